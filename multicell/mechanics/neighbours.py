"""Neighbours of cells: cells in bins, and a Verlet list in chunks.

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

import math
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from multicell.cells import FloatArray
from multicell.compiling import INLINED, INNER, KERNEL
from multicell.compiling.threads import two_drivers
from multicell.vectors import corners

IndexArray = NDArray[np.int32]
OffsetArray = NDArray[np.int64]

CHUNK = 2048  # cells in a chunk. Larger ones share fewer pairs, smaller ones feed more threads.

_BINS_PER_CELL = 24  # most bins for each cell, and for few cells: scattered cells get wider ones
_SPARE_BINS = 4096  # 32 kB of counts
_SPARE_PAIRS = 4_000_000  # beyond 500 for each cell: more is no tissue, and fills the memory
_BLOCK = 512  # candidates that are tested in one go
_SLICES = 4  # bins along x for each along y and z


REPAIRED = 1000  # cells from which on lists are repaired, which takes seconds to compile
_USED = (0.25, 0.5)  # of the square of a margin: a repair gives new ones to cells beyond
FEW = 8  # a list is repaired where one cell in so many has drifted, or fewer
_FOUND = 64  # pairs of a cell that a repair has room for
_PART = 256  # cells whose pairs one thread looks for at a time

WIDEST = 8.0  # largest margin of a cell over the least
_FORESIGHT = 6.0  # how many times as far as since the last list a cell may move until the next one


class TooManyPairsError(Exception):
    """So many cells lie on top of each other that the list of pairs would not fit."""


@final
@dataclass(frozen=True)
class PairList:
    """All pairs of ``n`` cells that are closer than ``r_i + r_j + skin``.

    - ``first``, ``second``, (m,) int32: cells of a pair, which of the two comes first is left open
      but for outer pairs. Only the ranges named below hold pairs, the rest is spare room.
    - ``start``, ``inner_end``, ``outer_end``, (k,) int64: for chunk ``c``, inner pairs are
      ``start[c]:inner_end[c]`` and outer pairs ``inner_end[c]:outer_end[c]``
    - ``chunk``, int: cells in a chunk
    - ``n``, int: number of cells
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


def listed(pairs: PairList) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the cells of all places of a list; spare room stands for cell 0 twice."""
    used = np.zeros(len(pairs.first), dtype=np.bool_)
    for start, end in zip(pairs.start, pairs.outer_end, strict=True):
        used[start:end] = True
    first = np.where(used, pairs.first, 0).astype(np.int64)
    return first, np.where(used, pairs.second, 0).astype(np.int64)


def are_listed(
    pairs: IndexArray | OffsetArray | None,
    first: NDArray[np.int64],
    second: NDArray[np.int64],
    n: int,
) -> NDArray[np.bool_]:
    """Tell which pairs of the cells ``first`` and ``second`` are among ``pairs``, (m, 2)."""
    if pairs is None:
        return np.zeros(len(first), dtype=np.bool_)
    known = pairs[:, 0] * np.int64(n) + pairs[:, 1]
    return np.isin(np.minimum(first, second) * np.int64(n) + np.maximum(first, second), known)


def neighbour_pairs(position: FloatArray, cutoff: float) -> IndexArray:
    """Return all pairs of points (n, 3) no further apart than ``cutoff``, sorted, (m, 2)."""
    radius = np.full(len(position), 0.5 * cutoff)
    return build(np.ascontiguousarray(position, dtype=float), radius, 0.0).pairs()


def build(
    position: FloatArray,
    radius: FloatArray,
    skin: float,
    threads: int = 1,
    chunk: int = CHUNK,
    room: tuple[IndexArray, IndexArray] | None = None,
) -> PairList:
    """Build the list of all pairs closer than ``r_i + r_j + skin``.

    - ``chunk``: cells in a chunk
    - ``room``: ``first`` and ``second`` of a list that nobody needs any more, which may be taken
    """
    n = len(position)
    none = np.empty(0, dtype=np.int32)
    if n < 2:
        empty = np.zeros(-(-n // chunk), dtype=np.int64)
        return PairList(none, none, empty, empty.copy(), empty.copy(), chunk, n)
    run = rebuild_parallel if threads > 1 and n > chunk else rebuild
    crowded, first, second, start, inner_end, outer_end = run(
        position, radius, skin, chunk, *(room or (none, none))
    )
    if crowded:
        raise TooManyPairsError(f"more than {500 * n + _SPARE_PAIRS} pairs among {n} cells")
    return PairList(first, second, start, inner_end, outer_end, chunk, n)


class Bins(NamedTuple):
    """Cells sorted into bins; one row of bins along x follows the other.

    Dense bins are as wide in y and z as the largest distance of a pair, and a quarter of that in x:
    a cell then looks through one range of places in each of the rows next to it, and that range
    is as short as its own reach allows. Each pair is found from one of its cells, the one that
    comes first.

    - ``order``, (n,) int32: cells in the order of their bins
    - ``place``, (n,) int32: where each cell stands in that order
    - ``cells``, (n, 4), µm: centres and radii, half of the skin included, in that order: the search
      reads them in a stream
    - ``largest``, float, µm: the largest of these radii
    - ``low``, (3,), µm: dense: the corner of the grid
    - ``shape``, (3,) int64: dense: the number of bins along x, y and z; zeros where the bins are
      sparse
    - ``start``, (bins + 2,) int32: dense: the first place of each bin, x running fastest, and the
      end
    - ``ranges``, (n, 5, 2) int64: sparse: the first place and the end of the bins that may hold a
      cell's neighbours, in its own row, where only what comes later counts, and in the four rows
      that come later
    """

    order: IndexArray
    place: IndexArray
    cells: FloatArray
    largest: float
    low: FloatArray
    shape: OffsetArray
    start: IndexArray
    ranges: OffsetArray


@njit(**INNER)
def _extent(c, chunk, position, radius, extent):
    """Write the corners of the box round a chunk's centres, and its largest radius."""
    begin, end = np.uint64(c * chunk), np.uint64(min((c + 1) * chunk, radius.size))
    for a in range(3):
        low, high = position[begin, a], position[begin, a]
        for i in range(begin, end):
            low, high = min(low, position[i, a]), max(high, position[i, a])
        extent[c, a], extent[c, 3 + a] = low, high
    largest = radius[begin]
    for i in range(begin, end):
        largest = max(largest, radius[i])
    extent[c, 6] = largest


