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

Fits of several models to one table are compared by this score, and by AIC = -2 ln L + 2 k, AICc,
which adds 2 k (k + 1) / (n - k - 1), and BIC, which has k ln n in place of 2 k (Burnham & Anderson
2002, Model Selection and Multimodel Inference). L is the likelihood at its largest value, for n
data and k parameters. The scatter of tissues is estimated from some dozen runs of each model; one
covariance for all of them, the mean, keeps the error of its determinant from deciding between
models.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, final

import numpy as np

from multicell.calibration.fitting.emulator import ENOUGH_DRAWS, best_of, draws
from multicell.calibration.fitting.priors import Prior
from multicell.calibration.fitting.verdict import quantiles
from multicell.errors import SceneError
from multicell.host.extras import needs
from multicell.measured.noise import Array

if TYPE_CHECKING:
    import pandas as pd

    from multicell.calibration.fitting.fitted import Fit


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
    count = math.ceil(min(0.2 * len(sizes), 3.0 * math.sqrt(len(sizes))))
    order = np.argsort(sizes, kind="stable")
    largest, below = order[-count:], sizes[order[-count - 1]]
    beyond = sizes[largest] - below
    middle = float(np.median(beyond))
    if middle > 0.0:  # else the datum tells no draws apart
        shape, _, scale = genpareto.fit(beyond / middle, 0.5, floc=0.0, scale=1.0)
        places = (np.arange(count) + 0.5) / count
        sizes[largest] = np.minimum(below + middle * genpareto.ppf(places, shape, scale=scale), 1.0)
    return np.asarray(sizes / sizes.sum())


def predictive_of(fit: Fit) -> Predictive:
    """Return the predictions of a fit; raises FitFailed where it has no posterior."""
    shares = fit.some_sample()
    problem = fit.problem
    logs = np.array([math.log(d.value) if d.log else 0.0 for d in problem.measured.data])
    jacobian = np.log(problem.sigma) + logs
    known = fit.fresh.likelihood
    assert known is not None
    root = np.linalg.inv(known.whitening)
    return Predictive(known.predict(shares)[0], root @ root.T, jacobian)


def least_residuals(fit: Fit, predictive: Predictive) -> Array:
    """Return m(θ) - y in σ where ln p(y | θ) is largest, (n,)."""
    known = fit.fresh.likelihood
    assert known is not None

    def loss(shares: Array) -> Array:
        r = known.predict(shares)[0]
        return np.asarray(np.einsum("si,ij,sj->s", r, predictive.precision, r))

    flat = Prior(len(fit.problem.ranges))
    best = best_of(loss, flat, draws(loss, flat, seed=0, count=ENOUGH_DRAWS))
    return np.asarray(known.predict(best[None])[0][0])


def predictive_check(fit: Fit) -> PredictiveCheck:
    """Return the posterior predictive checks of a fit."""
    import pandas

    found = predictive_of(fit)
    problem = fit.problem
    again = np.maximum(found.replicate(), problem.lowest)
    above = (again > 0.0).mean(axis=0) + 0.5 * (again == 0.0).mean(axis=0)
    rows = quantiles(problem.observed + again * problem.sigma, (0.025, 0.5, 0.975))
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


def compare_fits(fits: Mapping[str, Fit]) -> pd.DataFrame:
    """Compare fits to the same data.

    Parameters
    ----------
    fits
        Name -> fit.

    Returns
    -------
    pandas.DataFrame
        A row for each, the best predictive score first: ``parameters`` and ``data`` (numbers),
        ``log_likelihood`` at best, ``aic``, ``aicc``, ``bic``, ``score`` (Σ ``ln p(y_i | y_-i)``,
        the larger the better) with its standard error ``score_error``, ``behind`` (what is missing
        to the best score) with its standard error ``behind_error``, which is that of the
        differences datum by datum.

    Raises
    ------
    SceneError
        If there are fewer than two, or data differ.
    FitFailed
        If one of them has no posterior.
    """
    needs("pandas")
    import pandas

    if not isinstance(fits, Mapping) or len(fits) < 2:
        raise SceneError("fits", "must have at least two fits", "Give {'name': fit, ...}.")
    (first, one), *others = fits.items()
    for name, other in others:
        if _key(one) != _key(other):
            problem = f"has '{first}' and '{name}', which are to different data"
            hint = "Scores and likelihoods compare only where all data and their errors are equal."
            raise SceneError("fits", problem, hint)
    found = {name: predictive_of(fit) for name, fit in fits.items()}
    common = np.mean([each.covariance for each in found.values()], axis=0)
    rows = {}
    for name, fit in fits.items():
        found[name] = replace(found[name], covariance=common)
        count, free = len(fit.problem.sigma), len(fit.problem.ranges)
        largest = found[name].log_likelihood(least_residuals(fit, found[name]))
        left = count - free - 1
        aic = 2.0 * (free - largest)
        rows[name] = {
            "parameters": free,
            "data": count,
            "log_likelihood": largest,
            "aic": aic,
            "aicc": aic + 2.0 * free * (free + 1) / left if left > 0 else math.nan,
            "bic": free * math.log(count) - 2.0 * largest,
            **dict(zip(("score", "score_error"), _sum(found[name].scores), strict=True)),
        }
    best = max(rows, key=lambda name: rows[name]["score"])
    for name, row in rows.items():
        missing = _sum(found[best].scores - found[name].scores)
        row.update(zip(("behind", "behind_error"), missing, strict=True))
    table = pandas.DataFrame.from_dict(rows, orient="index")
    table.index.name = "model"
    return table.sort_values("score", ascending=False)


def _sum(values: np.ndarray) -> tuple[float, float]:
    """Return the sum of some values, and its standard error."""
    spread = values.std(ddof=1) if len(values) > 1 else math.nan
    return float(values.sum()), float(math.sqrt(len(values)) * spread)


def _key(fit: Fit) -> list[tuple[object, ...]]:
    """Return all that the likelihood takes from data."""
    measured = fit.problem.measured
    return [
        (
            d.observable,
            d.value,
            d.sigma,
            d.log,
            d.time,
            d.depth,
            d.tissues,
            d.specimens,
            sorted(measured.conditions[d.condition].changes.items(), key=str),
        )
        for d in measured.data
    ]
