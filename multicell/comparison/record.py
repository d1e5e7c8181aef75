"""Record a scene once: all its coupling steps with their events, or a sample of them.

Each coupling step is recorded with its motion (radii and their rates, moduli) and with what the
events did to the cells. In a growing or driven population the trajectories of any two methods
diverge: a contact that forms a moment later sends cells into another pocket, and the error at the
end of the run no longer measures a method. For such runs a *sample* of the steps is recorded, each
with the state at its beginning, from which every method starts; no error is carried from one step
to the next. The sample is taken from the middles of equal parts of the run, because the first
steps, in which an artificial beginning collapses, are not typical.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable
from dataclasses import replace
from typing import Final, NamedTuple, final

import numpy as np

from multicell.cells import Cells, FloatArray
from multicell.comparison.replay import RecordedEvents, ReplayProblem, Step, Trajectory
from multicell.errors import SceneError
from multicell.integrators.base import Integrator, Outcome
from multicell.mechanics.motion import Motion
from multicell.mechanics.system import Mechanics
from multicell.scene.scene import Scene
from multicell.simulation import Simulation

SAMPLES: Final = 24  # number of coupling steps that are compared unless another one is asked for

_SPARE = 16  # times as many states are stored during the run as the sample has


def sample_size(stepwise: bool | int | None) -> int | None:
    """Return the number of steps that is asked for; None if the whole run is compared.

    Raises SceneError if it is no whole number above zero.
    """
    if stepwise is None or stepwise is False:
        return None
    if stepwise is True:
        return SAMPLES
    if not isinstance(stepwise, int | np.integer) or stepwise < 1:
        raise SceneError("stepwise", f"is {stepwise!r}, must be a whole number of 1 or more")
    return int(stepwise)


class RecordedStep(NamedTuple):
    """A coupling step of the run; its start is stored in a sample only."""

    motion: Motion
    end: FloatArray
    start: FloatArray | None


@final
class StepRecorder:
    """Record the steps of another integrator: all of them, or an even sample.

    The number of steps is not known before the end. For a sample every step is stored at first;
    whenever there are too many, every second one is dropped.

    - ``inner``: the method that moves the cells
    - ``samples``: number of steps that :meth:`select` returns; None to keep all
    """

    def __init__(self, inner: Integrator, samples: int | None = None) -> None:
        self.inner = inner
        self.samples = samples
        self.system: Mechanics | None = None
        self.stride, self.total = 1, 0
        self.steps: dict[int, RecordedStep] = {}
        self.end: FloatArray = np.empty((0, 3))

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate by the inner method."""
        self.system = system
        start = None if self.samples is None else np.array(position)
        outcome = self.inner.integrate(system, position)
        self.end = system.at_end(outcome.position)
        if self.total % self.stride == 0:
            self.steps[self.total] = RecordedStep(system.motion, self.end, start)
        self.total += 1
        most = math.inf if self.samples is None else _SPARE * self.samples
        while len(self.steps) > most:
            self.stride *= 2
            self.steps = {k: state for k, state in self.steps.items() if k % self.stride == 0}
        return outcome

    def select(self) -> list[RecordedStep]:
        """Return all steps, or the sample: from the middles of equal parts of the run."""
        if self.samples is None:
            return list(self.steps.values())
        parts = min(self.samples, self.total)
        known = np.array(sorted(self.steps))
        middles = (np.arange(parts) + 0.5) * self.total / parts - 0.5
        nearest = {int(known[np.abs(known - middle).argmin()]) for middle in middles}
        return [self.steps[k] for k in sorted(nearest)]


def record(
    scene: Scene,
    integrator: Integrator,
    samples: int | None = None,
    *,
    cells: Cells | None = None,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> tuple[ReplayProblem, Trajectory]:
    """Simulate a scene and return what happened: the problem, and where the method led.

    Coupling steps in which nothing can move (no cell, or one on which nothing acts) are left out:
    the problem begins with the first step that a method has to solve.

    - ``integrator``: the method that moves the cells; of a sample it decides which states occur,
      and has no part in any error
    - ``samples``: None for the whole run; or the number of steps of a step-wise problem, one from
      the middle of each of so many equal parts of the run (all steps if there are fewer)

    Raises StepFailed if a step cannot be solved; SceneError if there is nothing to move in any
    step.
    """
    begin, begin_cpu = clock.perf_counter(), clock.process_time()
    recorder = StepRecorder(integrator, samples)
    simulation = Simulation(scene, threads=threads, cells=cells, integrator=recorder)
    # the recorder notes every step that it sees
    simulation.state = replace(simulation.state, replays=None)
    first: Cells | None = None
    events: list[RecordedEvents | None] = []
    happened: RecordedEvents | None = None
    while not simulation.finished and len(simulation.state.cells):
        before, seen = simulation.state.cells, recorder.total
        simulation.step()
        moved = recorder.total > seen
        if moved and first is None:
            first, happened = before, None
        if samples is None:
            if moved:
                events.append(happened)
                happened = None
            end = recorder.end if moved else before.position
            happened = compose_events(happened, events_between(before, end, simulation.state.cells))
        if progress is not None:
            progress(simulation.time / scene.duration)
    if recorder.system is None or first is None:
        raise SceneError(
            "initial",
            "leaves nothing to compare: at no time are there two cells, or one that a force from "
            "outside, a motion or a wall acts on",
            "Start from two cells, or let the only one divide: a longer duration, [growth]",
        )
    recorded = recorder.select()
    starts = None if samples is None else [s.start for s in recorded if s.start is not None]
    steps = [
        Step(state.motion, events[k] if samples is None else None)
        for k, state in enumerate(recorded)
    ]
    problem = ReplayProblem(
        scene, recorder.system, first.position, first.radius, steps, starts, recorder.total
    )
    wall, cpu = clock.perf_counter() - begin, clock.process_time() - begin_cpu
    ends = [state.end for state in recorded]
    return problem, Trajectory(ends, replace(recorder.system.work), wall, cpu)


def compose_events(
    first: RecordedEvents | None, second: RecordedEvents | None
) -> RecordedEvents | None:
    """Return two events of the cells as one, None for nothing."""
    if first is None or second is None:
        return second if first is None else first
    offset = first.offset[second.source] + second.offset
    return RecordedEvents(first.source[second.source], offset)


def events_between(before: Cells, position: FloatArray, after: Cells) -> RecordedEvents | None:
    """Return how the cells ``after`` follow from those ``before``, which ended at ``position``.

    None if no cell divided, died or changed its place in the order.
    """
    if np.array_equal(before.id, after.id):
        return None
    order = np.argsort(before.id)
    known = before.id[order]
    survives = np.isin(after.id, known)
    origin = np.where(survives, after.id, after.parent)
    source = order[np.searchsorted(known, origin)]
    offset = after.position - position[source]
    offset[survives] = 0.0
    return RecordedEvents(source, offset)
