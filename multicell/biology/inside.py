"""Networks inside cells: signals become their inputs, and their states become signals.

All that networks carry from step to step stands in one column of the cells, ``inside``: of each
network its states, the inputs at the end of the last step, what its solver remembers of the cell,
and its parameters where events may change them. So division, removal, sorting, frames and resumed
runs treat it as they treat any column. It is NaN in cells without the network.

In a coupling step the fields are solved first; then inputs are known at both ends and go linearly
between them, those that are transient fields between as many moments of the step as they need. A
cell that was born in the step is its mother until then. A network whose inputs hang on what
networks of neighbours are at the end of the step is solved twice, the second time with what the
first one found: both ways are of second order.
"""

from __future__ import annotations

import itertools
import math
import zlib
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, NamedTuple, final

import numpy as np

from multicell import random
from multicell.behaviours.catalogue import OF_NEIGHBOURS, SUM_OF, WEIGHTED, value_around
from multicell.biology.division import are_second
from multicell.biology.waiting import SINCE
from multicell.cells import HALF, Cells, FloatArray, IntArray, Mask, Signals
from multicell.errors import StepFailed
from multicell.random import Purpose
from multicell.scene.networks import (
    columns_of_network,
    flux_factor,
    flux_of,
    input_factor,
    network_order,
    networks_change_fields,
)
from multicell.schema import Draw

if TYPE_CHECKING:
    from multicell.biology.responding import Level
    from multicell.networks.network import Network
    from multicell.networks.solver import Inside, NetworkSolver
    from multicell.scene.networks import CellNetwork
    from multicell.scene.scene import Scene

Courses = Mapping[str, tuple[FloatArray, FloatArray]]
"""Field -> parts of a step, (k,), and (k, n) mM: concentrations then at the last places of
cells."""

_MOST_PIECES: Final = 16  # of a step, for inputs that do not go straight

FindPairs = Callable[[bool], tuple[IntArray, FloatArray]]
FindSignals = Callable[[Cells], Signals]
"""Returns signals at the cells: fields in mM, and others."""


@final
class Edges(NamedTuple):
    """Columns at which states, parameters, inputs and memory of a network end."""

    states: int
    values: int
    inputs: int
    memory: int


