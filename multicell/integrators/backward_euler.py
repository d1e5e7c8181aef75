"""Backward Euler with a fixed step: the least energy downhill from where the step begins.

Without friction between cells the end of a step minimises ½ ‖x - x_0‖² / Δt + U(x) in the norm
of the scalar product ⟨u, v⟩ = Σ_i Γ_i u_i·v_i of the drag coefficients at the end of the step;
external forces add a linear part to the energy U. Times Δt, the gradient is the residual
x - x_0 - Δt v and the second derivative I - ΔtJ, which is symmetric in that product.
So Newton's method finds the minimum by conjugate gradients and a line search along the energy, and
where a direction has no positive curvature cells go along it as far as they may (Steihaug 1983).

With friction there is no such energy. There, and where the energy of a user's law does not belong
to its force closely enough, Newton's method with GMRES lowers the residual.

References
----------
T. Steihaug, "The conjugate gradient method and trust regions in large scale optimization", SIAM
J. Numer. Anal. 20 (1983), https://doi.org/10.1137/0720042
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, final

import numpy as np

from multicell.integrators.base import (
    EqualSteps,
    MethodInfo,
    Outcome,
    count_equal_steps,
    move_words,
)
from multicell.mechanics.rows import SOFTENING

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.mechanics.preconditioners import Sweeps
    from multicell.mechanics.system import Mechanics

_EXACT = 1e-2  # tolerance of Newton's method over that of the method
_HALVINGS = 30  # of a line search: below 10^-9 of a Newton step nothing is left to gain
_MAX_ITERATIONS = 200  # of conjugate gradients in a Newton step
_RESIDUAL = 100.0
"""Largest residual at the end of Newton's method, in tolerances of its last correction.

