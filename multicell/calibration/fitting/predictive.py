"""Predictive checks of a fit: replicated data, and the accuracy of prediction left out.

Given parameters θ, data minus mean m(θ) of runs are taken to be normal with the covariance C of
:mod:`~multicell.calibration.fitting.likelihood` at the best point: errors of measurement, scatter
of tissues and of the mean of fresh runs, error of the emulator.

- Posterior predictive checks (Gelman, Meng & Stern 1996, Statistica Sinica 6, 733) compare a
  discrepancy of the data with that of replicated data: χ² = r'C⁻¹r with r = m(θ) - y, and the
  largest |r| in standard deviations.
- The predictive score is Σ ln p(y_i | y_-i) over the data, each left out once. With K = C⁻¹,
  y_i | y_-i, θ is normal with deviation (K r)_i / K_ii and variance 1 / K_ii (Bürkner, Gabry &
  Vehtari 2021, Comput. Stat. 36, 1243); draws are weighted by 1 / p(y_i | y_-i, θ), the
  largest weights smoothed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, final

import numpy as np

from multicell.calibration.fitting.emulator import ENOUGH_DRAWS, best_of, draws
from multicell.calibration.fitting.verdict import quantiles
from multicell.calibration.shared.confidence import BAND
from multicell.measured.noise import Array

if TYPE_CHECKING:
    import pandas as pd

    from multicell.calibration.fitting.numbers import FitNumbers

_TAIL_PART, _TAIL_ROOTS = 0.2, 3.0
"""The tail of S draws that is smoothed: min(S / 5, 3 √S) (Vehtari et al. 2024, JMLR 25, 72)."""


@final
@dataclass(frozen=True, eq=False)
class PredictiveCheck:
    """Posterior predictive checks of a fit.

    - ``chi_squared``: probability that replicated data have a larger χ² than the data; near 0 where
      the model does not describe them, or their errors are larger than stated; near 1 where they
      are smaller
    - ``largest``: the same of the largest deviation of a single datum
    - ``table``: one row for each datum: ``measured``, ``low``, ``median`` and ``high`` of
      replicated data (95 %) in base units, and ``p``, the probability to be further out on either
      side
    """

    chi_squared: float
    largest: float
    table: pd.DataFrame

    @property
    def outside(self) -> int:
        """Number of data outside their 95 % interval."""
        low, high, value = (self.table[name] for name in ("low", "high", "measured"))
        return int(((value < low) | (value > high)).sum())


@final
@dataclass(frozen=True, eq=False)
class Predictive:
    """Draws of a posterior with the errors of what they predict, in σ of the data.

    - ``residuals``, (S, n): m(θ) - y
    - ``covariance``, (n, n): C
    - ``jacobian``, (n,): logarithm of σ, and of the value where logarithms are compared
    """

    residuals: Array
    covariance: Array
    jacobian: Array

    @cached_property
    def precision(self) -> Array:
        """The inverse of C, (n, n)."""
        return np.asarray(np.linalg.inv(self.covariance), dtype=np.float64)

    @cached_property
    def pointwise(self) -> Array:
        """Return ln p(y_i | y_-i, θ) for all draws and data, base units: (S, n)."""
        own = np.diag(self.precision)
        away = self.residuals @ self.precision
        return np.asarray(
            0.5 * (np.log(own) - math.log(2.0 * math.pi) - away**2 / own) - self.jacobian
        )

    @cached_property
    def scores(self) -> Array:
        """Return ln p(y_i | y_-i) of all data, (n,)."""
        logs = self.pointwise
        weights = np.apply_along_axis(_smoothed, 0, -logs)
        return np.asarray(np.log((weights * np.exp(logs)).sum(axis=0)))

    def log_likelihood(self, residuals: Array) -> float:
        """Return ln p(y | θ) for the m(θ) - y of some parameters, (n,); base units."""
        count = len(residuals)
        inner = residuals @ self.precision @ residuals + np.linalg.slogdet(self.covariance)[1]
        return float(-0.5 * (inner + count * math.log(2.0 * math.pi)) - self.jacobian.sum())

    def replicate(self, seed: int = 0) -> Array:
        """Return replicated data less the data, one set for each draw, in σ: (S, n)."""
        return self.residuals + self._errors(seed)

    def _errors(self, seed: int) -> Array:
        random = np.random.default_rng(seed)
        root = np.linalg.cholesky(self.covariance)
        return np.asarray(random.standard_normal(self.residuals.shape) @ root.T)

    def check(self, seed: int = 0) -> tuple[float, float]:
        """Return the probabilities of a larger χ², and of a larger single deviation."""
        from scipy import stats

        squares = np.einsum("si,ij,sj->s", self.residuals, self.precision, self.residuals)
        chi = stats.chi2.sf(squares, self.residuals.shape[1]).mean()
        deviation = np.sqrt(np.diag(self.covariance))
        own = np.abs(self.residuals / deviation).max(axis=1)
        other = np.abs(self._errors(seed) / deviation).max(axis=1)
        return float(chi), float((other >= own).mean())


def _smoothed(ratios: Array) -> Array:
    """Return the weights of draws from logarithms of their importance ratios, (S,); their sum is 1.

    The largest ratios are replaced by quantiles of a Pareto distribution that is fitted to them
    (Vehtari et al. 2024, JMLR 25, 72): one draw far out would outweigh all others.
    """
    from scipy.stats import genpareto

    sizes = np.exp(ratios - ratios.max())
    count = math.ceil(min(_TAIL_PART * len(sizes), _TAIL_ROOTS * math.sqrt(len(sizes))))
    order = np.argsort(sizes, kind="stable")
    largest, below = order[-count:], sizes[order[-count - 1]]
    beyond = sizes[largest] - below
    middle = float(np.median(beyond))
    if middle > 0.0:  # else the datum distinguishes no draws
        shape, _, scale = genpareto.fit(beyond / middle, 0.5, floc=0.0, scale=1.0)
        places = (np.arange(count) + 0.5) / count
        sizes[largest] = np.minimum(below + middle * genpareto.ppf(places, shape, scale=scale), 1.0)
    return np.asarray(sizes / sizes.sum())


def predictive_of(fit: FitNumbers) -> Predictive:
    """Return the predictions of a fit; raises FitFailed where it has no posterior."""
    shares = fit.some_sample()
    problem = fit.problem
    logs = np.array([math.log(d.value) if d.log else 0.0 for d in problem.measured.data])
    jacobian = np.log(problem.sigma) + logs
    known = fit.fresh.likelihood
    assert known is not None
    root = np.linalg.inv(known.whitening)
    return Predictive(known.predict(shares)[0], root @ root.T, jacobian)


def least_residuals(fit: FitNumbers, predictive: Predictive) -> Array:
    """Return m(θ) - y in σ where ln p(y | θ) is largest, (n,)."""
    known = fit.fresh.likelihood
    assert known is not None

    def loss(shares: Array) -> Array:
        r = known.predict(shares)[0]
        return np.asarray(np.einsum("si,ij,sj->s", r, predictive.precision, r))

    flat = replace(fit.problem.prior, densities=())
    best = best_of(loss, flat, draws(loss, flat, seed=0, count=ENOUGH_DRAWS))
    return np.asarray(known.predict(best[None])[0][0])


def predictive_check(fit: FitNumbers) -> PredictiveCheck:
    """Return the posterior predictive checks of a fit."""
    import pandas

    found = predictive_of(fit)
    problem = fit.problem
    again = np.maximum(found.replicate(), problem.lowest)
    above = (again > 0.0).mean(axis=0) + 0.5 * (again == 0.0).mean(axis=0)
    rows = quantiles(problem.observed + again * problem.sigma, BAND)
    low, median, high = map(problem.unscale, rows)
    about = pandas.DataFrame(fit.rows())[["row", "condition", "observable", "unit", "time"]]
    table = about.assign(
        measured=[d.value for d in problem.measured.data],
        low=low,
        median=median,
        high=high,
        p=2.0 * np.minimum(above, 1.0 - above),
    )
    chi_squared, largest = found.check()
    return PredictiveCheck(chi_squared, largest, table)
