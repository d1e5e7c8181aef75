"""Which cells are close: cells in bins, and a Verlet list in chunks.

A :class:`PairList` holds every pair closer than ``r_i + r_j + skin``. The cells are cut, in
the order of their indices, into chunks (:data:`CHUNK` cells). A chunk owns its cells: pairs with
both cells inside stand once in it ("inner"), pairs that reach out of it ("outer") stand in
both chunks that they touch, each time with the owned cell first. So each chunk can sum the
forces on its own cells without looking at other chunks' sums, and the result has the same
bits whatever the number of threads.

Trial states of an implicit integrator are arbitrary. Any finite input is handled: where the
cells are so far apart that a dense grid would be larger than a few bins per cell, bins are
made from the sorted coordinates instead, and memory stays proportional to cells and pairs.

A list names all pairs that are close at the cells' reference positions, for which each cell may
drift by its margin. Where few cells have drifted far, the list is repaired: their pairs are taken
out and searched anew, and stand as outer pairs even where both cells are in one chunk.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple, final

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from multicell.cells import FloatArray
from multicell.compiling import INLINED, INNER
from multicell.compiling.threads import two_drivers
from multicell.mechanics.margins import FORESIGHT, REPAIR_FORESIGHT, square_drift, widened

IndexArray = NDArray[np.int32]
OffsetArray = NDArray[np.int64]

CHUNK = 2048  # cells in a chunk. Larger ones share fewer pairs, smaller ones feed more threads.

_BINS_PER_CELL = 24
_SPARE_BINS = 4096
_SPARE_PAIRS = 4_000_000
_BLOCK = 512  # candidates that are tested in one go
_SLICES = 4  # bins along x for each along y and z
_WORN = 0.7  # part of its margin from which on a cell's pairs are searched anew in a repair
_FEW = 5  # a list is repaired for at most one cell in so many

REPAIR_CELLS = 1000
"""Number of cells from which on lists are repaired: with fewer a new one costs little, and code for
repairs is not compiled."""


class TooManyPairsError(Exception):
    """So many cells lie on top of each other that the list of pairs would not fit."""

    def __init__(self, n: int) -> None:
        super().__init__(f"more than {500 * n + _SPARE_PAIRS} pairs among {n} cells")


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


def neighbour_pairs(position: FloatArray, cutoff: float) -> IndexArray:
    """Return all pairs of points no further apart than ``cutoff``.

    - ``position``, (n, 3): any finite points, µm
    - ``cutoff``: largest distance, µm

    Returns (m, 2) int32: each pair once, smaller index first, in lexicographic order.
    """
    radius = np.full(len(position), 0.5 * cutoff)
    return build(np.ascontiguousarray(position, dtype=float), radius, 0.0).pairs()


def build(
    position: FloatArray, radius: FloatArray, skin: float, threads: int = 1, chunk: int = CHUNK
) -> PairList:
    """Build the list of all pairs closer than ``r_i + r_j + skin``.

    - ``position``, (n, 3): finite centres, µm
    - ``radius``, (n,): radii, µm
    - ``skin``: added to the sum of the radii, µm
    - ``threads``: with more than one, chunks are searched in parallel (same result)
    - ``chunk``: cells in a chunk
    """
    n = len(position)
    if n < 2:
        return PairList(*no_list(n, chunk), chunk, n)
    run = rebuild_parallel if threads > 1 and n > chunk else rebuild
    crowded, first, second, start, inner_end, outer_end = run(
        position, np.full((n, 3), np.nan), radius + 0.5 * skin, 0.0, np.zeros(n), chunk,
        *no_list(n, chunk)[:2],
    )  # fmt: skip
    if crowded:
        raise TooManyPairsError(n)
    return PairList(first, second, start, inner_end, outer_end, chunk, n)


def no_list(n: int, chunk: int) -> tuple[Any, Any, Any, Any, Any]:
    """Return the arrays of a list of ``n`` cells without pairs or room."""
    none, ends = np.empty(0, dtype=np.int32), np.zeros(-(-n // chunk), dtype=np.int64)
    return none, none, ends, ends, ends


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
    - ``shape``, (3,) int64: the number of bins along x, y and z; no bins where they are sparse
    - ``row``, (n, 2) int32: dense: the row of each cell along y and z
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
    row: IndexArray
    start: IndexArray
    ranges: OffsetArray


@njit(**INNER)
def _measure_chunk(c, chunk, reference, reach, margin, wide, bounds):
    """Write the radii of search of one chunk's cells, µm, and what holds for all of them.

    ``bounds[c]`` are the lowest and the highest coordinates and the largest radius of search.
    """
    for a in range(3):
        bounds[c, a], bounds[c, 3 + a] = np.inf, -np.inf
    bounds[c, 6] = 0.0
    for i in range(c * chunk, min((c + 1) * chunk, reference.shape[0])):
        wide[i] = reach[i] + margin[i]
        bounds[c, 6] = max(bounds[c, 6], wide[i])
        for a in range(3):
            bounds[c, a] = min(bounds[c, a], reference[i, a])
            bounds[c, 3 + a] = max(bounds[c, 3 + a], reference[i, a])


@njit(**INNER)
def _renew_chunk(c, chunk, position, reference, least, margin):
    """Make the present positions of one chunk's cells the reference; adapt their margins."""
    for i in range(c * chunk, min((c + 1) * chunk, position.shape[0])):
        margin[i] = widened(margin[i], FORESIGHT, square_drift(position, reference, i), least)
        for a in range(3):
            reference[i, a] = position[i, a]


