"""Pairs that may come into contact within a step, remembered from step to step.

To look at all pairs after each step would cost a tenth of it. Cells are given room, eights of them
together, which follow each other in memory: a gap as wide as the room of its two cells is not
closed before one of them has used up its own. Pairs that are closer are noted with their gaps, and
looked at where the ways of both add up to that. Cells that move fast get much room: they alone
have many pairs noted, and not all others too.
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
_STEPS = 16.0  # room of others, over the way in a step
_ROUNDING = 4.0  # of a time, in units of its last place


@njit(**KERNEL)
def furthest_ways(before, after, radius, ways):
    """Return the cell that moved furthest, in its radius, and how far; not a number is ∞.

    Notes the longest way among eight cells each, µm, as :func:`empty_ways` has room for.
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
        watched.first[k], watched.second[k] = i >> ROOMY, j >> ROOMY
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
def _look(watched, known, cells, pairs, law, rows, step, ways, way, slack):
    """Return the part of a step to be taken, as :func:`.forces.missed_contact` does.

    Also how many pairs are watched, of which ``known`` (-1: none yet) were before, and whether they
    were searched for anew.
    """
    renewed = known < 0 or not _have_room(watched, ways, slack)
    if renewed:
        known = _search(watched, pairs, rows, step.elapsed, ways, slack)
    closed, found, near = watched.closed, watched.found, 0
    for k in range(known):
        found[near] = watched.places[k]
        most = closed[watched.first[k]] + closed[watched.second[k]] + 2.0 * slack
        near += np.int64(watched.gap[k] <= most)
    radius, rate = cells.radius, cells.radius_rate
    forming = forming_pairs(found[:near], pairs, radius, rate, step, way, found)
    part = 1.0
    if forming > 0:
        part = missed_contact(cells, pairs, law, rows, found[:forming], step)
    return part, known, renewed


class Watched(NamedTuple):
    """Arrays of a watch, and the least room, µm.

    Of eight cells each their room, the way that they have gone and what of their gaps may be closed
    in a step; of pairs their places in the list, gap or overlap, and the eights that they are of.
    ``found`` are those that are looked at in a step.
    """

    least: float
    room: FloatArray
    used: FloatArray
    closed: FloatArray
    places: NDArray[np.int64]
    found: NDArray[np.int64]
    gap: FloatArray
    first: NDArray[np.uint32]
    second: NDArray[np.uint32]


@final
class ContactWatch:
    """The pairs of a coupling step that are watched."""

    def __init__(self, motion: Motion) -> None:
        self._motion = motion
        self._last, self._own = (empty_ways(len(motion.radius)) for _ in range(2))
        self._eights = tuple(empty_ways(len(motion.radius)) for _ in range(3))
        self._watched: Watched
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
            self._watched = _for_pairs(len(pairs.first), self._eights, motion.largest_radius)
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

    def _follow(self, begin: float) -> None:
        """Let cells go the way of the last step, if it was taken; after a gap nothing is known."""
        if begin == self._begin:
            return
        if self._known >= 0 and abs(begin - self._end) <= _ROUNDING * math.ulp(begin):
            self._watched.used[:] += self._last
        else:
            self._known = -1


def _for_pairs(count: int, eights: tuple[FloatArray, ...], largest: float) -> Watched:
    """Return arrays for a list of so many pairs."""
    places, found = np.empty((2, count), dtype=np.int64)
    first, second = np.empty((2, count), dtype=np.uint32)
    return Watched(_LEAST * largest, *eights, places, found, np.empty(count), first, second)
