"""Problems of fitting whose simulators cost nothing and whose posteriors are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import multicell as mc
from multicell.studies.axes import Range
from multicell.studies.data import Condition, Datum, Measured
from multicell.studies.problem import Problem
from multicell.studies.simulating import Reading

MATRIX = [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, -1.0]]
"""Four data of two parameters that determine both."""

CALLS = []
"""Shares, condition and seed of every call of a simulator in this process."""


def calls_of(work):
    """Return what some work returns, and the calls of simulators that it made."""
    before = len(CALLS)
    try:
        found = work()
    except KeyboardInterrupt:
        found = None
    return found, CALLS[before:]


SCENE = mc.load_scene("growth")


@dataclass(frozen=True)
class Linear:
    """Readings A x + noise: with normal errors the posterior is a normal one.

    Every call is noted in ``CALLS``, also of copies that were sent somewhere in this process.
    """

    matrix: tuple[tuple[float, ...], ...]
    noise: float = 0.0
    bend: float = 0.0

    def __call__(self, shares, condition, seed):
        CALLS.append((tuple(shares), condition, seed))
        x = np.asarray(shares)
        found = np.asarray(self.matrix) @ (x + self.bend * x**2)
        # the same seed gives the same numbers at all parameters
        found = found + self.noise * np.random.default_rng(seed).standard_normal(len(found))
        return Reading(tuple(map(float, found)))


def measured(values, sigma):
    """Return data of one condition with given values and deviations, at as many hours."""
    data = tuple(
        Datum("diameter", float(v), float(s), False, False, 3600.0 * (k + 1), None, 0, f"row {k}")
        for k, (v, s) in enumerate(zip(values, np.broadcast_to(sigma, len(values)), strict=True))
    )
    condition = Condition("only", {}, SCENE)
    return Measured(data, (condition,), {"diameter": "um"}, "cheap")


def linear(matrix, values, sigma, *, noise=0.0, bend=0.0, seeds=1, first=0):
    """Return a problem with as many parameters between 0 and 1 as the matrix has columns."""
    matrix = tuple(tuple(map(float, row)) for row in matrix)
    ranges = tuple(
        Range(f"toy.p{k}", 0.0, 1.0, "", False, f"p{k}", False) for k in range(len(matrix[0]))
    )
    return Problem(
        measured(values, sigma),
        ranges,
        Linear(matrix, noise, bend),
        tuple(range(first, first + seeds)),
    )


def exact(problem):
    """Return mean and covariance of the posterior of a linear problem whose ends do not count.

    Scatter of the runs adds to the variance of the data.
    """
    a = np.asarray(problem.simulator.matrix)
    weights = 1.0 / (problem.sigma**2 + problem.simulator.noise**2)
    covariance = np.linalg.inv(a.T @ (weights[:, None] * a))
    return covariance @ (a.T @ (weights * problem.observed)), covariance
