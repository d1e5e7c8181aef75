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

from multicell.compiling import INLINED, INNER, KERNEL, typed
from multicell.nutrient.stencil import imbalance_of_planes

_jit = typed(**KERNEL, nogil=True)
# a call for each row would take as long as its work
_inline = typed(**INNER, forceinline=True, nogil=True)
# they count no references to what they are given, so that they must not return arrays to others
_bare = typed(**INLINED, nogil=True)

_NONE = np.float32(0.0)
_ONE = np.float32(1.0)


@_bare
def _across(along: Any, i: int, j: int) -> Any:
    """Return the coefficient of the nodes (i, j, :) by their faces across the first two axes."""
    ax, ay, _az = along
    return (ax[2, i] + ax[3, i]) + (ay[2, j] + ay[3, j])


@_inline
def _unit(along: Any) -> Any:
    """Return the coefficient of all neighbours, or zero where they have several."""
    unit = _NONE
    for axis in range(3):
        table = along[axis]
        for n in range(table.shape[1] - 1):
            unit = table[1, n] if unit == _NONE else unit
            if not unit == table[1, n] == table[0, n + 1]:
                return _NONE
    return unit


@_inline
def _rimmed(ny: int, nz: int) -> Any:
    """Return three planes that are kept by turns, with a rim of zeros, and a fourth one of zeros.

    So there are neighbours beyond the faces too, which add nothing.
    """
    return np.zeros((4, ny + 2, nz + 2), np.float32)


@_bare
def _rows_around(x: Any, i: int, nx: int, j: int) -> Any:
    """Return the rows beside the nodes (i, j, :), three times two of them, and their own.

    ``x`` are planes as :func:`_rimmed` makes them.
    """
    # unsigned numbers cannot count from the end of an array: no test for that
    below, here = np.uintp((i + 2) % 3 if i > 0 else 3), np.uintp(i % 3)
    above = np.uintp((i + 1) % 3 if i < nx - 1 else 3)
    before, own, after = np.uintp(j), np.uintp(j + 1), np.uintp(j + 2)
    a, b = x[below, own, 1:], x[above, own, 1:]
    c, d, row = x[here, before, 1:], x[here, after, 1:], x[here, own]
    return a, b, c, d, row, row[2:], row[1:]


@_bare
def _fill(along: Any, weights: Any, i: int, j: int, around: Any, row: Any, diagonal: Any) -> Any:
    """Write the weighted sums of the neighbours of the nodes (i, j, :) to ``row``, (nz,).

    The coefficients of the nodes themselves are what is returned plus ``diagonal``, (nz,), which is
    written where it is not the same for all rows.
    """
    ax, ay, az = along
    a, b, c, d, e, f, _ = around
    low, high = az[0], az[1]
    wa, wb, wc, wd = ax[0, i], ax[1, i], ay[0, j], ay[1, j]
    if weights is None:
        for k in range(row.size):
            across = (wa * a[k] + wb * b[k]) + (wc * c[k] + wd * d[k])
            row[k] = across + (low[k] * e[k] + high[k] * f[k])
        return _across(along, i, j)
    wx, wy, wz = weights
    for k in range(row.size):
        la, lb, lc, ld = wx[i, j, k], wx[i + 1, j, k], wy[i, j, k], wy[i, j + 1, k]
        le, lf = wz[i, j, k], wz[i, j, k + 1]
        across = (wa * la * a[k] + wb * lb * b[k]) + (wc * lc * c[k] + wd * ld * d[k])
        row[k] = across + (low[k] * le * e[k] + high[k] * lf * f[k])
        own = (ax[2, i] * la + ax[3, i] * lb) + (ay[2, j] * lc + ay[3, j] * ld)
        diagonal[k] = own + (az[2, k] * le + az[3, k] * lf)
    return _NONE


