"""Implicit integration in single steps: a Rosenbrock method of order 2 under error control.

The method of Shampine & Reichelt (1997) with γ = 1 - 1/√2, which keeps nothing from step to step,
so that a coupling step begins without start-up at low order. With W = I - γΔt A and the velocity v:

    W k₁ = v(t, x) + γΔt ∂v/∂t,
    W (k₂ - k₁) = v(t + Δt/2, x + Δt k₁/2) - k₁,      x' = x + Δt k₂,
    W k₃ = v(t + Δt, x') - (6 + √2) (k₂ - v(t + Δt/2, ·)) - 2 (k₁ - v(t, x)) + γΔt ∂v/∂t,

and the estimated error Δt (k₁ - 2 k₂ + k₃) / 6, of third order and bounded for stiff modes. It is
L-stable for A = J, and of order 2 for every A.

**What grows.** An implicit step damps a mode with eigenvalue μ > 0 once γΔtμ > 1, and no error
estimate sees it. So A is J without JKR's slopes below -``softening`` E_ij r_ij, whose snap enters
explicitly by the factor 1 + z + z²/2, and no step is tried with Δtμ > ``growth`` as far as
conjugate gradients see: by the Rayleigh quotient of each search direction, and by five iterations
every few steps from what was found slowest last. docs/theory/integrators.md measures it.

References
----------
L. F. Shampine, M. W. Reichelt, "The MATLAB ODE Suite", SIAM J. Sci. Comput. 18 (1997) 1-22,
https://doi.org/10.1137/S1064827594276424
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, final

import numpy as np

from multicell.integrators.base import ErrorControl, MethodInfo, Outcome, hold

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.mechanics.system import Mechanics

_MAX_GROWTH = 3.0  # most that a step may grow over the one before


@final
@dataclass(frozen=True)
class Rosenbrock(ErrorControl):
    """Rosenbrock method of order 2 with preconditioned conjugate gradients.

    - ``worst``: error that a step may have in the worst cell, in tolerances times √θ, where θ is
      the tolerance in mean radii (see :mod:`multicell.integrators.driver`): 1.1 tolerances at 0.01
      µm, and up to four times as much with many steps to go. A root mean square over thousands of
      cells does not show a single one that goes astray.
    - ``sharp``: factor of the second estimate of an error, Δt (v' - v - A(x' - x) - Δt ∂v/∂t).
      The method's own one is smoothed by W⁻¹: a contact that forms within a long step moved cells
      up to 39 times as far as it showed. With 0.2 a cell at 0.01 kPa s was still off by 14 times
      what a shift of its start by the tolerance of 0.1 µm does, with 0.5 by less than that shift
    - ``growth``: largest product of a step and an eigenvalue of the matrix, above which steps are
      refused; at most 3, beyond 3.4 modes that grow would be damped
    - ``softening``: the matrix shows no dF/dh below minus this times E_ij r_ij; the order does not
      depend on it

    Raises ValueError for a ``growth`` out of its range, or tolerances that are not positive.
    """

    info: ClassVar[MethodInfo] = MethodInfo(
        "rosenbrock",
        "implicit, one step: Rosenbrock method of order 2, conjugate gradients",
        "tolerance",
        order=2,
        implicit=True,
        stable=math.inf,
        colour="#2e1cd2",
        marker="d",
        friction=False,
        atol=0.01,
        source="shampine1997",
    )

    atol: float = info.atol
    worst: float = 25.0
    sharp: float = 0.5
    growth: float = 0.5
    softening: float = 1.0

    def __post_init__(self) -> None:
        ErrorControl.__post_init__(self)
        if not 0.0 < self.growth <= _MAX_GROWTH:
            raise ValueError(f"growth is {self.growth}, must be above 0 and at most {_MAX_GROWTH}")

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step of ``system``; see :class:`Integrator`."""
        from multicell.integrators.limits import find_failure
        from multicell.integrators.rosenbrock_solver import Walk

        hold(self.info, system)
        if len(system) == 0 or system.motion.end <= system.motion.begin:
            return Outcome(system.motion.end, np.array(position))
        refused = find_failure(system, position, self.atol)
        if refused is not None:
            return refused
        return Walk(self, system, np.array(position)).integrate()


METHODS = (Rosenbrock,)