@final
@dataclass(frozen=True, eq=False)
class PlacedNetwork:
    """A network of a scene, and its place among the columns of ``Cells.inside``.

    - ``name``, ``part``: as in the scene; ``model``: the network
    - ``seed``: of the scene
    - ``kinds``, (types,) bool, or None: which types have it; None for all
    - ``levels``, input -> what finds its signal, names of what that is made of, and the factor to
      the network's unit
    - ``begin``: first of its columns; ``columns``: their names
    """

    name: str
    part: CellNetwork
    model: Network
    seed: int
    kinds: Mask | None
    levels: Mapping[str, tuple[Level, frozenset[str], float]]
    begin: int
    columns: tuple[str, ...]

    @cached_property
    def edges(self) -> Edges:
        """The ends of its parts, counted from the first column."""
        model = self.model
        states = len(model.states)
        values = states + (len(model.parameters) if model.events else 0)
        inputs = values + len(model.inputs)
        return Edges(states, values, inputs, inputs + 3 + len(model.events))

    @cached_property
    def slopes(self) -> slice:
        """The places of the slopes of its inputs; none where nothing is extrapolated."""
        first = self.begin + self.edges.memory
        more = len(self.columns) > self.edges.memory
        return slice(first, first + more * len(self.model.inputs))

    def share_of(self, field: str) -> tuple[int, int]:
        """Return the places of the share of a field's uptake, and of its slope."""
        fields = list(self.part.fluxes or ())
        place = self.slopes.stop + fields.index(field)
        return place, place + len(fields)

    @cached_property
    def seconds(self) -> float:
        """The unit of its time, s."""
        return self.part.seconds()

    def solver_for(self, threads: int = 1) -> NetworkSolver:
        """Return its solver."""
        from multicell.networks.solver import NetworkSolver

        part = self.part
        return NetworkSolver(
            self.model,
            method=part.method,
            relative=part.tolerance,
            absolute=part.absolute_tolerance,
            threads=threads,
            length=0.0 if part.step is None else part.step / self.seconds,
        )

    @cached_property
    def solver(self) -> NetworkSolver:
        """The solver on one thread, which also computes values that follow from others."""
        return self.solver_for()

    @cached_property
    def diluted(self) -> FloatArray:
        """Which states fall as the cell grows, (s,): 1 or 0."""
        amounts = self.model.amounts
        return np.array([float(self.part.dilution and x not in amounts) for x in self.model.states])

    def has(self, cells: Cells) -> Mask:
        """Return which cells are of a type that has it, (n,)."""
        return np.ones(len(cells), bool) if self.kinds is None else self.kinds[cells.kind]

    def values(self, ids: IntArray) -> FloatArray:
        """Return the parameters of cells by their identities, (n, q)."""
        out = np.tile(np.array(self.model.values, dtype=float), (len(ids), 1))
        for name, given in (self.part.parameters or {}).items():
            column = out[:, self.model.parameters.index(name)]
            if not isinstance(given, Draw):
                column[:] = given
                continue
            wide = math.log1p(given.variation**2)
            event = zlib.crc32(f"{self.name}.{name}".encode())
            z = random.normal(self.seed, Purpose.NETWORK, event, ids)[:, 0]
            column[:] = given.mean * np.exp(math.sqrt(wide) * z - 0.5 * wide)
        return out

    def inputs(self, cells: Cells, signals: Signals) -> FloatArray:
        """Return the inputs of all cells, (n, m), in the network's units."""
        out = np.tile(np.array(self.model.defaults, dtype=float), (len(cells), 1))
        for name, (level, _, factor) in self.levels.items():
            out[:, self.model.inputs.index(name)] = factor * level(signals, cells, None)
        return out

    def read(self, inside: FloatArray, ids: IntArray) -> tuple[Inside, FloatArray]:
        """Return networks and inputs from rows of ``Cells.inside``, (n, k), and the identities."""
        from multicell.networks.solver import Inside

        own = inside[:, self.begin : self.begin + len(self.columns)]
        y, p, u, memory, _ = np.split(own, self.edges, axis=1)
        values = p if self.model.events else self.values(ids)
        return Inside(*map(np.ascontiguousarray, (y, values, memory))), np.ascontiguousarray(u)

    def write(self, inside: FloatArray, rows: IntArray, found: Inside, u: FloatArray) -> None:
        """Write networks and inputs to some rows of ``Cells.inside``."""
        p = found.p if self.model.events else found.p[:, :0]
        inside[rows, self.begin : self.begin + self.edges.memory] = np.concatenate(
            [found.y, p, u, found.memory], axis=1
        )

    def value(self, name: str, cells: Cells, time: float) -> FloatArray:
        """Return a state, parameter, input or observed value of each cell, (n,); NaN without."""
        assert cells.inside is not None
        model = self.model
        if name in model.states:
            return cells.inside[:, self.begin + model.states.index(name)]
        if name in model.inputs:
            return cells.inside[:, self.begin + self.edges.values + model.inputs.index(name)]
        out, rows = np.full(len(cells), np.nan), self.rows_with(cells)
        out[rows] = self._of(name, *self.read(cells.inside[rows], cells.id[rows]), time)
        return out

    def _of(self, name: str, known: Inside, u: FloatArray, time: float) -> FloatArray:
        model = self.model
        if name in model.states:
            return known.y[:, model.states.index(name)]
        if name in model.inputs:
            return u[:, model.inputs.index(name)]
        if name in model.parameters:
            return known.p[:, model.parameters.index(name)]
        values = self.solver.observe(known, u, time / self.seconds)
        return values[:, model.observed.index(name)]

    def filled(self, own: FloatArray, name: str, cells: Cells, time: float) -> FloatArray:
        """Return values of cells, with those that the network begins with in cells without it.

        They count in cells that become one of its types before it is in them.
        """
        assert cells.inside is not None
        rows = np.flatnonzero(np.isnan(cells.inside[:, self.begin + self.edges.inputs]))
        if rows.size:
            ids, own = cells.id[rows], own.copy()
            u = np.tile(np.array(self.model.defaults, dtype=float), (len(rows), 1))
            known = self.solver.begin(len(rows), u, self.values(ids))
            own[rows] = self._of(name, known, u, time)
        return own

    def rows_with(self, cells: Cells) -> IntArray:
        """Return the rows of the cells in which it is."""
        assert cells.inside is not None
        return np.flatnonzero(~np.isnan(cells.inside[:, self.begin + self.edges.inputs]))


