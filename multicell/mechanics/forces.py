"""All jitted pair kernels: bare floats and arrays in base units (µm, s, nN), no objects.

One file, because numba's disk cache does not notice a change in another module. No fastmath:
with it, freshly compiled and cached code were seen to differ in the last bits.

Layout. ``rows`` holds for each cell ``x, y, z, radius, compliance`` (the last from
:func:`multicell.contact.law.compliance`), and ``receptor, ligand`` where cells have them, so that
a pair is gathered from two short runs of memory. Pairs come in chunks (see
:mod:`multicell.mechanics.neighbours`); a chunk works through its pairs in blocks of :data:`BLOCK`:
gather into small arrays, evaluate the law there (which the compiler turns into SIMD),
scatter. Every chunk writes to its own cells only, so that the serial and the parallel drivers
give the same bits.

Laws are chosen by the integer ``code`` of the classes in :mod:`multicell.contact.law`. With the
Hertz contact radius q = √(r_ij h) the approximate JKR force (eq. 3.6) is
F = E_ij h q - √(6πσ) q √(E_ij q), which needs three square roots and no power.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

BLOCK = 256
"""Pairs that are gathered before the law is evaluated on them."""

HERTZ, JKR, EXACT_JKR, LINEAR, CUBIC, GENERALISED_LINEAR = range(6)
_TINY = 1e-300
"""Keeps coincident centres finite: their direction, and so their force, is zero."""
NEARLY_SINGULAR = 1e7
"""Ratio of eigenvalues from which on cofactors of a block have no digits left."""
_RESOLVED = 1e-8
"""Least distance from exact JKR's turning point at which a slope is taken."""


class SlackData(NamedTuple):
    """Pairs whose law sees only the overlap beyond a slack; no entries where there are none.

    Each pair stands here twice, once for each of its cells: the entries of cell i are those
    from ``begin[i]`` to ``begin[i + 1]``, and ``other`` is the cell they join it to. The slack is
    ``value`` + ``rate`` x time, µm and µm/s, until it reaches zero. The rest is as in
    :class:`PairData`. The neighbour list knows nothing of slack and may be built anew.
    """

    begin: NDArray[np.int64]
    other: NDArray[np.int64]
    value: NDArray[np.float64]
    rate: NDArray[np.float64]
    sticky: NDArray[np.float64]
    unit: NDArray[np.float64]
    onset: NDArray[np.float64]


class CellData(NamedTuple):
    """What is known of the cells over a coupling step; times count from its beginning.

    ``reference`` are the positions that the list was built at, ``limit`` the squared drift
    that it allows. ``bonds`` is (n, 4) with receptor, ligand and their rates, ``push`` (n, 6)
    with an external force and its rate, nN and nN/s; both have no rows where absent.
    """

    chunk: int
    limit: float
    reference: NDArray[np.float64]
    radius: NDArray[np.float64]
    radius_rate: NDArray[np.float64]
    bonds: NDArray[np.float64]
    push: NDArray[np.float64]


class PairData(NamedTuple):
    """The neighbour list, and what a law keeps for each pair (no entries where absent).

    ``sticky`` is √(6πσ_ij), ``unit`` (2, m) exact JKR's unit of overlap and its rate, µm and
    µm/s, ``onset`` the overlap in that unit from which there is contact (-3 or 0).
    """

    first: NDArray[np.int32]
    second: NDArray[np.int32]
    start: NDArray[np.int64]
    inner_end: NDArray[np.int64]
    outer_end: NDArray[np.int64]
    sticky: NDArray[np.float64]
    unit: NDArray[np.float64]
    onset: NDArray[np.float64]


class LawData(NamedTuple):
    """Constants of the law: √(6πσ), smoothing length, spring constants, f_ad, 6πη."""

    code: int
    adhesion: float
    smoothing: float
    stiffness: float
    cutoff: float
    decay: float
    bond: float
    drag: float


class Block(NamedTuple):
    """Geometry and result of a block of pairs; ``force`` is F / distance."""

    dx: NDArray[np.float64]
    dy: NDArray[np.float64]
    dz: NDArray[np.float64]
    total: NDArray[np.float64]
    product: NDArray[np.float64]
    soft: NDArray[np.float64]
    sticky: NDArray[np.float64]
    extra: NDArray[np.float64]
    force: NDArray[np.float64]


@njit(cache=True, inline="always")
def _new_block():
    return Block(
        np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK),
        np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK),
    )  # fmt: skip


@njit(cache=True)
def _pack_chunk(c, cells, position, elapsed, rows):
    """Fill the rows of one chunk at a time ``elapsed``; return 1 if a cell has drifted.

    Drifted means further than √``limit`` from ``reference``, or not a number.
    """
    drifted = 0
    begin, end = c * cells.chunk, min((c + 1) * cells.chunk, rows.shape[0])
    for i in range(begin, end):
        x, y, z = position[i, 0], position[i, 1], position[i, 2]
        rows[i, 0] = x
        rows[i, 1] = y
        rows[i, 2] = z
        rows[i, 3] = cells.radius[i] + cells.radius_rate[i] * elapsed
        x -= cells.reference[i, 0]
        y -= cells.reference[i, 1]
        z -= cells.reference[i, 2]
        drifted |= not (x * x + y * y + z * z <= cells.limit)
    if cells.bonds.shape[0] > 0:
        for i in range(begin, end):
            rows[i, 5] = cells.bonds[i, 0] + cells.bonds[i, 2] * elapsed
            rows[i, 6] = cells.bonds[i, 1] + cells.bonds[i, 3] * elapsed
    return drifted


@njit(cache=True)
def _gather(rows, pairs, begin, count, block):
    """Collect the geometry of a block of pairs."""
    for p in range(count):
        i, j = np.uint32(pairs.first[begin + p]), np.uint32(pairs.second[begin + p])
        block.dx[p] = rows[j, 0] - rows[i, 0]
        block.dy[p] = rows[j, 1] - rows[i, 1]
        block.dz[p] = rows[j, 2] - rows[i, 2]
        block.total[p] = rows[i, 3] + rows[j, 3]
        block.product[p] = rows[i, 3] * rows[j, 3]
        block.soft[p] = rows[i, 4] + rows[j, 4]


