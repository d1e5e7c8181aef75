"""All fields of a scene with the cells that live on them: uptake, secretion, accounts.

The fields are solved one after another, each after those that it depends on, so that together
they are the exact solution of the coupled problem; steady ones whose uptakes depend on each other
in turn until none changes any more. What depends on another field is evaluated at
the cells: each field may have a grid and a geometry of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, final

import numpy as np

from multicell.cells import Cells, FloatArray, Mask, State, rows_before
from multicell.errors import NutrientFailed, SceneError
from multicell.nutrient.balance import FieldExchange, Ledger
from multicell.nutrient.tissue import Tissue
from multicell.scene.dependences import circles, followed, solving_order

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from multicell.cells import IntArray
    from multicell.nutrient.field import NutrientField, Solution
    from multicell.nutrient.group import FieldGroup
    from multicell.population.extents import Extent, NoExtent
    from multicell.results.frame import Field, Frame
    from multicell.scene.scene import Scene


_MAX_TURNS = 200  # in which fields whose uptakes depend on each other are solved for
_SETTLED = 1e-8  # change of a field, over its highest concentration, that ends the turns

Demand = tuple[FloatArray, FloatArray | None]
"""Largest uptake of each cell, and its secretion, (n,) amol/s."""

Fluxes = Callable[[str, Cells, float], tuple[FloatArray | None, FloatArray | None]]
"""Returns what networks in cells take up and secrete of a field at a time in s, (n,) amol/s; NaN
in cells that have none, None where no network does."""

_SAME_TIME = 1e-6  # of a step, within which a release is at its beginning
_LEAST_SHARE = 1e-6  # of the largest uptake, where a cell finds next to nothing

Respond = Callable[[str, Cells, Mapping[str, FloatArray]], FloatArray | None]
"""Returns the factor that responses give a behaviour of each cell, (n,), or None for one."""


@final
class FieldsState(NamedTuple):
    """All that the fields of a run hold from step to step; a step makes the next one.

    - ``solutions``, name -> Solution
    - ``ledger``, name -> Ledger
    - ``concentrations``, name -> (n,) mM: at the cells
    - ``reports``, name -> FieldExchange: what a steady field exchanges now
    - ``grids``: changes of the geometry that a run chooses, as frames store them
    - ``taken``, name -> (n,) amol/s: what cells take up of fields that others are made from; it
      follows from the rest, and a step finds it anew
    """

    solutions: dict[str, Solution]
    ledger: dict[str, Ledger]
    concentrations: dict[str, FloatArray]
    reports: dict[str, FieldExchange]
    grids: dict[str, Mapping[str, float]]
    taken: dict[str, FloatArray]

    def fields(self) -> dict[str, Field]:
        """Return the fields as they were last solved."""
        return {name: solution.field(name) for name, solution in self.solutions.items()}

    def progress(self) -> dict[str, Any]:
        """Return the part of a frame to resume from, beside fields and concentrations."""
        return {
            "ledger": {name: account.entries() for name, account in self.ledger.items()},
            "rates": {name: report.entries() for name, report in self.reports.items()},
            "grids": dict(self.grids),
        }

    def at_rows(self, rows: IntArray) -> FieldsState:
        """Return the state for some of the cells, in another order."""
        found = {name: values[rows] for name, values in self.concentrations.items()}
        taken = {name: values[rows] for name, values in self.taken.items()}
        return self._replace(concentrations=found, taken=taken)


_NO_FIELDS = FieldsState({}, {}, {}, {}, {}, {})


@final
class FieldSystem:
    """Owner of the fields of a simulation; one without any loads nothing that it does not need.

    - ``reactions``: between its fields, of the user's own (:func:`multicell.reaction`)
    - ``threads``: how many may share the loops over many nodes; it changes no result
    - ``respond``: absent: cells do not respond
    - ``fluxes``: absent: no network takes up or secretes anything

    - ``time``: of the present exchange of cells, s: rates of networks may depend on it

    - ``fields``, name -> NutrientField
    - ``groups``, list of FieldGroup: the same in the groups that are solved for together, in the
      order of solving
    - ``ledger``, name -> Ledger
    - ``concentrations``, name -> (n,) float64, mM: at the cells of the last call
    - ``courses``, name -> parts of the last step, (m,), and concentrations then, (m, n) mM, at the
      cells' places at its end: of fields that were followed through it
    - ``steady``: names of the fields that are solved as steady, also with a finite medium

    Raises SceneError for reactions that do not fit the fields.
    """

    def __init__(
        self,
        scene: Scene,
        reactions: Mapping[str, Any] | None = None,
        threads: int = 1,
        respond: Respond | None = None,
        fluxes: Fluxes | None = None,
    ) -> None:
        self._fluxes, self.time = fluxes, 0.0
        self._tissue: Tissue | None = None  # of the last step, which may be tried again
        self._ahead: Mapping[str, FloatArray] = {}
        known: dict[str, Any] = {**scene.reactions, **(reactions or {})}
        self._scene, self._nutrients, self._respond = scene, scene.nutrients, respond
        self._followed = followed(scene)
        self.order: list[str] = []
        self.fields: dict[str, NutrientField] = {}
        self.groups: list[FieldGroup] = []
        if scene.nutrients:
            self._lay_out(scene, reactions, known, threads)
        elif reactions:
            raise SceneError("reactions", "are given, but the scene has no fields that could react")
        self._factors = {
            (what, name): factors(scene, what, name)
            for name in self.order
            for what in ("uptake", "secretion")
        }
        self._resting = {name for name in self.order if self._rests(name)}
        self._released = [name for name in self.order if scene.nutrients[name].release]
        self._marched = [name for name in self.order if name not in self._resting]
        self.steady = [n for n, x in self.fields.items() if x.parameters.regime == "steady"]
        around = circles(scene.nutrients, known, scene.responses)
        self._circles = {x[-1]: x for x in map(tuple, around.values()) if len(x) > 1}
        for group in self.groups:
            # what is solved for again and again within a solve of others is as exact as can be
            alone = len(around[group.names[0]]) == 1
            if alone and all(scene.nutrients[x].finite_medium is None for x in group.names):
                group.settle_for_enough()
        self._changes: dict[str, Mapping[str, float]] = {}  # of geometry, as frames store them
        self.ledger = {name: Ledger() for name in scene.nutrients}
        self.concentrations: dict[str, FloatArray] = {}
        self.reports: dict[str, FieldExchange] = {}
        self.courses: dict[str, tuple[FloatArray, FloatArray]] = {}
        self._uptake: dict[str, FloatArray] = {}
        self._sources = {x for n in scene.nutrients.values() for x in (n.secretion_from or ())}

    def _lay_out(
        self,
        scene: Scene,
        reactions: Mapping[str, Any] | None,
        known: Mapping[str, Any],
        threads: int,
    ) -> None:
        """Make the fields, and the groups that are solved for together."""
        from multicell.nutrient.field import NutrientField
        from multicell.nutrient.group import joined_parameters, together
        from multicell.nutrient.parameters import FieldParameters

        self.order = solving_order(scene.nutrients, known, scene.responses)
        parameters = {name: FieldParameters.of(scene, name) for name in self.order}
        if reactions:
            parameters |= joined_parameters(scene, parameters, reactions)
        self.fields = {
            name: NutrientField(name, parameters[name], threads) for name in scene.nutrients
        }
        self.groups = together(self.fields, self.order, known)

    def begin(self, cells: Cells, time: float, *, again: bool = False) -> None:
        """Solve for the fields at the start of a run; ``again`` for other states of its cells."""
        self.time = time
        tissue = Tissue(cells.position, cells.radius)
        for group in self.groups:
            if again:
                # the account begins anew, and a finite medium with it
                for name in group.names:
                    self.ledger[name], self.fields[name].well_mixed = Ledger(), None
            self._begin(group, cells, tissue, time)
            self._settle(group, cells, tissue, time)

    def _settle(
        self,
        group: FieldGroup,
        cells: Cells,
        tissue: Tissue,
        time: float,
        gone: IntArray | None = None,
    ) -> None:
        """Solve in turn for the steady fields of a circle that ends with this one.

        - ``gone``: rows of cells that exchange nothing
        """
        names = self._circles.get(group.names[-1], ())
        if not names or not self._resting.issuperset(names):
            return  # others depend on what the last step has left
        for _ in range(_MAX_TURNS):
            change = 0.0
            for other in (one for one in self.groups if one.names[0] in names):
                name = other.names[0]
                before, demand = self.concentrations[name], self.demand(name, cells)
                if gone is not None:
                    demand = _parted({name: demand}, gone)[0][name]
                self.reports |= other.solve(tissue, {name: demand}, time=time)
                self.ledger[name].fill(self.fields[name].stored())
                self._sample(name, other, cells, demand[0])
                moved = np.abs(self.concentrations[name] - before).max(initial=0.0)
                change = max(change, float(moved) / self._nutrients[name].highest)
            if change < _SETTLED:
                return
        problem = f"{' and '.join(names)} do not settle: their uptakes depend on each other"
        raise NutrientFailed(problem, "Make one of these dependences weaker (uptake_on.*.effect).")

    def _begin(self, group: FieldGroup, cells: Cells, tissue: Tissue, time: float) -> None:
        """Solve for fields at the start of a run."""
        demand = {name: self.demand(name, cells) for name in group.names}
        first = group.names[0]
        steady = self.fields[first].parameters.regime == "steady"
        if steady or self._nutrients[first].initial == "steady":
            self.reports |= group.solve(tissue, demand, time=time)
        else:
            group.fill(tissue, time=time)
        for name in group.names:
            field = self.fields[name]
            self.ledger[name].add(self._none(name))
            self._release(name, cells, -1.0, 0.0 if time == 0.0 else -1.0)
            self.ledger[name].fill(field.stored())
            if self._nutrients[name].finite_medium is not None:
                field.attach_medium()
            self.ledger[name].note(field.well_mixed)
            self._sample(name, group, cells, demand[name][0])

    @property
    def marches(self) -> bool:
        """Whether any field is brought through time, and not solved as steady at its moments."""
        return bool(self._marched)

    def reacts(self, name: str) -> bool:
        """Return whether a field takes part in reactions."""
        return any(name in group.names for group in self.groups if group.kinetics is not None)

    def _rests(self, name: str) -> bool:
        """Return whether a field is solved as steady, and not marched with a finite medium."""
        # a steady field in a finite medium continues with its content
        group = next(group for group in self.groups if name in group.names)
        finite = any(self._nutrients[other].finite_medium is not None for other in group.names)
        return self.fields[name].parameters.regime == "steady" and not finite

    def advance(
        self,
        cells: Cells,
        begin: float,
        end: float,
        *,
        before: Cells | None = None,
        follow: Collection[str] = (),
        until: Any = 1.0,
        ahead: Mapping[str, FloatArray] | None = None,
    ) -> None:
        """Bring the fields from ``begin`` to ``end`` (s), with the cells as they are at the end.

        What a steady field exchanged in this time is what its solution of ``begin`` said. With
        transient ones each cell exchanges the mean of the step, at its place at the end; where
        networks exchange with fields, what it exchanges goes linearly from one end to the other.
        ``before`` are the cells at the beginning.

        - ``follow``: fields of which, where they are transient, ``courses`` keep the concentrations
          at cells on the way
        - ``until``, (n,) or a number: part of the step after which cells exchange nothing; steady
          fields at its end are without those that do not reach it
        - ``ahead``: :meth:`shares` at the end as an earlier try has them; absent: those of the
          beginning
        """
        self._continue()
        self.time = begin
        for name in self._released:
            near = _SAME_TIME * (end - begin)
            after = begin - near if begin > 0.0 else 0.0  # what was there at the start is there
            self._release(name, cells if before is None else before, after, end - near)
        began: dict[str, Demand] = {}
        shares = np.zeros(0)
        if before is not None and self._marched:
            if any(self._nutrients[name].secretion_from for name in self._marched):
                for name, field in self.fields.items():
                    self._uptake[name] = field.uptake(
                        before.position,
                        self._capacity(name, before, self.concentrations),
                        before.radius,
                    )
            row, earlier, shares = _shares(before, cells, end - begin)
            for name in self._marched:
                one, other = self.demand(name, before)
                began[name] = earlier * one[row], None if other is None else earlier * other[row]
        self.time, self._ahead = end, ahead or {}
        tissue = self._tissue
        if tissue is None or not tissue.is_of(cells.position, cells.radius):
            tissue = self._tissue = Tissue(cells.position, cells.radius)
        for names in self._circles.values():  # as the fields of the last step have them
            found = {x: self.fields[x].sample_tissue(tissue) for x in names}
            self.concentrations = {**self.concentrations, **found}
        # asked for only where networks exchange with fields
        whole = None if self._fluxes is None else np.broadcast_to(until, len(cells)) == 1.0
        leaving = None
        if isinstance(until, np.ndarray) and (rows := np.flatnonzero(until < 1.0)).size:
            leaving = rows, begin + until[rows] * (end - begin)
        for group in self.groups:
            followed = [name for name in group.names if name in follow and name in self._marched]
            seen: list[tuple[float, list[FloatArray]]] = []
            group.watch = partial(self._follow, group, seen) if followed else None
            self._advance(group, cells, tissue, begin, end, began, shares, whole, leaving)
            self._settle(group, cells, tissue, end, None if leaving is None else leaving[0])
            for name in followed:
                times = np.array([(time - begin) / (end - begin) for time, _ in seen])
                values = np.stack([found[group.names.index(name)] for _, found in seen])
                self.courses[name] = times, values
        self._ahead = {}

    def _release(self, name: str, cells: Cells, after: float, until: float) -> None:
        """Put what is released after a time and up to another, s, into a field.

        Raises NutrientFailed where it has no place.
        """
        field, ledger = self.fields[name], self.ledger[name]
        for key, release in self._nutrients[name].release.items():
            if not after < release.time <= until:
                continue
            place, radius = np.array([release.place or (0.0,) * 3]), np.array([release.radius])
            if release.type:
                row = list(self._scene.types).index(release.type)
                chosen = cells.kind == row
                place, radius = cells.position[chosen], cells.radius[chosen]
            share = np.full(len(place), release.amount / max(len(place), 1))
            try:
                if not len(place):
                    raise ValueError(f"there is no cell of type {release.type}")
                ledger.release(field.put(place, share, radius))
            except ValueError as trouble:
                problem = f"release.{key} of {name} at {release.time:g} s has no place: {trouble}"
                raise NutrientFailed(problem, "Look at place and domain, or type") from None
            ledger.fill(field.stored())

    def shares(self, cells: Cells) -> dict[str, FloatArray]:
        """Return the uptake of each field over the largest one where cells are, name -> (n,)."""
        one = np.ones(len(cells))
        return {
            name: field.uptake(cells.position, one, cells.radius)
            for name, field in self.fields.items()
            if field.laid
        }

    def _follow(
        self,
        group: FieldGroup,
        seen: list[tuple[float, list[FloatArray]]],
        time: float,
        nodes: FloatArray,
    ) -> None:
        """Note the concentrations of a group's fields on the way, from given values."""
        layout, found = group.layout, []
        for values, field in zip(nodes, group.fields.values(), strict=True):
            conditions = field.parameters.conditions(layout, field.level(time))
            found.append(layout.read(group.position, values, conditions, group.radius))
        if not seen or time > seen[-1][0]:
            seen.append((time, found))

    def _advance(
        self,
        group: FieldGroup,
        cells: Cells,
        tissue: Tissue,
        begin: float,
        end: float,
        began: Mapping[str, Demand],
        shares: FloatArray,
        whole: Mask | None,
        leaving: tuple[IntArray, FloatArray] | None,
    ) -> None:
        """Bring fields to ``end``.

        - ``began``: the part of the demand that the beginning sets; ``shares``: that of the end
        - ``whole``, (n,): which cells exchange until the end; None without exchange by networks
        - ``leaving``: rows of those that do not, and until when in s
        """
        demand = {name: self.demand(name, cells) for name in group.names}
        # what steady fields are solved with
        staying = demand if leaving is None else _parted(demand, leaving[0])[0]
        shells = self._on_shells(group.names[0])
        if group.names[0] in self._resting:
            for name in group.names:
                self.ledger[name].add(self.reports[name], end - begin)
            self.reports |= group.solve(tissue, staying, time=end)
        else:
            content = {name: self.fields[name].stored() for name in group.names}
            mean, first = dict(demand), {}
            for name in began.keys() & demand.keys():
                (one, two), (uptake, made) = began[name], demand[name]
                product = None if made is None or two is None else two + shares * made
                mean[name] = one + shares * uptake, product
                if whole is not None:
                    first[name], mean[name] = _line(mean[name], demand[name], whole)
            parted = None
            if leaving is not None:
                mean, those = _parted(mean, leaving[0])
                first, _ = _parted(first, leaving[0])
                parted = *leaving, those
            found = group.advance(tissue, mean, begin=begin, end=end, first=first, leaving=parted)
            for name, exchange in found.items():
                gained = self.fields[name].stored() - content[name]
                self.ledger[name].add(exchange, stored=gained)
                self.ledger[name].note(self.fields[name].well_mixed)
        for name in group.names:
            self.ledger[name].fill(self.fields[name].stored())
            if self._on_shells(name) != shells:
                number = self._changes.get(name, {"changes": 0})["changes"] + 1
                self._changes[name] = {"changes": number, "changed_at": end}
            self._sample(name, group, cells, staying[name][0])

    def find_again(self, cells: Cells) -> None:
        """Note concentrations and uptake of cells after some have divided."""
        self.concentrations = {
            name: field.sample(cells.position, cells.radius) for name, field in self.fields.items()
        }
        self._uptake = {
            name: self.fields[name].uptake(
                cells.position,
                self._capacity(name, cells, self.concentrations),
                cells.radius,
            )
            for name in self._sources
        }

    def give_back(self, cells: Cells, after: Cells, late: FloatArray) -> None:
        """Give transient fields back the uptake of cells after their death or quiescence.

        - ``cells``, ``after``: before and after that
        - ``late``, (n,) s: how long before the end of the last step it was; zero of others
        """
        for group in (one for one in self.groups if one.names[0] in self._marched):
            for name in group.names:
                field = self.fields[name]
                if field.parameters.regime == "steady":
                    continue  # it has been solved with the content of the field and its medium
                capacity, _ = self.demand(name, after)
                excess = np.maximum(self.demand(name, cells)[0] - capacity, 0.0)
                amount = late * field.uptake(cells.position, excess)
                total = field.put(group.position, amount)
                self.ledger[name].add(self._none(name)._replace(uptake=-total), stored=total)
                self.ledger[name].fill(field.stored())
                self._sample(name, group, cells, capacity)

    def _none(self, name: str) -> FieldExchange:
        """Return the account of a field to which nothing happens."""
        none = 0.0 if self.reacts(name) else None
        return FieldExchange(made=none, used=none)

    @property
    def state(self) -> FieldsState:
        """All that the fields hold; to assign one makes it the last that was found."""
        if not self.fields:
            return _NO_FIELDS
        return FieldsState(
            {name: field.solution for name, field in self.fields.items()},
            self.ledger,
            self.concentrations,
            self.reports,
            self._changes,
            self._uptake,
        )

    @state.setter
    def state(self, state: FieldsState) -> None:
        for name, field in self.fields.items():
            field.solution = state.solutions[name]
        _, self.ledger, self.concentrations, self.reports, self._changes, self._uptake = state

    def _continue(self) -> None:
        """Continue in accounts and tables of their own: those that are there belong to a state."""
        self.ledger = {name: account.copy() for name, account in self.ledger.items()}
        self.concentrations, self.reports = self.concentrations.copy(), self.reports.copy()
        self._changes, self._uptake = self._changes.copy(), self._uptake.copy()
        self.courses = {}

    def _on_shells(self, name: str) -> bool:
        return self.fields[name].layout.kind == "radial"

    def grid_remarks(self, name: str) -> list[str]:
        """Return in words whether a field went over from shells to cubes, or back."""
        if name not in self._changes:
            return []
        number, time = self._changes[name]["changes"], self._changes[name]["changed_at"]
        shells = self._on_shells(name)
        ways = "cubes to shells" if shells else "shells to cubes"
        often = "" if number == 1 else f", the last of {number:g} changes"
        return [
            f"{name} went over from {ways} at {time / 3600.0:.4g} h{often}: "
            f"the tissue is {'round' if shells else 'not round'}."
        ]

    def fitness(self, cells: Cells, time: float) -> tuple[dict[str, dict[str, Any]], list[str]]:
        """Return how well the grids fit the cells, by field, and remarks."""
        if not self.fields:
            return {}, []
        from multicell.nutrient.fitness import fitness

        return fitness(self, cells, time)

    def gradients(self, cells: Cells) -> dict[str, FloatArray]:
        """Return the gradients that cells follow, name -> (n, 3) mM/µm."""
        if not self.concentrations:
            # contacts are looked for before there is a field, and need no forces
            return {name: np.zeros((len(cells), 3)) for name in self._followed}
        return {name: self.fields[name].gradient(cells.position) for name in self._followed}

    def columns(self, cells: Cells, extent: Extent | NoExtent) -> dict[str, float]:
        """Return the columns of the history: media, and uptake; ``extent`` is that of the cells."""
        media = {name: field.well_mixed for name, field in self.fields.items()}
        found = {f"medium_{name}": x.concentration for name, x in media.items() if x is not None}
        rates = {name: self._uptake_rate(name, cells) for name in self.fields}
        found |= {f"uptake_{name}": rate for name, rate in rates.items()}
        if rates and self._scene.dimensions == 3:
            rim = extent.viable_volume()
            found |= {f"rim_uptake_{name}": rate / rim for name, rate in rates.items()}
        return found

    def restore(self, frame: Frame) -> None:
        """Take fields, concentrations and accounts from a frame."""
        assert frame.progress is not None
        self._changes = dict(frame.progress.grids)
        for name, field in self.fields.items():
            self.ledger[name] = ledger = Ledger(**frame.progress.ledger[name])
            if (ledger.made is None) == self.reacts(name):
                problem = f"of the run that this frame is from are not the same for {name}"
                raise SceneError("reactions", problem, "Give those that it was started with.")
            field.restore(frame.fields[name], frame.time)
            if ledger.held is not None:
                field.attach_medium()
                assert field.well_mixed is not None
                field.well_mixed = replace(
                    field.well_mixed,
                    amount=ledger.held,
                    fresh=ledger.fresh,
                    discarded=ledger.discarded,
                    decayed=ledger.spoiled,
                    changes=int(ledger.changes),
                )
                field.restore(frame.fields[name], frame.time)
            self.concentrations[name] = np.array(frame.concentrations[name])
        self.reports = {
            name: FieldExchange(**report)  # type: ignore[arg-type]
            for name, report in frame.progress.rates.items()
        }

    @property
    def nodes(self) -> int:
        """Number of nodes of the largest field in a box; zero before there is one."""
        laid = [field.layout for field in self.fields.values() if field.laid]
        return max((math.prod(x.shape) for x in laid if x.kind == "box"), default=0)

    def demand(
        self,
        name: str,
        cells: Cells,
        concentrations: Mapping[str, FloatArray] | None = None,
        taken: Mapping[str, FloatArray] | None = None,
    ) -> Demand:
        """Return each cell's largest uptake and its secretion, (n,) amol/s.

        - ``concentrations``, ``taken``, name -> (n,), mM and amol/s: concentrations of all fields
          at each cell, and uptake of those that others are made from; absent: the present ones
        """
        concentrations = self.concentrations if concentrations is None else concentrations
        taken = self._uptake if taken is None else taken
        nutrient, capacity = self._nutrients[name], self._capacity(name, cells, concentrations)
        given, made = None, None
        if self._fluxes is not None:
            given, made = self._fluxes(name, cells, self.time)
        if nutrient.secretion == 0.0 and not nutrient.secretion_from and given is made is None:
            return capacity, None
        production = nutrient.secretion * self._active("secretion", name, cells, concentrations)
        for other, share in (nutrient.secretion_from or {}).items():
            production = production + share * taken[other]
        if made is not None:
            production = np.where(np.isnan(made), production, made)
        if given is not None:  # what is taken up at a rate below zero is given away
            production = production + np.where(given < 0.0, -given, 0.0)
        return capacity, production

    def _active(
        self, what: str, name: str, cells: Cells, concentrations: Mapping[str, FloatArray]
    ) -> FloatArray:
        """Return uptake or secretion of each cell over that of a proliferating one, (n,)."""
        by_state, by_kind = self._factors[what, name]
        active = by_state[cells.state]
        if by_kind is not None:
            active = active * by_kind[cells.kind]
        if self._respond is None:
            return active
        response = self._respond(f"{what} of {name}", cells, concentrations)
        return active if response is None else active * response

    def _capacity(
        self, name: str, cells: Cells, concentrations: Mapping[str, FloatArray]
    ) -> FloatArray:
        """Return each cell's largest uptake, (n,) amol/s."""
        nutrient = self._nutrients[name]
        active = self._active("uptake", name, cells, concentrations)
        volume = 0.0 if nutrient.uptake_per_volume is None else cells.volume
        capacity = nutrient.largest_uptake(volume) * active
        factor: Any = 1.0
        for other, law in nutrient.uptake_on.items():
            if other in concentrations:  # at the start one of a circle is not there yet
                factor = factor * law.factor(concentrations[other])
        given = None if self._fluxes is None else self._fluxes(name, cells, self.time)[0]
        if given is not None:
            # the largest uptake whose part at the cell's concentration is the given one
            own = np.maximum(given, 0.0) / np.maximum(self._share(name, cells), _LEAST_SHARE)
            return np.where(np.isnan(given), capacity * factor, own)
        return np.asarray(capacity * factor)

    def _share(self, name: str, cells: Cells) -> FloatArray:
        """Return the uptake of a field over the largest one where cells are, (n,)."""
        if name in self._ahead:
            return self._ahead[name]
        field, one = self.fields[name], np.ones(len(cells))
        if field.laid:
            return field.uptake(cells.position, one, cells.radius)
        nutrient = self._nutrients[name]
        level = nutrient.medium(self.time)
        return one * (level / (level + nutrient.half_saturation))

    def _sample(self, name: str, group: FieldGroup, cells: Cells, capacity: FloatArray) -> None:
        """Keep concentrations and uptake of cells of a field that its group has just solved for."""
        field = self.fields[name]
        self.concentrations[name] = field.read(group.position, group.radius)
        if name in self._sources:
            self._uptake[name] = field.uptake(cells.position, capacity, cells.radius)

    def _uptake_rate(self, name: str, cells: Cells) -> float:
        """Return the uptake of a field by all cells now, amol/s."""
        capacity = self._capacity(name, cells, self.concentrations)
        field, group = self.fields[name], next(x for x in self.groups if name in x.names)
        if group.has_met(cells, capacity) and field.layout is group.layout:
            rates = field.uptake_reached(group.position, capacity, group.radius)
        else:
            rates = field.uptake(cells.position, capacity, cells.radius)
        return float(rates.sum())


