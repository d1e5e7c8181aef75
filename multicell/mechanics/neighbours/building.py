"""The search for all pairs of cells that are close."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from multicell.cells import FloatArray
from multicell.compiling import INNER, UNCOUNTED
from multicell.compiling.threads import two_drivers
from multicell.mechanics.neighbours.bins import (
    LANES,
    SLABS,
    Bins,
    collect,
    dense_bins,
    next_block,
    ranges_found,
    ranges_near,
    sparse_bins,
)
from multicell.mechanics.neighbours.pair_list import CHUNK, IndexArray, PairList

_SPARE_PAIRS = 4_000_000  # beyond 500 for each cell: more is no tissue, and fills the memory
_HITS = 512  # neighbours of a cell that are noted in one go


class TooManyPairsError(Exception):
    """So many cells lie on top of each other that the list of pairs would not fit."""


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
) -> PairList:
    """Build the list of all pairs closer than ``r_i + r_j + skin``.

    - ``chunk``: cells in a chunk

    Raises :class:`TooManyPairsError`.
    """
    n = len(position)
    if n < 2:
        return empty_list(n, chunk)
    run, none = rebuild_parallel if threads > 1 and n > chunk else rebuild, np.empty(0, np.int32)
    crowded, first, second, start, inner_end, outer_end = run(
        position, radius, skin, chunk, none, none
    )
    if crowded:
        raise TooManyPairsError(too_many_pairs(n))
    return PairList(first, second, start, inner_end, outer_end, chunk, n)


def empty_list(n: int, chunk: int) -> PairList:
    """Return the list of ``n`` cells none of which are close."""
    none = np.empty(0, dtype=np.int32)
    start, inner_end, outer_end = np.zeros((3, -(-n // chunk)), dtype=np.int64)
    return PairList(none, none, start, inner_end, outer_end, chunk, n)


def too_many_pairs(n: int) -> str:
    """Return in words why there is no list of ``n`` cells."""
    return f"more than {500 * n + _SPARE_PAIRS} pairs among {n} cells"


@njit(**UNCOUNTED)
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
    hits, ranges = np.empty(_HITS + LANES, np.int32), np.empty((10, 2), np.int64)
    for i in range(np.uint64(own[0]), np.uint64(own[1])):
        # a typed zero: a bare one would have the functions below compiled twice
        a, count = np.int64(bins.place[i]), np.int64(0)
        if bins.shape[0] > 0:
            blocks = ranges_near(bins, a, 4, ranges)
        else:
            blocks = ranges_found(bins.ranges[i], ranges)
        part, block = np.int64(0), ranges[0, 0]
        for _ in range(blocks):
            if count > _HITS - LANES:
                _note(i, own, bins.order, hits, count, at, stop, first, second)
                count = np.int64(0)
            count = collect(bins.cells, block, ranges[part, 1], a, hits, count)
            part, block = next_block(ranges, part, block)
        _note(i, own, bins.order, hits, count, at, stop, first, second)
        if at[0] - base[c] + at[1] - stop[0] > limit:
            break
    found[c, 0], found[c, 1] = at[0] - base[c], at[1] - stop[0]
    if at[0] <= stop[0] and at[1] <= stop[1]:
        for k in range(found[c, 1]):
            first[at[0] + k] = first[stop[0] + k]
            second[at[0] + k] = second[stop[0] + k]


@njit(**UNCOUNTED)
def _count_mirrored(g, chunk, base, found, second, at):
    """Count the outer pairs of some chunks, the part ``g``, by the chunks of their second cells."""
    parts, chunks = at.shape
    for d in range(chunks):
        at[g, d] = 0
    for c in range(g * chunks // parts, (g + 1) * chunks // parts):
        own = base[c] + found[c, 0]
        for k in range(own, own + found[c, 1]):
            at[g, np.uint64(second[k] // chunk)] += 1


@njit(**UNCOUNTED)
def _make_room(base, room, found, at, end):
    """Turn these counts into places behind the chunks' own pairs, and write where lists end.

    Return whether there is room for them; where not, ``room`` is made larger.
    """
    chunks, enough = found.shape[0], True
    for c in range(chunks):
        end[c] = base[c] + found[c, 0] + found[c, 1]
    for g in range(at.shape[0]):
        for d in range(chunks):
            at[g, d], end[d] = end[d], end[d] + at[g, d]
    for c in range(chunks):
        if end[c] > base[c + 1]:
            room[c, 1] += end[c] - base[c + 1]
            enough = False
    return enough


@njit(**UNCOUNTED)
def _mirror(g, chunk, base, found, first, second, at):
    """Give the outer pairs of a part's chunks to the chunks of their second cells, too."""
    parts, chunks = at.shape
    for c in range(g * chunks // parts, (g + 1) * chunks // parts):
        own = base[c] + found[c, 0]
        for k in range(own, own + found[c, 1]):
            d = np.uint64(second[k] // chunk)
            p = np.uint64(at[g, d])
            first[p], second[p] = second[k], first[k]
            at[g, d] += 1


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
    dense = dense_bins(position, radius, skin, chunk)
    order, place, cells, ranges = dense.order, dense.place, dense.cells, dense.ranges
    if dense.shape[0] == 0:
        order, place, cells, ranges = sparse_bins(position, radius, skin)
    # made once: loops that threads share take no tuple that is either of two
    bins = Bins(order, place, cells, dense.largest, dense.low, dense.shape, dense.start, ranges)
    base, limit = np.empty(chunks + 1, np.int64), 500 * n + _SPARE_PAIRS
    room, counts = np.empty((chunks, 2), np.int64), np.empty((chunks, 2), np.int64)
    parts = min(chunks, SLABS)
    at = np.empty((parts, chunks), np.int64)
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
        if enough:
            for g in prange(parts):
                _count_mirrored(g, chunk, base, counts, second, at)
            if _make_room(base, room, counts, at, outer_end):
                for g in prange(parts):
                    _mirror(g, chunk, base, counts, first, second, at)
                break
    for c in range(chunks):
        start[c], inner_end[c] = base[c], base[c] + counts[c, 0]
    return total > limit, first, second, start, inner_end, outer_end


rebuild, rebuild_parallel = two_drivers(_rebuild)
