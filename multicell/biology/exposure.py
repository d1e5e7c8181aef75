"""What a coupling step knows of signals in time, and the integrals of rates over it.

A rate acts through its integral over the step, from signals that are linear in time between the
moments at which they are known: the step's two ends, and for transient fields the times of their
solver in between. Each such piece is cut where a signal passes a threshold or another kink of a
law, cell by cell, and the rate is taken in the middle of every part. So a threshold acts for
exactly the time that the signal is beyond it, and all else is of second order in the step.

An event (death, a change of type) comes to pass where the integral of its rate reaches a threshold
of the cell's own, which is exponential with mean 1. It is drawn once for a cell and event, so that
steps of all lengths see the same draws. Daughters begin at zero with thresholds of their own; an
exponential has no memory, so that this is what an undivided cell would have before it, too. In the
step of its birth a daughter has been exposed as its mother was before: two daughters that are each
at risk for the whole step are as many in the mean as a mother at risk before and both after.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from multicell import random
from multicell.cells import HALF, Cells, FloatArray, Found, IntArray, Mask, rows_before

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan
    from multicell.biology.responding import Known
    from multicell.random import Purpose

Course = tuple[FloatArray, FloatArray]
"""Parts of a step, (m,), rising from 0 to 1, and what cells find then, (m, n)."""

Rate = Callable[[Found, Cells], Any]
"""Signals and cells at one moment -> a rate of each cell, (n,) or (n, k) 1/s."""

_CARRIED: Final = ("age", "radius", "pressure")
"""Columns of the cells that signals are made of and that change within a step."""

_OWN: Final = frozenset({*_CARRIED, "volume"})


@final
class Exposure:
    """The signals of cells over a coupling step.

    - ``cells``, ``found``: at its end
    - ``length``, s
    - ``began``, ``before``: cells and signals at its beginning; absent: as at the end
    - ``inner``, name -> Course: what is known in between
    - ``held``: signals that jump at the end of the step, before which they were as at its beginning
    """

    def __init__(
        self,
        cells: Cells,
        found: Found,
        length: float,
        *,
        began: Cells | None = None,
        before: Found | None = None,
        inner: Mapping[str, Course] | None = None,
        held: Collection[str] = (),
    ) -> None:
        self.cells, self.length = cells, length
        ends = {name: np.stack([values, values]) for name, values in found.items()}
        ends |= {name: np.stack([getattr(cells, name)] * 2) for name in _CARRIED}
        if began is not None and before is not None:
            row = rows_before(began, cells)
            born = began.id[row] != cells.id
            for name in found:
                ends[name][0] = before[name][row]
            for name in held:
                ends[name][1] = ends[name][0]
            ends["age"][0] = np.maximum(cells.age - length, 0.0)
            ends["pressure"][0] = began.pressure[row]
            ends["radius"][0] = np.where(born, HALF, 1.0) * began.radius[row]
        self._ends = ends
        self._inner = {name: _joined(x, ends[name]) for name, x in (inner or {}).items()}

    def __getitem__(self, rows: IntArray) -> Exposure:
        """Return that of some of the cells."""
        part = object.__new__(Exposure)
        part.cells, part.length = self.cells.take(rows), self.length
        part._ends = {name: ends[:, rows] for name, ends in self._ends.items()}
        part._inner = {name: (at, values[:, rows]) for name, (at, values) in self._inner.items()}
        return part

    def integral(self, known: Known, rate: Rate, since: Any = 0.0) -> Any:
        """Return the integral of a rate over the step, (n,) or (n, k); infinite for death at once.

        - ``known``: the responses that make the rate
        - ``since``, (n,) or a number: part of the step from which it counts
        """
        total = 0.0
        for low, high in self._parts(known):
            share = np.maximum(high - np.maximum(low, since), 0.0)
            moment = 0.5 * (np.maximum(low, since) + high)
            value = np.asarray(rate(*self._at(moment, known))).T
            with np.errstate(invalid="ignore"):  # an infinite rate that acts for no time
                acts = np.where(share > 0.0, value * share, 0.0)
            total = total + self.length * acts
        return np.asarray(total).T

    def _parts(self, known: Known) -> Iterator[tuple[Any, Any]]:
        """Yield begin and end, in parts of the step, of what no kink of a law lies within."""
        names = _needs(known)
        times = [self._inner[name][0] for name in names if name in self._inner]
        knots = np.unique(np.concatenate(times)) if times else np.array([0.0, 1.0])
        for low, high in pairwise(knots.tolist()):
            cuts = list(self._cuts(known, low, high))
            inside = np.sort(np.stack(cuts), axis=0) if cuts else ()
            yield from pairwise((low, *inside, high))

    def _cuts(self, known: Known, low: float, high: float) -> Iterator[FloatArray]:
        """Yield where between two parts of the step signals pass kinks, (n,); else at ``high``."""
        for part in known:
            kinks = part.effect.law.kinks
            if not kinks:
                continue
            first, last = (part.level(*self._at(s, known), None) for s in (low, high))
            for kink in kinks:
                passes = (first < kink) != (last < kink)
                if passes.any():
                    change = np.where(passes, last - first, 1.0)
                    yield np.where(passes, low + (high - low) * ((kink - first) / change), high)

    def _at(self, part: Any, known: Known) -> tuple[Found, Cells]:
        """Return signals and cells at a part of the step: one for all, or that of each, (n,)."""
        names = _needs(known)
        found = {name: self._value(name, part) for name in names - _OWN}
        cells = self.cells.shared()
        for name in ("age", "pressure"):
            if name in names:
                setattr(cells, name, self._value(name, part))
        if "radius" in names or "volume" in names:
            cells.radius = self._value("radius", part)
        return found, cells

    def _value(self, name: str, part: Any) -> FloatArray:
        if name not in self._inner:
            first, last = self._ends[name]
            return np.asarray(first + part * (last - first))
        at, values = self._inner[name]
        before = np.clip(np.searchsorted(at, part, side="right") - 1, 0, len(at) - 2)
        share = (part - at[before]) / (at[before + 1] - at[before])
        every = np.arange(values.shape[1])
        first, last = values[before, every], values[before + 1, every]
        return np.asarray(first + share * (last - first))


def _needs(known: Known) -> frozenset[str]:
    return frozenset().union(*(part.needs for part in known))


def _joined(course: Course, ends: FloatArray) -> Course:
    """Return a course between two ends.

    What it knows of the step's beginning is where cells are at its end. The difference to what
    they found fades over the step, as they move.
    """
    at, values = course
    moved = values + (1.0 - at[:, None]) * (ends[0] - values[0])
    moved[-1] = ends[1]
    return at, moved


def part_until(
    plan: BiologyPlan, purpose: Purpose, ids: IntArray, before: FloatArray, gained: FloatArray,
    number: int | IntArray = 0,
) -> FloatArray:  # fmt: skip
    """Return at which part of what an integral has gained it reaches the cell's threshold, (n,).

    Infinite where it does not; ``number`` tells events of the same cell apart.
    """
    part = np.full(len(ids), np.inf)
    grows = np.flatnonzero(gained > 0.0)
    if grows.size:
        event = np.broadcast_to(number, len(ids))[grows]
        threshold = random.thresholds(plan.seed, purpose, event, ids[grows])
        part[grows] = (threshold - before[grows]) / gained[grows]
    return np.where(part <= 1.0, part, np.inf)


def comes_to_pass(
    plan: BiologyPlan, purpose: Purpose, cells: Cells, column: str, gained: FloatArray
) -> Mask:
    """Return which living cells die of what an integral has gained, (n,); it is noted.

    ``column`` is its name, one of :data:`multicell.cells.HAZARDS`.
    """
    gained = np.where(cells.dead, 0.0, gained)
    known = getattr(cells, column)
    before = np.zeros(len(cells)) if known is None else known
    dies = np.isfinite(part_until(plan, purpose, cells.id, before, gained))
    if known is not None or gained.any():
        # an infinite one has no use any more, and files hold finite numbers
        setattr(cells, column, before + np.where(np.isinf(gained), 0.0, gained))
    return np.asarray(dies)