@njit(cache=True, error_model="numpy")
def _force_hertz(count, block):
    for p in range(count):
        d = math.sqrt(block.dx[p] ** 2 + block.dy[p] ** 2 + block.dz[p] ** 2 + _TINY)
        h = max(block.total[p] - d, 0.0)
        # one division serves r_ij, E_ij and 1 / d
        w = 1.0 / (block.total[p] * block.soft[p] * d)
        q = math.sqrt(block.product[p] * (w * block.soft[p] * d) * h)
        block.force[p] = (w * block.total[p] * d) * h * q * (w * block.total[p] * block.soft[p])


@njit(cache=True, error_model="numpy")
def _force_jkr(adhesion, count, block):
    for p in range(count):
        d = math.sqrt(block.dx[p] ** 2 + block.dy[p] ** 2 + block.dz[p] ** 2 + _TINY)
        h = max(block.total[p] - d, 0.0)
        w = 1.0 / (block.total[p] * block.soft[p] * d)
        q = math.sqrt(block.product[p] * (w * block.soft[p] * d) * h)
        e = w * block.total[p] * d
        force = e * h * q - adhesion * q * math.sqrt(e * q)
        block.force[p] = force * (w * block.total[p] * block.soft[p])


@njit(cache=True, error_model="numpy")
def _force_jkr_of_pairs(bond, count, block):
    """JKR with an adhesion of each pair's own, and receptors (``extra``): π q² is the area."""
    for p in range(count):
        d = math.sqrt(block.dx[p] ** 2 + block.dy[p] ** 2 + block.dz[p] ** 2 + _TINY)
        h = max(block.total[p] - d, 0.0)
        w = 1.0 / (block.total[p] * block.soft[p] * d)
        q = math.sqrt(block.product[p] * (w * block.soft[p] * d) * h)
        e = w * block.total[p] * d
        force = e * h * q - block.sticky[p] * q * math.sqrt(e * q)
        force -= (0.5 * math.pi * bond) * q * q * block.extra[p]
        block.force[p] = force * (w * block.total[p] * block.soft[p])


@njit(cache=True, error_model="numpy")
def _force_smooth_jkr(count, smoothing, block):
    """JKR whose adhesion sets in linearly below the smoothing length."""
    inverse = 1.0 / smoothing
    for p in range(count):
        d = math.sqrt(block.dx[p] ** 2 + block.dy[p] ** 2 + block.dz[p] ** 2 + _TINY)
        h = max(block.total[p] - d, 0.0)
        w = 1.0 / (block.total[p] * block.soft[p] * d)
        r = block.product[p] * (w * block.soft[p] * d)
        q = math.sqrt(r * h)
        e = w * block.total[p] * d
        # below the smoothing length h^(3/4) there times (5 s - s²) / 4
        s = min(h * inverse, 1.0)
        onset = math.sqrt(r * max(h, smoothing))
        sticky = block.sticky[p] * onset * math.sqrt(e * onset) * (s * (5.0 - s) * 0.25)
        block.force[p] = (e * h * q - sticky) * (w * block.total[p] * block.soft[p])


@njit(cache=True, error_model="numpy")
def _force_exact(begin, count, pairs, elapsed, block):
    """Exact JKR on its stable branch, see :mod:`multicell.contact.exact_jkr` for the curve."""
    for p in range(count):
        block.extra[p] = pairs.unit[0, begin + p] + pairs.unit[1, begin + p] * elapsed
        block.soft[p] = pairs.onset[begin + p]
    for p in range(count):
        d = math.sqrt(block.dx[p] ** 2 + block.dy[p] ** 2 + block.dz[p] ** 2 + _TINY)
        w = 1.0 / (block.total[p] * block.extra[p] * d)
        x = (block.total[p] - d) * (w * block.total[p] * d)
        excess = max(x + 3.0, 0.0)
        q = math.sqrt(excess)
        r = math.sqrt(q)
        v = q * (r + 1.101) / (q + 2.101 * r + 2.696888)
        g = v * v * (6.0 + v * (4.0 + v)) - excess
        slope = v * (12.0 + v * (12.0 + 4.0 * v))
        bend = 12.0 + v * (24.0 + 12.0 * v)
        v -= 2.0 * g * slope / (2.0 * slope * slope - g * bend + _TINY)
        g = v * v * (6.0 + v * (4.0 + v)) - excess
        slope = v * (12.0 + v * (12.0 + 4.0 * v))
        bend = 12.0 + v * (24.0 + 12.0 * v)
        v -= 2.0 * g * slope / (2.0 * slope * slope - g * bend + _TINY)
        u = 1.0 + v
        cube = u * u * u
        # P = π w r / 6 with √(6πw) in ``sticky``
        scale = block.sticky[p] ** 2 * block.product[p] * (w * block.extra[p] * d) / 36.0
        force = scale * cube * (cube - 6.0) * (w * block.total[p] * block.extra[p])
        block.force[p] = force if x >= block.soft[p] else 0.0


@njit(cache=True, error_model="numpy")
def _force_linear(stiffness, cutoff, count, block):
    for p in range(count):
        d = math.sqrt(block.dx[p] ** 2 + block.dy[p] ** 2 + block.dz[p] ** 2 + _TINY)
        force = stiffness * (block.total[p] - d) / d
        block.force[p] = force if d < cutoff * block.total[p] else 0.0


@njit(cache=True, error_model="numpy")
def _force_cubic(stiffness, cutoff, count, block):
    reach = 1.0 / (cutoff - 1.0)
    for p in range(count):
        d = math.sqrt(block.dx[p] ** 2 + block.dy[p] ** 2 + block.dz[p] ** 2 + _TINY)
        h = block.total[p] - d
        w = 1.0 / (d * block.total[p])
        # zero beyond the cutoff, where the square would rise again
        near = max(1.0 + h * reach * (w * d), 0.0)
        block.force[p] = stiffness * h * near * near * (w * block.total[p])


