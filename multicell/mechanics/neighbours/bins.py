"""Cells in bins: where the search for close cells looks.

Any finite positions are handled: where the cells are so far apart that a dense grid would be larger
than a few bins per cell, bins are made from the sorted coordinates instead, and memory stays
proportional to cells and pairs.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import njit, prange, types
from numba.extending import intrinsic

from multicell.cells import FloatArray
from multicell.compiling import INLINED, INNER, UNCOUNTED
from multicell.mechanics.neighbours.pair_list import IndexArray, OffsetArray
from multicell.mechanics.rows import RADIUS

_BINS_PER_CELL = 24  # most bins for each cell: scattered cells get wider ones
_SPARE_BINS = 4096  # and for few cells: 32 kB of counts
SLABS = 64
"""Parts in which threads count and sort at most: tables grow with the cells, not their square."""

SLICES = 4  # bins along x for each along y and z
_LARGEST = 6  # column of ``extent`` behind both corners: the largest radius of a chunk
_X, _Y, _Z = np.arange(3)  # axes; with literals each would have its own functions compiled
LANES = 8  # candidates that are tested at once


class Bins(NamedTuple):
    """Cells sorted into bins; one row of bins along x follows the other.

    Dense bins are as wide in y and z as the largest distance of a pair, and a quarter of that in x:
    a cell then looks through one range of places in each of the rows next to it, and that range
    is as short as its own reach allows. Each pair is found from one of its cells, the one that
    comes first.

    - ``order``, (n,) int32: cells in the order of their bins
    - ``place``, (n,) int32: where each cell stands in that order
    - ``cells``, (4, n + LANES), µm: centres and radii, half of the skin included, in that order;
      the search reads them in a stream, some beyond the end
    - ``largest``, float, µm: the largest of these radii
    - ``low``, (3,), µm: dense: the corner of the grid
    - ``shape``, (3,) int64: dense: the number of bins along x, y and z; zeros where the bins are
      sparse
    - ``start``, (bins + 1,) int32: dense: the first place of each bin, x running fastest, and the
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


@njit(**UNCOUNTED)
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
    extent[c, _LARGEST] = largest


@njit(**INNER)
def _dense_grid(extent, skin, n):
    """Return the largest radius, the grid's corner, and its shape: zeros with too many bins."""
    low, high, shape = np.empty(3), np.empty(3), np.empty(3, np.int64)
    largest, total = extent[0, _LARGEST], 1.0
    for a in range(3):
        low[a], high[a] = extent[0, a], extent[0, 3 + a]
    for c in range(extent.shape[0]):
        largest = max(largest, extent[c, _LARGEST])
        for a in range(3):
            low[a], high[a] = min(low[a], extent[c, a]), max(high[a], extent[c, 3 + a])
    largest += 0.5 * skin
    for a in range(3):
        # math.floor makes an integer, which is undefined beyond the range of integers
        count = np.floor((high[a] - low[a]) * (0.5 / largest) * (SLICES if a == 0 else 1)) + 1.0
        total *= count
        shape[a] = np.int64(count) if total <= _BINS_PER_CELL * n + _SPARE_BINS else 0
    if shape[0] * shape[1] * shape[2] == 0:
        shape[0] = 0
    return largest, low, shape


@njit(**INLINED)
def _bin_along(x, axis, largest, low, shape):
    """Return the bin of a coordinate along an axis."""
    inverse = 0.5 / largest * (SLICES if axis == 0 else 1)
    return min(np.int64((x - low[axis]) * inverse), shape[axis] - 1)


@njit(**UNCOUNTED)
def _assign(c, chunk, position, largest, low, shape, shift, bin_of, count):
    """Write the bins of a chunk's cells, and how many lie in each slab of 2 ** ``shift`` bins."""
    for s in range(count.shape[1]):
        count[c, s] = 0
    for i in range(np.uint64(c * chunk), np.uint64(min((c + 1) * chunk, bin_of.size))):
        ix = _bin_along(position[i, 0], _X, largest, low, shape)
        iy = _bin_along(position[i, 1], _Y, largest, low, shape)
        iz = _bin_along(position[i, 2], _Z, largest, low, shape)
        b = (iz * shape[1] + iy) * shape[0] + ix
        bin_of[i] = b
        count[c, np.uint64(b >> shift)] += 1


@njit(**UNCOUNTED)
def _place_slabs(count):
    """Turn counts into the places of each chunk's cells, slab after slab."""
    total = 0
    for s in range(count.shape[1]):
        for c in range(count.shape[0]):
            count[c, s], total = total, total + count[c, s]


