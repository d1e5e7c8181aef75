"""Which cells are close: spatial sort, cell list, and a Verlet list in chunks.

A :class:`PairList` holds every pair closer than ``r_i + r_j + skin``. The cells are cut, in
the order of their indices, into chunks (:data:`CHUNK` cells). A chunk owns its cells: pairs with
both cells inside stand once in it ("inner"), pairs that reach out of it ("outer") stand in
both chunks that they touch, each time with the owned cell first. So each chunk can sum the
forces on its own cells without looking at other chunks' sums, and the result has the same
bits whatever the number of threads.

Trial states of an implicit integrator are arbitrary. Any finite input is handled: where the
cells are so far apart that a dense grid would be larger than a few bins per cell, bins are
made from the sorted coordinates instead, and memory stays proportional to cells and pairs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, final

import numpy as np
from numba import njit, objmode, prange
from numba.extending import register_jitable
from numpy.typing import NDArray

from multicell.threads import two_drivers

if TYPE_CHECKING:
    from multicell.cells import FloatArray

IndexArray = NDArray[np.int32]
OffsetArray = NDArray[np.int64]

CHUNK = 2048
"""Cells in a chunk. Larger ones share fewer pairs, smaller ones feed more threads."""

_BINS_PER_CELL = 8
_SPARE_BINS = 4096
_SPARE_PAIRS = 4_000_000
_BLOCK = 512
"""Candidates that are tested in one go."""


class TooManyPairsError(Exception):
    """So many cells lie on top of each other that the list of pairs would not fit."""


@final
@dataclass(frozen=True)
class PairList:
    """All pairs of ``n`` cells that are closer than ``r_i + r_j + skin``.

    Attributes
    ----------
    first, second : (m,) int32
        Cells of a pair. Only the ranges named below hold pairs, the rest is spare room.
    start, inner_end, outer_end : (k,) int64
        For chunk ``c``, inner pairs are ``start[c]:inner_end[c]`` and outer pairs
        ``inner_end[c]:outer_end[c]``.
    chunk : int
        Cells in a chunk.
    n : int
        Number of cells.
    """

    first: IndexArray
    second: IndexArray
    start: OffsetArray
    inner_end: OffsetArray
    outer_end: OffsetArray
    chunk: int
    n: int

    def __len__(self) -> int:
        """Return the number of pairs, each counted once."""
        inner = int((self.inner_end - self.start).sum())
        return inner + int((self.outer_end - self.inner_end).sum()) // 2

    def pairs(self) -> IndexArray:
        """Return every pair once, (m, 2), smaller index first, in lexicographic order."""
        index = np.concatenate(
            [np.arange(a, b) for a, b in zip(self.start, self.outer_end, strict=True)]
            or [np.empty(0, dtype=np.int64)]
        ).astype(np.int64)
        both = np.sort(np.stack([self.first[index], self.second[index]], axis=1), axis=1)
        return np.unique(both, axis=0).reshape(-1, 2)


def neighbour_pairs(position: FloatArray, cutoff: float) -> IndexArray:
    """Return all pairs of points no further apart than ``cutoff``.

    Parameters
    ----------
    position : (n, 3)
        Any finite points, µm.
    cutoff
        Largest distance, µm.

    Returns
    -------
    (m, 2) int32
        Each pair once, smaller index first, in lexicographic order.

    Raises
    ------
    TooManyPairsError
        If the pairs would not fit into memory.
    """
    radius = np.full(len(position), 0.5 * cutoff)
    return build(np.ascontiguousarray(position, dtype=float), radius, 0.0).pairs()


def build(
    position: FloatArray, radius: FloatArray, skin: float, threads: int = 1, chunk: int = CHUNK
) -> PairList:
    """Build the list of all pairs closer than ``r_i + r_j + skin``.

    Parameters
    ----------
    position : (n, 3)
        Finite centres, µm.
    radius : (n,)
        Radii, µm.
    skin
        Added to the sum of the radii, µm.
    threads
        With more than one, chunks are searched in parallel (same result).
    chunk
        Cells in a chunk.

    Raises
    ------
    TooManyPairsError
        If there are more than 500 pairs per cell beyond the first four million.
    """
    n = len(position)
    if n < 2:
        empty = np.zeros(-(-n // chunk), dtype=np.int64)
        none = np.empty(0, dtype=np.int32)
        return PairList(none, none, empty, empty.copy(), empty.copy(), chunk, n)
    bins = _bins(position, radius, skin)
    # on one thread the few steps between the kernels run in Python: they are not compiled then
    run = _list_parallel if threads > 1 and n > chunk else _list
    crowded, first, second, start, inner_end, outer_end = run(bins, skin, chunk)
    if crowded:
        raise TooManyPairsError(f"more than {500 * n + _SPARE_PAIRS} pairs among {n} cells")
    return PairList(first, second, start, inner_end, outer_end, chunk, n)


def spatial_order(position: FloatArray, width: float) -> OffsetArray:
    """Return the order of the cells along a Morton curve.

    Parameters
    ----------
    position : (n, 3)
        Finite centres, µm.
    width
        Edge of the boxes that the curve visits, µm; widened where more than 2²¹ of them
        would be needed along an axis.

    Returns
    -------
    (n,) int64
        Cells that are close in space are close in this order; ties keep their order.
    """
    if len(position) == 0:
        return np.empty(0, dtype=np.int64)
    low = position.min(axis=0)
    # halves, because the extent itself may overflow
    extent = 2.0 * float((0.5 * position.max(axis=0) - 0.5 * low).max())
    width = max(width, min(extent, np.finfo(float).max) / 2.0**20)
    box = ((0.5 * position - 0.5 * low) * (2.0 / width)).astype(np.uint64)
    key = (
        _spread(box[:, 0]) | _spread(box[:, 1]) << np.uint64(1) | _spread(box[:, 2]) << np.uint64(2)
    )
    return np.argsort(key, kind="stable")


def _spread(value: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Put two zero bits between the 21 lowest bits (Morton code by magic masks)."""
    value = value & np.uint64(0x1FFFFF)
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        value = (value | (value << np.uint64(shift))) & np.uint64(mask)
    return value


