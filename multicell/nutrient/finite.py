"""A finite volume of stirred medium, which the cells of a field use up.

All the medium of a field is its grid and, beyond that, a part of volume V that is stirred and has
one concentration C. It exchanges with the grid what flows over the sides and what a perfusion
brings, J, and decays as the field does:

    V dC/dt = -J - k_d V C,

with C the boundary value of the field. Where the field is transient, its nodes and C are one state,
which :func:`multicell.nutrient.transient.march` brings forward; where it is steady, the state is
the amount in both, and the field at each moment the steady one of the C with which field and
stirred part together hold that. In each implicit step C is the root of a function that rises with
C, since more flows in where there is more outside.

When the grid follows the tissue, it takes medium in or gives it back: V changes too, and C does not
where the field has the same concentration there.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from multicell.cells import FloatArray
from multicell.errors import NutrientFailed
from multicell.nutrient.transient import Amounts, March, TransientReport, march

if TYPE_CHECKING:
    from multicell.nutrient.field import NutrientField
    from multicell.nutrient.grid import Layout
    from multicell.nutrient.steady import SolveReport
    from multicell.scene.nutrient import Nutrient

_FADED: Final = 1e-3
"""Part of the highest concentration below which a medium that is used up is not followed with an
error relative to itself any more, but to this."""

_MOST: Final = 100
"""Evaluations in which a concentration of the medium must be found; two to four are usual."""

_EXACT: Final = (1e-9, 1e-7)
"""Part of what field and medium hold that may be missing when the medium's concentration is
accepted: the boundary value of the field is so near to it. The second after ``_PATIENCE``
evaluations: what the field's solver leaves over may be as much."""

_PATIENCE: Final = 15


@final
@dataclass(frozen=True)
class Stirred:
    """The stirred part of a medium, with its account from the start on.

    Attributes
    ----------
    amount : float, amol
    volume : float, µm³
    fresh, discarded : float, amol
        What fresh medium brought, at the start and at changes, and what went with the old.
    decayed : float, amol
    changes : int
        How many entries of the schedule have been done.
    """

    amount: float
    volume: float
    fresh: float
    discarded: float = 0.0
    decayed: float = 0.0
    changes: int = 0

    @property
    def concentration(self) -> float:
        """Concentration, mM."""
        return self.amount / self.volume

    def changed(self, concentration: float, part: float) -> Stirred:
        """Return it with a part replaced by fresh medium of a concentration in mM."""
        gone, brought = part * self.amount, part * self.volume * concentration
        return replace(
            self, amount=self.amount - gone + brought, fresh=self.fresh + brought,
            discarded=self.discarded + gone, changes=self.changes + 1,
        )  # fmt: skip


def whole(layout: Layout, values: FloatArray) -> float:
    """Return the volume of all nodes of a layout, µm³."""
    return float(np.sum(np.broadcast_to(layout.volumes, values.shape)))


def poured(name: str, nutrient: Nutrient, covered: float) -> Stirred:
    """Return the medium at the start, round a grid that covers ``covered`` µm³.

    Raises
    ------
    NutrientFailed
        If the grid covers all of it.
    """
    volume, level = _left(name, nutrient, covered), nutrient.medium(0.0)
    done = sum(time <= 0.0 for time, _ in nutrient.media or ())
    return Stirred(level * volume, volume, level * volume, changes=done)


def _left(name: str, nutrient: Nutrient, covered: float) -> float:
    """Return the volume of the medium beyond the grid, µm³."""
    assert nutrient.finite_medium is not None
    volume = nutrient.finite_medium.volume
    if not volume > covered:
        raise NutrientFailed(
            f"the finite medium of {name} is {volume:.4g} um^3 in all, but its grid covers "
            f"{covered:.4g} um^3: nothing is left that could be stirred",
            "Give finite_medium a larger volume, or the field a smaller margin",
        )
    return volume - covered


def advance(
    field: NutrientField,
    position: FloatArray,
    capacity: FloatArray,
    production: FloatArray | None,
    radius: FloatArray,
    begin: float,
    end: float,
) -> TransientReport:
    """Bring a field with its finite medium from ``begin`` to ``end`` (s).

    Parameters as for :meth:`NutrientField.advance`; changes of the medium up to and at ``end`` that
    have not been done are done at their times. A steady field counts as ``relaid`` what its content
    has changed by.

    Raises
    ------
    NutrientFailed
        If a solve fails, or the medium cannot be what cells and grid ask of it; the field then
        still is the last one.
    """
    exchange = _Exchange(field, position, capacity, production, radius, begin, end)
    nutrient, before, now = exchange.nutrient, field.stored(), begin
    for time, level in (nutrient.media or ())[exchange.stirred.changes :]:
        if time > end:
            break
        exchange.march(now, max(time, now))
        assert nutrient.finite_medium is not None
        exchange.settle()
        exchange.stirred = exchange.stirred.changed(level, nutrient.finite_medium.replaced)
        exchange.resume()
        now = max(time, now)
    exchange.march(now, end)
    exchange.settle()
    return exchange.finish(before)


