"""Outside references: the methods of ``scipy.integrate.solve_ivp``, stepped one by one.

``solve_ivp`` is a loop over the steps of these classes; the loop here is that of
:mod:`multicell.integrators.restarts`, which refuses a step that throws a cell away.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any, final

import numpy as np

from multicell.errors import SceneError
from multicell.integrators.base import ErrorControl, MethodInfo, Outcome, hold

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.integrators.restarts import IntegrationProgress, Taken
    from multicell.mechanics.system import Mechanics

_LEAST_RTOL = 100.0 * sys.float_info.epsilon  # SciPy raises smaller ones to this, with a warning

_INFOS = {
    "RK45": MethodInfo(
        "scipy-rk45",
        "outside reference: SciPy's RK45",
        order=5,
        colour="#8b8f94",
        marker="o",
    ),
    "DOP853": MethodInfo(
        "scipy-dop853",
        "outside reference: SciPy's DOP853",
        order=8,
        colour="#5c6166",
        marker="s",
    ),
    "LSODA": MethodInfo(
        "scipy-lsoda",
        "outside reference: SciPy's LSODA, up to 1000 cells",
        implicit=True,
        colour="#a78473",
        marker="^",
        friction=False,
        most_cells=1000,
        why_no_more="its Jacobian is a full matrix of 9 n² numbers",
    ),
    "Radau": MethodInfo(
        "scipy-radau",
        "outside reference: SciPy's Radau, up to 3000 cells",
        order=5,
        implicit=True,
        stable=math.inf,
        colour="#abb3b4",
        marker="D",
        friction=False,
        most_cells=3000,
        why_no_more="it factorises a real and a complex matrix with a growing fill",
    ),
    "BDF": MethodInfo(
        "scipy-bdf",
        "outside reference: SciPy's BDF, up to 6000 cells",
        implicit=True,
        stable=math.inf,
        colour="#685632",
        marker="v",
        friction=False,
        most_cells=6000,
        why_no_more="its factors would fill the memory",
    ),
}


@final
@dataclass(frozen=True)
class Scipy(ErrorControl):
    """A method of SciPy with its error control, and the analytic Jacobian where it takes one.

    - ``name``: of SciPy's class: ``"RK45"``, ``"DOP853"``, ``"LSODA"``, ``"Radau"`` or ``"BDF"``

    Raises SceneError for a relative tolerance below what SciPy carries.
    """

    atol: float = 0.01
    name: str = field(kw_only=True)

    @property
    def info(self) -> MethodInfo:
        """Information on the method."""
        return _INFOS[self.name]

    def __post_init__(self) -> None:
        ErrorControl.__post_init__(self)
        if self.rtol < _LEAST_RTOL:
            raise SceneError(
                "integrator.rtol",
                f"is {self.rtol:g}, must be at least {_LEAST_RTOL:.3g} for the methods of SciPy: "
                "double precision carries no more",
            )

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step of ``system``; see :class:`Integrator`.

        Raises SceneError if the method cannot hold the scene.
        """
        from multicell.integrators.restarts import IntegrationProgress

        hold(self.info, system)
        run = IntegrationProgress(self, system, position)
        return run.integrate(lambda run, ceiling: _Stepped(self, run, ceiling))


@final
class _Stepped:
    """A session of one of SciPy's solvers between two restarts."""

    def __init__(self, method: Scipy, run: IntegrationProgress, ceiling: float) -> None:
        from scipy import integrate

        self.run, self.system = run, run.system
        options: dict[str, Any] = {}
        if method.info.implicit:
            options["jac"] = self.full if method.name == "LSODA" else self.sparse
        self.factorised = 0
        self.solver = getattr(integrate, method.name)(
            self.velocity,
            0.0,
            run.position.ravel(),
            run.left,
            rtol=max(run.share * method.rtol, _LEAST_RTOL),
            atol=run.share * method.atol,
            max_step=ceiling or np.inf,
            **options,
        )

    def close(self) -> None:
        """Empty SciPy's solver, whose functions hold it and this object."""
        vars(self.solver).clear()

    def take_step(self) -> Taken:
        """Take one step; SciPy keeps its estimate of the error to itself."""
        from multicell.integrators.restarts import StepImpossible, Taken

        try:
            message = self.solver.step()
        except (RuntimeError, np.linalg.LinAlgError) as error:
            # SuperLU on a matrix that is singular to rounding
            raise StepImpossible(f"SciPy: {error}") from error
        self.system.work.factorisations += self.solver.nlu - self.factorised
        self.factorised = self.solver.nlu
        if self.solver.status == "failed":
            raise StepImpossible(f"SciPy: {message}")
        return Taken(float(self.solver.t), np.array(self.solver.y).reshape(-1, 3))

    def velocity(self, t: float, y: FloatArray) -> FloatArray:
        """Right-hand side."""
        out = np.empty_like(y)
        self.run.velocity(t, y, out)
        return out

    def sparse(self, t: float, y: FloatArray) -> Any:
        """Jacobian as a sparse matrix."""
        from multicell.mechanics.jacobian import sparse_jacobian

        self.system.linearise(self.run.clock(t), y.reshape(-1, 3))
        return sparse_jacobian(self.system)

    def full(self, t: float, y: FloatArray) -> FloatArray:
        """Jacobian as a full matrix."""
        return np.asarray(self.sparse(t, y).toarray())


METHODS = tuple(
    replace(
        info, control="tolerance", outside=True, atol=Scipy.atol, make=partial(Scipy, name=name)
    )
    for name, info in _INFOS.items()
)
