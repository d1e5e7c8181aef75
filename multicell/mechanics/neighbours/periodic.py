"""Lists of neighbours where space repeats: cells near a border have images beyond the others.

The images stand behind the cells in one search (:mod:`.building`), and its result is folded back
into a list of the cells. Each pair is listed once, if two images of a cell are never within reach
of another one: an axis has at least twice the distance at which pairs are listed.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from multicell.cells import FloatArray
from multicell.compiling import KERNEL
from multicell.mechanics.neighbours.building import (
    TooManyPairsError,
    build,
    rebuild,
    rebuild_parallel,
    too_many_pairs,
)
from multicell.mechanics.neighbours.pair_list import CHUNK, ListArrays, OffsetArray, PairList
from multicell.vectors import nearest_differences, wrapped


def build_periodic(
    position: FloatArray, radius: FloatArray, period: FloatArray, chunk: int = CHUNK
) -> PairList:
    """Return the list of all pairs closer than ``r_i + r_j`` to an image of each other."""
    crowded, arrays = rebuild_periodic(position, radius, chunk, period, shared=False)
    if crowded:
        raise TooManyPairsError(too_many_pairs(len(position)))
    return PairList(*arrays, chunk, len(position))


def overlapping_pairs(
    position: FloatArray, radius: FloatArray, period: FloatArray | None = None
) -> OffsetArray:
    """Return the pairs of balls (n, 3), (n,) that overlap, sorted, (m, 2)."""
    place = np.ascontiguousarray(position, dtype=float)
    near = build(place, radius, 0.0) if period is None else build_periodic(place, radius, period)
    pairs = near.pairs()
    first, second = pairs.T
    apart = np.linalg.norm(nearest_differences(place[first], place[second], period), axis=1)
    return np.asarray(pairs[apart < radius[first] + radius[second]], dtype=np.int64)


def rebuild_periodic(
    position: FloatArray, wide: FloatArray, chunk: int, period: FloatArray, *, shared: bool
) -> tuple[bool, ListArrays]:
    """Search for all pairs closer than the sum of ``wide``; return if there are too many, and them.

    - ``period``, (3,), µm: zero along an axis where space does not repeat
    - ``shared``: whether threads share the search; same list
    """
    inside = wrapped(position, period)
    owner, places = _images(inside, wide + wide.max(), period)
    run, none = rebuild_parallel if shared else rebuild, np.empty(0, np.int32)
    everyone, reach = np.concatenate([inside, places]), np.concatenate([wide, wide[owner]])
    crowded, *found = run(everyone, reach, 0.0, chunk, none, none)
    return crowded, _fold(len(position), owner, chunk, *found)


@njit(**KERNEL)
def _images(place, reach, period):
    """Return the cells of all images that lie within reach of the others' space, and where."""
    owner, found = np.empty(0, np.int64), np.empty((0, 3))
    for fill in range(2):
        count = 0
        for i in range(place.shape[0]):
            ends = np.zeros((3, 2), np.int64)
            for a in range(3):
                if period[a] > 0.0:
                    ends[a, 0] = -np.int64(place[i, a] > period[a] - reach[i])
                    ends[a, 1] = np.int64(place[i, a] < reach[i])
            for x in range(ends[0, 0], ends[0, 1] + 1):
                for y in range(ends[1, 0], ends[1, 1] + 1):
                    for z in range(ends[2, 0], ends[2, 1] + 1):
                        if x == 0 and y == 0 and z == 0:
                            continue
                        if fill:
                            owner[count] = i
                            found[count, 0] = place[i, 0] + x * period[0]
                            found[count, 1] = place[i, 1] + y * period[1]
                            found[count, 2] = place[i, 2] + z * period[2]
                        count += 1
        if not fill:
            owner, found = np.empty(count, np.int64), np.empty((count, 3))
    return owner, found


@njit(**KERNEL)
def _fold(n, owner, chunk, first, second, start, inner_end, outer_end):
    """Return the list of ``n`` cells from that of cells and images.

    Of two images that meet nothing is kept; of a cell and an image that with the lower index.
    """
    chunks = (n + chunk - 1) // chunk
    counts, at = np.zeros((chunks, 2), np.int64), np.zeros((chunks, 2), np.int64)
    begins, inner, outer = np.empty((3, chunks), np.int64)
    one, other = np.empty(0, np.int32), np.empty(0, np.int32)
    for fill in range(2):
        for c in range(start.size):
            for p in range(start[c], outer_end[c]):
                i, j = first[p], second[p]
                if (p >= inner_end[c] and j < i) or (i >= n and j >= n):
                    continue
                a = owner[i - n] if i >= n else i
                b = owner[j - n] if j >= n else j
                if (i >= n and b >= a) or (j >= n and a >= b):
                    continue
                own, its = a // chunk, b // chunk
                side = np.int64(own != its)
                if fill:
                    one[at[own, side]], other[at[own, side]] = a, b
                    at[own, side] += 1
                    if side:
                        one[at[its, 1]], other[at[its, 1]] = b, a
                        at[its, 1] += 1
                else:
                    counts[own, side] += 1
                    counts[its, 1] += side
        if not fill:
            total = 0
            for c in range(chunks):
                begins[c] = at[c, 0] = total
                inner[c] = at[c, 1] = total + counts[c, 0]
                total += counts[c, 0] + counts[c, 1]
                outer[c] = total
            one, other = np.empty(total, np.int32), np.empty(total, np.int32)
    return one, other, begins, inner, outer
