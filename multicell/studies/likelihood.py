"""The likelihood behind the intervals of a search: fresh runs, and a full covariance from them.

All points of a search have the same seeds, so that its best point leans towards what these seeds
happen to do, and readings of one run scatter together: a tissue that is large at one time is large
at the next. So R runs with fresh seeds are made at the best point. With their mean m and their
covariance S, all in σ of the data,

    C = 1 + S/√(n_i n_j) + S/R + E

is the covariance of data minus mean: errors of measurement, the scatter of n_i tissues (Datum), the
error of the mean, and the emulator's error E, which depends on the parameters. The emulator is
shifted so that it has the mean m at the best point.

S has R - 1 degrees of freedom, often fewer than there are data. It serves twice. The data are
weighted by the inverse of C with S shrunk (Ledoit & Wolf 2004, J. Multivariate Anal. 88, 365, of
its correlations; at least by a tenth), which decides how well parameters are determined and not
whether intervals are right. What these weights see of the data along the few directions that the
parameters move them in has a covariance V of that many dimensions, which the fresh runs estimate
without shrinkage. Its likelihood is Hotelling's, a multivariate Student's with ν - k + 1 degrees of
freedom for k directions; ν is R - 1, or more where errors of measurement, which are known, make
most of V (Satterthwaite). The other directions, in which all parameters are alike except for
curvature, count as normal.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from multicell.studies.distance import Array
from multicell.studies.emulator import Emulator, draws

LEAST: Final = 4
"""Fresh runs of which a covariance can be estimated."""
_SHRINKAGE: Final = 0.1
_STILL: Final = 0.02
"""Standard deviations below which a direction of the data does not depend on the parameters."""
_EXACT: Final = 1e6
"""Degrees of freedom that stand for a variance that is known."""


@final
@dataclass(frozen=True, eq=False)
class Scatter:
    """What fresh runs at one point show, in σ of the data.

    Attributes
    ----------
    mean : (n,)
        Of (reading - datum) / σ.
    covariance : (n, n)
        Of one run.
    shrunk : (n, n)
        The same with its correlations drawn towards none.
    count
        Number of runs; 0 where the covariance was not estimated from fresh ones.
    """

    mean: Array
    covariance: Array
    shrunk: Array
    count: int


def scatter_of(residuals: Array) -> Scatter:
    """Return mean and covariance of fresh runs from their (reading - datum) / σ, (R, n)."""
    from sklearn.covariance import ledoit_wolf_shrinkage

    mean, count = residuals.mean(axis=0), len(residuals)
    away = residuals - mean
    covariance = away.T @ away / (count - 1.0)
    deviation = np.sqrt(np.diag(covariance))
    moving = deviation > 0.0
    shrinkage = _SHRINKAGE
    if moving.sum() > 1:
        wolf = ledoit_wolf_shrinkage(away[:, moving] / deviation[moving], assume_centered=True)
        shrinkage = max(_SHRINKAGE, float(wolf))
    shrunk = (1.0 - shrinkage) * covariance + shrinkage * np.diag(deviation**2)
    return Scatter(mean, covariance, shrunk, count)


@final
@dataclass(frozen=True, eq=False)
class Likelihood:
    """-2 ln L of parameters by an emulator and fresh runs.

    Attributes
    ----------
    emulator
        Of the search.
    shift : (n,)
        What is added to its means, in σ.
    error : (n,)
        Variance that is added to the emulator's own, in σ².
    whitening : (n, n)
        Takes data to the scale where C is one.
    directions : (n, k)
        Of whitened data, orthonormal, along which the parameters move them; k may be 0.
    spread : (k, k)
        Scale of the Student distribution along them, at the best point.
    freedom
        Its degrees of freedom.
    """

    emulator: Emulator
    shift: Array
    error: Array
    whitening: Array
    directions: Array
    spread: Array
    freedom: float

    def predict(self, shares: Array) -> tuple[Array, Array]:
        """Return (mean - datum) / σ and the variance of its error for parameters (k, d)."""
        means, variances = self.emulator.predict(shares)
        return np.maximum(means + self.shift, self.emulator.lowest), variances + self.error

    def loss(self, shares: Array) -> Array:
        """Return -2 ln L up to a constant for parameters (k, d): (k,)."""
        means, variances = self.predict(shares)
        white = means @ self.whitening.T
        count, along = self.directions.shape
        part = white @ self.directions
        rest = white - part @ self.directions.T
        more = 1.0 + variances @ (self.whitening**2).T
        normal = (rest**2 / more).sum(axis=1) + (1.0 - along / count) * np.log(more).sum(axis=1)
        if along == 0:
            return np.asarray(normal)
        moved = self.whitening.T @ self.directions
        spread = self.spread + np.einsum("ni,pn,nj->pij", moved, variances, moved, optimize=True)
        size = (part * np.linalg.solve(spread, part[..., None])[..., 0]).sum(axis=1)
        student = (self.freedom + along) * np.log1p(size / self.freedom)
        return np.asarray(normal + student + np.linalg.slogdet(spread)[1])

    def draws(self, seed: int = 0) -> Array:
        """Return draws from the posterior under a uniform prior: (count, d), of equal weight."""
        return draws(self.loss, self.emulator.dimensions, seed)


def likelihood(
    emulator: Emulator, tissues: Array, best: Array, scatter: Scatter, error: Array | float = 0.0
) -> Likelihood:
    """Return the likelihood with the scatter of fresh runs at the best point.

    Parameters
    ----------
    emulator
        Of the search.
    tissues : (n,)
        How many tissues each datum is the mean of.
    best : (d,)
        Where the fresh runs were made.
    scatter
        What they show.
    error : (n,)
        Variance that check runs have found beyond the emulator's own, in σ².
    """
    means, variances = emulator.predict(best[None])
    count = max(scatter.count, 1)
    shares = np.sqrt(1.0 / np.outer(tissues, tissues)) + 1.0 / count
    error = np.broadcast_to(np.asarray(error, dtype=float), tissues.shape)
    known = np.eye(len(tissues))
    total = known + scatter.shrunk * shares + np.diag(variances[0] + error)
    values, vectors = np.linalg.eigh(total)
    whitening = (vectors / np.sqrt(values)) @ vectors.T
    none = np.zeros((len(tissues), 0))
    working = Likelihood(
        emulator, scatter.mean - means[0], error, whitening, none, np.zeros((0, 0)), _EXACT
    )
    if scatter.count == 0:
        return working
    return _student(working, known, scatter.covariance * shares, scatter.count - 1.0)


def _student(working: Likelihood, known: Array, estimated: Array, freedom: float) -> Likelihood:
    """Return a likelihood whose covariance counts as estimated where the parameters move data."""
    shares = working.draws()
    white = working.predict(shares)[0] @ working.whitening.T
    _, sizes, vectors = np.linalg.svd(white - white.mean(axis=0), full_matrices=False)
    most = min(shares.shape[1], int(freedom) - 2)
    along = int((sizes[:most] / np.sqrt(len(shares)) > _STILL).sum())
    directions = vectors[:along].T
    if along == 0:
        return working
    moved = working.whitening.T @ directions
    scatter = moved.T @ estimated @ moved
    spread = moved.T @ known @ moved + scatter
    part = float(np.trace(scatter) / np.trace(spread))
    freedom = min(freedom / max(part, 1e-9) ** 2, _EXACT)
    left = freedom - along + 1.0
    return replace(working, directions=directions, spread=spread * freedom / left, freedom=left)
