"""The state that a run starts with, from its first cells or from a frame."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from multicell.biology import driven
from multicell.biology.start_states import StartStates
from multicell.biology.states import irradiate
from multicell.biology.step import bind, decide
from multicell.errors import NutrientFailed, SceneError, StepFailed
from multicell.integrators.shift import Replays
from multicell.integrators.stability import Stability
from multicell.scene.domain import check_start
from multicell.scene.steps import step_plan
from multicell.simulation.coupling_step import sorted_in_space
from multicell.simulation.run_state import RunState
from multicell.simulation.step_lengths import first_lengths
from multicell.simulation.timeline import Laps, Timeline

if TYPE_CHECKING:
    from multicell.cells import Cells, FloatArray, Signals
    from multicell.results.frame import Frame
    from multicell.results.lineage import Lineage
    from multicell.simulation.machinery import Machinery

_MOST_TURNS, _SETTLED = 100, 1e-8
"""In which networks and fields that they change settle, and the change that ends them."""


def begun(run: Machinery, cells: Cells, lineage: Lineage, *, given_states: bool) -> RunState:
    """Return the state of a run that starts with cells; states that are not given are found.

    Raises SceneError where a cell lies outside the domain, StepFailed where no field is found.
    """
    check_start(run.scene, cells)
    steps, fields = step_plan(run.scene), run.scene.nutrients
    lengths = first_lengths(steps)
    timeline = Timeline(steps).choosing(lengths)
    time, first = timeline.time, cells.take(np.argsort(cells.id))
    first.parent = np.full(len(first), -1)  # nothing is known of mothers before the start
    networks = run.plan.networks
    if networks is not None:
        cells = cells.shared()
        networks.begin(cells)
    bound, period = bind(run.plan, cells, cells, {}, time), run.mover.system.period
    cells, unsorted = sorted_in_space(bound, len(cells), period)
    state = RunState(
        cells=cells,
        timeline=timeline,
        fields=run.field_system.state,
        contacts=np.empty((0, 2), dtype=np.int64),
        lineage=lineage.born(first, time),
        next_id=int(cells.id.max(initial=-1)) + 1,
        unsorted=unsorted,
        divisions=0,
        removals=0,
        released=0.0,
        separation=None,
        first_states={},
        exposures={},
        named=driven.named_at_start(run.plan, first),
        replays=Replays(),
        stability=Stability() if run.mover.limit > 0.0 else None,
        work={},
        lengths=lengths,
        learnt=(),
        cavity=None,
        inside=() if networks is None else networks.columns,
    )
    lap = Laps(run.wall)
    motion = run.motion(state, run.signals_of(state), time, time, cells.radius)
    touching = run.mover.contacts(cells, motion)
    if touching is not None:
        state = replace(state, contacts=cells.id[touching])
    lap("mechanics")
    try:
        run.field_system.begin(cells, time)
        state = _with_networks(run, state)
        if fields and not given_states:
            state = _with_networks(run, _with_states(run, state))
    except NutrientFailed as failure:
        raise StepFailed(time, failure.problem, failure.hint) from failure
    if fields:
        cells = bind(run.plan, state.cells, state.cells, run.signals_of(state), time)
        state = replace(state, cells=cells)
    lap("nutrient")
    cells, lineage = state.cells, state.lineage
    if given_states or not fields:
        decided = decide(run.plan, cells, run.signals_of(state), ahead=timeline.ahead, time=time)
        cells, lineage = decided.cells, lineage.died(decided.cells, decided.died, time)
    if run.plan.radiation:
        found = run.field_system.concentrations
        cells, dead = irradiate(run.plan, cells, found, -math.inf, time)
        lineage = lineage.died(cells, dead, time)
    lap("biology")
    fields_now, cavity = run.field_system.state, run.mover.cavity
    return replace(
        state, cells=cells, lineage=lineage, fields=fields_now, work=run.work(), cavity=cavity
    )


def _with_networks(run: Machinery, state: RunState) -> RunState:
    """Return a state whose cells have networks that are set by their signals at the start.

    Raises NutrientFailed where networks and the fields that they change do not settle.
    """
    networks, fields = run.plan.networks, run.field_system
    if networks is None:
        return state
    cells, time = state.cells.shared(), state.timeline.time

    def find(some: Cells) -> Signals:
        return run.signals(some, state.contacts, time)

    networks.begin(cells, find, time)
    for _ in range(_MOST_TURNS if networks.change_fields else 0):
        before = dict(fields.concentrations)
        fields.begin(cells, time, again=True)
        networks.begin(cells, find, time)
        networks.note_shares(cells, fields.shares(cells))
        if all(
            np.abs(fields.concentrations[name] - known).max(initial=0.0)
            <= _SETTLED * run.scene.nutrients[name].highest
            for name, known in before.items()
        ):
            break
    else:
        if networks.change_fields:
            problem = "networks and the fields that they change do not settle at the start"
            raise NutrientFailed(problem, "Let the fields begin with the medium (initial).")
    return replace(state, cells=cells)


def _with_states(run: Machinery, state: RunState) -> RunState:
    """Return a state whose cells have states that fit the fields which they make."""
    time = state.timeline.time

    def field(cells: Cells) -> dict[str, FloatArray]:
        run.field_system.begin(cells, time, again=True)
        return dict(run.signals(cells, state.contacts, time))

    tabled = run.scene.initial.cells is not None
    search = StartStates(run.plan, state.cells, field, tabled=tabled)
    cells, unfit = search.find(run.signals_of(state))
    resting, dead = int((search.rests & ~search.dead).sum()), int(search.dead.sum())
    noted = {"quiescent": resting, "necrotic": dead, "unfit": unfit}
    noted = noted if any(noted.values()) else {}
    lineage = state.lineage.died(cells, search.dead, time)
    return replace(state, cells=cells, first_states=noted, lineage=lineage)


def resumed(run: Machinery, frame: Frame, lineage: Lineage) -> RunState:
    """Return the state of a run of the scene at a frame.

    Raises ValueError for a frame that holds no progress, SceneError for one beyond the scene's end,
    with cells outside its domain, or of a run with other reactions.
    """
    if frame.progress is None:
        raise ValueError("this frame does not hold what a run needs to go on")
    if frame.time > run.scene.duration:
        raise SceneError(
            "duration",
            f"is {run.scene.duration:g} s, which ends before the frame at {frame.time:g} s",
            "Name a later end, or resume from an earlier frame.",
        )
    check_start(run.scene, frame.cells)
    run.field_system.restore(frame)
    timeline = Timeline.at_frame(step_plan(run.scene), frame)
    state = RunState.of_frame(
        frame, timeline=timeline, fields=run.field_system.state, lineage=lineage
    )
    return state if run.mover.limit > 0.0 else replace(state, stability=None)
