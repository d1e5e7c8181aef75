"""The list of neighbours of a coupling step, which follows the cells as they move."""

from __future__ import annotations

import math
from typing import final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import FloatArray
from multicell.mechanics.neighbours.building import empty_list
from multicell.mechanics.neighbours.margins import WIDEST, widened
from multicell.mechanics.neighbours.pair_list import CHUNK, IndexArray, ListArrays, PairList
from multicell.mechanics.neighbours.periodic import rebuild_periodic
from multicell.mechanics.neighbours.repairing import FEW
from multicell.mechanics.neighbours.updating import (
    BUILT,
    REPAIRED,
    TOO_CROWDED,
    kernels,
    update_list,
)

Room = tuple[IndexArray, IndexArray]
"""First and second cells of a list that nobody needs any more, to be overwritten."""

NO_ROOM: Room = (np.empty(0, dtype=np.int32), np.empty(0, dtype=np.int32))
_KEPT = 50
"""Places of a list for each cell up to which it is kept for the next: twice what is usual."""


@final
class NeighbourList:
    """All pairs of cells that may touch while no cell drifts further than its margin.

    The list holds the pairs closer than the sum of both cells' ``reach`` and ``margin`` where the
    cells were last time, at ``reference``. It serves one coupling step, and changes in
    :meth:`update` alone; a compiled loop makes the same change by
    :func:`.updating.update_list`, and gives its list back to :meth:`adopt`.

    - ``reach``, (n,), µm: half of the distance within which a pair matters
    - ``least``, µm: the least margin, that of all cells at the beginning
    - ``chunk``: cells in a chunk
    - ``newborn``, (n,) bool, optional: cells that part first of all, with wide margins from the
      beginning where they are few
    - ``room``: arrays for the first list, see :meth:`release`
    - ``shared``: whether threads share the search; same list
    - ``period``, (3,), µm, optional: lengths after which space repeats; zero: not along this axis.
      Margins are then at most what leaves one image of each cell in reach of another one.

    Attributes
    ----------
    pairs : PairList, optional
        The list; None before the first update, and after one that found too many pairs.
    reference : array, (n, 3)
        Where the cells were, µm; not a number without a list.
    margin : array, (n,)
        How far each cell may drift from there, µm.
    """

    def __init__(
        self,
        reach: FloatArray,
        least: float,
        *,
        chunk: int = CHUNK,
        newborn: NDArray[np.bool_] | None = None,
        room: Room = NO_ROOM,
        shared: bool = False,
        period: FloatArray | None = None,
    ) -> None:
        n = len(reach)
        self.reach, self.least, self.chunk, self.shared = reach, least, chunk, shared
        self.reference, self.margin = np.empty((n, 3)), np.empty(n)
        self.reference.fill(np.nan)
        self.margin.fill(least)
        if newborn is not None and 0 < np.count_nonzero(newborn) * FEW <= n:
            self.margin[newborn] *= WIDEST
        self.pairs: PairList | None = None
        self._room, self._period = room, period

    def __len__(self) -> int:
        """Return the number of cells."""
        return len(self.reach)

    def update(self, position: FloatArray) -> int:
        """Bring the list up to date where cells have drifted: at ``position``, (n, 3) µm, finite.

        Returns ``REPAIRED``, ``BUILT`` or ``TOO_CROWDED`` of :mod:`.updating`. Lists that stood
        here before are left as they are: whoever has linearised with one still needs it.
        """
        n, last = len(self), self.pairs
        if n < 2:
            self.reference[:], self.pairs = position, empty_list(n, self.chunk)
            return BUILT
        if self._period is not None:
            return self._rebuild(position, self._period)
        rebuild, repair = kernels(n, shared=self.shared)
        first, second, *ends = self.hand_out()
        if last is None:
            repair = 0
        elif repair != 0:
            first, second = first.copy(), second.copy()
        room = (first, second) if last is None else self._room
        # a copy of one type, for which kernels are compiled once
        found, arrays = update_list(
            rebuild,
            repair,
            np.array(position),
            self.reference,
            self.reach,
            self.margin,
            self.least,
            self.chunk,
            (first, second, *ends),
            *room,
        )
        if found != REPAIRED:
            self._room = NO_ROOM
        self.adopt(arrays)
        return int(found)

    def _rebuild(self, position: FloatArray, period: FloatArray) -> int:
        """Build the list anew where space repeats; see :meth:`update`."""
        widened(np.array(position), self.reference, self.reach, self.least, self.margin)
        np.minimum(self.margin, 0.25 * period[period > 0.0].min() - self.reach, out=self.margin)
        wide = self.reach + self.margin
        crowded, arrays = rebuild_periodic(position, wide, self.chunk, period, shared=self.shared)
        self.reference[0, 0] = np.nan if crowded else self.reference[0, 0]
        self.adopt(arrays)
        return TOO_CROWDED if crowded else BUILT

    def hold_no_pairs(self) -> None:
        """Be empty however far cells drift, where they do not act on each other."""
        self.reference[:], self.margin[:] = 0.0, np.inf
        self.pairs = empty_list(len(self), self.chunk)

    def hand_out(self) -> ListArrays:
        """Return the list as :func:`.updating.update_list` takes it; without one, room for it."""
        if self.pairs is not None:
            return self.pairs.arrays
        room, self._room = self._room, NO_ROOM
        ends = np.zeros(-(-len(self) // self.chunk), dtype=np.int64)
        return room[0], room[1], ends, ends, ends

    def adopt(self, arrays: ListArrays) -> None:
        """Take the list that :func:`.updating.update_list` has left, in the same form."""
        lost = math.isnan(self.reference.item(0))
        self.pairs = None if lost else PairList(*arrays, self.chunk, len(self))

    def release(self, n: int) -> Room:
        """Give up the list; return its arrays as room for the next one, of ``n`` cells."""
        last, self.pairs = self.pairs, None
        if last is not None and len(last.first) <= _KEPT * (n + 100):
            return last.first, last.second
        return self._room
