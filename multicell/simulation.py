"""A simulation: a scene plus state, which advances in coupling steps.

In each step the data goes one way: growth rates from what the cells find around them, motion
while the radii grow, then all events (division, removal), then the nutrient field of the new
configuration, and from it the cells' new states. So a frame taken between two steps is
consistent: its concentrations are those of its own cells.
"""

from __future__ import annotations

import math
import operator
import time as clock
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any, final

import numpy as np

from multicell.biology import driven, spring_graph
from multicell.biology.growth import growth_factor
from multicell.biology.initial import initial_cells
from multicell.biology.motion import motion_of
from multicell.biology.pace import Pace, end_of_step, first_pace, next_pace
from multicell.biology.splitting import StepError, columns, held, jumps, step_error
from multicell.biology.spring_graph import Springs
from multicell.biology.start_states import StartStates
from multicell.biology.step import aged, bind, decide, divide_and_remove, grow
from multicell.cells import Cells, FloatArray
from multicell.compiling import COMPILATION
from multicell.contact.custom import Compiling
from multicell.errors import NutrientFailed, SceneError, StepFailed
from multicell.integrators import registry, stability
from multicell.integrators.shift import SHIFT, Replays, replay_step, shifted_positions
from multicell.integrators.stability import Stability
from multicell.interrupts import STEP, UNCUT
from multicell.mechanics import binning
from multicell.mechanics.motion import Motion
from multicell.mechanics.system import Mechanics
from multicell.nutrient.balance import Ledger
from multicell.results import summary
from multicell.results.frame import Field, Frame, Progress
from multicell.results.lineage import Lineage
from multicell.results.observables import contact_rows
from multicell.scene import start
from multicell.scene.checks import followed
from multicell.scene.coupling import fixed_step, longest_step
from multicell.scene.domain import check_inside, check_start
from multicell.scene.ranges import check_memory
from multicell.threads import thread_count

if TYPE_CHECKING:
    from multicell.biology.splitting import Held
    from multicell.cells import IntArray
    from multicell.integrators.base import Integrator
    from multicell.nutrient.fields import Feeding
    from multicell.nutrient.reactions.own import OwnReaction
    from multicell.scene.scene import Scene


PHASES = ("compile", "nutrient", "biology", "mechanics", "events", "record")
"""Phases of the loop whose wall time is measured; no moment belongs to two of them."""

_NOTED = (
    "divisions", "removals", "released", "separation", "next_id", "unsorted", "splitting",
    "first_states",
)  # fmt: skip
"""What a run notes beside its cells; a frame's progress has entries of the same names."""

_STATE = ("cells", "step_index", "contacts", "step_error", "pace", "named", "springs", "_origin",
          "replays", "stability",
          *_NOTED)  # fmt: skip
"""What a coupling step changes, beside fields, logs and counts of work."""

_STALE_ORDER = 0.05
"""Part of the cells that may be new before all are sorted in space again."""