def _shares(
    before: Cells, cells: Cells, dt: float
) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """Return how the demand of a step follows from that of its beginning and that of its end.

    Returns the rows of the cells or their mothers at the beginning, and the weights of both
    demands, (n,) each. Until a division each daughter stands for half of its mother.
    """
    row = rows_before(before, cells)
    born = before.id[row] != cells.id
    since = np.minimum(cells.age / dt, 1.0)
    return row, np.where(born, 0.5 * (1.0 - since), 0.5), np.where(born, since, 0.5)


def _parted(
    demand: Mapping[str, Demand], rows: IntArray
) -> tuple[dict[str, Demand], dict[str, Demand]]:
    """Return the demand of all cells but some, (n,), and that of these, (k,)."""
    others: dict[str, Demand] = {}
    those: dict[str, Demand] = {}
    for name, (capacity, production) in demand.items():
        those[name] = capacity[rows], None if production is None else production[rows]
        capacity = capacity.copy()
        capacity[rows] = 0.0
        if production is not None:
            production = production.copy()
            production[rows] = 0.0
        others[name] = capacity, production
    return others, those


def _line(mean: Demand, last: Demand, whole: Mask) -> tuple[Demand, Demand]:
    """Return the demands at both ends between which it goes linearly through a step.

    They have the mean, and where that can be, with none below zero, the last one at the end. Where
    cells do not exchange until the end, both are the mean.
    """
    ends: list[tuple[FloatArray | None, FloatArray | None]] = []
    for middle, end in zip(mean, last, strict=True):
        if middle is None or end is None:
            ends.append((middle, middle))
            continue
        first = np.where(whole, np.maximum(2.0 * middle - end, 0.0), middle)
        ends.append((first, 2.0 * middle - first))
    (one, uptake), (two, made) = ends
    assert one is not None
    assert uptake is not None
    return (one, two), (uptake, made)


def factors(scene: Scene, what: str, name: str) -> tuple[FloatArray, FloatArray | None]:
    """Return factors on ``"uptake"`` or ``"secretion"`` of a field by state and by type.

    None stands for factors by type that are all one.
    """
    by_kind = []
    for kind in scene.types.values():
        own = kind.uptake_scale
        if what == "secretion" and kind.secretion_scale is not None:
            own = kind.secretion_scale
        of = kind.uptake_of if what == "uptake" else kind.secretion_of
        by_kind.append(own * (of or {}).get(name, 1.0))
    scales = np.array(by_kind)
    active = np.zeros(len(State))
    active[State.PROLIFERATING] = 1.0
    active[State.QUIESCENT] = scene.nutrients[name].quiescent_uptake
    return active, scales if (scales != 1.0).any() else None
