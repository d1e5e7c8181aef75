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
whether intervals are right. What these weights make of the scatter along the few directions in
which the parameters move the data has a covariance V of that many dimensions. It is estimated
without shrinkage, and each run with weights in which it had no part: weights seek out what happens
to scatter little in the runs that they come from, which would make V too small. The likelihood
along these directions is Hotelling's, a multivariate Student's with ν - k + 1 degrees of freedom
for k directions; ν is R - 1, or more where errors of measurement, which are known, make
most of V (Satterthwaite). The other directions, in which all parameters are alike except for
curvature, count as normal.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from multicell.calibration.distance import Array
from multicell.calibration.emulator import FEW, PARTICLES, Emulator, draws

MIN_REPEATS: Final = 4  # fresh runs of which a covariance can be estimated
_SHRINKAGE: Final = 0.1
_STILL: Final = 0.02
"""Standard deviations below which a direction of the data does not depend on the parameters."""
_EXACT: Final = 1e6  # degrees of freedom that stand for a variance that is known


@final
@dataclass(frozen=True, eq=False)
class Scatter:
    """What fresh runs at one point show, in σ of the data.

    - ``mean``, (n,): of (reading - datum) / σ
    - ``variance``, (n,): of one run
    - ``away``, (R, n): the runs less their mean
    """

    mean: Array
    variance: Array
    away: Array

    @property
    def count(self) -> int:
        """Number of runs."""
        return len(self.away)


def scatter_of(residuals: Array) -> Scatter:
    """Return mean and scatter of fresh runs from their (reading - datum) / σ, (R, n)."""
    mean = residuals.mean(axis=0)
    return Scatter(mean, residuals.var(axis=0, ddof=1), residuals - mean)


def _shrink(away: Array) -> Array:
    """Return the covariance of runs (R, n), its correlations drawn towards none: (n, n)."""
    from sklearn.covariance import ledoit_wolf_shrinkage

    away = away - away.mean(axis=0)
    covariance = away.T @ away / (len(away) - 1.0)
    deviation = np.sqrt(np.diag(covariance))
    moving = deviation > 0.0
    shrinkage = _SHRINKAGE
    if moving.sum() > 1:
        wolf = ledoit_wolf_shrinkage(away[:, moving] / deviation[moving], assume_centered=True)
        shrinkage = max(_SHRINKAGE, float(wolf))
    return np.asarray((1.0 - shrinkage) * covariance + shrinkage * np.diag(deviation**2))


@final
@dataclass(frozen=True, eq=False)
class Likelihood:
    """-2 ln L of parameters by an emulator and fresh runs.

    - ``emulator``: of the search
    - ``shift``, (n,): what is added to its means, in σ
    - ``error``, (n,): variance that is added to the emulator's own, in σ²
    - ``whitening``, (n, n): takes data to the scale where C is one
    - ``directions``, (n, k): of whitened data, orthonormal, along which the parameters move them; k
      may be 0
    - ``spread``, (k, k): scale of the Student distribution along them, at the best point
    - ``freedom``: its degrees of freedom
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
        return self.loss_of(*self.predict(shares))

    def loss_of(self, means: Array, variances: Array) -> Array:
        """Return -2 ln L for (mean - datum) / σ and the variances of their errors, (k, n): (k,)."""
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

    def draws(self, count: int = PARTICLES) -> Array:
        """Return draws from the posterior: (count, d), of equal weight."""
        return draws(self.loss, self.emulator.prior, seed=0, count=count)


def likelihood(
    emulator: Emulator, tissues: Array, best: Array, scatter: Scatter, error: Array | float = 0.0
) -> Likelihood:
    """Return the likelihood with the scatter of fresh runs at the best point.

    - ``emulator``: of the search
    - ``tissues``, (n,): how many tissues each datum is the mean of
    - ``best``, (d,): where the fresh runs were made
    - ``scatter``: what they show
    - ``error``, (n,): variance that check runs have found beyond the emulator's own, in σ²
    """
    means, variances = emulator.predict(best[None])
    error = np.broadcast_to(np.asarray(error, dtype=float), tissues.shape)
    known = np.diag(1.0 + variances[0] + error)
    # scatter of the tissues, correlated between data as they are the same ones, and of the mean
    share = np.sqrt(1.0 / np.outer(tissues, tissues)) + 1.0 / scatter.count
    values, vectors = np.linalg.eigh(known + _shrink(scatter.away) * share)
    whitening = (vectors / np.sqrt(values)) @ vectors.T
    none = np.zeros((len(tissues), 0))
    working = Likelihood(
        emulator, scatter.mean - means[0], error, whitening, none, np.zeros((0, 0)), _EXACT
    )
    return _student(working, known, share, tissues, scatter.away)


def _student(
    working: Likelihood, known: Array, share: Array, tissues: Array, away: Array
) -> Likelihood:
    """Return a likelihood whose covariance counts as estimated where the parameters move data."""
    shares, count = working.draws(FEW), len(away)
    white = working.predict(shares)[0] @ working.whitening.T
    _, sizes, vectors = np.linalg.svd(white - white.mean(axis=0), full_matrices=False)
    most = min(shares.shape[1], count - 3)
    along = int((sizes[:most] / np.sqrt(len(shares)) > _STILL).sum())
    directions = vectors[:along].T
    if along == 0:
        return working
    # how the parameters move the data themselves
    moved = np.linalg.solve(working.whitening, directions)
    scatter = np.zeros((along, along))
    for k in range(count):
        others = np.delete(away, k, axis=0)
        total = known + _shrink(others) * share
        weighted = np.linalg.solve(total, moved)
        estimate = np.linalg.solve(moved.T @ weighted, weighted.T)
        left_out = away[k] - others.mean(axis=0)  # of variance S (1 + 1/(R - 1))
        tissue, mean = estimate @ (left_out / np.sqrt(tissues)), estimate @ left_out
        scatter += np.outer(tissue, tissue) + np.outer(mean, mean) / count
    scatter *= (count - 1.0) / count**2
    weights = working.whitening.T @ directions
    spread = weights.T @ weights + scatter  # the emulator's error is added where it is used
    part = float(np.trace(scatter) / np.trace(spread))
    freedom = min((count - 1.0) / max(part, 1e-9) ** 2, _EXACT)
    left = freedom - along + 1.0
    return replace(working, directions=directions, spread=spread * freedom / left, freedom=left)
