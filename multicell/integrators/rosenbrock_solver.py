"""Steps of the Rosenbrock method, and the linear systems (I - γA) x = b in them.

In the scalar product ⟨u, v⟩ = Σ_i r_i u_i·v_i of the radii, that is of the drag coefficients, J is
symmetric, and so is A, so that conjugate gradients apply. They yield more than the solution: of
every search direction p, ⟨p, A p⟩ / ⟨p, p⟩ is a lower bound on the largest eigenvalue of A.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, final

import numpy as np

from multicell.cells import FloatArray
from multicell.compiling import KERNEL, typed
from multicell.integrators.base import OUT_OF_STEPS_HINT, Outcome, move_words
from multicell.integrators.driver import control
from multicell.integrators.stepping import (
    LEAST_PART,
    fit_step,
    furthest_move,
    largest_length,
    next_step,
    step_after_error,
    step_after_move,
)
from multicell.mechanics.jacobian import limited
from multicell.mechanics.motion import StateRejected
from multicell.random import Purpose, normal

if TYPE_CHECKING:
    from multicell.integrators.rosenbrock import Rosenbrock
    from multicell.mechanics.system import Mechanics

_jit = typed(**KERNEL)

_D = 1.0 / (2.0 + math.sqrt(2.0))
_E = 6.0 + math.sqrt(2.0)  # coefficients of Shampine & Reichelt (1997)
_ORDER = 3.0  # exponent of the step in the estimated error
_SHORTEST = 1e-13  # steps below this fraction of the interval are lost in rounding
_MOST_ITERATIONS = 200  # of conjugate gradients in a stage
_PROBE = 5  # iterations of the search for an eigenvalue above the bound
_AGE, _LONGER = 10, 1.5
"""The search is repeated after so many steps, or once steps are so much longer."""
_FORCING = 0.03  # error that a linear system may leave in a position, in that of a step
_SHARE = 0.1  # of its right-hand side that the residual of a linear system may have
_FORGOTTEN, _LARGEST = 40.0, 4.0
"""Steps of the present length before the end from which on larger errors are allowed, since they
will be forgotten, and how much larger."""
_FIRST = 0.5  # tolerances that the fastest cell moves in the first step
_HINT = "Choose a shorter coupling_step or a tighter integrator.atol"


class Refused(Exception):  # noqa: N818 - what happened to a step, not a fault
    """A step that must not be taken.

    - ``factor``, float: of the step that is to be tried
    - ``cell``, int or None: cell that shows the problem
    """

    def __init__(self, problem: str, factor: float, cell: int | None = None) -> None:
        super().__init__(problem)
        self.factor, self.cell = factor, cell


@_jit
def _product(radius: FloatArray, a: FloatArray, b: FloatArray) -> float:
    """Return ⟨a, b⟩."""
    total = 0.0
    for i in range(radius.size):
        total += radius[i] * (a[i, 0] * b[i, 0] + a[i, 1] * b[i, 1] + a[i, 2] * b[i, 2])
    return total


@_jit
def _image(
    radius: FloatArray, gamma: float, vector: FloatArray, image: FloatArray
) -> tuple[float, float]:
    """Replace J v by v - γ J v; return its scalar product with v, and ⟨v, v⟩."""
    curvature, square = 0.0, 0.0
    for i in range(radius.size):
        a, b = 0.0, 0.0
        for k in range(3):
            v = vector[i, k]
            y = v - gamma * image[i, k]
            image[i, k] = y
            a += v * y
            b += v * v
        curvature += radius[i] * a
        square += radius[i] * b
    return curvature, square


@_jit
def _advance(
    share: float, direction: FloatArray, image: FloatArray, solution: FloatArray, left: FloatArray
) -> float:
    """Go along a direction; return the length of the longest row of the residual."""
    most = 0.0
    for i in range(left.shape[0]):
        square = 0.0
        for k in range(3):
            solution[i, k] += share * direction[i, k]
            r = left[i, k] - share * image[i, k]
            left[i, k] = r
            square += r * r
        most = max(most, square)
    return math.sqrt(most)


@_jit
def _turn(better: FloatArray, share: float, direction: FloatArray) -> None:
    """Replace a direction by ``better`` + share direction."""
    x, y = better.reshape(-1), direction.reshape(-1)
    for k in range(y.size):
        y[k] = x[k] + share * y[k]


@_jit
def worst_cell(
    error: FloatArray, before: FloatArray, after: FloatArray, rtol: float, atol: float
) -> float:
    """Return the largest |e_i| / (atol + rtol max |x_ik|) of a cell; not a number is ∞."""
    most = 0.0
    for i in range(error.shape[0]):
        square, size = 0.0, 0.0
        for k in range(3):
            square += error[i, k] * error[i, k]
            size = max(size, abs(before[i, k]), abs(after[i, k]))
        part = math.sqrt(square) / (atol + rtol * size)
        if not math.isfinite(part):
            return math.inf
        most = max(most, part)
    return most


@final
class Resolvent:
    """Approximate solutions with I - γA, and a watch on the positive eigenvalues of A."""

    def __init__(self, method: Rosenbrock, system: Mechanics) -> None:
        self.method, self.system = method, system
        shape = (len(system), 3)
        self._left, self._better = np.empty(shape), np.empty(shape)
        self._direction, self._image = np.empty(shape), np.empty(shape)
        self._slowest = np.zeros(shape)
        self._noise = normal(0, Purpose.EIGENVECTOR, 0, np.arange(3 * len(system))).reshape(shape)
        self._age, self._probed = _AGE, math.inf

    def linearise(self, time: float, position: FloatArray) -> None:
        """Take A at a state: J with bounded softening."""
        self.system.linearise(time, position)
        self.linear, _ = limited(self.system, self.method.softening)

    def setup(self, dt: float) -> None:
        """Prepare for a step; refuse one that is too long for what grows."""
        self.dt = dt
        self.system.setup_preconditioner(_D * dt, self.linear)
        self._age += 1
        if self._age > _AGE or dt > _LONGER * self._probed:
            self._probe()

    def solve(
        self, right: FloatArray, guess: FloatArray | None, allowed: float, share: float = _SHARE
    ) -> FloatArray:
        """Return x with (I - γA) x = b, (n, 3).

        No row of the residual is longer than ``allowed``, nor than a ``share`` of the longest row
        of b: what moves less than the tolerance moves too, and may grow.
        """
        radius, gamma = self.system.motion.radius, _D * self.dt
        allowed = min(allowed, share * largest_length(right))
        if guess is None:
            solution = np.zeros_like(right)
            self._left[:] = right
        else:
            solution = guess.copy()
            self.system.jacobian_product(guess, self._image, self.linear)
            _image(radius, gamma, guess, self._image)
            np.subtract(right, self._image, out=self._left)
        size = largest_length(self._left)
        if not self._iterate(gamma, solution, size, allowed, _MOST_ITERATIONS) <= allowed:
            raise Refused("the linear system is not solved", 0.25)
        return solution

    def _probe(self) -> None:
        """Look for an eigenvalue of A above the bound: inverse iteration on what was found last."""
        radius = self.system.motion.radius
        self._left[:] = self._noise / math.sqrt(_product(radius, self._noise, self._noise))
        size = math.sqrt(_product(radius, self._slowest, self._slowest))
        if size > 0.0:
            self._left += self._slowest / size
        solution = np.zeros_like(self._left)
        self._age, self._probed = 0, 0.0  # of a step that is refused nothing is known
        self._iterate(self.dt / self.method.growth, solution, 1.0, 0.0, _PROBE)
        self._slowest, self._probed = solution, self.dt

    def _iterate(
        self, gamma: float, solution: FloatArray, size: float, allowed: float, most: int
    ) -> float:
        """Improve a solution whose residual is known; return the length of its longest row."""
        system, radius = self.system, self.system.motion.radius
        left, better, direction, image = self._left, self._better, self._direction, self._image
        direction[:] = 0.0
        before = 1.0
        for _ in range(most):
            if size <= allowed:
                break
            system.precondition(left, better)
            product = _product(radius, left, better)
            if product == 0.0:
                break
            _turn(better, product / before, direction)
            before = product
            system.work.linear_iterations += 1
            system.jacobian_product(direction, image, self.linear)
            curvature, square = _image(radius, gamma, direction, image)
            rate = (1.0 - curvature / square) / gamma
            if not self.dt * rate <= self.method.growth:
                allowed_step = self.method.growth / rate if rate > 0.0 else 0.0
                raise Refused(
                    f"disturbances grow at a rate of {rate:.3g} /s",
                    max(0.1, min(0.5, 0.9 * allowed_step / self.dt)),
                )
            size = _advance(product / curvature, direction, image, solution, left)
        return size


@final
class Walk:
    """One integration under way."""

    def __init__(self, method: Rosenbrock, system: Mechanics, position: FloatArray) -> None:
        self.method, self.system = method, system
        self.position = position
        self.length = system.motion.end - system.motion.begin
        self.elapsed = 0.0
        self.velocity = np.empty_like(position)
        self._middle, self._end, self._later, self._change = (
            np.empty_like(position) for _ in range(4)
        )
        self._slope, self._last = np.zeros_like(position), np.zeros_like(position)
        # errors of steps of order 3 make one of the interval of order 2
        self._tolerances = method.worst * control(method, system, _ORDER, lower=2).strictness
        motion = system.motion
        # velocities change while no cell moves
        changing = (motion.radius_rate, motion.bonds, motion.push, motion.velocity)
        self._moving = any(values is not None and bool(np.any(values)) for values in changing)
        # what drives cells keeps errors alive
        self._largest = _LARGEST if system.motion.push is None else 1.0
        self._resolvent = Resolvent(method, system)
        self._linearised, self._steps, self._moved = False, 0, 0.0
        self._bound = self._tolerances
        self._problem: str = ""
        self._cell: int | None = None

    def integrate(self) -> Outcome:
        """Step to the end of the interval."""
        begin = self.system.motion.begin
        try:
            self.system.velocity(begin, self.position, self.velocity)
        except StateRejected as error:
            return Outcome(begin, self.position, str(error), _HINT)
        dt, previous, held = self._first_step(), 1.0, False
        while self.elapsed < self.length:
            dt = fit_step(dt, self.length - self.elapsed)
            failed = self._ended(dt)
            if failed is not None:
                return failed
            try:
                size = self._step(dt)
            except (StateRejected, Refused) as error:
                # the error itself is not kept: its traceback holds this frame and all arrays in it
                factor, self._problem, self._cell = 0.25, str(error), None
                if isinstance(error, Refused):
                    factor, self._cell = error.factor, error.cell
                self.system.work.rejections += 1
                dt, held = factor * dt, True
                continue
            wanted = next_step(dt, size, previous, _ORDER)
            # no growth right after a refusal
            dt = min(dt, wanted) if held else wanted
            held, previous = False, max(size, 1e-4)
        return Outcome(self.system.motion.end, self.position)

    def _ended(self, dt: float) -> Outcome | None:
        """Return how the integration ends if no further step can be tried."""
        time = self.system.motion.begin + self.elapsed
        if self._steps == self.method.max_steps:
            problem = f"{self._steps} internal steps did not reach the end"
            return Outcome(time, self.position, problem, OUT_OF_STEPS_HINT, self._cell)
        if dt < _SHORTEST * self.length:
            problem = f"steps became too short to continue: {self._problem}"
            return Outcome(time, self.position, problem, _HINT, self._cell)
        return None

    def _first_step(self) -> float:
        """Return a step in which the fastest cell moves by a part of the tolerance."""
        speed = largest_length(self.velocity)
        if speed == 0.0:
            return self.length
        wanted = float(_FIRST * self.method.atol / speed)
        return min(self.length, max(1e-6 * self.length, wanted))

    def _step(self, dt: float) -> float:
        """Take a step; return its estimated error over the allowed one."""
        system, motion = self.system, self.system.motion
        begin = motion.begin + self.elapsed
        last = dt == self.length - self.elapsed
        end = motion.end if last else begin + dt
        if not self._linearised:
            self._resolvent.linearise(begin, self.position)
            self._linearised = True
        self._resolvent.setup(dt)
        steps_left = (motion.end - end) / dt
        self._bound = self._tolerances * min(self._largest, max(1.0, steps_left / _FORGOTTEN))
        trial, errors = self._stages(begin, dt, end)
        rtol, atol = self.method.rtol, self.method.atol
        size = max(worst_cell(error, self.position, trial, rtol, atol) for error in errors)
        size /= self._bound
        if not size <= 1.0:
            raise Refused(
                f"a step of {dt:.3g} s is not exact enough",
                step_after_error(1.0, size, _ORDER, 0.2),
            )
        part = system.missed_contact(
            begin, end, self.position, trial, self.velocity, self._end, self._moved, atol
        )
        if part < 1.0:
            raise Refused(f"a contact forms within a step of {dt:.3g} s", max(part, LEAST_PART))
        self.position = trial
        self.velocity, self._end = self._end, self.velocity
        self._slope, self._last = self._last, self._slope
        self.elapsed = self.length if last else self.elapsed + dt
        self._linearised = False
        self._steps += 1
        system.work.steps += 1
        return float(size)

    def _stages(
        self, begin: float, dt: float, end: float
    ) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
        """Return the end of a step and two estimates of its error, (n, 3) µm each.

        The method's own one is smoothed by (I - γA)⁻¹, and a contact that forms within a long step
        hardly shows in it. The other is the part of the change of velocity that A does not explain.
        """
        method, system, start = self.method, self.system, self.position
        solve = self._resolvent.solve
        allowed = _FORCING * self._bound * method.atol / dt
        drift = self._drift(begin, dt)
        first = solve(self.velocity + drift, self._slope, allowed)
        system.velocity(0.5 * (begin + end), start + (0.5 * dt) * first, self._middle)
        second = first + solve(self._middle - first, None, allowed)
        trial = start + dt * second
        cell, moved = furthest_move(start, trial, system.motion.radius)
        self._moved = moved
        if not moved <= method.max_displacement:
            allowed_move = method.max_displacement
            raise Refused(
                move_words(dt, moved, allowed_move),
                step_after_move(1.0, moved, allowed_move),
                cell,
            )
        system.velocity(end, trial, self._end)
        right = self._end - _E * (second - self._middle) - 2.0 * (first - self.velocity) + drift
        # only the estimate depends on it, by a sixth
        self._last = solve(right, second, 4.0 * allowed, 1.0)
        system.jacobian_product(trial - start, self._change, self._resolvent.linear)
        self._change += self.velocity + drift / _D - self._end
        smoothed = (dt / 6.0) * (first - 2.0 * second + self._last)
        return trial, (smoothed, (method.sharp * dt) * self._change)

    def _drift(self, begin: float, dt: float) -> FloatArray | float:
        """Return γ ∂v/∂t."""
        if not self._moving:
            return 0.0
        self.system.velocity(begin + 0.5 * dt, self.position, self._later)
        return (2.0 * _D) * (self._later - self.velocity)
