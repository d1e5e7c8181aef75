"""Loops over the nodes of one level of the multigrid hierarchy, in single precision.

The operator A of a level is minus the Laplacian with the conditions on the faces, plus a rate, over
D/h² of the finest level. ``along`` holds the differences along the three axes: of each a (4, n)
table with the coefficients of the lower and of the upper neighbour, and what the node itself has by
its lower and by its upper face. Conditions and nodes of unequal width are in these tables, so that
the loops have no branches. Where the coefficient of diffusion differs from place to place,
``weights`` holds it at the faces, as in :mod:`multicell.nutrient.stencil`; else it is None, and
what it needs is not compiled. All arrays of nodes are (nx, ny, nz) float32.

Each loop runs over the planes from ``begin`` to ``end`` of what it writes, without the lock of
the interpreter, so that threads can share it (:class:`multicell.compiling.threads.Team`).
Products are summed plane by plane: the same bits for any number of threads.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from multicell.compiling import INLINED, KERNEL, typed

_jit = typed(**KERNEL, nogil=True)
# a call for each row would take as long as its work
_inline = typed(**INLINED, nogil=True)

_NONE = np.float32(0.0)
_ONE = np.float32(1.0)


@_inline
def _across(along: Any, i: int, j: int) -> Any:
    """Return the coefficient of the nodes (i, j, :) by their faces across the first two axes."""
    ax, ay, _az = along
    return (ax[2, i] + ax[3, i]) + (ay[2, j] + ay[3, j])


@_inline
def _neighbours(
    x: Any, at: Any, along: Any, weights: Any, i: int, j: int, row: Any, diagonal: Any
) -> Any:
    """Write the weighted sums of the six neighbours of the nodes (i, j, :) to ``row``, (nz,).

    Plane i of ``x`` and those beside it are the three that ``at`` says. The coefficients of the
    nodes themselves are what is returned plus ``diagonal``, (nz,), which is written where it is not
    the same for all rows.
    """
    ny, nz = x.shape[1:]
    ax, ay, az = along
    below, here, above = at
    a, b = x[below, j], x[above, j]
    c, d = x[here, max(j - 1, 0)], x[here, min(j + 1, ny - 1)]
    e, low, high = x[here, j], az[0], az[1]
    wa, wb, wc, wd = ax[0, i], ax[1, i], ay[0, j], ay[1, j]
    if weights is None:
        for k in range(1, nz - 1):
            across = (wa * a[k] + wb * b[k]) + (wc * c[k] + wd * d[k])
            row[k] = across + (low[k] * e[k - 1] + high[k] * e[k + 1])
        for k in (0, nz - 1):
            across = (wa * a[k] + wb * b[k]) + (wc * c[k] + wd * d[k])
            row[k] = across + (low[k] * e[max(k - 1, 0)] + high[k] * e[min(k + 1, nz - 1)])
        return _across(along, i, j)
    wx, wy, wz = weights
    for k in range(nz):
        la, lb, lc, ld = wx[i, j, k], wx[i + 1, j, k], wy[i, j, k], wy[i, j + 1, k]
        le, lf = wz[i, j, k], wz[i, j, k + 1]
        across = (wa * la * a[k] + wb * lb * b[k]) + (wc * lc * c[k] + wd * ld * d[k])
        ends = low[k] * le * e[max(k - 1, 0)] + high[k] * lf * e[min(k + 1, nz - 1)]
        row[k] = across + ends
        own = (ax[2, i] * la + ax[3, i] * lb) + (ay[2, j] * lc + ay[3, j] * ld)
        diagonal[k] = own + (az[2, k] * le + az[3, k] * lf)
    return _NONE


@_inline
def _beside(i: int, nx: int) -> Any:
    """Return the planes below, at and above plane i; at a face the plane itself."""
    return max(i - 1, 0), i, min(i + 1, nx - 1)


@_inline
def _ring(i: int, nx: int) -> Any:
    """Return the places of these planes among three that are kept by turns."""
    return max(i - 1, 0) % 3, i % 3, min(i + 1, nx - 1) % 3


@_inline
def _rows(along: Any) -> Any:
    """Return two rows to work in; the second holds the coefficients along the last axis."""
    table = along[2]
    row, diagonal = np.empty(table.shape[1], np.float32), np.empty(table.shape[1], np.float32)
    for k in range(row.size):
        diagonal[k] = table[2, k] + table[3, k]
    return row, diagonal


@_inline
def _sum(values: Any) -> float:
    """Return the sum of a row (NumPy's takes longer to compile)."""
    total = 0.0
    for k in range(values.size):
        total += values[k]
    return total


@_inline
def _relax(
    i: int,
    x: Any,
    b: Any,
    inverse: Any,
    along: Any,
    weights: Any,
    damping: Any,
    row: Any,
    diagonal: Any,
    out: Any,
) -> None:
    """Write plane i of ``x + damping (b - A x) / diagonal``, a damped Jacobi step, to ``out``.

    ``x`` are three planes by turns, see :func:`_ring`.
    """
    nx, ny, nz = b.shape
    at = _ring(i, nx)
    for j in range(ny):
        _neighbours(x, at, along, weights, i, j, row, diagonal)
        e, right, v, o = x[at[1], j], b[i, j], inverse[i, j], out[j]
        for k in range(nz):
            o[k] = e[k] + damping * ((right[k] + row[k]) * v[k] - e[k])


@_inline
def _pair(total: Any, share: Any, out: Any) -> None:
    """Write the weighted sums of neighbouring pairs, (n,), to ``out``, (ceil(n / 2),)."""
    n = total.size
    for k in range(n // 2):
        out[k] = share[2 * k] * total[2 * k] + share[2 * k + 1] * total[2 * k + 1]
    if n % 2 == 1:
        out[n // 2] = share[n - 1] * total[n - 1]


@_jit
def invert_diagonal(
    begin: int, end: int, rate: Any, along: Any, weights: Any, inverse: Any
) -> None:
    """Write one over the coefficients of the nodes themselves."""
    nx, ny, nz = rate.shape
    row, diagonal = _rows(along)
    for i in range(begin, end):
        for j in range(ny):
            if weights is None:
                base = _across(along, i, j)
            else:
                base = _neighbours(rate, _beside(i, nx), along, weights, i, j, row, diagonal)
            r, o = rate[i, j], inverse[i, j]
            for k in range(nz):
                o[k] = _ONE / (base + diagonal[k] + r[k])


@_jit
def down(
    begin: int,
    end: int,
    b: Any,
    rate: Any,
    inverse: Any,
    along: Any,
    weights: Any,
    damping: Any,
    shares: Any,
    x: Any,
    out: Any,
) -> None:
    """Take two damped Jacobi steps from zero to ``x``, and write to ``out`` what they leave.

    That is the mean of ``b - A x`` over the up to eight nodes in each node of the next level, of
    which the planes from ``begin`` to ``end`` are made. ``shares`` (n,) of each axis are the nodes'
    widths over that of the one they lie in. A step follows the one before at a distance of one
    plane, while that is in the nearest memory; those beside the own planes are made once more.
    """
    nx, ny, nz = b.shape
    sx, sy, sz = shares
    row, diagonal = _rows(along)
    start, stop = 2 * begin, min(2 * end, nx)
    once, twice = np.empty((3, ny, nz), np.float32), np.empty((3, ny, nz), np.float32)
    total = np.empty((out.shape[1], nz), np.float32)
    for front in range(max(start - 2, 0), stop + 2):
        if front < nx:
            for j in range(ny):
                right, v, o = b[front, j], inverse[front, j], once[front % 3, j]
                for k in range(nz):
                    o[k] = damping[0] * right[k] * v[k]
        i = front - 1
        if max(start - 1, 0) <= i < nx:
            made = twice[i % 3]
            _relax(i, once, b, inverse, along, weights, damping[1], row, diagonal, made)
            if start <= i < stop:
                for j in range(ny):
                    o, e = x[i, j], made[j]
                    for k in range(nz):
                        o[k] = e[k]
        i = front - 2
        if not start <= i < stop:
            continue
        at = _ring(i, nx)
        for j in range(ny):
            left = total[j // 2]
            if i % 2 == 0 and j % 2 == 0:
                for k in range(nz):
                    left[k] = _NONE
            base = _neighbours(twice, at, along, weights, i, j, row, diagonal)
            e, right, r, share = twice[at[1], j], b[i, j], rate[i, j], sx[i] * sy[j]
            for k in range(nz):
                left[k] += share * (right[k] + row[k] - (base + diagonal[k] + r[k]) * e[k])
        if i % 2 == 1 or i == nx - 1:
            for j in range(out.shape[1]):
                _pair(total[j], sz, out[i // 2, j])


@_jit
def average(begin: int, end: int, values: Any, shares: Any, out: Any) -> None:
    """Write the mean over the nodes in each node of the next level; see :func:`_restrict`."""
    nx, ny, nz = values.shape
    sx, sy, sz = shares
    for coarse in range(begin, end):
        total = np.empty(nz, np.float32)
        for across in range(out.shape[1]):
            for k in range(nz):
                total[k] = _NONE
            for i in range(2 * coarse, min(2 * coarse + 2, nx)):
                for j in range(2 * across, min(2 * across + 2, ny)):
                    share, v = sx[i] * sy[j], values[i, j]
                    for k in range(nz):
                        total[k] += share * v[k]
            _pair(total, sz, out[coarse, across])


@_inline
def _prolong(i: int, coarse: Any, others: Any, nearness: Any, row: Any, x: Any, out: Any) -> None:
    """Write plane i of ``x``, and of the interpolation between nodes of the next level, to ``out``.

    Node i of an axis lies in i // 2; the second one that it lies between is ``others[i]``, with
    the weight ``nearness[i]``.
    """
    ny, nz = out.shape
    ox, oy, oz = others
    wx, wy, wz = nearness
    n = coarse.shape[2]
    for j in range(ny):
        a, b = coarse[i // 2, j // 2], coarse[ox[i], j // 2]
        c, d = coarse[i // 2, oy[j]], coarse[ox[i], oy[j]]
        u, v = wx[i], wy[j]
        wa, wb, wc, wd = (_ONE - u) * (_ONE - v), u * (_ONE - v), (_ONE - u) * v, u * v
        for k in range(n):
            row[k] = (wa * a[k] + wb * b[k]) + (wc * c[k] + wd * d[k])
        e, o = x[i, j], out[j]
        inner = max(nz // 2 - 1, 1)
        for k in range(1, inner):
            m = 2 * k
            o[m] = e[m] + ((_ONE - wz[m]) * row[k] + wz[m] * row[k - 1])
            o[m + 1] = e[m + 1] + ((_ONE - wz[m + 1]) * row[k] + wz[m + 1] * row[k + 1])
        for k in range(min(2, nz)):
            o[k] = e[k] + ((_ONE - wz[k]) * row[k // 2] + wz[k] * row[oz[k]])
        for k in range(2 * inner, nz):
            o[k] = e[k] + ((_ONE - wz[k]) * row[k // 2] + wz[k] * row[oz[k]])


@_jit
def up(
    begin: int,
    end: int,
    coarse: Any,
    others: Any,
    nearness: Any,
    x: Any,
    b: Any,
    inverse: Any,
    along: Any,
    weights: Any,
    damping: Any,
    out: Any,
) -> None:
    """Add what the next level has found to ``x``, and write two damped Jacobi steps to ``out``.

    They follow each other as in :func:`down`.
    """
    nx, ny, nz = x.shape
    row, diagonal = _rows(along)
    between = np.empty(coarse.shape[2], np.float32)
    added, once = np.empty((3, ny, nz), np.float32), np.empty((3, ny, nz), np.float32)
    for front in range(max(begin - 2, 0), end + 2):
        if front < nx:
            _prolong(front, coarse, others, nearness, between, x, added[front % 3])
        for sweep in range(2):  # written once: it is what takes long to compile
            i, beside = front - 1 - sweep, 1 - sweep
            if max(begin - beside, 0) <= i < min(end + beside, nx):
                given, made = (added, once[i % 3]) if sweep == 0 else (once, out[i])
                _relax(i, given, b, inverse, along, weights, damping[sweep], row, diagonal, made)


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
def apply_planes(
    begin: int, end: int, p: Any, rate: Any, along: Any, weights: Any, out: Any, parts: Any
) -> None:
    """Write ``A p`` to ``out``, and its product with ``p`` in each plane to ``parts``, (nx,)."""
    ny, nz = p.shape[1:]
    row, diagonal = _rows(along)
    for i in range(begin, end):
        total = np.zeros(nz)
        for j in range(ny):
            base = _neighbours(p, _beside(i, len(p)), along, weights, i, j, row, diagonal)
            e, r, o = p[i, j], rate[i, j], out[i, j]
            for k in range(nz):
                w = (base + diagonal[k] + r[k]) * e[k] - row[k]
                o[k] = w
                total[k] += w * e[k]
        parts[i] = _sum(total)


@_jit
def update_residual_planes(
    begin: int, end: int, alpha: Any, x: Any, p: Any, r: Any, q: Any, parts: Any
) -> None:
    """Do ``x += alpha p``, ``r -= alpha q``; write ``r . r`` of each plane to ``parts``, (nx,)."""
    ny, nz = x.shape[1:]
    for i in range(begin, end):
        total = np.zeros(nz)
        for j in range(ny):
            solution, along, left, change = x[i, j], p[i, j], r[i, j], q[i, j]
            for k in range(nz):
                solution[k] += alpha * along[k]
                v = left[k] - alpha * change[k]
                left[k] = v
                total[k] += v * v
        parts[i] = _sum(total)


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
        parts[0, i] = _sum(first)
        parts[1, i] = _sum(second)


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

    ``rate`` is in 1/s, ``residual`` in mM/s.
    """
    ny, nz = r.shape[1:]
    for i in range(begin, end):
        for j in range(ny):
            old, new, left, right = rate[i, j], single[i, j], residual[i, j], r[i, j]
            solution, way = x[i, j], p[i, j]
            for k in range(nz):
                new[k] = old[k] / stiffness
                right[k] = left[k] / size
                solution[k] = _NONE
                way[k] = _NONE


@_jit
def add_correction(begin: int, end: int, c: Any, correction: Any, share: float, out: Any) -> None:
    """Write ``c + share correction`` to ``out``; c and out are float64."""
    ny, nz = c.shape[1:]
    for i in range(begin, end):
        for j in range(ny):
            old, way, new = c[i, j], correction[i, j], out[i, j]
            for k in range(nz):
                new[k] = old[k] + share * way[k]


@_jit
def dot_planes(begin: int, end: int, a: Any, b: Any, parts: Any) -> None:
    """Write ``a . b`` of each plane to ``parts``, (nx,)."""
    ny, nz = a.shape[1:]
    for i in range(begin, end):
        total = np.zeros(nz)
        for j in range(ny):
            u, v = a[i, j], b[i, j]
            for k in range(nz):
                total[k] += u[k] * v[k]
        parts[i] = _sum(total)
