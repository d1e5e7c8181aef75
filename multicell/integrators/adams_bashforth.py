"""Adams-Bashforth of order 2, with a fixed step and under error control."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, final

from multicell.integrators.base import EqualSteps, ErrorControl, MethodInfo, Outcome

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.mechanics.system import Mechanics


@final
@dataclass(frozen=True)
class AdamsBashforth2(EqualSteps):
    """Two steps back, order 2, one evaluation a step, stable for Δt < 1/λ_max.

    The first step of each coupling step is Heun's.
    """

    info: ClassVar[MethodInfo] = MethodInfo(
        "ab2",
        "explicit Adams-Bashforth of order 2 with a fixed step",
        "step",
        order=2,
        stable=1.0,
        remembers=True,
        colour="#957bd2",
        marker="D",
    )

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step of ``system``; see :class:`Integrator`."""
        from multicell.integrators import driver
        from multicell.integrators.loops.adams_bashforth import fixed_adams

        return driver.run_equal_steps(system, position, fixed_adams, self)


@final
@dataclass(frozen=True)
class AdaptiveAdams(ErrorControl):
    """Adams-Bashforth of order 2 under error control, one evaluation a step; to 1/λ_max.

    - ``patience``: largest number of evaluations that a coupling step may be expected to take;
      beyond, the integration ends early, with ``problem`` set. Zero for any number.
    """

    info: ClassVar[MethodInfo] = MethodInfo(
        "ab2-adaptive",
        "explicit Adams-Bashforth of order 2 under error control",
        "tolerance",
        order=2,
        remembers=True,
        colour="#d4a8d6",
        marker="p",
        meant=("adams", "adams-bashforth"),
    )

    patience: int = 0

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step of ``system``; see :class:`Integrator`."""
        from multicell.integrators import driver
        from multicell.integrators.loops.adams_bashforth import adaptive_adams

        control = driver.control(self, system, 3.0, lower=2)
        return driver.adaptive(
            system, position, adaptive_adams, control, self.patience, passes=True
        )


METHODS = (AdamsBashforth2, AdaptiveAdams)
