"""Replay of recorded coupling steps: the same cells, events and radii for every method.

A scene is simulated once (:mod:`multicell.comparison.record`). A method then *replays* the record:
it integrates over the same coupling steps and undergoes the same events at the same times, so
that nothing but the mechanics differs, and nutrient and biology are solved once.

A problem may also be *step-wise*: then every coupling step starts from a recorded state, and not
from where the method has led.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar, final

import numpy as np

from multicell.cells import FloatArray, IntArray
from multicell.compiling.numba_068 import install_recorder
from multicell.integrators.auto import ChosenWork
from multicell.integrators.base import Integrator
from multicell.mechanics.motion import Motion, Work
from multicell.mechanics.system import Mechanics
from multicell.scene.scene import Scene

T = TypeVar("T")


@final
@dataclass(frozen=True, eq=False)
class RecordedEvents:
    """Divisions and removals of cells between two coupling steps.

    - ``source``, (n,) int64: for each cell after the events the index of the cell before them that
      it was, or that was its mother
    - ``offset``, (n, 3) float64, µm: displacement from that cell: zero, or a daughter's place
      beside her mother's centre
    """

    source: IntArray
    offset: FloatArray

    def apply(self, position: FloatArray) -> FloatArray:
        """Return the positions after the events, (n, 3) µm."""
        return np.asarray(position[self.source] + self.offset)


@final
@dataclass(frozen=True, eq=False)
class Step:
    """One coupling step: its motion, and the events before it (None if there were none)."""

    motion: Motion
    before: RecordedEvents | None = None


@final
@dataclass(frozen=True, eq=False)
class ReplayProblem:
    """Coupling steps and events that every method goes through.

    - ``scene``, Scene: the scene that was recorded
    - ``template``, Mechanics: mechanics with the scene's law and drag; each replay works on a copy
    - ``start``, (n, 3) float64, µm: positions at the beginning
    - ``radius``, (n,) float64, µm: radii at the beginning
    - ``steps``, sequence of Step
    - ``starts``, sequence of (n, 3) float64, µm, or None: where each step starts from in a
      step-wise comparison; None where a step starts from the end of the one before
    - ``total``, int: number of coupling steps of the run that ``steps`` is a sample of, or of all
    """

    scene: Scene
    template: Mechanics
    start: FloatArray
    radius: FloatArray
    steps: Sequence[Step] = ()
    starts: Sequence[FloatArray] | None = None
    total: int = 0

    @property
    def times(self) -> FloatArray:
        """Common times, the ends of the coupling steps: (m,), s."""
        return np.array([step.motion.end for step in self.steps])

    @property
    def counts(self) -> IntArray:
        """Number of cells in each coupling step: (m,)."""
        return np.array([len(step.motion.radius) for step in self.steps])

    @property
    def mean_radius(self) -> float:
        """Mean radius of the cells at the beginning, µm: the unit of length of errors."""
        return float(self.radius.mean())

    @property
    def stepwise(self) -> bool:
        """Whether every step starts from a recorded state."""
        return self.starts is not None

    @property
    def mode(self) -> str:
        """The kind of comparison, in words: the whole run, or a number of its steps."""
        if self.stepwise:
            return f"step-wise, {len(self.steps)} of {self.total} coupling steps"
        return "whole run"

    def beginning(self, k: int, reached: FloatArray) -> FloatArray:
        """Return the positions from which step ``k`` starts, (n, 3) µm.

        - ``k``: index of the step
        - ``reached``: where the step before it ended; of no account in a step-wise problem
        """
        if self.starts is not None:
            return self.starts[k]
        events = self.steps[k].before
        return reached if events is None else events.apply(reached)

    def system(self) -> Mechanics:
        """Return mechanics of its own, with all counts at zero."""
        return replace(self.template, work=ChosenWork())


@final
@dataclass(frozen=True, eq=False)
class Trajectory:
    """Where a method led.

    - ``positions``, list of (n, 3) float64, µm: positions at the end of each coupling step, before
      the events there
    - ``work``, Work: cost in counts
    - ``wall``, float, s: wall time
    - ``cpu``, float, s: CPU time, summed over the threads; other load
      on the machine adds little to it
    - ``problem``, str: why it ended early, in words; empty if it reached the end
    """

    positions: list[FloatArray]
    work: Work = field(default_factory=ChosenWork)
    wall: float = 0.0
    cpu: float = 0.0
    problem: str = ""

    @property
    def done(self) -> bool:
        """Whether the end was reached."""
        return not self.problem


def replay(problem: ReplayProblem, integrator: Integrator, limit: float = np.inf) -> Trajectory:
    """Carry the cells of a problem through all its coupling steps and events.

    - ``limit``: wall time in s after which the replay ends, at the next coupling step or at the
      next evaluation that a method asks for from Python (those compiled as a whole ask for none)

    Returns Trajectory: a failure is returned in words, whatever it was: in a chart of many methods
    the fault of one must not lose the others.
    """
    system = problem.system()
    position = problem.start
    ends: list[FloatArray] = []
    begin, begin_cpu = clock.perf_counter(), clock.process_time()
    if limit < np.inf:
        set_deadline(system, begin + limit, timeout_words(limit))
    words = ""
    for k, step in enumerate(problem.steps):
        position = problem.beginning(k, position)
        system.begin(step.motion)
        words, position = advance_system(system, integrator, position)
        last = k + 1 == len(problem.steps)
        if not words and not last and clock.perf_counter() - begin > limit:
            words = f"{timeout_words(limit)} (t = {step.motion.end:.6g} s)"
        if words:
            break
        ends.append(position)
    wall, cpu = clock.perf_counter() - begin, clock.process_time() - begin_cpu
    return Trajectory(ends, system.work, wall, cpu, words)


@final
class _OutOfTime(Exception):  # noqa: N818 - it names what happened
    """Report a solve that takes longer than it may."""


def solve_compiled(solve: Callable[[], T]) -> tuple[T, float]:
    """Solve without compiling; return the result and the wall time lost to compilation, s.

    A tolerance or a step may be the first to need some kernel; then it is solved a second time.
    """
    begin = clock.perf_counter()
    with install_recorder("numba:compile") as compiled:
        found = solve()
    if not compiled.buffer:
        return found, 0.0
    lost = clock.perf_counter() - begin
    return solve(), lost


def timeout_words(limit: float) -> str:
    """Return the words for a solve that takes longer than ``limit`` s of wall time."""
    return f"not done after {limit:g} s of wall time"


def set_deadline(system: Mechanics, deadline: float, words: str) -> None:
    """Let the next evaluation of this one system end the solve once a time has passed."""
    inner = system.velocity

    def velocity(time: float, position: FloatArray, out: FloatArray) -> None:
        if clock.perf_counter() > deadline:
            raise _OutOfTime(words)
        inner(time, position, out)

    system.velocity = velocity  # type: ignore[method-assign]


def advance_system(
    system: Mechanics, integrator: Integrator, position: FloatArray
) -> tuple[str, FloatArray]:
    """Integrate over the coupling step of ``system``, whatever happens.

    Returns str: words of a failure; empty if there was none; (n, 3) float64, µm: where the step
    ended.
    """
    begin = system.motion.begin
    try:
        # what overflows on the way ends in a position that is not finite
        with np.errstate(all="ignore"):
            outcome = integrator.integrate(system, position)
    except _OutOfTime as error:
        return f"{error} (in the step from t = {begin:.6g} s)", position
    except Exception as error:  # see replay(): it becomes a row with these words
        return f"{error} ({type(error).__name__}, in the step from t = {begin:.6g} s)", position
    if not outcome.done:
        return f"{outcome.problem} (t = {outcome.time:.6g} s)", position
    if not np.isfinite(outcome.position).all():
        return f"a position is not a number (in the step from t = {begin:.6g} s)", position
    return "", system.at_end(outcome.position)
