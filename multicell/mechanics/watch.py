"""Pairs that may come into contact within a step, remembered from step to step.

To look at all pairs after each step would cost a tenth of it. Each cell is given room: a gap as
wide as the room of its two cells is not closed before one of them has used up its own. Pairs that
are closer are noted with their gaps, and looked at where the ways of both cells add up to that. A
cell that moves fast gets much room: it alone has many pairs noted, and not all others too.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple, final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from multicell.cells import FloatArray
from multicell.compiling import INNER, KERNEL
from multicell.mechanics.forces import (
    apart,
    forming_pairs,
    missed_contact,
    pairs_about_to_touch,
)

if TYPE_CHECKING:
    from multicell.mechanics.forces import CellData, PairData
    from multicell.mechanics.motion import Motion
    from multicell.mechanics.neighbours import PairList

_LEAST = 0.05  # room of a cell that hardly moves, in the largest radius
_STEPS = 32.0  # room of others, over the way in a step
_ABOVE = 1.0 + 1e-6  # makes up for what single precision may lose


@njit(**INNER)
def _have_room(watched, before, after, slack):
    """Return whether no cell uses up its room in a step, to and fro.

    Notes what each of them may have closed of a gap by then.
    """
    reference, enough = watched.reference, True
    for i in range(watched.room.size):
        x, y, z = before[i, 0], before[i, 1], before[i, 2]
        dx, dy, dz = x - reference[i, 0], y - reference[i, 1], z - reference[i, 2]
        gone = dx * dx + dy * dy + dz * dz
        dx, dy, dz = after[i, 0] - x, after[i, 1] - y, after[i, 2] - z
        way = dx * dx + dy * dy + dz * dz
        closed = math.sqrt(gone) + 2.0 * math.sqrt(way) + slack
        watched.closed[i] = _ABOVE * closed
        enough &= closed <= watched.room[i]
    return enough


@njit(**INNER)
def _search(watched, pairs, rows, before, after, elapsed, slack):
    """Give room, and search for the pairs to watch from now on; return how many there are."""
    reference, room, places = watched.reference, watched.room, watched.places
    for i in range(room.size):
        square = 0.0
        for k in range(3):
            reference[i, k] = rows[i, k]
            square += (after[i, k] - before[i, k]) ** 2
        room[i] = max(watched.least, _STEPS * math.sqrt(square)) + 2.0 * slack
    known = pairs_about_to_touch(pairs, rows, elapsed, room, places)
    for k in range(known):
        p = places[k]
        square, reach = apart(rows, pairs, p, elapsed)
        watched.first[k], watched.second[k] = pairs.first[p], pairs.second[p]
        watched.gap[k] = abs(math.sqrt(square) - reach)
    return known


@njit(**INNER)
def _near(watched, known):
    """Note which of the watched pairs may come into contact in a step; return how many."""
    closed, found, near = watched.closed, watched.found, 0
    for k in range(known):
        found[near] = watched.places[k]
        most = closed[watched.first[k]] + closed[watched.second[k]]
        near += np.int64(watched.gap[k] <= most)
    return near


@njit(**KERNEL)
def _look(watched, known, radius, rate, pairs, rows, path, elapsed, dt, way, slack, tolerance):
    """Note the watched pairs that come into contact in a step; return how many.

    Also how many pairs are watched, of which ``known`` (-1: none yet) were before, and whether they
    were searched for anew. The law is no argument: contacts form in few steps.
    """
    before, after = path[:2]
    renewed = known < 0 or not _have_room(watched, before, after, slack)
    if renewed:
        known = _search(watched, pairs, rows, before, after, elapsed, slack)
        _have_room(watched, before, after, slack)
    found = watched.found
    near = found[: _near(watched, known)]
    forming = forming_pairs(near, pairs, radius, rate, *path, elapsed, dt, way, tolerance, found)
    return forming, known, renewed


class Watched(NamedTuple):
    """Arrays of a watch.

    Of cells their places at the search, their room, and the part of gaps that each may have closed
    since; of pairs their places in the list, their cells, and gaps or overlaps. ``found`` are those
    that come into contact in the last step, ``least`` the least room, µm.
    """

    reference: FloatArray
    room: FloatArray
    closed: NDArray[np.float32]
    places: NDArray[np.int64]
    found: NDArray[np.int64]
    first: NDArray[np.uint32]
    second: NDArray[np.uint32]
    gap: NDArray[np.float32]
    least: float


@final
class ContactWatch:
    """The pairs of a coupling step that are watched."""

    def __init__(self, motion: Motion) -> None:
        self._motion = motion
        self._watched = self._for_pairs(0)
        self._pairs: PairList | None = None
        self._since, self._known, self._growth = 0.0, -1, 0.0

    def missed_contact(
        self,
        pairs: PairList,
        kernel: tuple[CellData, PairData, Any, FloatArray],
        path: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
        begin: float,
        end: float,
        way: float,
        tolerance: float,
    ) -> float:
        """Return the part of a step to be taken, as :func:`.forces.missed_contact` does.

        - ``pairs``, ``kernel``: list, and data, law and rows of the last evaluation, at the end of
          the step
        - ``begin``, ``end``: of the step, s
        - ``path``, ``way``, ``tolerance``: places and velocities at both ends, and the rest, as
          :func:`.forces.forming_pairs` takes them
        """
        cells, data, law, rows = kernel
        if self._pairs is not pairs:
            self._pairs, self._known, self._since = pairs, -1, end
            if len(pairs.first) > len(self._watched.places):
                self._watched = self._for_pairs(len(pairs.first))
            self._growth = self._motion.fastest_growth
            if data.onset is not None and data.unit is not None:
                self._growth += 0.5 * float(np.abs(data.onset * data.unit[1]).max(initial=0.0))
        motion, dt = self._motion, end - begin
        # radii change, and gaps below the tolerance are looked at wherever cells go
        slack = self._growth * (abs(begin - self._since) + 2.0 * dt) + 0.5 * tolerance
        step = begin - motion.begin, dt
        given = cells.radius, cells.radius_rate, data, rows, path, *step, way, slack, tolerance
        forming, self._known, renewed = _look(self._watched, self._known, *given)
        if renewed:
            self._since = end
        if forming == 0:
            return 1.0
        found = self._watched.found[:forming]
        return float(missed_contact(cells, data, law, rows, found, *path, *step, tolerance))

    def _for_pairs(self, count: int) -> Watched:
        """Return arrays for a list of so many pairs."""
        motion, n = self._motion, len(self._motion.radius)
        places, found = np.empty((2, count), dtype=np.int64)
        first, second = np.empty((2, count), dtype=np.uint32)
        closed, gap = (np.empty(size, dtype=np.float32) for size in (n, count))
        least, cells = _LEAST * motion.largest_radius, (np.empty((n, 3)), np.empty(n), closed)
        return Watched(*cells, places, found, first, second, gap, least)