@njit(cache=True, error_model="numpy")
def _force_generalised(stiffness, cutoff, decay, count, block):
    for p in range(count):
        d = math.sqrt(block.dx[p] ** 2 + block.dy[p] ** 2 + block.dz[p] ** 2 + _TINY)
        total = block.total[p]
        force = 0.0
        if d < total:
            force = -stiffness * total * math.log(d / total)
        elif d < cutoff * total:
            force = stiffness * (total - d) * math.exp(decay * (total - d) / total)
        block.force[p] = force / d


@njit(cache=True)
def _fill_bonds(rows, pairs, begin, count, block):
    """Collect rec_i lig_j + lig_i rec_j of a block of pairs (eq. 3.7), zero without receptors."""
    if rows.shape[1] == 5:
        for p in range(count):
            block.extra[p] = 0.0
        return
    for p in range(count):
        i, j = np.uint32(pairs.first[begin + p]), np.uint32(pairs.second[begin + p])
        block.extra[p] = rows[i, 5] * rows[j, 6] + rows[i, 6] * rows[j, 5]


@njit(cache=True, error_model="numpy")
def _add_bonds(bond, count, block):
    """Add differential adhesion, -A_ij f_ad ½ (rec_i lig_j + lig_i rec_j) (eq. 3.7)."""
    for p in range(count):
        d = math.sqrt(block.dx[p] ** 2 + block.dy[p] ** 2 + block.dz[p] ** 2 + _TINY)
        h = max(block.total[p] - d, 0.0)
        area = math.pi * block.product[p] * h / (block.total[p] * d)
        block.force[p] -= area * (0.5 * bond) * block.extra[p]


@njit(cache=True)
def _fill_sticky(pairs, law, begin, count, block):
    """Collect √(6πσ) of a block of pairs."""
    if pairs.sticky.size > 0:
        for p in range(count):
            block.sticky[p] = pairs.sticky[begin + p]
    else:
        for p in range(count):
            block.sticky[p] = law.adhesion


@njit(cache=True)
def _evaluate(rows, pairs, law, elapsed, begin, count, block):
    """Gather a block and write its forces over distances, for any law."""
    _gather(rows, pairs, begin, count, block)
    if law.code == JKR and law.smoothing == 0.0:
        _fill_sticky(pairs, law, begin, count, block)
        _fill_bonds(rows, pairs, begin, count, block)
        _force_jkr_of_pairs(law.bond, count, block)
        return
    if law.code == HERTZ:
        _force_hertz(count, block)
    elif law.code == LINEAR:
        _force_linear(law.stiffness, law.cutoff, count, block)
    elif law.code == CUBIC:
        _force_cubic(law.stiffness, law.cutoff, count, block)
    elif law.code == GENERALISED_LINEAR:
        _force_generalised(law.stiffness, law.cutoff, law.decay, count, block)
    else:
        _fill_sticky(pairs, law, begin, count, block)
        if law.code == EXACT_JKR:
            _force_exact(begin, count, pairs, elapsed, block)
        else:
            _force_smooth_jkr(count, law.smoothing, block)
    if rows.shape[1] > 5:
        _fill_bonds(rows, pairs, begin, count, block)
        _add_bonds(law.bond, count, block)


@njit(cache=True, inline="always")
def _scatter_inner(pairs, begin, count, block, out):
    """Add the forces of a block to both cells of each pair."""
    for p in range(count):
        i, j = np.uint32(pairs.first[begin + p]), np.uint32(pairs.second[begin + p])
        fx, fy, fz = (
            block.force[p] * block.dx[p],
            block.force[p] * block.dy[p],
            block.force[p] * block.dz[p],
        )
        out[i, 0] -= fx
        out[i, 1] -= fy
        out[i, 2] -= fz
        out[j, 0] += fx
        out[j, 1] += fy
        out[j, 2] += fz


@njit(cache=True, inline="always")
def _scatter_outer(pairs, begin, count, block, out):
    """Add the forces of a block to the first cell of each pair, which the chunk owns."""
    for p in range(count):
        i = np.uint32(pairs.first[begin + p])
        out[i, 0] -= block.force[p] * block.dx[p]
        out[i, 1] -= block.force[p] * block.dy[p]
        out[i, 2] -= block.force[p] * block.dz[p]


@njit(cache=True, error_model="numpy")
def _force_chunk_jkr(c, chunk, rows, pairs, law, elapsed, out):
    """Sum the forces on the cells of one chunk under plain JKR; the same loop as below, alone."""
    for i in range(c * chunk, min((c + 1) * chunk, rows.shape[0])):
        out[i, 0] = 0.0
        out[i, 1] = 0.0
        out[i, 2] = 0.0
    block = _new_block()
    for begin in range(pairs.start[c], pairs.inner_end[c], BLOCK):
        count = min(BLOCK, pairs.inner_end[c] - begin)
        _gather(rows, pairs, begin, count, block)
        _force_jkr(law.adhesion, count, block)
        _scatter_inner(pairs, begin, count, block, out)
    for begin in range(pairs.inner_end[c], pairs.outer_end[c], BLOCK):
        count = min(BLOCK, pairs.outer_end[c] - begin)
        _gather(rows, pairs, begin, count, block)
        _force_jkr(law.adhesion, count, block)
        _scatter_outer(pairs, begin, count, block, out)