@njit(**INNER)
def _dense_grid(extent, skin, n):
    """Return the largest radius, the grid's corner, and its shape: zeros with too many bins."""
    low, high, shape = np.empty(3), np.empty(3), np.empty(3, np.int64)
    largest, total = extent[0, 6], 1.0
    for a in range(3):
        low[a], high[a] = extent[0, a], extent[0, 3 + a]
    for c in range(extent.shape[0]):
        largest = max(largest, extent[c, 6])
        for a in range(3):
            low[a], high[a] = min(low[a], extent[c, a]), max(high[a], extent[c, 3 + a])
    largest += 0.5 * skin
    for a in range(3):
        # math.floor makes an integer, which is undefined for what no integer holds
        count = np.floor((high[a] - low[a]) * (0.5 / largest) * (_SLICES if a == 0 else 1)) + 1.0
        total *= count
        shape[a] = np.int64(count) if total <= _BINS_PER_CELL * n + _SPARE_BINS else 0
    if shape[0] * shape[1] * shape[2] == 0:
        shape[0] = 0
    return largest, low, shape


@njit(**INLINED)
def _bin_along(x, axis, largest, low, shape):
    """Return the bin of a coordinate along an axis."""
    inverse = 0.5 / largest * (_SLICES if axis == 0 else 1)
    return min(np.int64((x - low[axis]) * inverse), shape[axis] - 1)


@njit(**INNER)
def _assign(c, chunk, position, largest, low, shape, bin_of):
    """Write the bins of a chunk's cells."""
    for i in range(np.uint64(c * chunk), np.uint64(min((c + 1) * chunk, bin_of.size))):
        ix = _bin_along(position[i, 0], 0, largest, low, shape)
        iy = _bin_along(position[i, 1], 1, largest, low, shape)
        iz = _bin_along(position[i, 2], 2, largest, low, shape)
        bin_of[i] = (iz * shape[1] + iy) * shape[0] + ix


@njit(**INNER)
def _sort(bin_of, shape):
    """Sort by counting; return where each bin begins, and where each cell stands.

    The only part that threads do not share.
    """
    bins, place = shape[0] * shape[1] * shape[2], np.empty(bin_of.size, np.int32)
    start = np.empty(bins + 2, np.int32)
    for b in range(bins + 2):
        start[b] = 0
    if bins == 0:
        return start, place
    for i in range(bin_of.size):
        start[np.uint32(bin_of[i] + 2)] += 1
    for b in range(1, bins + 1):
        start[b + 1] += start[b]
    for i in range(bin_of.size):
        # start[b + 1] runs through bin b, and ends as the first place of the next one
        b = np.uint32(bin_of[i] + 1)
        place[i] = start[b]
        start[b] += 1
    return start, place