@njit(**UNCOUNTED)
def _part(c, chunk, bin_of, shift, at, by_slab):
    """Write a chunk's cells among those of their slabs; ``at[c]`` then holds the ends of these."""
    for i in range(np.uint64(c * chunk), np.uint64(min((c + 1) * chunk, bin_of.size))):
        s = np.uint64(bin_of[i] >> shift)
        by_slab[np.uint64(at[c, s])] = i
        at[c, s] += 1


@njit(**UNCOUNTED)
def _sort(s, shift, ends, by_slab, bin_of, position, radius, skin, start, place, order, cells):
    """Sort the cells of a slab by counting: write where its bins end, and line up the cells."""
    begin, end = ends[s - 1] if s > 0 else np.int64(0), ends[s]
    low, high = s << shift, min((s + 1) << shift, start.size - 1)
    for b in range(low, high):
        start[b + 1] = 0
    for k in range(begin, end):
        start[np.uint32(bin_of[by_slab[k]] + 1)] += 1
    total = begin
    for b in range(low, high):
        start[b + 1], total = total, total + start[b + 1]
    for k in range(begin, end):
        # start[b + 1] runs through bin b, and ends as the first place of the next one
        i = np.uint64(by_slab[k])
        b = np.uint32(bin_of[i] + 1)
        p = np.uint64(start[b])
        start[b] += 1
        place[i], order[p] = p, i
        for a in range(3):
            cells[a, p] = position[i, a]
        cells[RADIUS, p] = radius[i] + 0.5 * skin


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


@njit(**UNCOUNTED)
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
def sparse_bins(position, radius, skin):
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
    order, stride, count = np.empty(0, np.int32), n + 2.0, np.int64(0)
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
        count, gap = np.int64(0), width if sort < 3 else 0.0
        for k in range(n):
            i = order[k]
            # compared as a sum of halves, which cannot overflow
            if count == 0 or 0.5 * key[i] > 0.5 * edge[count - 1] + 0.5 * gap:
                edge[count] = key[i]
                count += 1
            number[sort, i] = count - 1
    place, cells, line = np.empty(n, np.int32), np.empty((4, n + LANES)), np.empty(n)
    for k in range(n):
        i = order[k]
        place[i], line[k] = k, key[i]
        for a in range(3):
            cells[a, k] = position[i, a]
        cells[RADIUS, k] = radius[i] + 0.5 * skin
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


@njit(**INNER, inline="always")
def dense_bins(position, radius, skin, chunk):
    """Return cells in the bins of a dense grid; ``shape`` is zero where it would be too large.

    Put into its callers line by line, so that threads share its loops there.
    """
    n = radius.size
    chunks = (n + chunk - 1) // chunk
    extent, bin_of = np.empty((chunks, 7)), np.empty(n, np.int32)
    for c in prange(chunks):
        _extent(c, chunk, position, radius, extent)
    largest, low, shape = _dense_grid(extent, skin, n)
    bins, shift = shape[0] * shape[1] * shape[2], 0
    while (bins - 1) >> shift >= min(SLABS, chunks):
        shift += 1
    slabs, dense = ((bins - 1) >> shift) + 1, chunks if bins > 0 else 0
    at, by_slab = np.empty((chunks, slabs), np.int64), np.empty(n, np.int32)
    for c in prange(dense):
        _assign(c, chunk, position, largest, low, shape, shift, bin_of, at)
    _place_slabs(at)
    for c in prange(dense):
        _part(c, chunk, bin_of, shift, at, by_slab)
    place, order, cells = np.empty(n, np.int32), np.empty(n, np.int32), np.empty((4, n + LANES))
    start = np.empty(bins + 1, np.int32)
    start[0] = 0
    for s in prange(slabs):
        _sort(
            s,
            shift,
            at[chunks - 1],
            by_slab,
            bin_of,
            position,
            radius,
            skin,
            start,
            place,
            order,
            cells,
        )
    return Bins(order, place, cells, largest, low, shape, start, np.empty((0, 5, 2), np.int64))


