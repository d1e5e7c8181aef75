"""Pairs that may come into contact within a step, remembered from step to step.

To look at all pairs after each step would cost a tenth of it. Each cell is given room: a gap as
wide as the room of its two cells is not closed before one of them has used up its own. Pairs that
are closer are noted, and looked at until then. A cell that moves fast gets much room: it alone has
many pairs noted, and not all others too.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple, final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from multicell.cells import FloatArray
from multicell.compiling import KERNEL
from multicell.mechanics.forces import forming_pairs, missed_contact, pairs_about_to_touch

if TYPE_CHECKING:
    from multicell.mechanics.forces import CellData, PairData
    from multicell.mechanics.motion import Motion
    from multicell.mechanics.neighbours import PairList

_LEAST = 0.05  # room of a cell that hardly moves, in the largest radius
_STEPS = 16.0  # room of others, over the way in a step


@njit(**KERNEL)
def _has_room(reference, room, before, after, slack):
    """Return whether no cell has used up its room, nor does so in a step, to and fro."""
    for i in range(room.size):
        left = room[i] - slack
        x, y, z = before[i, 0], before[i, 1], before[i, 2]
        dx, dy, dz = x - reference[i, 0], y - reference[i, 1], z - reference[i, 2]
        gone = dx * dx + dy * dy + dz * dz
        dx, dy, dz = after[i, 0] - x, after[i, 1] - y, after[i, 2] - z
        way = dx * dx + dy * dy + dz * dz
        # saves the roots
        if left > 0.0 and max(gone, way) <= left * left / 9.0:
            continue
        if not math.sqrt(gone) + 2.0 * math.sqrt(way) <= left:
            return False
    return True


@njit(**KERNEL)
def _look(
    watched,
    known,
    cells,
    pairs,
    law,
    rows,
    before,
    after,
    speed,
    end_speed,
    elapsed,
    dt,
    way,
    slack,
    tolerance,
):
    """Return the part of a step to be taken, as :func:`.forces.missed_contact` does.

    Also how many pairs are watched, of which ``known`` (-1: none yet) were before, and whether they
    were searched for anew.
    """
    reference, room, places, found = watched.reference, watched.room, watched.places, watched.found
    renewed = known < 0 or not _has_room(reference, room, before, after, slack)
    if renewed:
        for i in range(room.size):
            square = 0.0
            for k in range(3):
                reference[i, k] = rows[i, k]
                square += (after[i, k] - before[i, k]) ** 2
            room[i] = max(watched.least, _STEPS * math.sqrt(square)) + 2.0 * slack
        known = pairs_about_to_touch(pairs, rows, elapsed, room, places)
    forming = forming_pairs(
        places[:known],
        pairs,
        cells.radius,
        cells.radius_rate,
        before,
        after,
        speed,
        end_speed,
        elapsed,
        dt,
        way,
        tolerance,
        found,
    )
    part = 1.0
    if forming > 0:
        part = missed_contact(
            cells,
            pairs,
            law,
            rows,
            found[:forming],
            before,
            after,
            speed,
            end_speed,
            elapsed,
            dt,
            tolerance,
        )
    return part, known, renewed


class Watched(NamedTuple):
    """Arrays of a watch: where cells were, their room, places in the list of pairs.

    ``found`` are those that come into contact in the last step, ``least`` the least room, µm.
    """

    reference: FloatArray
    room: FloatArray
    places: NDArray[np.int64]
    found: NDArray[np.int64]
    least: float


@final
class ContactWatch:
    """The pairs of a coupling step that are watched."""

    def __init__(self, motion: Motion) -> None:
        self._motion = motion
        room, none = np.empty(len(motion.radius)), np.empty(0, dtype=np.int64)
        least = _LEAST * motion.largest_radius
        self._watched = Watched(np.empty((len(room), 3)), room, none, none, least)
        self._pairs: PairList | None = None
        self._since, self._known = 0.0, -1

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
        if self._pairs is not pairs:
            self._pairs, self._known, self._since = pairs, -1, end
            places, found = np.empty((2, len(pairs.first)), dtype=np.int64)
            self._watched = self._watched._replace(places=places, found=found)
        motion, dt = self._motion, end - begin
        # radii change, and gaps below the tolerance are looked at wherever cells go
        slack = motion.fastest_growth * (abs(begin - self._since) + dt) + 0.5 * tolerance
        part, self._known, renewed = _look(
            self._watched,
            self._known,
            *kernel,
            *path,
            begin - motion.begin,
            dt,
            way,
            slack,
            tolerance,
        )
        if renewed:
            self._since = end
        return float(part)
