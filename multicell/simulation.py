"""A simulation: a scene plus state, which advances in coupling steps.

In each step the data goes one way: growth rates from what the cells find around them, motion
while the radii grow, then all events (division, removal), then the nutrient field of the new
configuration, and from it the cells' new states. So a frame taken between two steps is
consistent: its concentrations are those of its own cells.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, final

import numpy as np

from multicell import random
from multicell.biology import adhesion
from multicell.biology.active_forces import push
from multicell.biology.cycle import Cycling, advance, leave_rest, parting
from multicell.biology.death import remove_lysed
from multicell.biology.division import divide
from multicell.biology.growth import growth_factor, volumes_after
from multicell.biology.initial import initial_cells
from multicell.biology.states import deciding, restricted, unfavourable, update_states
from multicell.cells import DEAD, SPHERE, Cells, FloatArray, IntArray
from multicell.errors import NutrientFailed, SceneError, StepFailed
from multicell.integrators import registry
from multicell.mechanics import neighbours
from multicell.mechanics.system import Mechanics, Motion
from multicell.nutrient.balance import Ledger
from multicell.results import observables
from multicell.results.folder import versions
from multicell.results.frame import Field, Frame, Progress
from multicell.results.lineage import Lineage
from multicell.results.quantities import units_of
from multicell.scene import pairs
from multicell.scene.domain import strayed, walls
from multicell.scene.ranges import check_memory
from multicell.threads import thread_count

if TYPE_CHECKING:
    from multicell.integrators.base import Integrator
    from multicell.nutrient.fields import Feeding
    from multicell.scene.scene import Scene


PHASES = ("nutrient", "biology", "mechanics", "events", "record")
"""Phases of the loop whose wall time is measured."""

_STATE = (
    "cells", "step_index", "contacts", "separation", "divisions", "removals", "released",
    "local_error", "_next_id", "_unsorted",
)  # fmt: skip
"""What a coupling step changes, beside fields, logs and counts of work."""

_STALE_ORDER = 0.05
"""Part of the cells that may be new before all are sorted in space again."""


@final
class Simulation:
    """Cells of a scene, and what moves, feeds and divides them.

    Parameters
    ----------
    scene
        What there is.
    threads
        Number of threads for large populations, by default all that there are. The results
        have the same bits for any number.
    cells
        Cells to start from instead of the scene's initial ones.
    frame
        State to go on from, of a run of this scene; what comes is what would have come.
    lineage
        Of the run that the frame is from.
    integrator
        A method of the user's own, in place of the one that the scene names.

    Attributes
    ----------
    cells : Cells
        The state at ``time``.
    time : float, s
    step_index : int
        Number of coupling steps done.
    divisions, removals : int
        Events so far.
    released : float, µm³
        Volume that dead cells have lost, their remains at removal included.
    local_error : float or None, µm
        The largest error that the integrator expects to have made with a cell in one of its steps
        so far; None before the first step, and with a method that makes no estimate.
    wall : phase -> s
        Wall time of each phase of the loop.

    Raises
    ------
    SceneError
        If there are not as many threads, or a cell starts outside the scene's domain.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        threads: int | None = None,
        cells: Cells | None = None,
        frame: Frame | None = None,
        lineage: Lineage | None = None,
        integrator: Integrator | None = None,
    ) -> None:
        if cells is None and frame is None:
            check_memory(scene)
        self.scene = scene
        self.wall = dict.fromkeys(PHASES, 0.0)
        self.step_index = self.divisions = self.removals = 0
        self._origin = (0, 0.0)
        self.released = 0.0
        self.local_error: float | None = None
        self._mechanics = _mechanics(scene, thread_count(threads))
        # identities of the pairs in contact, (m, 2): what exact JKR remembers, and others count
        self.contacts = np.empty((0, 2), dtype=np.int64)
        self.separation: dict[str, float] | None = None
        self._integrator = integrator or registry.make(scene.integrator)
        self._feeding = _feeding(scene)
        self.lineage = Lineage() if lineage is None else lineage
        if frame is None:
            self._start(_separated(scene, initial_cells(scene) if cells is None else cells))
        else:
            self._restore(frame)

    def _start(self, cells: Cells) -> None:
        """Begin with these cells."""
        _refuse_outside(self.scene, cells)
        self.cells = cells
        self._set_bonds({})
        self._next_id = int(cells.id.max(initial=-1)) + 1
        self.lineage.born(cells.take(np.argsort(cells.id)), self.time)
        self._unsorted = len(cells)
        self._sort()
        with self._phase("mechanics"):
            self._find_first_contacts()
        with self._phase("nutrient"):
            if self._feeding is not None:
                try:
                    self._feeding.begin(self.cells, self.time)
                except NutrientFailed as failure:
                    raise StepFailed(self.time, failure.problem, failure.hint) from failure
                self._set_bonds(self.concentrations)
        with self._phase("biology"):
            self._change_states(0.0)

    def _restore(self, frame: Frame) -> None:
        """Go on from a frame."""
        known = frame.progress
        if known is None:
            raise ValueError("this frame does not hold what a run needs to go on")
        self.step_index = frame.step
        if frame.time != frame.step * self.scene.coupling_step:
            # a run whose last step was a shorter one has been prolonged: count from here
            self._origin = (frame.step, frame.time)
        self.cells = frame.cells.take(np.arange(len(frame.cells)))
        _refuse_outside(self.scene, self.cells)
        self.contacts = np.array(frame.contacts)
        self.divisions, self.removals = known.divisions, known.removals
        self.released, self.local_error = known.released, known.local_error
        self._next_id, self._unsorted = known.next_id, known.unsorted
        self.separation = None if known.separation is None else dict(known.separation)
        for name, count in known.work.items():
            setattr(self._mechanics.work, name, count)
        if self._feeding is not None:
            self._feeding.restore(frame)

    def _progress(self) -> Progress:
        """Return what a frame needs so that the run can be resumed from it."""
        feeding = self._feeding
        return Progress(
            self._next_id,
            self.divisions,
            self.removals,
            self._unsorted,
            self.released,
            self.separation,
            {} if feeding is None else {n: asdict(x) for n, x in feeding.ledger.items()},
            {} if feeding is None else {n: asdict(x) for n, x in feeding.reports.items()},
            asdict(self._mechanics.work),
            self.local_error,
        )

    @property
    def concentrations(self) -> dict[str, FloatArray]:
        """Concentration of each nutrient at the cells, name -> (n,) mM."""
        return {} if self._feeding is None else self._feeding.concentrations

    @property
    def ledger(self) -> dict[str, Ledger]:
        """What has come in, been taken up, secreted, stored ... of each nutrient."""
        return {} if self._feeding is None else self._feeding.ledger

    @property
    def time(self) -> float:
        """Simulated time, s: whole coupling steps from the start or a prolonged end, or the end."""
        step, time = self._origin
        return min(time + (self.step_index - step) * self.scene.coupling_step, self.scene.duration)

    @property
    def steps(self) -> int:
        """Number of coupling steps from the start to the scene's end."""
        step, time = self._origin
        ahead = (self.scene.duration - time) / self.scene.coupling_step
        return max(1, step + math.ceil(ahead * (1.0 - 1e-12)))

    @property
    def finished(self) -> bool:
        """Whether the duration or the number of cells is reached, or all are pulled apart."""
        enough = self.scene.stop_cells
        grown = enough is not None and len(self.cells) >= enough
        return self.step_index >= self.steps or grown or self.separation is not None

    @property
    def fields(self) -> dict[str, Field]:
        """The nutrient fields as they were last solved."""
        return {} if self._feeding is None else self._feeding.snapshot()

    def step(self) -> None:
        """Advance by one coupling step.

        Raises
        ------
        StepFailed
            If positions or a field cannot be solved for. After this and any other exception
            (Ctrl-C) the state is that of the step's beginning.
        """
        kept = self._kept()
        try:
            self._advance()
        except NutrientFailed as failure:
            self._take_back(kept)
            raise StepFailed(self.time, failure.problem, failure.hint) from failure
        except BaseException:
            self._take_back(kept)
            raise

    def _advance(self) -> None:
        """Do one coupling step; an exception leaves parts of it behind."""
        begin = self.time
        end = min(begin + self.scene.coupling_step, self.scene.duration)
        with self._phase("biology"):
            radius, cycling = self._grown(end - begin)
        with self._phase("mechanics"):
            position, pressure = self._move(begin, end, radius)
        with self._phase("events"):
            self._take(position, radius, pressure, end - begin, cycling)
            self._divide_and_remove()
            self._sort()
        with self._phase("nutrient"):
            if self._feeding is not None:
                self._feeding.advance(self.cells, begin, end)
        with self._phase("biology"):
            self._change_states(end - begin)

    def _kept(self) -> dict[str, Any]:
        """Return what :meth:`_take_back` needs to undo a step.

        A step makes new arrays and does not write into those that are there: to keep them is
        to remember them. Logs and accounts only grow.
        """
        return {
            "lineage": self.lineage.counts(),
            "work": asdict(self._mechanics.work),
            "feeding": None if self._feeding is None else self._feeding.kept(),
            "rest": {name: getattr(self, name) for name in _STATE},
        }

    def _take_back(self, kept: Mapping[str, Any]) -> None:
        """Make the state that was kept the state again."""
        self.lineage.cut(kept["lineage"])
        for name, count in kept["work"].items():
            setattr(self._mechanics.work, name, count)
        if self._feeding is not None:
            self._feeding.take_back(kept["feeding"])
        for name, value in kept["rest"].items():
            setattr(self, name, value)

    def frame(self) -> Frame:
        """Return the state as a frame that later steps do not change."""
        return Frame(
            self.time,
            self.step_index,
            self.cells.take(np.arange(len(self.cells))),
            {name: values.copy() for name, values in self.concentrations.items()},
            self.fields,
            self.contacts,
            self._progress(),
        )

    def history_row(self) -> dict[str, float]:
        """Return the observables of the state (see :func:`observables.history_row`)."""
        extra: dict[str, float] = {}
        if _counts_contacts(self.scene):
            extra["contacts"] = float(len(self.contacts))
        extra |= self._mixing()
        extra |= {f"hypoxic_radius_{name}": r for name, r in self._hypoxic().items()}
        round_fields = any(part.geometry != "box" for part in self.scene.nutrients.values())
        if round_fields and self.scene.dimensions == 3:
            extra["departure_from_a_ball"] = _departure(self.cells)
        if self.scene.pull is not None:
            extra["pull"] = self.scene.pull.force + self.scene.pull.rate * self.time
        extra |= self._held_back()
        dimensions = self.scene.dimensions
        return observables.history_row(self.time, self.step_index, self.cells, dimensions, **extra)

    def _held_back(self) -> dict[str, float | int]:
        """Return how much pressure holds growth back, where it does."""
        growth = self.scene.growth
        if growth is None or growth.critical_pressure is None:
            return {}
        return observables.pressure_summary(self.cells, growth.critical_pressure)

    def _hypoxic(self) -> dict[str, float]:
        """Return the radius in which cells lack each nutrient that makes them rest, µm."""
        return {
            name: observables.hypoxic_radius(
                self.cells,
                self.concentrations[name],
                nutrient.quiescence,
                self.scene.dimensions,
            )
            for name, nutrient in self.scene.nutrients.items()
            if nutrient.quiescence is not None and name in self.concentrations
        }

    def _mixing(self) -> dict[str, float]:
        """Return how the types mix, where there is more than one."""
        if len(self.scene.types) < 2:
            return {}
        fraction = observables.heterotypic_fraction(self.cells, self.contacts)
        return {"heterotypic_fraction": fraction}

    def energy(self) -> float:
        """Return the contact energy of the cells, fJ."""
        self._mechanics.begin(self._motion(self.time, self.time, self.cells.radius))
        return self._mechanics.energy(self.time, self.cells.position)

    def summary(self) -> dict[str, Any]:
        """Return the numbers that describe the run so far; ``units`` names the units.

        A number that does not exist (the viable rim without a core) is None.
        """
        own = observables.state_summary(self.time, self.cells, self.scene.dimensions)
        ledgers = {name: ledger.summary() for name, ledger in self.ledger.items()}
        remainders = [entry["relative_remainder"] for entry in ledgers.values()]
        whole: dict[str, Any] = {"relative_remainder": max(remainders)} if remainders else {}
        summary = {
            **own,
            **{name: observables.known(value) for name, value in self._held_back().items()},
            **({"hypoxic_radius": hypoxic} if (hypoxic := self._hypoxic()) else {}),
            "title": self.scene.title,
            "seed": self.scene.seed,
            "steps": self.step_index,
            "divisions": self.divisions,
            "removals": self.removals,
            "volume_released": self.released,
            "integrator": self._work(),
            "ledger": {**ledgers, **whole},
            **self._fitness(own["packing_ratio"]),
            **({"separation": self.separation} if self.separation else {}),
            **{name: observables.known(value) for name, value in self._mixing().items()},
            "wall": {**self.wall, "total": sum(self.wall.values())},
            "threads": self._mechanics.threads,
            "versions": versions(),
        }
        return {**summary, "units": units_of(summary)}

    def _work(self) -> dict[str, Any]:
        """Return what the integration has cost, and the largest error that it tells of."""
        work = {"method": self.scene.integrator.method, **asdict(self._mechanics.work)}
        known = {} if self.local_error is None else {"largest_local_error": self.local_error}
        return {**work, **known}

    def _fitness(self, packing: float | None) -> dict[str, Any]:
        """Return how well grids and geometries fit the tissue, and remarks on what does not."""
        from multicell.scene.packing import packing_notes

        known: dict[str, Any] = {}
        notes = packing_notes(self.scene, packing)
        if self._feeding is not None:
            known["fields"], remarks = self._feeding.fitness(self.cells, self.time)
            notes += remarks
        return {**known, **({"notes": notes} if notes else {})}

    @contextmanager
    def _phase(self, name: str) -> Iterator[None]:
        begin = clock.perf_counter()
        try:
            yield
        finally:
            self.wall[name] += clock.perf_counter() - begin

    def _grown(self, dt: float) -> tuple[FloatArray, Cycling | None]:
        """Return the radii after a time, and where the cells then are in their cycle."""
        scene, cells = self.scene, self.cells
        factor = growth_factor(scene, self.concentrations, cells.pressure)
        volume = volumes_after(scene, cells, factor, dt)
        cycling = None
        if scene.growth is not None and scene.growth.phases:
            resting = unfavourable(scene, cells, self.concentrations)
            cycling = advance(scene, cells, factor, resting, dt)
            volume += cycling.volume - cells.volume
        return np.asarray(np.cbrt(volume / SPHERE)), cycling

    def _motion(self, begin: float, end: float, radius: FloatArray) -> Motion:
        """Return what mechanics must know of the cells between two times."""
        cells, scene = self.cells, self.scene
        length = end - begin
        rate = (radius - cells.radius) / length if length > 0.0 else np.zeros(len(cells))
        apart = parting(scene, cells, length)
        return Motion(
            cells.radius, rate, cells.young, cells.poisson, begin, end,
            bonds=self._bonds(begin, end),
            push=push(scene, cells, begin, self._gradients()),
            kind=cells.kind if scene.types else None,
            touching=self._touching() if _remembers(scene) else None,
            slack_pairs=None if apart is None else apart[0],
            slack=None if apart is None else apart[1],
        )  # fmt: skip

    def _gradients(self) -> dict[str, FloatArray]:
        """Return the gradients that chemotaxis follows, at the cells."""
        if self._feeding is None or not self.scene.chemotaxis:
            return {}
        if not self._feeding.concentrations:
            # contacts are looked for before there is a field, and need no forces
            return {name: np.zeros((len(self.cells), 3)) for name in self.scene.chemotaxis}
        return self._feeding.gradients(self.cells.position, self.scene.chemotaxis)

    def prepared(self) -> Mechanics:
        """Return the mechanics made ready for the next coupling step, which is not taken."""
        begin = self.time
        end = min(begin + self.scene.coupling_step, self.scene.duration)
        radius, _ = self._grown(end - begin)
        self._mechanics.begin(self._motion(begin, end, radius))
        return self._mechanics

    def _move(self, begin: float, end: float, radius: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Integrate the positions; return them and the pressures at the end."""
        cells = self.cells
        self._mechanics.begin(self._motion(begin, end, radius))
        if len(cells) == 0:
            return cells.position, cells.pressure
        outcome = self._integrator.integrate(self._mechanics, cells.position)
        if not outcome.done:
            cell = None if outcome.cell is None else int(cells.id[outcome.cell])
            raise StepFailed(outcome.time, outcome.problem, outcome.hint, cell)
        self._keep_inside(outcome.position, cells, end)
        if not math.isnan(outcome.local_error):
            self.local_error = max(outcome.local_error, self.local_error or 0.0)
        pressure = self._mechanics.pressure(end, outcome.position)
        if _counts_contacts(self.scene):
            self._note_contacts(self._mechanics.contacts(end, outcome.position), end)
        return outcome.position, pressure

    def _keep_inside(self, position: FloatArray, cells: Cells, time: float) -> None:
        """Raise ``StepFailed`` where a centre has left the scene's domain."""
        domain = self.scene.domain
        found = None if domain is None else strayed(domain, position)
        if domain is None or found is None:
            return
        cell, side = found
        where = position[cell, "xyz".index(side[0])]
        hint = "Give the walls a larger domain.young, let less push the cells, or widen the domain"
        if domain.wall == "refuse":
            hint = "Widen the domain, or let its wall be 'elastic'"
        problem = f"its centre left the domain through the side {side}, to {side[0]} = {where:g} um"
        raise StepFailed(time, problem, hint, int(cells.id[cell]))

    def _find_first_contacts(self) -> None:
        """Find the pairs that overlap at the start, before any of them has touched."""
        if _counts_contacts(self.scene) and len(self.cells):
            self._mechanics.begin(self._motion(self.time, self.time, self.cells.radius))
            found = self._mechanics.contacts(self.time, self.cells.position)
            self.contacts = self.cells.id[found]

    def _note_contacts(self, found: IntArray, time: float) -> None:
        """Remember contacts by identity, and the pull at which the last one broke."""
        before, self.contacts = len(self.contacts), self.cells.id[found]
        if self.scene.pull is not None and before and not len(found):
            force = self.scene.pull.force + self.scene.pull.rate * time
            self.separation = {"time": time, "force": force}

    def _touching(self) -> IntArray:
        """Return the remembered contacts as indices of the present cells; dead ones are gone."""
        if len(self.cells) == 0:
            return np.empty((0, 2), dtype=np.int64)
        order = np.argsort(self.cells.id)
        ids = self.cells.id[order]
        place = np.minimum(np.searchsorted(ids, self.contacts), len(ids) - 1)
        known = (ids[place] == self.contacts).all(axis=1)
        return np.sort(order[place[known]], axis=1)

    def _take(
        self,
        position: FloatArray,
        radius: FloatArray,
        pressure: FloatArray,
        dt: float,
        cycling: Cycling | None,
    ) -> None:
        """Make the end of the motion the state."""
        cells = self.cells.take(np.arange(len(self.cells)))
        cells.position, cells.radius, cells.pressure = position, radius, pressure
        cells.age = cells.age + dt
        dead = np.isin(cells.state, DEAD)
        if dead.any():
            # what the dead took up when they swelled counts against what they lose
            lost = self.cells.radius[dead] ** 3 - radius[dead] ** 3
            self.released += SPHERE * float(lost.sum())
        if cycling is not None:
            cells.state, cells.phase = cycling.state, cycling.phase
            cells.progress, cells.phase_length = cycling.progress, cycling.phase_length
        if self.scene.adhesion is not None:
            end = adhesion.bond_levels(self.scene, self.cells, self.concentrations, self.time + dt)
            cells.receptor, cells.ligand = end[:, 0].copy(), end[:, 1].copy()
        self.cells = cells
        self.step_index += 1

    def _divide_and_remove(self) -> None:
        first, before = self._next_id, self.cells
        divided, next_id = divide(self.scene, self.cells, self.step_index, first)
        if next_id > first:
            # daughters lie within their mother: only one that is pressed nearly flat, or that no
            # wall holds, can have one outside
            self._keep_inside(divided.position, divided, self.time)
        self.cells, self._next_id = divided, next_id
        whole = float(self.cells.volume.sum())
        self.cells, removed = remove_lysed(self.scene, self.cells)
        if removed:
            self.released += whole - float(self.cells.volume.sum())
        self.divisions += (self._next_id - first) // 2
        self.removals += removed
        self._unsorted += self._next_id - first + removed
        if self._next_id > first or removed:
            self.lineage.events(before, self.cells, self.time)
            there = np.isin(self.contacts, self.cells.id).all(axis=1)
            self.contacts = self.contacts[there]

    def _set_bonds(self, concentrations: Mapping[str, FloatArray]) -> None:
        """Set receptors and ligands of all cells at the start."""
        if self.scene.adhesion is not None:
            levels = adhesion.bond_levels(self.scene, self.cells, concentrations, self.time)
            self.cells.receptor, self.cells.ligand = levels[:, 0].copy(), levels[:, 1].copy()

    def _bonds(self, begin: float, end: float) -> FloatArray | None:
        """Return receptors and ligands at ``begin`` with their rates."""
        return adhesion.bonds(self.scene, self.cells, self.concentrations, begin, end)

    def _sort(self) -> None:
        """Sort the cells in space when many are new: neighbours then share memory."""
        if self._unsorted > _STALE_ORDER * len(self.cells):
            width = 2.0 * float(self.cells.radius.max(initial=1.0))
            self.cells = self.cells.take(neighbours.spatial_order(self.cells.position, width))
            self._unsorted = 0

    def _change_states(self, dt: float) -> None:
        before = self.cells.state
        self.cells.state = update_states(
            self.scene, self.cells, self.concentrations, self.step_index, dt, self.time
        )
        if restricted(self.scene):
            due = deciding(self.cells, self.scene.coupling_step, self.scene.cells.reaction_time)
            well = ~unfavourable(self.scene, self.cells, self.concentrations)
            leave_rest(self.scene, self.cells, due & well)
        dead = (self.cells.state != before) & np.isin(self.cells.state, DEAD)
        if dead.any():
            self.cells.age[dead] = 0.0
            self.lineage.died(np.sort(self.cells.id[dead]), self.time)


def _mechanics(scene: Scene, threads: int) -> Mechanics:
    """Return the mechanics that a scene asks for."""
    rubbing = scene.friction
    return Mechanics(
        scene.contact,
        scene.drag.viscosity,
        threads,
        bond_strength=0.0 if scene.adhesion is None else scene.adhesion.strength,
        friction=(0.0, 0.0) if rubbing is None else (rubbing.normal, rubbing.tangential),
        surface_energies=pairs.surface_energies(scene),
        walls=walls(scene),
    )


def _refuse_outside(scene: Scene, cells: Cells) -> None:
    """Raise ``SceneError`` for a cell that starts outside the scene's domain."""
    found = None if scene.domain is None else strayed(scene.domain, cells.position)
    if found is not None:
        cell, side = found
        place = ", ".join(f"{x:g}" for x in cells.position[cell])
        problem = f"is too small: cell {cells.id[cell]} starts at ({place}) um, beyond side {side}"
        hint = "Widen the domain, or start with fewer cells."
        raise SceneError(f"domain.{side[0]}", problem, hint)


def _remembers(scene: Scene) -> bool:
    """Return whether the contact law needs to know which pairs were in contact."""
    return hasattr(scene.contact, "in_contact")


def _counts_contacts(scene: Scene) -> bool:
    """Return whether anything asks for the pairs in contact; to find them costs a little."""
    return _remembers(scene) or len(scene.types) > 1 or scene.pull is not None


def _departure(cells: Cells) -> float:
    """Return the departure of the tissue from a ball; only scenes with shells load it."""
    from multicell.nutrient.cartesian import departure

    return departure(cells.position, cells.radius)


def _feeding(scene: Scene) -> Feeding | None:
    """Return the scene's fields; a scene without nutrients does not load them."""
    if not scene.nutrients:
        return None
    from multicell.nutrient.fields import Feeding

    return Feeding(scene)


def _separated(scene: Scene, cells: Cells) -> Cells:
    """Move cells apart whose centres coincide: between them no force has a direction.

    Each but one of them moves by a millionth of its radius along a random direction; the
    contact forces do the rest.
    """
    if len(cells) < 2:
        return cells
    pairs = neighbours.neighbour_pairs(cells.position, 1e-9 * float(cells.radius.min()))
    moved = np.unique(pairs[:, 1])
    if len(moved):
        cells = cells.take(np.arange(len(cells)))
        axis = random.directions(
            scene.seed, random.Purpose.SEPARATION, 0, cells.id[moved], scene.dimensions
        )
        cells.position[moved] += 1e-6 * cells.radius[moved, None] * axis
    return cells