@njit(cache=True, error_model="numpy")
def _force_chunk_pairs(c, chunk, rows, pairs, law, elapsed, out):
    """Sum the forces on the cells of one chunk under JKR with types or receptors."""
    for i in range(c * chunk, min((c + 1) * chunk, rows.shape[0])):
        out[i, 0] = 0.0
        out[i, 1] = 0.0
        out[i, 2] = 0.0
    block = _new_block()
    for begin in range(pairs.start[c], pairs.inner_end[c], BLOCK):
        count = min(BLOCK, pairs.inner_end[c] - begin)
        _gather(rows, pairs, begin, count, block)
        _fill_sticky(pairs, law, begin, count, block)
        _fill_bonds(rows, pairs, begin, count, block)
        _force_jkr_of_pairs(law.bond, count, block)
        _scatter_inner(pairs, begin, count, block, out)
    for begin in range(pairs.inner_end[c], pairs.outer_end[c], BLOCK):
        count = min(BLOCK, pairs.outer_end[c] - begin)
        _gather(rows, pairs, begin, count, block)
        _fill_sticky(pairs, law, begin, count, block)
        _fill_bonds(rows, pairs, begin, count, block)
        _force_jkr_of_pairs(law.bond, count, block)
        _scatter_outer(pairs, begin, count, block, out)


@njit(cache=True, error_model="numpy")
def _force_chunk_exact(c, chunk, rows, pairs, law, elapsed, out):
    """Sum the forces on the cells of one chunk under exact JKR without receptors."""
    for i in range(c * chunk, min((c + 1) * chunk, rows.shape[0])):
        out[i, 0] = 0.0
        out[i, 1] = 0.0
        out[i, 2] = 0.0
    block = _new_block()
    for begin in range(pairs.start[c], pairs.inner_end[c], BLOCK):
        count = min(BLOCK, pairs.inner_end[c] - begin)
        _gather(rows, pairs, begin, count, block)
        _fill_sticky(pairs, law, begin, count, block)
        _force_exact(begin, count, pairs, elapsed, block)
        _scatter_inner(pairs, begin, count, block, out)
    for begin in range(pairs.inner_end[c], pairs.outer_end[c], BLOCK):
        count = min(BLOCK, pairs.outer_end[c] - begin)
        _gather(rows, pairs, begin, count, block)
        _fill_sticky(pairs, law, begin, count, block)
        _force_exact(begin, count, pairs, elapsed, block)
        _scatter_outer(pairs, begin, count, block, out)


@njit(cache=True, error_model="numpy")
def _force_chunk_any(c, chunk, rows, pairs, law, elapsed, out):
    """Sum the forces on the cells of one chunk under any law."""
    for i in range(c * chunk, min((c + 1) * chunk, rows.shape[0])):
        out[i, 0] = 0.0
        out[i, 1] = 0.0
        out[i, 2] = 0.0
    block = _new_block()
    for begin in range(pairs.start[c], pairs.inner_end[c], BLOCK):
        count = min(BLOCK, pairs.inner_end[c] - begin)
        _evaluate(rows, pairs, law, elapsed, begin, count, block)
        _scatter_inner(pairs, begin, count, block, out)
    for begin in range(pairs.inner_end[c], pairs.outer_end[c], BLOCK):
        count = min(BLOCK, pairs.outer_end[c] - begin)
        _evaluate(rows, pairs, law, elapsed, begin, count, block)
        _scatter_outer(pairs, begin, count, block, out)


@njit(cache=True)
def _force_chunk(c, chunk, rows, pairs, law, elapsed, out):
    """Sum the pair forces on the cells of one chunk into ``out``, nN.

    The commonest laws have loops of their own: only where a law is inlined beside the making
    of the block does the compiler see that its arrays do not overlap (5 ns per cell). To
    inline all laws in one loop would make it slower, and its compilation ten times longer.
    """
    bare = rows.shape[1] == 5
    if law.code == JKR and law.smoothing == 0.0:
        if bare and pairs.sticky.size == 0:
            _force_chunk_jkr(c, chunk, rows, pairs, law, elapsed, out)
        else:
            _force_chunk_pairs(c, chunk, rows, pairs, law, elapsed, out)
    elif law.code == EXACT_JKR and bare:
        _force_chunk_exact(c, chunk, rows, pairs, law, elapsed, out)
    else:
        _force_chunk_any(c, chunk, rows, pairs, law, elapsed, out)


@njit(cache=True)
def _push_chunk(c, cells, rows, elapsed, out):
    """Add external forces to the cells of one chunk."""
    if cells.push.shape[0] > 0:
        for i in range(c * cells.chunk, min((c + 1) * cells.chunk, rows.shape[0])):
            out[i, 0] += cells.push[i, 0] + cells.push[i, 3] * elapsed
            out[i, 1] += cells.push[i, 1] + cells.push[i, 4] * elapsed
            out[i, 2] += cells.push[i, 2] + cells.push[i, 5] * elapsed


@njit(cache=True)
def _drag_chunk(c, chunk, rows, drag, out):
    """Turn forces into velocities: divide by ``drag`` times the radius (Stokes)."""
    for i in range(c * chunk, min((c + 1) * chunk, rows.shape[0])):
        mobility = 1.0 / (drag * rows[i, 3])
        out[i, 0] *= mobility
        out[i, 1] *= mobility
        out[i, 2] *= mobility