@njit(**INLINED)
def ranges_near(bins, a, first, ranges):
    """Note the ranges of places that may hold neighbours of place ``a``; return how many blocks.

    A block is :data:`LANES` places. Of the nine rows of a dense grid round its own, those from
    ``first`` on; where that is the own row, 4, only what comes later counts in it. Rows without any
    are written and overwritten: a branch would mispredict.

    - ``ranges``, (10, 2) int64: the first place and the end of each
    """
    cells, start, shape, low = bins.cells, bins.start, bins.shape, bins.low
    width, scale = 2.0 * bins.largest, 0.5 * SLICES / bins.largest
    iy = _bin_along(cells[1, a], _Y, bins.largest, low, shape)
    iz = _bin_along(cells[2, a], _Z, bins.largest, low, shape)
    reach, count, blocks = cells[RADIUS, a] + bins.largest, np.int64(0), np.int64(0)
    x, y, z = cells[0, a] - low[0], cells[1, a] - low[1], cells[2, a] - low[2]
    for row in range(first, 9):
        dy, dz = row % 3 - 1, row // 3 - 1
        v, w = iy + dy, iz + dz
        beside = 0.0 if dy == 0 else y - (iy + max(dy, 0)) * width
        above = 0.0 if dz == 0 else z - (iz + max(dz, 0)) * width
        # wider by a millionth, so that rounding loses no pair
        rest = reach * reach * 1.000001 - beside * beside - above * above
        inside = (v >= 0) & (v < shape[1]) & (w >= 0) & (w < shape[2]) & (rest > 0.0)
        line = (w * shape[1] + v) * shape[0] if inside else np.int64(0)
        half = math.sqrt(max(rest, 0.0))
        left, right = np.int64((x - half) * scale), np.int64((x + half) * scale)
        begin = np.int64(start[np.uint64(line + max(left, 0))])
        begin = a + 1 if row == first and first == 4 else begin
        end = np.int64(start[np.uint64(line + min(right, shape[0] - 1) + 1)])
        ranges[count, 0], ranges[count, 1] = begin, end
        some = np.int64(inside & (begin < end))
        count += some
        blocks += some * ((end - begin + LANES - 1) // LANES)
    return blocks


@njit(**INLINED)
def ranges_found(found, ranges):
    """Note the ranges of sparse bins that are not empty; return how many blocks they have."""
    count, blocks = np.int64(0), np.int64(0)
    for row in range(found.shape[0]):
        begin, end = found[row, 0], found[row, 1]
        ranges[count, 0], ranges[count, 1] = begin, end
        if begin < end:
            count, blocks = count + 1, blocks + (end - begin + LANES - 1) // LANES
    return blocks


@njit(**INLINED)
def next_block(ranges, part, block):
    """Return the range and the place where the next block begins."""
    over, block = block + LANES >= ranges[part, 1], block + LANES
    return part + np.int64(over), ranges[part + 1, 0] if over else block


@intrinsic
def _close(context: Any, cells, begin, x, y, z, r):
    """Return as bits which of the :data:`LANES` candidates from ``begin`` on are close.

    The compiler does not find by itself that these can be tested at once.
    """

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        array, place = context.make_array(signature.args[0])(context, builder, values[0]), values[1]
        kind, row = ir.VectorType(ir.DoubleType(), LANES), builder.extract_value(array.shape, 1)
        zeros = ir.Constant(ir.VectorType(ir.IntType(32), LANES), None)
        squares = []
        for axis, value in enumerate(values[2:]):
            one = builder.insert_element(kind(ir.Undefined), value, ir.IntType(32)(0))
            same = builder.shuffle_vector(one, kind(ir.Undefined), zeros)
            at = builder.bitcast(builder.gep(array.data, [place]), kind.as_pointer())
            join = builder.fadd if axis == RADIUS else builder.fsub
            part = join(builder.load(at, align=8), same)
            squares.append(builder.fmul(part, part))
            place = builder.add(place, row)
        apart = builder.fadd(builder.fadd(squares[0], squares[1]), squares[2])
        bits = builder.bitcast(builder.fcmp_ordered("<=", apart, squares[3]), ir.IntType(LANES))
        return builder.zext(bits, ir.IntType(64))

    return types.int64(cells, types.int64, *[types.float64] * 4), generate


@njit(**INLINED)
def collect(cells, block, end, a, hits, count):
    """Append the places from ``block`` on that are close to place ``a``; return how many there are.

    :data:`LANES` candidates are tested at once, also beyond the end, where nothing counts. The
    writes are unconditional and only the count depends on the tests: one cell in three is close,
    which a branch would mispredict.
    """
    close = _close(cells, block, cells[0, a], cells[1, a], cells[2, a], cells[RADIUS, a])
    close &= (np.int64(1) << min(end - block, LANES)) - np.int64(1)
    for k in range(LANES):
        hits[np.uint64(count)] = block + k
        count += (close >> k) & np.int64(1)
    return count
