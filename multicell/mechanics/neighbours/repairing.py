"""The repair of a list where few cells have drifted."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from multicell.compiling import INNER
from multicell.compiling.threads import two_drivers
from multicell.mechanics.neighbours.bins import (
    LANES,
    SLABS,
    collect,
    dense_bins,
    next_block,
    ranges_near,
)
from multicell.mechanics.neighbours.margins import next_margin

_USED = (0.25, 0.5)  # of the square of a margin: a repair gives new ones to cells beyond
FEW = 8  # a list is repaired where one cell in so many has drifted, or fewer
_FOUND = 64  # pairs of a cell that a repair has room for
_MOST = 576  # pairs of one cell, which may use the room of others
_BOTH, _OWN = 6, 7  # sums of x r and r r, behind those of three components of x and of r
_MARGIN = 3  # column of ``before`` behind a reference
_PART = 256  # cells whose pairs one thread looks for at a time


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
            sums[c, _BOTH] += x * r
            sums[c, _OWN] += r * r


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
    both, own = total[_BOTH], total[_OWN]
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
            cell[k], before[k, _MARGIN], square = i, margin[i], 0.0
            for a in range(3):
                before[k, a] = reference[i, a]
                square += (position[i, a] - reference[i, a]) ** 2
                reference[i, a] = position[i, a]
            margin[i] = next_margin(square, least, margin[i])
            k += 1
        wide[i] = reach[i] + margin[i]


@njit(**INNER)
def _pairs_of(part, cell, moved, bins, first, second):
    """Write all pairs of a part of some cells, those among them once; return how many there are.

    -1 without room: each of the cells has :data:`_FOUND` places.
    """
    begin, end = part * _PART, min((part + 1) * _PART, cell.size)
    at, hits = np.int64(_FOUND * begin), np.empty(_MOST + 2 * LANES, np.int32)
    ranges = np.empty((10, 2), np.int64)
    for k in range(begin, end):
        i = np.int64(cell[k])
        a, count = np.int64(bins.place[i]), np.int64(0)
        blocks = ranges_near(bins, a, 0, ranges)
        row, block = np.int64(0), ranges[0, 0]
        for _ in range(blocks):
            count = collect(bins.cells, block, ranges[row, 1], a, hits, count)
            if count > _MOST:
                return -1
            row, block = next_block(ranges, row, block)
        if at + count > _FOUND * end:
            return -1
        for h in range(np.uint64(count)):
            j = np.int64(bins.order[hits[h]])
            first[at], second[at] = i, j
            # a branch would mispredict
            at += np.int64((j != i) & ((moved[j] == 0) | (j > i)))
    return at - _FOUND * begin


@njit(**INNER)
def _count_new(g, new, chunk, first, second, at):
    """Count the pairs that some parts, the group ``g``, have found, ``new`` of each, by chunks.

    Inner and outer pairs of each chunk in turn.
    """
    groups, parts = at.shape[0], new.size
    for k in range(at.shape[1]):
        at[g, k] = 0
    for part in range(g * parts // groups, (g + 1) * parts // groups):
        begin = _FOUND * _PART * part
        for p in range(begin, begin + new[part]):
            c, d = first[p] // chunk, second[p] // chunk
            out = np.int64(c != d)
            at[g, 2 * c + out] += 1
            at[g, 2 * d + 1] += out


@njit(**INNER)
def _add(g, new, chunk, new_first, new_second, at, first, second):
    """Write the pairs that a group has found to their places ``at[g]`` in the list."""
    groups, parts = at.shape[0], new.size
    for part in range(g * parts // groups, (g + 1) * parts // groups):
        begin = _FOUND * _PART * part
        for p in range(begin, begin + new[part]):
            i, j = new_first[p], new_second[p]
            c, d = i // chunk, j // chunk
            own = 2 * c + np.int64(c != d)
            first[at[g, own]], second[at[g, own]] = i, j
            at[g, own] += 1
            if c != d:
                other = 2 * d + 1
                first[at[g, other]], second[at[g, other]] = j, i
                at[g, other] += 1


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
            c,
            chunk,
            mark,
            way,
            position,
            reference,
            reach,
            least,
            margin,
            moved,
            base,
            cell,
            before,
            wide,
        )
    bins = dense_bins(reference, wide, 0.0, chunk)
    parts = (total + _PART - 1) // _PART if bins.shape[0] > 0 else 0
    new_first = np.empty(_FOUND * total, np.int32)
    new_second = np.empty(_FOUND * total, np.int32)
    groups, new = min(parts, SLABS), np.empty(parts, np.int64)
    places = np.empty((groups, 2 * chunks), np.int64)
    for g in prange(groups):
        for q in range(g * parts // groups, (g + 1) * parts // groups):
            new[q] = _pairs_of(q, cell, moved, bins, new_first, new_second)
        _count_new(g, new, chunk, new_first, new_second, places)
    extra, at = np.zeros((chunks, 2), np.int64), np.empty((chunks, 2), np.int64)
    enough = bins.shape[0] > 0
    for part in range(parts):
        enough &= new[part] >= 0
    for g in range(groups):
        for c in range(chunks):
            extra[c, 0] += places[g, 2 * c]
            extra[c, 1] += places[g, 2 * c + 1]
    for c in range(chunks):
        room = start[c + 1] if c + 1 < chunks else first.size
        room -= outer_end[c] + extra[c, 0] + extra[c, 1]
        # a chunk may be full of daughters, all of whose pairs are found anew
        enough &= room >= 0 or room + _leaving(c, moved, first, second, start, outer_end) >= 0
    if not enough:
        for k in range(total):
            margin[cell[k]] = before[k, _MARGIN]
            for a in range(3):
                reference[cell[k], a] = before[k, a]
        return False, inner_end, outer_end
    for c in prange(chunks):
        _keep(c, moved, first, second, start, inner_end, outer_end, extra, at)
    for g in range(groups):
        for c in range(chunks):
            for side in range(2):
                k = 2 * c + side
                places[g, k], at[c, side] = at[c, side], at[c, side] + places[g, k]
    for g in prange(groups):
        _add(g, new, chunk, new_first, new_second, places, first, second)
    inner, outer = np.empty(chunks, np.int64), np.empty(chunks, np.int64)
    for c in range(chunks):
        inner[c], outer[c] = at[c, 0], at[c, 1]
    return True, inner, outer


repair, repair_parallel = two_drivers(_repair)