@njit(**INNER)
def _grid_of(bounds, slices, n):
    """Return corner, shape, number of bins and largest radius of a dense grid of ``n`` cells.

    Bins are as wide as the largest distance of a pair, along x a part of that. There are none where
    they would be too many.
    """
    low, shape = np.empty(3), np.zeros(3, np.int64)
    largest = 0.0
    for c in range(bounds.shape[0]):
        largest = max(largest, bounds[c, 6])
    inverse, total = 0.5 / largest, 1.0
    for a in range(3):
        low[a], high = np.inf, -np.inf
        for c in range(bounds.shape[0]):
            low[a], high = min(low[a], bounds[c, a]), max(high, bounds[c, 3 + a])
        # math.floor makes an integer, which is undefined for what no integer holds
        count = np.floor((high - low[a]) * inverse * (slices if a == 0 else 1)) + 1.0
        total *= count
        shape[a] = np.int64(count) if total <= _BINS_PER_CELL * n + _SPARE_BINS else 0
    return low, shape, shape[0] * shape[1] * shape[2], largest


@njit(**INLINED)
def _bin_of(position, i, low, shape, scale, slices):
    """Return the bin of cell i along x, y and z; ``scale`` is one over their width, 1/µm."""
    ix = min(np.int64((position[i, 0] - low[0]) * scale * slices), shape[0] - 1)
    iy = min(np.int64((position[i, 1] - low[1]) * scale), shape[1] - 1)
    iz = min(np.int64((position[i, 2] - low[2]) * scale), shape[2] - 1)
    return ix, iy, iz


@njit(**INNER)
def _row_chunk(c, chunk, position, low, shape, scale, row, bin_of):
    """Write the bins of one chunk's cells."""
    for i in range(c * chunk, min((c + 1) * chunk, position.shape[0])):
        ix, iy, iz = _bin_of(position, i, low, shape, scale, _SLICES)
        row[i, 0], row[i, 1] = iy, iz
        bin_of[i] = (iz * shape[1] + iy) * shape[0] + ix


@njit(**INNER)
def _count_out(bin_of, start, order, place):
    """Sort the cells by counting; ``start`` is given the first place of each bin."""
    for b in range(start.size):
        start[b] = 0
    for i in range(bin_of.size):
        start[bin_of[i] + 2] += 1
    for b in range(2, start.size):
        start[b] += start[b - 1]
    for i in range(bin_of.size):
        # start[b + 1] runs through bin b, and ends as the first place of the next one
        b = bin_of[i]
        p = start[b + 1]
        start[b + 1] = p + 1
        order[p], place[i] = i, p


