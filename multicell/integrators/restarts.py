"""Step through a coupling step with solvers of other packages; restart where one fails.

A solver with its own error control may accept a step that throws a cell away, or give up on
a state that has no meaning. Its internal step cannot be taken back, so a new solver is
started at the last good state, with a ceiling on its steps, which is lifted again bit by bit.

SUNDIALS holds the mean square of all coordinates' errors against the tolerance: one daughter among
thousands of cells at rest may then be wrong by many tolerances in a single step, and end in another
pocket, where the true course leads to none but one. Tissue that grows is like that all the time. So
solvers are given a share of the tolerance (:func:`.limits.norm_share`), CVODE a part of that share,
and a step in which a single cell's estimated error exceeds the tolerance is refused and taken with
a smaller share. To bound h times the largest positive eigenvalue of J made errors as small, with
two to five times as many steps, and products for that eigenvalue in each of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, final

import numpy as np

from multicell.cells import FloatArray
from multicell.host.interrupts import UNCUT
from multicell.integrators.base import OUT_OF_STEPS_HINT, ErrorControl, Outcome, move_words
from multicell.integrators.limits import find_failure, norm_share
from multicell.integrators.stepping import LEAST_PART, largest_length
from multicell.mechanics.motion import StateRejected
from multicell.mechanics.system import Mechanics
from multicell.mechanics.watch import empty_ways, furthest_ways

_MAX_REFUSALS = 30  # restarts with shorter steps in one interval; then it is given up
_STEPS_BEFORE_LIFT = 8  # steps without a refusal after which a ceiling rises again
_SHORTER = 0.25  # ceiling of steps after a refusal, over the refused one
_SMALLER = 0.25  # by how much the share is made smaller then


class StepImpossible(Exception):  # noqa: N818 - what happened to a solver, not a fault
    """A solver cannot continue from its state; the text is its own reason."""


class Restart(Exception):  # noqa: N818 - a request
    """A solver asks to be made anew at its last accepted state."""


class Taken(NamedTuple):
    """A step that a solver has taken; its arrays stay valid.

    - ``time``, float: of its end, since the solver's start, s
    - ``position``, (n, 3): there, µm
    - ``error``, float: the largest one that it is expected to have made with a cell, µm, or NaN
    - ``speed``, (n, 3), optional: velocities there, µm/s, where the solver knows them
    """

    time: float
    position: FloatArray
    error: float = math.nan
    speed: FloatArray | None = None


class Solver(Protocol):
    """A solver under way; its clock counts from its start.

    A step of 1e-10 s would be lost on a clock that shows days.
    """

    def take_step(self) -> Taken:
        """Take one step."""

    def close(self) -> None:
        """Let go of what calls it back: such a circle would hold its arrays for long."""


Start = Callable[["IntegrationProgress", float], Solver]
"""Makes a solver for the rest of the interval; the number is the ceiling of its steps, or 0."""


@final
class IntegrationProgress:
    """One integration: the last accepted state and the counts so far.

    Attributes
    ----------
    position : (n, 3)
        At the last accepted state, µm.
    elapsed, length : float
        Time since the beginning of the interval, and its length, s.
    offset : float
        ``elapsed`` when the present solver was started.
    latest : float
        Time of the last evaluation, on the present solver's clock.
    share : float
        Part of the tolerances that a solver gets whose norm is a mean over all coordinates.
    speed : (n, 3), optional
        Velocities at the last accepted state, µm/s, where they are known.

    With ``each_cell`` the tolerance, ``atol`` + ``rtol`` times the mean radius, is held by single
    cells, too, as far as solvers report the errors of their steps; ``part`` is the part of the
    usual share that a solver then begins with.
    """

    def __init__(
        self,
        method: ErrorControl,
        system: Mechanics,
        position: FloatArray,
        *,
        each_cell: bool = True,
        part: float = 1.0,
    ) -> None:
        self.method, self.system = method, system
        self.position = np.array(position)
        self.share, self._most_error = 1.0, math.inf
        if each_cell and len(system):
            self.share = part * norm_share(len(system))
            self._most_error = method.atol + method.rtol * float(system.motion.radius.mean())
        self.length = system.motion.end - system.motion.begin
        self.elapsed = 0.0
        self.offset = 0.0
        self.latest = 0.0
        self.speed: FloatArray | None = None
        self._ways = empty_ways(len(system))
        self.steps = 0
        self.problem = ""
        self.hint = ""
        self.cell: int | None = None

    @property
    def left(self) -> float:
        """Rest of the interval when the present solver was started, s."""
        return self.length - self.offset

    def clock(self, t: float) -> float:
        """Return the scene's time for the present solver's."""
        return self.system.motion.begin + self.offset + t

    def velocity(self, t: float, y: FloatArray, out: FloatArray) -> None:
        """Write the velocities, flat, at flat positions."""
        UNCUT.pause()
        self.latest = t
        self.system.velocity(self.clock(t), y.reshape(-1, 3), out.reshape(-1, 3))

    def integrate(self, start: Start) -> Outcome:
        """Step to the end of the interval, starting again where that helps.

        Signals come between two evaluations only: an exception there ends a solver by its own exit.
        """
        with UNCUT:
            return self._integrate(start)

    def _integrate(self, start: Start) -> Outcome:
        if len(self.system) == 0:
            return Outcome(self.system.motion.end, self.position)
        refused = find_failure(self.system, self.position, self.method.atol)
        if refused is not None:
            return refused
        ceiling = 0.0
        refusals = refused_at = 0
        while True:
            self.offset, self.latest = self.elapsed, 0.0
            solver: Solver | None = None
            try:
                solver = self._started(start, ceiling)
                lifted = self._advance(solver, ceiling)
            except _Refused as refusal:
                self.system.work.rejections += 1
                self.problem, self.cell = str(refusal), refusal.cell
                self.hint = "Choose a shorter coupling_step or a tighter integrator.atol"
                # ceilings are lifted again and again: what counts is refusals without a step
                refusals = refusals + 1 if self.steps == refused_at else 1
                refused_at = self.steps
                if refusals > _MAX_REFUSALS:
                    break
                ceiling = _SHORTER * (refusal.dt or self.left)
                continue
            except Restart:
                continue
            finally:
                if solver is not None:
                    solver.close()
            if not lifted:
                break
            ceiling = 4.0 * ceiling if 4.0 * ceiling < self.length else 0.0
        time = self.system.motion.begin + self.elapsed
        if self.elapsed >= self.length:
            return Outcome(self.system.motion.end, self.position)
        return Outcome(time, self.position, self.problem, self.hint, self.cell)

    def _started(self, start: Start, ceiling: float) -> Solver:
        """Return a solver; one that tries states before its first step may fail at that."""
        try:
            return start(self, ceiling)
        except (StateRejected, StepImpossible) as error:
            raise _Refused(str(error), self.latest) from error

    def _advance(self, solver: Solver, ceiling: float) -> bool:
        """Step until the end, or until the ceiling may be lifted (then return True)."""
        held = 0
        while self.elapsed < self.length:
            if self.steps >= self.method.max_steps:
                self.problem = f"{self.steps} internal steps did not reach the end"
                self.hint = OUT_OF_STEPS_HINT
                return False
            dt = self._step(solver)
            held = held + 1 if dt > 0.9 * ceiling else 0
            if ceiling > 0.0 and held >= _STEPS_BEFORE_LIFT and self.elapsed < self.length:
                return True
        return False

    def _step(self, solver: Solver) -> float:
        """Take one step if it may be taken; return its length."""
        before = self.elapsed - self.offset
        try:
            reached, moved_to, expected, speed = solver.take_step()
        except (StateRejected, StepImpossible) as error:
            raise _Refused(str(error), self.latest - before) from error
        if expected > self._most_error:
            # with 1/√(3n) the norm excludes it: this ends after a few times
            self.share *= _SMALLER
            self.system.work.rejections += 1
            raise Restart
        radius = self.system.motion.radius
        cell, moved = furthest_ways(self.position, moved_to, radius, self._ways)
        # a move that is no number is the largest
        if not moved <= self.method.max_displacement:
            words = move_words(reached - before, moved, self.method.max_displacement)
            raise _Refused(words, reached - before, cell)
        self._refuse_missed(before, reached, moved_to, speed, moved)
        self.position, self.speed = moved_to, speed
        self.elapsed = self.length if reached >= self.left else self.offset + reached
        self.steps += 1
        self.system.work.steps += 1
        self.cell = cell
        return reached - before

    def _refuse_missed(
        self,
        before: float,
        reached: float,
        moved_to: FloatArray,
        speed: FloatArray | None,
        moved: float,
    ) -> None:
        """Refuse a step that misses a contact which forms in it, where velocities are known."""
        if speed is None or self.speed is None or not self._most_error < math.inf:
            return
        part = self.system.missed_contact(
            self.clock(before),
            self.clock(reached),
            self.position,
            moved_to,
            self.speed,
            speed,
            moved,
            self._most_error,
            self._ways,
        )
        if part < 1.0:
            dt = reached - before
            words = f"a contact forms within a step of {dt:.3g} s"
            raise _Refused(words, dt * max(part, LEAST_PART) / _SHORTER)


def one_step(solver: Any, left: float) -> Any:
    """Return the report of SUNDIALS on one internal step, up to ``left``."""
    result = solver.step(left, method="onestep", tstop=left)
    if not result.success:
        raise StepImpossible(f"SUNDIALS: {result.message}")
    return result


@final
class Predictor:
    """CVODE's own estimate of its errors, which scikit-sundae does not report.

    Newton's method begins at the state that the formula's polynomial predicts, so that the first
    evaluation at a new time is there. The error of a step of order q is the difference between
    solution and prediction over q + 1 (with equal steps; Hindmarsh et al., ACM TOMS 31 (2005)
    363). Where the order is not known it is taken as 1: the estimate is then up to three times
    too large.
    """

    def __init__(self, run: IntegrationProgress) -> None:
        self._run = run
        self._time = 0.0
        self._state = run.position.ravel().copy()
        self._speed = np.empty_like(run.position)

    def velocity(self, t: float, y: FloatArray, out: FloatArray) -> None:
        """Write the velocities as :meth:`Run.velocity` does, and note what was predicted."""
        if t != self._time:
            self._time = t
            self._state[:] = y
        self._run.velocity(t, y, out)
        self._speed.ravel()[:] = out
        if self._run.speed is None and t == 0.0:
            self._run.speed = self._speed.copy()

    def taken(self, t: float, y: FloatArray, order: int = 1) -> Taken:
        """Return the progress after a step that ended at ``t``.

        The velocity there is that of the last iterate, which differs from the solution by less than
        the tolerance of Newton's method.
        """
        speed = self._speed.copy() if t == self._time else None
        return Taken(float(t), y.reshape(-1, 3).copy(), self._error(t, y, order), speed)

    def _error(self, t: float, y: FloatArray, order: int) -> float:
        """Return the largest estimated error of a cell in a step that ended at ``t``, µm."""
        if t != self._time:
            return math.nan
        return float(largest_length((y - self._state).reshape(-1, 3))) / (order + 1.0)


class _Refused(Exception):  # noqa: N818 - control flow inside this module
    """A step that must not be taken; ``dt`` is its length in s, where it is known."""

    def __init__(self, problem: str, dt: float, cell: int | None = None) -> None:
        super().__init__(problem)
        self.dt = max(dt, 0.0)
        self.cell = cell
