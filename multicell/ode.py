"""The equations of one coupling step for any outside solver."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np

from multicell.errors import SceneError
from multicell.runner import integrated_by
from multicell.scene.scene import load_scene
from multicell.simulation import Simulation

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.integrators.base import Integrator
    from multicell.mechanics.system import Mechanics
    from multicell.scene.scene import Scene


@final
@dataclass(frozen=True, eq=False)
class OdeProblem:
    """dy/dt = f(t, y) from t0 to t1: the motion of all cells in one coupling step.

    y holds the coordinates of the cells one after the other, y[3 i + a] the component a of cell i
    in µm. Radii, receptors and external forces change linearly in time between t0 and t1.

    Evaluations raise :class:`~multicell.mechanics.motion.StateRejected` at states that are not
    finite, or with thousands of cells in one place. Cells whose motion is prescribed are no
    unknowns: they stand still in y, and ``system.at_end(y)`` puts them where they are at t1.

    Attributes
    ----------
    y0 : (3 n,) float64, µm
        Positions at the beginning.
    t0, t1 : float, s
        Beginning and end.
    system : Mechanics
        Made ready for the coupling step; it counts its evaluations in ``system.work``.
    """

    y0: FloatArray
    t0: float
    t1: float
    system: Mechanics

    def f(self, t: float, y: FloatArray) -> FloatArray:
        """Return dy/dt, (3 n,) µm/s."""
        out = np.empty((len(self.system), 3))
        self.system.velocity(t, _cells(y), out)
        return out.ravel()

    def jv(self, t: float, y: FloatArray, v: FloatArray) -> FloatArray:
        """Return the product of J = ∂f/∂y at (t, y) with v, (3 n,) µm/s."""
        self.system.linearise(t, _cells(y))
        out = np.empty((len(self.system), 3))
        self.system.jacobian_product(_cells(v), out)
        return out.ravel()

    def jacobian(self, t: float, y: FloatArray) -> Any:
        """Return J = ∂f/∂y at (t, y) as a ``scipy.sparse.csc_matrix`` (3 n, 3 n), 1/s.

        Raises
        ------
        SceneError
            With friction between cells or a gel, which make J a full matrix.
        """
        from multicell.mechanics.jacobian import sparse_jacobian

        self._refuse_full()
        self.system.linearise(t, _cells(y))
        return sparse_jacobian(self.system)

    def sparsity(self, margin: float = 0.2) -> Any:
        """Return which entries of J may differ from zero, as a ``csc_matrix`` of ones (3 n, 3 n).

        Parameters
        ----------
        margin
            Surfaces closer than this times the mean radius at the beginning have a place. Cells
            that come from further away within the coupling step have none.

        Raises
        ------
        SceneError
            With friction between cells or a gel, which make J a full matrix.
        """
        from multicell.mechanics.jacobian import sparsity

        self._refuse_full()
        return sparsity(_cells(self.y0), self.system, margin)

    def _refuse_full(self) -> None:
        if max(self.system.friction) > 0.0:
            raise SceneError("friction", "makes the Jacobian a full matrix", "Use jv instead.")
        if getattr(self.system.walls, "shear", None) is not None:
            problem = "makes the Jacobian a full matrix: the gel couples all cells that it touches"
            raise SceneError("domain.stiffness", problem, "Use jv instead.")


def ode_problem(
    scene: Scene | str | Path,
    step: int = 0,
    *,
    integrator: str | type[Integrator] | Integrator | None = None,
    threads: int | None = None,
) -> OdeProblem:
    """Return the equations of a coupling step of a scene, for any outside solver.

    The scene is simulated up to the beginning of that step.

    >>> problem = mc.ode_problem(scene, step=120)                   # doctest: +SKIP
    >>> solve_ivp(problem.f, (problem.t0, problem.t1), problem.y0)  # doctest: +SKIP

    Parameters
    ----------
    scene
        What to simulate: a scene, the name of a built-in one, or the path of a TOML file.
    step
        Number of coupling steps before the one that is wanted.
    integrator
        Which method takes them, as for :func:`multicell.run`; by default the scene's.
    threads
        Number of threads, by default all.

    Raises
    ------
    SceneError
        If the run ends before that step, or there are no cells then.
    StepFailed
        If a step before cannot be solved.
    """
    if isinstance(step, bool) or not isinstance(step, int) or step < 0:
        raise SceneError("step", f"is {step!r}, must be a whole number from 0 on")
    described = load_scene(scene) if isinstance(scene, str | Path) else scene
    described, own = integrated_by(described, integrator)
    simulation = Simulation(described, threads=threads, integrator=own)
    while simulation.step_index < step and not simulation.finished:
        simulation.step()
    if simulation.finished:
        problem = f"is {step}, but the run ends after {simulation.step_index} coupling steps"
        raise SceneError("step", problem, "Steps count from 0.")
    if len(simulation.cells) == 0:
        raise SceneError("step", f"is {step}, but no cells are left then")
    system = simulation.prepared()
    motion = system.motion
    return OdeProblem(np.array(simulation.cells.position).ravel(), motion.begin, motion.end, system)


def _cells(y: FloatArray) -> FloatArray:
    return np.ascontiguousarray(y, dtype=float).reshape(-1, 3)
