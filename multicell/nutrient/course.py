"""Fields on their way through one coupling step, as the state of an equation of py-pde's."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, final

import numpy as np
from pde.solvers.base import SolverBase

from multicell.cells import FloatArray
from multicell.nutrient.balance import Exchange
from multicell.nutrient.equations.substance import LINEAR_TERMS, Substance
from multicell.nutrient.regions import coefficients
from multicell.nutrient.sources import injected

if TYPE_CHECKING:
    from multicell.nutrient.equations.schedule import Schedule
    from multicell.nutrient.field import NutrientField
    from multicell.nutrient.grid import Layout
    from multicell.nutrient.group import FieldGroup
    from multicell.nutrient.parameters import FieldParameters

Demand = Mapping[str, tuple[FloatArray, FloatArray | None]]
"""Largest uptake and secretion of each cell by field, (n,) amol/s."""


def substance(
    parameters: FieldParameters,
    layout: Layout,
    position: FloatArray,
    radius: FloatArray,
    demand: tuple[FloatArray, FloatArray | None],
    medium: float | Schedule,
) -> Substance:
    """Return what a field of a scene is made of on a grid, with cells of these radii in µm."""
    nutrient = parameters.nutrient

    def conditions(level: float) -> dict[str, Any]:
        return parameters.conditions(layout, level)

    supply = injected(layout, nutrient.sources) if nutrient.sources else None
    varied = coefficients(layout, position, radius, nutrient)
    capacity, production = demand
    return Substance(
        nutrient.diffusion, conditions, nutrient.half_saturation, medium=medium,
        capacity=capacity, production=production, varied=varied, supply=supply,
        **{name: getattr(nutrient, name) for name in LINEAR_TERMS},
    )  # fmt: skip


@final
class Course:
    """The fields of a group on their way through one coupling step.

    - ``equation``, FieldEquation
    - ``state``, ScalarField or FieldCollection, mM
    """

    def __init__(
        self, group: FieldGroup, position: FloatArray, demand: Demand, radius: FloatArray | None,
        time: float, *, carry: bool,
    ) -> None:  # fmt: skip
        self.group, self.demand = group, demand
        fields = group.fields.values()
        for name in group.names:
            position, radius = checked(position, *demand[name], radius)
        assert radius is not None
        # what finds no medium beyond its own sides must have all cells on the grid they share
        strays = all(f.parameters.open_medium for f in fields)
        layout, kept, position = group.first.lay(position, radius, strays=strays)
        self.layout, self.kept = layout, kept
        self.equation = group.equation(layout, position, radius, demand)
        self.state: Any = group.state([self._first(f, time, carry) for f in fields])

    def _first(self, field: NutrientField, time: float, carry: bool) -> FloatArray:
        """Return the values that a field begins with on the layout."""
        level = field.level(time)
        if not field.laid:
            return self.layout.filled(level)
        if self.kept:
            return field.values
        take = self.layout.carried if carry else self.layout.guess
        # on shells what is carried are differences of contents, which rounding may leave below
        # zero where there is nothing; what that adds is counted as relaid
        found = take(field.values, field.layout, level)
        return found if found is field.values else np.maximum(found, 0.0)

    def masses(self) -> FloatArray:
        """Return what each field holds, (m,) amol."""
        nodes = np.reshape(self.state.data, (-1, *self.layout.shape))
        return np.array([float(np.sum(self.layout.volumes * c)) for c in nodes])

    def run(self, name: str, begin: float, end: float, **options: Any) -> SolverBase:
        """Bring the state to ``end`` (s) by a solver of py-pde's registry, which is returned."""
        solver = SolverBase.from_name(name, self.equation, **options)
        solver.make_stepper(self.state)(self.state, begin, end)
        return solver

    def finish(self, time: float) -> None:
        """Give the fields what has been found."""
        nodes = np.reshape(self.state.data, (-1, *self.layout.shape))
        for field, values in zip(self.group.fields.values(), nodes, strict=True):
            conditions = field.parameters.conditions(self.layout, field.level(time))
            field.take(self.layout, values.copy(), conditions, self.kept)

    def exchange(self, name: str, row: FloatArray, **more: float) -> Exchange:
        """Return what a field exchanged, from a row of what solvers say."""
        field = self.group.fields[name]
        absent = [] if field.parameters.nutrient.sources else ["injected"]
        if self.group.kinetics is None:
            absent += ["made", "used"]
        return Exchange.of(row.tolist(), absent, **more)

    def march(self, info: Mapping[str, Any], relaid: FloatArray) -> dict[str, Exchange]:
        """Return what the fields exchanged by a march; ``relaid`` (amol) what the grid gained."""
        counts = {name: info[name] for name in ("steps", "rejections", "first_order", "error")}
        rows = zip(self.group.names, info["amounts"], relaid.tolist(), strict=True)
        return {name: self.exchange(name, row, relaid=more, **counts) for name, row, more in rows}


def checked(
    position: FloatArray,
    capacity: FloatArray,
    production: FloatArray | None,
    radius: FloatArray | None,
) -> tuple[FloatArray, FloatArray]:
    """Return positions and radii as arrays; refuse what does not fit."""
    position = np.asarray(position, dtype=np.float64)
    if position.ndim != 2 or position.shape[1] != 3:
        raise ValueError(f"position has shape {position.shape}, expected (n, 3)")
    n = len(position)
    for name, values in (("capacity", capacity), ("production", production)):
        if values is None:
            continue
        values = np.asarray(values)
        if values.shape != (n,):
            raise ValueError(f"{name} has shape {values.shape}, expected ({n},)")
        # not so of what is no number either
        if not (values.min(initial=0.0) >= 0.0 and values.max(initial=0.0) < np.inf):
            what = "capacity of uptake" if name == "capacity" else name
            raise ValueError(f"a cell's {what} is negative or not finite")
    radius = np.ones(n) if radius is None else np.asarray(radius, dtype=np.float64)
    if radius.shape != (n,):
        raise ValueError(f"radius has shape {radius.shape}, expected ({n},)")
    return position, radius
