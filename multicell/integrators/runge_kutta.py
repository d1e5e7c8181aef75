"""Explicit Runge-Kutta methods, with a fixed step and under error control.

See :mod:`multicell.integrators.driver` for what all explicit methods have in common.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from multicell.integrators.base import EqualSteps, ErrorControl, MethodInfo, Outcome

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.mechanics.system import Mechanics


class Tableau(NamedTuple):
    """An explicit Runge-Kutta method.

    - ``a``, (s, s): stage i is at x + h Σ_j a_ij k_j, below the diagonal
    - ``b``, (s,): weights of the result
    - ``c``, (s,): times of the stages, in steps
    - ``error``, (s,): weights of the estimated error; no entries where there is no estimate.
      Methods with one must be "first same as last": the last stage is at the result.
    """

    a: NDArray[np.float64]
    b: NDArray[np.float64]
    c: NDArray[np.float64]
    error: NDArray[np.float64]


def _tableau(rows: list[list[float]], b: list[float], error: list[float] | None = None) -> Tableau:
    """Return the arrays of a method; the stages' times are the sums of their rows."""
    a = np.zeros((len(b), len(b)))
    for i, row in enumerate(rows, start=1):
        a[i, : len(row)] = row
    return Tableau(a, np.array(b), a.sum(axis=1), np.array(error or [], dtype=float))


EULER = _tableau([], [1.0])
HEUN = _tableau([[1.0]], [0.5, 0.5])
RUNGE_KUTTA_4 = _tableau([[0.5], [0.0, 0.5], [0.0, 0.0, 1.0]], [1 / 6, 1 / 3, 1 / 3, 1 / 6])

EULER_HEUN = _tableau([[1.0]], [1.0, 0.0], [0.5, -0.5])
"""Euler, with its distance from Heun as the estimate: no evaluation more than Euler."""

RUNGE_KUTTA_4_3 = _tableau(
    [[0.5], [0.0, 0.5], [0.0, 0.0, 1.0], [1 / 6, 1 / 3, 1 / 3, 1 / 6]],
    [1 / 6, 1 / 3, 1 / 3, 1 / 6, 0.0],
    [0.0, 0.0, 0.0, 0.1, -0.1],
)
"""The classical method with the estimate of order 3 of Dormand & Prince 1978 (Balac & Mahé 2013):
the slope at the result, which the next step begins with, stands for a part of the fourth one's."""