@_bare
def _near(around: Any, unit: Any, row: Any, k: int) -> Any:
    """Return the weighted sum of the neighbours of the node k of a row.

    It is in ``row``, or, where this is None, all have the coefficient ``unit``, a power of two.
    """
    if row is None:
        a, b, c, d, e, f, _ = around
        return unit * (((a[k] + b[k]) + (c[k] + d[k])) + (e[k] + f[k]))
    return row[k]


@_inline
def _rows(along: Any) -> Any:
    """Return two rows to work in; the second holds the coefficients along the last axis."""
    table = along[2]
    row, diagonal = np.empty(table.shape[1], np.float32), np.empty(table.shape[1], np.float32)
    for k in range(row.size):
        diagonal[k] = table[2, k] + table[3, k]
    return row, diagonal


@_bare
def _sum(values: Any) -> float:
    """Return the sum of a row (NumPy's takes longer to compile)."""
    total = 0.0
    for k in range(values.size):
        total += values[k]
    return total


@_bare
def _relax_row(around: Any, unit: Any, row: Any, b: Any, v: Any, damping: Any, out: Any) -> None:
    e = around[6]
    for k in range(b.size):
        near = _near(around, unit, row, k)
        out[k] = e[k] + damping * ((b[k] + near) * v[k] - e[k])


@_bare
def _relax(
    i: int, x: Any, b: Any, inverse: Any, level: Any, weights: Any, damping: Any, out: Any, rim: Any
) -> None:
    """Write plane i of ``x + damping (b - A x) / diagonal``, a damped Jacobi step, to ``out``.

    ``x`` are planes by turns, see :func:`_rimmed`, and ``out`` one that has a ``rim`` or none.
    """
    along, unit, row, diagonal = level
    nx, ny, _ = b.shape
    for j in range(ny):
        around, o = _rows_around(x, i, nx, j), out[np.uintp(j + rim), np.uintp(rim) :]
        right, v = b[np.uintp(i), np.uintp(j)], inverse[np.uintp(i), np.uintp(j)]
        if weights is None and unit != _NONE:
            _relax_row(around, unit, None, right, v, damping, o)
        else:
            _fill(along, weights, i, j, around, row, diagonal)
            _relax_row(around, unit, row, right, v, damping, o)


@_bare
def _leave_row(
    around: Any, unit: Any, row: Any, b: Any, rate: Any, own: Any, share: Any, out: Any, total: Any
) -> None:
    """Add a share of ``b - A x`` to ``out`` and its squares to ``total``."""
    base, diagonal = own
    e = around[6]
    for k in range(b.size):
        beside = b[k] + _near(around, unit, row, k)
        left = beside - (base + diagonal[k] + rate[k]) * e[k]
        out[k] += share * left
        total[k] += left * left