@final
class _Phase:
    """Adds the wall time of a block to that of a phase, and what numba took of it to another."""

    def __init__(self, wall: dict[str, float], name: str) -> None:
        self.wall, self.name = wall, name

    def __enter__(self) -> None:
        self.begin, self.compiled = clock.perf_counter(), COMPILATION.seconds

    def __exit__(self, *_: object) -> None:
        compiled = COMPILATION.seconds - self.compiled
        self.wall["compile"] += compiled
        self.wall[self.name] += clock.perf_counter() - self.begin - compiled


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
        Cells to start from instead of the scene's initial ones: as they are, or as a table (path
        of a CSV or Parquet file, a ``DataFrame``, columns by title) whose cells the scene takes as
        with ``initial.cells``.
    frame
        State to go on from, of a run of this scene; what comes is what would have come.
    lineage
        Of the run that the frame is from.
    integrator
        A method of the user's own, in place of the one that the scene names.
    reactions
        Between fields, of the user's own (:func:`multicell.reaction`), besides those of the scene.

    Attributes
    ----------
    cells : Cells
        The state at ``time``.
    time : float, s
    step_index : int
        Number of coupling steps done.
    divisions, removals : int
        Events so far.
    next_id, unsorted : int
        First identity that is free, and new cells since all were last sorted in space.
    released : float, µm³
        Volume that dead cells have lost, their remains at removal included.
    replays : Replays or None
        What a small shift of all positions has done to the ends of some coupling steps, which were
        taken twice (:mod:`multicell.integrators.shift`); None to take none twice.
    stability : Stability
        How far a fixed step was from its limit, where it has one
        (:mod:`multicell.integrators.stability`).
    splitting : float or None, µm³
        The error that coupling steps have made so far with the volume of all cells, over their
        number; None without growth. What the last step has made of it is ``step_error``.
    first_states : name -> int
        Cells that rested and were dead at the start, as it found them, and whose state does not
        fit the field.
    named : table of the scene -> (k,) identities
        Cells that are driven from outside because of who or where they were at the start.
    springs : Springs
        Those that join cells; none where the scene has none.
    pace : Pace or None
        What chooses the next coupling step; None where the scene fixes it.
    wall : phase -> s
        Wall time of each phase of the loop.

    Raises
    ------
    SceneError
        If there are not as many threads, a cell starts outside the scene's domain, or reactions do
        not fit the fields, or are not those that the run of ``frame`` was started with.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        threads: int | None = None,
        cells: Cells | Any = None,
        frame: Frame | None = None,
        lineage: Lineage | None = None,
        integrator: Integrator | None = None,
        reactions: Mapping[str, OwnReaction] | None = None,
    ) -> None:
        if cells is not None and not isinstance(cells, Cells):
            from multicell.scene.start_table import with_cells

            scene, cells = with_cells(scene, cells), None
        if cells is None and frame is None:
            check_memory(scene)
        self.scene = scene
        self._compiling = Compiling(scene.contact)
        self.wall = dict.fromkeys(PHASES, 0.0)
        self.step_index = self.divisions = self.removals = 0
        self._origin = (0, 0.0)
        self.released = 0.0
        self.replays: Replays | None = Replays()
        self.stability = Stability()
        self.splitting: float | None = None if scene.growth is None else 0.0
        self.first_states: Mapping[str, int] = {}
        self.step_error = StepError()
        self._known_factor: tuple[tuple[FloatArray, ...], FloatArray] = ((), np.empty(0))
        self.pace = None if fixed_step(scene) else first_pace(scene)
        self._mechanics = start.mechanics(scene, thread_count(threads))
        # identities of the pairs in contact, (m, 2): what exact JKR remembers, and others count
        self.contacts = np.empty((0, 2), dtype=np.int64)
        self.separation: Mapping[str, float] | None = None
        self.named: dict[str, IntArray] = {}
        self.springs = Springs()
        self._integrator = integrator or registry.from_options(scene.integrator)
        self._limit = stability.limit_of(self._integrator)
        self._feeding = _feeding(scene, reactions, self._mechanics.threads)
        self.lineage = Lineage() if lineage is None else lineage
        if frame is None:
            table = scene.initial.cells
            given = cells is not None or (table is not None and "state" in table.given.columns)
            first = start.separate(scene, initial_cells(scene) if cells is None else cells)
            self._start(first, given_states=given)
        else:
            self._restore(frame)

    def _start(self, cells: Cells, *, given_states: bool) -> None:
        """Begin with these cells; states that are not given are found with the fields."""
        check_start(self.scene, cells)
        self.named = driven.named_at_start(self.scene, cells)
        if self.scene.springs:
            self.springs = spring_graph.springs_at_start(self.scene, cells)
        self.cells = cells
        bind(self.scene, cells, cells, {}, self.time)
        self.next_id = int(cells.id.max(initial=-1)) + 1
        first = cells.take(np.argsort(cells.id))
        first.parent = np.full(len(first), -1)  # nothing is known of mothers before the start
        self.lineage.born(first, self.time)
        self.unsorted = len(cells)
        self._sort()
        with self.phase("mechanics"), self._compiling:
            self._find_first_contacts()
        with self.phase("nutrient"):
            if self._feeding is not None:
                try:
                    self._feeding.begin(self.cells, self.time)
                    if not given_states:
                        self._find_states(self._feeding)
                except NutrientFailed as failure:
                    raise StepFailed(self.time, failure.problem, failure.hint) from failure
                bind(self.scene, self.cells, self.cells, self.concentrations, self.time)
        if self._feeding is None or given_states:
            with self.phase("biology"):
                self._decide(0.0)

    def _find_states(self, feeding: Feeding) -> None:
        """Find states of the cells that fit the fields which they make."""

        def field(cells: Cells) -> dict[str, FloatArray]:
            feeding.begin(cells, self.time, again=True)
            return feeding.concentrations

        search = StartStates(self.scene, self.cells, field)
        self.cells, unfit = search.find(feeding.concentrations)
        resting, dead = int((search.rests & ~search.dead).sum()), int(search.dead.sum())
        if resting or dead or unfit:
            self.first_states = {"quiescent": resting, "necrotic": dead, "unfit": unfit}
        if dead:
            self.lineage.died(np.sort(self.cells.id[search.dead]), self.time)
            self.springs = spring_graph.without_dead(self.springs, self.cells)

    def _restore(self, frame: Frame) -> None:
        """Go on from a frame."""
        known = frame.progress
        if known is None:
            raise ValueError("this frame does not hold what a run needs to go on")
        if frame.time > self.scene.duration:
            raise SceneError(
                "duration",
                f"is {self.scene.duration:g} s, which ends before the frame at {frame.time:g} s",
                "Name a later end, or resume from an earlier frame.",
            )
        self.step_index = frame.step
        step = fixed_step(self.scene)
        if step is None or frame.time != frame.step * step:
            # a run whose last step was a shorter one has been prolonged: count from here
            self._origin = (frame.step, frame.time)
        if step is None:
            self.pace = Pace.of(known.pace) or self.pace
        self.cells = frame.cells.copy()
        check_start(self.scene, self.cells)
        self.contacts = np.array(frame.contacts)
        self.named = {path: np.array(ids, np.int64) for path, ids in known.driven.items()}
        self.springs = Springs.of(known.springs)
        for name in _NOTED:
            setattr(self, name, getattr(known, name))
        self.replays = Replays.of(known.replays)
        self.stability = Stability.of(known.stability)
        self._count(known.work)
        if self._feeding is not None:
            self._feeding.restore(frame)

    def _progress(self) -> Progress:
        """Return what a frame needs so that the run can be resumed from it."""
        feeding = self._feeding
        return Progress(
            **{name: getattr(self, name) for name in _NOTED},
            ledger={} if feeding is None else {n: x.kept() for n, x in feeding.ledger.items()},
            rates={} if feeding is None else {n: x.kept() for n, x in feeding.reports.items()},
            work=asdict(self._mechanics.work),
            pace=None if self.pace is None else self.pace._asdict(),
            grids={} if feeding is None else feeding.grids.kept(),
            driven={path: ids.tolist() for path, ids in self.named.items()},
            springs=self.springs.kept(),
            replays={} if self.replays is None else self.replays._asdict(),
            stability=self.stability._asdict() if self._limit > 0.0 else {},
        )

    def _count(self, work: Mapping[str, int]) -> None:
        """Set what the integration has cost so far."""
        for name, count in work.items():
            setattr(self._mechanics.work, name, count)

    @property
    def shared_from(self) -> int | None:
        """Number of cells from which on threads share loops; None on one thread."""
        system = self._mechanics
        return (system.shared_chunks - 1) * system.chunk + 1 if system.threads > 1 else None

    @property
    def nodes(self) -> int:
        """Number of nodes of the largest field in a box; zero without any."""
        return 0 if self._feeding is None else self._feeding.nodes

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
        if self.pace is None:
            time += (self.step_index - step) * longest_step(self.scene)
        return min(time, self.scene.duration)

    @property
    def _next_time(self) -> float:
        """The end of the next coupling step, s."""
        if self.pace is not None:
            return end_of_step(self.scene, self.pace, self.time)
        return min(self.time + longest_step(self.scene), self.scene.duration)

    @property
    def steps(self) -> int:
        """Number of coupling steps to the scene's end, chosen ones all as long as the next."""
        step, time = self._origin
        length = longest_step(self.scene) if self.pace is None else self.pace.step
        ahead = (self.scene.duration - time) / length
        return max(1, step + math.ceil(ahead * (1.0 - 1e-12)))

    @property
    def finished(self) -> bool:
        """Whether the duration or the number of cells is reached, or all are pulled apart."""
        enough = self.scene.stop_cells
        grown = enough is not None and len(self.cells) >= enough
        chosen = self.pace is not None
        over = self.time >= self.scene.duration if chosen else self.step_index >= self.steps
        return over or grown or self.separation is not None

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
            the state is that of the step's beginning.
        KeyboardInterrupt
            At the end of the step, after Ctrl-C; a second one ends it at once.
        """
        with STEP:
            kept = self._kept()
            try:
                with self._compiling:
                    self._advance()
            except NutrientFailed as failure:
                self._take_back(kept)
                raise StepFailed(self.time, failure.problem, failure.hint) from failure
            except BaseException:
                self._take_back(kept)
                raise

    def _advance(self) -> None:
        """Do one coupling step; an exception leaves parts of it behind."""
        scene, begin, end = self.scene, self.time, self._next_time
        with self.phase("biology"):
            factor = self._growth_factor()
            grown = grow(scene, self.cells, self.concentrations, factor, end - begin)
            before = None if scene.growth is None else held(self.cells, factor)
            first, began = self.next_id, self.cells
        with self.phase("mechanics"):
            position, pressure = self._move(begin, end, grown.radius)
        with self.phase("events"):
            self.cells, lost = aged(scene, self.cells, grown, self.concentrations, begin, end)
            self.cells.position, self.cells.pressure = position, pressure
            self.released += lost
            self.step_index += 1
            if self.pace is not None:
                self._origin = (self.step_index, end)
            self._divide_and_remove()
            if len(self.springs):
                self.springs = spring_graph.unbroken(scene, self.springs, self.cells)
            self._sort()
        with self.phase("nutrient"):
            if self._feeding is not None:
                earlier = None if before is None else began
                self._feeding.advance(self.cells, begin, end, before=earlier)
        with self.phase("biology"):
            self._decide(end - begin)
            if before is not None:
                self._estimate(before, first, begin, end)

    def _estimate(self, before: Held, first: int, begin: float, end: float) -> None:
        """Estimate the error of the step that has ended, and choose the length of the next."""
        scene, cells = self.scene, self.cells
        dt, jumped = end - begin, jumps(scene, end)
        now = held(cells, self._growth_factor())
        self.step_error = error = step_error(scene, before, now, cells, first, dt, jumped=jumped)
        self.splitting = (self.splitting or 0.0) + error.volume / max(len(cells), 1)
        if self.pace is not None:
            uptake = 0.0 if self._feeding is None else self._feeding.uptake_error(scene, dt)
            pace = first_pace(scene) if jumped else self.pace
            self.pace = next_pace(scene, pace, error, uptake, dt)

    def _growth_factor(self) -> FloatArray:
        """Return how fast cells would grow where they are now, (n,)."""
        # that of a step's end is that of the next one's beginning
        surroundings = (self.cells.pressure, *self.concentrations.values())
        known, factor = self._known_factor
        if len(known) != len(surroundings) or any(map(operator.is_not, known, surroundings)):
            factor = growth_factor(self.scene, self.concentrations, self.cells.pressure)
            self._known_factor = surroundings, factor
        return factor

    def _kept(self) -> dict[str, Any]:
        """Return what :meth:`_take_back` needs to undo a step.

        A step makes new arrays and does not write into those that are there: to keep them is
        to remember them. Logs and accounts only grow.
        """
        return {
            "lineage": self.lineage.counts(),
            "work": vars(self._mechanics.work).copy(),
            "feeding": None if self._feeding is None else self._feeding.kept(),
            "rest": {name: getattr(self, name) for name in _STATE},
        }

    def _take_back(self, kept: Mapping[str, Any]) -> None:
        """Make the state that was kept the state again."""
        with UNCUT:
            self.lineage.cut(kept["lineage"])
            self._count(kept["work"])
            if self._feeding is not None:
                self._feeding.take_back(kept["feeding"])
            for name, value in kept["rest"].items():
                setattr(self, name, value)

    def frame(self, *, shared: bool = False) -> Frame:
        """Return the state as a frame that later steps do not change.

        One that is ``shared`` has the arrays of the state itself: a step makes new ones, but who
        writes into those of ``cells`` writes into the frame.
        """
        if shared:
            found = dict(self.concentrations)
            return replace(self._view(), concentrations=found, fields=self.fields)
        return replace(
            self._view(),
            cells=self.cells.copy(),
            concentrations={name: values.copy() for name, values in self.concentrations.items()},
            fields=self.fields,
        )

    def _view(self, *, whole: bool = True) -> Frame:
        """Return the state, without fields, as a frame that shares its arrays.

        Where it is not ``whole`` it lacks what only those need who go on from it.
        """
        return Frame(
            self.time, self.step_index, self.cells, self.concentrations,
            contacts=self.contacts, progress=self._progress() if whole else None,
        )  # fmt: skip

    def history_row(self) -> dict[str, float]:
        """Return the observables of the state (:func:`multicell.results.summary.history_row`)."""
        # columns for every method: a run may be resumed with another one
        ratio = self.stability.latest if self._limit > 0.0 else math.nan
        extra = {"shift_effect": self._shift_effect(), "stability_ratio": ratio}
        round_fields = any(part.layout != "box" for part in self.scene.nutrients.values())
        if round_fields and self.scene.dimensions == 3:
            from multicell.nutrient.cartesian import departure

            extra["departure_from_a_ball"] = departure(self.cells.position, self.cells.radius)
        if self.scene.growth is not None:
            fields = {} if self._feeding is None else self._feeding.content_errors
            extra |= columns(self.step_error, self.cells, fields)
        if self._feeding is not None:
            extra |= {f"medium_{name}": level for name, level in self._feeding.media.items()}
            extra |= self._feeding.grids.columns()
        if self.scene.motions:
            now = self._motion(self.time, self.time, self.cells.radius)
            extra |= driven.columns(self.scene, self.cells, self.named, self._mechanics, now)
        if self.scene.springs:
            extra |= spring_graph.columns(self.scene, self.springs, self.cells)
        if self.scene.output.instability:
            extra["instability_rate"] = self._instability_rate()
        return summary.history_row(self.scene, self._view(whole=False), **extra)

    def _shift_effect(self) -> float:
        """Return what the last replay found, µm; NaN before the first."""
        replays = self.replays
        return replays.latest if replays is not None and replays.done else math.nan

    def energy(self) -> float:
        """Return the contact energy of the cells, fJ."""
        self._mechanics.begin(self._motion(self.time, self.time, self.cells.radius))
        return self._mechanics.energy(self.time, self.cells.position)

    def _instability_rate(self) -> float:
        from multicell.mechanics.growth_rate import recorded_rate

        motion = self._motion(self.time, self.time + longest_step(self.scene), self.cells.radius)
        return recorded_rate(self._mechanics, motion, self.cells.position, self.scene.dimensions)

    def summary(self) -> dict[str, Any]:
        """Return the numbers that describe the run so far; ``units`` names the units.

        A number that does not exist (the viable rim without a core) is None.
        """
        fields: dict[str, dict[str, Any]] = {}
        remarks: list[str] = []
        if self._feeding is not None:
            from multicell.nutrient.fitness import fitness

            fields, remarks = fitness(self._feeding, self.cells, self.time)
        if self._limit > 0.0:
            remarks = [*remarks, *self.stability.notes(self.scene.integrator.method)]
        ledgers = {name: ledger.summary() for name, ledger in self.ledger.items()}
        threads = self._mechanics.threads
        return summary.run_summary(
            self.scene, self._view(), ledgers, fields, remarks, self.wall, threads
        )

    def phase(self, name: str) -> _Phase:
        """Return a context that adds the wall time of its block to one of :data:`PHASES`."""
        return _Phase(self.wall, name)

    def _motion(self, begin: float, end: float, radius: FloatArray) -> Motion:
        """Return what mechanics must know of the cells between two times."""
        return motion_of(
            self.scene, self.cells, radius, begin, end, concentrations=self.concentrations,
            gradients=self._gradients(), contacts=self.contacts, named=self.named,
            springs=self.springs,
        )  # fmt: skip

    def _gradients(self) -> dict[str, FloatArray]:
        """Return the gradients that cells follow, where they are."""
        names = followed(self.scene)
        if self._feeding is None or not names:
            return {}
        if not self._feeding.concentrations:
            # contacts are looked for before there is a field, and need no forces
            return {name: np.zeros((len(self.cells), 3)) for name in names}
        return self._feeding.gradients(self.cells.position, names)

    def prepared(self) -> Mechanics:
        """Return the mechanics made ready for the next coupling step, which is not taken."""
        begin, end = self.time, self._next_time
        factor = self._growth_factor()
        radius = grow(self.scene, self.cells, self.concentrations, factor, end - begin).radius
        self._mechanics.begin(self._motion(begin, end, radius))
        return self._mechanics

    def _move(self, begin: float, end: float, radius: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Integrate the positions; return them and the pressures at the end."""
        cells = self.cells
        self._mechanics.begin(self._motion(begin, end, radius))
        if len(cells) == 0 or self._alone(self._mechanics.motion):
            return cells.position.copy(), np.zeros(len(cells))
        self._check_begin(cells.position)
        before = self._mechanics.work.effort
        outcome = self._integrator.integrate(self._mechanics, cells.position)
        if not outcome.done:
            cell = None if outcome.cell is None else int(cells.id[outcome.cell])
            raise StepFailed(outcome.time, outcome.problem, outcome.hint, cell)
        position = self._mechanics.at_end(outcome.position)
        check_inside(self.scene, cells.id, position, end)
        pressure = self._mechanics.pressure(end, outcome.position)
        self._note_contacts(end, outcome.position)
        cost = (self._mechanics.work.effort - before) * len(cells)
        self._check_end(outcome.position, float(cost))
        self._replay(outcome.position, float(cost))
        return position, pressure

    def _check_begin(self, position: FloatArray) -> None:
        """Measure, if that is due, how far a fixed step is from its limit before a step."""
        if not self._limit > 0.0:
            return
        system, known, n = self._mechanics, self.stability, len(position)
        product = self._limit / self._fixed_step()
        if stability.is_due(known, n, product):
            begin, dimensions = system.motion.begin, self.scene.dimensions
            rate = stability.rate_at(system, begin, position, dimensions)
            self.stability = stability.add_measurement(known, rate, product, n)

    def _check_end(self, position: FloatArray, cost: float) -> None:
        """Refuse a fixed step that is beyond its limit after a coupling step as it was before.

        ``cost`` is that of the step.
        """
        if not self._limit > 0.0:
            return
        system, n, end = self._mechanics, len(position), self._mechanics.motion.end
        self.stability = known = self.stability._replace(total=self.stability.total + cost)
        step = self._fixed_step()
        product = self._limit / step
        was_beyond, suspect = known.rate > product, False
        if not was_beyond and stability.may_glance(known, n):
            known = stability.add_glance(known, n)
            suspect = stability.suspect(system, end, position, product)
        if was_beyond or suspect:
            rate = stability.rate_at(system, end, position, self.scene.dimensions)
            known = stability.add_measurement(known, rate, product, n)
            if was_beyond and rate > product:
                words = stability.refusal_words(self._integrator, step, self._limit, rate)
                raise StepFailed(system.motion.begin, *words)
        self.stability = known

    def _fixed_step(self) -> float:
        """Return how long the equal steps of the coupling step are, s."""
        motion = self._mechanics.motion
        return stability.actual_step(self._integrator, motion.end - motion.begin)

    def _replay(self, end: FloatArray, cost: float) -> None:
        """Take the step again from shifted positions where that is due, and note the effect."""
        replays, cells = self.replays, self.cells
        if replays is None:
            return
        effect, spent = None, 0.0
        if replays.due:
            shifted = shifted_positions(
                cells.position, SHIFT, self.scene.seed, self.step_index, cells.id,
                self.scene.dimensions,
            )  # fmt: skip
            start = cells.position
            effect, spent = replay_step(self._integrator, self._mechanics, start, end, shifted)
        self.replays = replays.after(cost, spent, effect)

    def _alone(self, motion: Motion) -> bool:
        """Return whether there is one cell that nothing acts on: it stays where it is."""
        acting = (motion.push, motion.held, self._mechanics.walls)
        return len(self.cells) == 1 and all(part is None for part in acting)

    def _find_first_contacts(self) -> None:
        """Find the pairs that overlap at the start, before any of them has touched."""
        if len(self.cells):
            self._mechanics.begin(self._motion(self.time, self.time, self.cells.radius))
            self._note_contacts(self.time, self.cells.position)

    def _note_contacts(self, time: float, position: FloatArray) -> None:
        """Remember contacts by identity, and the pull at which the last one broke."""
        if not summary.counts_contacts(self.scene):
            return
        before, found = len(self.contacts), self._mechanics.contacts(time, position)
        self.contacts = self.cells.id[found]
        if self.scene.pull is not None and before and not len(found):
            self.separation = {"time": time, "force": self.scene.pull.load(time)}

    def _divide_and_remove(self) -> None:
        """Change the number of cells, and all that is noted of single ones."""
        before, first = self.cells, self.next_id
        after = divide_and_remove(self.scene, before, self.step_index, first, self.time)
        born = after.next_id - first
        self.cells, self.next_id = after.cells, after.next_id
        self.divisions += born // 2
        self.removals += after.removals
        self.released += after.released
        self.unsorted += born + after.removals
        if born or after.removals:
            self.lineage.events(before, self.cells, self.time)
            self.named = driven.handed_on(self.named, self.cells, first)
            if len(self.springs):
                self.springs = spring_graph.after_divisions(
                    self.scene, self.springs, before, self.cells
                )
            if len(self.contacts):
                self.contacts = self.cells.id[contact_rows(self.cells, self.contacts)]

    def _sort(self) -> None:
        """Sort the cells in space when many are new: neighbours then share memory."""
        if self.unsorted > _STALE_ORDER * len(self.cells):
            width = 2.0 * float(self.cells.radius.max(initial=1.0))
            self.cells = self.cells.take(binning.spatial_order(self.cells.position, width))
            self.unsorted = 0

    def _decide(self, dt: float) -> None:
        """Let cells turn to another state by what they find, and note those that die."""
        scene, cells = self.scene, self.cells
        dead = decide(scene, cells, self.concentrations, self.step_index, dt, self.time)
        if dead.any():
            self.lineage.died(np.sort(cells.id[dead]), self.time)
            self.springs = spring_graph.without_dead(self.springs, cells)


def _feeding(
    scene: Scene, reactions: Mapping[str, OwnReaction] | None, threads: int
) -> Feeding | None:
    """Return the scene's fields; a scene without nutrients does not load them."""
    if not scene.nutrients:
        if reactions:
            raise SceneError("reactions", "are given, but the scene has no fields that could react")
        return None
    from multicell.nutrient.fields import Feeding

    return Feeding(scene, reactions, threads)
