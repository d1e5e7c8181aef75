"""Methods that solve the equations of networks, as tables of coefficients.

Rosenbrock methods are in the form without products of the Jacobian with vectors,

    (I / (γh) - J) k_i = f(t + α_i h, y + Σ a_ij k_j) + Σ c_ij k_j / h + γ_i h ∂f/∂t.

All are stiffly accurate: the last of s stages begins at the result of the embedded method, and so

    y' = y + Σ a_sj k_j + k_s,   error = k_s.

References
----------
- E. Hairer, G. Wanner, *Solving Ordinary Differential Equations II* (1996), IV.7, IV.10: RODAS.
- A. Sandu et al., "Benchmarking stiff ODE solvers for atmospheric chemistry problems II:
  Rosenbrock solvers", Atmospheric Environment 31 (1997): RODAS3.
- J. R. Dormand, P. J. Prince, J. Comput. Appl. Math. 6 (1980).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, final

import numpy as np

from multicell.cells import FloatArray


@final
class LinearlyImplicit(NamedTuple):
    """Coefficients of a Rosenbrock method with s stages; γ is ``gamma[0]``."""

    a: FloatArray
    c: FloatArray
    alpha: FloatArray
    gamma: FloatArray
    order: float


@final
class Explicit(NamedTuple):
    """Coefficients of an explicit Runge–Kutta method; ``e`` is zero where it has no estimate.

    ``ends``: whether the rates at the result are its last stage.
    """

    a: FloatArray
    b: FloatArray
    e: FloatArray
    c: FloatArray
    order: float
    ends: bool


def _lower(rows: Sequence[Sequence[float]]) -> FloatArray:
    """Return a matrix with zeros on and above its diagonal, of its rows from the second on."""
    made = np.zeros((len(rows) + 1, len(rows) + 1))
    for place, row in enumerate(rows, start=1):
        made[place, : len(row)] = row
    return made


def _explicit(
    rows: Sequence[Sequence[float]], b: Sequence[float], e: Sequence[float] | None, order: float
) -> Explicit:
    a = _lower(rows)
    error = np.zeros(len(b)) if e is None else np.array(e)
    return Explicit(a, np.array(b), error, a.sum(axis=1), order, e is not None)


RODAS3: Final = LinearlyImplicit(
    _lower([[0.0], [2.0, 0.0], [2.0, 0.0, 1.0]]),
    _lower([[4.0], [1.0, -1.0], [1.0, -1.0, -8.0 / 3.0]]),
    np.array([0.0, 0.0, 1.0, 1.0]),
    np.array([0.5, 1.5, 0.0, 0.0]),
    3.0,
)
"""RODAS3: order 3 with an estimate of order 2, L-stable, four stages."""

# fmt: off
_LAST = [1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950]
RODAS4: Final = LinearlyImplicit(
    _lower([
        [1.544],
        [0.9466785280815826, 0.2557011698983284],
        [3.314825187068521, 2.896124015972201, 0.9986419139977817],
        _LAST,
        [*_LAST, 1.0],
    ]),
    _lower([
        [-5.6688],
        [-2.430093356833875, -0.2063599157091915],
        [-0.1073529058151375, -9.594562251023355, -20.47028614809616],
        [7.496443313967647, -10.24680431464352, -33.99990352819905, 11.70890893206160],
        [8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136,
         -6.058818238834054],
    ]),
    np.array([0.0, 0.386, 0.21, 0.63, 1.0, 1.0]),
    np.array([0.25, -0.1043, 0.1035, -0.0362, 0.0, 0.0]),
    4.0,
)
"""RODAS: order 4 with an estimate of order 3, L-stable, six stages."""

_DP = [35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84]
EXPLICIT_PAIR: Final = _explicit(
    [
        [1 / 5],
        [3 / 40, 9 / 40],
        [44 / 45, -56 / 15, 32 / 9],
        [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729],
        [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656],
        _DP,
    ],
    [*_DP, 0.0],
    [71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40],
    5.0,
)
"""The pair of Dormand and Prince of orders 5 and 4."""
# fmt: on

RK4: Final = _explicit(
    [[0.5], [0.0, 0.5], [0.0, 0.0, 1.0]], [1 / 6, 1 / 3, 1 / 3, 1 / 6], None, 4.0
)
FIXED_EULER: Final = _explicit([], [1.0], None, 1.0)

AUTO, IMPLICIT, EXPLICIT = range(3)
"""How a method goes: each cell by its own stiffness, or always one of the two."""

LOOSE: Final = 2e-5
"""Relative tolerance from which on RODAS3 takes less work than RODAS."""


@final
@dataclass(frozen=True, eq=False)
class NetworkMethod:
    """A method by name: how it goes, and its coefficients.

    ``words`` describe it.
    """

    name: str
    mode: int
    rosenbrock: LinearlyImplicit
    explicit: Explicit
    words: str

    @property
    def fixed(self) -> bool:
        """Whether it estimates no error, so that its steps are of a fixed length."""
        return self.mode == EXPLICIT and not self.explicit.e.any()


METHODS: Final[dict[str, NetworkMethod]] = {
    method.name: method
    for method in (
        NetworkMethod(
            "auto",
            AUTO,
            RODAS3,
            EXPLICIT_PAIR,
            "explicit or Rosenbrock, for each cell by its own stiffness",
        ),
        NetworkMethod("rodas3", IMPLICIT, RODAS3, EXPLICIT_PAIR, "Rosenbrock of order 3"),
        NetworkMethod("rodas4", IMPLICIT, RODAS4, EXPLICIT_PAIR, "Rosenbrock of order 4"),
        NetworkMethod(
            "dormand-prince", EXPLICIT, RODAS3, EXPLICIT_PAIR, "explicit pair of orders 5 and 4"
        ),
        NetworkMethod("rk4", EXPLICIT, RODAS3, RK4, "explicit, order 4, fixed steps"),
        NetworkMethod("euler", EXPLICIT, RODAS3, FIXED_EULER, "explicit, order 1, fixed steps"),
    )
}
"""The methods of networks by name."""


def method_of(name: str, relative: float) -> NetworkMethod:
    """Return a method by name; ``auto`` takes the Rosenbrock method that fits a tolerance."""
    method = METHODS[name]
    if method.mode == AUTO and relative < LOOSE:
        return NetworkMethod(name, AUTO, RODAS4, method.explicit, method.words)
    return method
