"""Coefficients of ROCK4, a stabilised method of order four, from the conditions of order.

Abdulle, "Fourth order Chebyshev methods with recurrence relation", SIAM J. Sci. Comput. 23 (2002)
2042, https://doi.org/10.1137/S1064827500379549. The published tables are not used: the stability
polynomial is w(z) P(z) with four complex zeros in w and orthogonal polynomials P, and agrees with
exp(z) up to z⁴; P is a recurrence of s - 4 stages, and the last four stages are chosen such that
the whole fulfils the eight conditions of order four.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.optimize import least_squares

from multicell.cells import FloatArray

DEGREES = (*range(5, 20), *range(20, 40, 3), *range(40, 80, 6), *range(80, 140, 12), 150)
_NEAR = 0.05  # -z from which on the polynomial oscillates
_DENSITY = np.array([1, 1, 2, 3, 6, 4, 8, 12, 24.0])
"""Of the empty tree and the rooted ones • [•] [••] [[•]] [•••] [•[•]] [[••]] [[[•]]]."""
_EXACT = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}


def rock4_length(stages: int) -> float:
    """Return the stable λΔt, within four per cent of that in table 2.1 there."""
    return 0.35 * stages**2 - 2.95


def slope_of(a: FloatArray) -> FloatArray:
    """Return the B-series of h f(y), one number for each tree, from that of y."""
    return np.array([0, 1, a[1], a[1] ** 2, a[2], a[1] ** 3, a[1] * a[2], a[3], a[4]])


def recurrence(roots: FloatArray, stages: int) -> FloatArray:
    """Return the weights of h f(y_j), y_j and y_(j-1) in y_(j+1), (s - 4, 3).

    The polynomials are 1 at zero and orthogonal on [-length, -_NEAR], the weight being |w|², where
    w has the four complex ``roots``, times that of Chebyshev's polynomials.
    """
    length = rock4_length(stages)
    half, zero = (length - _NEAR) / 2.0, (length + _NEAR) / (length - _NEAR)
    x = np.cos(np.pi * (np.arange(4 * stages) + 0.5) / (4 * stages))
    pairs = roots.reshape(2, 2)
    weight = np.prod([np.abs(1 - half * (x - zero) / complex(*p)) ** 4 for p in pairs], axis=0)
    before, now, last, table = np.zeros_like(x), np.ones_like(x), 1.0, []
    for _ in range(stages - 4):
        square = (weight * now * now).sum()
        a, c = (weight * x * now * now).sum() / square, (weight * x * now * before).sum() / last
        r = 1.0 / (zero - a - c)
        before, now, last = now, r * ((x - a) * now - c * before), square
        table.append((r / half, r * (zero - a), -r * c))
    return np.array(table)


def series_of(table: FloatArray) -> list[FloatArray]:
    """Return the B-series of the stages of a recurrence, from the first to the end."""
    stages = [np.eye(1, 9)[0], np.eye(1, 9)[0]]
    for mu, nu, kappa in table:
        stages.append(mu * slope_of(stages[-1]) + nu * stages[-1] + kappa * stages[-2])
    return stages[1:]


@cache
def rock4(stages: int) -> tuple[FloatArray, ...]:
    """Return recurrence, times of its stages, A and b of the last four, weights of the error."""

    def off(roots: FloatArray) -> FloatArray:
        """Return how far the stability polynomial is from exp(z), up to z⁴."""
        p = series_of(recurrence(roots, stages))[-1][[0, 1, 2, 4, 8]]
        for pair in roots.reshape(2, 2):
            size = pair @ pair
            p = np.convolve(p, [1.0, -2.0 * pair[0] / size, 1.0 / size])[:5]
        return p[1:] * [1, 2, 6, 24] - 1.0

    table = recurrence(least_squares(off, [-2.4, 1.3, -0.27, 3.4], **_EXACT).x, stages)
    series = series_of(table)

    def ending(x: FloatArray) -> FloatArray:
        slopes: list[FloatArray] = []
        for row in (*_tableau(x)[0], x[6:]):
            slopes.append(slope_of(series[-1] + sum(a * s for a, s in zip(row, slopes))))  # noqa: B905
        return np.array(slopes)

    def conditions(x: FloatArray) -> FloatArray:
        return (series[-1] + x[6:] @ ending(x)[:4])[1:] * _DENSITY[1:] - 1.0

    # ten numbers for eight conditions: those nearest to the classical method
    classical = np.array([0.5, 0, 0.5, 0, 0, 1, 1 / 6, 1 / 3, 1 / 3, 1 / 6])
    x = least_squares(conditions, (1.0 - series[-1][1]) * classical, **_EXACT).x
    slopes = ending(x)
    # the error is the combination of slopes that vanishes up to order three
    null = np.linalg.svd(slopes[:, 1:5].T)[2][-1]
    null /= 24.0 * np.abs(null @ slopes[:, 5:]).max()
    return table, np.array([s[1] for s in series]), *_tableau(x), null


def _tableau(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    a = np.zeros((4, 4))
    a[1, 0], a[2, :2], a[3, :3] = x[0], x[1:3], x[3:6]
    return a, x[6:]