@njit(**INNER)
def _copy_chunk(c, chunk, reference, wide, place, cells):
    """Copy centres and radii of search of one chunk's cells to their places in bins."""
    for i in range(c * chunk, min((c + 1) * chunk, reference.shape[0])):
        p = place[i]
        for a in range(3):
            cells[p, a] = reference[i, a]
        cells[p, 3] = wide[i]


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
def _sparse_bins(position, largest, order, place, ranges):
    """Bin far-flung cells by sorted coordinates; write their order, their places and ``ranges``.

    Along each axis bins are numbered one after the other, and close cells differ by at most one:
    memory does not depend on the distances. Compiled with what calls it: an exception that Python
    raises within a loop of a method, such as for Ctrl-C, could not be carried out of it. All keys
    are whole numbers that a float holds exactly for less than 9e7 cells.
    """
    n = position.shape[0]
    width = 2.0 * largest
    number, key, edge = np.empty((4, n)), np.empty(n), np.empty(n)
    sorted_cells, stride, count = np.empty(0, np.int32), n + 2.0, 0
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
        sorted_cells = _stable_order(key)
        if sort == 4:
            break
        count, gap = 0, width if sort < 3 else 0.0
        for k in range(n):
            i = sorted_cells[k]
            # compared as a sum of halves, which cannot overflow
            if count == 0 or 0.5 * key[i] > 0.5 * edge[count - 1] + 0.5 * gap:
                edge[count] = key[i]
                count += 1
            number[sort, i] = count - 1
    line = np.empty(n)
    for k in range(n):
        i = sorted_cells[k]
        order[k], place[i], line[k] = i, k, key[i]
    for i in range(n):
        x = number[0, i]
        for neighbour in range(5):
            ranges[i, neighbour, 0] = ranges[i, neighbour, 1] = 0
            wanted = number[1, i] + ((neighbour + 4) // 3 - 1) * stride + ((neighbour + 4) % 3 - 1)
            found = _first_not_below(edge, count, wanted)
            if found < count and edge[found] == wanted:
                begin = found * stride
                ranges[i, neighbour, 0] = _first_not_below(line, n, begin + max(x - 1.0, 0.0))
                ranges[i, neighbour, 1] = _first_not_below(line, n, begin + min(x + 2.0, stride))
        ranges[i, 0, 0] = place[i] + 1


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
    cells, row, start, shape, low = bins.cells, bins.row, bins.start, bins.shape, bins.low
    width, scale, dense = (
        2.0 * bins.largest,
        0.5 * _SLICES / bins.largest,
        bins.ranges.shape[0] == 0,
    )
    for i in range(np.uint64(own[0]), np.uint64(own[1])):
        # a typed zero: a bare one would have the functions below compiled twice
        a, count = np.int64(bins.place[i]), np.int64(0)
        reach = cells[a, 3] + bins.largest
        for neighbour in range(5):
            if dense:
                dy, dz = (neighbour + 4) % 3 - 1, (neighbour + 4) // 3 - 1
                v, w = row[i, 0] + dy, row[i, 1] + dz
                if v < 0 or v >= shape[1] or w >= shape[2]:
                    continue
                y, z = cells[a, 1] - low[1], cells[a, 2] - low[2]
                y = 0.0 if dy == 0 else y - (row[i, 0] + max(dy, 0)) * width
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


def _rebuild(position, reference, reach, least, margin, chunk, first, second):
    """Build a neighbour list.

    One function, and loops in place of array expressions: so it compiles many times faster.

    - ``position``, ``reference``, (n, 3), µm: now, and at the last list, not a number where there
      was none; becomes the present one
    - ``reach``, (n,), µm: half of the distance within which a pair matters
    - ``least``, float, µm: smallest margin
    - ``margin``, (n,), µm: how far each cell may drift; changed in place
    - ``first``, ``second``, (m,) int32: of a list that nobody needs any more, or empty: written to
      where they are long enough. With many cells the system takes longer to find new memory than
      the search to fill it.

    Returns crowded, bool: whether there are too many pairs; the list is then of no use; first,
    second, start, inner_end, outer_end: as in :class:`PairList`.
    """
    n = position.shape[0]
    chunks = (n + chunk - 1) // chunk
    wide, bounds = np.empty(n), np.empty((chunks, 7))
    for c in prange(chunks):
        _renew_chunk(c, chunk, position, reference, least, margin)
        _measure_chunk(c, chunk, reference, reach, margin, wide, bounds)
    low, shape, size, largest = _grid_of(bounds, _SLICES, n)
    order, place, row = np.empty(n, np.int32), np.empty(n, np.int32), np.empty((n, 2), np.int32)
    bin_of, first_place = np.empty(n, np.int32), np.empty(size + 2, np.int32)
    ranges = np.empty((n if size == 0 else 0, 5, 2), np.int64)
    if size > 0:
        for c in prange(chunks):
            _row_chunk(c, chunk, reference, low, shape, 0.5 / largest, row, bin_of)
        _count_out(bin_of, first_place, order, place)
    else:
        _sparse_bins(reference, largest, order, place, ranges)
    cells = np.empty((n, 4))
    for c in prange(chunks):
        _copy_chunk(c, chunk, reference, wide, place, cells)
    bins = Bins(order, place, cells, largest, low, shape, row, first_place, ranges)
    start, inner_end = np.empty(chunks, np.int64), np.empty(chunks, np.int64)
    outer_end = np.empty(chunks, np.int64)
    base, limit = np.empty(chunks + 1, np.int64), 500 * n + _SPARE_PAIRS
    room, counts = np.empty((chunks, 2), np.int64), np.empty((chunks, 2), np.int64)
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
    if total > limit:
        # no cell is close to a place that is not a number: the next state builds
        for i in range(n):
            reference[i, 0] = np.nan
    return total > limit, first, second, start, inner_end, outer_end


rebuild, rebuild_parallel = two_drivers(_rebuild)


@njit(**INNER)
def _wear_chunk(c, chunk, position, reference, margin, worn, count):
    """Mark the cells of one chunk that have used up much of their margin, and count them."""
    count[c] = 0
    for i in range(c * chunk, min((c + 1) * chunk, position.shape[0])):
        limit = _WORN * margin[i]
        worn[i] = not (square_drift(position, reference, i) <= limit * limit)
        count[c] += worn[i]


@njit(**INNER)
def _renew_worn(worn, total, position, reference, least, margin):
    """Do for the worn cells what :func:`_renew_chunk` does; return them."""
    cell = np.empty(total, np.int32)
    k = 0
    for i in range(worn.size):
        if worn[i]:
            cell[k] = i
            k += 1
            square = square_drift(position, reference, i)
            margin[i] = widened(margin[i], REPAIR_FORESIGHT, square, least)
            for a in range(3):
                reference[i, a] = position[i, a]
    return cell


@njit(**INNER)
def _sort_worn(worn, reference, wide, low, shape, scale, bins):
    """Sort the worn cells into bins; return cells, centres with radii, first places, neighbourhood.

    The last says of each bin whether a worn cell is in it or next to it.
    """
    total = worn.size
    bin_of, cell = np.empty(total, np.int32), np.empty(total, np.int32)
    order, place = np.empty(total, np.int32), np.empty(total, np.int32)
    start, near = np.empty(bins + 2, np.int32), np.zeros(bins, np.bool_)
    for k in range(total):
        ix, iy, iz = _bin_of(reference, worn[k], low, shape, scale, 1)
        bin_of[k] = (iz * shape[1] + iy) * shape[0] + ix
        for w in range(max(iz - 1, 0), min(iz + 2, shape[2])):
            for v in range(max(iy - 1, 0), min(iy + 2, shape[1])):
                for u in range(max(ix - 1, 0), min(ix + 2, shape[0])):
                    near[(w * shape[1] + v) * shape[0] + u] = True
    _count_out(bin_of, start, order, place)
    centre = np.empty((total, 4))
    for k in range(total):
        i = worn[order[k]]
        cell[k] = i
        for a in range(3):
            centre[k, a] = reference[i, a]
        centre[k, 3] = wide[i]
    return cell, centre, start, near


@njit(**INNER)
def _repair_chunk(
    c, chunk, reference, wide, worn, cell, centre, place, near, low, shape, scale, first, second,
    start, inner_end, outer_end, kept, found,
):  # fmt: skip
    """Take the pairs of worn cells out of one chunk, and append those that its cells have now.

    ``kept[c]`` are the ends of the inner and the outer pairs that stay, ``found[c]`` is that of
    the new ones: where it is beyond the chunk's room, they are not all written.
    """
    at, stop = start[c], start[c + 1] if c + 1 < start.size else first.size
    for side in range(2):
        begin = start[c] if side == 0 else inner_end[c]
        for p in range(begin, inner_end[c] if side == 0 else outer_end[c]):
            i, j = np.uint32(first[p]), np.uint32(second[p])
            first[at], second[at] = i, j
            at += np.int64(not (worn[i] or worn[j]))
        kept[c, side] = at
    for j in range(c * chunk, min((c + 1) * chunk, reference.shape[0])):
        ix, iy, iz = _bin_of(reference, j, low, shape, scale, 1)
        if not near[(iz * shape[1] + iy) * shape[0] + ix]:
            continue
        x, y, z, r = reference[j, 0], reference[j, 1], reference[j, 2], wide[j]
        for w in range(max(iz - 1, 0), min(iz + 2, shape[2])):
            for v in range(max(iy - 1, 0), min(iy + 2, shape[1])):
                line = (w * shape[1] + v) * shape[0]
                end = place[line + min(ix + 2, shape[0])]
                for k in range(place[line + max(ix - 1, 0)], end):
                    dx, dy, dz = centre[k, 0] - x, centre[k, 1] - y, centre[k, 2] - z
                    limit = centre[k, 3] + r
                    if dx * dx + dy * dy + dz * dz <= limit * limit and cell[k] != j:
                        if at < stop:
                            first[at], second[at] = j, cell[k]
                        at += 1
    found[c] = at


@njit(**INNER)
def _mirror_new(chunk, worn, first, second, start, kept, found, inner_end, outer_end):
    """Give the new pairs to the chunks of their worn cells, too, and write where lists end.

    Return whether there was room for all. Two worn cells have found each other.
    """
    chunks = start.size
    for c in range(chunks):
        if found[c] > (start[c + 1] if c + 1 < chunks else first.size):
            return False
        inner_end[c], outer_end[c] = kept[c, 0], found[c]
    for c in range(chunks):
        for p in range(kept[c, 1], found[c]):
            if worn[first[p]]:
                continue
            d = second[p] // chunk
            at = outer_end[d]
            if at == (start[d + 1] if d + 1 < chunks else first.size):
                return False
            first[at], second[at] = second[p], first[p]
            outer_end[d] = at + 1
    return True


def _repair(
    position, reference, reach, least, margin, chunk, first, second, start, inner_end, outer_end
):  # fmt: skip
    """Search anew the pairs of cells that have drifted, where these are few.

    The arguments are those of :func:`_rebuild`; ``first``, ``second``, ``start``, ``inner_end``
    and ``outer_end`` are the last list, whose pairs are written over.

    Returns repaired, bool: if not, the list must be built; inner_end, outer_end.
    """
    n, chunks = position.shape[0], start.size
    ends, kept = np.empty((2, chunks), np.int64), np.empty((chunks, 2), np.int64)
    worn, count = np.empty(n, np.bool_), np.empty(chunks, np.int64)
    for c in prange(chunks):
        _wear_chunk(c, chunk, position, reference, margin, worn, count)
    total = 0
    for c in range(chunks):
        total += count[c]
    if total > n // _FEW:
        return False, ends[0], ends[1]
    worn_cells = _renew_worn(worn, total, position, reference, least, margin)
    wide, bounds = np.empty(n), np.empty((chunks, 7))
    for c in prange(chunks):
        _measure_chunk(c, chunk, reference, reach, margin, wide, bounds)
    low, shape, bins, largest = _grid_of(bounds, 1, n)
    if bins == 0:
        return False, ends[0], ends[1]
    cell, centre, place, near = _sort_worn(
        worn_cells, reference, wide, low, shape, 0.5 / largest, bins
    )
    for c in prange(chunks):
        _repair_chunk(
            c, chunk, reference, wide, worn, cell, centre, place, near, low, shape, 0.5 / largest,
            first, second, start, inner_end, outer_end, kept, count,
        )  # fmt: skip
    done = _mirror_new(chunk, worn, first, second, start, kept, count, ends[0], ends[1])
    return done, ends[0], ends[1]


repair, repair_parallel = two_drivers(_repair)
