"""Likelihood of data that jump: readings as at the next run, or anything behind an edge.

Where readings are flat up to an edge and far away behind it, a Gaussian process knows neither: its
error is normal and grows steadily. Here a datum's mean over runs is a mosaic of tiles in the space
of parameters, constant in each but for a small variance τ². At parameters θ it is that of run i
with the probability w_i(θ), and otherwise that of a tile without a run, normal with mean and
variance of all runs. The w are those of indicator kriging with the covariance exp(-distance) of a
mosaic whose edges lie at random (Journel 1983, Math. Geol. 15, 445): near two runs on both sides
of an edge, of which none shows where between them it is, both count. Lengths of the distance and τ
are those by which runs predict each other best, each left out once. What is compared are densities
of data, of which a difference far below σ is none; where processes predict runs better, they are
kept. Data are taken to scatter independently.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np
from scipy.linalg import cho_solve

from multicell.calibration.fitting.emulator import Emulator
from multicell.measured.noise import Array

_LENGTHS: Final = 0.05 * 2.0 ** np.arange(8)  # of a tile, in parts of a range
_WITHIN: Final = 10.0 ** np.arange(-0.5, 2.1, 0.5)  # τ in σ of the data
_NUGGET: Final = 1e-6  # of the diagonal of covariances, so that runs may share a place
_FLOOR: Final = 1e-300  # of probabilities, whose logarithms are taken
_GAIN: Final = 0.1
"""Gain of ln of the density, a reading, from which a mosaic is taken: a choice.

