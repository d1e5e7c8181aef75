"""Implicit integration by SUNDIALS CVODE: BDF or Adams, Newton, error control."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, final

from multicell.integrators.base import ErrorControl, MethodInfo, Outcome

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.integrators.cvode_solver import Krylov, UnpreconditionedCvode
    from multicell.integrators.restarts import IntegrationProgress
    from multicell.mechanics.system import Mechanics


@final
@dataclass(frozen=True)
class Cvode(ErrorControl):
    """Variable-order, variable-step BDF with a preconditioned Krylov method.

    - ``formula``: ``"BDF"`` or ``"Adams"``. Adams formulas are solved by the same Newton method.
    - ``light``: begin with difference quotients for products and no preconditioner, which costs
      least while steps are mild, and go over to the preconditioned method as soon as the
      evaluations of the last steps say that they are not. False for that from the start.
    - ``each_cell``: hold the tolerance for single cells. False for SUNDIALS's own norm, a mean over
      all coordinates, in which one cell among many may be wrong by many tolerances.
    - ``part``: part of the usual share of the tolerances (:func:`.limits.norm_share`) that SUNDIALS
      gets with ``each_cell``. With the whole share one step in twenty at 0.05 kPa s left a cell
      3 to 20 times as far off as a shift of its start by the tolerance; with a tenth one in 300
      did, for 1.2 to 1.3 times the cost (tests/benchmarks/worst_cell.py)
    """

    info: ClassVar[MethodInfo] = MethodInfo(
        "cvode",
        "implicit: SUNDIALS CVODE, BDF with Newton-Krylov",
        "tolerance",
        implicit=True,
        stable=math.inf,
        colour="#1f7f54",
        marker="o",
        atol=0.01,
        meant=("bdf", "ode15s", "sundials"),
        source="hindmarsh2005",
    )

    atol: float = info.atol
    formula: str = "BDF"
    light: bool = True
    each_cell: bool = True
    part: float = 0.1

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step of ``system``; see :class:`Integrator`."""
        from multicell.integrators.cvode_solver import Krylov, UnpreconditionedCvode
        from multicell.integrators.restarts import IntegrationProgress

        run = IntegrationProgress(self, system, position, each_cell=self.each_cell, part=self.part)
        mild = self.light

        def start(run: IntegrationProgress, ceiling: float) -> Krylov | UnpreconditionedCvode:
            nonlocal mild
            # a ceiling comes with a refusal: nothing mild about that
            mild = mild and ceiling == 0.0 and run.steps == 0
            if mild:
                session = UnpreconditionedCvode(self, run)
                if not session.begins_slowly():
                    return session
                session.close()
                mild = False
            return Krylov(self, run, ceiling)

        return run.integrate(start)


@final
@dataclass(frozen=True)
class CvodeAdams(ErrorControl):
    """Adams formulas up to order 12, solved by the Newton-Krylov method of :class:`Cvode`.

    Not safe for single cells: in one of 40 coupling steps at 0.5 kPa s a cell was six times as far
    off as a shift of its start by the tolerance moves it (docs/theory/integrators.md).

    There is no functional iteration in scikit-sundae: this is an implicit method, and not an
    explicit one to compare with.
    """

    info: ClassVar[MethodInfo] = MethodInfo(
        "cvode-adams",
        "implicit: SUNDIALS CVODE, Adams formulas, solved by the same Newton-Krylov",
        "tolerance",
        implicit=True,
        stable=math.inf,
        colour="#a3c644",
        marker="D",
        atol=0.01,
        source="hindmarsh2005",
    )

    atol: float = info.atol

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step of ``system``; see :class:`Integrator`."""
        options = self.rtol, self.atol, self.max_steps, self.max_displacement
        return Cvode(*options, formula="Adams").integrate(system, position)


METHODS = (Cvode, CvodeAdams)
