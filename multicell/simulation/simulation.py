"""A simulation: a scene and the state of its run, which advances in coupling steps."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, final

from multicell.biology import driven
from multicell.biology.initial import initial_cells
from multicell.biology.step import grow
from multicell.cells import Cells
from multicell.compiling.threads import thread_count
from multicell.contact.custom import Compiling
from multicell.errors import NutrientFailed, SceneError, StepFailed
from multicell.host.interrupts import UNCUT, WHOLE_STEP
from multicell.results import summary
from multicell.results.lineage import Lineage
from multicell.results.observable import TissueState
from multicell.scene.ranges import check_memory
from multicell.scene.scene import Scene
from multicell.scene.steps import Lengths
from multicell.simulation.assembly import apart_at_start
from multicell.simulation.coupling_step import next_state
from multicell.simulation.first_state import begun, resumed
from multicell.simulation.machinery import Machinery
from multicell.simulation.timeline import PhaseTimer
from multicell.units import shown

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan
    from multicell.cells import FloatArray, IntArray, Signals
    from multicell.integrators.base import Integrator
    from multicell.integrators.shift import Replays
    from multicell.integrators.stability import Stability
    from multicell.mechanics.motion import Motion
    from multicell.mechanics.system import Mechanics
    from multicell.nutrient.balance import Ledger
    from multicell.nutrient.fields import FieldSystem
    from multicell.nutrient.reactions.own import OwnReaction
    from multicell.results.frame import Field, Frame
    from multicell.simulation.mover import Mover
    from multicell.simulation.run_state import RunState
    from multicell.simulation.timeline import Timeline


@final
class Simulation:
    """A scene's tissue in time: cells, mechanics, fields and biology.

    Parameters
    ----------
    scene
        What there is.
    threads
        Number of threads for large populations, by default all that there are. The results
        have the same bits for any number.
    cells
        Cells to start from instead of the scene's initial ones: as they are, or as a table (path
        of a file, entries of ``initial.cells`` by name, a ``DataFrame``, columns by title) whose
        cells the scene takes as with ``initial.cells``.
    frame
        State to resume from, of a run of this scene; the result is that of an uninterrupted run.
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
        if not isinstance(scene, Scene):
            problem = f"the scene is {shown(scene)}, must be a Scene"
            raise SceneError("", problem, "multicell.load_scene makes one of a name or a path.")
        if cells is not None and not isinstance(cells, Cells):
            from multicell.scene.start_table import with_cells

            scene, cells = with_cells(scene, cells), None
        if cells is None and frame is None:
            check_memory(scene)
        self.scene = scene
        self._compiling = Compiling(scene.contact)
        self._run = run = Machinery(scene, thread_count(threads), integrator, reactions)
        self._draft: Cells | None = None  # what has been given out to be read or written
        lineage = Lineage() if lineage is None else lineage
        if frame is not None:
            self._state = resumed(run, frame, lineage)
            return
        table = scene.initial.cells
        given = cells is not None or (table is not None and "state" in table.given.columns)
        first = apart_at_start(scene, initial_cells(scene) if cells is None else cells)
        with self._compiling:
            self._state = begun(run, first, lineage, given_states=given)

    @property
    def state(self) -> RunState:
        """The state of the run, a value: to assign an earlier one is to return to it."""
        draft, state = self._draft, self._state
        if draft is not None and not draft.equals(state.cells):
            self._state = state = state.with_cells(draft, max(len(self.scene.types), 1))
            self._run.load(state)
        return state

    @state.setter
    def state(self, state: RunState) -> None:
        self._run.load(state)
        self._state, self._draft = state, None

    @property
    def cells(self) -> Cells:
        """The cells, of which any column can be written, in place or by a new array.

        What is written counts at once. A step makes new cells, and leaves these as they are.
        """
        if self._draft is None:
            self._draft = self._state.cells.copy()
        return self._draft

    @cells.setter
    def cells(self, cells: Cells) -> None:
        self._draft = cells

    def step(self) -> None:
        """Advance by one coupling step.

        Raises
        ------
        StepFailed
            If the run is at its end, or positions or a field cannot be solved for. After this and
            any other exception the state is that of the step's beginning.
        KeyboardInterrupt
            At the end of the step, after Ctrl-C; a second one ends it at once.
        """
        if self.time >= self.scene.duration:
            hint = "Resume the run with a longer duration to continue it."
            raise StepFailed(self.time, "the run has reached its duration", hint)
        with WHOLE_STEP:
            before, draft = self.state, self._draft
            try:
                with self._compiling:
                    self._advance()
            except BaseException as error:
                with UNCUT:
                    self.state, self._draft = before, draft
                if isinstance(error, NutrientFailed):
                    raise StepFailed(self.time, error.problem, error.hint) from error
                raise

    def _advance(self) -> None:
        self._state, self._draft = next_state(self._run, self._state), None

    def history_row(self) -> dict[str, float]:
        """Return the observables of the state (:func:`multicell.results.summary.history_row`)."""
        # columns for every method: a run may be resumed with another one
        state, run = self.state, self._run
        ratio = math.nan if state.stability is None else state.stability.latest
        replays = state.replays
        shift = replays.latest if replays is not None and replays.done else math.nan
        extra = {"shift_effect": shift, "stability_ratio": ratio}
        tissue = TissueState(state.view(), self.scene)
        extra |= run.field_system.columns(tissue.cells, tissue.extent)
        if run.plan.acting:
            extra["splitting_events_error"] = abs(state.exposures.get("error", 0.0))
        if run.plan.networks is not None and run.plan.networks.change_fields:
            extra["splitting_networks_error"] = state.exposures.get("networks", 0.0)
        if state.lengths:
            chosen = Lengths(*state.lengths)
            extra |= {"coupling_step": chosen.last, "splitting_first_order_error": chosen.error}
        if self.scene.motions:
            now = self._motion(self.time, self.time, state.cells.radius)
            extra |= driven.columns(run.plan, state.cells, state.named, self.mechanics, now)
        return summary.history_row(tissue, **extra)

    def energy(self) -> float:
        """Return the contact energy of the cells, fJ."""
        cells = self.state.cells
        self.mechanics.begin(self._motion(self.time, self.time, cells.radius))
        return self.mechanics.energy(self.time, cells.position)

    def summary(self) -> dict[str, Any]:
        """Return the numbers that describe the run so far; ``units`` names the units.

        A number that does not exist (the viable rim without a core) is None.
        """
        state = self.state
        fields, remarks = self.field_system.fitness(state.cells, self.time)
        if state.stability is not None:
            remarks = [*remarks, *state.stability.notes(self.scene.integrator.method)]
        ledgers = {name: ledger.summary() for name, ledger in self.ledger.items()}
        threads = self.mechanics.threads
        return summary.run_summary(
            self.scene, state.frame(shared=True), ledgers, fields, remarks, self.wall, threads
        )

    def frame(self, *, shared: bool = False) -> Frame:
        """Return the state as a frame that later steps do not change.

        One that is ``shared`` has the arrays of the state itself, which are not to be written to.
        """
        return self.state.frame(shared=shared)

    def prepared(self) -> Mechanics:
        """Return the mechanics made ready for the next coupling step, which is not taken.

        Raises SceneError where cells diffuse: their motion is no equation without random numbers.
        """
        law = self.scene.motility
        if law is not None and law.diffusion is not None:
            hint = "Leave it out here: with_changes({'motility.diffusion': None})."
            problem = "makes motion random; what is asked for is a step of an equation of motion"
            raise SceneError("motility.diffusion", problem, hint)
        state, run = self.state, self._run
        begin, end = self.time, self.timeline.next_time
        found = run.signals_of(state)
        radius = grow(run.plan, state.cells, found, run.growth(state, found), end - begin).radius
        self.mechanics.begin(self._motion(begin, end, radius))
        return self.mechanics

    def _motion(self, begin: float, end: float, radius: FloatArray) -> Motion:
        state = self.state
        return self._run.motion(state, self._run.signals_of(state), begin, end, radius)

    def phase(self, name: str) -> PhaseTimer:
        """Return a context that adds the wall time of its block to a phase of the loop."""
        return PhaseTimer(self.wall, name)

    @property
    def finished(self) -> bool:
        """Whether the duration or the number of cells is reached, or all are pulled apart."""
        state, enough = self.state, self.scene.stop_cells
        grown = enough is not None and len(state.cells) >= enough
        return state.timeline.is_over or grown or state.separation is not None

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return self._state.timeline.time

    @property
    def step_index(self) -> int:
        """Number of coupling steps done."""
        return self._state.timeline.step_index

    @property
    def steps(self) -> int:
        """Number of coupling steps to the scene's end."""
        return self._state.timeline.steps

    @property
    def timeline(self) -> Timeline:
        """Where the run is in time."""
        return self._state.timeline

    @property
    def divisions(self) -> int:
        """Number of divisions so far."""
        return self._state.divisions

    @property
    def removals(self) -> int:
        """Number of cells removed so far."""
        return self.state.removals

    @property
    def released(self) -> float:
        """Volume that dead cells have lost so far, their remains at removal included, µm³."""
        return self._state.released

    @property
    def contacts(self) -> IntArray:
        """Identities of the pairs in contact, where the run counts them, (m, 2)."""
        return self.state.contacts

    @property
    def lineage(self) -> Lineage:
        """Births, deaths and ends of all cells so far."""
        return self.state.lineage

    @property
    def separation(self) -> Mapping[str, float] | None:
        """When and how the last contact broke in a pull."""
        return self._state.separation

    @property
    def first_states(self) -> Mapping[str, int]:
        """Numbers of cells quiescent and dead at the start, and of those not fitting the field."""
        return self._state.first_states

    @property
    def named(self) -> Mapping[str, IntArray]:
        """Identities of the cells that are driven, table of the scene -> (k,)."""
        return self._state.named

    @property
    def exposures(self) -> Mapping[str, float]:
        """Excess of events due to the length of steps, and the data of that estimate."""
        return self._state.exposures

    @property
    def next_id(self) -> int:
        """First identity that is free."""
        return self._state.next_id

    @property
    def replays(self) -> Replays | None:
        """Effects of small shifts on the ends of steps that were taken twice."""
        return self._state.replays

    @property
    def stability(self) -> Stability | None:
        """Ratio of a fixed step to its stability limit; None where the method has no limit."""
        return self._state.stability

    @property
    def ledger(self) -> dict[str, Ledger]:
        """Totals of each nutrient: inflow, uptake, secretion, storage ..."""
        return self._state.fields.ledger

    @property
    def concentrations(self) -> dict[str, FloatArray]:
        """Concentration of each nutrient at the cells, name -> (n,) mM."""
        return self.state.fields.concentrations

    @property
    def fields(self) -> dict[str, Field]:
        """The nutrient fields as they were last solved."""
        return self._state.fields.fields()

    @property
    def signals(self) -> Signals:
        """Signals from outside the cells: fields, time, neighbours; name -> (n,).

        Fields are in mM; there are no more than responses need.
        """
        return self._run.signals_of(self.state)

    @property
    def plan(self) -> BiologyPlan:
        """The biology of the scene, resolved."""
        return self._run.plan

    @property
    def mover(self) -> Mover:
        """Mechanics and the integrator."""
        return self._run.mover

    @property
    def mechanics(self) -> Mechanics:
        """The forces between the cells, and the neighbour list."""
        return self._run.mover.system

    @property
    def field_system(self) -> FieldSystem:
        """The system that solves for the fields."""
        return self._run.field_system

    @property
    def nodes(self) -> int:
        """Number of nodes of the largest field in a box; zero without any."""
        return self._run.field_system.nodes

    @property
    def wall(self) -> dict[str, float]:
        """Wall time of each phase of the loop, s."""
        return self._run.wall