It is at least 0.29 where all data jump; at most -0.15 of smooth data, cores that begin, scatter."""


@final
@dataclass(frozen=True, eq=False)
class Mosaic:
    """Densities of data in the tiles of runs.

    - ``points``, (k, d): where runs were made, over the lengths of tiles
    - ``lengths``, (d,): of tiles, in parts of the ranges
    - ``inverse``, (k, k): of the covariance of the points
    - ``likely``, (k + 1, n): density of each datum in the tile of each run, and in one without a
      run, over the largest
    - ``means``, ``variances``, (k + 1, n): of readings there, in σ from the datum
    """

    points: Array
    lengths: Array
    inverse: Array
    likely: Array
    means: Array
    variances: Array

    def loss(self, shares: Array) -> Array:
        """Return -2 ln L up to a constant for parameters (k, d): (k,)."""
        density = self._weights(shares) @ self.likely
        return np.asarray(-2.0 * np.log(density + _FLOOR).sum(axis=1))

    def predict(self, shares: Array) -> tuple[Array, Array]:
        """Return (mean - datum) / σ and its variance for parameters (k, d): (k, n) each."""
        weights = self._weights(shares)
        means = weights @ self.means
        squares = weights @ (self.means**2 + self.variances)
        return means, np.maximum(squares - means**2, 0.0)

    def _weights(self, shares: Array) -> Array:
        near = np.exp(-_distances(shares / self.lengths, self.points))
        return _with_rest(near @ self.inverse)


def mosaic_of(emulator: Emulator, others: Array) -> Mosaic | None:
    """Return the mosaic of the runs of an emulator, None unless it predicts them better.

    - ``others``, (n,): variance of datum and scatter, in σ²
    """
    found, scores = mosaic(emulator.shares, emulator.residuals, others)
    seen = emulator.residuals > emulator.lowest + 1e-9
    gain = float((scores - left_out(emulator, others))[seen].mean()) if seen.any() else 0.0
    return found if gain > _GAIN else None


def mosaic(points: Array, residuals: Array, others: Array) -> tuple[Mosaic, Array]:
    """Return the mosaic of runs, and ln of the density at each by all others, (k, n).

    - ``points``, (k, d): where they were made
    - ``residuals``, (k, n): (mean - datum) / σ
    - ``others``, (n,): variance of datum and scatter, in σ²
    """
    centre, width = residuals.mean(axis=0), residuals.var(axis=0) + 1e-9
    beyond = _normal(residuals - centre, width + others)

    def scored(trials: list[Array]) -> tuple[Array, Array]:
        """Return ln of the densities by lengths of tiles, (m, k, n), and the likeliest τ, (m, n).

        One datum after another: all would be many times the runs' square.
        """
        found = np.empty((len(trials), *residuals.shape))
        within = np.empty((len(trials), len(others)))
        weights = np.array([_left_out(points / lengths) for lengths in trials])
        for k, (column, error) in enumerate(zip(residuals.T, others, strict=True)):
            tiles = _normal((column[:, None] - column)[..., None], error + _WITHIN**2)
            density = np.einsum("mij,ijt->mit", weights[..., :-1], tiles)
            logs = np.log(density + weights[..., -1:] * beyond[:, k : k + 1] + _FLOOR)
            best = logs.sum(axis=1).argmax(axis=1)
            found[..., k] = logs[np.arange(len(trials)), :, best]
            within[:, k] = _WITHIN[best]
        return found, within

    def best_of(trials: list[Array]) -> Array:
        return trials[int(scored(trials)[0].sum(axis=(1, 2)).argmax())]

    lengths = best_of([np.full(points.shape[1], length) for length in _LENGTHS])
    for k in range(len(lengths)):  # longer along parameters that move no edge
        lengths = best_of([np.where(np.arange(len(lengths)) == k, x, lengths) for x in _LENGTHS])
    (scores,), (within,) = scored([lengths])
    own = np.vstack([np.tile(within**2, (len(points), 1)), width])
    at = np.vstack([residuals, centre])
    inverse = _inverse(points / lengths)
    logs = -0.5 * (at**2 / (own + others) + np.log(own + others))
    likely = np.exp(logs - logs.max(axis=0))
    found = Mosaic(points / lengths, lengths, inverse, likely, at, own)
    return found, scores


def left_out(emulator: Emulator, others: Array) -> Array:
    """Return ln of the density at each run by Gaussian processes through all others, (k, n).

    - ``others``, (n,): variance of datum and scatter, in σ²

    It is 0 for readings of zero that say nothing.
    """
    found = np.zeros_like(emulator.residuals)
    for process in emulator.processes:
        for column in process.columns:
            own = np.diag(cho_solve((column.root, True), np.eye(len(column.root))))[:, None]
            variance = column.width**2 / own + others[column.data]
            density = _normal(column.width * column.weights / own, variance)
            found[np.ix_(column.points, column.data)] = np.log(density + _FLOOR)
    return found


def _normal(away: Array, variance: Array) -> Array:
    return np.asarray(np.exp(-0.5 * away**2 / variance) / np.sqrt(2.0 * np.pi * variance))


def _distances(points: Array, others: Array) -> Array:
    squares = (points**2).sum(axis=1)[:, None] + (others**2).sum(axis=1)
    return np.asarray(np.sqrt(np.maximum(squares - 2.0 * points @ others.T, 0.0)))


def _inverse(points: Array) -> Array:
    """Return the inverse of the covariance of points, (k, k)."""
    covariance = np.exp(-_distances(points, points)) + _NUGGET * np.eye(len(points))
    return np.asarray(np.linalg.inv(covariance), dtype=np.float64)


def _left_out(points: Array) -> Array:
    """Return probabilities at each point of the tiles of all others, and of none, (k, k + 1)."""
    inverse = _inverse(points)
    return _with_rest(np.eye(len(points)) - inverse / np.diag(inverse)[:, None])


def _with_rest(weights: Array) -> Array:
    """Return probabilities of tiles from weights of kriging, and that of none of them."""
    positive = np.maximum(weights, 0.0)  # kriging's weights may be slightly below zero
    total = positive.sum(axis=1, keepdims=True)
    rest = np.maximum(1.0 - total, _FLOOR)
    return np.hstack([positive / np.maximum(total, 1.0), rest])
