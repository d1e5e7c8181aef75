"""Few nodes: the inverse of diffusion by transforms that are matrix products, and Newton's method.

On up to :data:`MAX_DENSE_NODES` nodes along an axis the product with the matrix of a transform
takes less time than a fast transform. What is even about the middle of an axis has coefficients of
its own, and so has what is odd: two products of half the size. The axis that is transformed comes
first and the others are one long row, which the vector units want: so the array is turned between
transforms, and in the spectrum, where the order does not matter, stays turned.

Sums are made in a fixed order: the result has the same bits on all machines. Calls of compiled code
would take longer than its work here, so that all of a solve is one call.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import FloatArray
from multicell.compiling import INNER, KERNEL, UNCOUNTED, arithmetic, typed
from multicell.nutrient import stencil
from multicell.nutrient.uptake import uptake_and_slope

Float32Array = NDArray[np.float32]
_jit = typed(**KERNEL)
_inner = typed(**INNER)
_bare = typed(**UNCOUNTED)

MAX_DENSE_NODES = 48
"""Nodes along an axis up to which its transform is a matrix product."""


Ends = tuple[bool, bool] | None
"""Which ends of an axis have values, the others have slopes; None where space repeats."""


@lru_cache(maxsize=256)
def halves(n: int, values: bool | None) -> tuple[Float32Array, FloatArray]:
    """Return the transform between two values (or two slopes) by halves, and its eigenvalues.

    With ``values`` None that of an axis along which space repeats: cosines and sines.

    Returns (4, h, h) float32, h = (n + 1) / 2 rounded down: even and odd part of the transform, and
    of its inverse; the odd ones are smaller by one for odd n. The odd part takes nodes from the
    middle outwards; (n,) float64: eigenvalues of minus the second difference in the order of the
    coefficients.
    """
    if values is None:
        return _halves_of_circle(n)
    order, middle = np.arange(n)[:, None] + values, np.arange(n) + 0.5
    whole = (np.sin if values else np.cos)(np.pi / n * order * middle)
    whole *= math.sqrt(2.0 / n)
    whole[-1 if values else 0] *= math.sqrt(0.5)
    even, odd = whole[0::2, : (n + 1) // 2], whole[1::2, : n // 2][:, ::-1]
    of = eigenvalues(n, (values, values))
    return _both_ways(even, odd), np.concatenate([of[0::2], of[1::2]])


def _halves_of_circle(n: int) -> tuple[Float32Array, FloatArray]:
    """Return the transform along an axis that repeats: cosines about its middle, then sines."""
    away = np.arange(n) - 0.5 * (n - 1)
    number = np.arange((n + 1) // 2)[:, None], np.arange(1, n // 2 + 1)[:, None]
    even = np.cos(2.0 * np.pi / n * number[0] * away[: (n + 1) // 2])
    odd = np.sin(2.0 * np.pi / n * number[1] * away[: n // 2])[:, ::-1]
    scale = [math.sqrt(2.0 / n) * np.where((2 * k % n) == 0, math.sqrt(0.5), 1.0) for k in number]
    of = [4.0 * np.sin(np.pi / n * k[:, 0]) ** 2 for k in number]
    return _both_ways(scale[0] * even, scale[1] * odd), np.concatenate(of)


def _both_ways(even: FloatArray, odd: FloatArray) -> Float32Array:
    """Return the even and the odd part of a transform and of its inverse, (4, h, h)."""
    found = np.zeros((4, *even.shape), dtype=np.float32)
    for k, part in enumerate((even, odd, even.T, odd.T)):
        found[k, : len(part), : len(part)] = part
    return found


def eigenvalues(n: int, ends: Ends) -> FloatArray:
    """Return the n eigenvalues of minus the second difference between two ends.

    With values at both ends the angles are kπ/n for k = 1 ... n, with slopes at both for
    k = 0 ... n - 1, and with one of each (k + 1/2)π/n; where space repeats 2kπ/n for
    k = 0 ... n - 1.
    """
    if ends is None:
        return np.asarray(4.0 * np.sin(np.pi * np.arange(n) / n) ** 2)
    first = {(True, True): 1.0, (False, False): 0.0}.get(ends, 0.5)
    return np.asarray(4.0 * np.sin(0.5 * np.pi * (np.arange(n) + first) / n) ** 2)


@final
class Inverse:
    """Solves (A + shift) u = y, A having the eigenvalues of minus a Laplacian.

    - ``halves``, of each axis (4, h, h) and (n,): see :func:`halves`
    """

    def __init__(self, halves: Sequence[tuple[Float32Array, FloatArray]]) -> None:
        (fx, ax), (fy, ay), (fz, az) = halves
        nodes = len(ax) * len(ay) * len(az)
        self._single = np.empty((3, nodes), dtype=np.float32)
        self._work = np.empty((6, nodes))
        self._of_axes: tuple[Any, ...] = fx, fy, fz, ax, ay, az

    def newton(self, *problem: Any) -> tuple[Any, ...]:
        """Do what :func:`_newton` does with the arrays that it works in."""
        given = *problem, self._work, self._single, *self._of_axes
        return _newton(*given)


@_jit
def _newton(
    c: FloatArray,
    residual: FloatArray,
    rate: FloatArray,
    const: FloatArray,
    varied: FloatArray | None,
    tolerance: float,
    rounding: float,
    forcing: float,
    near_forcing: float,
    most: int,
    backtracks: int,
    uptake_shift: float,
    sink: FloatArray,
    source: FloatArray,
    half: float,
    stiffness: float,
    linear: float,
    ghost: FloatArray,
    weights: stencil.Weights,
    exchange: FloatArray | None,
    level: float,
    work: FloatArray,
    single: Float32Array,
    fx: Float32Array,
    fy: Float32Array,
    fz: Float32Array,
    ax: FloatArray,
    ay: FloatArray,
    az: FloatArray,
) -> tuple[Any, ...]:
    """Bring ``c`` to rest as :func:`multicell.nutrient.steady._newton` does on more nodes.

    - ``residual``, ``rate``, (nx, ny, nz): to be those of the last state
    - ``rounding``: error of the imbalance over the norm of ``c``; ``most``: Newton steps
    - ``work``, (6, nodes), ``single``, (3, nodes)

    Return whether it is done, Newton steps, steps of conjugate gradients, the sums of
    :func:`.stencil.write_imbalance`, the least concentration, the sums of :func:`.stencil.account`
    and of :func:`.stencil.flows`.
    """
    law = (sink, source, half, stiffness, linear, ghost, weights, exchange, level)
    here, there, root = c, work[5].reshape(c.shape), np.sqrt(c.size)
    x, left, parts = work[0], residual.reshape(c.size), np.empty((5, 1))
    steps, products, size = 0, 0, 0.0
    _imbalance(here, law, weights, exchange, residual, rate, parts, x)
    while True:
        last, size = size, np.sqrt(parts[0, 0])
        target = max(tolerance * parts[1, 0] / root, rounding * np.sqrt(parts[2, 0]))
        if steps == 0:  # far from the solution imbalances are larger than the uptake
            share = near_forcing if size * root < parts[1, 0] else forcing
        else:
            share = min(forcing, (size / last) * (size / last))
        if size <= target or not np.isfinite(size) or steps == most:
            break
        goal = max(share, 0.3 * target / size)
        products += _iterate(
            rate,
            residual,
            varied,
            stiffness,
            ghost,
            weights,
            size,
            goal * goal,
            work,
            single,
            uptake_shift,
            fx,
            fy,
            fz,
            ax,
            ay,
            az,
        )
        steps += 1
        a, b, slope, part = here.reshape(c.size), there.reshape(c.size), 0.0, 1.0
        for n in range(c.size):
            slope += left[n] * x[n]
        if not slope > 0.0:
            break
        for _ in range(backtracks):  # see :func:`multicell.nutrient.steady._search`
            for n in range(c.size):
                b[n] = x[n] * part + a[n]
            product = _imbalance(there, law, weights, exchange, residual, rate, parts, x)
            if not product < -0.9 * slope:
                break
            part *= max(slope / (slope - product), 0.25)
        here, there = there, here
    a, b, least = here.reshape(c.size), c.reshape(c.size), np.inf
    for n in range(c.size):
        b[n] = a[n]
        least = min(least, a[n])
    amounts = stencil.account(c, sink, half, residual)
    flows = stencil.flows(c, ghost, const, weights)
    s = parts[:, 0]
    sums = s[0], s[1], s[2], s[3], s[4]
    return size <= target, steps, products, sums, least, amounts, flows


@_inner
def _imbalance(
    c: FloatArray,
    law: tuple[Any, ...],
    weights: stencil.Weights,
    exchange: FloatArray | None,
    residual: FloatArray,
    rate: FloatArray,
    parts: FloatArray,
    x: FloatArray,
) -> float:
    """Do what :func:`.stencil.imbalance_of_planes` does for all planes, which are one block.

    Return the product of the residual and ``x``, (nodes,). Planes without weights are one long row:
    short ones would leave the vector units idle.
    """
    # arguments of their own: numba does not see that a part of a tuple is None
    sink, source, half, stiffness, linear, ghost, _, _, _ = law
    nx, across = len(c), c.shape[1] * c.shape[2]
    if weights is not None or exchange is not None:
        stencil.imbalance_of_planes(0, nx, c, *law, residual, rate, parts, nx)
        every, product = residual.reshape(c.size), 0.0
        for k in range(c.size):
            product += every[k] * x[k]
        return product
    row, sinks, changes = np.empty(across), np.empty(across), np.empty(across)
    squares, total, size, net, change, product = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(nx):
        along = x[i * across : (i + 1) * across]
        e, most, brought = c[i].reshape(across), sink[i].reshape(across), source[i].reshape(across)
        left, slopes = residual[i].reshape(across), rate[i].reshape(across)
        _fill_plane(c, ghost, i, row)
        for k in range(across):  # no sums, for the vector units
            v = e[k]
            taken, slope = uptake_and_slope(most[k], v, half)
            spent = taken + linear * v
            outward = stiffness * (6.0 * v - row[k])
            row[k] = brought[k] - outward - spent
            left[k] = row[k]
            slopes[k] = slope + linear
            sinks[k] = spent
            changes[k] = outward + (slope + linear) * v
        for k in range(across):
            squares += row[k] * row[k]
            total += sinks[k]
            size += e[k] * e[k]
            net += row[k]
            change += changes[k]
            product += row[k] * along[k]
    parts[0, 0], parts[1, 0], parts[2, 0] = squares, total, size
    parts[3, 0], parts[4, 0] = net, change
    return product


@_bare
def _fill_plane(p: FloatArray, ghost: FloatArray, i: int, out: FloatArray) -> None:
    """Write the sums of neighbours of a plane to ``out``, see :func:`.stencil.fill_row`."""
    nx, ny, nz = p.shape
    for j in range(0, ny, max(ny - 1, 1)):
        stencil.fill_row(p, ghost, i, j, out[j * nz : (j + 1) * nz])
    if ny < 3:
        return
    plane, end = p[i].reshape(ny * nz), (ny - 1) * nz
    o, e, c, d = out[nz:end], plane[nz:end], plane[: end - nz], plane[2 * nz :]
    a, wa = (p[i - 1].reshape(ny * nz)[nz:end], 1.0) if i > 0 else (e, ghost[0])
    b, wb = (p[i + 1].reshape(ny * nz)[nz:end], 1.0) if i < nx - 1 else (e, ghost[1])
    before, after = plane[nz - 1 : end - 1], plane[nz + 1 : end + 1]
    if i == 0 or i == nx - 1:
        for k in range(o.size):
            o[k] = (wa * a[k] + wb * b[k] + c[k] + d[k]) + before[k] + after[k]
    else:
        for k in range(o.size):
            o[k] = (a[k] + b[k]) + (c[k] + d[k]) + (before[k] + after[k])
    for k in range(0, o.size, nz):  # the ends of rows
        across = wa * a[k] + wb * b[k] + c[k] + d[k] + ghost[4] * e[k]
        o[k] = across + (after[k] if nz > 1 else ghost[5] * e[k])
    for k in range(nz - 1, o.size if nz > 1 else 0, nz):
        o[k] = (wa * a[k] + wb * b[k] + c[k] + d[k] + before[k]) + ghost[5] * e[k]


@_inner
def _iterate(
    rate: FloatArray,
    residual: FloatArray,
    varied: FloatArray | None,
    stiffness: float,
    ghost: FloatArray,
    weights: stencil.Weights,
    size: float,
    goal: float,
    work: FloatArray,
    single: Float32Array,
    uptake_shift: float,
    fx: Float32Array,
    fy: Float32Array,
    fz: Float32Array,
    ax: FloatArray,
    ay: FloatArray,
    az: FloatArray,
) -> int:
    """Solve (-D L0 + rate) x = residual by conjugate gradients; return the number of steps.

    - ``size``, ``goal``: of the residual's norm, and the square of the part of it to be left
    - ``work``, (5, nodes) and more: x first; ``single``, (3, nodes)
    - ``uptake_shift``: the preconditioner's, over the mean of the rates
    """
    x, r, p, q, scale, flat = work[0], work[1], work[2], work[3], work[4], single[2]
    direction, image, y = p.reshape(rate.shape), q.reshape(rate.shape), flat.reshape(rate.shape)
    rates, left = rate.reshape(rate.size), residual.reshape(rate.size)
    weight = None if varied is None else varied.reshape(rate.size)
    total = stencil.begin(rates, left, weight, 0.5 / stiffness, size, x, r, p, scale, flat)
    shift = uptake_shift * total / rate.size
    rho, beta, steps = _invert(y, shift, stiffness, single, fx, fy, fz, ax, ay, az), 0.0, 0
    while steps < stencil.MAX_CG:
        stencil.new_direction(p, flat, scale, beta)
        curvature = stencil.apply_operator(direction, rate, stiffness, ghost, weights, image)
        if not curvature > 0.0:  # single precision has no smaller numbers
            break
        steps += 1
        if not stencil.update_residual(rho / curvature, x, p, r, q, scale, flat) > goal:
            break
        following = _invert(y, shift, stiffness, single, fx, fy, fz, ax, ay, az)
        beta, rho = following / rho, following
    for n in range(x.size):
        x[n] *= size
    return steps


@arithmetic
def _invert(
    y: Float32Array,
    shift: float,
    stiffness: float,
    room: Float32Array,
    fx: Float32Array,
    fy: Float32Array,
    fz: Float32Array,
    lx: FloatArray,
    ly: FloatArray,
    lz: FloatArray,
) -> float:
    """Overwrite ``y`` (nx, ny, nz) with u, where (A + shift) u = y, and return y . u.

    - ``shift``, and eigenvalues of A along each axis, 1/s; ``room``, (2, nodes) and more
    """
    nx, ny, nz = y.shape
    u, a, b = y.reshape((nx, ny * nz)), room[0], room[1]
    ax, ay, az = a.reshape((nx, ny * nz)), a.reshape((ny, nx * nz)), a.reshape((nz, ny * nx))
    by, bz, turned = b.reshape((ny, nx * nz)), b.reshape((nz, ny * nx)), a.reshape((ny * nx, nz))
    _forward(fx, u, ax)
    _swap(ax, by)
    _forward(fy, by, ay)
    _turn(turned, bz)
    _forward(fz, bz, az)
    product = _divide(az, stiffness, lx, ly, lz, shift)
    _backward(fz, az, bz)
    _turn(bz, turned)
    _backward(fy, ay, by)
    _swap(by, ax)
    _backward(fx, ax, u)
    return product


@_inner
def _forward(f: Float32Array, x: Float32Array, y: Float32Array) -> None:
    """Write the transform of ``x`` along its first axis to ``y``; ``x`` is overwritten."""
    half = f.shape[1]
    _fold(x)
    _product(f[0], x[:half], y[:half])
    _product(f[1], x[half:], y[half:])


@_inner
def _backward(f: Float32Array, x: Float32Array, y: Float32Array) -> None:
    """Write the inverse transform of ``x`` along its first axis to ``y``."""
    half = f.shape[1]
    _product(f[2], x[:half], y[:half])
    _product(f[3], x[half:], y[half:])
    _fold(y)


@_bare
def _fold(x: Float32Array) -> None:
    """Replace each two rows at the same distance from the middle by their sum and difference."""
    n, m = x.shape
    for i in range(n // 2):
        other = n - 1 - i
        for c in range(m):
            s, d = x[i, c] + x[other, c], x[i, c] - x[other, c]
            x[i, c], x[other, c] = s, d


@_inner
def _product(f: Float32Array, x: Float32Array, y: Float32Array) -> None:
    """Write the product of ``f``, of which the first n rows and columns count, and ``x`` to ``y``.

    ``x`` and ``y`` are (n, m). Two rows are made at a time, from four at a time: a number that is
    loaded is used more than once.
    """
    n, m = x.shape
    whole = n - n % 4
    spare = np.empty(m if n % 2 else 0, dtype=np.float32)
    for a in range(0, n, 2):
        b = min(a + 1, n - 1)
        p, q = y[a], y[b] if b > a else spare
        for c in range(m):
            p[c] = 0.0
            q[c] = 0.0
        for i in range(0, whole, 4):
            a0, a1, a2, a3 = f[a, i], f[a, i + 1], f[a, i + 2], f[a, i + 3]
            b0, b1, b2, b3 = f[b, i], f[b, i + 1], f[b, i + 2], f[b, i + 3]
            for c in range(m):
                s, t, u, v = x[i, c], x[i + 1, c], x[i + 2, c], x[i + 3, c]
                p[c] += (a0 * s + a1 * t) + (a2 * u + a3 * v)
                q[c] += (b0 * s + b1 * t) + (b2 * u + b3 * v)
        for i in range(whole, n):
            a0, b0 = f[a, i], f[b, i]
            for c in range(m):
                p[c] += a0 * x[i, c]
                q[c] += b0 * x[i, c]


# Flat arrays and unsigned numbers: the compiler would look for numbers that count from the end, and
# takes ten times as long.
@_bare
def _swap(x: Float32Array, y: Float32Array) -> None:
    """Write ``x`` (n, m k) as (m, n k) to ``y``: the first two of three axes change places."""
    n, m = x.shape[0], y.shape[0]
    k = x.shape[1] // m
    p, q = x.reshape(x.size), y.reshape(y.size)
    for i in range(n):
        for j in range(m):
            a, b = (
                p[(i * m + j) * k : (i * m + j + 1) * k],
                q[(j * n + i) * k : (j * n + i + 1) * k],
            )
            for c in range(k):
                b[c] = a[c]


@_bare
def _turn(x: Float32Array, y: Float32Array) -> None:
    """Write the transpose of ``x`` to ``y``, in blocks that fit into the nearest memory."""
    rows, columns = np.uint64(x.shape[0]), np.uint64(x.shape[1])
    p, q = x.reshape(x.size), y.reshape(y.size)
    for i in range(0, x.shape[0], 16):
        first, number = np.uint64(i), np.uint64(min(16, x.shape[0] - i))
        for j in range(columns):
            a, b = first * columns + j, j * rows + first
            for k in range(number):
                q[b + k] = p[a + k * columns]


@_inner
def _divide(
    spectrum: Float32Array,
    stiffness: float,
    lx: FloatArray,
    ly: FloatArray,
    lz: FloatArray,
    shift: float,
) -> float:
    """Divide the spectrum (nz, ny nx) in place; return the product of before and after."""
    nx, across = lx.size, lx.size * ly.size
    base, parts = np.empty(across), np.empty(across)
    for c in range(across):
        base[c] = stiffness * ly[c // nx] + stiffness * lx[c % nx] + shift
        parts[c] = 0.0
    for k in range(lz.size):
        row, least = spectrum[k], stiffness * lz[k]
        for c in range(across):
            v = row[c]
            w = v / (base[c] + least)
            row[c] = w
            parts[c] += v * w
    product = 0.0
    for c in range(across):
        product += parts[c]
    return product