@njit(**INNER)
def _line_up(c, chunk, position, radius, skin, place, order, cells):
    """Write a chunk's cells where they stand."""
    for i in range(np.uint64(c * chunk), np.uint64(min((c + 1) * chunk, radius.size))):
        p = np.uint32(place[i])
        order[p] = i
        for a in range(3):
            cells[p, a] = position[i, a]
        cells[p, 3] = radius[i] + 0.5 * skin


@njit(**INNER)
def _stable_order(key):
    """Return the order that sorts a key; equal ones keep theirs (merge sort, bottom up)."""
    n = key.size
    order, merged = np.empty(n, np.int32), np.empty(n, np.int32)
    for i in range(n):
        order[i] = i
    width = 1
    while width < n:
        for low in range(0, n, 2 * width):
            middle, high = min(low + width, n), min(low + 2 * width, n)
            a, b = low, middle
            for k in range(low, high):
                if a < middle and (b == high or key[order[a]] <= key[order[b]]):
                    merged[k] = order[a]
                    a += 1
                else:
                    merged[k] = order[b]
                    b += 1
        order, merged = merged, order
        width *= 2
    return order


@njit(**INNER)
def _first_not_below(key, count, wanted):
    """Return the first of ``count`` places of a sorted key whose value is not below ``wanted``."""
    low, high = 0, count
    while low < high:
        middle = (low + high) // 2
        if key[middle] < wanted:
            low = middle + 1
        else:
            high = middle
    return low