DORMAND_PRINCE = _tableau(
    [
        [1 / 5],
        [3 / 40, 9 / 40],
        [44 / 45, -56 / 15, 32 / 9],
        [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729],
        [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656],
        [35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
    ],
    [35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84, 0.0],
    [71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40],
)
"""Dormand & Prince 1980, order 5 with an estimate of order 4."""


class _Fixed(EqualSteps):
    """A method with a fixed step; abstract."""

    tableau: ClassVar[Tableau]

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step of ``system``; see :class:`Integrator`."""
        from multicell.integrators import driver
        from multicell.integrators.loops.runge_kutta import fixed_runge_kutta

        return driver.run_equal_steps(system, position, fixed_runge_kutta, self, self.tableau)


class _Adaptive(ErrorControl):
    """An embedded pair; abstract.

    ``estimate`` is the exponent of the step in the estimated error, ``lower`` the order of the
    result where it is below that of the estimate.
    """

    tableau: ClassVar[Tableau]
    estimate: ClassVar[float]
    lower: ClassVar[int] = 0

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step of ``system``; see :class:`Integrator`."""
        from multicell.integrators import driver
        from multicell.integrators.loops.runge_kutta import adaptive_runge_kutta

        control = driver.control(self, system, self.estimate, self.lower)
        return driver.adaptive(system, position, adaptive_runge_kutta, control, self.tableau)


@final
@dataclass(frozen=True)
class Euler(_Fixed):
    """x ← x + Δt v(t, x), order 1, stable for Δt < 2/λ_max; parameters as :class:`EqualSteps`."""

    info: ClassVar[MethodInfo] = MethodInfo(
        "euler",
        "explicit Euler with a fixed step",
        "step",
        order=1,
        stable=2.0,
        colour="#2f6fb0",
        marker="o",
        meant=("forward-euler", "explicit-euler"),
    )
    tableau: ClassVar[Tableau] = EULER


@final
@dataclass(frozen=True)
class Heun(_Fixed):
    """Heun's method, order 2, stable for Δt < 2/λ_max; parameters as :class:`EqualSteps`."""

    info: ClassVar[MethodInfo] = MethodInfo(
        "heun",
        "explicit Runge-Kutta of order 2 with a fixed step",
        "step",
        order=2,
        stable=2.0,
        colour="#4b3a8e",
        marker="^",
    )
    tableau: ClassVar[Tableau] = HEUN


@final
@dataclass(frozen=True)
class RungeKutta4(_Fixed):
    """The classical method, order 4, stable for Δt < 2.785/λ_max; as :class:`EqualSteps`."""

    info: ClassVar[MethodInfo] = MethodInfo(
        "rk4",
        "explicit Runge-Kutta of order 4 with a fixed step",
        "step",
        order=4,
        stable=2.785,
        colour="#943180",
        marker="v",
    )
    tableau: ClassVar[Tableau] = RUNGE_KUTTA_4


@final
@dataclass(frozen=True)
class AdaptiveEuler(_Adaptive):
    """Euler under error control, its distance from Heun's result being the estimate."""

    info: ClassVar[MethodInfo] = MethodInfo(
        "euler-adaptive",
        "explicit Euler under error control",
        "tolerance",
        order=1,
        colour="#74b0e4",
        marker="s",
    )
    tableau: ClassVar[Tableau] = EULER_HEUN
    estimate: ClassVar[float] = 2.0
    lower: ClassVar[int] = 1


@final
@dataclass(frozen=True)
class AdaptiveRungeKutta4(_Adaptive):
    """The classical method of order 4 with an estimate of order 3; stable to 2.785/λ_max.

    With ``atol`` as large as a cell ``max_displacement`` alone chooses the steps, as in Osborne
    (2024).
    """

    info: ClassVar[MethodInfo] = MethodInfo(
        "rk4-adaptive",
        "explicit Runge-Kutta of order 4 under error control",
        "tolerance",
        order=4,
        colour="#d6c400",
        marker=">",
        atol=0.01,
    )
    atol: float = info.atol
    tableau: ClassVar[Tableau] = RUNGE_KUTTA_4_3
    estimate: ClassVar[float] = 4.0


@final
@dataclass(frozen=True)
class Dopri5(_Adaptive):
    """Dormand & Prince's pair of orders 5 and 4, the higher one propagated; stable to 3.3/λ_max.

    Not safe for single cells where contacts form and break (docs/theory/integrators.md).
    """

    info: ClassVar[MethodInfo] = MethodInfo(
        "dopri5",
        "explicit Runge-Kutta of Dormand and Prince, order 5, under error control",
        "tolerance",
        order=5,
        colour="#14919b",
        marker="P",
        atol=0.01,
        meant=("ode45", "rk45", "dormand-prince"),
    )
    atol: float = info.atol
    tableau: ClassVar[Tableau] = DORMAND_PRINCE
    estimate: ClassVar[float] = 5.0


@final
@dataclass(frozen=True)
class MultirateEuler(ErrorControl):
    """Euler under error control, with shorter steps for the cells that need them; order 1.

    As proposed for centre-based models by Lötstedt & Mathias, where the local error of Euler's
    method, ½ Δt² J v, decides which equations take a long step and which take short ones within
    it. Three things differ here. The estimate is the difference of velocities that the next step
    needs anyway: a step costs one evaluation of all cells and not two. Slow cells move along a
    straight line meanwhile and do not stand still, so that a fast cell sees no error of order one
    that its estimate knows nothing of. And the ratio of the steps, there given, and the bound
    between fast and slow are those that cost least
    (:mod:`multicell.integrators.loops.multirate`).

    In scenes whose evaluations go through Python (exact JKR, surface energies between types,
    friction, walls) all cells take the same steps: there it is ``euler-adaptive``.

    P. Lötstedt, S. Mathias: Numerical integration of mechanical forces in center-based models for
    biological cell populations. Applied Mathematics and Computation 486 (2025); preprint
    https://doi.org/10.48550/arXiv.2206.00339.
    """

    info: ClassVar[MethodInfo] = MethodInfo(
        "multirate-euler",
        "explicit Euler under error control, shorter steps for fast cells",
        "tolerance",
        order=1,
        colour="#6f9c3d",
        marker="d",
    )

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step of ``system``; see :class:`Integrator`."""
        from multicell.integrators import driver
        from multicell.integrators.loops.multirate import adaptive_multirate

        control = driver.control(self, system, 2.0, lower=1)
        return driver.adaptive(system, position, adaptive_multirate, control, parts=True)


METHODS = (Euler, AdaptiveEuler, Heun, RungeKutta4, AdaptiveRungeKutta4, Dopri5, MultirateEuler)
