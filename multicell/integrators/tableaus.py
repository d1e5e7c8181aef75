"""Coefficients of the Runge-Kutta methods, as data."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Tableau(NamedTuple):
    """An explicit Runge-Kutta method.

    Attributes
    ----------
    a : (s, s)
        Stage i is at x + h Σ_j a_ij k_j, below the diagonal.
    b : (s,)
        Weights of the result.
    c : (s,)
        Times of the stages, in steps.
    error : (s,)
        Weights of the estimated error; no entries where there is no estimate. Methods with
        one must be "first same as last": the last stage is at the result.
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