@njit(**INNER)
def _sparse_bins(position, radius, skin):
    """Bin far-flung cells by sorted coordinates; return what :class:`Bins` holds of them.

    Along each axis bins are numbered one after the other, and close cells differ by at most one:
    memory does not depend on the distances. Compiled with what calls it: an exception that Python
    raises within a loop of a method, such as for Ctrl-C, could not be carried out of it. All keys
    are whole numbers that a float holds exactly for less than 9e7 cells.
    """
    n = position.shape[0]
    width = 0.0
    for i in range(n):
        width = max(width, radius[i] + 0.5 * skin)
    width *= 2.0
    number, key, edge = np.empty((4, n)), np.empty(n), np.empty(n)
    order, stride, count = np.empty(0, np.int32), n + 2.0, 0
    # along x, y and z, rows along x, and places in rows: sorted by one call, which compiles once
    for sort in range(5):
        for i in range(n):
            if sort < 3:
                key[i] = position[i, sort]
            elif sort == 3:
                number[1, i] += number[2, i] * stride
                key[i] = number[1, i]
            else:
                key[i] = number[3, i] * stride + number[0, i]
        order = _stable_order(key)
        if sort == 4:
            break
        count, gap = 0, width if sort < 3 else 0.0
        for k in range(n):
            i = order[k]
            # compared as a sum of halves, which cannot overflow
            if count == 0 or 0.5 * key[i] > 0.5 * edge[count - 1] + 0.5 * gap:
                edge[count] = key[i]
                count += 1
            number[sort, i] = count - 1
    place, cells, line = np.empty(n, np.int32), np.empty((n, 4)), np.empty(n)
    for k in range(n):
        i = order[k]
        place[i], line[k] = k, key[i]
        for a in range(3):
            cells[k, a] = position[i, a]
        cells[k, 3] = radius[i] + 0.5 * skin
    ranges = np.zeros((n, 5, 2), np.int64)
    for i in range(n):
        x = number[0, i]
        for neighbour in range(5):
            wanted = number[1, i] + ((neighbour + 4) // 3 - 1) * stride + ((neighbour + 4) % 3 - 1)
            found = _first_not_below(edge, count, wanted)
            if found < count and edge[found] == wanted:
                begin = found * stride
                ranges[i, neighbour, 0] = _first_not_below(line, n, begin + max(x - 1.0, 0.0))
                ranges[i, neighbour, 1] = _first_not_below(line, n, begin + min(x + 2.0, stride))
        ranges[i, 0, 0] = place[i] + 1
    return order, place, cells, ranges


@njit(**INLINED)
def _row_of(bins, a):
    """Return the row of place ``a`` in a dense grid, its bins along y and z."""
    if bins.shape[0] == 0:
        return 0, 0
    iy = _bin_along(bins.cells[a, 1], 1, bins.largest, bins.low, bins.shape)
    return iy, _bin_along(bins.cells[a, 2], 2, bins.largest, bins.low, bins.shape)


@njit(**INLINED)
def _range(neighbour, line, start, slices, x, half, scale, place):
    """Return the range of places to look through in one row of a dense grid.

    ``line`` is the first of the row's bins, ``x ± half``, µm from the grid's end, what is looked
    for there. In a cell's own row only what comes later counts.
    """
    high = min(np.int64((x + half) * scale), slices - 1)
    end = np.int64(start[np.uint64(line + high + 1)])
    if neighbour == 0:
        return place + 1, end
    return np.int64(start[np.uint64(line + max(np.int64((x - half) * scale), 0))]), end


@njit(**INLINED)
def _collect(cells, begin, end, a, hits, count):
    """Append the places in ``begin:end`` that are close to place ``a``; return how many there are.

    The write is unconditional and only the count depends on the test: one cell in three is
    close, which a branch would mispredict.
    """
    x, y, z, r = cells[a, 0], cells[a, 1], cells[a, 2], cells[a, 3]
    for b in range(np.uint64(begin), np.uint64(end)):
        dx = cells[b, 0] - x
        dy = cells[b, 1] - y
        dz = cells[b, 2] - z
        reach = r + cells[b, 3]
        hits[np.uint64(count)] = b
        count += np.int64(dx * dx + dy * dy + dz * dz <= reach * reach)
    return count


@njit(**INNER)
def _note(i, own, order, hits, count, at, stop, first, second):
    """Write the pairs of cell i with its hits, inner and outer ones to their places ``at``.

    ``own`` are the first cell of the chunk and the end. Counts on without writing when the room
    up to ``stop`` is used up.
    """
    inner, outer = at[0], at[1]
    if inner + count < stop[0] and outer + count < stop[1]:
        p, q = np.uint64(inner), np.uint64(outer)
        for h in range(np.uint64(count)):
            j = order[np.uint64(hits[h])]
            out = np.uint64(j < own[0]) | np.uint64(j >= own[1])
            # both are written and one is kept: a branch would mispredict
            first[p], second[p] = i, j
            first[q], second[q] = i, j
            p, q = p + np.uint64(1) - out, q + out
        inner, outer = np.int64(p), np.int64(q)
    else:
        for h in range(count):
            j = order[hits[h]]
            out = j < own[0] or j >= own[1]
            place, end = (outer, stop[1]) if out else (inner, stop[0])
            if place < end:
                first[place], second[place] = i, j
            inner, outer = inner + np.int64(not out), outer + np.int64(out)
    at[0], at[1] = inner, outer


@njit(**INNER)
def _search_chunk(c, chunk, bins, base, room, limit, first, second, found):
    """Write the pairs that are found from one chunk's cells; count inner and outer to ``found[c]``.

    (chunks, 2) places from ``base[c]`` on are for them, those for inner pairs first. Where that is
    enough, the outer pairs are moved up behind the inner ones. The search ends when there are more
    than ``limit`` pairs.
    """
    own = (c * chunk, min((c + 1) * chunk, bins.order.size))
    at, stop = np.empty(2, np.int64), np.empty(2, np.int64)
    at[0], stop[0] = base[c], base[c] + room[c, 0]
    at[1], stop[1] = stop[0], stop[0] + room[c, 1]
    hits = np.empty(2 * _BLOCK, np.int32)
    cells, start, shape, low = bins.cells, bins.start, bins.shape, bins.low
    width, scale, dense = 2.0 * bins.largest, 0.5 * _SLICES / bins.largest, shape[0] > 0
    for i in range(np.uint64(own[0]), np.uint64(own[1])):
        # a typed zero: a bare one would have the functions below compiled twice
        a, count = np.int64(bins.place[i]), np.int64(0)
        reach = cells[a, 3] + bins.largest
        iy, iz = _row_of(bins, a)
        for neighbour in range(5):
            if dense:
                dy, dz = (neighbour + 4) % 3 - 1, (neighbour + 4) // 3 - 1
                v, w = iy + dy, iz + dz
                if v < 0 or v >= shape[1] or w >= shape[2]:
                    continue
                y, z = cells[a, 1] - low[1], cells[a, 2] - low[2]
                y = 0.0 if dy == 0 else y - (iy + max(dy, 0)) * width
                z = 0.0 if dz == 0 else z - w * width
                # wider by a millionth, so that rounding loses no pair
                rest = reach * reach * 1.000001 - y * y - z * z
                if rest <= 0.0:
                    continue
                begin, end = _range(
                    neighbour, (w * shape[1] + v) * shape[0], start, shape[0],
                    cells[a, 0] - low[0], math.sqrt(rest), scale, a,
                )  # fmt: skip
            else:
                begin, end = bins.ranges[i, neighbour, 0], bins.ranges[i, neighbour, 1]
            for block in range(begin, end, _BLOCK):
                if count > _BLOCK:
                    _note(i, own, bins.order, hits, count, at, stop, first, second)
                    count = np.int64(0)
                count = _collect(cells, block, min(block + _BLOCK, end), a, hits, count)
        _note(i, own, bins.order, hits, count, at, stop, first, second)
        if at[0] - base[c] + at[1] - stop[0] > limit:
            break
    found[c, 0], found[c, 1] = at[0] - base[c], at[1] - stop[0]
    if at[0] <= stop[0] and at[1] <= stop[1]:
        for k in range(found[c, 1]):
            first[at[0] + k] = first[stop[0] + k]
            second[at[0] + k] = second[stop[0] + k]


@njit(**INNER)
def _mirror(chunk, base, room, found, first, second, end):
    """Give the outer pairs to the chunks of their second cells, too, and write where lists end.

    Return whether there was room for them; where not, ``room`` is made larger.
    """
    chunks, enough = found.shape[0], True
    for c in range(chunks):
        end[c] = base[c] + found[c, 0] + found[c, 1]
    for c in range(chunks):
        own = base[c] + found[c, 0]
        for k in range(own, own + found[c, 1]):
            end[second[k] // chunk] += 1
    for c in range(chunks):
        if end[c] > base[c + 1]:
            room[c, 1] += end[c] - base[c + 1]
            enough = False
        end[c] = base[c] + found[c, 0] + found[c, 1]
    if not enough:
        return False
    for c in range(chunks):
        own = base[c] + found[c, 0]
        for k in range(own, own + found[c, 1]):
            d = second[k] // chunk
            first[end[d]], second[end[d]] = second[k], first[k]
            end[d] += 1
    return True


def _rebuild(position, radius, skin, chunk, first, second):
    """Do the work of :func:`build` for one cell and more.

    One function, and loops in place of array expressions: so it compiles many times faster.

    - ``first``, ``second``, (m,) int32: of a list that nobody needs any more, or empty: written to
      where they are long enough. With many cells the system takes longer to find new memory than
      the search to fill it.

    Returns crowded, bool: whether there are too many pairs; the list is then of no use; first,
    second, start, inner_end, outer_end: as in :class:`PairList`.
    """
    n = radius.size
    chunks = (n + chunk - 1) // chunk
    # these loops stand in repairs, too: one function for both would not be shared by threads
    extent, bin_of = np.empty((chunks, 7)), np.empty(n, np.int32)
    for c in prange(chunks):
        _extent(c, chunk, position, radius, extent)
    largest, low, shape = _dense_grid(extent, skin, n)
    dense = chunks if shape[0] > 0 else 0
    for c in prange(dense):
        _assign(c, chunk, position, largest, low, shape, bin_of)
    places, place = _sort(bin_of, shape)
    order, cells = np.empty(n, np.int32), np.empty((n, 4))
    for c in prange(dense):
        _line_up(c, chunk, position, radius, skin, place, order, cells)
    ranges = np.empty((0, 5, 2), np.int64)
    if shape[0] == 0:
        order, place, cells, ranges = _sparse_bins(position, radius, skin)
    bins = Bins(order, place, cells, largest, low, shape, places, ranges)
    base, limit = np.empty(chunks + 1, np.int64), 500 * n + _SPARE_PAIRS
    room, counts = np.empty((chunks, 2), np.int64), np.empty((chunks, 2), np.int64)
    start, inner_end = np.empty(chunks, np.int64), np.empty(chunks, np.int64)
    outer_end = np.empty(chunks, np.int64)
    for c in range(chunks):
        # what packed tissue needs
        room[c, 0] = room[c, 1] = 9 * min(n, chunk) + 64
    while True:
        base[0] = 0
        for c in range(chunks):
            base[c + 1] = base[c] + room[c, 0] + room[c, 1]
        if min(first.size, second.size) < base[chunks]:
            first, second = np.empty(base[chunks], np.int32), np.empty(base[chunks], np.int32)
        for c in prange(chunks):
            _search_chunk(c, chunk, bins, base, room, limit, first, second, counts)
        total, enough = 0, True
        for c in range(chunks):
            for side in range(2):
                total += counts[c, side]
                enough &= counts[c, side] <= room[c, side]
                room[c, side] = max(room[c, side], counts[c, side])
        if total > limit:
            break
        if enough and _mirror(chunk, base, room, counts, first, second, outer_end):
            break
    for c in range(chunks):
        start[c], inner_end[c] = base[c], base[c] + counts[c, 0]
    return total > limit, first, second, start, inner_end, outer_end


rebuild, rebuild_parallel = two_drivers(_rebuild)


@njit(**INLINED)
def _next_margin(square, least, margin):
    """Return a cell's margin after it has drifted by the root of ``square``, µm."""
    return max(least, min(max(_FORESIGHT * math.sqrt(square), 0.5 * margin), WIDEST * least))


@njit(**INNER)
def _sum_up(c, chunk, position, reference, sums):
    """Write sums over a chunk to ``sums[c]``: those of :func:`_together` beside the first cell."""
    for k in range(8):
        sums[c, k] = 0.0
    for i in range(c * chunk, min((c + 1) * chunk, position.shape[0])):
        for a in range(3):
            x, r = position[i, a] - reference[0, a], reference[i, a] - reference[0, a]
            sums[c, a] += x
            sums[c, 3 + a] += r
            sums[c, 6] += x * r
            sums[c, 7] += r * r


@njit(**INNER)
def _together(sums, reference):
    """Return how all cells move and spread together, x = s r + (x, y, z), by least squares.

    A list stays valid where its reference moves so: with s above one no pair comes closer, and
    below it is left out. Drifts are then those of a cell among the others.
    """
    total, n = np.zeros(8), reference.shape[0]
    for c in range(sums.shape[0]):
        for k in range(8):
            total[k] += sums[c, k]
    both, own = total[6], total[7]
    for a in range(3):
        both -= total[a] * total[3 + a] / n
        own -= total[3 + a] * total[3 + a] / n
    spread = max(both / own, 1.0) if own > 0.0 else 1.0
    for a in range(3):
        total[a] = (total[a] - spread * total[3 + a]) / n + (1.0 - spread) * reference[0, a]
    return spread, total[0], total[1], total[2]


@njit(**INNER)
def _mark(c, chunk, position, reference, way, margin, moved, counts):
    """Mark and count the cells of a chunk that have used up the parts :data:`_USED` of a margin.

    Two marks for references as they are, and two for such as go ``way``, that of all together.
    Where there was no list each cell has all marks.
    """
    spread, ahead = way[0], (way[1], way[2], way[3])
    few, fewer, few_along, fewer_along = 0, 0, 0, 0
    for i in range(np.uint64(c * chunk), np.uint64(min((c + 1) * chunk, margin.size))):
        rest, along = 0.0, 0.0
        for a in range(3):
            rest += (position[i, a] - reference[i, a]) ** 2
            along += (position[i, a] - spread * reference[i, a] - ahead[a]) ** 2
        near = _USED[0] * (margin[i] * margin[i])
        far = _USED[1] * (margin[i] * margin[i])
        marks = not rest <= near, not rest <= far, not along <= near, not along <= far
        moved[i] = marks[0] | marks[1] << 1 | marks[2] << 2 | marks[3] << 3
        few, fewer = few + marks[0], fewer + marks[1]
        few_along, fewer_along = few_along + marks[2], fewer_along + marks[3]
    counts[c, 0], counts[c, 1], counts[c, 2], counts[c, 3] = few, fewer, few_along, fewer_along


@njit(**INNER)
def _take_up(
    c, chunk, mark, way, position, reference, reach, least, margin, moved, base, cell, before, wide
):
    """Give the marked cells of a chunk new references and margins; let the others go ``way``.

    - ``base``, (chunks,) int64: number of such cells in earlier chunks
    - ``cell``, (k,) int32, and ``before``, (k, 4), µm: they, and what reference and margin were
    - ``wide``, (n,), µm: the radius with which the list is built, of all cells
    """
    k = base[c]
    for i in range(c * chunk, min((c + 1) * chunk, margin.size)):
        if mark > 1:
            for a in range(3):
                reference[i, a] = way[0] * reference[i, a] + way[1 + a]
        moved[i] = (moved[i] >> np.uint8(mark)) & np.uint8(1)
        if moved[i]:
            cell[k], before[k, 3], square = i, margin[i], 0.0
            for a in range(3):
                before[k, a] = reference[i, a]
                square += (position[i, a] - reference[i, a]) ** 2
                reference[i, a] = position[i, a]
            margin[i] = _next_margin(square, least, margin[i])
            k += 1
        wide[i] = reach[i] + margin[i]


@njit(**INNER)
def _pairs_of(part, cell, moved, bins, first, second):
    """Write all pairs of a part of some cells, those among them once; return how many there are.

    -1 without room: each of the cells has :data:`_FOUND` places.
    """
    cells, shape, low = bins.cells, bins.shape, bins.low
    begin, end = part * _PART, min((part + 1) * _PART, cell.size)
    at, hits = np.int64(_FOUND * begin), np.empty(_FOUND + 2 * _BLOCK, np.int32)
    width, scale = 2.0 * bins.largest, 0.5 * _SLICES / bins.largest
    for k in range(begin, end):
        i = np.int64(cell[k])
        a, count = np.int64(bins.place[i]), np.int64(0)
        reach = cells[a, 3] + bins.largest
        iy, iz = _row_of(bins, a)
        for neighbour in range(9):
            dy, dz = neighbour % 3 - 1, neighbour // 3 - 1
            v, w = iy + dy, iz + dz
            if v < 0 or v >= shape[1] or w < 0 or w >= shape[2]:
                continue
            y, z = cells[a, 1] - low[1], cells[a, 2] - low[2]
            y = 0.0 if dy == 0 else y - (iy + max(dy, 0)) * width
            z = 0.0 if dz == 0 else z - (iz + max(dz, 0)) * width
            rest = reach * reach * 1.000001 - y * y - z * z
            if rest <= 0.0:
                continue
            from_, to = _range(
                1, (w * shape[1] + v) * shape[0], bins.start, shape[0],
                cells[a, 0] - low[0], math.sqrt(rest), scale, a,
            )  # fmt: skip
            for block in range(from_, to, _BLOCK):
                count = _collect(cells, block, min(block + _BLOCK, to), a, hits, count)
                if count > _FOUND + _BLOCK:
                    return -1
        if at + count > _FOUND * end:
            return -1
        for h in range(np.uint64(count)):
            j = np.int64(bins.order[hits[h]])
            first[at], second[at] = i, j
            # a branch would mispredict
            at += np.int64((j != i) & ((moved[j] == 0) | (j > i)))
    return at - _FOUND * begin


@njit(**INNER)
def _leaving(c, moved, first, second, start, outer_end):
    """Return how many pairs of a chunk :func:`_keep` will take out."""
    count = 0
    for p in range(start[c], outer_end[c]):
        count += (moved[first[p]] | moved[second[p]]) != 0
    return count


@njit(**INNER)
def _keep(c, moved, first, second, start, inner_end, outer_end, extra, at):
    """Close the gaps that pairs of cells that have moved leave in a chunk's part of the list.

    Between inner and outer pairs ``extra[c, 0]`` places are left for new ones. Writes to ``at[c]``
    where these and new outer pairs go.
    """
    ends = (start[c], inner_end[c], outer_end[c])
    for side in range(2):
        # a branch would mispredict
        k = np.uint64(ends[side])
        for p in range(np.uint64(ends[side]), np.uint64(ends[side + 1])):
            i, j = first[p], second[p]
            first[k], second[k] = i, j
            k += np.uint64((moved[np.uint32(i)] | moved[np.uint32(j)]) == 0)
        at[c, side] = k
    begin, count, to = ends[1], at[c, 1] - ends[1], at[c, 0] + extra[c, 0]
    for k in range(count):
        p = k if to < begin else count - 1 - k
        first[to + p], second[to + p] = first[begin + p], second[begin + p]
    at[c, 1] = to + count


def _repair(
    position, reference, reach, margin, least, chunk, first, second, start, inner_end, outer_end
):
    """Bring a list up to date where few cells have drifted; return whether, and its new ends.

    Only cells that have used up most of their margin are looked at, after :func:`_together`: their
    pairs are taken out of the list and found anew, and they get new margins as in :func:`widened`.
    The list then holds what one built at ``reference`` would, and perhaps pairs that have moved
    apart since. It is for a new list to be built, and of margins and list nothing is changed, where
    too many have drifted, where they are too far apart for a dense grid, or without room.

    - ``position``, (n, 3), µm: now
    - ``reference``, (n, 3), µm, ``margin``, (n,), µm, and the list: changed in place
    - the rest as in :func:`widened` and :class:`PairList`
    """
    chunks, moved = start.size, np.empty(margin.size, np.uint8)
    counts, sums = np.empty((chunks, 4), np.int64), np.empty((chunks, 8))
    for c in prange(chunks):
        _sum_up(c, chunk, position, reference, sums)
    way = _together(sums, reference)
    for c in prange(chunks):
        _mark(c, chunk, position, reference, way, margin, moved, counts)
    # those who will soon have drifted too far are repaired ahead where they are few
    total, mark = margin.size, 0
    for nearness in range(2):
        for k in (nearness, 2 + nearness):
            count = 0
            for c in range(chunks):
                count += counts[c, k]
            if count < total:
                total, mark = count, k
        if total * FEW <= margin.size:
            break
    if total * FEW > margin.size:
        return False, inner_end, outer_end
    base, count = np.empty(chunks, np.int64), 0
    for c in range(chunks):
        base[c] = count
        count += counts[c, mark]
    cell, before, wide = np.empty(total, np.int32), np.empty((total, 4)), np.empty(margin.size)
    for c in prange(chunks):
        _take_up(
            c, chunk, mark, way, position, reference, reach, least, margin, moved, base, cell,
            before, wide,
        )  # fmt: skip
    extent, bin_of = np.empty((chunks, 7)), np.empty(margin.size, np.int32)
    for c in prange(chunks):
        _extent(c, chunk, reference, wide, extent)
    largest, low, shape = _dense_grid(extent, 0.0, margin.size)
    dense = chunks if shape[0] > 0 else 0
    for c in prange(dense):
        _assign(c, chunk, reference, largest, low, shape, bin_of)
    places, place = _sort(bin_of, shape)
    order, cells = np.empty(margin.size, np.int32), np.empty((margin.size, 4))
    for c in prange(dense):
        _line_up(c, chunk, reference, wide, 0.0, place, order, cells)
    bins = Bins(order, place, cells, largest, low, shape, places, np.empty((0, 5, 2), np.int64))
    parts = (total + _PART - 1) // _PART if bins.shape[0] > 0 else 0
    new_first = np.empty(_FOUND * total, np.int32)
    new_second = np.empty(_FOUND * total, np.int32)
    new = np.empty(parts, np.int64)
    for q in prange(parts):
        new[q] = _pairs_of(q, cell, moved, bins, new_first, new_second)
    extra, at = np.zeros((chunks, 2), np.int64), np.empty((chunks, 2), np.int64)
    enough = bins.shape[0] > 0
    for part in range(parts):
        enough &= new[part] >= 0
        for p in range(_FOUND * _PART * part, _FOUND * _PART * part + new[part]):
            c, d = new_first[p] // chunk, new_second[p] // chunk
            extra[c, np.int64(c != d)] += 1
            extra[d, 1] += np.int64(c != d)
    for c in range(chunks):
        room = start[c + 1] if c + 1 < chunks else first.size
        room -= outer_end[c] + extra[c, 0] + extra[c, 1]
        # a chunk may be full of daughters, all of whose pairs are found anew
        enough &= room >= 0 or room + _leaving(c, moved, first, second, start, outer_end) >= 0
    if not enough:
        for k in range(total):
            margin[cell[k]] = before[k, 3]
            for a in range(3):
                reference[cell[k], a] = before[k, a]
        return False, inner_end, outer_end
    for c in prange(chunks):
        _keep(c, moved, first, second, start, inner_end, outer_end, extra, at)
    inner, outer = np.empty(chunks, np.int64), np.empty(chunks, np.int64)
    for c in range(chunks):
        inner[c], outer[c] = at[c, 0] + extra[c, 0], at[c, 1] + extra[c, 1]
    for part in range(parts):
        for p in range(_FOUND * _PART * part, _FOUND * _PART * part + new[part]):
            i, j = new_first[p], new_second[p]
            c, d = i // chunk, j // chunk
            side = np.int64(c != d)
            first[at[c, side]], second[at[c, side]] = i, j
            at[c, side] += 1
            if c != d:
                first[at[d, 1]], second[at[d, 1]] = j, i
                at[d, 1] += 1
    return True, inner, outer


repair, repair_parallel = two_drivers(_repair)


@njit(**KERNEL)
def widened(position, reference, reach, least, margin):
    """Adapt the margins of the cells to how they move; return the radii to build a list with.

    A list lasts until some cell has drifted by its margin. Where few cells move it is they for
    whom it is built again and again, and room round them costs little: each cell's margin is a
    multiple of its drift since the last list, but not below half of what it was.

    - ``position``, ``reference``, (n, 3), µm: now, and at the last list; not a number where there
      was none
    - ``reach``, (n,), µm: half of the distance within which a pair matters
    - ``least``, float, µm: smallest margin
    - ``margin``, (n,), µm: how far each cell may drift; changed in place

    Returns (n,), µm: ``reach`` + ``margin``.
    """
    wide = np.empty_like(reach)
    for i in range(reach.size):
        square = 0.0
        for a in range(3):
            square += (position[i, a] - reference[i, a]) ** 2
        # not a number where there was no list: the margin stays
        if square == square:
            margin[i] = _next_margin(square, least, margin[i])
        wide[i] = reach[i] + margin[i]
    return wide


def spatial_order(position: FloatArray, width: float) -> OffsetArray:
    """Return the order of the cells along a Morton curve, (n,); ties keep their order.

    ``width``, µm, is the edge of the boxes that the curve visits; it is widened where more than 2²¹
    of them would be needed along an axis.
    """
    if len(position) == 0:
        return np.empty(0, dtype=np.int64)
    low, high = corners(position)
    # halves, because the extent itself may overflow
    extent = 2.0 * float((0.5 * high - 0.5 * low).max())
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