@final
class Networks:
    """The networks of a scene, in the order in which they are solved.

    - ``parts``, name -> PlacedNetwork
    - ``columns``: names of all columns of ``Cells.inside``
    - ``needs``: signals that their inputs are made of
    - ``change_fields``: whether fields hang on them
    - ``exchanges``, (network, field) -> ``"uptake"`` or ``"secretion"``, the name of the rate, and
      the factor to amol/s
    """

    def __init__(self, scene: Scene, find: Callable[[Scene, str], tuple[Level, set[str]]]) -> None:
        self.parts: dict[str, PlacedNetwork] = {}
        kinds, begin = list(scene.types), 0
        for name in network_order(scene):
            part = scene.networks[name]
            levels = {}
            for x, signal in (part.inputs or {}).items():
                level, needs = find(scene, signal)
                levels[x] = level, frozenset(needs), input_factor(scene, part, x)
            mask = np.array([kind in part.types for kind in kinds]) if part.types else None
            names = columns_of_network(scene, name)
            made = PlacedNetwork(name, part, part.model, scene.seed, mask, levels, begin, names)
            self.parts[name] = made
            begin += len(made.columns)
        self.columns = tuple(x for part in self.parts.values() for x in part.columns)
        needed = (needs for part in self.parts.values() for _, needs, _ in part.levels.values())
        self.needs = frozenset().union(*needed)
        self.exchanges = {
            (name, field): (*flux_of(part, field), flux_factor(part, field))
            for name, part in scene.networks.items()
            for field in part.fluxes or ()
        }
        self._scene = scene
        self._given: tuple[IntArray, Mapping[str, FloatArray]] | None = None
        self.change_fields = networks_change_fields(scene)
        self._twice = any(OF_NEIGHBOURS in name for name in self.needs)

    @cached_property
    def inputs(self) -> frozenset[str]:
        """Signals that inputs are."""
        parts = self.parts.values()
        return frozenset(x for part in parts for x in (part.part.inputs or {}).values())

    def signals(
        self, names: Collection[str], cells: Cells, time: float, pairs: FindPairs
    ) -> dict[str, FloatArray]:
        """Return those of the signals that networks make, name -> (n,).

        - ``time``: s
        - ``pairs``: returns the rows of the cells that touch, (m, 2), and their weights, (m,):
          areas of contact if it is given True, else ones
        """
        out: dict[str, FloatArray] = {}
        if cells.inside is None:
            return out
        for signal in sorted(name for name in names if "." in name):
            network, _, name = value_around(signal).partition(".")
            part = self.parts[network]
            own = part.value(name, cells, time)
            if OF_NEIGHBOURS in signal:
                near = pairs(signal.startswith(WEIGHTED))
                own = _around(own, *near, mean=SUM_OF not in signal)
            elif part.kinds is not None:
                own = part.filled(own, name, cells, time)
            out[signal] = own
        return out

    def begin(self, cells: Cells, find: FindSignals | None = None, time: float = 0.0) -> None:
        """Set the networks of cells at the start of a run.

        - ``find``: returns the signals of cells; absent while there are no fields
        """
        if self._given is None:
            self._given = self._given_in(cells)
        for part in self.parts.values():
            rows = np.flatnonzero(part.has(cells))
            u = None if find is None else part.inputs(cells, find(cells))[rows]
            inside = self._new(part, cells.id[rows], u)
            if u is None:
                u = np.tile(np.array(part.model.defaults, dtype=float), (len(rows), 1))
            elif part.part.start == "steady":
                inside = self._settled(part, inside, u, cells.id[rows], time)
            self._take_given(part, inside, cells.id[rows])
            # later readers find it: other networks, and those of neighbours
            known = cells.inside
            shape = len(cells), len(self.columns)
            whole = np.full(shape, np.nan) if known is None else known.copy()
            own = slice(part.begin + part.edges.memory, part.begin + len(part.columns))
            whole[rows, own] = 0.0  # nothing has changed yet
            part.write(whole, rows, inside, u)
            cells.inside = whole

    def _given_in(self, cells: Cells) -> tuple[IntArray, Mapping[str, FloatArray]]:
        """Return the identities of the first cells, and values of networks that are given.

        Raises SceneError for cells with other networks than those of the scene.
        """
        from multicell.scene.start_table import inside_of

        if cells.inside is not None:
            return cells.id, inside_of(self._scene, cells)
        table = self._scene.initial.cells
        if table is None or not table.given.inside:
            return cells.id, {}
        return table.given.columns.get("id", np.arange(len(table.given))), table.given.inside

    def _take_given(self, part: PlacedNetwork, inside: Inside, ids: IntArray) -> None:
        """Set the values that are given of the first cells."""
        assert self._given is not None
        known, given = self._given
        if not given:
            return
        order = np.argsort(known)
        row = order[np.searchsorted(known, ids, sorter=order)]
        for name, values in given.items():
            network, _, of = name.partition(".")
            if network != part.name:
                continue
            names = (part.model.states, part.model.parameters)
            place = next(k for k in (0, 1) if of in names[k])
            column = (inside.y, inside.p)[place][:, names[place].index(of)]
            own = values[row]
            column[:] = np.where(np.isnan(own), column, own)

    def fluxes(
        self, field: str, cells: Cells, time: float
    ) -> tuple[FloatArray | None, FloatArray | None]:
        """Return uptake and secretion of a field at a time in s, (n,) amol/s.

        NaN in cells without a network that does, zero in dead ones, None where none does.
        """
        found: dict[str, FloatArray] = {}
        for (network, of), (what, name, factor) in self.exchanges.items():
            if of != field:
                continue
            own = factor * self.parts[network].value(name, cells, time)
            own = np.where(cells.dead & ~np.isnan(own), 0.0, own)
            before = found.get(what, np.full(len(cells), np.nan))
            both = np.where(np.isnan(before), 0.0, before) + np.where(np.isnan(own), 0.0, own)
            found[what] = np.where(np.isnan(before) & np.isnan(own), np.nan, both)
        return found.get("uptake"), found.get("secretion")

    def _new(self, part: PlacedNetwork, ids: IntArray, u: FloatArray | None) -> Inside:
        return part.solver.begin(len(ids), u, part.values(ids))

    def _settled(
        self, part: PlacedNetwork, inside: Inside, u: FloatArray, ids: IntArray, time: float
    ) -> Inside:
        from multicell.networks.solver import NetworkFailed

        try:
            return part.solver.settle(inside, u, time / part.seconds)
        except NetworkFailed as failure:
            raise _failed(part, failure, ids) from None

    def note_shares(
        self, cells: Cells, shares: Mapping[str, FloatArray], length: float = 0.0
    ) -> None:
        """Note uptakes of fields over the largest ones at cells, field -> (n,), and their slopes.

        - ``length``: of the step since they were noted last, s; 0: there was none
        """
        assert cells.inside is not None
        inside = cells.inside.copy()
        for name, field in self.exchanges:
            share, slope = self.parts[name].share_of(field)
            if length > 0.0:
                change = (shares[field] - inside[:, share]) / length
                inside[:, slope] = np.where(inside[:, share] > 0.0, change, 0.0)
            inside[:, share] = np.where(np.isnan(inside[:, share]), np.nan, shares[field])
        cells.inside = inside

    def shares_ahead(self, cells: Cells, length: float) -> dict[str, FloatArray]:
        """Return these uptakes a time in s later, field -> (n,), as their slopes have it."""
        assert cells.inside is not None
        out: dict[str, FloatArray] = {}
        for name, field in self.exchanges:
            share, slope = (cells.inside[:, x] for x in self.parts[name].share_of(field))
            own = _ahead(share, length * slope)
            out[field] = np.where(np.isnan(own), out.get(field, np.ones(len(cells))), own)
        return out

    def correction(self, predicted: Cells, cells: Cells) -> float:
        """Return by what part of a state the fields of a step's end have changed it at most."""
        worst = 0.0
        assert predicted.inside is not None
        assert cells.inside is not None
        for part in self.parts.values():
            states = slice(part.begin, part.begin + part.edges.states)
            one, other = predicted.inside[:, states], cells.inside[:, states]
            scale = np.abs(other) + part.solver.absolute / part.solver.relative
            change = (np.abs(one - other) / scale)[~np.isnan(other)]
            worst = max(worst, float(change.max(initial=0.0)))
        return worst

    def advance(
        self,
        cells: Cells,
        began: Cells,
        find: FindSignals | None,
        begin: float,
        end: float,
        held: Collection[str] = (),
        threads: int = 1,
        *,
        next_id: int,
        courses: Courses | None = None,
        waiting: Mapping[str, FloatArray] | None = None,
    ) -> FloatArray | None:
        """Bring the networks of cells through a step from ``begin`` to ``end`` (s).

        - ``cells``: at its end; ``inside`` is that of its beginning, or of their mothers
        - ``began``: at its beginning
        - ``find``: returns the signals of cells at its end; None: inputs are extrapolated
        - ``held``: signals that jump at the end, before which they were as at the beginning
        - ``next_id``: first identity that is free
        - ``courses``: what fields were at the cells on the way, for inputs that are one of them;
          all others go linearly from one end to the other
        - ``waiting``, network -> (n, 4): what cells wait for
          (:func:`multicell.biology.waiting.watched`)

        Returns at which part of the step that comes true, (n,); infinite where it does not, None
        where nothing is waited for.
        """
        assert cells.inside is not None
        first = cells.inside
        step = _Step(cells, began, begin, end, next_id)
        met: FloatArray | None = None
        for _ in range(1 + (self._twice and find is not None)):
            known, met = cells.inside, None
            for part in self.parts.values():
                if find is not None:
                    u = part.inputs(cells, find(cells))
                else:
                    place = part.begin + part.edges.values
                    u = first[:, place : place + len(part.model.inputs)]
                    u = _ahead(u, (end - begin) * first[:, part.slopes])
                    # a cell that has just become one of its type has no slopes
                    u = np.where(np.isnan(u), np.array(part.model.defaults), u)
                known = known.copy()
                own = (waiting or {}).get(part.name)
                found = self._advance(
                    part, step, first, known, u, held, threads, courses or {}, own
                )
                cells.inside = known
                if found is not None:  # a cell waits for one network at a time
                    met = found if met is None else np.minimum(met, found)
        return met

    def _advance(
        self,
        part: PlacedNetwork,
        step: _Step,
        first: FloatArray,
        out: FloatArray,
        u: FloatArray,
        held: Collection[str],
        threads: int,
        courses: Courses,
        waiting: FloatArray | None,
    ) -> FloatArray | None:
        """Write what becomes of one network in all cells; return when it is what they wait for."""
        from multicell.networks.solver import NetworkFailed

        cells, own = step.cells, slice(part.begin, part.begin + len(part.columns))
        has = part.has(cells)
        out[~has, own] = np.nan
        fresh = has & np.isnan(first[:, part.begin + part.edges.inputs])
        rows = np.flatnonzero(fresh)
        if rows.size:
            out[rows, own] = 0.0
            part.write(out, rows, self._new(part, cells.id[rows], u[rows]), u[rows])
        rows = np.flatnonzero(has & ~fresh & ~cells.dead)
        met = None if waiting is None else np.full(len(cells), np.inf)
        if not rows.size:
            return met
        inside, before = part.read(first[rows], step.mother[rows])
        after = u[rows].copy()
        for place, name in enumerate(part.model.inputs):
            if name in part.levels and part.levels[name][1] & set(held):
                after[:, place] = before[:, place]
        ids = cells.id[rows]
        solver = part.solver_for(threads) if threads > 1 else part.solver
        start, length = step.begin / part.seconds, (step.end - step.begin) / part.seconds
        if waiting is not None:
            waiting = waiting[rows]
            waiting[:, SINCE] = start + length * waiting[:, SINCE]
        path = _path(part, step, rows, before, after, courses)
        try:
            for piece in itertools.pairwise(path):
                inside = self._through_piece(part, step, rows, solver, inside, *piece, waiting)
                if met is not None and inside.met is not None:
                    at = np.clip((inside.met - start) / length, 0.0, np.inf)
                    met[rows] = np.minimum(met[rows], at)
        except NetworkFailed as failure:
            raise _failed(part, failure, ids) from None
        part.write(out, rows, inside, u[rows])
        if part.slopes.stop > part.slopes.start:
            out[rows, part.slopes] = (after - before) / (step.end - step.begin)
        return met

    def _through_piece(
        self,
        part: PlacedNetwork,
        step: _Step,
        rows: IntArray,
        solver: NetworkSolver,
        inside: Inside,
        first: tuple[float, FloatArray],
        last: tuple[float, FloatArray],
        waiting: FloatArray | None,
    ) -> Inside:
        """Return the networks of some cells after a piece of a step, of which daughters are born.

        - ``first``, ``last``: part of the step at both ends, and inputs there
        - ``waiting``, (n, 4): what cells wait for, in the network's own time
        """
        (begin, before), (end, after) = first, last
        born, since = step.born[rows], step.since[rows]
        length, start = (step.end - step.begin) / part.seconds, step.begin / part.seconds
        growth, from_here = step.growth[rows] / length, np.full(len(rows), begin)
        newborn = np.flatnonzero(born & (since >= begin) & ((since < end) | (end == 1.0)))
        if newborn.size:
            at = since[newborn]
            middle = _middle(
                step.mother[rows][newborn],
                before[newborn],
                after[newborn],
                (at - begin) / (end - begin),
            )
            half = solver.advance(
                _some(inside, newborn),
                before[newborn],
                middle,
                start + length * begin,
                length * (at - begin),
                growth=growth[newborn],
                diluted=part.diluted,
            )
            half = self._inherited(part, half, step, rows[newborn])
            for whole, piece in zip(_arrays(inside), _arrays(half), strict=True):
                whole[newborn] = piece
            before = before.copy()
            before[newborn], from_here[newborn] = middle, at
        return solver.advance(
            inside,
            before,
            after,
            start + length * from_here,
            length * (end - from_here),
            growth=growth,
            diluted=part.diluted,
            waiting=waiting,
        )

    def divided(
        self,
        daughters: Cells,
        mothers: Cells,
        rows: IntArray,
        began: Cells,
        signals: Signals,
        begin: float,
        end: float,
        held: Collection[str] = (),
        *,
        next_id: int,
        courses: Courses | None = None,
    ) -> None:
        """Set the networks of daughters of a step once those of their mothers are known.

        - ``mothers``: cells that have divided, and others, at the end of the step
        - ``rows``, (n,): of the mother of each daughter among them
        - ``began``: cells at the beginning of the step
        - ``signals``: what ``mothers`` find at its end; ``courses``: and on the way
        """
        assert began.inside is not None
        assert mothers.inside is not None
        own = {x for x in signals if "." in x and OF_NEIGHBOURS not in x}
        around = {name: values[rows] for name, values in signals.items()}

        def find(cells: Cells) -> Signals:
            return {**around, **self.signals(own, cells, end, no_pairs)}

        daughters.inside = began.inside[began.rows_of(daughters.parent)]
        seen = {name: (times, x[:, rows]) for name, (times, x) in (courses or {}).items()}
        self.advance(daughters, began, find, begin, end, held, next_id=next_id, courses=seen)
        for part in self.parts.values():  # concentrations are the mothers' still
            places = slice(part.slopes.stop, part.begin + len(part.columns))
            daughters.inside[:, places] = mothers.inside[rows, places]

    def _inherited(
        self, part: PlacedNetwork, inside: Inside, step: _Step, rows: IntArray
    ) -> Inside:
        """Return the share of newborn cells in their mothers' networks at the division."""
        from multicell.networks.solver import Inside

        model, y = part.model, inside.y.copy()
        mother, second = step.mother[rows], step.second[rows]
        for place, name in enumerate(model.states):
            amount = name in model.amounts
            rule = (part.part.divide or {}).get(name, "halve" if amount else "keep")
            event = zlib.crc32(f"{part.name}.{name}".encode())
            column = y[:, place]
            if rule == "halve":
                column *= 0.5
            elif rule == "reset":
                column[:] = model.start[place]
            elif rule in ("binomial", "share"):
                z = random.uniform(part.seed, Purpose.NETWORK_DIVISION, event, mother)[:, 0]
                if rule == "share":
                    column *= np.where(second, 1.0 - z, z) * (1.0 if amount else 2.0)
                else:
                    column[:] = _binomial(column, z, second)
        p = inside.p
        if model.events:  # changes by events stay, drawn values are drawn anew
            p, own = p.copy(), part.values(step.cells.id[rows])
            for name, given in (part.part.parameters or {}).items():
                if isinstance(given, Draw):
                    drawn = model.parameters.index(name)
                    p[:, drawn] = own[:, drawn]
        else:
            p = part.values(step.cells.id[rows])
        return Inside(y, p, inside.memory)


