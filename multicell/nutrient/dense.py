"""The inverse of diffusion on few nodes, by sine and cosine transforms that are matrix products.

On up to :data:`MAX_DENSE_NODES` nodes along an axis the product with the matrix of a transform
takes less time than a fast transform. What is even about the middle of an axis has coefficients of
its own, and so has what is odd: two products of half the size. The axis that is transformed comes
first and the others are one long row, which the vector units want: so the array is turned between
transforms, and in the spectrum, where the order does not matter, stays turned.

Sums are made in a fixed order: the result has the same bits on all machines.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import FloatArray
from multicell.compiling import INNER, KERNEL, arithmetic, typed
from multicell.nutrient import stencil

Float32Array = NDArray[np.float32]
_jit = typed(**KERNEL)
_inner = typed(**INNER)

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
    - ``stiffness``, float, 1/s: what the eigenvalues are to be multiplied by
    """

    def __init__(self, halves: Sequence[tuple[Float32Array, FloatArray]], stiffness: float) -> None:
        (fx, ax), (fy, ay), (fz, az) = halves
        nx, ny, nz = len(ax), len(ay), len(az)
        self._room = np.empty((2, nx * ny * nz), dtype=np.float32)
        along = stiffness * ax, stiffness * ay, stiffness * az
        self._of_axes: tuple[Any, ...] = fx, fy, fz, *along

    def overwrite(self, y: Float32Array, shift: float) -> float:
        """Overwrite ``y`` (nx, ny, nz) with u, and return y . u; ``shift`` is in 1/s."""
        return float(_invert(y, shift, self._room, *self._of_axes))

    def iterate(self, *system: Any) -> int:
        """Solve by conjugate gradients as :func:`_iterate` does; return the number of steps."""
        given = *system, self._room, *self._of_axes
        return int(_iterate(*given))


@_jit
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
    y: Float32Array,
    uptake_shift: float,
    room: Float32Array,
    fx: Float32Array,
    fy: Float32Array,
    fz: Float32Array,
    lx: FloatArray,
    ly: FloatArray,
    lz: FloatArray,
) -> int:
    """Solve (-D L0 + rate) x = residual in one call: on few nodes calls take longer than the work.

    - ``size``, ``goal``: of the residual's norm, and the square of the part of it to be left
    - ``work``, (5, nodes): x first; ``y``, (nx, ny, nz)
    - ``uptake_shift``: the preconditioner's, over the mean of the rates
    """
    x, r, p, q, scale = work[0], work[1], work[2], work[3], work[4]
    direction, image, flat = p.reshape(rate.shape), q.reshape(rate.shape), y.reshape(y.size)
    rates, left = rate.reshape(rate.size), residual.reshape(rate.size)
    weight = None if varied is None else varied.reshape(rate.size)
    total = stencil.begin(rates, left, weight, 0.5 / stiffness, size, x, r, p, scale, flat)
    shift = uptake_shift * total / rate.size
    rho, beta, steps = _invert(y, shift, room, fx, fy, fz, lx, ly, lz), 0.0, 0
    while steps < stencil.MAX_CG:
        stencil.new_direction(p, flat, scale, beta)
        curvature = stencil.apply_operator(direction, rate, stiffness, ghost, weights, image)
        if not curvature > 0.0:  # single precision has no smaller numbers
            break
        steps += 1
        if not stencil.update_residual(rho / curvature, x, p, r, q, scale, flat) > goal:
            break
        following = _invert(y, shift, room, fx, fy, fz, lx, ly, lz)
        beta, rho = following / rho, following
    for n in range(x.size):
        x[n] *= size
    return steps


@arithmetic
def _invert(
    y: Float32Array,
    shift: float,
    room: Float32Array,
    fx: Float32Array,
    fy: Float32Array,
    fz: Float32Array,
    lx: FloatArray,
    ly: FloatArray,
    lz: FloatArray,
) -> float:
    """Do what :meth:`Inverse.overwrite` does, with ``room``, (2, nodes)."""
    nx, ny, nz = y.shape
    u, a, b = y.reshape((nx, ny * nz)), room[0], room[1]
    ax, ay, az = a.reshape((nx, ny * nz)), a.reshape((ny, nx * nz)), a.reshape((nz, ny * nx))
    by, bz, turned = b.reshape((ny, nx * nz)), b.reshape((nz, ny * nx)), a.reshape((ny * nx, nz))
    _forward(fx, u, ax)
    _swap(ax, by)
    _forward(fy, by, ay)
    _turn(turned, bz)
    _forward(fz, bz, az)
    product = _divide(az, lx, ly, lz, shift)
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


@_inner
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


@_inner
def _swap(x: Float32Array, y: Float32Array) -> None:
    """Write ``x`` (n, m k) as (m, n k) to ``y``: the first two of three axes change places."""
    n, m = x.shape[0], y.shape[0]
    k = x.shape[1] // m
    for i in range(n):
        for j in range(m):
            for c in range(k):
                y[j, i * k + c] = x[i, j * k + c]


@_inner
def _turn(x: Float32Array, y: Float32Array) -> None:
    """Write the transpose of ``x`` to ``y``, in blocks that fit into the nearest memory."""
    rows, columns = x.shape
    for i in range(0, rows, 16):
        for j in range(0, columns, 16):
            for k in range(i, min(i + 16, rows)):
                for m in range(j, min(j + 16, columns)):
                    y[m, k] = x[k, m]


@_inner
def _divide(
    spectrum: Float32Array, lx: FloatArray, ly: FloatArray, lz: FloatArray, shift: float
) -> float:
    """Divide the spectrum (nz, ny nx) in place; return the product of before and after."""
    nx, across = lx.size, lx.size * ly.size
    base, parts = np.empty(across), np.empty(across)
    for c in range(across):
        base[c] = ly[c // nx] + lx[c % nx] + shift
        parts[c] = 0.0
    for k in range(lz.size):
        row, least = spectrum[k], lz[k]
        for c in range(across):
            v = row[c]
            w = v / (base[c] + least)
            row[c] = w
            parts[c] += v * w
    product = 0.0
    for c in range(across):
        product += parts[c]
    return product