@final
class _Exchange:
    """A field and its medium on the way through one coupling step."""

    def __init__(
        self,
        field: NutrientField,
        position: FloatArray,
        capacity: FloatArray,
        production: FloatArray | None,
        radius: FloatArray,
        begin: float,
        end: float,
    ) -> None:
        assert field.stirred is not None
        self.field, self.nutrient = field, field.parameters.nutrient
        self.steady = field.parameters.regime == "steady"
        layout, self.kept, position = field.lay(position, radius)
        self.layout, old = layout, field.stirred
        values = field._values
        if not self.kept:
            carry = layout.guess if self.steady else layout.carried
            values = carry(values, field.layout, old.concentration)
        self.values = values
        self.whole = whole(layout, values)
        self.relaid = self.content - field.stored()
        self.stirred = replace(
            old,
            volume=_left(field.name, self.nutrient, self.whole),
            amount=old.amount - (0.0 if self.steady else self.relaid),
        )
        self.operator, self.conditions = field._operator_on(
            layout, self.kept, position, radius, begin
        )
        self.sink = layout.scatter(position, capacity)
        self.source = field._supply(layout, position, production, 0.0)
        self.produced = 0.0 if production is None else float(np.sum(production)) * (end - begin)
        self.done = March(Amounts())
        self.decayed = self.washed = self.brought = 0.0
        self.guess = self.stirred.concentration
        self.slope = 0.0  # of what the field takes over the medium's concentration, µm³/s
        self.total = field.stored() + old.amount  # of a steady field with its medium
        self._refuse_overdrawn()

    @property
    def content(self) -> float:
        """What the field holds, amol."""
        return float(np.sum(self.layout.volumes * self.values))

    def _refuse_overdrawn(self) -> None:
        if not self.stirred.amount >= 0.0:
            raise NutrientFailed(
                f"the grid of {self.field.name} came to enclose more than its finite medium holds",
                "Give finite_medium a larger volume, or let the field live on a domain",
            )

    def march(self, begin: float, end: float) -> None:
        """Bring both to ``end`` (s); the medium's account goes along."""
        if not end > begin:
            return
        p, volume, before = self.nutrient, self.stirred.volume, self.done.amounts
        level = max(self.stirred.concentration, _FADED * p.highest)
        if self.steady:
            # the second number is what the field holds: as a difference it would be rounding
            state = march(
                self._step_steady, np.array([0.0, 1.0]), np.array([self.total, self.content]),
                begin, end,
                tolerance=p.time_tolerance, scale=level * volume, done=self.done, opening=1.0,
            )  # fmt: skip
            self.total = float(state[0])
        else:
            volumes = np.append(np.broadcast_to(self.layout.volumes, self.values.shape), 0.0)
            state = march(
                self._step, volumes, np.append(self.values, self.stirred.concentration), begin, end,
                tolerance=p.time_tolerance, scale=level, done=self.done,
            )  # fmt: skip
            self.values = state[:-1].reshape(self.values.shape)
        found = self.done.amounts.plus(before, -1.0)
        decayed = p.decay * volume * found.level
        self.decayed += p.decay * found.mass
        self.washed += p.perfusion * found.mass
        self.brought += p.perfusion * self.whole * found.level
        amount = self.stirred.amount if self.steady else volume * float(state[-1])
        self.stirred = replace(self.stirred, amount=amount, decayed=self.stirred.decayed + decayed)

    def settle(self) -> None:
        """Bring a steady field to rest with its medium: both hold what is there in all."""
        if not self.steady:
            return

        def excess(trial: float) -> float:
            self._solve(trial)
            return self.content + self.stirred.volume * trial - self.total

        self.guess, _ = self._root(excess, self.guess, self.stirred.volume + self.whole)
        # what the balance says, but for rounding beside an empty medium
        amount = self.total - self.content
        self.stirred = replace(self.stirred, amount=amount if amount > 0.0 else 0.0)

    def resume(self) -> None:
        """Take up again after a change of the medium."""
        self.total = self.content + self.stirred.amount
        self.guess = self.stirred.concentration

    def finish(self, before: float) -> TransientReport:
        """Give the field what has been found, and return the account of the step."""
        field, done = self.field, self.done
        medium = field.parameters.sides(0.0, self.stirred.concentration)
        conditions = self.layout.conditions(medium)
        self.operator.set_boundary(conditions)
        field._take(self.layout, self.operator, conditions, self.values, self.kept)
        field.stirred = self.stirred
        return TransientReport(
            done.amounts.inflow + self.brought - self.washed,
            done.amounts.uptake,
            self.produced,
            self.decayed,
            self.content - before if self.steady else self.relaid,
            done.steps,
            done.rejections,
            done.first_order,
            done.error,
            self.washed,
        )

    def _solve(self, level: float, dt: float | None = None, c: Any = None) -> SolveReport:
        """Solve for the field at a concentration of the medium; a step of ``dt`` s from ``c``."""
        p = self.nutrient
        wanted = self.layout.conditions(self.field.parameters.sides(0.0, level))
        if wanted != self.conditions:
            self.operator.set_boundary(wanted)
            self.conditions = wanted
        supply = self.layout.filled(p.perfusion * level) if self.source is None else (
            self.source + p.perfusion * level
        )  # fmt: skip
        linear = p.decay + p.perfusion
        if dt is not None:
            supply, linear = supply + c / dt, linear + 1.0 / dt
        self.values, report = self.operator.solve(
            self.sink, p.half_saturation, self.values, linear=linear, supply=supply
        )
        return report

    def _step(
        self, state: FloatArray, dt: float, time: float
    ) -> tuple[FloatArray, SolveReport, float]:
        """Take a step of backward Euler with a transient field; the state ends with C."""
        p, volume = self.nutrient, self.stirred.volume
        c, level = state[:-1].reshape(self.values.shape), float(state[-1])
        share, report = 1.0 + p.decay * dt, None
        taken = 0.0

        def excess(trial: float) -> float:
            nonlocal report, taken
            report = self._solve(trial, dt, c)
            washed = p.perfusion * self.content
            taken = dt * (report.inflow + p.perfusion * trial * self.whole - washed)
            return volume * (share * trial - level) + taken

        self.values = c
        fixed = volume * share
        trial, slope = self._root(excess, level, fixed + dt * self.slope)
        self.slope = max((slope - fixed) / dt, 0.0)
        assert report is not None
        after = (volume * level - taken) / (volume * share)
        # the balance's own value, unless rounding puts it below zero
        new = np.append(self.values, after if after >= 0.0 else trial)
        return new, report, trial

    def _step_steady(
        self, state: FloatArray, dt: float, time: float
    ) -> tuple[FloatArray, SolveReport, float]:
        """Take a step of backward Euler with a steady field; the state is what both hold."""
        p, volume, before = self.nutrient, self.stirred.volume, float(state[0])
        report, after = None, before

        def excess(trial: float) -> float:
            nonlocal report, after
            report = self._solve(trial)
            there = self.content + volume * trial
            produced = report.supplied - p.perfusion * trial * self.whole
            gained = produced - report.uptake - p.decay * there
            after = before + dt * gained
            return there - after

        fixed = (volume + self.whole) * (1.0 + p.decay * dt)
        trial, slope = self._root(excess, self.guess, fixed + dt * self.slope)
        self.slope, self.guess = max((slope - fixed) / dt, 0.0), trial
        assert report is not None
        if not after >= 0.0:
            after = self.content + volume * trial
        return np.array([after, self.content]), report, trial

    def _root(
        self, excess: Callable[[float], float], guess: float, slope: float
    ) -> tuple[float, float]:
        """Return the concentration, not below zero, at which ``excess`` (amol) is zero.

        Secants from a first ``slope`` (µm³), kept between what is known to be too little and too
        much. Returns the last slope too. The last evaluation is that of the result.
        """
        low, high, x = 0.0, math.inf, guess
        last: tuple[float, float] | None = None
        for count in range(_MOST):
            y, exact = excess(x), _EXACT[count > _PATIENCE]
            outside = self.stirred.volume * x
            # what the balance says is then not below zero either
            if abs(y) <= exact * (outside + self.content) and y <= outside:
                return x, slope
            low, high = (low, x) if y > 0.0 else (x, high)
            if last is not None and (y - last[1]) * (x - last[0]) > 0.0:
                slope = (y - last[1]) / (x - last[0])
            last = (x, y)
            x -= y / slope
            if not low <= x <= high or x == last[0]:
                x = 0.5 * (low + high) if low > 0.0 and high < math.inf else 0.1 * high
            if not math.isfinite(x) or (x == 0.0 and high == 0.0):
                break
        raise NutrientFailed(
            f"the concentration of the finite medium of {self.field.name} was not found: no value "
            "agrees with what flows between it and the field",
            "A field that cells fill faster than it settles needs regime = 'transient'",
        )