@final
class _Step:
    """A coupling step as all networks need it.

    - ``born``, (n,): which cells were born in it; ``since``: part of the step before that
    - ``mother``: identity of the mother of those, else of the cell; ``second``: of two sisters
    - ``growth``: by how much ln(volume) has risen in it, that of the mother before included
    """

    def __init__(self, cells: Cells, began: Cells, begin: float, end: float, next_id: int) -> None:
        self.cells, self.begin, self.end = cells, begin, end
        row = began.rows_of(cells.id)
        self.born = row < 0
        self.mother = np.where(self.born, cells.parent, cells.id)
        row[self.born] = began.rows_of(cells.parent[self.born])
        self.since = np.where(self.born, 1.0 - np.minimum(cells.age / (end - begin), 1.0), 0.0)
        was = began.radius[row] * np.where(self.born, HALF, 1.0)
        self.growth = 3.0 * np.log(cells.radius / was)
        self.second = self.born & are_second(cells.id, next_id)


def _path(
    part: PlacedNetwork,
    step: _Step,
    rows: IntArray,
    before: FloatArray,
    after: FloatArray,
    courses: Courses,
) -> list[tuple[float, FloatArray]]:
    """Return parts of a step and the inputs of cells then, (n, m), between which they go linearly.

    There are as many as the networks' tolerance needs. Until they are born daughters have the mean
    of their signals.
    """
    times, bends = _bends(part, rows, courses)
    chosen = _corners(times, bends, part.part.tolerance * np.abs([before, after]).max(axis=(0, 1)))
    path = [(0.0, before)]
    born, since, mother = step.born[rows], step.since[rows][:, None], step.mother[rows]
    for k in chosen[1:-1]:
        x = times[k]
        middle = _middle(mother, before, after, since[:, 0])
        late = middle + (x - since) / np.maximum(1.0 - since, x - since) * (after - middle)
        early = _middle(mother, before, after, np.full(len(rows), x))
        bend = bends[k]
        both = _middle(mother, np.zeros_like(bend), bend, np.ones(len(rows)))
        own = before + x * (after - before) + bend
        path.append(
            (x, np.where(born[:, None], np.where(x <= since, early + both, late + bend), own))
        )
    return [*path, (1.0, after)]