class Bins(NamedTuple):
    """Cells sorted into bins at least as wide as the largest distance of a pair.

    Attributes
    ----------
    order : (n,) int64
        Cells in the order of their bins; bins of one row along x follow each other.
    place : (n,) int64
        Where each cell stands in that order.
    cells : (n, 4), µm
        Centres and radii in that order: the search reads them in a stream.
    shape : (3,) int64
        Bins of a dense grid along x, y and z; zeros where the bins are sparse.
    box : (n, 3) int32
        Dense: the place of each cell's bin along x, y and z.
    start : (bins + 2,) int64
        Dense: the first place of each bin, x running fastest, and the end.
    ranges : (n, 9, 2) int64
        Sparse: the first place and the end of the three bins next to each cell in each of the
        nine rows around it.
    """

    order: OffsetArray
    place: OffsetArray
    cells: FloatArray
    shape: OffsetArray
    box: IndexArray
    start: OffsetArray
    ranges: OffsetArray


@register_jitable
def _bins(position, radius, skin):
    """Return the cells in a dense grid where its memory is in proportion, else sparse bins."""
    bins, width = _dense_bins(position, radius, skin)
    return bins if bins.shape[0] > 0 else _sparse_bins(position, radius, width, bins)


@njit(cache=True, error_model="numpy")
def _dense_bins(position, radius, skin):
    """Sort by counting into a dense grid; return the bins and the width they need.

    ``shape`` is zero, and nothing else is filled, where the grid would have too many bins.
    """
    n = position.shape[0]
    largest = radius[0]
    for i in range(n):
        largest = max(largest, radius[i])
    width = 2.0 * largest + skin
    low, shape = np.empty(3), np.empty(3, np.int64)
    total = 1.0
    for a in range(3):
        low[a], high = position[0, a], position[0, a]
        for i in range(n):
            low[a], high = min(low[a], position[i, a]), max(high, position[i, a])
        # math.floor makes an integer, which is undefined for what no integer holds
        count = np.floor((high - low[a]) / width) + 1.0
        total *= count
        shape[a] = np.int64(count) if total <= _BINS_PER_CELL * n + _SPARE_BINS else 0
    bins = shape[0] * shape[1] * shape[2]
    if bins == 0:
        shape[0], n = 0, 0
    order, place, box = np.empty(n, np.int64), np.empty(n, np.int64), np.empty((n, 3), np.int32)
    cells, start = np.empty((n, 4)), np.empty(bins + 2, np.int64)
    for b in range(bins + 2):
        start[b] = 0
    inverse = 1.0 / width
    for i in range(n):
        ix = min(np.int64((position[i, 0] - low[0]) * inverse), shape[0] - 1)
        iy = min(np.int64((position[i, 1] - low[1]) * inverse), shape[1] - 1)
        iz = min(np.int64((position[i, 2] - low[2]) * inverse), shape[2] - 1)
        box[i, 0], box[i, 1], box[i, 2] = ix, iy, iz
        start[(iz * shape[1] + iy) * shape[0] + ix + 2] += 1
    for b in range(1, bins + 1):
        start[b + 1] += start[b]
    for i in range(n):
        # start[b + 1] runs through bin b, and ends as the first place of the next one
        b = (box[i, 2] * shape[1] + box[i, 1]) * shape[0] + box[i, 0]
        p = start[b + 1]
        start[b + 1] = p + 1
        order[p], place[i] = i, p
        for a in range(3):
            cells[p, a] = position[i, a]
        cells[p, 3] = radius[i]
    return Bins(order, place, cells, shape, box, start, np.empty((0, 9, 2), np.int64)), width


