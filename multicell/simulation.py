"""A simulation: a scene plus state, which advances in coupling steps.

In each step the data goes one way: growth rates from what the cells find around them, motion
while the radii grow, then all events (division, removal), then the nutrient field of the new
configuration, and from it the cells' new states. So a frame taken between two steps is
consistent: its concentrations are those of its own cells.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any, cast, final

import numpy as np

from multicell.biology import driven
from multicell.biology.division import change_types, changing, mutate_as_found
from multicell.biology.exposure import Exposure, remainders
from multicell.biology.growth import growth_factor, lag_after
from multicell.biology.initial import initial_cells
from multicell.biology.motion import motion_of
from multicell.biology.plan import biology_plan
from multicell.biology.start_states import StartStates
from multicell.biology.states import irradiate
from multicell.biology.step import (
    age_cells,
    bind,
    bind_changed,
    decide,
    divide_and_remove,
    grow,
)
from multicell.cells import Cells, FloatArray
from multicell.compiling.threads import thread_count
from multicell.contact.custom import Compiling
from multicell.coupling.mover import Mover
from multicell.coupling.state import RunState, fields_of
from multicell.errors import NutrientFailed, StepFailed
from multicell.host.interrupts import STEP
from multicell.mechanics import neighbours
from multicell.results import summary
from multicell.results.frame import Frame
from multicell.results.lineage import Lineage
from multicell.results.observables import contact_rows
from multicell.scene import start
from multicell.scene.domain import check_start
from multicell.scene.ranges import check_memory

if TYPE_CHECKING:
    from multicell.cells import Found, IntArray, Mask
    from multicell.integrators.base import Integrator
    from multicell.mechanics.motion import Motion
    from multicell.mechanics.system import Mechanics
    from multicell.nutrient.reactions.own import OwnReaction
    from multicell.scene.scene import Scene


_GRAIN = 1e-3  # of a coupling step, to which the time of a separation is known
_MOST_TURNS, _SETTLED = 100, 1e-8
"""In which networks and fields that they change settle, and the change that ends them."""
_STALE_ORDER = 0.05  # part of the cells that may be new before all are sorted in space again


@final
class Simulation(RunState):
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
        self._compiling = Compiling(scene.contact)
        plan = biology_plan(scene)

        super().__init__(
            scene,
            plan=plan,
            mover=Mover(scene, thread_count(threads), integrator),
            fields=fields_of(scene, reactions, thread_count(threads), plan),
            lineage=lineage,
        )
        self._known_factor: tuple[tuple[Any, ...], FloatArray] = ((), np.empty(0))
        if frame is None:
            table = scene.initial.cells
            given = cells is not None or (table is not None and "state" in table.given.columns)
            first = start.separate(scene, initial_cells(scene) if cells is None else cells)
            self._start(first, given_states=given)
        else:
            self.resume(frame)

    def _start(self, cells: Cells, *, given_states: bool) -> None:
        """Begin with these cells; states that are not given are found with the fields."""
        check_start(self.scene, cells)
        self.named = driven.named_at_start(self.plan, cells)
        self.cells = cells
        if self.plan.networks is not None:
            self.plan.networks.begin(cells)
        bind(self.plan, cells, cells, {}, self.time)
        self.next_id = int(cells.id.max(initial=-1)) + 1
        first = cells.take(np.argsort(cells.id))
        first.parent = np.full(len(first), -1)  # nothing is known of mothers before the start
        self.lineage.born(first, self.time)
        self.unsorted = len(cells)
        self._sort()
        with self.phase("mechanics"), self._compiling:
            motion = self._motion(self.time, self.time, cells.radius)
            self._note_contacts(self.mover.contacts(self.cells, motion))
        with self.phase("nutrient"):
            try:
                self.field_system.begin(self.cells, self.time)
                self._begin_networks()
                if self.scene.nutrients and not given_states:
                    self._find_states()
            except NutrientFailed as failure:
                raise StepFailed(self.time, failure.problem, failure.hint) from failure
            self._begin_networks()
            if self.scene.nutrients:
                bind(self.plan, self.cells, self.cells, self.signals, self.time)
        if given_states or not self.scene.nutrients:
            with self.phase("biology"):
                dead, _ = self._decide()
                self.lineage.died(self.cells, dead, self.time)
        self._irradiate(-math.inf)

    def _begin_networks(self) -> None:
        """Set the networks inside cells by what these find at the start."""
        networks, fields = self.plan.networks, self.field_system
        if networks is None:
            return
        networks.begin(self.cells, self._signals_at, self.time)
        for _ in range(_MOST_TURNS if networks.exchanges else 0):
            before = dict(self.concentrations)
            fields.begin(self.cells, self.time, again=True)
            networks.begin(self.cells, self._signals_at, self.time)
            networks.note_shares(self.cells, fields.shares(self.cells))
            if all(
                np.abs(self.concentrations[name] - known).max(initial=0.0)
                <= _SETTLED * self.scene.nutrients[name].highest
                for name, known in before.items()
            ):
                return
        if networks.exchanges:
            problem = "networks and the fields that they change do not settle at the start"
            raise NutrientFailed(problem, "Let the fields begin with the medium (initial).")

    def _find_states(self) -> None:
        """Find states of the cells that fit the fields which they make."""

        def field(cells: Cells) -> dict[str, FloatArray]:
            self.field_system.begin(cells, self.time, again=True)
            return self._signals_at(cells)

        search = StartStates(
            self.plan, self.cells, field, tabled=self.scene.initial.cells is not None
        )
        self.cells, unfit = search.find(self.signals)
        resting, dead = int((search.rests & ~search.dead).sum()), int(search.dead.sum())
        if resting or dead or unfit:
            self.first_states = {"quiescent": resting, "necrotic": dead, "unfit": unfit}
        if dead:
            self.lineage.died(self.cells, search.dead, self.time)

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
            before = self.snapshot()
            try:
                with self._compiling:
                    self._advance()
            except NutrientFailed as failure:
                self.restore(before)
                raise StepFailed(self.time, failure.problem, failure.hint) from failure
            except BaseException:
                self.restore(before)
                raise

    def _advance(self) -> None:
        """Do one coupling step; an exception leaves parts of it behind."""
        plan, begin, end = self.plan, self.time, self.timeline.next_time
        with self.phase("biology"):
            factor = self._growth_factor()
            began, found = self.cells, self.signals
            grown = grow(plan, began, found, factor, end - begin)
            found = dict(found)  # the fields will write what they find in place of this
        with self.phase("mechanics"):
            position, pressure = self._move(begin, end, grown.radius)
        with self.phase("events"):
            self.cells, lost = age_cells(plan, self.cells, grown, self.signals, begin, end)
            self.cells.position, self.cells.pressure = position, pressure
            self.released += lost
            self.timeline = self.timeline.after_step()
            self._divide_and_remove(end - begin, grown.factor)
            self._sort()
        self._expose(began, found, begin, end)
        with self.phase("biology"):
            self._irradiate(begin)
            if plan.growth is not None and not self.timeline.plan.jumps_at(end):
                # a jump changes nothing of the step that it ends
                now = self._growth_factor()
                self.cells.lag = lag_after(plan, began, factor, self.cells, now, end - begin)

    def _growth_factor(self) -> FloatArray:
        """Return how fast cells would grow where they are now, (n,)."""
        # that of a step's end is that of the next one's beginning
        cells = self.cells
        surroundings = (cells.pressure, cells.kind, *self.concentrations.values())
        known, factor = self._known_factor
        if (
            self.plan.growth_follows_state
            or len(known) != len(surroundings)
            or any(map(operator.is_not, known, surroundings))
        ):
            factor = growth_factor(self.plan, self.signals, cells.pressure, cells)
            self._known_factor = surroundings, factor
        return factor

    def history_row(self) -> dict[str, float]:
        """Return the observables of the state (:func:`multicell.results.summary.history_row`)."""
        # columns for every method: a run may be resumed with another one
        ratio = self.stability.latest if self.mover.limit > 0.0 else math.nan
        shift = self.replays.latest if self.replays is not None and self.replays.done else math.nan
        extra = {"shift_effect": shift, "stability_ratio": ratio}
        extra |= self.field_system.columns(self.cells)
        if self.plan.acting:
            extra["splitting_events_error"] = abs(self.exposures.get("error", 0.0))
        if self.plan.networks is not None and self.plan.networks.exchanges:
            extra["splitting_networks_error"] = self.exposures.get("networks", 0.0)
        if self.scene.motions:
            now = self._motion(self.time, self.time, self.cells.radius)
            extra |= driven.columns(self.plan, self.cells, self.named, self.mechanics, now)
        return summary.history_row(self.scene, self._view(whole=False), **extra)

    def energy(self) -> float:
        """Return the contact energy of the cells, fJ."""
        self.mechanics.begin(self._motion(self.time, self.time, self.cells.radius))
        return self.mechanics.energy(self.time, self.cells.position)

    def summary(self) -> dict[str, Any]:
        """Return the numbers that describe the run so far; ``units`` names the units.

        A number that does not exist (the viable rim without a core) is None.
        """
        fields, remarks = self.field_system.fitness(self.cells, self.time)
        if self.mover.limit > 0.0:
            remarks = [*remarks, *self.stability.notes(self.scene.integrator.method)]
        ledgers = {name: ledger.summary() for name, ledger in self.ledger.items()}
        threads = self.mechanics.threads
        return summary.run_summary(
            self.scene, self._view(), ledgers, fields, remarks, self.wall, threads
        )

    def _motion(self, begin: float, end: float, radius: FloatArray) -> Motion:
        return motion_of(
            self.plan, self.cells, radius, begin, end, concentrations=self.signals,
            gradients=self.field_system.gradients(self.cells), contacts=self.contacts,
            named=self.named,
        )  # fmt: skip

    def prepared(self) -> Mechanics:
        """Return the mechanics made ready for the next coupling step, which is not taken."""
        begin, end = self.time, self.timeline.next_time
        factor = self._growth_factor()
        radius = grow(self.plan, self.cells, self.signals, factor, end - begin).radius
        self.mechanics.begin(self._motion(begin, end, radius))
        return self.mechanics

    def _move(self, begin: float, end: float, radius: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Integrate the positions; return them and the pressures at the end."""
        motion = self._motion(begin, end, radius)
        moved = self.mover.move(self.cells, motion, self.step_index, self.replays, self.stability)
        self.replays, self.stability = moved.replays, moved.stability
        pull, none_left = self.scene.pull, moved.contacts is not None and not len(moved.contacts)
        if pull is not None and len(self.contacts) and none_left:
            time = self._parting(begin, end, radius)
            self.separation = {"time": time, "force": pull.load(time)}
        self._note_contacts(moved.contacts)
        return moved.position, moved.pressure

    def _parting(self, begin: float, end: float, radius: FloatArray) -> float:
        """Return when in a step the last contact breaks, s: halving it until the time is known."""
        cells, low, high = self.cells, begin, end
        while high - low > _GRAIN * (end - begin):
            middle = 0.5 * (low + high)
            grown = cells.radius + (middle - begin) / (end - begin) * (radius - cells.radius)
            motion = self._motion(begin, middle, grown)
            moved = self.mover.move(cells, motion, self.step_index, None, self.stability)
            joined = moved.contacts is not None and len(moved.contacts) > 0
            low, high = (middle, high) if joined else (low, middle)
        return high

    def _note_contacts(self, found: IntArray | None) -> None:
        """Remember contacts by identity."""
        if found is not None:
            self.contacts = self.cells.id[found]

    def _divide_and_remove(self, dt: float, factor: FloatArray) -> None:
        """Change the number of cells after a step of ``dt`` s, and all that is noted of them.

        They have grown in it at ``factor``, (n,), of unlimited growth.
        """
        before, first, found = self.cells, self.next_id, self.signals
        after = divide_and_remove(self.plan, before, first, self.time, dt, found, factor)
        born = after.next_id - first
        self.cells, self.next_id = after.cells, after.next_id
        self.divisions += born // 2
        self.removals += after.removals
        self.released += after.released
        self.unsorted += born + after.removals
        if born or after.removals:
            self.lineage.events(before, self.cells, self.time)
            self.named = driven.pass_on(self.named, self.cells, first)
            if len(self.contacts):
                self.contacts = self.cells.id[contact_rows(self.cells, self.contacts)]

    def _sort(self) -> None:
        """Sort the cells in space when many are new: neighbours then share memory."""
        if self.unsorted > _STALE_ORDER * len(self.cells):
            width = 2.0 * float(self.cells.radius.max(initial=1.0))
            self.cells = self.cells.take(neighbours.spatial_order(self.cells.position, width))
            self.unsorted = 0

    def _expose(self, began: Cells, before: Found, begin: float, end: float) -> None:
        """Bring the fields through a step, and let cells do what follows from what they find.

        Where rates have killed cells, transient fields are brought through it once more, now with
        these cells until they died.
        """
        plan, fields, cells = self.plan, self.field_system, self.cells
        again = fields.marches and self._follows(begin)
        known, until = fields.snapshot() if again else {}, cast(Any, 1.0)
        exposure, dead, lost = self._attempt(began, before, begin, end)
        if again and np.count_nonzero(dead):
            until = np.where(dead, 1.0 - self.cells.age / (end - begin), 1.0)
            fields.undo(known)
            self.cells = cells
            exposure, dead, lost = self._attempt(began, before, begin, end, until)
        with self.phase("biology"):
            if np.count_nonzero(dead):
                self.released += lost
                self.lineage.died(self.cells, dead, end)
            if fields.marches and self.cells.radius is not cells.radius:  # some died, or rest early
                rests = (self.cells.state != cells.state) & (self.cells.age < end - begin) & ~dead
                late = np.where((dead & (until == 1.0)) | rests, self.cells.age, 0.0)
                fields.give_back(cells, self.cells, late)
            if plan.acting:
                jumped = self.timeline.plan.changes_at(begin)
                found = remainders(plan, exposure, self.exposures, jumped=jumped)
                self.exposures = {**self.exposures, **found}
            typed = self.cells
            self.cells, rows = mutate_as_found(plan, self.cells, exposure)
            self.lineage.retype(self.cells.id[rows], self.cells.kind[rows])
            if changing(plan.acting):
                exposure.cells = self.cells
                self.cells = change_types(plan, self.cells, exposure)
            bind_changed(plan, typed, self.cells, exposure.found, end)

    def _follows(self, begin: float) -> bool:
        """Return whether more than the ends of a step matters: rates, or fields that jumped."""
        return bool(self.plan.acting) or self.timeline.plan.changes_at(begin)

    def _attempt(
        self, began: Cells, before: Found, begin: float, end: float, until: Any = 1.0
    ) -> tuple[Exposure, Mask, float]:
        """Bring the fields through a step with cells until a part of it, (n,), and let some die.

        Returns what cells were exposed to, which have died, and the volume that these have lost.
        """
        plan, fields = self.plan, self.field_system
        held = fields.steady if self.timeline.plan.jumps_at(end) else ()
        networks, sources, ahead = plan.networks, self.cells, None
        if networks is not None and networks.exchanges:
            # the fields need what networks do at the end of the step
            with self.phase("biology"):
                sources = self.cells.shared()
                ahead = networks.shares_ahead(sources, end - begin)
                self._advance_networks(sources, began, None, begin, end, held)
        with self.phase("nutrient"):
            followed = plan.exposed if self._follows(begin) else ()
            fields.advance(
                sources, begin, end, before=began, follow=followed, until=until, ahead=ahead
            )
        with self.phase("biology"):
            self.cells = self.cells.shared()  # what they were is needed once more
            if networks is not None:
                self._advance_networks(self.cells, began, self._signals_at, begin, end, held)
                if networks.exchanges:
                    networks.note_shares(self.cells, fields.shares(self.cells), end - begin)
                    error = networks.correction(sources, self.cells)
                    self.exposures = {**self.exposures, "networks": error}
            exposure = Exposure(
                self.cells,
                self.signals,
                end - begin,
                began=began,
                before=before,
                inner=fields.courses,
                held=held,
            )
            dead, lost = self._decide(exposure)
        return exposure, dead, lost

    def _advance_networks(
        self, cells: Cells, began: Cells, find: Any, begin: float, end: float,
        held: Collection[str],
    ) -> None:  # fmt: skip
        """Bring the networks in cells through a step; see :class:`multicell.biology.inside`."""
        assert self.plan.networks is not None
        threads = self.mechanics.threads
        self.plan.networks.advance(cells, began, find, begin, end, held, threads)

    def _decide(self, exposure: Exposure | None = None) -> tuple[Mask, float]:
        """Let cells turn to another state; return which have died, and the volume lost, µm³.

        By what they were exposed to in the step that has ended, or find at the start of the run.
        """
        found = self.signals if exposure is None else exposure.found
        ahead = self.timeline.ahead
        return decide(self.plan, self.cells, found, exposure, ahead=ahead, time=self.time)

    def _irradiate(self, since: float) -> None:
        """Let cells be hit by what is due since a time in s, and note those that die."""
        if self.plan.radiation:
            cells, found = self.cells, self.concentrations
            self.cells, dead = irradiate(self.plan, cells, found, since, self.time)
            self.lineage.died(self.cells, dead, self.time)
