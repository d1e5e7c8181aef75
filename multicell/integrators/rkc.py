"""Stabilised explicit Runge-Kutta: RKC2 of Sommeijer, Shampine & Verwer (1998)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, ClassVar, final

import numpy as np

from multicell.integrators.base import ErrorControl, MethodInfo, Outcome

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.mechanics.system import Mechanics

_MAX_STAGES = 200  # under error control: a step that needs more is taken shorter
_MAX_FIXED_STAGES = 5000  # β(s) grows as s²: 5000 stages hold λΔt of 1.6e7


@final
@dataclass(frozen=True)
class Rkc2(ErrorControl):
    """Stabilised Runge-Kutta of order 2 with s stages, stable for Δt < 0.65 s²/λ_max.

    Under error control unless ``step`` is given. See :mod:`multicell.integrators.loops.chebyshev`.

    - ``step``: fixed step, s, for studies of order and stability; zero for error control
    - ``stages``: fixed number of stages, 2 or more, only with ``step``; zero for as many as the
      stiffness asks for

    Raises ValueError for a number of stages that there is no method of, or one without ``step``;
    for tolerances that are not positive.
    """

    info: ClassVar[MethodInfo]

    step: float = 0.0
    stages: int = 0

    def __post_init__(self) -> None:
        ErrorControl.__post_init__(self)
        if self.stages and (self.stages < 2 or self.step <= 0.0):
            raise ValueError(f"stages is {self.stages}, must be 2 or more and go with a step")

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step of ``system``; see :class:`Integrator`."""
        from multicell.integrators import driver
        from multicell.integrators.loops import chebyshev

        if self.step > 0.0:
            return driver.run_equal_steps(
                system, position, chebyshev.fixed_chebyshev, self, self.stages, _MAX_FIXED_STAGES
            )
        control = driver.control(self, system, 3.0, lower=2)
        # s² times the rounding of a stage must stay below the tolerance
        finest = control.strictness / math.sqrt(10.0 * np.finfo(float).eps)
        most = int(min(_MAX_STAGES, max(2.0, finest)))
        loop = chebyshev.adaptive_chebyshev
        return driver.adaptive(system, position, loop, control, most, watched=True)


def _of_stages(stages: int) -> MethodInfo | None:
    """Return the information on the method with a fixed step and number of stages."""
    if not 2 <= stages <= _MAX_STAGES:
        return None
    from multicell.integrators.loops.chebyshev import stable_length

    return MethodInfo(
        f"rkc2-{stages}",
        f"Runge-Kutta-Chebyshev of {stages} stages with a fixed step",
        "step",
        order=2,
        stable=float(stable_length(stages)),
        make=partial(Rkc2, stages=stages),
    )


Rkc2.info = MethodInfo(
    "rkc2",
    "explicit, stabilised: Runge-Kutta-Chebyshev of order 2 under error control",
    "tolerance",
    order=2,
    colour="#e8590c",
    marker="X",
    variant=_of_stages,
    source="sommeijer1998",
)
METHODS = (Rkc2,)
