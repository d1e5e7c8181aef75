"""Multirate Euler, as proposed for centre-based models by Lötstedt & Mathias (2025).

P. Lötstedt, S. Mathias: Numerical integration of mechanical forces in center-based models for
biological cell populations. Applied Mathematics and Computation 486 (2025); preprint
https://doi.org/10.48550/arXiv.2206.00339.

There the local error of Euler's method, ½ Δt² J v, decides which equations take a long step and
which take short ones within it; slow cells stand still meanwhile, and the ratio of the steps is
given. Three things differ here. The estimate of an error is the difference of velocities that the
next step needs anyway, so that a step costs one evaluation of all cells and not two. Slow cells
move along a straight line meanwhile, so that a fast cell sees no error of order one in the long
step that its estimate knows nothing of. And the ratio and the bound between fast and slow are
those that cost least (see :mod:`multicell.integrators.loops.multirate`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, final

from multicell.integrators.base import ErrorControl, MethodInfo, Outcome

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.mechanics.system import Mechanics


@final
@dataclass(frozen=True)
class MultirateEuler(ErrorControl):
    """Euler under error control, with shorter steps for the cells that need them; order 1.

    In scenes whose evaluations go through Python (exact JKR, surface energies between types,
    friction, walls) all cells take the same steps: there it is ``euler-adaptive``. Parameters as
    for :class:`~multicell.integrators.base.ErrorControl`.
    """

    info: ClassVar[MethodInfo] = MethodInfo(
        "multirate-euler", "explicit Euler under error control, shorter steps for fast cells",
        "tolerance", order=1, colour="#6f9c3d", marker="d",
    )  # fmt: skip

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step of ``system``; see :class:`Integrator`."""
        from multicell.integrators import driver
        from multicell.integrators.loops.multirate import adaptive_multirate

        control = driver.control(self, system, 2.0, lower=1)
        return driver.adaptive(system, position, adaptive_multirate, control)[0]


METHODS = (MultirateEuler,)
