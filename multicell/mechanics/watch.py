"""Pairs that may come into contact within a step, remembered from step to step.

To look at all pairs after each step would cost a tenth of it. Cells are given room, four of them
together, which follow each other in memory: a gap as wide as the room of its two cells is not
closed before one of them has used up its own. Pairs that are closer are noted with their gaps, and
looked at where the ways of both add up to that. Cells that move fast get much room: they alone
have many pairs noted, and not all others too. What a step touches is not in the nearest caches by
then, so that each number which is read from afar counts.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple, final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from multicell.cells import FloatArray
from multicell.compiling import KERNEL
from multicell.mechanics.forces import (
    ROOMY,
    Passage,
    begin_of_contact,
    forming_pairs,
    missed_contact,
    nearest_image,
    pairs_about_to_touch,
)
from multicell.mechanics.rows import RADIUS

if TYPE_CHECKING:
    from multicell.mechanics.forces import CellData, PairData
    from multicell.mechanics.motion import Motion
    from multicell.mechanics.neighbours import PairList

_LEAST = 0.05  # room of cells that hardly move, in the largest radius
_STEPS = 32.0  # room of others, over the way in a step
_ROUNDING = 4.0  # of a time, in units of its last place


@njit(**KERNEL)
def furthest_ways(before, after, radius, ways):
    """Return the cell that moved furthest, in its radius, and how far; not a number is ∞.

    Notes the longest way among four cells each, µm, as :func:`empty_ways` has room for.
    """
    cell, most = 0, -1.0
    for b in range(ways.size):
        longest = 0.0
        for i in range(b << ROOMY, min((b + 1) << ROOMY, radius.size)):
            x, y = after[i, 0] - before[i, 0], after[i, 1] - before[i, 1]
            z = after[i, 2] - before[i, 2]
            way = math.sqrt(x * x + y * y + z * z)
            moved = way / radius[i]
            if not math.isfinite(moved):
                return i, math.inf
            longest = max(longest, way)
            if moved > most:
                cell, most = i, moved
        ways[b] = longest
    return cell, most


def empty_ways(cells: int) -> FloatArray:
    """Return an array for the ways of so many cells."""
    return np.empty(-(-cells // (1 << int(ROOMY))))


@njit(**KERNEL)
def _search(watched, pairs, rows, elapsed, ways, slack):
    """Give room, and search for the pairs to watch from now on; return how many there are."""
    room, places = watched.room, watched.places
    for b in range(ways.size):
        room[b] = max(watched.least, _STEPS * ways[b]) + 2.0 * slack
        # if the step is refused, cells are where they were before
        watched.used[b], watched.closed[b] = ways[b], 3.0 * ways[b]
    known = pairs_about_to_touch(pairs, rows, elapsed, room, places)
    for k in range(known):
        i, j = np.uint32(pairs.first[places[k]]), np.uint32(pairs.second[places[k]])
        dx, dy, dz = rows[j, 0] - rows[i, 0], rows[j, 1] - rows[i, 1], rows[j, 2] - rows[i, 2]
        dx, dy, dz = nearest_image(pairs.period, dx, dy, dz)
        reach = rows[i, RADIUS] + rows[j, RADIUS]
        reach -= begin_of_contact(pairs.unit, pairs.onset, places[k], elapsed)
        watched.first[k], watched.second[k], watched.reach[k] = i, j, reach
        watched.gap[k] = abs(math.sqrt(dx * dx + dy * dy + dz * dz) - reach)
    return known


@njit(**KERNEL)
def _have_room(watched, ways, slack):
    """Return whether no cell uses up its room in a step, to and fro; note what they use."""
    for b in range(ways.size):
        watched.closed[b] = watched.used[b] + 2.0 * ways[b]
        if not watched.closed[b] <= watched.room[b] - slack:
            return False
    return True


@njit(**KERNEL)
def _near(watched, known, period, before, ways, slack):
    """Note which of the watched pairs may come into contact in a step; return how many."""
    closed, near = watched.closed, 0
    for k in range(known):
        i, j = watched.first[k], watched.second[k]
        if watched.gap[k] > closed[i >> ROOMY] + closed[j >> ROOMY] + 2.0 * slack:
            continue
        dx, dy = before[j, 0] - before[i, 0], before[j, 1] - before[i, 1]
        dx, dy, dz = nearest_image(period, dx, dy, before[j, 2] - before[i, 2])
        low = max(watched.reach[k] - 2.0 * slack, 0.0)
        high = watched.reach[k] + 2.0 * (ways[i >> ROOMY] + ways[j >> ROOMY] + 2.0 * slack)
        square = dx * dx + dy * dy + dz * dz
        watched.found[near] = watched.places[k]
        near += np.int64((square >= low * low) & (square <= high * high))
    return near


@njit(**KERNEL)
def _look(watched, known, cells, pairs, law, rows, step, ways, way, slack):
    """Return the part of a step to be taken, as :func:`.forces.missed_contact` does.

    Also how many pairs are watched, of which ``known`` (-1: none yet) were before, and whether they
    were searched for anew.
    """
    renewed = known < 0 or not _have_room(watched, ways, slack)
    if renewed:
        known = _search(watched, pairs, rows, step.elapsed, ways, slack)
    found, radius, rate = watched.found, cells.radius, cells.radius_rate
    near = _near(watched, known, pairs.period, step.before, ways, slack)
    forming = forming_pairs(found[:near], pairs, radius, rate, step, way, found)
    part = 1.0
    if forming > 0:
        part = missed_contact(cells, pairs, law, rows, found[:forming], step)
    return part, known, renewed


class Watched(NamedTuple):
    """Arrays of a watch, and the least room, µm.

    Of four cells each their room, the way that they have gone and what of their gaps may be closed
    in a step; of pairs their places in the list, cells, gap or overlap, and the distance at which
    they touch. ``found`` are those that are looked at in a step.
    """

    least: float
    room: FloatArray
    used: FloatArray
    closed: FloatArray
    places: NDArray[np.int64]
    found: NDArray[np.int64]
    gap: FloatArray
    reach: FloatArray
    first: NDArray[np.uint32]
    second: NDArray[np.uint32]


@final
class ContactWatch:
    """The pairs of a coupling step that are watched."""

    def __init__(self, motion: Motion) -> None:
        self._motion = motion
        self._last, self._own = (empty_ways(len(motion.radius)) for _ in range(2))
        self._watched = self._for_pairs(0)
        self._pairs: PairList | None = None
        self._since, self._known = 0.0, -1
        self._begin, self._end = math.nan, math.nan

    def missed_contact(
        self,
        pairs: PairList,
        kernel: tuple[CellData, PairData, Any, FloatArray],
        path: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
        begin: float,
        end: float,
        way: float,
        tolerance: float,
        ways: FloatArray | None = None,
    ) -> float:
        """Return the part of a step to be taken, as :func:`.forces.missed_contact` does.

        - ``pairs``, ``kernel``: list, and data, law and rows of the last evaluation, at the end of
          the step
        - ``begin``, ``end``: of the step, s
        - ``path``: places and velocities at both ends, as :class:`.forces.Passage` has them
        - ``way``, ``tolerance``: as :func:`.forces.forming_pairs` takes them
        - ``ways``: of :func:`furthest_ways` on this path; None: found here
        """
        motion, dt = self._motion, end - begin
        if ways is None:
            ways = self._own
            furthest_ways(path[0], path[1], motion.radius, ways)
        self._follow(begin)
        if self._pairs is not pairs:
            self._pairs, self._known = pairs, -1
            if len(pairs.first) > len(self._watched.places):
                self._watched = self._for_pairs(len(pairs.first))
        since = end if self._known < 0 else self._since
        # radii change, and gaps below the tolerance are looked at wherever cells go
        slack = motion.fastest_growth * (abs(begin - since) + dt) + 0.5 * tolerance
        part, self._known, renewed = _look(
            self._watched,
            self._known,
            *kernel,
            Passage(*path, begin - motion.begin, dt, tolerance),
            ways,
            way,
            slack,
        )
        self._since = end if renewed else self._since
        self._begin, self._end = begin, end
        self._last[:] = ways
        return float(part)

    def _for_pairs(self, count: int) -> Watched:
        """Return arrays for a list of so many pairs."""
        motion = self._motion
        places, found = np.empty((2, count), dtype=np.int64)
        first, second = np.empty((2, count), dtype=np.uint32)
        room, used, closed = (empty_ways(len(motion.radius)) for _ in range(3))
        gap, reach = np.empty((2, count))
        least = _LEAST * motion.largest_radius
        return Watched(least, room, used, closed, places, found, gap, reach, first, second)

    def _follow(self, begin: float) -> None:
        """Let cells go the way of the last step, if it was taken; after a gap nothing is known."""
        if begin == self._begin:
            return
        if self._known >= 0 and abs(begin - self._end) <= _ROUNDING * math.ulp(begin):
            self._watched.used[:] += self._last
        else:
            self._known = -1
