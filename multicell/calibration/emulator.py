"""What runs would give between the parameters that were tried: Gaussian processes.

The mean over runs of each datum is a polynomial of second degree in the parameters (places in
their ranges) and what is beyond that: a Gaussian process with a Matern covariance of degree 5/2,
which follows the kink where a core begins. Both are one process, whose error grows away from the
points that were tried; data of one observable share its hyperparameters, which scikit-learn fits by
the marginal likelihood. Its white part takes what runs scatter between neighbouring points. The
synthetic likelihood of the processes (:mod:`multicell.calibration.distance`) gives the next points
that are worth a run, and with fresh runs an approximate posterior
(:mod:`multicell.calibration.likelihood`), at a hundredth of the cost of one sampled with runs.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from multicell.calibration.distance import Array
from multicell.calibration.noise import Noise

PARTICLES: Final = 2000  # draws from a posterior
FEW: Final = 500  # draws that are enough to see where a posterior is, if not where its tails end
_MOVES: Final = 8
_MAX_POINTS: Final = 100
"""Points that a process is fitted to, the nearest ones: its cost is their number cubed."""

Loss = Callable[[Array], Array]  # from parameters (k, d) to -2 ln L, (k,)


@final
@dataclass(frozen=True, eq=False)
class Process:
    """Gaussian processes of some data, which share their hyperparameters.

    - ``columns``, (m,): numbers of the data
    - ``fitted``: scikit-learn's ``GaussianProcessRegressor`` of the scaled values
    - ``centre``, ``width``, (m,): origin and scale of the values
    """

    columns: NDArray[np.int64]
    fitted: Any
    centre: Array
    width: Array

    def predict(self, shares: Array) -> tuple[Array, Array]:
        """Return means and variances of the smooth part for parameters (k, d): (k, m) each."""
        from scipy.linalg import solve_triangular

        smooth = self.fitted.kernel_.k1
        near = smooth(shares - 0.5, self.fitted.X_train_)
        held = solve_triangular(self.fitted.L_, near.T, lower=True, check_finite=False)
        variance = np.maximum(smooth.diag(shares - 0.5) - (held**2).sum(axis=0), 0.0)
        means = self.centre + self.width * (near @ self.fitted.alpha_)
        return means, variance[:, None] * self.width**2


@final
@dataclass(frozen=True, eq=False)
class Emulator:
    """Gaussian processes in place of runs.

    - ``processes``: one for each observable
    - ``lowest``, (n,): of (mean - datum) / σ: where the observable is 0 and cannot be negative;
      else -inf
    - ``scatter``, (n,): variance over runs and of their mean, s² (1 + 1/K) / σ²
    - ``noise``: of the data
    """

    processes: tuple[Process, ...]
    lowest: Array
    scatter: Array
    noise: Noise

    @property
    def dimensions(self) -> int:
        """Number of parameters."""
        return int(self.processes[0].fitted.n_features_in_)

    def predict(self, shares: Array) -> tuple[Array, Array]:
        """Return (mean - datum) / σ and its variance for parameters (k, d): (k, n) each."""
        means = np.empty((len(shares), len(self.lowest)))
        variances = np.empty_like(means)
        for process in self.processes:
            found = process.predict(shares)
            means[:, process.columns], variances[:, process.columns] = found
        return np.maximum(means, self.lowest), variances

    def means(self, shares: Array) -> Array:
        """Return (mean - datum) / σ for parameters (k, d): (k, n)."""
        return self.predict(shares)[0]

    def loss(self, shares: Array) -> Array:
        """Return -2 ln L for parameters (k, d), as if all data scattered independently: (k,)."""
        residuals, error = self.predict(shares)
        return self.noise.loss(residuals, self.scatter + error)


def emulator(
    shares: Array,
    residuals: Array,
    scatter: Array,
    loss: Array,
    *,
    observables: Sequence[str] | None = None,
    lowest: Array | None = None,
    noise: Noise | None = None,
) -> Emulator | None:
    """Return processes through the best of the points that were tried, None if these are too few.

    - ``shares``, (k, d): the points
    - ``residuals``, (k, n): (mean - datum) / σ; points with NaN are left out
    - ``scatter``, (k, n): s² (1 + 1/K) / σ²
    - ``loss``, (k,): -2 ln L of the runs
    - ``observables``: of the data; None: all are of one
    - ``lowest``, (n,): see :class:`Emulator`; None: no datum has a lowest value
    - ``noise``: of the data; None: independent errors
    """
    whole = np.isfinite(residuals).all(axis=1)
    shares, residuals, scatter, loss = (x[whole] for x in (shares, residuals, scatter, loss))
    if len(shares) < shares.shape[1] + 3:
        return None
    nearest = np.argsort(loss, kind="stable")[:_MAX_POINTS]
    names = np.array(observables or [""] * residuals.shape[1])
    processes = tuple(
        _process(shares[nearest], residuals[nearest], np.flatnonzero(names == name))
        for name in dict.fromkeys(names.tolist())
    )
    floor = np.full(residuals.shape[1], -np.inf) if lowest is None else lowest
    noise = noise or Noise.of_means(np.ones(residuals.shape[1]))
    return Emulator(processes, floor, _near_scatter(scatter, loss), noise)


def _process(shares: Array, residuals: Array, columns: NDArray[np.int64]) -> Process:
    """Return the processes of the data of one observable."""
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, DotProduct, Matern, WhiteKernel

    values = residuals[:, columns]
    centre, width = values.mean(axis=0), values.std(axis=0) + 1e-9
    lengths = np.full(shares.shape[1], 0.5)
    rough = ConstantKernel(1.0, (1e-10, 1e4)) * Matern(lengths, (0.05, 50.0), nu=2.5)
    parabola = ConstantKernel(100.0, "fixed") * DotProduct(1.0, "fixed") ** 2
    white = WhiteKernel(1e-4, (1e-9, 1.0))
    fitted = GaussianProcessRegressor(parabola + rough + white, alpha=1e-10)
    with warnings.catch_warnings():
        # a parameter without effect has its length at the upper bound
        warnings.simplefilter("ignore", ConvergenceWarning)
        fitted.fit(shares - 0.5, (values - centre) / width)
    fitted.alpha_ = fitted.alpha_.reshape(len(shares), len(columns))
    return Process(columns, fitted, centre, width)


def _near_scatter(scatter: Array, loss: Array) -> Array:
    """Return the mean scatter of the points that fit best."""
    above = loss - loss.min()
    # points within what the data can tell apart count fully
    reach = max(float(np.sort(above)[min(len(above), 12) - 1]), 9.0)
    weights = 1.0 / (1.0 + (above / reach) ** 4)
    return np.asarray(np.average(scatter, axis=0, weights=weights), dtype=float)


def draws(loss: Loss, dimensions: int, seed: int, count: int = PARTICLES) -> Array:
    """Return draws from a posterior under a uniform prior: (count, d), of equal weight.

    Sequential Monte Carlo: the likelihood's power rises from 0 to 1 so that half of the draws
    stay effective, and between two powers the draws move by random-walk Metropolis steps.
    """
    random = np.random.default_rng(seed)
    found = random.random((count, dimensions))
    losses = loss(found)
    power = 0.0
    while power < 1.0:
        step = _step(losses, 1.0 - power)
        power = 1.0 if step >= 1.0 - power else power + step
        chosen = _resample(_weights(losses, step), random)
        found, losses = _move(loss, found[chosen], losses[chosen], power, random)
    return found


def best_of(loss: Loss, found: Array) -> Array:
    """Return the parameters of least loss, (d,), descended to from the best of some draws."""
    from scipy.optimize import minimize

    start = found[np.argmin(loss(found))]
    down = minimize(
        lambda x: float(loss(x[None])[0]), start, method="L-BFGS-B",
        bounds=[(0.0, 1.0)] * len(start),
    )  # fmt: skip
    return np.asarray(down.x, dtype=float)


def _move(
    loss: Loss, found: Array, losses: Array, power: float, random: np.random.Generator
) -> tuple[Array, Array]:
    """Return draws after Metropolis steps at a power of the likelihood."""
    dimensions = found.shape[1]
    spread = np.atleast_2d(np.cov(found.T)) + 1e-12 * np.eye(dimensions)
    root = np.linalg.cholesky(spread) * 2.38 / np.sqrt(dimensions)
    for _ in range(_MOVES):
        tried = found + random.standard_normal(found.shape) @ root.T
        inside = ((tried >= 0.0) & (tried <= 1.0)).all(axis=1)
        there = np.full(len(found), np.inf)
        there[inside] = loss(tried[inside])
        accepted = np.log(random.random(len(found))) < 0.5 * power * (losses - there)
        found = np.where(accepted[:, None], tried, found)
        losses = np.where(accepted, there, losses)
    return found, losses


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


def _resample(weights: Array, random: np.random.Generator) -> NDArray[np.intp]:
    """Return rows drawn systematically by their weights."""
    count = len(weights)
    places = (random.random() + np.arange(count)) / count
    return np.minimum(np.searchsorted(np.cumsum(weights), places), count - 1)