@_bare
def _leave(
    i: int, x: Any, b: Any, rate: Any, level: Any, weights: Any, shares: Any, out: Any, total: Any
) -> None:
    """Add plane i of ``b - A x``, by the nodes' shares, to rows of the next level."""
    along, unit, row, diagonal = level
    nx, ny, _ = b.shape
    for j in range(ny):
        left = out[np.uintp(j // 2)]
        if i % 2 == 0 and j % 2 == 0:
            _clear(left)
        around, share = _rows_around(x, i, nx, j), shares[0][i] * shares[1][j]
        right, r = b[np.uintp(i), np.uintp(j)], rate[np.uintp(i), np.uintp(j)]
        if weights is None and unit != _NONE:
            own = _across(along, i, j), diagonal
            _leave_row(around, unit, None, right, r, own, share, left, total)
        else:
            own = _fill(along, weights, i, j, around, row, diagonal), diagonal
            _leave_row(around, unit, row, right, r, own, share, left, total)


@_bare
def _clear(row: Any) -> None:
    for k in range(row.size):
        row[k] = _NONE


@_bare
def _apply_row(around: Any, unit: Any, row: Any, rate: Any, own: Any, out: Any, total: Any) -> None:
    """Write ``A x`` to ``out`` and add its products with x to ``total``."""
    base, diagonal = own
    e = around[6]
    for k in range(rate.size):
        w = (base + diagonal[k] + rate[k]) * e[k] - _near(around, unit, row, k)
        out[k] = w
        total[k] += w * e[k]


@_bare
def _apply(i: int, x: Any, rate: Any, level: Any, weights: Any, out: Any, total: Any) -> None:
    """Write plane i of ``A x`` to ``out``, and add its products with x to ``total``."""
    along, unit, row, diagonal = level
    nx, ny, _ = rate.shape
    for j in range(ny):
        around = _rows_around(x, i, nx, j)
        r, o = rate[np.uintp(i), np.uintp(j)], out[np.uintp(i), np.uintp(j)]
        if weights is None and unit != _NONE:
            _apply_row(around, unit, None, r, (_across(along, i, j), diagonal), o, total)
        else:
            own = _fill(along, weights, i, j, around, row, diagonal), diagonal
            _apply_row(around, unit, row, r, own, o, total)


@_bare
def _multiply(x: Any, b: Any, q: Any, first: Any, second: Any) -> None:
    """Add the products of nodes of a plane with those of two others to two rows."""
    ny, nz = x.shape
    for j in range(ny):
        e, r, o = x[np.uintp(j)], b[np.uintp(j)], q[np.uintp(j)]
        for k in range(nz):
            first[k] += e[k] * r[k]
        for k in range(nz):
            second[k] += e[k] * o[k]


@_bare
def _copy(x: Any, out: Any, inner: int, rim: int) -> None:
    """Copy a plane to another one; ``inner`` and ``rim`` are the widths of their rims."""
    ny, nz = x.shape[0] - 2 * inner, x.shape[1] - 2 * inner
    for j in range(ny):
        e, o = x[np.uintp(j + inner), np.uintp(inner) :], out[np.uintp(j + rim), np.uintp(rim) :]
        for k in range(nz):
            o[k] = e[k]


@_bare
def _combine(z: Any, beta: Any, p: Any, out: Any) -> None:
    """Write ``z + beta p`` of a plane to ``out``, which has a rim."""
    ny, nz = z.shape
    for j in range(ny):
        way, old, o = z[np.uintp(j)], p[np.uintp(j)], out[np.uintp(j + 1), 1:]
        for k in range(nz):
            o[k] = way[k] + beta * old[k]


@_bare
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
    ny, nz = rate.shape[1:]
    row, diagonal = _rows(along)
    wide = np.zeros(nz + 2, np.float32)
    for i in range(begin, end):
        for j in range(ny):
            r, o = rate[i, j], inverse[i, j]
            around = r, r, r, r, wide, r, r
            if weights is None:
                base = _across(along, i, j)
            else:
                base = _fill(along, weights, i, j, around, row, diagonal)
            for k in range(nz):
                o[k] = _ONE / (base + diagonal[k] + r[k])


@_jit
def restrict_left(
    begin: int,
    end: int,
    b: Any,
    x: Any,
    rate: Any,
    along: Any,
    weights: Any,
    shares: Any,
    out: Any,
    parts: Any,
) -> None:
    """Write the mean of ``b - A x`` over the up to eight nodes in each node of the next level.

    The planes from ``begin`` to ``end`` are those of that level, ``out``. ``shares`` (n,) of each
    axis are the nodes' widths over that of the one they lie in. The squares of each plane of this
    level go to ``parts``, (nx,).
    """
    nx, ny, nz = b.shape
    level = along, _unit(along), *_rows(along)
    start, stop = 2 * begin, min(2 * end, nx)
    planes = _rimmed(ny, nz)
    total = np.empty((out.shape[1], nz), np.float32)
    for front in range(max(start - 1, 0), stop + 1):
        if front < nx:
            _copy(x[front], planes[front % 3], 0, 1)
        i = front - 1
        if not start <= i < stop:
            continue
        squares = np.zeros(nz, np.float32)
        _leave(i, planes, b, rate, level, weights, shares, total, squares)
        parts[i] = _sum(squares)
        if i % 2 == 1 or i == nx - 1:
            for j in range(out.shape[1]):
                _pair(total[j], shares[2], out[i // 2, j])


@_jit
def average(begin: int, end: int, values: Any, shares: Any, out: Any) -> None:
    """Write the mean over the nodes in each node of the next level; see :func:`restrict_left`."""
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


@_bare
def _beside(i: int, n: int) -> int:
    """Return the second of ``n`` nodes of the next level that node i of an axis lies between.

    The first is i // 2. Beyond the ends it is that too, with no weight.
    """
    return min(max(i // 2 - 1 + 2 * (i % 2), 0), n - 1)


@_bare
def _prolong(i: int, coarse: Any, nearness: Any, row: Any, x: Any, out: Any) -> None:
    """Write plane i of the interpolation between nodes of the next level to ``out``, and add ``x``.

    ``nearness``, (2, n) of each axis, are the weights of the two nodes that a node lies between.
    ``out`` has a rim, and ``row`` a node of zero at both ends. ``x`` may have no planes.
    """
    ny, nz = out.shape[0] - 2, out.shape[1] - 2
    wx, wy, wz = nearness
    n, own, other = coarse.shape[2], wz[0], wz[1]
    lower, upper = coarse[i // 2], coarse[_beside(i, coarse.shape[0])]
    u, v = wx[0, i], wx[1, i]
    for j in range(ny):
        first, second = j // 2, _beside(j, coarse.shape[1])
        a, b, c, d = lower[first], upper[first], lower[second], upper[second]
        wa, wb, wc, wd = u * wy[0, j], v * wy[0, j], u * wy[1, j], v * wy[1, j]
        for k in range(n):
            row[k + 1] = (wa * a[k] + wb * b[k]) + (wc * c[k] + wd * d[k])
        o = out[j + 1, 1:]
        for k in range(nz // 2):
            m = 2 * k
            o[m] = own[m] * row[k + 1] + other[m] * row[k]
            o[m + 1] = own[m + 1] * row[k + 1] + other[m + 1] * row[k + 2]
        if nz % 2 == 1:
            o[nz - 1] = own[nz - 1] * row[n]
        if x.shape[0] > 0:
            e = x[i, j]
            for k in range(nz):
                o[k] += e[k]


@_jit
def up(
    begin: int,
    end: int,
    coarse: Any,
    nearness: Any,
    x: Any,
    b: Any,
    inverse: Any,
    along: Any,
    weights: Any,
    damping: Any,
    q: Any,
    out: Any,
    parts: Any,
) -> None:
    """Add what the next level has found to ``x``, and write damped Jacobi steps of that to ``out``.

    Without planes ``x`` is zero. A step follows the one before at a distance of one plane, while
    that is in the nearest memory; those beside the own planes are made once more. The products of
    each plane of ``out`` with ``b`` and with ``q`` go to ``parts``, (2, nx), if it has columns.
    """
    nx, ny, nz = b.shape
    level = along, _unit(along), *_rows(along)
    between = np.zeros(coarse.shape[2] + 2, np.float32)
    steps = len(damping)
    planes = np.zeros((steps, 4, ny + 2, nz + 2), np.float32)  # of each as of :func:`_rimmed`
    for front in range(max(begin - steps, 0), end + steps):
        if front < nx:
            _prolong(front, coarse, nearness, between, x, planes[0, front % 3])
        for step in range(steps):  # written once: it is what takes long to compile
            i, beside = front - 1 - step, steps - 1 - step
            if max(begin - beside, 0) <= i < min(end + beside, nx):
                made = planes[step + 1, i % 3] if beside > 0 else out[i]
                rim = min(beside, 1)
                _relax(i, planes[step], b, inverse, level, weights, damping[step], made, rim)
        i = front - steps
        if begin <= i < end and parts.shape[1] > 0:
            first, second = np.zeros(nz, np.float32), np.zeros(nz, np.float32)
            _multiply(out[i], b[i], q[i], first, second)
            parts[0, i], parts[1, i] = _sum(first), _sum(second)


@_jit
def apply_direction(
    begin: int,
    end: int,
    p: Any,
    z: Any,
    beta: Any,
    rate: Any,
    along: Any,
    weights: Any,
    new: Any,
    out: Any,
    parts: Any,
) -> None:
    """Write ``z + beta p`` to ``new``, and ``A`` of it to ``out``.

    Its product with ``new`` in each plane goes to ``parts``, (nx,).
    """
    nx, ny, nz = p.shape
    level = along, _unit(along), *_rows(along)
    planes = _rimmed(ny, nz)
    for front in range(max(begin - 1, 0), end + 1):
        if front < nx:
            _combine(z[front], beta, p[front], planes[front % 3])
        if begin <= front < end:
            _copy(planes[front % 3], new[front], 1, 0)
        i = front - 1
        if not begin <= i < end:
            continue
        total = np.zeros(nz, np.float32)
        _apply(i, planes, rate, level, weights, out, total)
        parts[i] = _sum(total)


@_jit
def update_residual_planes(
    begin: int, end: int, alpha: Any, x: Any, p: Any, r: Any, q: Any, parts: Any
) -> None:
    """Do ``x += alpha p``, ``r -= alpha q``; write ``r . r`` of each plane to ``parts``, (nx,)."""
    ny, nz = x.shape[1:]
    for i in range(begin, end):
        total = np.zeros(nz, np.float32)
        for j in range(ny):
            solution, along, left, change = x[i, j], p[i, j], r[i, j], q[i, j]
            for k in range(nz):
                solution[k] += alpha * along[k]
                v = left[k] - alpha * change[k]
                left[k] = v
                total[k] += v * v
        parts[i] = _sum(total)


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
) -> None:
    """Write ``rate / stiffness`` to ``single`` and ``residual / size`` to ``r``.

    ``rate`` is in 1/s, ``residual`` in mM/s.
    """
    ny, nz = r.shape[1:]
    for i in range(begin, end):
        for j in range(ny):
            old, new, left, right = rate[i, j], single[i, j], residual[i, j], r[i, j]
            for k in range(nz):
                new[k] = old[k] / stiffness
                right[k] = left[k] / size


@_jit
def move_planes(
    begin: int,
    end: int,
    c: Any,
    correction: Any,
    share: float,
    law: Any,
    there: Any,
    residual: Any,
    rate: Any,
    parts: Any,
) -> None:
    """Set ``there`` to ``c + share correction``, and write its imbalance.

    ``law`` and ``parts``, (5, nx), are those of :func:`.stencil.imbalance_of_planes`, which follows
    at a distance of one plane. One more plane on either side is moved: others write the same to it.
    """
    nx, ny, nz = c.shape
    moved = max(begin - 1, 0)
    for i in range(begin, end):
        for front in range(moved, min(i + 2, nx)):
            for j in range(ny):
                old, way, new = c[front, j], correction[front, j], there[front, j]
                for k in range(nz):
                    new[k] = old[k] + share * way[k]
        moved = min(i + 2, nx)
        imbalance_of_planes(i, i + 1, there, *law, residual, rate, parts, 1)


@_jit
def dot_planes(begin: int, end: int, a: Any, b: Any, parts: Any) -> None:
    """Write ``a . b`` of each plane to ``parts``, (nx,)."""
    ny, nz = a.shape[1:]
    for i in range(begin, end):
        total = np.zeros(nz, np.float32)
        for j in range(ny):
            u, v = a[i, j], b[i, j]
            for k in range(nz):
                total[k] += u[k] * v[k]
        parts[i] = _sum(total)
