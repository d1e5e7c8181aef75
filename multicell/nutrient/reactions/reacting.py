"""Fields of a simulation that react with each other: solved for together, on one grid.

Transient ones are marched as single fields are (:mod:`multicell.nutrient.transient`), each step
being one of all of them (:mod:`multicell.nutrient.reactions.coupled`); steady ones are brought to
rest. The account of a step is made of the same values as the step, so that what one field loses to
a reaction the others gain to the tolerance of Newton's iterations.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, final

import numpy as np

from multicell.cells import FloatArray
from multicell.errors import NutrientFailed
from multicell.nutrient.field import GONE, FieldReport, NutrientField, checked
from multicell.nutrient.grid import tissue_share
from multicell.nutrient.reactions.coupled import Coupled, settle
from multicell.nutrient.reactions.kinetics import growth_rate
from multicell.nutrient.transient import March, StepRefused, TransientReport, controlled
from multicell.scene.nutrient import MOST

if TYPE_CHECKING:
    from multicell.nutrient.grid import Layout, Operator
    from multicell.nutrient.reactions.kinetics import Kinetics

_TRACE = 1e-6
"""Part of the largest concentration of all fields below which the error of one is not followed."""

Demand = Mapping[str, tuple[FloatArray, FloatArray | None]]
"""Largest uptake and secretion of each cell by field, (n,) amol/s."""


@final
@dataclass(frozen=True)
class GroupAmounts:
    """What happened in some time: a row for each field with the columns of :data:`COLUMNS`."""

    values: FloatArray

    def plus(self, other: GroupAmounts, share: float = 1.0) -> GroupAmounts:
        """Return these and a share of others."""
        return GroupAmounts(self.values + share * other.values)


COLUMNS = ("inflow", "uptake", "mass", "made", "used", "level")
"""Of :class:`GroupAmounts`: amol, but ``mass`` in amol s and ``level`` in mM s."""


@final
class Reacting:
    """Fields on one grid, and the reactions between them.

    Parameters
    ----------
    fields
        By name, all with the same grid.
    kinetics
        Reactions between them, in the same order.
    """

    def __init__(self, fields: Mapping[str, NutrientField], kinetics: Kinetics) -> None:
        self.fields, self.kinetics = dict(fields), kinetics
        self.names = list(kinetics.names)

    def solve(
        self, position: FloatArray, demand: Demand, *, radius: FloatArray, time: float
    ) -> dict[str, FieldReport]:
        """Bring the fields to rest with the cells' uptake and secretion.

        Raises
        ------
        NutrientFailed
            If there is no state of rest, or it is not found; the fields then are the last ones.
        """
        course = _Course(self, position, demand, radius, time, steady=True)
        coupled = course.at(time)
        c = settle(coupled, course.values)
        course.finish(c)
        found = {}
        for name, account in zip(self.names, coupled.account(c), strict=True):
            p = self.fields[name].parameters.nutrient
            brought = p.perfusion * self.fields[name].level(time) * course.whole
            washed = p.perfusion * account.mass
            sources = account.supplied - brought
            decayed = p.decay * account.mass
            left = account.inflow + brought - washed + sources + account.made
            left -= account.used + account.uptake + decayed
            found[name] = FieldReport(
                coupled.newton, coupled.linear_steps, abs(left), account.inflow + brought - washed,
                account.uptake, sources, decayed, account.outflow, washed, account.made,
                account.used,
            )  # fmt: skip
        return found

    def advance(
        self, position: FloatArray, demand: Demand, *, radius: FloatArray, begin: float, end: float
    ) -> dict[str, TransientReport]:
        """March the fields from ``begin`` to ``end`` (s).

        Raises
        ------
        NutrientFailed
            If a field grows without bound, which is named with its growth rate, or the march
            cannot go on; the fields then are the last ones.
        """
        before = {name: self.fields[name].stored() for name in self.names}
        course = _Course(self, position, demand, radius, begin, steady=False)
        relaid = course.masses() - np.array(list(before.values()))
        done = March(GroupAmounts(np.zeros((len(self.names), len(COLUMNS)))))
        nutrients = [self.fields[name].parameters.nutrient for name in self.names]
        switches = sorted({t for n in nutrients for t in n.switches(begin, end)})
        c = course.values
        for start, stop in itertools.pairwise([begin, *switches, end]):
            c = course.march(c, start, stop, done)
        course.finish(c)
        return {
            name: course.report(i, done, end - begin, float(relaid[i]))
            for i, name in enumerate(self.names)
        }


@final
class _Course:
    """The fields on their way through one coupling step."""

    def __init__(
        self,
        group: Reacting,
        position: FloatArray,
        demand: Demand,
        radius: FloatArray,
        time: float,
        *,
        steady: bool,
    ) -> None:
        self.group, self.fields = group, [group.fields[name] for name in group.names]
        self.demand = demand
        for name in group.names:
            self.position, self.radius = checked(position, *demand[name], radius)
        # what finds no medium beyond its own sides must have all cells on the grid they share
        strays = all(f.parameters.open_medium for f in self.fields)
        layout, kept, self.position = self.fields[0].lay(self.position, self.radius, strays=strays)
        self.layout: Layout = layout
        self.kept = [kept and f._layout is not None for f in self.fields]
        # the operators' own ones stay as they are if this course comes to nothing
        made = [
            f._operator_on(layout, False, self.position, self.radius, time) for f in self.fields
        ]
        self.operators: list[Operator] = [operator for operator, _ in made]
        self.conditions = [conditions for _, conditions in made]
        self.shape = layout.filled(0.0).shape
        self.values = np.array([self._first(f, time, steady).ravel() for f in self.fields])
        self.sinks = np.array(
            [layout.scatter(self.position, demand[name][0]).ravel() for name in group.names]
        )
        volumes = layout.volumes
        self.volumes = np.broadcast_to(np.ravel(volumes), self.sinks.shape[1:])
        self.whole = float(np.sum(self.volumes))
        self.tissue = None
        if group.kinetics.needs_tissue:
            self.tissue = tissue_share(layout, self.position, self.radius).ravel()
        nutrients = [f.parameters.nutrient for f in self.fields]
        self.half = np.array([n.half_saturation for n in nutrients])
        self.linear = np.array([n.decay + n.perfusion for n in nutrients])

    def _first(self, field: NutrientField, time: float, steady: bool) -> FloatArray:
        """Return the values that a field begins with on the layout."""
        level = field.parameters.nutrient.medium(time)
        if field._layout is None:
            return self.layout.filled(level)
        if field._layout == self.layout:
            return field._values
        carry = self.layout.guess if steady else self.layout.carried
        carried = carry(field._values, field._layout, level)
        # on shells they are differences of contents, which rounding may leave below zero where
        # there is nothing; what that adds is counted as relaid
        return np.where(carried < 0.0, 0.0, carried)

    def masses(self) -> FloatArray:
        """Return what each field holds at first, (m,) amol."""
        return np.asarray(np.sum(self.values * self.volumes, axis=1))

    def at(self, time: float) -> Coupled:
        """Return the equations with the media of a time in s."""
        supplies = np.zeros_like(self.values)
        for i, field in enumerate(self.fields):
            wanted = self.layout.conditions(field.parameters.sides(time))
            if wanted != self.conditions[i]:
                self.operators[i].set_boundary(wanted)
                self.conditions[i] = wanted
            medium = field.parameters.nutrient.medium(time)
            production = self.demand[field.name][1]
            supply = field._supply(self.layout, self.position, production, medium)
            if supply is not None:
                supplies[i] = supply.ravel()
        operators: list[Any] = list(self.operators)
        return Coupled(
            operators, self.sinks, supplies, self.half, self.linear, self.group.kinetics,
            self.tissue,
        )  # fmt: skip

    def march(
        self, c: FloatArray, start: float, stop: float, done: March[GroupAmounts]
    ) -> FloatArray:
        """Bring the fields from one time to another, between which no medium jumps."""
        nutrients = [f.parameters.nutrient for f in self.fields]
        last = float(np.nextafter(stop, -np.inf))
        scale = self._scale(c, start, stop)
        known: dict[float, Coupled] = {}
        self.now, self.state = start, c

        def step(c: FloatArray, dt: float, time: float) -> tuple[FloatArray, GroupAmounts]:
            moment = min(time, last)
            changing = any(n.media_change == "linear" for n in nutrients)
            key = moment if changing else 0.0
            if key not in known:
                known.clear()
                known[key] = self.at(moment)
            coupled = known[key]
            self.now, self.state = time - dt, c
            after = coupled.step(c, c, dt)
            if float(after.max()) > MOST:
                self.state = after
                problem = f"one of {', '.join(self.group.names)} became denser than water"
                raise NutrientFailed(problem, "Look at what is secreted and made of it")
            rows = [
                (a.inflow, a.uptake, a.mass, a.made, a.used, n.medium(moment))
                for a, n in zip(coupled.account(after), nutrients, strict=True)
            ]
            return after, GroupAmounts(dt * np.array(rows))

        def error(halves: FloatArray, full: FloatArray) -> float:
            largest = np.maximum(scale, halves.max(axis=1))
            found = np.abs(halves - full).max(axis=1) / np.where(largest > 0.0, largest, 1.0)
            return float(found.max())

        try:
            return controlled(
                step, error, c, start, stop, done=done, opening=0.1 * (stop - start),
                tolerance=min(n.time_tolerance for n in nutrients),
            )  # fmt: skip
        except NutrientFailed as failure:
            raise self._named(failure) from None

    def _scale(self, c: FloatArray, start: float, stop: float) -> FloatArray:
        """Return what errors of each field are compared with at least, (m,) mM.

        For a field that is only being made, about the most that will be there at the end, by one
        step through it all: errors relative to what is there would ask for steps as short as the
        time that has passed since there was nothing.
        """
        nutrients = [f.parameters.nutrient for f in self.fields]
        scale = np.array([max(n.medium(start), GONE * n.highest) for n in nutrients])
        try:
            ahead = self.at(start).step(c, c, stop - start).max(axis=1)
        except StepRefused:
            ahead = c.max(axis=1)
        scale = np.maximum(scale, ahead)
        return np.asarray(np.maximum(scale, _TRACE * scale.max()))

    def _named(self, failure: NutrientFailed) -> NutrientFailed:
        """Return a failure with the field that grows without bound, if one does."""
        worst = (0.0, 0, 0)
        for node in {int(np.argmax(row)) for row in self.state}:
            point = np.ascontiguousarray(self.state[:, node : node + 1])
            tissue = None if self.tissue is None else self.tissue[node : node + 1]
            _, derivative = self.group.kinetics.evaluate(point, tissue)
            if np.isfinite(derivative).all():
                growth, field = growth_rate(derivative[:, :, 0], self.linear)
                worst = max(worst, (growth, field, node))
        growth, field, node = worst
        if not growth > 0.0:
            return failure
        value = float(self.state[field, node])
        return NutrientFailed(
            f"{self.group.names[field]} grows without bound: at t = {self.now:.6g} s it has come "
            f"to {value:.3g} mM, and reactions make it grow by {growth:.3g} 1/s more than decay "
            "and perfusion take",
            "Look at the rates of the reactions that make it, or let them saturate (kind = 'hill')",
        )

    def finish(self, c: FloatArray) -> None:
        """Give the fields what has been found."""
        for i, field in enumerate(self.fields):
            kept = self.kept[i] and field._layout == self.layout
            values = c[i].reshape(self.shape).copy()
            field._take(self.layout, self.operators[i], self.conditions[i], values, kept)

    def report(
        self, row: int, done: March[GroupAmounts], length: float, relaid: float
    ) -> TransientReport:
        """Return the account of a field over the whole march."""
        field = self.fields[row]
        inflow, uptake, mass, made, used, level = (float(x) for x in done.amounts.values[row])
        nutrient, production = field.parameters.nutrient, self.demand[field.name][1]
        base = TransientReport(
            inflow + nutrient.perfusion * (level * self.whole - mass),
            uptake,
            0.0 if production is None else float(np.sum(production)) * length,
            nutrient.decay * mass,
            relaid,
            done.steps,
            done.rejections,
            done.first_order,
            done.error,
            nutrient.perfusion * mass,
        )
        return replace(base, made=made, used=used)