@njit(cache=True)
def pack(cells, position, elapsed, rows):
    """Fill ``rows`` for all cells; return whether any has drifted (see the chunk's)."""
    drifted = 0
    for c in range(-(-rows.shape[0] // cells.chunk)):
        drifted |= _pack_chunk(c, cells, position, elapsed, rows)
    return drifted > 0


@njit(cache=True)
def forces(cells, pairs, slack, law, position, elapsed, stokes, rows, out):
    """Write the forces on all cells, nN, or with ``stokes`` their velocities, µm/s.

    Stop and return True if a cell has drifted: the list is not valid there.
    """
    if pack(cells, position, elapsed, rows):
        return True
    for c in range(pairs.start.size):
        _force_chunk(c, cells.chunk, rows, pairs, law, elapsed, out)
        _push_chunk(c, cells, rows, elapsed, out)
        if stokes:
            _drag_chunk(c, cells.chunk, rows, law.drag, out)
    if slack.other.size > 0:
        _slacken(rows, slack, law, elapsed, stokes, out)
    return False


@njit(cache=True, parallel=True)
def forces_parallel(cells, pairs, slack, law, position, elapsed, stokes, rows, out):
    """Do the same as :func:`forces`, with the chunks shared among threads."""
    drifted = 0
    for c in prange(-(-rows.shape[0] // cells.chunk)):
        drifted += _pack_chunk(c, cells, position, elapsed, rows)
    if drifted > 0:
        return True
    for c in prange(pairs.start.size):
        _force_chunk(c, cells.chunk, rows, pairs, law, elapsed, out)
        _push_chunk(c, cells, rows, elapsed, out)
        if stokes:
            _drag_chunk(c, cells.chunk, rows, law.drag, out)
    if slack.other.size > 0:
        _slacken(rows, slack, law, elapsed, stokes, out)
    return False


@njit(cache=True)
def _turning(excess):
    """Return u - 1 on exact JKR's stable branch (a copy of ``laws.beyond_turning``)."""
    q = math.sqrt(excess)
    p = math.sqrt(q)
    v = q * (p + 1.101) / (q + 2.101 * p + 2.696888)
    for _ in range(2):
        g = v * v * (6.0 + v * (4.0 + v)) - excess
        slope = v * (12.0 + v * (12.0 + 4.0 * v))
        bend = 12.0 + v * (24.0 + 12.0 * v)
        v -= 2.0 * g * slope / (2.0 * slope * slope - g * bend + _TINY)
    return v


@njit(cache=True, error_model="numpy")
def _spring(law, d, total):
    """Return force, stiffness and energy of a spring law."""
    h = total - d
    reach = (law.cutoff - 1.0) * total
    if h <= -reach:
        return 0.0, 0.0, 0.0
    mu = law.stiffness
    if law.code == LINEAR:
        return mu * h, mu, 0.5 * mu * (h * h - reach * reach)
    if law.code == CUBIC:
        x = h / reach
        energy = mu * (h * h * (0.5 + x * (2.0 / 3.0 + 0.25 * x)) - reach * reach / 12.0)
        return mu * h * (1.0 + x) ** 2, mu * (1.0 + x) * (1.0 + 3.0 * x), energy
    far = -law.decay * reach / total
    energy = -mu * (total / law.decay) ** 2 * ((far - 1.0) * math.exp(far) + 1.0)
    if h < 0.0:
        x = law.decay * h / total
        fading = math.exp(x)
        energy += mu * (total / law.decay) ** 2 * ((x - 1.0) * fading + 1.0)
        return mu * h * fading, mu * (1.0 + x) * fading, energy
    gap = d / total
    energy += mu * total * total * (gap * math.log(gap) + 1.0 - gap)
    return -mu * total * math.log(gap), mu / gap, energy


@njit(cache=True, error_model="numpy")
def _jkr(law, h, e, r, sticky):
    """Return force, stiffness and energy of Hertz and approximate JKR for h > 0."""
    q = math.sqrt(r * h)
    elastic = e * h * q
    # each power rule brings its exponent over h
    force, stiffness, energy = elastic, 1.5 * elastic / h, 0.4 * elastic * h
    if law.code == HERTZ:
        return force, stiffness, energy
    hs = law.smoothing
    if h >= hs:
        part = sticky * q * math.sqrt(e * q)
        energy -= (4.0 / 7.0) * part * h
        if hs > 0.0:
            energy += (5.0 / 168.0) * sticky * math.sqrt(e * r * math.sqrt(r)) * hs**1.75
        return force - part, stiffness - 0.75 * part / h, energy
    onset = math.sqrt(r * hs)
    part = sticky * onset * math.sqrt(e * onset)
    s = h / hs
    return (
        force - part * s * (5.0 - s) * 0.25,
        stiffness - part * (5.0 - 2.0 * s) * 0.25 / hs,
        energy - part * hs * s * s * (5.0 / 8.0 - s / 12.0),
    )


@njit(cache=True, error_model="numpy")
def _exact(h, unit, onset, scale):
    """Return force, stiffness and energy of exact JKR."""
    x = h / unit
    if x < onset or x < -3.0:
        return 0.0, 0.0, 0.0
    v = _turning(x + 3.0)
    u = 1.0 + v
    cube = u * u * u
    w = max(v, _RESOLVED)
    rise = w * (3.0 + w * (3.0 + w))
    stiffness = 1.5 * scale / unit * (1.0 + w) ** 2 * (rise - 2.0) / rise
    energy = unit * scale * u * cube * (cube * (0.4 * cube - 4.0) + 6.0)
    return scale * cube * (cube - 6.0), stiffness, energy


@njit(cache=True, error_model="numpy")
def _between(rows, i, j, law, sticky, unit, onset, slack):
    """Return force, stiffness and energy of two cells, of whose overlap ``slack`` is not felt."""
    dx, dy, dz = rows[j, 0] - rows[i, 0], rows[j, 1] - rows[i, 1], rows[j, 2] - rows[i, 2]
    d = math.sqrt(dx * dx + dy * dy + dz * dz + _TINY) + slack
    total = rows[i, 3] + rows[j, 3]
    h = total - d
    r = rows[i, 3] * rows[j, 3] / total
    force, stiffness, energy = 0.0, 0.0, 0.0
    if law.code == EXACT_JKR:
        force, stiffness, energy = _exact(h, unit, onset, sticky * sticky * r / 36.0)
    elif law.code >= LINEAR:
        force, stiffness, energy = _spring(law, d, total)
    elif h > 0.0:
        force, stiffness, energy = _jkr(law, h, 1.0 / (rows[i, 4] + rows[j, 4]), r, sticky)
    if rows.shape[1] > 5 and h > 0.0:
        bonds = 0.5 * law.bond * (rows[i, 5] * rows[j, 6] + rows[i, 6] * rows[j, 5])
        slope = math.pi * r * bonds
        force -= slope * h
        stiffness -= slope
        energy -= 0.5 * slope * h * h
    return force, stiffness, energy


@njit(cache=True, error_model="numpy")
def _pair(rows, pairs, law, elapsed, p):
    """Return force, stiffness and energy of one pair, without slack."""
    sticky = pairs.sticky[p] if pairs.sticky.size > 0 else law.adhesion
    unit, onset = 1.0, 0.0
    if law.code == EXACT_JKR:
        unit = pairs.unit[0, p] + pairs.unit[1, p] * elapsed
        onset = pairs.onset[p]
    return _between(rows, pairs.first[p], pairs.second[p], law, sticky, unit, onset, 0.0)


@njit(cache=True, error_model="numpy")
def _slack_at(slack, e, elapsed):
    """Return the slack of an entry, µm: it ends where it reaches zero."""
    return max(slack.value[e] + slack.rate[e] * elapsed, 0.0)


@njit(cache=True, error_model="numpy")
def _slackened(rows, slack, law, elapsed, i, e, amount):
    """Return force, stiffness and energy of an entry of cell ``i`` at a slack of ``amount``."""
    unit = slack.unit[0, e] + slack.unit[1, e] * elapsed
    return _between(rows, i, slack.other[e], law, slack.sticky[e], unit, slack.onset[e], amount)


@njit(cache=True, error_model="numpy")
def _slacken(rows, slack, law, elapsed, stokes, out):
    """Replace the forces of the pairs with slack, or with ``stokes`` their part of velocities.

    The list has given them the force of their whole overlap. That is taken off again here: the
    loops over the list, which all other pairs share, need not look for pairs with slack.
    """
    for i in range(rows.shape[0]):
        for e in range(slack.begin[i], slack.begin[i + 1]):
            amount = _slack_at(slack, e, elapsed)
            if amount == 0.0:
                continue
            j = slack.other[e]
            dx, dy, dz = rows[j, 0] - rows[i, 0], rows[j, 1] - rows[i, 1], rows[j, 2] - rows[i, 2]
            whole, _, _ = _slackened(rows, slack, law, elapsed, i, e, 0.0)
            felt, _, _ = _slackened(rows, slack, law, elapsed, i, e, amount)
            change = (felt - whole) / math.sqrt(dx * dx + dy * dy + dz * dz + _TINY)
            if stokes:
                change *= 1.0 / (law.drag * rows[i, 3])
            out[i, 0] -= change * dx
            out[i, 1] -= change * dy
            out[i, 2] -= change * dz


@njit(cache=True, error_model="numpy")
def slack_energy(rows, slack, law, elapsed):
    """Return what slack adds to :func:`energy`, fJ; each pair stands in two entries."""
    total = 0.0
    for i in range(rows.shape[0]):
        for e in range(slack.begin[i], slack.begin[i + 1]):
            amount = _slack_at(slack, e, elapsed)
            if amount > 0.0:
                _, _, whole = _slackened(rows, slack, law, elapsed, i, e, 0.0)
                _, _, felt = _slackened(rows, slack, law, elapsed, i, e, amount)
                total += 0.5 * (felt - whole)
    return total


@njit(cache=True, error_model="numpy")
def add_slack_virials(rows, slack, law, elapsed, out):
    """Add what slack changes in :func:`half_virials`, nN µm."""
    for i in range(rows.shape[0]):
        for e in range(slack.begin[i], slack.begin[i + 1]):
            amount = _slack_at(slack, e, elapsed)
            if amount == 0.0:
                continue
            j = slack.other[e]
            dx, dy, dz = rows[j, 0] - rows[i, 0], rows[j, 1] - rows[i, 1], rows[j, 2] - rows[i, 2]
            whole, _, _ = _slackened(rows, slack, law, elapsed, i, e, 0.0)
            felt, _, _ = _slackened(rows, slack, law, elapsed, i, e, amount)
            out[i] += 0.5 * (felt - whole) * math.sqrt(dx * dx + dy * dy + dz * dz)


@njit(cache=True)
def slack_places(pairs, slack):
    """Return the places of the pairs with slack in the neighbour list, and their entries."""
    places = np.empty(slack.other.size, dtype=np.int64)
    entries = np.empty(slack.other.size, dtype=np.int64)
    count = 0
    for c in range(pairs.start.size):
        for p in range(pairs.start[c], pairs.outer_end[c]):
            i, j = pairs.first[p], pairs.second[p]
            for e in range(slack.begin[i], slack.begin[i + 1]):
                if slack.other[e] == j:
                    places[count] = p
                    entries[count] = e
                    count += 1
    return places[:count], entries[:count]


@njit(cache=True)
def slack_of_places(slack, entries, elapsed):
    """Return the slack at each of the places that :func:`slack_places` found, µm."""
    amounts = np.empty(entries.size)
    for k in range(entries.size):
        amounts[k] = _slack_at(slack, entries[k], elapsed)
    return amounts


@njit(cache=True, error_model="numpy")
def relinearise(rows, pairs, slack, law, elapsed, places, entries, along, across):
    """Write dF/dh + F/d and F/d of the pairs with slack over those of :func:`linearise`."""
    for k in range(places.size):
        p, e = places[k], entries[k]
        amount = _slack_at(slack, e, elapsed)
        if amount == 0.0:
            continue
        i, j = pairs.first[p], pairs.second[p]
        dx, dy, dz = rows[j, 0] - rows[i, 0], rows[j, 1] - rows[i, 1], rows[j, 2] - rows[i, 2]
        d = math.sqrt(dx * dx + dy * dy + dz * dz + _TINY)
        force, stiffness, _ = _slackened(rows, slack, law, elapsed, i, e, amount)
        across[p] = force / d
        along[p] = stiffness + force / d


@njit(cache=True)
def part_contacts(rows, pairs, slack, law, elapsed, places, entries, out):
    """Unmark the pairs of :func:`contacts` of whose overlap nothing is left beyond the slack."""
    for k in range(places.size):
        p, e = places[k], entries[k]
        i, j = pairs.first[p], pairs.second[p]
        dx, dy, dz = rows[j, 0] - rows[i, 0], rows[j, 1] - rows[i, 1], rows[j, 2] - rows[i, 2]
        h = rows[i, 3] + rows[j, 3] - math.sqrt(dx * dx + dy * dy + dz * dz)
        onset = 0.0
        if law.code == EXACT_JKR:
            onset = slack.onset[e] * (slack.unit[0, e] + slack.unit[1, e] * elapsed)
        out[p] &= h - _slack_at(slack, e, elapsed) >= onset


@njit(cache=True)
def energy(rows, pairs, law, elapsed):
    """Return the contact energy, fJ; an outer pair stands in two chunks, half in each."""
    total = 0.0
    for c in range(pairs.start.size):
        for p in range(pairs.start[c], pairs.outer_end[c]):
            _, _, part = _pair(rows, pairs, law, elapsed, p)
            total += part if p < pairs.inner_end[c] else 0.5 * part
    return total


@njit(cache=True, error_model="numpy")
def half_virials(rows, pairs, law, elapsed, out):
    """Write ½ Σ_j F_ij d_ij of each cell, nN µm."""
    out[:] = 0.0
    block = _new_block()
    for c in range(pairs.start.size):
        for begin in range(pairs.start[c], pairs.outer_end[c], BLOCK):
            count = min(BLOCK, pairs.outer_end[c] - begin)
            _evaluate(rows, pairs, law, elapsed, begin, count, block)
            for p in range(count):
                square = block.dx[p] ** 2 + block.dy[p] ** 2 + block.dz[p] ** 2
                virial = 0.5 * block.force[p] * square
                out[pairs.first[begin + p]] += virial
                if begin + p < pairs.inner_end[c]:
                    out[pairs.second[begin + p]] += virial


@njit(cache=True)
def contacts(rows, pairs, law, elapsed, out):
    """Mark the pairs in contact: overlap above zero, for exact JKR above the onset.

    Of an outer pair, which stands in two chunks, only the one with the smaller first cell.
    """
    out[:] = False
    for c in range(pairs.start.size):
        for p in range(pairs.start[c], pairs.outer_end[c]):
            i, j = pairs.first[p], pairs.second[p]
            if p >= pairs.inner_end[c] and j < i:
                continue
            dx, dy, dz = rows[j, 0] - rows[i, 0], rows[j, 1] - rows[i, 1], rows[j, 2] - rows[i, 2]
            h = rows[i, 3] + rows[j, 3] - math.sqrt(dx * dx + dy * dy + dz * dz)
            onset = 0.0
            if law.code == EXACT_JKR:
                onset = pairs.onset[p] * (pairs.unit[0, p] + pairs.unit[1, p] * elapsed)
            out[p] = h >= onset


@njit(cache=True, error_model="numpy")
def _slope_jkr(count, block):
    """Write F / d and dF/dh + F/d of Hertz and approximate JKR without smoothing.

    Each power rule brings its exponent over h; where there is no contact all is zero.
    """
    for p in range(count):
        d = math.sqrt(block.dx[p] ** 2 + block.dy[p] ** 2 + block.dz[p] ** 2 + _TINY)
        h = max(block.total[p] - d, 0.0)
        w = 1.0 / (block.total[p] * block.soft[p] * d)
        q = math.sqrt(block.product[p] * (w * block.soft[p] * d) * h)
        e = w * block.total[p] * d
        elastic = e * h * q
        part = block.sticky[p] * q * math.sqrt(e * q)
        force = (elastic - part) * (w * block.total[p] * block.soft[p])
        # the tiny number keeps 0 / 0 out: numerator and all are zero there
        stiffness = (1.5 * elastic - 0.75 * part) / (h + _TINY)
        block.force[p] = force
        block.extra[p] = stiffness + force


@njit(cache=True)
def _slope_any(rows, pairs, law, elapsed, begin, count, block):
    """Do the same as :func:`_slope_jkr` for any law, one pair after the other."""
    for p in range(count):
        d = math.sqrt(block.dx[p] ** 2 + block.dy[p] ** 2 + block.dz[p] ** 2 + _TINY)
        force, stiffness, _ = _pair(rows, pairs, law, elapsed, begin + p)
        block.force[p] = force / d
        block.extra[p] = stiffness + force / d


@njit(cache=True, error_model="numpy")
def _linearise_chunk(c, rows, pairs, law, elapsed, normal, along, across):
    """Store direction, dF/dh + F/d and F/d of the pairs of one chunk."""
    block = _new_block()
    plain = law.code <= JKR and law.smoothing == 0.0 and rows.shape[1] == 5
    for begin in range(pairs.start[c], pairs.outer_end[c], BLOCK):
        count = min(BLOCK, pairs.outer_end[c] - begin)
        _gather(rows, pairs, begin, count, block)
        if plain:
            _fill_sticky(pairs, law, begin, count, block)
            _slope_jkr(count, block)
        else:
            _slope_any(rows, pairs, law, elapsed, begin, count, block)
        for p in range(count):
            square = block.dx[p] ** 2 + block.dy[p] ** 2 + block.dz[p] ** 2
            inverse = 1.0 / math.sqrt(square + _TINY)
            normal[begin + p, 0] = block.dx[p] * inverse
            normal[begin + p, 1] = block.dy[p] * inverse
            normal[begin + p, 2] = block.dz[p] * inverse
            along[begin + p] = block.extra[p]
            across[begin + p] = block.force[p]


@njit(cache=True)
def linearise(rows, pairs, law, elapsed, normal, along, across):
    """Store what :func:`products` needs for all pairs, from the state in ``rows``.

    The stiffness of a pair is K = k n nᵀ - (F/d)(I - n nᵀ) with k = dF/dh. For a pair out
    of contact everything stored but the direction is zero.
    """
    for c in range(pairs.start.size):
        _linearise_chunk(c, rows, pairs, law, elapsed, normal, along, across)


@njit(cache=True, parallel=True)
def linearise_parallel(rows, pairs, law, elapsed, normal, along, across):
    """Do the same as :func:`linearise`, with the chunks shared among threads."""
    for c in prange(pairs.start.size):
        _linearise_chunk(c, rows, pairs, law, elapsed, normal, along, across)


@njit(cache=True)
def _product_chunk(c, chunk, rows, pairs, normal, along, across, drag, v, out):
    """Write (J v) for the cells of one chunk; forces instead of velocities if drag is zero."""
    low, high = c * chunk, min((c + 1) * chunk, rows.shape[0])
    out[low:high] = 0.0
    for p in range(pairs.start[c], pairs.outer_end[c]):
        i, j = np.uint32(pairs.first[p]), np.uint32(pairs.second[p])
        vx, vy, vz = v[j, 0] - v[i, 0], v[j, 1] - v[i, 1], v[j, 2] - v[i, 2]
        nx, ny, nz = normal[p, 0], normal[p, 1], normal[p, 2]
        stretch = along[p] * (nx * vx + ny * vy + nz * vz)
        fx = stretch * nx - across[p] * vx
        fy = stretch * ny - across[p] * vy
        fz = stretch * nz - across[p] * vz
        out[i, 0] += fx
        out[i, 1] += fy
        out[i, 2] += fz
        if p < pairs.inner_end[c]:
            out[j, 0] -= fx
            out[j, 1] -= fy
            out[j, 2] -= fz
    if drag > 0.0:
        _drag_chunk(c, chunk, rows, drag, out)


@njit(cache=True)
def products(chunk, rows, pairs, normal, along, across, drag, v, out):
    """Write J v, the directional derivative of the velocities along ``v``, 1/s times ``v``."""
    for c in range(pairs.start.size):
        _product_chunk(c, chunk, rows, pairs, normal, along, across, drag, v, out)


@njit(cache=True, parallel=True)
def products_parallel(chunk, rows, pairs, normal, along, across, drag, v, out):
    """Do the same as :func:`products`, with the chunks shared among threads."""
    for c in prange(pairs.start.size):
        _product_chunk(c, chunk, rows, pairs, normal, along, across, drag, v, out)


@njit(cache=True)
def diagonal_blocks(pairs, normal, along, across, out):
    """Write for each cell Σ_j max(k, 0) n nᵀ + max(-F/d, 0) (I - n nᵀ), nN/µm.

    The six entries are ``xx, yy, zz, xy, xz, yz``. Only the stable part of each pair's
    stiffness enters: the blocks are positive semidefinite, I + γ/Γ times a block can be
    inverted for every γ > 0, and twice their largest eigenvalue bounds the decay rates.
    """
    out[:] = 0.0
    for c in range(pairs.start.size):
        for p in range(pairs.start[c], pairs.outer_end[c]):
            t = max(-across[p], 0.0)
            k = max(along[p] - across[p], 0.0) - t
            nx, ny, nz = normal[p, 0], normal[p, 1], normal[p, 2]
            for side in range(2 if p < pairs.inner_end[c] else 1):
                i = pairs.first[p] if side == 0 else pairs.second[p]
                out[i, 0] += k * nx * nx + t
                out[i, 1] += k * ny * ny + t
                out[i, 2] += k * nz * nz + t
                out[i, 3] += k * nx * ny
                out[i, 4] += k * nx * nz
                out[i, 5] += k * ny * nz


@njit(cache=True)
def invert_by_pivots(a, b, c, f, g, h, least, out):
    """Write the inverse of a symmetric matrix whose eigenvalues are ``least`` or more.

    ``a, b, c`` stand on the diagonal, ``f, g, h`` at xy, xz, yz. By L D Lᵀ: cofactors lose all
    digits where a stiff contact stands beside a free direction. No pivot is below ``least``;
    where rounding says so, it is rounding.
    """
    one = 1.0 / max(a, least)
    p, q = f * one, g * one
    two = 1.0 / max(b - p * f, least)
    s = (h - p * g) * two
    three = 1.0 / max(c - q * g - s * (h - p * g), least)
    t = p * s - q
    out[0] = one + p * p * two + t * t * three
    out[1] = two + s * s * three
    out[2] = three
    out[3] = -p * two - t * s * three
    out[4] = t * three
    out[5] = -s * three


@njit(cache=True)
def invert_blocks(rows, blocks, gamma, drag, out):
    """Write the inverse of I + γ/Γ_i times each block, in the same six entries."""
    for i in range(rows.shape[0]):
        w = gamma / (drag * rows[i, 3])
        a, b, c = 1.0 + w * blocks[i, 0], 1.0 + w * blocks[i, 1], 1.0 + w * blocks[i, 2]
        f, g, h = w * blocks[i, 3], w * blocks[i, 4], w * blocks[i, 5]
        if max(a, b, c) > NEARLY_SINGULAR:
            invert_by_pivots(a, b, c, f, g, h, 1.0, out[i])
            continue
        xx, xy, xz = b * c - h * h, g * h - f * c, f * h - b * g
        scale = 1.0 / (a * xx + f * xy + g * xz)
        out[i, 0] = xx * scale
        out[i, 1] = (a * c - g * g) * scale
        out[i, 2] = (a * b - f * f) * scale
        out[i, 3] = xy * scale
        out[i, 4] = xz * scale
        out[i, 5] = (f * g - a * h) * scale


@njit(cache=True)
def apply_blocks(inverse, vector, out):
    """Write the product of each cell's symmetric 3 x 3 matrix with its part of ``vector``."""
    for i in range(inverse.shape[0]):
        x, y, z = vector[i, 0], vector[i, 1], vector[i, 2]
        out[i, 0] = inverse[i, 0] * x + inverse[i, 3] * y + inverse[i, 4] * z
        out[i, 1] = inverse[i, 3] * x + inverse[i, 1] * y + inverse[i, 5] * z
        out[i, 2] = inverse[i, 4] * x + inverse[i, 5] * y + inverse[i, 2] * z