def _bends(part: PlacedNetwork, rows: IntArray, courses: Courses) -> tuple[FloatArray, FloatArray]:
    """Return parts of a step, (k,), and by how much inputs are off a straight line, (k, n, m)."""
    inputs = {
        place: (*courses[signal], part.levels[name][2])
        for place, name in enumerate(part.model.inputs)
        if (signal := (part.part.inputs or {}).get(name, "")) in courses
    }
    times = np.unique(np.concatenate([[0.0, 1.0], *(known for known, *_ in inputs.values())]))
    bends = np.zeros((len(times), len(rows), len(part.model.inputs)))
    for place, (known, values, factor) in inputs.items():
        own = factor * values[:, rows]
        right = np.clip(np.searchsorted(known, times), 1, len(known) - 1)
        share = (times - known[right - 1]) / (known[right] - known[right - 1])
        there = own[right - 1] + share[:, None] * (own[right] - own[right - 1])
        bends[:, :, place] = there - there[0] - times[:, None] * (there[-1] - there[0])
    return times, bends


def _corners(times: FloatArray, bends: FloatArray, allowed: FloatArray) -> list[int]:
    """Return the moments between which straight lines are near enough to a path, both ends too."""
    chosen = [0, len(times) - 1]
    while len(chosen) <= min(_MOST_PIECES, len(times) - 1):
        right = np.clip(np.searchsorted(times[chosen], times), 1, len(chosen) - 1)
        one, other = (np.array(chosen)[right - k] for k in (1, 0))
        share = ((times - times[one]) / (times[other] - times[one]))[:, None, None]
        off = np.abs(bends - bends[one] - share * (bends[other] - bends[one])).max(axis=1)
        excess = (off - allowed).max(axis=1, initial=-1.0)
        worst = int(excess.argmax())
        if not excess[worst] > 0.0:
            break
        chosen = sorted([*chosen, worst])
    return chosen


