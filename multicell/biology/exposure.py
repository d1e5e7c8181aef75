"""Exposure of cells over a coupling step: signals in time, and integrals of rates over them.

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
from functools import cached_property, partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final, NamedTuple, final

import numpy as np

from multicell import random
from multicell.biology.responding import rate_of
from multicell.cells import HALF, SPHERE, Cells, FloatArray, IntArray, Signals, rows_before

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan
    from multicell.biology.responding import Known
    from multicell.biology.waiting import Awaited
    from multicell.random import Purpose

Course = tuple[FloatArray, FloatArray]
"""Parts of a step, (m,), rising from 0 to 1, and the signals at cells then, (m, n)."""

Rate = Callable[[Signals, Cells], Any]
"""Signals and cells at one moment -> a rate of each cell, (n,) or (n, k) 1/s."""

_CARRIED: Final = ("age", "radius", "pressure")
"""Columns of the cells that signals are made of and that change within a step."""

_OF_CELLS: Final = frozenset({*_CARRIED, "volume"})

_ENDS: Final = np.array([0.0, 1.0])

_MOST_JUMPS: Final = 32  # of a steady field in a step, by deaths in it

_AFTER: Final = 1e-9  # of a step, after which a death has changed it


@final
class Jumps(NamedTuple):
    """Jumps of signals within a step, at moments of each cell's own.

    - ``part``, (m, n): parts of the step at which they are, rising; 1 where there is none
    - ``first``, ``last``, name -> (m, n): their sizes if they were at the step's begin, and end
    """

    part: FloatArray
    first: Mapping[str, FloatArray]
    last: Mapping[str, FloatArray]

    def of_some(self, rows: IntArray) -> Jumps:
        """Return those of some of the cells."""
        first, last = ({x: sizes[:, rows] for x, sizes in end.items()} for end in self[1:])
        return Jumps(self.part[:, rows], first, last)

    def of_signals(self, names: Collection[str]) -> FloatArray | None:
        """Return the parts of the step at which any of the signals may jump, (m, n), or None."""
        return None if self.first.keys().isdisjoint(names) else self.part

    def sizes(self, name: str, part: Any, jumped: Any) -> FloatArray:
        """Return the sum of the jumps of a signal at a part of the step, (n,).

        - ``jumped``: part of the step until which jumps count
        """
        sizes = self.first[name] + part * (self.last[name] - self.first[name])
        return np.asarray(np.where(self.part <= jumped, sizes, 0.0).sum(axis=0))


@final
class Exposure:
    """The signals of cells over a coupling step; nothing is computed before it is asked for.

    - ``cells``, ``signals``: at its end
    - ``length``, s
    - ``began``, ``before``: cells and signals at its beginning; absent: as at the end
    - ``inner``, name -> Course: what is known in between
    - ``held``: signals that jump at the end of the step, before which they were as at its beginning
    - ``jumps``: of signals within it, by deaths and changes of neighbours

    - ``until``, (n,) or a number: part of the step after which nothing counts
    """

    def __init__(
        self,
        cells: Cells,
        signals: Signals,
        length: float,
        *,
        began: Cells | None = None,
        before: Signals | None = None,
        inner: Mapping[str, Course] | None = None,
        held: Collection[str] = (),
        jumps: Jumps | None = None,
    ) -> None:
        self.cells, self.signals, self.length = cells, signals, length
        self.began = cells if began is None else began
        self.before = signals if before is None else before
        self.inner, self.held, self.jumps = inner or {}, held, jumps
        self.until: Any = 1.0
        self._known: dict[str, Course] = {}

    @cached_property
    def row(self) -> IntArray:
        """Rows of the cells, or of their mothers, at the beginning of the step, (n,)."""
        return rows_before(self.began, self.cells)

    def __getitem__(self, rows: IntArray) -> Exposure:
        """Return that of some of the cells."""
        part = Exposure(
            self.cells.take(rows),
            {name: x[rows] for name, x in self.signals.items()},
            self.length,
            began=self.began,
            before=self.before,
            held=self.held,
            inner={name: (at, values[:, rows]) for name, (at, values) in self.inner.items()},
            jumps=None if self.jumps is None else self.jumps.of_some(rows),
        )
        part.row = self.row[rows]
        return part

    def volume_at(self, part: FloatArray) -> FloatArray:
        """Return the volumes of living cells at parts of the step, (n,) µm³."""
        first, last = (SPHERE * x**3 for x in self._course("radius")[1])
        return np.asarray(first + part * (last - first))

    def _course(self, name: str) -> Course:
        """Return a signal in time, or a column that signals are made of."""
        if name not in self._known:
            if name in _CARRIED:
                ends = self._ends(name)
            else:
                first, last = self.before[name][self.row], self.signals[name]
                ends = np.stack([first, first if name in self.held else last])
            found = self.inner.get(name)
            self._known[name] = (_ENDS, ends) if found is None else _joined(found, ends)
        return self._known[name]

    def _ends(self, name: str) -> FloatArray:
        first, last = getattr(self.began, name)[self.row], getattr(self.cells, name)
        if name == "age":
            first = np.maximum(last - self.length, 0.0)
        elif name == "radius":  # until it was born a cell was half of its mother
            first = np.where(self.began.id[self.row] == self.cells.id, 1.0, HALF) * first
        return np.stack([first, last])

    def integral(self, known: Known, rate: Rate, since: Any = 0.0) -> Any:
        """Return the integral of a finite rate over the step, (n,) or (n, k).

        - ``known``: the responses that make the rate
        - ``since``, (n,) or a number: part of the step from which it counts
        """
        total: Any = 0.0
        for low, high in self._parts(known):
            low = np.maximum(low, since)
            share = np.maximum(high - low, 0.0)
            value = np.asarray(rate(*self._at(0.5 * (low + high), known))).T
            total = total + value * (share * self.length)
        return np.asarray(total).T

    def reached(self, known: Known, rate: Rate, share: FloatArray, since: Any = 0.0) -> FloatArray:
        """Return at which part of the step an integral comes to a share of what it gains, (n,).

        - ``known``: the responses that make the rate, which is finite, (n,), or of which all (n, k)
          are added
        - ``since``, (n,) or a number: part of the step from which it counts
        """
        pieces = []
        for low, high in self._parts(known):
            low = np.maximum(low, since)
            width = np.maximum(high - low, 0.0)
            value = rate(*self._at(0.5 * (low + high), known))
            pieces.append((low, width, width * (value if value.ndim == 1 else value.sum(axis=1))))
        left = share * sum(gain for *_, gain in pieces)
        found = np.full(len(self.cells), np.inf)
        for low, width, gain in pieces:
            within = np.isinf(found) & (gain > 0.0) & (left <= gain)
            found = np.where(within, low + width * left / np.where(within, gain, 1.0), found)
            left = left - gain
        return np.asarray(np.minimum(found, self.until))  # rounding may leave something over

    def pieces(self, known: Known, rate: Rate) -> Iterator[tuple[Any, Any, Any]]:
        """Yield begin and end, in parts of the step, of pieces, and the finite rate in each."""
        for low, high in self._parts(known):
            yield low, high, rate(*self._at(0.5 * (low + high), known))

    def at(self, part: Any, known: Known, rate: Rate) -> Any:
        """Return a rate or chance at a part of the step, that of each cell or one for all."""
        return rate(*self._at(part, known))

    def first_infinite(self, known: Known, rate: Rate) -> FloatArray:
        """Return at which part of the step a rate becomes infinite, (n,); infinite where not.

        - ``known``: the responses that make the rate
        """
        first = np.full(len(self.cells), np.inf)
        for low, high in self._parts(known):
            acts = np.isinf(rate(*self._at(0.5 * (low + high), known))) & (high > low)
            first = np.where(acts, np.minimum(first, low), first)
        return first

    def first_beyond(self, awaited: Awaited, since: FloatArray) -> FloatArray:
        """Return at which part of the step a signal comes beyond a value, (n,); infinite: never.

        - ``since``, (n,): part of the step from which it counts
        """
        first, one = np.full(len(self.cells), np.inf), (awaited,)
        for low, high in self._between_jumps(one):
            begin, middle = np.maximum(low, since), 0.5 * (low + high)
            before, after = (
                awaited.sign * (awaited.level(*self._at(part, one, middle), None) - awaited.value)
                for part in (begin, high)
            )
            rise = np.where(after > before, after - before, 1.0)
            passes = begin + (high - begin) * np.where(before > 0.0, 0.0, -before / rise)
            beyond = (begin < high) & ((before > 0.0) | (after > 0.0))
            first = np.minimum(first, np.where(beyond, passes, np.inf))
        return first

    def remainder(self, known: Known, rate: Rate, slope: float | None) -> tuple[float, float]:
        """Return about how far off the integral is, and the slope of the rate at its end, 1/s².

        Of all living cells together. By every other of the moments that are known; of the ends
        alone by Euler and Maclaurin, Δt²/12 times by how much the slope has changed.

        - ``slope``, 1/s²: at the end of the step before; None: it may have jumped since
        """
        knots, living = self._knots(known), ~self.cells.dead
        # jumps are exact: what is left out lies between them
        rates = np.array(
            [rate(*self._at(part, known, -1.0))[living].sum() for part in knots.tolist()]
        )
        ahead = float(rates[-1] - rates[-2]) / float(knots[-1] - knots[-2]) / self.length
        if len(knots) == 2:
            change = 0.0 if slope is None else ahead - slope
            return self.length**2 / 12.0 * change, ahead
        fewer = np.unique([*range(0, len(knots), 2), len(knots) - 1])
        all_of_them, half = (np.trapezoid(rates[k], knots[k]) for k in (slice(None), fewer))
        return self.length * float(half - all_of_them) / 3.0, ahead

    def _knots(self, known: Known | tuple[Awaited]) -> FloatArray:
        """Return the moments at which all that a rate depends on is known, in parts of the step."""
        times = [self.inner[name][0] for name in _needs(known) & self.inner.keys()]
        return np.unique(np.concatenate(times)) if times else _ENDS

    def _between_jumps(self, known: Known | tuple[Awaited]) -> Iterator[tuple[Any, Any]]:
        """Yield begin and end, in parts of the step, of pieces in which all signals are linear."""
        jumps = None if self.jumps is None else self.jumps.of_signals(_needs(known))
        for low, high in pairwise(self._knots(known).tolist()):
            inside = () if jumps is None else np.clip(jumps, low, high)
            yield from pairwise((low, *inside, high))

    def _parts(self, known: Known) -> Iterator[tuple[Any, Any]]:
        """Yield begin and end, in parts of the step, of what no kink of a law lies within."""
        for low, high in self._between_jumps(known):
            cuts = list(self._cuts(known, low, high))
            inside = np.sort(np.stack(cuts), axis=0) if cuts else ()
            for begin, end in pairwise((low, *inside, high)):
                yield np.minimum(begin, self.until), np.minimum(end, self.until)

    def _cuts(self, known: Known, low: Any, high: Any) -> Iterator[FloatArray]:
        """Yield where between two parts of the step signals pass kinks, (n,); else at ``high``."""
        for part in known:
            kinks = part.effect.law.kinks
            if not kinks:
                continue
            middle = 0.5 * (low + high)
            first, last = (part.level(*self._at(s, known, middle), None) for s in (low, high))
            for kink in kinks:
                passes = (first < kink) != (last < kink)
                if passes.any():
                    change = np.where(passes, last - first, 1.0)
                    yield np.where(passes, low + (high - low) * ((kink - first) / change), high)

    def _at(
        self, part: Any, known: Known | tuple[Awaited], jumped: Any = None
    ) -> tuple[Signals, Cells]:
        """Return signals and cells at a part of the step: one for all, or that of each, (n,).

        - ``jumped``: the part of it until which jumps count; absent: until then
        """
        names = _needs(known)
        signals = {name: self._value(name, part) for name in names - _OF_CELLS}
        if self.jumps is not None:
            for name in names & self.jumps.first.keys():
                signals[name] += self.jumps.sizes(name, part, part if jumped is None else jumped)
        cells = self.cells.shared()
        for name in _CARRIED:
            if name in names or (name == "radius" and "volume" in names):
                setattr(cells, name, self._value(name, part))
        return signals, cells

    def _value(self, name: str, part: Any) -> FloatArray:
        at, values = self._course(name)
        if len(at) == 2:
            return np.asarray(values[0] + part * (values[1] - values[0]))
        before = np.clip(np.searchsorted(at, part, side="right") - 1, 0, len(at) - 2)
        share = (part - at[before]) / (at[before + 1] - at[before])
        every = np.arange(values.shape[1])
        first, last = values[before, every], values[before + 1, every]
        return np.asarray(first + share * (last - first))


def _needs(known: Known | tuple[Awaited]) -> frozenset[str]:
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


def course_with_deaths(
    first: FloatArray, alone: FloatArray, last: FloatArray, until: FloatArray
) -> Course:
    """Return the course of a steady field through a step in which cells die.

    It goes linearly from ``first`` to where it would be with all of them, ``alone``, (n,) mM. What
    their deaths change at the end, to ``last``, comes in equal parts when they die, never before.

    - ``until``, (n,): parts of the step until which cells lived
    """
    died = np.sort(until[until < 1.0])
    group = max(-(-len(died) // _MOST_JUMPS), 1)
    jumps = died[::-1][::group][::-1]
    at = np.unique(np.concatenate([_ENDS, jumps, np.minimum(jumps + _AFTER, 1.0)]))
    done = np.append(0, np.searchsorted(died, jumps, side="right")) / max(len(died), 1)
    share = done[np.searchsorted(jumps, at)]
    values = first + at[:, None] * (alone - first) + share[:, None] * (last - alone)
    return at, values


def remainders(
    plan: BiologyPlan, exposure: Exposure, before: Mapping[str, float], *, jumped: bool
) -> dict[str, float]:
    """Return about how many events steps have made too many so far, as ``error``, and slopes.

    - ``before``: the same of the step before; empty at the start
    - ``jumped``: whether something scheduled has changed since
    """
    found = {"error": before.get("error", 0.0)}
    for name in plan.acting:
        slope = None if jumped else before.get(name)
        rate = partial(finite_rate, plan, name)
        error, found[name] = exposure.remainder(plan.responses[name], rate, slope)
        found["error"] += error
    return found


def finite_rate(plan: BiologyPlan, name: str, signals: Signals, cells: Cells) -> FloatArray:
    """Return a rate without that of death at once, (n,) 1/s."""
    rate = rate_of(plan, name, signals, cells)
    return np.where(np.isinf(rate), 0.0, rate)


def part_until(
    plan: BiologyPlan,
    purpose: Purpose,
    ids: IntArray,
    before: FloatArray,
    gained: FloatArray,
    number: int | IntArray = 0,
) -> FloatArray:
    """Return at which part of its gain an integral reaches the cell's threshold, (n,).

    Infinite where it does not; ``number`` distinguishes events of the same cell.
    """
    part = np.full(len(ids), np.inf)
    grows = (gained > 0.0).nonzero()[0]
    if grows.size:
        event = np.broadcast_to(number, len(ids))[grows]
        threshold = random.thresholds(plan.seed, purpose, event, ids[grows])
        # who is beyond it already, by a rounding or by a user's hand, is so from the beginning on
        with np.errstate(over="ignore"):  # of next to nothing gained, infinitely many are needed
            part[grows] = np.maximum((threshold - before[grows]) / gained[grows], 0.0)
    return np.where(part <= 1.0, part, np.inf)
