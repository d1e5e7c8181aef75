"""Likelihood of data that jump: readings as at the next run, or anything behind an edge.

Where readings are flat up to an edge and far away behind it, a Gaussian process knows neither: its
error is normal and grows steadily. Here a datum's mean over runs is a mosaic of tiles in the space
of parameters, constant in each but for a small variance τ². At parameters θ it is that of run i
with the probability w_i(θ), and otherwise that of a tile without a run, normal with mean and
variance of all runs. The w are those of indicator kriging with the covariance exp(-distance) of a
mosaic whose edges lie at random (Journel 1983, Math. Geol. 15, 445): near two runs
on both sides of an edge, of which none shows where between them it is, both count. Lengths of the
distance and τ are those by which runs predict each other best, each left out once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np
from scipy.linalg import cho_solve

from multicell.calibration.fitting.emulator import Emulator
from multicell.measured.noise import Array

_LENGTHS: Final = 0.05 * 2.0 ** np.arange(8)  # of a tile, in parts of a range
_WITHIN: Final = 10.0 ** np.arange(-1.0, 2.1, 0.5)  # τ in σ of the data
_NUGGET: Final = 1e-6  # of the diagonal of covariances, so that runs may share a place
_FLOOR: Final = 1e-300  # of probabilities, whose logarithms are taken
_SURE: Final = 3.0  # standard errors by which a mosaic must predict runs better


@final
@dataclass(frozen=True, eq=False)
class Mosaic:
    """Likelihood of the runs' tiles.

    - ``points``, (k, d): where runs were made, over the lengths of tiles
    - ``lengths``, (d,): of tiles, in parts of the ranges
    - ``inverse``, (k, k): of the covariance of the points
    - ``likely``, (k + 1, n): density of each datum in the tile of each run, and in one without a
      run, over the largest
    - ``means``, ``variances``, (k + 1, n): of readings there, given the datum; in σ from it
    """

    points: Array
    lengths: Array
    inverse: Array
    likely: Array
    means: Array
    variances: Array

    def loss(self, shares: Array) -> Array:
        """Return -2 ln L up to a constant for parameters (k, d): (k,)."""
        return np.asarray(-2.0 * np.log(self._density(self._weights(shares))).sum(axis=1))

    def predict(self, shares: Array) -> tuple[Array, Array]:
        """Return (mean - datum) / σ and its variance, given the data, for parameters (k, d)."""
        weights = self._weights(shares)
        density = self._density(weights)
        means = weights @ (self.likely * self.means) / density
        squares = weights @ (self.likely * (self.means**2 + self.variances)) / density
        return means, np.maximum(squares - means**2, 0.0)

    def _density(self, weights: Array) -> Array:
        return np.asarray(np.maximum(weights @ self.likely, _FLOOR))

    def _weights(self, shares: Array) -> Array:
        near = np.exp(-_distances(shares / self.lengths, self.points))
        return _with_rest(near @ self.inverse)


def mosaic(
    points: Array, residuals: Array, others: Array, emulator: Emulator | None = None
) -> Mosaic | None:
    """Return the mosaic of runs.

    - ``points``, (k, d): where they were made
    - ``residuals``, (k, n): (mean - datum) / σ
    - ``others``, (n,): variance of datum and scatter, in σ²
    - ``emulator``: through the same points; None is returned unless the mosaic predicts them better
    """
    centre, width = residuals.mean(axis=0), residuals.var(axis=0) + 1e-9
    tiles = np.array(
        [_normal(residuals[:, None] - residuals, np.full(len(centre), t**2)) for t in _WITHIN]
    )
    beyond = _normal(residuals - centre, width)

    def scores(lengths: Array) -> tuple[Array, Array]:
        """Return ln of the density of each run by all others, (k, n), and the τ of it, (n,)."""
        inverse = np.linalg.inv(_covariance(points / lengths))
        weights = _with_rest(np.eye(len(points)) - inverse / np.diag(inverse)[:, None])
        found = np.einsum("ij,tijn->tin", weights[:, :-1], tiles) + weights[:, -1:] * beyond
        found = np.log(np.maximum(found, _FLOOR))
        best = found.sum(axis=1).argmax(axis=0)
        return found[best, :, np.arange(len(best))].T, _WITHIN[best]

    trials = [np.full(points.shape[1], length) for length in _LENGTHS]
    lengths = max(trials, key=lambda tried: scores(tried)[0].sum())
    for k in range(len(lengths)):  # longer along parameters that move no edge
        trials = [np.where(np.arange(len(lengths)) == k, x, lengths) for x in _LENGTHS]
        lengths = max(trials, key=lambda tried: scores(tried)[0].sum())
    score, within = scores(lengths)
    if emulator is not None:
        better = np.where(residuals <= emulator.lowest + 1e-9, 0.0, score - left_out(emulator))
        gain = better.sum(axis=1)
        if not gain.mean() > _SURE * gain.std() / np.sqrt(len(gain)):
            return None
    own = np.vstack([np.tile(within**2, (len(points), 1)), width])
    at = np.vstack([residuals, centre])
    density = -0.5 * (at**2 / (own + others) + np.log(own + others))
    return Mosaic(
        points / lengths,
        lengths,
        np.linalg.inv(_covariance(points / lengths)),
        np.exp(density - density.max(axis=0)),
        at * others / (own + others),
        own * others / (own + others),
    )


def left_out(emulator: Emulator) -> Array:
    """Return ln of the density of each run by Gaussian processes through all others, (k, n).

    It is 0 for readings of zero that say nothing.
    """
    found = np.zeros_like(emulator.residuals)
    for process in emulator.processes:
        for column in process.columns:
            own = np.diag(cho_solve((column.root, True), np.eye(len(column.root))))[:, None]
            logs = 0.5 * (np.log(own / (2.0 * np.pi)) - column.weights**2 / own)
            found[np.ix_(column.points, column.data)] = logs - np.log(column.width)
    return found


def _normal(away: Array, variance: Array) -> Array:
    return np.asarray(np.exp(-0.5 * away**2 / variance) / np.sqrt(2.0 * np.pi * variance))


def _distances(points: Array, others: Array) -> Array:
    squares = (points**2).sum(axis=1)[:, None] + (others**2).sum(axis=1)
    return np.asarray(np.sqrt(np.maximum(squares - 2.0 * points @ others.T, 0.0)))


def _covariance(points: Array) -> Array:
    return np.asarray(np.exp(-_distances(points, points)) + _NUGGET * np.eye(len(points)))


def _with_rest(weights: Array) -> Array:
    """Return probabilities of tiles from weights of kriging, and that of none of them."""
    positive = np.maximum(weights, 0.0)  # kriging's weights may be slightly below zero
    total = positive.sum(axis=1, keepdims=True)
    rest = np.maximum(1.0 - total, _FLOOR)
    return np.hstack([positive / np.maximum(total, 1.0), rest])