@njit(cache=True)
def _sparse_bins(position, radius, width, none):
    """Bin far-flung cells; the rest of ``none``, bins that were not filled, is kept.

    In Python also from compiled code: NumPy sorts as fast, and nothing has to be compiled for
    states that hardly ever come.
    """
    with objmode(
        order="int64[::1]", place="int64[::1]", cells="float64[:, ::1]", ranges="int64[:, :, ::1]"
    ):
        order, place, cells, ranges = _sorted_sparsely(position, radius, width)
    return Bins(order, place, cells, none.shape, none.box, none.start, ranges)


def _sorted_sparsely(
    position: FloatArray, radius: FloatArray, width: float
) -> tuple[OffsetArray, OffsetArray, FloatArray, OffsetArray]:
    """Return order, place, cells and ranges of sparse :class:`Bins`.

    Coordinates are sorted: memory does not depend on the distances.
    """
    n = len(position)
    x, y, z = (_intervals(np.ascontiguousarray(c), width) for c in position.T)
    # a row's key is below 9 n², so that it overflows for no n that fits into memory
    stride = n + 2
    row = z * stride + y
    occupied, rank = np.unique(row, return_inverse=True)
    key = rank * stride + x
    order = np.argsort(key, kind="stable")
    place, sorted_key = np.empty_like(order), key[order]
    place[order] = np.arange(n)
    ranges = np.zeros((n, 9, 2), dtype=np.int64)
    for neighbour in range(9):
        wanted = row + (neighbour // 3 - 1) * stride + neighbour % 3 - 1
        found = np.searchsorted(occupied, wanted)
        there = occupied[np.minimum(found, len(occupied) - 1)] == wanted
        line, column = found[there] * stride, x[there]
        ends = (line + np.maximum(column - 1, 0), line + np.minimum(column + 2, stride))
        ranges[there, neighbour] = np.searchsorted(sorted_key, ends).T
    return order, place, np.column_stack([position, radius])[order], ranges


def _intervals(coordinate: FloatArray, width: float) -> OffsetArray:
    """Return the number of each cell's bin along one axis; close cells differ by at most one."""
    number = np.empty(len(coordinate), dtype=np.int64)
    _sweep(coordinate, np.argsort(coordinate, kind="stable"), width, number)
    return number


@njit(cache=True)
def _sweep(coordinate, order, width, number):
    start = coordinate[order[0]]
    found = 0
    for i in order:
        # compared as a sum of halves, which cannot overflow
        if 0.5 * coordinate[i] > 0.5 * start + 0.5 * width:
            start = coordinate[i]
            found += 1
        number[i] = found


@njit(cache=True)
def _collect(cells, low, high, a, skin, hits):
    """Write the places in ``low:high`` that are close to place ``a``; return how many.

    The write is unconditional and only the count depends on the test: one cell in six is
    close, which a branch would mispredict.
    """
    x, y, z = cells[a, 0], cells[a, 1], cells[a, 2]
    r = cells[a, 3] + skin
    count = 0
    for b in range(low, high):
        dx = cells[b, 0] - x
        dy = cells[b, 1] - y
        dz = cells[b, 2] - z
        reach = r + cells[b, 3]
        hits[count] = b
        count += np.int64(dx * dx + dy * dy + dz * dz <= reach * reach)
    return count


@njit(cache=True, error_model="numpy")
def _search_chunk(c, chunk, bins, skin, base, room, limit, first, second, found):
    """Write the pairs of one chunk, and how many are inner and outer to ``found[c]``.

    Counts on without writing when the room is used up: (chunks, 2) places from ``base[c]`` on,
    those for inner pairs first. Where it is enough, the outer pairs are moved up behind the inner
    ones. The search ends when there are more than ``limit`` pairs.
    """
    n, nx, ny, nz = bins.order.size, bins.shape[0], bins.shape[1], bins.shape[2]
    begin, end = c * chunk, min((c + 1) * chunk, n)
    inner_at, inner_stop = base[c], base[c] + room[c, 0]
    outer_at, outer_stop = inner_stop, inner_stop + room[c, 1]
    hits = np.empty(_BLOCK, np.int64)
    x, y, z = np.int64(0), np.int64(0), np.int64(0)
    for i in range(begin, end):
        a = bins.place[i]
        if nx > 0:
            x, y, z = np.int64(bins.box[i, 0]), np.int64(bins.box[i, 1]), np.int64(bins.box[i, 2])
        for neighbour in range(9):
            v, w = y + neighbour % 3 - 1, z + neighbour // 3 - 1
            if nx == 0:
                low, high = bins.ranges[i, neighbour, 0], bins.ranges[i, neighbour, 1]
            elif 0 <= v < ny and 0 <= w < nz:
                line = (w * ny + v) * nx
                low = bins.start[line + max(x - 1, 0)]
                high = bins.start[line + min(x + 1, nx - 1) + 1]
            else:
                continue
            for block in range(low, high, _BLOCK):
                stop = min(block + _BLOCK, high)
                close = _collect(bins.cells, block, stop, a, skin, hits)
                for h in range(close):
                    j = bins.order[hits[h]]
                    if begin <= j < end:
                        if inner_at < inner_stop:
                            first[inner_at], second[inner_at] = i, j
                        inner_at += np.int64(j > i)
                    else:
                        if outer_at < outer_stop:
                            first[outer_at], second[outer_at] = i, j
                        outer_at += 1
        if inner_at - base[c] + outer_at - inner_stop > limit:
            break
    found[c, 0], found[c, 1] = inner_at - base[c], outer_at - inner_stop
    if inner_at <= inner_stop and outer_at <= outer_stop:
        for k in range(outer_at - inner_stop):
            first[inner_at + k] = first[inner_stop + k]
            second[inner_at + k] = second[inner_stop + k]


def _list(bins, skin, chunk):
    """Return the list of pairs of cells that were sorted into bins.

    Loops in place of array expressions: short as these are, they compile many times faster.

    Returns
    -------
    crowded : bool
        Whether there are too many pairs; the list is then of no use.
    first, second, start, inner_end, outer_end
        As in :class:`PairList`.
    """
    n = bins.order.size
    chunks = (n + chunk - 1) // chunk
    base, limit = np.empty(chunks + 1, np.int64), 500 * n + _SPARE_PAIRS
    room, found = np.empty((chunks, 2), np.int64), np.empty((chunks, 2), np.int64)
    for c in range(chunks):
        # what packed tissue needs
        room[c, 0] = room[c, 1] = 9 * min(n, chunk) + 64
    while True:
        base[0] = 0
        for c in range(chunks):
            base[c + 1] = base[c] + room[c, 0] + room[c, 1]
        first, second = np.empty(base[chunks], np.int32), np.empty(base[chunks], np.int32)
        for c in prange(chunks):
            _search_chunk(c, chunk, bins, skin, base, room, limit, first, second, found)
        total, enough = 0, True
        for c in range(chunks):
            for side in range(2):
                total += found[c, side]
                enough &= found[c, side] <= room[c, side]
                room[c, side] = max(room[c, side], found[c, side])
        if enough or total > limit:
            break
    start, inner_end = np.empty(chunks, np.int64), np.empty(chunks, np.int64)
    outer_end = np.empty(chunks, np.int64)
    for c in range(chunks):
        start[c], inner_end[c] = base[c], base[c] + found[c, 0]
        outer_end[c] = inner_end[c] + found[c, 1]
    return total > limit, first, second, start, inner_end, outer_end


_list_serial, _list_parallel = two_drivers(_list)


@njit(cache=True)
def rebuild(position, radius, skin, chunk):
    """Do the work of :func:`build` for one cell and more, for callers inside numba."""
    return _list_serial(_bins(position, radius, skin), skin, chunk)


@njit(cache=True)
def rebuild_parallel(position, radius, skin, chunk):
    """Do the same with the chunks shared among threads."""
    return _list_parallel(_bins(position, radius, skin), skin, chunk)
