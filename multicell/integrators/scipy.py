"""Outside references: the methods of ``scipy.integrate.solve_ivp``, stepped one by one.

``solve_ivp`` is a loop over the steps of these classes; the loop here is that of
:mod:`multicell.integrators.restarts`, which refuses a step that throws a cell away.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from multicell.cells import FloatArray
from multicell.errors import SceneError
from multicell.integrators.base import Outcome
from multicell.integrators.cvode_sparse import holds
from multicell.integrators.restarts import Run, StepImpossible
from multicell.mechanics.jacobian import sparse_jacobian
from multicell.mechanics.system import Mechanics

_LEAST_RTOL = 100.0 * sys.float_info.epsilon

_CLASSES = {"rk45": "RK45", "dop853": "DOP853", "lsoda": "LSODA", "radau": "Radau", "bdf": "BDF"}
_LIMITS = {
    "lsoda": (1000, "its Jacobian is a full matrix of 9 n² numbers"),
    "radau": (3000, "it factorises a real and a complex matrix with a growing fill"),
    "bdf": (6000, "its factors would fill the memory"),
}
"""Method -> most cells that it holds, and why no more; the explicit ones hold any number."""


@final
@dataclass(frozen=True)
class Scipy:
    """A method of SciPy with its error control, and the analytic Jacobian where it takes one.

    Parameters
    ----------
    name
        ``"rk45"``, ``"dop853"``, ``"lsoda"``, ``"radau"`` or ``"bdf"``.
    rtol, atol, max_steps, max_displacement
        As for :class:`~multicell.integrators.cvode.Cvode`.

    Raises
    ------
    SceneError
        For a relative tolerance below what SciPy carries.
    """

    name: str
    rtol: float = 1e-6
    atol: float = 1e-2
    max_steps: int = 10_000
    max_displacement: float = 0.5

    def __post_init__(self) -> None:
        if self.rtol < _LEAST_RTOL:
            raise SceneError(
                "integrator.rtol",
                f"is {self.rtol:g}, must be at least {_LEAST_RTOL:.3g} for the methods of SciPy: "
                "double precision carries no more",
            )

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step of ``system``; see :class:`Integrator`.

        Raises
        ------
        SceneError
            If the method cannot hold the scene.
        """
        if self.name in _LIMITS:
            holds(system, f"scipy-{self.name}", *_LIMITS[self.name])
        run = Run(system, np.array(position), self.max_steps, self.max_displacement, self.atol)
        return run.integrate(lambda run, ceiling: _Stepped(self, run, ceiling))


@final
class _Stepped:
    """One life of a solver of SciPy."""

    def __init__(self, method: Scipy, run: Run, ceiling: float) -> None:
        from scipy import integrate

        self.run, self.system = run, run.system
        jacobian = {"lsoda": self.full, "radau": self.sparse, "bdf": self.sparse}
        options: dict[str, Any] = {}
        if method.name in jacobian:
            options["jac"] = jacobian[method.name]
        self.factorised = 0
        self.solver = getattr(integrate, _CLASSES[method.name])(
            self.velocity, 0.0, run.position.ravel(), run.left,
            rtol=method.rtol, atol=method.atol, max_step=ceiling or np.inf, **options,
        )  # fmt: skip

    def step(self) -> tuple[float, FloatArray, float]:
        """Take one step; SciPy keeps its estimate of the error to itself."""
        try:
            message = self.solver.step()
        except (RuntimeError, np.linalg.LinAlgError) as error:
            # SuperLU on a matrix that is singular to rounding
            raise StepImpossible(f"SciPy: {error}") from error
        self.system.work.factorisations += self.solver.nlu - self.factorised
        self.factorised = self.solver.nlu
        if self.solver.status == "failed":
            raise StepImpossible(f"SciPy: {message}")
        return float(self.solver.t), np.array(self.solver.y).reshape(-1, 3), math.nan

    def velocity(self, t: float, y: FloatArray) -> FloatArray:
        """Right-hand side."""
        out = np.empty_like(y)
        self.run.velocity(t, y, out)
        return out

    def sparse(self, t: float, y: FloatArray) -> Any:
        """Jacobian as a sparse matrix."""
        self.system.linearise(self.run.clock(t), y.reshape(-1, 3))
        return sparse_jacobian(self.system)

    def full(self, t: float, y: FloatArray) -> FloatArray:
        """Jacobian as a full matrix."""
        return np.asarray(self.sparse(t, y).toarray())