def _arrays(inside: Inside) -> tuple[FloatArray, FloatArray, FloatArray]:
    return inside.y, inside.p, inside.memory


def _ahead(value: FloatArray, change: FloatArray) -> FloatArray:
    """Return values that change, but those that would come near to zero or beyond as they are."""
    ahead = value + change
    return np.asarray(np.where(ahead * value >= 0.1 * value * value, ahead, value))


def _some(inside: Inside, rows: IntArray) -> Inside:
    return type(inside)(inside.y[rows], inside.p[rows], inside.memory[rows])


def _middle(
    mother: IntArray, before: FloatArray, after: FloatArray, since: FloatArray
) -> FloatArray:
    """Return the inputs of mothers when they divide: sisters have the same until then."""
    _, group, count = np.unique(mother, return_inverse=True, return_counts=True)
    end = np.empty_like(after)
    for k in range(after.shape[1]):
        end[:, k] = (np.bincount(group, after[:, k]) / count)[group]
    return np.asarray(before + since[:, None] * (end - before))


def _binomial(total: FloatArray, z: FloatArray, second: Mask) -> FloatArray:
    """Return the part of each daughter where chance decides for each molecule.

    What is left over a whole number of molecules is halved.

    - ``total``, (n,): of the mothers; ``z``, (n,): uniform, the same for two sisters
    """
    from scipy.special import bdtrik

    whole = np.floor(np.maximum(total, 0.0))
    first = np.zeros(len(total))
    some = whole > 0.0
    # the least number whose distribution function reaches z
    found = np.ceil(bdtrik(z[some], whole[some], 0.5) - 1e-9)
    first[some] = np.clip(np.where(np.isnan(found), 0.0, found), 0.0, whole[some])
    return np.asarray(np.where(second, whole - first, first) + 0.5 * (total - whole))


