"""Loops over all nodes that the steady solver needs, each fused into one pass.

All run on one thread, so that no sum depends on the number of threads. At a face of the box the
missing neighbour is ``ghost[face]`` times the node itself, faces in the order x-, x+, y-, y+, z-,
z+, and what else the condition brings is part of the source: py-pde's convention, in which a value
gives -1 and a slope 1. A test holds the stencil against py-pde's own operator.

Where the coefficient of diffusion differs from place to place, ``wx``, ``wy`` and ``wz`` hold it at
all faces between nodes, relative to that of tissue; else they are empty.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

from multicell.cells import FloatArray

Float32Array = NDArray[np.float32]
_F = TypeVar("_F", bound=Callable[..., Any])
# No fastmath: with it, a function compiled now and the same one read from numba's disk cache were
# seen to differ in the last bits. Division as NumPy does it has no branch.
_jit = cast(Callable[[_F], _F], njit(cache=True, error_model="numpy"))


@_jit
def _around(p: FloatArray, ghost: FloatArray, i: int, j: int, k: int) -> float:
    """Return the sum of the six neighbours of a node."""
    nx, ny, nz = p.shape
    v = p[i, j, k]
    total = 0.0
    total += p[i - 1, j, k] if i > 0 else ghost[0] * v
    total += p[i + 1, j, k] if i < nx - 1 else ghost[1] * v
    total += p[i, j - 1, k] if j > 0 else ghost[2] * v
    total += p[i, j + 1, k] if j < ny - 1 else ghost[3] * v
    total += p[i, j, k - 1] if k > 0 else ghost[4] * v
    total += p[i, j, k + 1] if k < nz - 1 else ghost[5] * v
    return float(total)


@_jit
def _fill_row(p: FloatArray, ghost: FloatArray, i: int, j: int, row: FloatArray) -> None:
    """Write the sums of neighbours along the last axis to ``row``."""
    nx, ny, nz = p.shape
    if i == 0 or i == nx - 1 or j == 0 or j == ny - 1 or nz == 1:
        for k in range(nz):
            row[k] = _around(p, ghost, i, j, k)
        return
    row[0], row[nz - 1] = _around(p, ghost, i, j, 0), _around(p, ghost, i, j, nz - 1)
    a, b, c, d, e = p[i - 1, j], p[i + 1, j], p[i, j - 1], p[i, j + 1], p[i, j]
    for k in range(1, nz - 1):  # no branches, for the vector units
        row[k] = (a[k] + b[k]) + (c[k] + d[k]) + (e[k - 1] + e[k + 1])


@_jit
def _fill_varied(
    p: FloatArray,
    ghost: FloatArray,
    wx: FloatArray,
    wy: FloatArray,
    wz: FloatArray,
    i: int,
    j: int,
    row: FloatArray,
    diagonal: FloatArray,
) -> None:
    """Write the weighted sums of neighbours to ``row`` and those of the weights."""
    nx, ny, nz = p.shape
    for k in range(nz):
        v = p[i, j, k]
        a, b = wx[i, j, k], wx[i + 1, j, k]
        c, d = wy[i, j, k], wy[i, j + 1, k]
        e, f = wz[i, j, k], wz[i, j, k + 1]
        total = a * (p[i - 1, j, k] if i > 0 else ghost[0] * v)
        total += b * (p[i + 1, j, k] if i < nx - 1 else ghost[1] * v)
        total += c * (p[i, j - 1, k] if j > 0 else ghost[2] * v)
        total += d * (p[i, j + 1, k] if j < ny - 1 else ghost[3] * v)
        total += e * (p[i, j, k - 1] if k > 0 else ghost[4] * v)
        total += f * (p[i, j, k + 1] if k < nz - 1 else ghost[5] * v)
        row[k] = total
        diagonal[k] = a + b + c + d + e + f


@_jit
def apply_operator(
    p: FloatArray,
    rate: FloatArray,
    stiffness: float,
    ghost: FloatArray,
    wx: FloatArray,
    wy: FloatArray,
    wz: FloatArray,
    out: FloatArray,
) -> float:
    """Write ``(-D L0 + rate) p`` to ``out`` and return its product with ``p``.

    ``stiffness`` is D/h² in 1/s, ``rate`` the linearised uptake at the nodes in 1/s.
    """
    nx, ny, nz = p.shape
    row, diagonal = np.empty(nz), np.full(nz, 6.0)
    product = 0.0
    for i in range(nx):
        for j in range(ny):
            if wx.size:
                _fill_varied(p, ghost, wx, wy, wz, i, j, row, diagonal)
            else:
                _fill_row(p, ghost, i, j, row)
            for k in range(nz):
                v = p[i, j, k]
                w = stiffness * (diagonal[k] * v - row[k]) + rate[i, j, k] * v
                out[i, j, k] = w
                product += v * w
    return product


@_jit
def imbalance(
    c: FloatArray,
    sink: FloatArray,
    source: FloatArray,
    half: float,
    stiffness: float,
    linear: float,
    ghost: FloatArray,
    wx: FloatArray,
    wy: FloatArray,
    wz: FloatArray,
    residual: FloatArray,
    rate: FloatArray,
) -> tuple[float, float, float]:
    """Write sources minus sinks of all nodes (mM/s) and the sinks' derivative (1/s).

    The sinks are the uptake and ``linear`` times c. Below zero, where only intermediate iterates
    can be, the law ``sink c / (half + c)`` goes on along its tangent. Return the sums of
    residual², of all sinks, and of c².
    """
    nx, ny, nz = c.shape
    row, diagonal = np.empty(nz), np.full(nz, 6.0)
    squares, total, size = 0.0, 0.0, 0.0
    for i in range(nx):
        for j in range(ny):
            if wx.size:
                _fill_varied(c, ghost, wx, wy, wz, i, j, row, diagonal)
            else:
                _fill_row(c, ghost, i, j, row)
            for k in range(nz):
                v = c[i, j, k]
                kept = max(v, 0.0)
                share = half / (half + kept)
                slope = sink[i, j, k] / (half + kept) * share
                spent = sink[i, j, k] * kept / (half + kept) + slope * (v - kept) + linear * v
                r = source[i, j, k] - stiffness * (diagonal[k] * v - row[k]) - spent
                residual[i, j, k] = r
                rate[i, j, k] = slope + linear
                squares += r * r
                total += spent
                size += v * v
    return squares, total, size


@_jit
def balance_negative(
    c: FloatArray,
    sink: FloatArray,
    source: FloatArray,
    half: float,
    stiffness: float,
    linear: float,
    ghost: FloatArray,
    wx: FloatArray,
    wy: FloatArray,
    wz: FloatArray,
    most: int,
) -> int:
    """Bring all nodes below zero to their own balance, in sweeps, until there are none.

    A node is given the concentration at which its sinks meet its source and what comes from its
    neighbours; one that has reached zero is left alone from then on. Return how many are below
    zero after at most ``most`` sweeps.
    """
    nx, ny, nz = c.shape
    below = np.flatnonzero(c.ravel() < 0.0)
    left = below.size
    for sweep in range(most):
        if left == 0:
            break
        left = 0
        for m in range(below.size):
            # every other sweep runs backwards: what a neighbour brings crosses the core at once
            n = below[m if sweep % 2 == 0 else below.size - 1 - m]
            i, j, k = n // (ny * nz), n // nz % ny, n % nz
            if c[i, j, k] >= 0.0:
                continue
            gain, loss = source[i, j, k], linear
            for face in range(6):
                w = 1.0
                if wx.size:
                    axis, high = face // 2, face % 2
                    if axis == 0:
                        w = wx[i + high, j, k]
                    elif axis == 1:
                        w = wy[i, j + high, k]
                    else:
                        w = wz[i, j, k + high]
                step = 2 * (face % 2) - 1
                a = i + step if face // 2 == 0 else i
                b = j + step if face // 2 == 1 else j
                d = k + step if face // 2 == 2 else k
                if 0 <= a < nx and 0 <= b < ny and 0 <= d < nz:
                    gain += stiffness * w * c[a, b, d]
                    loss += stiffness * w
                else:
                    loss += stiffness * w * (1.0 - ghost[face])
            if gain >= 0.0:  # loss c + sink c / (half + c) = gain
                middle = loss * half + sink[i, j, k] - gain
                root = np.sqrt(middle * middle + 4.0 * loss * gain * half)
                # the smaller of two sums would cancel
                v = (
                    2.0 * gain * half / (middle + root)
                    if middle > 0.0
                    else 0.5 * (root - middle) / loss
                )
            else:
                v = gain / (loss + sink[i, j, k] / half)
            c[i, j, k] = v
            left += v < 0.0
    return left


@_jit
def begin(
    rate: FloatArray,
    residual: FloatArray,
    weight: FloatArray,
    time: float,
    size: float,
    x: FloatArray,
    r: FloatArray,
    p: FloatArray,
    scale: FloatArray,
    y: Float32Array,
) -> float:
    """Start the linear solver: ``scale = (w + time rate)^(-1/2)``, ``y = scale r``, no direction.

    ``w`` is the relative coefficient of diffusion at the nodes, one where the array is empty, and
    ``r`` the residual over its ``size``. Return the sum of ``scale² rate``.
    """
    rate, residual, x, r = rate.ravel(), residual.ravel(), x.ravel(), r.ravel()
    p, scale, y, weight = p.ravel(), scale.ravel(), y.ravel(), weight.ravel()
    total = 0.0
    for n in range(rate.size):
        w = weight[n] if weight.size else 1.0
        square = 1.0 / (w + time * rate[n])
        s = np.sqrt(square)
        v = residual[n] / size
        x[n] = 0.0
        p[n] = 0.0
        r[n] = v
        scale[n] = s
        y[n] = s * v
        total += square * rate[n]
    return total


@_jit
def advance(
    step: float,
    x: FloatArray,
    p: FloatArray,
    r: FloatArray,
    q: FloatArray,
    scale: FloatArray,
    y: Float32Array,
) -> float:
    """Do ``x += step p``, ``r -= step q``, ``y = scale r``; return ``r . r``."""
    x, p, r, q, scale, y = x.ravel(), p.ravel(), r.ravel(), q.ravel(), scale.ravel(), y.ravel()
    product = 0.0
    for n in range(x.size):
        x[n] += step * p[n]
        v = r[n] - step * q[n]
        r[n] = v
        y[n] = scale[n] * v
        product += v * v
    return product


@_jit
def new_direction(p: FloatArray, u: Float32Array, scale: FloatArray, beta: float) -> None:
    """Do ``p = scale u + beta p``."""
    p, u, scale = p.ravel(), u.ravel(), scale.ravel()
    for n in range(p.size):
        p[n] = scale[n] * u[n] + beta * p[n]


@_jit
def divide_spectrum(
    spectrum: Float32Array, ax: FloatArray, ay: FloatArray, az: FloatArray, shift: float
) -> float:
    """Divide by ``ax + ay + az + shift`` in place; return the product of before and after.

    With an orthonormal transform that product is the one of residual and preconditioned residual.
    """
    nx, ny, nz = spectrum.shape
    product = 0.0
    for i in range(nx):
        for j in range(ny):
            base = ax[i] + ay[j] + shift
            for k in range(nz):
                v = spectrum[i, j, k]
                w = v / (base + az[k])
                spectrum[i, j, k] = w
                product += v * w
    return product


@_jit
def dot(a: FloatArray, b: FloatArray) -> float:
    """Return the product of two fields (NumPy's may use threads and then change its bits)."""
    a, b = a.ravel(), b.ravel()
    product = 0.0
    for n in range(a.size):
        product += a[n] * b[n]
    return product
