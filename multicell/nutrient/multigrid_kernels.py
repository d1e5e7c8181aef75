"""Loops over the nodes of one level of the multigrid hierarchy, in single precision.

The operator of a level is A x = (sum over axes of x's second differences with the conditions on
the faces) + rate x, divided by D/h² of the finest level. ``along`` holds it for the three axes: of
each a (3, n) table with the coefficients of the lower neighbour, of the upper one, and of the node
itself. Conditions and cells of unequal width are in these tables, so that the loops have no
branches. All arrays of nodes are (nx, ny, nz) float32.

Each loop runs over the planes from ``begin`` to ``end`` of what it writes, without the lock of
the interpreter, so that threads can share it (:class:`multicell.threads.Team`). Products are
summed plane by plane: the same bits for any number of threads.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit

from multicell.compiling import INNER, KERNEL
from multicell.nutrient.stencil import _fill_varied

_F = TypeVar("_F", bound=Callable[..., Any])
_jit = cast(Callable[[_F], _F], njit(**KERNEL, error_model="numpy", nogil=True))
_inner = cast(Callable[[_F], _F], njit(**INNER, nogil=True))

_NONE = np.float32(0.0)
_ONE = np.float32(1.0)


@_inner
def _neighbours(x: Any, along: Any, i: int, j: int, row: Any) -> None:
    """Write the weighted sums of the six neighbours of the nodes (i, j, :) to ``row``, (nz,)."""
    nx, ny, nz = x.shape
    ax, ay, az = along
    a, b = x[max(i - 1, 0), j], x[min(i + 1, nx - 1), j]
    c, d = x[i, max(j - 1, 0)], x[i, min(j + 1, ny - 1)]
    e, low, high = x[i, j], az[0], az[1]
    wa, wb, wc, wd = ax[0, i], ax[1, i], ay[0, j], ay[1, j]
    for k in range(1, nz - 1):
        across = (wa * a[k] + wb * b[k]) + (wc * c[k] + wd * d[k])
        row[k] = across + (low[k] * e[k - 1] + high[k] * e[k + 1])
    for k in (0, nz - 1):
        across = (wa * a[k] + wb * b[k]) + (wc * c[k] + wd * d[k])
        row[k] = across + (low[k] * e[max(k - 1, 0)] + high[k] * e[min(k + 1, nz - 1)])


@_jit
def first(begin: int, end: int, b: Any, rate: Any, along: Any, weight: Any, out: Any) -> None:
    """Write the first damped Jacobi step from zero, ``weight b / diagonal``, to ``out``."""
    ny, nz = b.shape[1:]
    ax, ay, az = along
    for i in range(begin, end):
        for j in range(ny):
            base, right, r, o = ax[2, i] + ay[2, j], b[i, j], rate[i, j], out[i, j]
            for k in range(nz):
                o[k] = weight * right[k] / (base + az[2, k] + r[k])


@_jit
def relax(
    begin: int, end: int, x: Any, b: Any, rate: Any, along: Any, weight: Any, out: Any
) -> None:
    """Write ``x + weight (b - A x) / diagonal``, a damped Jacobi step, to ``out``."""
    ny, nz = x.shape[1:]
    ax, ay, az = along
    for i in range(begin, end):
        row = np.empty(nz, np.float32)
        for j in range(ny):
            _neighbours(x, along, i, j, row)
            base, e, right, r, o = ax[2, i] + ay[2, j], x[i, j], b[i, j], rate[i, j], out[i, j]
            for k in range(nz):
                o[k] = e[k] + weight * ((right[k] + row[k]) / (base + az[2, k] + r[k]) - e[k])


@_inner
def _pair(total: Any, share: Any, out: Any) -> None:
    """Write the weighted sums of neighbouring pairs, (n,), to ``out``, (ceil(n / 2),)."""
    n = total.size
    for k in range(n // 2):
        out[k] = share[2 * k] * total[2 * k] + share[2 * k + 1] * total[2 * k + 1]
    if n % 2 == 1:
        out[n // 2] = share[n - 1] * total[n - 1]


@_jit
def restrict(
    begin: int, end: int, x: Any, b: Any, rate: Any, along: Any, shares: Any, out: Any
) -> None:
    """Write the mean of ``b - A x`` over the up to eight nodes in each node of the next level.

    ``shares`` (n,) of each axis are the nodes' widths over that of the one they lie in.
    """
    nx, ny, nz = x.shape
    ax, ay, az = along
    sx, sy, sz = shares
    for coarse in range(begin, end):
        row, total = np.empty(nz, np.float32), np.empty(nz, np.float32)
        for across in range(out.shape[1]):
            total[:] = _NONE
            for i in range(2 * coarse, min(2 * coarse + 2, nx)):
                for j in range(2 * across, min(2 * across + 2, ny)):
                    _neighbours(x, along, i, j, row)
                    base, share = ax[2, i] + ay[2, j], sx[i] * sy[j]
                    e, right, r = x[i, j], b[i, j], rate[i, j]
                    for k in range(nz):
                        left = right[k] + row[k] - (base + az[2, k] + r[k]) * e[k]
                        total[k] += share * left
            _pair(total, sz, out[coarse, across])


@_jit
def average(begin: int, end: int, values: Any, shares: Any, out: Any) -> None:
    """Write the mean over the nodes in each node of the next level; see :func:`_restrict`."""
    nx, ny, nz = values.shape
    sx, sy, sz = shares
    for coarse in range(begin, end):
        total = np.empty(nz, np.float32)
        for across in range(out.shape[1]):
            total[:] = _NONE
            for i in range(2 * coarse, min(2 * coarse + 2, nx)):
                for j in range(2 * across, min(2 * across + 2, ny)):
                    share, v = sx[i] * sy[j], values[i, j]
                    for k in range(nz):
                        total[k] += share * v[k]
            _pair(total, sz, out[coarse, across])


@_jit
def prolong(begin: int, end: int, coarse: Any, others: Any, weights: Any, out: Any) -> None:
    """Add the linear interpolation between the nodes of the next level to ``out``.

    Node i of an axis lies in i // 2; the second one that it lies between is ``others[i]``, with
    the weight ``weights[i]``.
    """
    ny, nz = out.shape[1:]
    ox, oy, oz = others
    wx, wy, wz = weights
    n = coarse.shape[2]
    for i in range(begin, end):
        row = np.empty(n, np.float32)
        for j in range(ny):
            a, b = coarse[i // 2, j // 2], coarse[ox[i], j // 2]
            c, d = coarse[i // 2, oy[j]], coarse[ox[i], oy[j]]
            u, v = wx[i], wy[j]
            wa, wb, wc, wd = (_ONE - u) * (_ONE - v), u * (_ONE - v), (_ONE - u) * v, u * v
            for k in range(n):
                row[k] = (wa * a[k] + wb * b[k]) + (wc * c[k] + wd * d[k])
            o = out[i, j]
            inner = max(nz // 2 - 1, 1)
            for k in range(1, inner):
                m = 2 * k
                o[m] += (_ONE - wz[m]) * row[k] + wz[m] * row[k - 1]
                o[m + 1] += (_ONE - wz[m + 1]) * row[k] + wz[m + 1] * row[k + 1]
            for k in range(min(2, nz)):
                o[k] += (_ONE - wz[k]) * row[k // 2] + wz[k] * row[oz[k]]
            for k in range(2 * inner, nz):
                o[k] += (_ONE - wz[k]) * row[k // 2] + wz[k] * row[oz[k]]


@_jit
def direct(begin: int, end: int, p: Any, z: Any, beta: Any) -> None:
    """Do ``p = z + beta p``."""
    ny, nz = p.shape[1:]
    for i in range(begin, end):
        for j in range(ny):
            old, new = p[i, j], z[i, j]
            for k in range(nz):
                old[k] = new[k] + beta * old[k]


@_jit
def apply(
    begin: int,
    end: int,
    p: Any,
    rate: Any,
    along: Any,
    ghost: Any,
    weights: Any,
    out: Any,
    parts: Any,
) -> None:
    """Write ``A p`` to ``out``, and its product with ``p`` in each plane to ``parts``, (nx,).

    With ``weights`` the coefficient of diffusion differs from place to place; ``ghost`` and they
    are those of :mod:`multicell.nutrient.stencil`.
    """
    ny, nz = p.shape[1:]
    ax, ay, az = along
    for i in range(begin, end):
        row, diagonal = np.empty(nz, np.float32), np.empty(nz, np.float32)
        total = np.zeros(nz)
        for j in range(ny):
            if weights is None:
                _neighbours(p, along, i, j, row)
                base = ax[2, i] + ay[2, j]
                for k in range(nz):
                    diagonal[k] = base + az[2, k]
            else:
                _fill_varied(p, ghost, weights, i, j, row, diagonal)
            e, r, o = p[i, j], rate[i, j], out[i, j]
            for k in range(nz):
                w = (diagonal[k] + r[k]) * e[k] - row[k]
                o[k] = w
                total[k] += w * e[k]
        parts[i] = total.sum()


@_jit
def advance(begin: int, end: int, step: Any, x: Any, p: Any, r: Any, q: Any, parts: Any) -> None:
    """Do ``x += step p`` and ``r -= step q``; write ``r . r`` of each plane to ``parts``, (nx,)."""
    ny, nz = x.shape[1:]
    for i in range(begin, end):
        total = np.zeros(nz)
        for j in range(ny):
            solution, along, left, change = x[i, j], p[i, j], r[i, j], q[i, j]
            for k in range(nz):
                solution[k] += step * along[k]
                v = left[k] - step * change[k]
                left[k] = v
                total[k] += v * v
        parts[i] = total.sum()


@_jit
def products(begin: int, end: int, z: Any, r: Any, q: Any, parts: Any) -> None:
    """Write ``z . r`` and ``z . q`` of each plane to ``parts``, (2, nx)."""
    ny, nz = z.shape[1:]
    for i in range(begin, end):
        first, second = np.zeros(nz), np.zeros(nz)
        for j in range(ny):
            a, b, c = z[i, j], r[i, j], q[i, j]
            for k in range(nz):
                first[k] += a[k] * b[k]
                second[k] += a[k] * c[k]
        parts[0, i] = first.sum()
        parts[1, i] = second.sum()


@_jit
def load(
    begin: int,
    end: int,
    rate: Any,
    stiffness: float,
    residual: Any,
    size: float,
    single: Any,
    r: Any,
    x: Any,
    p: Any,
) -> None:
    """Write ``rate / stiffness`` to ``single`` and ``residual / size`` to ``r``; clear x and p.

    ``rate`` (1/s) and ``residual`` (mM/s) are float64.
    """
    ny, nz = r.shape[1:]
    for i in range(begin, end):
        for j in range(ny):
            old, new, left, right = rate[i, j], single[i, j], residual[i, j], r[i, j]
            for k in range(nz):
                new[k] = old[k] / stiffness
                right[k] = left[k] / size
        x[i] = _NONE
        p[i] = _NONE


@_jit
def step(begin: int, end: int, c: Any, correction: Any, share: float, out: Any) -> None:
    """Write ``c + share correction`` to ``out``; c and out are float64."""
    ny, nz = c.shape[1:]
    for i in range(begin, end):
        for j in range(ny):
            old, way, new = c[i, j], correction[i, j], out[i, j]
            for k in range(nz):
                new[k] = old[k] + share * way[k]


@_jit
def dot(begin: int, end: int, a: Any, b: Any, parts: Any) -> None:
    """Write ``a . b`` of each plane to ``parts``, (nx,); a is float64."""
    ny, nz = a.shape[1:]
    for i in range(begin, end):
        total = np.zeros(nz)
        for j in range(ny):
            u, v = a[i, j], b[i, j]
            for k in range(nz):
                total[k] += u[k] * v[k]
        parts[i] = total.sum()