Since no eigenvalue of I - ΔtJ of a cluster at rest is below 1, the error is at most the residual.
The correction alone is not enough: where γλ is large, the linear solver's residual may hide a
motion of the cluster as a whole.
"""
_FORCING = 1e-2  # relative residual to which each linear system is solved
_FINER = 1e-2  # what that is multiplied by where ``_RESIDUAL`` is exceeded
_DECREASE = 1e-4
"""Least part of the promised decrease, of the residual or of the energy (Armijo's rule)."""
_ROUNDING = 1e-14  # of the energy, below which a difference of two energies is rounding


@final
@dataclass(frozen=True)
class BackwardEuler(EqualSteps):
    """x_{k+1} = x_k + Δt v(t_{k+1}, x_{k+1}), first order.

    - ``tolerance``: Newton's method ends when the largest correction of a coordinate is below this,
      µm
    - ``newton``: most Newton iterations in a step
    """

    info: ClassVar[MethodInfo] = MethodInfo(
        "backward-euler",
        "implicit Euler with a fixed step, Newton's method along the energy",
        "step",
        order=1,
        implicit=True,
        stable=math.inf,
        colour="#0d4a3a",
        marker="v",
        make=lambda step, atol, max_displacement: BackwardEuler(
            step, max_displacement, tolerance=_EXACT * atol
        ),
    )

    tolerance: float = _EXACT * info.atol
    newton: int = 100

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step of ``system``; see :class:`Integrator`."""
        from multicell.integrators.limits import find_failure
        from multicell.integrators.stepping import furthest_move
        from multicell.mechanics.motion import StateRejected

        if len(system) == 0:
            return Outcome(system.motion.end, np.array(position))
        refused = find_failure(system, position, self.tolerance)
        if refused is not None:
            return refused
        motion = system.motion
        count = count_equal_steps(motion.end - motion.begin, self.step)
        dt = (motion.end - motion.begin) / count
        position = np.array(position)
        for k in range(count):
            time = motion.begin + k * dt
            hint = "Choose a shorter integrator.step, or the method 'cvode'"
            implicit = _Step(self, system, position, motion.begin + (k + 1) * dt, dt)
            try:
                problem = implicit.solve()
            except StateRejected as error:
                problem = str(error)
            if problem:
                return Outcome(time, position, problem, hint, implicit.worst)
            cell, moved = furthest_move(position, implicit.trial, motion.radius)
            if moved > self.max_displacement:
                problem = move_words(dt, moved, self.max_displacement)
                return Outcome(time, position, problem, hint, cell)
            position = implicit.trial
            system.work.steps += 1
        return Outcome(motion.end, position)


@final
class _Step:
    """The equation of one step, x - x_0 - Δt v(t_1, x) = 0, and its solution so far."""

    def __init__(
        self, method: BackwardEuler, system: Mechanics, start: FloatArray, end: float, dt: float
    ) -> None:
        self.method, self.system, self.start, self.end, self.dt = method, system, start, end, dt
        self.trial = start.copy()
        motion = system.motion
        radius = motion.radius + motion.radius_rate * (end - motion.begin)
        self.weight = system.drag * radius[:, None]
        self.forcing = _FORCING
        self.room = self.most_room = 0.5 * float(radius.min(initial=np.inf))
        # with friction between cells the drag is a matrix that depends on their places
        self.descends = max(system.friction) == 0.0
        self.worst: int | None = None

    def solve(self) -> str:
        """Find the end of the step; return what went wrong, if anything did."""
        from multicell.mechanics.jacobian import limited
        from multicell.mechanics.preconditioners import Sweeps

        method, system = self.method, self.system
        # with friction between cells J = Γ⁻¹K is not a matrix of pairs, which the sweeps need
        approximate = system if max(system.friction) > 0.0 else Sweeps(system)
        residual = self._residual(self.trial)
        self.energy = self._energy(self.trial) if self.descends else 0.0
        for _ in range(method.newton):
            system.work.newton_iterations += 1
            system.linearise(self.end, self.trial)
            self.linear = system.linearisation
            if not self.descends:
                self.linear, _ = limited(system, SOFTENING)
            approximate.setup_preconditioner(self.dt, self.linear)
            solve = self._conjugate_gradients if self.descends else self._gmres
            correction = solve(residual, approximate)
            found = self._search(residual, correction)
            if found is None and self.descends:
                self.descends, self.room = False, self.most_room
                continue
            if found is None:
                self.worst = int(np.square(residual).sum(axis=1).argmax())
                return (
                    f"backward Euler's step of {self.dt:.3g} s has no solution that a line "
                    "search finds"
                )
            residual, taken = found
            if taken * np.abs(correction).max(initial=0.0) <= method.tolerance:
                if np.abs(residual).max(initial=0.0) <= _RESIDUAL * method.tolerance:
                    return ""
                self.forcing *= _FINER
        self.worst = int(np.square(residual).sum(axis=1).argmax())
        return (
            f"Newton's method did not converge in {method.newton} iterations in a step of "
            f"{self.dt:.3g} s"
        )

    def _residual(self, trial: FloatArray) -> FloatArray:
        out = np.empty_like(trial)
        self.system.velocity(self.end, trial, out)
        return np.asarray(trial - self.start - self.dt * out)

    def _search(
        self, residual: FloatArray, correction: FloatArray
    ) -> tuple[FloatArray, float] | None:
        """Take as much of a correction as lowers the energy; None if nothing does.

        The residual must fall instead where only rounding is left of the energy, and with friction.
        """
        before, slope = self._norm(residual), self._product(residual, correction)
        largest = _length(correction)
        taken = 1.0 if largest <= self.room else self.room / largest
        for halvings in range(_HALVINGS):
            trial = self.trial + taken * correction
            energy = self._energy(trial) if self.descends else self.energy
            fall = self.energy - energy
            if fall >= -_ROUNDING * (abs(self.energy) + abs(energy)):
                after = self._residual(trial)
                # at the end of the iteration only rounding is left
                if (
                    (self.descends and fall >= -_DECREASE * taken * slope)
                    or self._norm(after) <= (1.0 - _DECREASE * taken) * before
                    or taken * largest <= self.method.tolerance
                ):
                    self.trial, self.energy = trial, energy
                    if self.descends:
                        wider = min(2.0 * self.room, self.most_room)
                        self.room = taken * largest if halvings else wider
                    return after, taken
            taken *= 0.5
        return None

    def _energy(self, trial: FloatArray) -> float:
        """Return ½ ‖x - x_0‖² + Δt (U - f·x), whose gradient is the residual, nN s µm."""
        system, moved = self.system, trial - self.start
        system.work.evaluations += 1
        potential = system.energy(self.end, trial)
        push = system.motion.push
        if push is not None:
            force = push[:, :3] + (self.end - system.motion.begin) * push[:, 3:]
            potential -= float((force * moved).sum())
        return 0.5 * self._product(moved, moved) + self.dt * potential

    def _product(self, first: FloatArray, second: FloatArray) -> float:
        return float((self.weight * first * second).sum())

    def _norm(self, vector: FloatArray) -> float:
        return math.sqrt(self._product(vector, vector))

    def _operator(self, vector: FloatArray) -> FloatArray:
        out = np.empty_like(vector)
        self.system.work.linear_iterations += 1
        self.system.jacobian_product(vector, out, self.linear)
        return np.asarray(vector - self.dt * out)

    def _conjugate_gradients(
        self, residual: FloatArray, approximate: Sweeps | Mechanics
    ) -> FloatArray:
        """Solve (I - ΔtJ) x = -residual as far as ``forcing`` asks, or find a way down.

        A way down ends where the curvature is not positive: the last direction is then followed as
        far as cells may move (Steihaug 1983).
        """
        solution, left = np.zeros_like(residual), -residual
        better = np.empty_like(residual)
        target = self.forcing * self._norm(residual)
        direction, before = np.zeros_like(residual), 1.0
        for _ in range(_MAX_ITERATIONS):
            if self._norm(left) <= target:
                break
            approximate.precondition(left, better)
            product = self._product(left, better)
            direction = better + product / before * direction
            before = product
            image = self._operator(direction)
            curvature = self._product(direction, image)
            if curvature <= 0.0:
                return solution + self.room / (_length(direction) or 1.0) * direction
            solution += product / curvature * direction
            left -= product / curvature * image
            if _length(solution) > self.room:
                break
        return solution

    def _gmres(self, residual: FloatArray, approximate: Sweeps | Mechanics) -> FloatArray:
        from scipy.sparse.linalg import LinearOperator, gmres

        shape = (residual.size, residual.size)

        def apply(vector: FloatArray) -> Any:
            return self._operator(vector.reshape(-1, 3)).ravel()

        def approximately(vector: FloatArray) -> Any:
            out = np.empty_like(residual)
            approximate.precondition(vector.reshape(-1, 3), out)
            return out.ravel()

        # without a type SciPy asks for the product of a vector of small integers
        whole, inverse = (LinearOperator(shape, f, dtype=float) for f in (apply, approximately))
        right = -residual.ravel()
        solution, _ = gmres(whole, right, rtol=self.forcing, restart=30, maxiter=10, M=inverse)
        return np.asarray(solution).reshape(-1, 3)


def _length(vector: FloatArray) -> float:
    """Return the length of the longest row, µm."""
    return float(np.sqrt(np.square(vector).sum(axis=1)).max(initial=0.0))


METHODS = (BackwardEuler,)
