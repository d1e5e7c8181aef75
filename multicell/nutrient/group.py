"""Fields that share a grid, brought forward together: one that stands alone, or those that react.

The fields are the state of one equation of py-pde's
(:class:`multicell.nutrient.equations.equation.FieldEquation`), made anew when the grid is laid
anew, and a solver out of py-pde's registry brings it forward. The account of a step is made of the
same values as the step, so that what one field loses to a reaction the others gain.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, final

import numpy as np
from pde.solvers.base import SolverBase

from multicell.cells import FloatArray
from multicell.nutrient.equations.equation import FieldEquation
from multicell.nutrient.equations.term import Substance
from multicell.nutrient.field import FADED, FieldReport
from multicell.nutrient.grid import BoxLayout, Layout, tissue_share
from multicell.nutrient.regions import coefficients
from multicell.nutrient.sources import injected
from multicell.nutrient.transient import COLUMNS, TransientReport

if TYPE_CHECKING:
    from multicell.nutrient.equations.schedule import Schedule
    from multicell.nutrient.field import NutrientField
    from multicell.nutrient.parameters import FieldParameters
    from multicell.nutrient.reactions.kinetics import Kinetics
    from multicell.nutrient.steady import SolveReport
    from multicell.scene.nutrient import Nutrient

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
    return Substance(
        nutrient.diffusion, conditions, nutrient.half_saturation, nutrient.decay,
        nutrient.perfusion, medium, *demand, varied, supply,
    )  # fmt: skip


@final
class FieldGroup:
    """Fields on one grid, and the reactions between them.

    Parameters
    ----------
    fields
        By name, all with the same grid.
    kinetics
        Reactions between them, in the same order; None where there are none.

    Attributes
    ----------
    info
        What py-pde's solver said of its last solve; see ``pde.SolverBase``.
    """

    def __init__(
        self, fields: Mapping[str, NutrientField], kinetics: Kinetics | None = None
    ) -> None:
        self.fields, self.kinetics = dict(fields), kinetics
        self.names = list(fields)
        self.first = next(iter(self.fields.values()))
        self._equation: FieldEquation | None = None
        self._made_for: tuple[FieldParameters, ...] = ()
        self._may_stay = False
        self.info: dict[str, Any] = {}

    def solve(
        self, position: FloatArray, demand: Demand, *, radius: FloatArray | None, time: float
    ) -> dict[str, FieldReport]:
        """Bring the fields to rest with the cells' uptake and secretion.

        Raises
        ------
        NutrientFailed
            If there is no state of rest, or it is not found; the fields then are the last ones.
        ValueError
            If shapes do not match or a capacity is negative or not finite.
        """
        course = Course(self, position, demand, radius, time, carry=False)
        self.info = course.run("multicell-steady", time, time).info
        course.finish(time)
        reports = self.info["reports"]
        return {name: course.report(name, reports[name], time) for name in self.names}

    def advance(
        self,
        position: FloatArray,
        demand: Demand,
        *,
        radius: FloatArray | None,
        begin: float,
        end: float,
    ) -> dict[str, TransientReport]:
        """Bring transient fields from ``begin`` to ``end`` (s).

        The grid is laid round the cells first. What it encloses then and did not before is the
        medium of the moment, counted as ``relaid``.

        Raises
        ------
        NutrientFailed
            If a field grows without bound, which is named with its growth rate, or the march
            cannot go on; the fields then are the last ones.
        ValueError
            As for :meth:`solve`.
        """
        if any(field.well_mixed is not None for field in self.fields.values()):
            from multicell.nutrient import finite

            return finite.advance(self, position, demand, radius, begin, end)
        before = [field.stored() for field in self.fields.values()]
        course = Course(self, position, demand, radius, begin, carry=True)
        relaid = course.masses() - np.array(before)
        nutrients = [field.parameters.nutrient for field in self.fields.values()]
        if nutrients[0].solver in (None, "multicell-march"):
            self.info = course.run(
                "multicell-march", begin, end,
                tolerance=min(n.time_tolerance for n in nutrients),
                scales=np.array([FADED * n.highest for n in nutrients]),
            ).info  # fmt: skip
        else:
            from multicell.nutrient.foreign import advance

            self.info = advance(course.equation, course.state, nutrients, begin, end)
        course.finish(end)
        return {
            name: course.account(name, self.info, row, end - begin, float(relaid[i]))
            for i, (name, row) in enumerate(zip(self.names, self.info["amounts"], strict=True))
        }

    def leap(
        self,
        position: FloatArray,
        demand: Demand,
        *,
        radius: FloatArray | None,
        begin: float,
        end: float,
    ) -> dict[str, SolveReport]:
        """Take one step of backward Euler from ``begin`` to ``end`` (s), whatever its error.

        Finite media stay as they are.

        Raises
        ------
        NutrientFailed, ValueError
            As for :meth:`solve`; the fields then still are the last ones.
        """
        course = Course(self, position, demand, radius, end, carry=True)
        data = np.array(course.state.data)
        found, reports = course.equation.solution(data, end, end - begin, data)
        course.state.data[...] = found.reshape(data.shape)
        course.finish(end)
        return reports

    def fill(self, position: FloatArray, *, radius: FloatArray | None, time: float) -> None:
        """Begin with the media's concentrations everywhere."""
        nothing = np.zeros(len(position)), None
        course = Course(
            self, position, dict.fromkeys(self.names, nothing), radius, time, carry=False
        )
        levels = [field.level(time) for field in self.fields.values()]
        course.state.data[...] = course.equation.state(
            dict(zip(self.names, levels, strict=True))
        ).data
        course.finish(time)

    def equation(
        self, layout: Layout, kept: bool, position: FloatArray, radius: FloatArray, demand: Demand,
    ) -> FieldEquation:  # fmt: skip
        """Return the equation on a layout with cells there; the last one if it still holds.

        A box that has only moved with the tissue leaves all but its place as it was.
        """
        fields = self.fields.values()
        tissue = self.kinetics is not None and self.kinetics.needs_tissue
        last, made_for = self._equation, tuple(f.parameters for f in fields)
        holds = last is not None and self._may_stay and self._made_for == made_for
        if last is not None and holds and not tissue and (kept or _moved(last.layout, layout)):
            for f in fields:
                if f.well_mixed is not None:
                    last.terms[f.name].follow(f.well_mixed.concentration)
            last.place(layout, position, demand)
            return last
        substances = {
            f.name: substance(f.parameters, layout, position, radius, demand[f.name], f.schedule)
            for f in fields
        }
        self._made_for = made_for
        self._may_stay = not any(_stands_still(f.parameters.nutrient) for f in fields)
        self._equation = FieldEquation(
            None, substances, position, layout=layout, reactions=self.kinetics,
            tissue=tissue_share(layout, position, radius) if tissue else None,
            threads=self.first.threads,
        )  # fmt: skip
        return self._equation


