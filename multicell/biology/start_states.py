"""States of the cells at the start that fit the field which they make.

If all cells took up at the full rate before any rests or is dead, the field of a large tissue would
be far too low, and most of it would die at once. So the states are those of tissue that has been
there for long: cells short of a nutrient are quiescent, dead ones take up nothing, and the
field is that of the cells as they are. Each state that is taken up makes the field rise, so that
as few as possible take it: the poorest cells, and no more than leave none of the others beyond the
threshold. First the resting ones are found, with nobody dead; then the dead among these; then some
of those that rest find enough and wake, which may cost more lives, until nothing changes. The dead
become more and the resting ones fewer in each pass, so that this ends.

How many of the poorest is found by bisection, to a small part of a layer of cells; the cells are
ranked anew in each field. Who dies at a rate (``death.necrosis_rate``) or of damage is not dead at
the start.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Final, final

import numpy as np

from multicell.biology.cycle import time_before_phase, volume_in_phase
from multicell.biology.responding import rate_of_harm, wants_rest
from multicell.cells import SPHERE, Cells, FloatArray, IntArray, Mask, Phase, Signals, State

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan


MAX_PASSES: Final = 20
"""Passes in which resting and dead cells are found in turn."""

_PART_OF_LAYER: Final = 0.05
"""Cells in doubt that are left, over the number of cells to the power 2/3: 1 % of the surface."""

_RESTS = ("state", "phase", "progress", "phase_length", "age", "radius")
"""Columns that change where a cell rests from the start."""


@final
class StartStates:
    """Search for the states at the start.

    - ``cells``: as they are drawn; those that are dead or rest already stay as they are
    - ``field``: solve the fields for cells; return their concentrations, name -> (n,) mM
    - ``tabled``: whether a table gives their places in the cycle
    """

    def __init__(
        self,
        plan: BiologyPlan,
        cells: Cells,
        field: Callable[[Cells], Signals],
        *,
        tabled: bool = False,
    ) -> None:
        self._plan, self._first, self._field = plan, cells, field
        self._rested = _rest_for_long(plan, cells)
        self._may_rest = cells.state == State.PROLIFERATING
        if plan.restricted and tabled:
            self._may_rest[:] = False  # the table gives their places in the cycle
        self._may_die = ~cells.dead
        self.rests = np.zeros(len(cells), dtype=bool)
        self.dead = np.zeros(len(cells), dtype=bool)
        self._few = int(_PART_OF_LAYER * len(cells) ** (2.0 / 3.0))

    def find(self, signals: Signals) -> tuple[Cells, int]:
        """Return the cells in their states, and how many of them do not fit their field.

        ``signals`` are those with the present states.
        """
        for _ in range(MAX_PASSES):
            before = self.rests.copy(), self.dead.copy()
            signals = self._let_rest(signals)
            signals = self._let_die(signals)
            if all(map(np.array_equal, before, (self.rests, self.dead))):
                break
        now = self._cells()
        left = ~self.dead & self._may_die & self._starve(signals)
        awake = ~self.dead & ~self.rests & self._may_rest
        left |= awake & wants_rest(self._plan, now, signals)
        return now, int(left.sum())

    def _let_rest(self, signals: Signals) -> Signals:
        """Make cells quiescent that lack a nutrient, and wake those that have enough."""

        def poor(signals: Signals) -> Mask:
            lacking = wants_rest(self._plan, self._first, signals)
            return np.asarray(self._may_rest & ~self.dead & lacking)

        here = poor(signals)
        pool = np.flatnonzero(np.where(self.rests, self._may_rest & ~here & ~self.dead, here))
        # those who already rest and find enough are left where there are few of them
        if not pool.size or (self.rests[pool].all() and pool.size <= self._few):
            return signals
        return self._turn(self.rests, pool, poor, signals, resting=True)

    def _let_die(self, signals: Signals) -> Signals:
        """Let the cells die whose signals are beyond a threshold of death."""

        def starved(signals: Signals) -> Mask:
            return np.asarray(self._may_die & ~self.dead & self._starve(signals))

        pool = np.flatnonzero(starved(signals))
        return (
            self._turn(self.dead, pool, starved, signals, resting=False) if pool.size else signals
        )

    def _starve(self, signals: Signals) -> Mask:
        """Return which cells would die at once at their signals, (n,)."""
        hazard = rate_of_harm(self._plan, "necrosis rate", signals, self._first)
        return np.zeros(len(self.dead), dtype=bool) if hazard is None else np.isinf(hazard)

    def _turn(
        self,
        turned: Mask,
        pool: IntArray,
        short: Callable[[Signals], Mask],
        signals: Signals,
        *,
        resting: bool,
    ) -> Signals:
        """Turn the poorest of a pool, as few as leave no other cell short; return signals.

        ``turned`` is changed.
        """
        tried = -1

        def enough(count: int) -> bool:
            """Turn the first of the pool; return whether none of the other cells is short."""
            nonlocal signals, tried
            turned[pool] = np.arange(len(pool)) < count
            signals, tried = self._field(self._cells()), count
            return not (short(signals) & ~turned).any()

        def rank(begin: int, end: int) -> None:
            """Put the poorest first in a part of the pool."""
            part = pool[begin:end]
            plenty = _plenty(self._plan, self._first, signals, resting)[part]
            pool[begin:end] = part[np.argsort(plenty, kind="stable")]

        low, high, waking = 0, len(pool), bool(turned[pool[0]])
        rank(low, high)
        if waking and enough(0):
            return signals
        while high - low > max(1, self._few):
            middle = (low + high) // 2
            if enough(middle):
                high = middle
            else:
                low = middle
                rank(low, high)
        if tried != high:
            enough(high)
        return signals

    def _cells(self) -> Cells:
        """Return the cells in the states that are being tried."""
        now = self._first.shared()
        for name in _RESTS:
            mine, resting = getattr(self._first, name), getattr(self._rested, name)
            setattr(now, name, np.where(self.rests & ~self.dead, resting, mine))
        now.state[self.dead] = State.NECROTIC
        now.age[self.dead] = 0.0
        return now


def _rest_for_long(plan: BiologyPlan, cells: Cells) -> Cells:
    """Return the cells as they are if they have rested for long.

    Where they rest in G0 only, they have come to the end of G1, and have the size of cells there.
    """
    rested = cells.copy()
    rested.state[:] = State.QUIESCENT
    if plan.restricted:
        rested.phase[:] = Phase.G0
        rested.progress[:] = rested.phase_length[:] = 0.0
        rested.age = time_before_phase(plan, rested)[:, 0]
        volume = plan.birth_volumes(rested.kind) * volume_in_phase(plan, rested)
        rested.radius = np.cbrt(volume / SPHERE)
    return rested


def _plenty(plan: BiologyPlan, cells: Cells, signals: Signals, resting: bool) -> FloatArray:
    """Return the smallest ratio of signals over thresholds of each cell, (n,).

    Those that rest because of pressure have less than none.
    """
    least = np.full(len(cells), np.inf)
    # over a threshold next to nothing a ratio may be infinite; one of zero excludes nobody
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        for part in plan.responses.get("rest" if resting else "necrosis rate", ()):
            level, middle = part.level(signals, cells, None), part.effect.law.middle
            if part.needs == {"pressure"}:
                ratio = np.where(part.share(signals, cells) > 0.0, -1.0, np.inf)
            elif middle == 0.0:
                continue
            elif part.effect.falls == (part.effect.high > part.effect.low):
                ratio = level / middle
            else:
                ratio = np.where(level > 0.0, middle / level, np.inf)
            if part.mask is not None:
                ratio = np.where(part.mask[cells.kind], ratio, np.inf)
            least = np.minimum(least, ratio)
    return least
