"""SUNDIALS CVODE with a direct solver: BDF, SuperLU_MT, the analytic sparse Jacobian.

scikit-sundae fixes the pattern of the matrix when a solver is made, and contacts change. The
pattern is that of a neighbour list with room for cells that come closer; when a pair touches
that has no place in it, a new solver is started, which begins again at first order.
"""

from __future__ import annotations

import ctypes
import math
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, final

import numpy as np

from multicell.integrators.base import ErrorControl, MethodInfo, Outcome, hold

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.integrators.restarts import Run
    from multicell.mechanics.system import Mechanics


@final
@dataclass(frozen=True)
class CvodeSparse(ErrorControl):
    """Variable-order, variable-step BDF with a direct sparse solver.

    - ``rtol``, ``atol``, ``max_steps``, ``max_displacement``, ``softening``: as for
      :class:`~multicell.integrators.cvode.Cvode`
    - ``margin``: room of the pattern: surfaces closer than this times the mean radius have a place
    """

    # the factors of a solid tissue fill up: 5000 cells need ten million entries and 1.7 s for each
    # factorisation, 1000 cells 0.06 s
    info: ClassVar[MethodInfo] = MethodInfo(
        "cvode-sparse", "implicit: SUNDIALS CVODE, BDF with a direct sparse solver (SuperLU_MT)",
        "tolerance", implicit=True, stable=math.inf, colour="#58b368", marker="s", friction=False,
        atol=0.01, most_cells=10_000, why_no_more="its factors would fill the memory",
    )  # fmt: skip

    softening: float = 0.5
    margin: float = 0.2

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step of ``system``; see :class:`Integrator`.

        Raises SceneError if there are too many cells, or friction between them.
        """
        from multicell.integrators.restarts import Run

        hold(self.info, system)
        run = Run(
            system, np.array(position), self.max_steps, self.max_displacement, self.atol, self.rtol,
            each_cell=True,
        )  # fmt: skip
        return run.integrate(lambda run, ceiling: _Direct(self, run, ceiling))


@final
class _Direct:
    """A CVODE session with one pattern."""

    def __init__(self, method: CvodeSparse, run: Run, ceiling: float) -> None:
        from sksundae.cvode import CVODE

        from multicell.integrators.restarts import Predictor
        from multicell.mechanics.jacobian import Pattern

        self.run, self.system, self.softening = run, run.system, method.softening
        self.pattern = Pattern.near(run.position, run.system, method.margin)
        self.lost = 0
        self._predictor = Predictor(run)
        with warnings.catch_warnings():
            # it warns that a pattern with a Jacobian is not used for difference quotients
            warnings.filterwarnings("ignore", message="Custom sparse Jacobian")
            self.solver = CVODE(
                self._predictor.velocity,
                method="BDF",
                rtol=run.share * method.rtol,
                atol=run.share * method.atol,
                max_step=ceiling,
                linsolver="sparse",
                sparsity=self.pattern.matrix(np.ones(len(self.pattern.index))),
                jacfn=self.jacobian,
            )
        # SUNDIALS frees what SuperLU_MT factorised without asking whether it ever did: to let go of
        # a solver that was stopped before its first Jacobian ends the process
        self._factorised = False
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(self.solver))
        self.solver.init_step(0.0, run.position.ravel())

    def step(self) -> tuple[float, FloatArray, float]:
        """Take one step."""
        from multicell.integrators.restarts import Restart, one_step

        if self.lost:
            raise Restart
        result = one_step(self.solver, self.run.left)
        error = self._predictor.error(result.t, result.y)
        return float(result.t), result.y.reshape(-1, 3).copy(), error

    def jacobian(self, t: float, y: FloatArray, yp: FloatArray, values: FloatArray) -> None:
        """Write the Jacobian's values in CSC order."""
        from multicell.mechanics.jacobian import limited

        self.system.linearise(self.run.clock(t), y.reshape(-1, 3))
        linear, _ = limited(self.system, self.softening)
        self.lost = self.pattern.fill(self.system, values, linear)
        if not self._factorised:
            self._factorised = True
            ctypes.pythonapi.Py_DecRef(ctypes.py_object(self.solver))


METHODS = (CvodeSparse,)
