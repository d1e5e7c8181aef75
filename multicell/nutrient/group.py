"""Fields that share a grid, brought forward together: one that stands alone, or those that react.

The fields are the state of one equation of py-pde's
(:class:`multicell.nutrient.equations.equation.FieldEquation`), made anew when the grid changes its
shape, and a solver out of py-pde's registry brings it forward. The account of a step is made of
the same values as the step, so that what one field loses to a reaction the others gain.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, final

import numpy as np
from pde.fields.scalar import ScalarField

from multicell.cells import FloatArray
from multicell.nutrient import finite
from multicell.nutrient.balance import FADED, Exchange
from multicell.nutrient.course import Course, Demand, substance
from multicell.nutrient.equations.equation import FieldEquation
from multicell.nutrient.grid import Layout, tissue_share
from multicell.scene.reactions import groups

if TYPE_CHECKING:
    from pde.grids.base import GridBase

    from multicell.nutrient.field import NutrientField
    from multicell.nutrient.parameters import FieldParameters
    from multicell.nutrient.reactions.kinetics import Kinetics
    from multicell.scene.nutrient import Nutrient
    from multicell.scene.scene import Scene


@final
class FieldGroup:
    """Fields on one grid, and the reactions between them.

    - ``fields``: by name, all with the same grid
    - ``kinetics``: reactions between them, in the same order; None where there are none

    - ``info``: what py-pde's solver said of its last solve; see ``pde.SolverBase``
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
        self._state: Any = None
        self.info: dict[str, Any] = {}

    def solve(
        self, position: FloatArray, demand: Demand, *, radius: FloatArray | None, time: float
    ) -> dict[str, Exchange]:
        """Bring the fields to rest with the cells' uptake and secretion."""
        course = Course(self, position, demand, radius, time, carry=False)
        self.info = course.run("multicell-steady", time, time).info
        course.finish(time)
        found, rows = self.info["reports"], zip(self.names, self.info["rates"], strict=True)
        return {
            name: course.exchange(
                name, row, newton=found[name].newton, cg=found[name].cg,
                residual=found[name].residual,
            )
            for name, row in rows
        }  # fmt: skip

    def advance(
        self,
        position: FloatArray,
        demand: Demand,
        *,
        radius: FloatArray | None,
        begin: float,
        end: float,
    ) -> dict[str, Exchange]:
        """Bring transient fields from ``begin`` to ``end`` (s).

        The grid is laid round the cells first. What it encloses then and did not before is the
        medium of the moment, counted as ``relaid``.
        """
        if any(field.well_mixed is not None for field in self.fields.values()):
            return finite.advance(self, position, demand, radius, begin, end)
        before = [field.stored() for field in self.fields.values()]
        course = Course(self, position, demand, radius, begin, carry=True)
        relaid = course.masses() - np.array(before)
        nutrients = [field.parameters.nutrient for field in self.fields.values()]
        self.info = course.run(
            "multicell-march", begin, end,
            tolerance=min(n.time_tolerance for n in nutrients),
            scales=np.array([FADED * n.highest for n in nutrients]),
        ).info  # fmt: skip
        course.finish(end)
        return course.march(self.info, relaid)

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
        self, layout: Layout, position: FloatArray, radius: FloatArray, demand: Demand
    ) -> FieldEquation:
        """Return the equation on a layout with cells there; the last one if it still holds.

        A layout of the same kind that follows the tissue leaves what it is made of as it was.
        """
        fields = self.fields.values()
        tissue = self.kinetics is not None and self.kinetics.needs_tissue
        last, made_for = self._equation, tuple(f.parameters for f in fields)
        holds = last is not None and self._may_stay and self._made_for == made_for
        if last is not None and holds and not tissue and last.layout.kind == layout.kind:
            for f in fields:
                if f.well_mixed is not None:
                    last.substances[f.name].follow(f.well_mixed.concentration)
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

    def state(self, values: list[FloatArray]) -> Any:
        """Return a state of the last equation; the last one, with other values, if it still holds.

        - ``values``, mM: at the nodes, for each field
        """
        equation, last = self._equation, self._state
        assert equation is not None
        if len(values) == 1:
            (own,) = values
            if last is None or last.nodes != own.shape:
                self._state = last = _Following(equation.grid, label=self.names[0])
                last.nodes = own.shape
            last.equation = equation
            last.data[...] = own.reshape(last.data.shape)
        elif last is not None and last.grid is equation.grid:
            last.data[...] = np.reshape(values, last.data.shape)
        else:
            self._state = equation.state_of(values)
        return self._state


@final
class _Following(ScalarField):  # type: ignore[no-untyped-call]
    """A state on the grid that its equation has at the moment, which is made if asked for.

    - ``nodes``: shape of the equation's layout
    """

    equation: FieldEquation | None = None
    nodes: tuple[int, ...] = ()

    @property
    def grid(self) -> GridBase:
        """py-pde's grid."""
        return self._grid if self.equation is None else self.equation.grid


def _stands_still(nutrient: Nutrient) -> bool:
    """Return whether what a field is made of depends on where its grid and cells are."""
    return bool(nutrient.sources or nutrient.regions or nutrient.diffusion_medium is not None)


def joined(
    scene: Scene, parameters: Mapping[str, FieldParameters], reactions: Mapping[str, Any]
) -> dict[str, FieldParameters]:
    """Return the parameters of fields that reactions of the user's own join."""
    from multicell.scene.checks import check_own

    check_own(scene, reactions)
    found: dict[str, FieldParameters] = {}
    for names in groups(scene.nutrients, {**scene.reactions, **reactions}):
        given = [scene.nutrients[name].regime for name in names]
        regime = next((x for x in given if x != "auto"), "transient")
        found |= {name: replace(parameters[name], regime=regime) for name in names}
    return found


def together(
    fields: Mapping[str, NutrientField], order: list[str], reactions: Mapping[str, Any]
) -> list[FieldGroup]:
    """Return the fields in the groups that are solved for together, in an order of the fields."""
    from multicell.nutrient.reactions.kinetics import kinetics_of

    joined = groups(fields, reactions)
    found = []
    for name in order:
        names = next((group for group in joined if name in group), None)
        if names is None:
            found.append(fields[name].group)
        elif name == names[0]:
            own = {n: r for n, r in reactions.items() if r.fields[0] in names}
            members = {member: fields[member] for member in names}
            found.append(FieldGroup(members, kinetics_of(names, own)))
    return found
