"""Step-wise problems: the coupling steps that occur in a run, each from its own recorded state.

In a growing or driven population the trajectories of any two methods part after a while: a
contact that forms a moment later sends cells into another pocket, and an error at the end of the
run then tells nothing about a method. So a run is recorded once, by a method good enough to give
sane states. Every step of a sample then starts from the recorded state at its beginning, with the
recorded radii, bonds, pushes and contacts, and the error is that at the step's end. Every method
is judged on the problems that do occur, and no error is carried from one step to the next.

The sample is taken from the middles of equal parts of the run: the first steps, in which an
artificial beginning collapses, are typical of nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, final

import numpy as np

from multicell.cells import Cells, FloatArray
from multicell.comparison.replay import Problem, Step
from multicell.errors import SceneError, StepFailed
from multicell.integrators.base import Integrator, Outcome
from multicell.mechanics.system import Mechanics, Motion
from multicell.scene.scene import Scene
from multicell.simulation import Simulation

SAMPLES: Final = 24
"""Number of coupling steps that are compared unless another one is asked for."""

_SPARE = 16  # so many times more states are held during the run than are taken in the end


def sample_size(stepwise: bool | int | None) -> int | None:
    """Return the number of steps that is asked for; None if the whole run is compared.

    Raises
    ------
    SceneError
        If it is no whole number above zero.
    """
    if stepwise is None or stepwise is False:
        return None
    if stepwise is True:
        return SAMPLES
    if not isinstance(stepwise, int | np.integer) or stepwise < 1:
        raise SceneError("stepwise", f"is {stepwise!r}, must be a whole number of 1 or more")
    return int(stepwise)


@final
class _Sampler:
    """An integrator that notes the states from which another one starts, evenly over a run.

    How many steps there will be is not known before the end. So every step is kept at first;
    whenever too many are held every second one is dropped.
    """

    def __init__(self, inner: Integrator, count: int) -> None:
        self.inner = inner
        self.most = _SPARE * count
        self.system: Mechanics | None = None
        self.stride, self.total = 1, 0
        self.held: dict[int, tuple[FloatArray, Motion]] = {}

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate by the inner method."""
        self.system = system
        if self.total % self.stride == 0:
            self.held[self.total] = (np.array(position), system.motion)
        self.total += 1
        while len(self.held) > self.most:
            self.stride *= 2
            self.held = {k: state for k, state in self.held.items() if k % self.stride == 0}
        return self.inner.integrate(system, position)

    def chosen(self, count: int) -> list[tuple[FloatArray, Motion]]:
        """Return up to ``count`` of the states, from the middles of equal parts of the run."""
        parts = min(count, self.total)
        known = np.array(sorted(self.held))
        middles = (np.arange(parts) + 0.5) * self.total / parts - 0.5
        nearest = {int(known[np.abs(known - middle).argmin()]) for middle in middles}
        return [self.held[k] for k in sorted(nearest)]


def sample(
    scene: Scene,
    integrator: Integrator,
    count: int,
    *,
    cells: Cells | None = None,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Problem:
    """Simulate a scene and return a step-wise problem of up to ``count`` of its steps.

    Parameters
    ----------
    scene
        What to simulate; its own integrator is not used.
    integrator
        The method that moves the cells from step to step; it decides which states occur and
        has no part in any error.
    count
        Number of steps, one from the middle of each of so many equal parts of the run; all
        steps if there are fewer.
    cells, threads, progress
        See :func:`multicell.comparison.replay.record`.

    Raises
    ------
    StepFailed
        If a step cannot be solved, or if there is nothing that moves.
    """
    sampler = _Sampler(integrator, count)
    simulation = Simulation(scene, threads=threads, cells=cells, integrator=sampler)
    begin = simulation.cells
    while not simulation.finished and len(simulation.cells):
        simulation.step()
        if progress is not None:
            progress(simulation.time / scene.duration)
    if sampler.system is None:
        raise StepFailed(0.0, "the scene has no cells to move", "Start from at least one cell")
    starts, motions = zip(*sampler.chosen(count), strict=True)
    steps = [Step(motion) for motion in motions]
    return Problem(
        scene, sampler.system, begin.position, begin.radius, steps, starts, sampler.total
    )