def no_pairs(weighted: bool) -> tuple[IntArray, FloatArray]:
    """Return that no cells touch, for :meth:`Networks.signals`."""
    return np.empty((0, 2), np.int64), np.empty(0)


def _around(values: FloatArray, pairs: IntArray, weights: FloatArray, *, mean: bool) -> FloatArray:
    """Return sum or mean of a value over the neighbours that have it, (n,); 0 without any."""
    first, second = np.concatenate([pairs, pairs[:, ::-1]]).T
    weights, has = np.concatenate([weights, weights]), ~np.isnan(values[second])
    first, second, weights = first[has], second[has], weights[has]
    order = np.lexsort((second, first))  # sums do not hang on the order of the pairs
    first, second, weights = first[order], second[order], weights[order]
    total = np.bincount(first, weights * values[second], minlength=len(values)).astype(float)
    if not mean:
        return total
    whole = np.bincount(first, weights, minlength=len(values))
    found = np.divide(total, whole, out=np.zeros(len(values)), where=whole > 0.0)
    return np.asarray(found)


def _failed(part: PlacedNetwork, failure: Any, ids: IntArray) -> StepFailed:
    hint = "Look at its inputs and parameters; a tighter tolerance may help."
    problem = f"network {part.name}: {failure.problem}"
    return StepFailed(failure.time * part.seconds, problem, hint, int(ids[failure.row]))
