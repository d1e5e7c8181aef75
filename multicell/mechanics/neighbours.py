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
from typing import TYPE_CHECKING, final

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

if TYPE_CHECKING:
    from multicell.cells import FloatArray

IndexArray = NDArray[np.int32]
OffsetArray = NDArray[np.int64]

CHUNK = 2048
"""Cells in a chunk. Larger ones share fewer pairs, smaller ones feed more threads."""

_BINS_PER_CELL = 8
_SPARE_BINS = 4096
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
    run = rebuild_parallel if threads > 1 and n > chunk else rebuild
    crowded, first, second, start, inner_end, outer_end = run(position, radius, skin, chunk)
    if crowded:
        raise TooManyPairsError(f"more than {_limit(n)} pairs among {n} cells")
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


@njit(cache=True)
def _limit(n):
    """Return how many entries a list may have."""
    return 500 * n + 4_000_000


@njit(cache=True)
def _guess(n, chunk):
    """Return the room per chunk that a packed tissue needs."""
    room = np.empty(-(-n // chunk), np.int64)
    for c in range(room.size):
        room[c] = 9 * min(n, chunk) + 64
    return room


@njit(cache=True, error_model="numpy")
def _bins(position, width):
    """Sort the cells into bins at least as wide as the cutoff.

    Returns
    -------
    order : (n,)
        Cells in the order of their bins; bins of one row along x follow each other.
    rows, columns : (n,)
        Row (y and z) and place along x of the bin of each *cell*.
    bin_start
        Dense: the first entry of ``order`` in each bin, and the end. Sparse: see ``shape``.
    shape
        ``(nx, ny, nz)`` of a dense grid, or zeros where the bins are listed sparsely, with
        ``bin_start`` then holding the keys of the sorted cells.
    """
    n = position.shape[0]
    low, counts, total = np.empty(3), np.empty(3), 1.0
    for a in range(3):
        low[a], high = position[0, a], position[0, a]
        for i in range(n):
            low[a], high = min(low[a], position[i, a]), max(high, position[i, a])
        # math.floor makes an integer, which is undefined for what no integer holds
        counts[a] = np.floor((high - low[a]) / width) + 1.0
        total *= counts[a]
    shape = np.zeros(3, np.int64)
    if total <= _BINS_PER_CELL * n + _SPARE_BINS:
        for a in range(3):
            shape[a] = np.int64(counts[a])
        order, row, column, start = _dense_bins(position, low, width, shape)
    else:
        order, row, column, start = _sparse_bins(position, width)
    return order, row, column, start, shape


@njit(cache=True)
def _stable_order(values):
    """Return the places of ``values`` in ascending order, ties in their order (merge sort)."""
    n = values.size
    order, other = np.empty(n, np.int64), np.empty(n, np.int64)
    for place in range(n):
        order[place] = place
    width = 1
    while width < n:
        for begin in range(0, n, 2 * width):
            middle, end = min(begin + width, n), min(begin + 2 * width, n)
            left, right = begin, middle
            for place in range(begin, end):
                if left < middle and (right >= end or values[order[left]] <= values[order[right]]):
                    other[place] = order[left]
                    left += 1
                else:
                    other[place] = order[right]
                    right += 1
        order, other = other, order
        width *= 2
    return order


@njit(cache=True)
def _sparse_bins(position, width):
    """Bin far-flung cells by sorted coordinates; memory does not depend on the distances."""
    n = position.shape[0]
    index = np.empty((3, n), np.int64)
    coordinate = np.empty(n)
    for a in range(3):
        for i in range(n):
            coordinate[i] = position[i, a]
        _sweep(coordinate, _stable_order(coordinate), width, index[a])
    # a row key is below 9 n², so that neither key overflows for any n that fits in memory
    stride = np.int64(n + 2)
    row, column = np.empty(n, np.int64), np.empty(n, np.int64)
    for i in range(n):
        row[i], column[i] = index[2, i] * stride + index[1, i], index[0, i]
    # number the rows that are occupied, in the order of their keys
    table = np.empty(2 * n, np.int64)
    key = np.empty(n, np.int64)
    rank = -1
    for place in _stable_order(row):
        if rank < 0 or table[n + rank] != row[place]:
            rank += 1
            table[n + rank] = row[place]
        key[place] = rank * stride + column[place]
    order = _stable_order(key)
    for place in range(n):
        table[place] = key[order[place]]
    return order, row, column, table[: n + rank + 1]


@njit(cache=True)
def _sweep(coordinate, order, width, index):
    """Write the number of each cell's bin along one axis; close cells differ by at most one."""
    start = coordinate[order[0]]
    number = 0
    for place in order:
        # compared as a sum of halves, which cannot overflow
        if 0.5 * coordinate[place] > 0.5 * start + 0.5 * width:
            start = coordinate[place]
            number += 1
        index[place] = number


@njit(cache=True)
def _dense_bins(position, low, width, shape):
    """Sort by counting into a dense grid of bins."""
    n = position.shape[0]
    row = np.empty(n, np.int64)
    column = np.empty(n, np.int64)
    start = np.zeros(shape[0] * shape[1] * shape[2] + 1, np.int64)
    inverse = 1.0 / width
    for i in range(n):
        ix = min(np.int64((position[i, 0] - low[0]) * inverse), shape[0] - 1)
        iy = min(np.int64((position[i, 1] - low[1]) * inverse), shape[1] - 1)
        iz = min(np.int64((position[i, 2] - low[2]) * inverse), shape[2] - 1)
        column[i] = ix
        row[i] = iz * shape[1] + iy
        start[row[i] * shape[0] + ix + 1] += 1
    for b in range(start.size - 1):
        start[b + 1] += start[b]
    order = np.empty(n, np.int64)
    cursor = start[:-1].copy()
    for i in range(n):
        b = row[i] * shape[0] + column[i]
        order[cursor[b]] = i
        cursor[b] += 1
    return order, row, column, start


@njit(cache=True)
def _sorted_rows(position, radius, order):
    """Copy centre and radius in the order of the bins: the search reads them in a stream."""
    rows = np.empty((order.size, 4))
    for place in range(order.size):
        i = order[place]
        rows[place, 0] = position[i, 0]
        rows[place, 1] = position[i, 1]
        rows[place, 2] = position[i, 2]
        rows[place, 3] = radius[i]
    return rows


@njit(cache=True)
def _lower_bound(values, begin, end, key):
    """Return the first place in the sorted ``values[begin:end]`` not below ``key``."""
    while begin < end:
        middle = (begin + end) // 2
        if values[middle] < key:
            begin = middle + 1
        else:
            end = middle
    return begin


@njit(cache=True)
def _sparse_range(row, column, table, n, dy, dz):
    """Return where in the sorted order the three bins of a neighbouring row stand."""
    stride = np.int64(n + 2)
    wanted = row + dz * stride + dy
    place = _lower_bound(table, n, table.size, wanted)
    if place == table.size or table[place] != wanted:
        return 0, 0
    line = (place - n) * stride
    begin = _lower_bound(table, 0, n, line + max(column - 1, 0))
    return begin, _lower_bound(table, begin, n, line + min(column + 2, stride))


@njit(cache=True)
def _dense_range(iy, iz, column, bin_start, shape):
    """Return where in the sorted order the three bins of a row of the grid stand."""
    if iy < 0 or iy >= shape[1] or iz < 0 or iz >= shape[2]:
        return np.int64(0), np.int64(0)
    line = (iz * shape[1] + iy) * shape[0]
    high = bin_start[line + min(column + 1, shape[0] - 1) + 1]
    return bin_start[line + max(column - 1, 0)], high


@njit(cache=True)
def _collect(sorted_rows, low, high, a, skin, hits):
    """Write the places in ``low:high`` that are close to place ``a``; return how many.

    The write is unconditional and only the count depends on the test: one cell in six is
    close, which a branch would mispredict.
    """
    x, y, z = sorted_rows[a, 0], sorted_rows[a, 1], sorted_rows[a, 2]
    r = sorted_rows[a, 3] + skin
    count = 0
    for b in range(low, high):
        dx = sorted_rows[b, 0] - x
        dy = sorted_rows[b, 1] - y
        dz = sorted_rows[b, 2] - z
        reach = r + sorted_rows[b, 3]
        hits[count] = b
        count += np.int64(dx * dx + dy * dy + dz * dz <= reach * reach)
    return count


@njit(cache=True)
def _search_chunk(
    c, chunk, order, own, sorted_rows, rows, columns, bin_start, shape, skin,
    base, inner, outer, first, second, found_inner, found_outer, limit,
):  # fmt: skip
    """Find the pairs of one chunk; counts on when the room is used up, without writing."""
    n = order.size
    begin, end = c * chunk, min((c + 1) * chunk, n)
    inner_at, inner_stop = base[c], base[c] + inner[c]
    outer_at, outer_stop = inner_stop, inner_stop + outer[c]
    hits = np.empty(_BLOCK, np.int64)
    dense = shape[0] > 0
    for i in range(begin, end):
        a, row, column = own[i], rows[i], columns[i]
        iy, iz = (row % shape[1], row // shape[1]) if dense else (row, row)
        for neighbour in range(9):
            dy, dz = neighbour % 3 - 1, neighbour // 3 - 1
            if dense:
                low, high = _dense_range(iy + dy, iz + dz, column, bin_start, shape)
            else:
                low, high = _sparse_range(row, column, bin_start, n, dy, dz)
            for block in range(low, high, _BLOCK):
                close = _collect(sorted_rows, block, min(block + _BLOCK, high), a, skin, hits)
                for h in range(close):
                    j = order[hits[h]]
                    if begin <= j < end:
                        if inner_at < inner_stop:
                            first[inner_at] = i
                            second[inner_at] = j
                        inner_at += np.int64(j > i)
                    else:
                        if outer_at < outer_stop:
                            first[outer_at] = i
                            second[outer_at] = j
                        outer_at += 1
        if inner_at - base[c] + outer_at - inner_stop > limit:
            break
    found_inner[c] = inner_at - base[c]
    found_outer[c] = outer_at - inner_stop


@njit(cache=True)
def _search(
    chunk, order, sorted_rows, rows, columns, bin_start, shape, skin,
    base, inner, outer, first, second, found_inner, found_outer, limit,
):  # fmt: skip
    own = np.empty(order.size, np.int64)
    for place in range(order.size):
        own[order[place]] = place
    for c in range(found_inner.size):
        _search_chunk(
            c, chunk, order, own, sorted_rows, rows, columns, bin_start, shape, skin,
            base, inner, outer, first, second, found_inner, found_outer, limit,
        )  # fmt: skip


@njit(cache=True, parallel=True)
def _search_parallel(
    chunk, order, sorted_rows, rows, columns, bin_start, shape, skin,
    base, inner, outer, first, second, found_inner, found_outer, limit,
):  # fmt: skip
    own = np.empty(order.size, np.int64)
    for place in prange(order.size):
        own[order[place]] = place
    for c in prange(found_inner.size):
        _search_chunk(
            c, chunk, order, own, sorted_rows, rows, columns, bin_start, shape, skin,
            base, inner, outer, first, second, found_inner, found_outer, limit,
        )  # fmt: skip


@njit(cache=True)
def _room(inner, outer):
    """Return where each chunk's entries begin, and arrays for all of them."""
    base = np.zeros(inner.size + 1, np.int64)
    for c in range(inner.size):
        base[c + 1] = base[c] + inner[c] + outer[c]
    return base, np.empty(base[-1], np.int32), np.empty(base[-1], np.int32)


@njit(cache=True)
def _largest(values):
    most = values[0]
    for value in values:
        most = max(most, value)
    return most


@njit(cache=True)
def _count(found_inner, found_outer):
    """Return the number of entries that were found."""
    total = 0
    for c in range(found_inner.size):
        total += found_inner[c] + found_outer[c]
    return total


@njit(cache=True)
def _ranges(base, found_inner, found_outer):
    """Return where the pairs of each chunk begin and end."""
    start, inner_end = np.empty_like(found_inner), np.empty_like(found_inner)
    outer_end = np.empty_like(found_inner)
    for c in range(start.size):
        start[c], inner_end[c] = base[c], base[c] + found_inner[c]
        outer_end[c] = inner_end[c] + found_outer[c]
    return start, inner_end, outer_end


@njit(cache=True)
def _fits(inner, outer, found_inner, found_outer):
    """Return whether the room was enough, and make it so."""
    enough = True
    for c in range(inner.size):
        enough &= found_inner[c] <= inner[c] and found_outer[c] <= outer[c]
        inner[c] = max(inner[c], found_inner[c])
        outer[c] = max(outer[c], found_outer[c])
    return enough


@njit(cache=True)
def _close_gaps(first, second, base, inner, found_inner, found_outer):
    """Move the outer pairs of each chunk up: they were written behind the room for inner ones."""
    for c in range(found_inner.size):
        source = base[c] + inner[c]
        target = base[c] + found_inner[c]
        for k in range(found_outer[c]):
            first[target + k] = first[source + k]
            second[target + k] = second[source + k]


@njit(cache=True)
def rebuild(position, radius, skin, chunk):
    """Do the work of :func:`build` for one cell and more, for callers inside numba.

    Returns
    -------
    crowded : bool
        Whether there are too many pairs; the list is then of no use.
    first, second, start, inner_end, outer_end
        As in :class:`PairList`.
    """
    order, rows, columns, bin_start, shape = _bins(position, 2.0 * _largest(radius) + skin)
    sorted_rows = _sorted_rows(position, radius, order)
    inner, outer = _guess(order.size, chunk), _guess(order.size, chunk)
    limit = _limit(order.size)
    while True:
        base, first, second = _room(inner, outer)
        found_inner, found_outer = np.empty_like(inner), np.empty_like(inner)
        _search(
            chunk, order, sorted_rows, rows, columns, bin_start, shape, skin,
            base, inner, outer, first, second, found_inner, found_outer, limit,
        )  # fmt: skip
        crowded = _count(found_inner, found_outer) > limit
        if crowded or _fits(inner, outer, found_inner, found_outer):
            break
    if not crowded:
        _close_gaps(first, second, base, inner, found_inner, found_outer)
    start, inner_end, outer_end = _ranges(base, found_inner, found_outer)
    return crowded, first, second, start, inner_end, outer_end


@njit(cache=True)
def rebuild_parallel(position, radius, skin, chunk):
    """Do the same as :func:`rebuild`, with the chunks shared among threads."""
    order, rows, columns, bin_start, shape = _bins(position, 2.0 * _largest(radius) + skin)
    sorted_rows = _sorted_rows(position, radius, order)
    inner, outer = _guess(order.size, chunk), _guess(order.size, chunk)
    limit = _limit(order.size)
    while True:
        base, first, second = _room(inner, outer)
        found_inner, found_outer = np.empty_like(inner), np.empty_like(inner)
        _search_parallel(
            chunk, order, sorted_rows, rows, columns, bin_start, shape, skin,
            base, inner, outer, first, second, found_inner, found_outer, limit,
        )  # fmt: skip
        crowded = _count(found_inner, found_outer) > limit
        if crowded or _fits(inner, outer, found_inner, found_outer):
            break
    if not crowded:
        _close_gaps(first, second, base, inner, found_inner, found_outer)
    start, inner_end, outer_end = _ranges(base, found_inner, found_outer)
    return crowded, first, second, start, inner_end, outer_end
