"""Fields that share a grid, brought forward together: one that stands alone, or those that react.

The fields are the state of one equation
(:class:`multicell.nutrient.equations.equation.FieldEquation`), made anew when the grid changes its
shape, and a solver out of py-pde's registry brings it forward. The account of a step is made of
the same values as the step, so that what one field loses to a reaction the others gain.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from operator import is_
from typing import TYPE_CHECKING, Any, final

import numpy as np
from pde.solvers.base import SolverBase

from multicell.cells import FloatArray, IntArray
from multicell.nutrient import finite
from multicell.nutrient.balance import BALANCE_COLUMNS, FADED, FieldExchange
from multicell.nutrient.equations.equation import FieldEquation
from multicell.nutrient.equations.substance import Substance
from multicell.nutrient.grid import Layout, relative_diffusion, tissue_share
from multicell.nutrient.steady import BALANCE_TOLERANCE, ENOUGH
from multicell.nutrient.tissue import reaching
from multicell.scene.nutrient import OWN_SOLVERS
from multicell.scene.reactions import groups

if TYPE_CHECKING:
    from multicell.cells import Cells
    from multicell.nutrient.equations.substance import Schedule
    from multicell.nutrient.field import NutrientField
    from multicell.nutrient.parameters import FieldParameters
    from multicell.nutrient.reactions.kinetics import Kinetics
    from multicell.nutrient.tissue import Tissue
    from multicell.scene.scene import Scene

Demand = Mapping[str, tuple[FloatArray, FloatArray | None]]
"""Largest uptake and secretion of each cell by field, (n,) amol/s."""

Leaving = tuple[IntArray, FloatArray, Demand]
"""Rows of cells that exchange for a part of a step only, (k,), until when, (k,) s, and their
demand, (k,); that of all cells is without them."""


@final
class FieldGroup:
    """Fields on one grid, and the reactions between them.

    - ``fields``: by name, all with the same grid
    - ``kinetics``: reactions between them, in the same order; None where there are none

    - ``layout``, ``equation``: of the last solve
    - ``position``, (n, 3) µm, ``radius``, (n,) µm: where and as what balls the cells reached the
      grid in it
    - ``nodes``, (m, ...) mM: its values at the nodes of the layout
    - ``state``: the same array as py-pde's ``FieldCollection``, for solvers
    - ``info``: what py-pde's solver said of it; see ``pde.SolverBase``
    - ``watch``: called with time and values on the way of an :meth:`advance`; None: nobody looks
    - ``tolerance``: of what :meth:`solve` brings to rest, see :func:`.steady.solve_steady`
    """

    layout: Layout
    position: FloatArray
    radius: FloatArray
    equation: FieldEquation
    nodes: FloatArray
    tolerance = BALANCE_TOLERANCE

    def __init__(
        self, fields: Mapping[str, NutrientField], kinetics: Kinetics | None = None
    ) -> None:
        self.fields, self.kinetics = dict(fields), kinetics
        self.names = list(fields)
        self.first = next(iter(self.fields.values()))
        self._made_for: tuple[FieldParameters, ...] = ()
        self._made_at: tuple[Any, ...] = (None, None, None)
        self._tissue: Tissue | None = None  # round which the layout lies
        self._may_stay = False
        self._solver: Any = None  # of the last solve
        self.info: dict[str, Any] = {}
        self.watch: Callable[[float, FloatArray], None] | None = None

    def settle_for_enough(self) -> None:
        """Be no more exact at rest than the grid allows."""
        self.tolerance = ENOUGH

    def solve(self, tissue: Tissue, demand: Demand, *, time: float) -> dict[str, FieldExchange]:
        """Bring the fields to rest with the cells' uptake and secretion."""
        self.begin(tissue, demand, time, carry=False)
        for placed in self.equation.substances.values():
            placed.tolerance = self.tolerance
        if self._outside is None:
            self._run("multicell-steady", time, time)
        else:
            self._settle(time)
        self.finish(time)
        reports, rows = self.info["reports"], zip(self.names, self.info["rates"], strict=True)
        found = {}
        for name, row in rows:
            newton, cg, residual, *_ = reports[name]
            found[name] = self._exchange(row, newton=newton, cg=cg, residual=residual)
        return found

    def advance(
        self,
        tissue: Tissue,
        demand: Demand,
        *,
        begin: float,
        end: float,
        first: Demand | None = None,
        leaving: Leaving | None = None,
    ) -> dict[str, FieldExchange]:
        """Bring transient fields from ``begin`` to ``end`` (s).

        The grid is laid round the cells first. What it encloses then and did not before is the
        medium of the moment, counted as ``relaid``.

        - ``first``: demand at the beginning, from which it goes linearly to ``demand``; missing
          entries do not change
        - ``leaving``: cells that exchange for a part of this time
        """
        if any(field.well_mixed is not None for field in self.fields.values()):
            return finite.advance_finite_fields(self, tissue, demand, begin, end, first, leaving)
        before = [field.stored() for field in self.fields.values()]
        self.begin(tissue, demand, begin, carry=True)
        self.change_demand(first, begin, end, leaving)
        relaid = self.masses() - np.array(before)
        nutrients = [field.parameters.nutrient for field in self.fields.values()]
        scales = np.array([FADED * n.highest for n in nutrients])
        tolerance = min(n.time_tolerance for n in nutrients)
        if self._outside is None:
            self._run("multicell-march", begin, end, tolerance=tolerance, scales=scales)
            relaid = relaid + self.info["lifted"]
        else:
            relaid = relaid + self._bring(begin, end, tolerance)
        self.finish(end)
        return self.exchanges(self.info["amounts"], relaid)

    def fill(self, tissue: Tissue, *, time: float) -> None:
        """Begin with the media's concentrations everywhere."""
        nothing = np.zeros(len(tissue.position)), None
        self.begin(tissue, dict.fromkeys(self.names, nothing), time, carry=False)
        for nodes, field in zip(self.nodes, self.fields.values(), strict=True):
            nodes[...] = field.first_values(self.layout, time)
        self.finish(time)

    def begin(self, tissue: Tissue, demand: Demand, time: float, *, carry: bool) -> None:
        """Lay the grid round the cells, and take over values; amounts stay where they ``carry``."""
        fields = self.fields.values()
        if tissue is not self._tissue:
            # what finds no medium beyond its own sides must have all cells on the grid they share
            strays = all(f.parameters.open_medium for f in fields)
            self.layout, self.position = self.first.lay(tissue, strays=strays)
            self.radius = tissue.once(reaching, tissue.position, self.position, tissue.extent)
            self.layout.keep(self.position, self.radius)
            self._tissue = tissue
        self._set_equation(tissue, demand, self.first.exchange(self.layout, tissue))
        self.nodes = np.array([self._first(f, time, carry) for f in fields])
        self.state = self.equation.view(self.nodes)

    def has_met(self, cells: Cells, capacity: FloatArray) -> bool:
        """Return whether the layout lies round these cells, as far as they take up, (n,) amol/s.

        Some that take up no more may have lost volume since.
        """
        tissue = self._tissue
        if tissue is None or tissue.position is not cells.position:
            return False
        same = tissue.radius is cells.radius
        return same or not capacity[tissue.radius != cells.radius].any()

    def change_demand(
        self, first: Demand | None, begin: float, end: float, leaving: Leaving | None
    ) -> None:
        """Let demand go linearly from ``first`` to what it is at the end, and cells leave."""
        for name, demand in (first or {}).items():
            placed = self.equation.substances[name]
            placed.change_demand(self.position, self.radius, *demand, begin, end)
        if leaving is not None:
            rows, times, more = leaving
            for name, demand in more.items():
                cells = self.position[rows], self.radius[rows]
                self.equation.substances[name].let_leave(*cells, *demand, times)

    def _first(self, field: NutrientField, time: float, carry: bool) -> FloatArray:
        """Return the values that a field begins with on the layout."""
        level = field.level(time)
        if not field.laid:
            return self.layout.filled(level)
        if field.layout == self.layout:
            return field.values
        take = self.layout.carried if carry else self.layout.guess
        # on shells what is carried are differences of contents, which rounding may leave below
        # zero where there is nothing; what that adds is counted as relaid
        found = take(field.values, field.layout, level)
        return found if found is field.values else np.maximum(found, 0.0)

    def masses(self) -> FloatArray:
        """Return the content of each field, (m,) amol."""
        return np.array([float(np.sum(self.layout.volumes * c)) for c in self.nodes])

    def _run(self, name: str, begin: float, end: float, **options: Any) -> None:
        """Bring the state to ``end`` (s) by a solver of py-pde's registry."""
        solver = self._solver
        if solver is None or solver.pde is not self.equation or solver.name != name:
            # options are those of the parameters that the equation was made for
            solver = self._solver = SolverBase.from_name(name, self.equation, **options)
        solver.watch = None if self.watch is None else self._watch
        solver.make_stepper(self.state)(self.state, begin, end)
        self.info = solver.info

    def _watch(self, time: float, data: FloatArray) -> None:
        """Hand on values on the way as they lie on the layout."""
        assert self.watch is not None
        self.watch(time, data.reshape(self.nodes.shape))

    @property
    def _outside(self) -> str | None:
        """The solver that the scene names in place of those that runs take by themselves."""
        name = self.first.parameters.nutrient.solver
        return None if name in OWN_SOLVERS else name

    def scales(self) -> FloatArray:
        """Return the highest concentration of each field, also within it, (m,) mM."""
        levels = [field.parameters.nutrient.highest for field in self.fields.values()]
        there = self.nodes.reshape(len(levels), -1).max(axis=1)
        found = np.maximum(levels, there)
        return np.where(found > 0.0, found, 1.0)

    def _settle(self, time: float) -> None:
        """Bring the state to rest by a solver of the scene's choice."""
        from multicell.nutrient.equations import outside

        assert self._outside is not None
        found, reports = outside.settle(
            self.equation, self._outside, self.nodes, time, self.scales()
        )
        self.nodes[...] = found
        self.info = {"reports": reports, "rates": self.equation.exchanges(found, time)}

    def _bring(self, begin: float, end: float, tolerance: float) -> FloatArray:
        """Bring the state to ``end`` by a solver of the scene's choice; return what that added."""
        from multicell.nutrient.equations import outside

        assert self._outside is not None
        found = outside.bring(
            self.equation,
            self._outside,
            self.nodes,
            begin,
            end,
            tolerance=tolerance,
            scales=self.scales(),
            watch=self.watch,
        )
        self.nodes[...] = found.data
        self.info = {"steps": found.steps, "amounts": found.amounts}
        return found.lifted

    def finish(self, time: float) -> None:
        """Give the fields what has been found, which nobody will write to any more."""
        for field, values in zip(self.fields.values(), self.nodes, strict=True):
            conditions = field.parameters.conditions(self.layout, field.level(time))
            field.take(self.layout, values, conditions)

    def _exchange(self, row: FloatArray, **more: Any) -> FieldExchange:
        """Return the exchange of a field from a row of solvers' reports."""
        found = dict(zip(BALANCE_COLUMNS[:-1], row.tolist(), strict=False))
        if self.kinetics is None:
            found |= {"made": None, "used": None}
        return FieldExchange(**found, **more)

    def exchanges(self, amounts: FloatArray, relaid: FloatArray) -> dict[str, FieldExchange]:
        """Return the exchange of the fields by a march; ``relaid`` (amol) the gain by the grid."""
        rows = zip(self.names, amounts, relaid.tolist(), strict=True)
        return {name: self._exchange(row, relaid=more) for name, row, more in rows}

    def _set_equation(self, tissue: Tissue, demand: Demand, exchange: FloatArray | None) -> None:
        """Make the equation on the layout with the cells there; the last one stays if it holds.

        A layout of the same kind that follows the tissue leaves what it is made of as it was, and
        so does all that differs from place to place where neither grid nor cells have moved.
        """
        layout, position = self.layout, self.position
        fields = self.fields.values()
        shares = self.kinetics is not None and self.kinetics.needs_tissue
        made_for = tuple(f.parameters for f in fields)
        here, before = (layout, position, tissue.radius), self._made_at
        holds = all(map(is_, here, before)) or (
            self._may_stay and not shares and self.equation.layout.kind == layout.kind
        )
        if holds and self._made_for == made_for:
            for f in fields:
                if f.well_mixed is not None:
                    self.equation.substances[f.name].follow(f.well_mixed.concentration)
            self.equation.place(layout, position, demand, self.radius, exchange)
            self._made_at = here
            return
        substances = {
            f.name: substance(
                f.parameters, layout, position, tissue, demand[f.name], f.schedule, exchange
            )
            for f in fields
        }
        radius = tissue.radius
        self.equation = FieldEquation(
            None,
            substances,
            position,
            radius=self.radius,
            layout=layout,
            reactions=self.kinetics,
            tissue=tissue.once(tissue_share, layout, position, radius) if shares else None,
            threads=self.first.threads,
        )
        self._made_for, self._made_at = made_for, here
        # what differs from place to place belongs to where grid and cells are
        self._may_stay = all(f.parameters.nutrient.diffusion_medium is None for f in fields)