def _moved(old: Layout, new: Layout) -> bool:
    return isinstance(new, BoxLayout) and new.moved_from(old)


def _stands_still(nutrient: Nutrient) -> bool:
    """Return whether what a field is made of depends on where its grid and cells are."""
    return bool(nutrient.sources or nutrient.regions or nutrient.diffusion_medium is not None)


@final
class Course:
    """The fields of a group on their way through one coupling step.

    Attributes
    ----------
    equation : FieldEquation
    state : ScalarField or FieldCollection, mM
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
        self.equation = group.equation(layout, kept, position, radius, demand)
        values = {f.name: self._first(f, time, carry) for f in fields}
        self.state = self.equation.state(values)

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
        return np.maximum(take(field.values, field.layout, level), 0.0)

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

    def report(self, name: str, report: SolveReport, time: float) -> FieldReport:
        """Return the balance of a steady field by what it was for."""
        field = self.group.fields[name]
        nutrient, mass, brought = field.parameters.nutrient, 0.0, 0.0
        if nutrient.decay > 0.0 or nutrient.perfusion > 0.0:
            mass = field.stored()
        if nutrient.perfusion > 0.0:
            brought = nutrient.perfusion * field.level(time) * self.layout.whole
        washed = nutrient.perfusion * mass
        reacts = self.group.kinetics is not None
        return FieldReport(
            report.newton, report.cg, report.residual, report.inflow + brought - washed,
            report.uptake, report.supplied - brought, nutrient.decay * mass, report.outflow,
            washed, report.made if reacts else None, report.used if reacts else None,
        )  # fmt: skip

    def account(
        self, name: str, info: Mapping[str, Any], row: FloatArray, length: float, relaid: float
    ) -> TransientReport:
        """Return the account of a field over all steps."""
        amounts = dict(zip(COLUMNS, map(float, row), strict=True))
        nutrient, production = self.group.fields[name].parameters.nutrient, self.demand[name][1]
        mass, whole = amounts["mass"], self.layout.whole
        return TransientReport(
            amounts["inflow"] + nutrient.perfusion * (amounts["level"] * whole - mass),
            amounts["uptake"],
            0.0 if production is None else float(np.sum(production)) * length,
            nutrient.decay * mass,
            relaid,
            info["steps"],
            info["rejections"],
            info["first_order"],
            info["error"],
            nutrient.perfusion * mass,
            amounts["made"],
            amounts["used"],
        )


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
