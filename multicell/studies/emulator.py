"""What runs would give between the parameters that were tried: polynomials fitted to them.

Each datum's mean over runs is a polynomial of the parameters (places in their ranges), of second
degree where there are points enough, else of first, fitted by weighted least squares to the points
that fit best. What a polynomial leaves unexplained counts as its error wherever it is used. The
synthetic likelihood of the polynomials (see :mod:`multicell.studies.distance`) gives the next
points that are worth a run, and an approximate posterior; it takes a hundredth of the runs of one
that is sampled with runs.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from multicell.studies.distance import Array

_PARTICLES: Final = 2000
_MOVES: Final = 8


@final
@dataclass(frozen=True, eq=False)
class Emulator:
    """Polynomials in place of runs.

    Attributes
    ----------
    degree
        Of the polynomials, 1 or 2.
    centre, width : (d,)
        Origin and scale of their variables.
    coefficients : (p, n)
        Of (mean - datum) / σ.
    inverse : (p, p)
        Of the weighted normal matrix: how far the points hold the coefficients.
    error : (n,)
        Variance that the polynomials leave, in σ².
    scatter : (n,)
        Variance over runs and of their mean, s² (1 + 1/K) / σ².
    """

    degree: int
    centre: Array
    width: Array
    coefficients: Array
    inverse: Array
    error: Array
    scatter: Array

    def loss(self, shares: Array) -> Array:
        """Return -2 ln L for parameters (k, d): (k,)."""
        terms = _terms((shares - self.centre) / self.width, self.degree)
        residuals = terms @ self.coefficients
        held = np.einsum("ij,jk,ik->i", terms, self.inverse, terms)
        total = 1.0 + self.scatter + self.error * (1.0 + held[:, None])
        return np.asarray((residuals**2 / total + np.log(total)).sum(axis=1))

    def means(self, shares: Array) -> Array:
        """Return (mean - datum) / σ for parameters (k, d): (k, n)."""
        return _terms((shares - self.centre) / self.width, self.degree) @ self.coefficients

    def sample(self, seed: int, count: int = _PARTICLES) -> Array:
        """Return draws from the posterior under a uniform prior: (count, d), of equal weight.

        Sequential Monte Carlo: the likelihood's power rises from 0 to 1 so that half of the draws
        stay effective, and between two powers the draws move by random-walk Metropolis steps.
        """
        random = np.random.default_rng(seed)
        dimensions = len(self.centre)
        draws = random.random((count, dimensions))
        losses = self.loss(draws)
        power = 0.0
        while power < 1.0:
            step = _step(losses, 1.0 - power)
            power = 1.0 if step >= 1.0 - power else power + step
            chosen = _resampled(_weights(losses, step), random)
            draws, losses = draws[chosen], losses[chosen]
            draws, losses = self._moved(draws, losses, power, random)
        return draws

    def _moved(
        self, draws: Array, losses: Array, power: float, random: np.random.Generator
    ) -> tuple[Array, Array]:
        """Return draws after Metropolis steps at a power of the likelihood."""
        dimensions = draws.shape[1]
        spread = np.atleast_2d(np.cov(draws.T)) + 1e-12 * np.eye(dimensions)
        root = np.linalg.cholesky(spread) * 2.38 / np.sqrt(dimensions)
        for _ in range(_MOVES):
            tried = draws + random.standard_normal(draws.shape) @ root.T
            inside = ((tried >= 0.0) & (tried <= 1.0)).all(axis=1)
            found = np.full(len(draws), np.inf)
            found[inside] = self.loss(tried[inside])
            accepted = np.log(random.random(len(draws))) < 0.5 * power * (losses - found)
            draws = np.where(accepted[:, None], tried, draws)
            losses = np.where(accepted, found, losses)
        return draws, losses


def emulator(shares: Array, residuals: Array, scatter: Array, loss: Array) -> Emulator | None:
    """Return polynomials for the best of the points that were tried, None if these are too few.

    Parameters
    ----------
    shares : (k, d)
        The points.
    residuals : (k, n)
        (mean - datum) / σ; points with NaN are left out.
    scatter : (k, n)
        s² (1 + 1/K) / σ².
    loss : (k,)
        -2 ln L of the runs.
    """
    whole = np.isfinite(residuals).all(axis=1)
    shares, residuals, scatter, loss = (x[whole] for x in (shares, residuals, scatter, loss))
    dimensions = shares.shape[1]
    linear, quadratic = 1 + dimensions, (1 + dimensions) * (2 + dimensions) // 2
    if len(shares) >= quadratic + 3:
        degree, size = 2, quadratic
    elif len(shares) >= linear + 2:
        degree, size = 1, linear
    else:
        return None
    weights = _nearness(loss, min(len(shares), max(2 * size, size + 3)))
    kept = weights > 1e-4
    shares, residuals, scatter, weights = (x[kept] for x in (shares, residuals, scatter, weights))
    centre = np.average(shares, axis=0, weights=weights)
    width = np.sqrt(np.average((shares - centre) ** 2, axis=0, weights=weights)) + 1e-9
    width = np.asarray(width, dtype=float)
    terms = _terms((shares - centre) / width, degree)
    # a little of a ridge, so that points on a line are no error
    normal = terms.T @ (weights[:, None] * terms) + 1e-9 * np.eye(size)
    inverse: Array = np.linalg.inv(normal).astype(float)
    coefficients = inverse @ (terms.T @ (weights[:, None] * residuals))
    left = residuals - terms @ coefficients
    # degrees of freedom of a weighted fit: Σw minus the trace of its hat matrix
    free = weights.sum() - np.einsum("ij,jk,ik,i->", terms, inverse, terms, weights**2)
    error = (weights[:, None] * left**2).sum(axis=0) / max(free, 0.5)
    mean_scatter = np.asarray(np.average(scatter, axis=0, weights=weights), dtype=float)
    return Emulator(degree, centre, width, coefficients, inverse, error, mean_scatter)


def _nearness(loss: Array, count: int) -> Array:
    """Return weights in which about ``count`` points count, the best ones most."""
    above = loss - loss.min()
    # points within what the data can tell apart count fully
    reach = max(float(np.sort(above)[count - 1]), 9.0)
    return np.asarray(1.0 / (1.0 + (above / reach) ** 4))


def _terms(variables: Array, degree: int) -> Array:
    """Return all products of up to ``degree`` variables, (k, p)."""
    columns = [np.ones(len(variables)), *variables.T]
    if degree == 2:
        pairs = combinations_with_replacement(range(variables.shape[1]), 2)
        columns += [variables[:, i] * variables[:, j] for i, j in pairs]
    return np.column_stack(columns)


def _weights(losses: Array, power: float) -> Array:
    weights = np.exp(-0.5 * power * (losses - losses.min()))
    return np.asarray(weights / weights.sum())


def _step(losses: Array, most: float) -> float:
    """Return by how much the likelihood's power may rise so that half of the draws count."""

    def effective(power: float) -> float:
        return float(1.0 / (_weights(losses, power) ** 2).sum())

    if effective(most) >= 0.5 * len(losses):
        return most
    low, high = 0.0, most
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if effective(middle) >= 0.5 * len(losses) else (low, middle)
    return max(low, 1e-12 * most)


def _resampled(weights: Array, random: np.random.Generator) -> NDArray[np.intp]:
    """Return rows drawn systematically by their weights."""
    count = len(weights)
    places = (random.random() + np.arange(count)) / count
    return np.minimum(np.searchsorted(np.cumsum(weights), places), count - 1)