def substance(
    parameters: FieldParameters,
    layout: Layout,
    position: FloatArray,
    cells: Tissue,
    demand: tuple[FloatArray, FloatArray | None],
    medium: float | Schedule,
    exchange: FloatArray | None,
) -> Substance:
    """Return a field of a scene as a substance on a grid that cells reach at these positions.

    - ``exchange``: with the medium, see :meth:`multicell.nutrient.field.NutrientField.exchange`
    """
    nutrient = parameters.nutrient

    def conditions(level: float) -> dict[str, Any]:
        return parameters.conditions(layout, level)

    medium_diffusion, varied = nutrient.diffusion_medium, None
    if medium_diffusion is not None and medium_diffusion != nutrient.diffusion:
        share = cells.once(tissue_share, layout, position, cells.radius)
        varied = relative_diffusion(share, medium_diffusion, nutrient.diffusion)
    capacity, production = demand
    return Substance(
        nutrient.diffusion,
        conditions,
        nutrient.half_saturation,
        medium=medium,
        capacity=capacity,
        production=production,
        varied=varied,
        exchange=exchange,
        decay=nutrient.decay,
        perfusion=nutrient.perfusion,
    )


def joined_parameters(
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
    joined = groups(fields, reactions)
    found = []
    for name in order:
        names = next((group for group in joined if name in group), None)
        if names is None:
            found.append(fields[name].group)
        elif name == names[0]:
            from multicell.nutrient.reactions.kinetics import kinetics_of

            own = {n: r for n, r in reactions.items() if r.fields[0] in names}
            members = {member: fields[member] for member in names}
            found.append(FieldGroup(members, kinetics_of(names, own)))
    return found
