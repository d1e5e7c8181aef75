"""Implicit integration by SUNDIALS CVODE: BDF, Newton–Krylov, error control.

scikit-sundae hands every callback read-only views of the solver's memory, and counts only
part of the evaluations; the counts that are reported are those of :class:`Mechanics`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

import numpy as np
from sksundae.cvode import CVODE, CVODEJacTimes, CVODEPrecond

from multicell.integrators.base import FloatArray, Outcome, furthest
from multicell.mechanics import Mechanics, StateRejected

_MOST_REFUSALS = 12


@final
@dataclass(frozen=True)
class Cvode:
    """Variable-order, variable-step BDF with GMRES and block-Jacobi preconditioning.

    The Jacobian–vector product is analytic and refreshed at every linear solve;
    preconditioning is on the right, so that the Krylov method measures the true residual.

    Parameters
    ----------
    rtol, atol
        Relative tolerance, and absolute tolerance in µm.
    max_steps
        Largest number of internal steps in a coupling step.
    max_displacement
        Fraction of its radius that a cell may move in one accepted step. A step that
        moves a cell further is refused and tried again with a quarter of the step.
    krylov_dim
        Dimension of the Krylov space.
    """

    rtol: float = 1e-6
    atol: float = 1e-2
    max_steps: int = 10_000
    max_displacement: float = 0.5
    krylov_dim: int = 5

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step of ``system``; see :class:`Integrator`."""
        motion = system.motion
        run = _Run(system, np.array(position))
        for _ in range(_MOST_REFUSALS):
            try:
                self._advance(run)
            except _Refused as refusal:
                system.work.rejections += 1
                run.ceiling = 0.25 * (refusal.step or motion.end - motion.begin)
                run.problem, run.cell = str(refusal), refusal.cell
                continue
            break
        time = motion.begin + run.elapsed
        return Outcome(time, run.position, run.problem, run.hint, run.cell)

    def _advance(self, run: _Run) -> None:
        """Step until the end, or until something is wrong; raise ``_Refused`` to try again."""
        system, length = run.system, run.length
        solver = CVODE(run.velocity, **self._options(run))
        solver.init_step(0.0, np.zeros(0) if run.position.size == 0 else run.position.ravel())
        begun = run.elapsed
        run.offset = begun
        while run.elapsed < length:
            try:
                result = solver.step(length - begun, method="onestep", tstop=length - begun)
            except StateRejected as error:
                raise _Refused(str(error), run.latest - (run.elapsed - begun)) from error
            if not result.success:
                raise _Refused(f"SUNDIALS: {result.message}", run.latest - (run.elapsed - begun))
            moved_to = result.y.reshape(-1, 3)
            step = begun + result.t - run.elapsed
            cell, moved = furthest(run.position, moved_to, system.motion.radius)
            if moved > self.max_displacement:
                raise _Refused(
                    f"a step of {step:.3g} s would move the cell by {moved:.3g} of its radius "
                    f"(allowed: {self.max_displacement:g})", step, cell,
                )  # fmt: skip
            run.accept(moved_to.copy(), length if result.t >= length - begun else begun + result.t)
            if run.steps >= self.max_steps and run.elapsed < length:
                run.give_up(f"{run.steps} internal steps did not reach the end", cell)
                return
        run.problem = ""

    def _options(self, run: _Run) -> dict[str, Any]:
        return {
            "method": "BDF",
            "rtol": self.rtol,
            "atol": self.atol,
            "max_step": run.ceiling,
            "linsolver": "gmres",
            "krylov_dim": self.krylov_dim,
            "jactimes": CVODEJacTimes(run.linearise, run.product),
            "precond": CVODEPrecond(run.setup, run.solve, side="right"),
        }


class _Refused(Exception):  # noqa: N818 - control flow inside this module
    """A step that must not be taken; ``step`` is its length in s, where it is known."""

    def __init__(self, problem: str, step: float, cell: int | None = None) -> None:
        super().__init__(problem)
        self.step = max(step, 0.0)
        self.cell = cell


@final
class _Run:
    """One integration under way: the last accepted state, and the callbacks of CVODE.

    CVODE's time counts from the last restart: a step of 1e-10 s is lost on a clock that
    shows days.
    """

    def __init__(self, system: Mechanics, position: FloatArray) -> None:
        self.system = system
        self.position = position
        self.length = system.motion.end - system.motion.begin
        self.elapsed = 0.0
        self.offset = 0.0
        self.latest = 0.0
        self.ceiling = 0.0
        self.steps = 0
        self.problem = ""
        self.hint = "Choose a shorter coupling_step or a tighter integrator.atol"
        self.cell: int | None = None

    def accept(self, position: FloatArray, elapsed: float) -> None:
        """Take a step."""
        self.position, self.elapsed = position, elapsed
        self.steps += 1
        self.system.work.steps += 1

    def give_up(self, problem: str, cell: int) -> None:
        """End with the number of steps used up."""
        self.problem, self.cell = problem, cell
        self.hint = "Raise integrator.max_steps, loosen integrator.atol or shorten coupling_step"

    def velocity(self, t: float, y: FloatArray, yp: FloatArray) -> None:
        """Right-hand side."""
        self.latest = t
        self.system.velocity(self._clock(t), y.reshape(-1, 3), yp.reshape(-1, 3))

    def linearise(self, t: float, y: FloatArray, yp: FloatArray) -> None:
        """Fresh Jacobian before every linear solve."""
        self.system.linearise(self._clock(t), y.reshape(-1, 3))

    def product(
        self, t: float, y: FloatArray, yp: FloatArray, v: FloatArray, jv: FloatArray
    ) -> None:
        """Jacobian times vector."""
        self.system.jacobian_product(v.reshape(-1, 3), jv.reshape(-1, 3))

    def setup(
        self, t: float, y: FloatArray, yp: FloatArray, jok: int, jnew: list[int], gamma: float
    ) -> None:
        """Preconditioner for a new γ; its Jacobian is always refreshed (it costs one RHS)."""
        self.system.linearise(self._clock(t), y.reshape(-1, 3))
        self.system.setup_preconditioner(gamma)
        jnew[0] = 1

    def solve(
        self, t: float, y: FloatArray, yp: FloatArray, r: FloatArray, z: FloatArray,
        gamma: float, delta: float, lr: int,
    ) -> None:  # fmt: skip
        """Apply the preconditioner."""
        self.system.precondition(r.reshape(-1, 3), z.reshape(-1, 3))

    def _clock(self, t: float) -> float:
        return self.system.motion.begin + self.offset + t
