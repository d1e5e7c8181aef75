"""Emulator of runs between the parameters that were tried: Gaussian processes.

The mean over runs of each datum is a polynomial of second degree in the parameters (places in
their ranges) and what is beyond that: a Gaussian process with a Matern covariance of degree 5/2.
Both are one process, whose error grows away from the points that were tried; data of one observable
share its hyperparameters, which are fitted by the marginal likelihood. Its white part takes what
runs scatter between neighbouring points.

A quantity that cannot be negative, such as the radius of a core, has a kink where it begins. There
the process is of a signed quantity behind it, which is the reading where that is above zero, and of
which a reading of zero says only that it is not (Tobin 1958, Econometrica 26, 24). What such
readings say is approximated by expectation propagation (Minka 2001, UAI 17, 362), one Gaussian
factor each; means and variances of readings are those of the signed quantity cut off at zero. Where
the readings above zero leave a reading of zero no room, the white part grows until both are likely.

The synthetic likelihood of the processes (:mod:`~multicell.calibration.fitting.problem`) gives the
next points that are worth a run, and with fresh runs an approximate posterior
(:mod:`~multicell.calibration.fitting.likelihood`), at a hundredth of the cost of one sampled with
runs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from multicell.calibration.fitting.priors import Prior
from multicell.measured.noise import Array, Noise

PARTICLES: Final = 2000  # draws from a posterior
ENOUGH_DRAWS: Final = 500  # to see where a posterior is, if not where its tails end
_MOVES: Final = 8  # Metropolis steps of all particles at each power
_MAX_POINTS: Final = 100
"""Points that a process is fitted to, the nearest ones: its cost is their number cubed."""
_ABOVE: Final = 3  # readings above zero without which nothing is known of what is behind them
_JITTER: Final = 1e-10  # of the diagonal of covariances, in variances of the values
_DIFFERENCE: Final = 1e-7  # step of slopes, in parts of a range
_SWEEPS: Final = 60  # of expectation propagation, at most
_OLD, _NEW = 0.3, 0.7  # parts of the factors before and found in a sweep: undamped they may swing
_SETTLED: Final = 1e-4  # change of precisions, over the largest, that ends the sweeps
_TELLING: Final = 1e-8  # precision below which a reading says nothing
_POSITIVE: Final = 1e-12  # least variance and precision, where rounding leaves none
_WALK: Final = 2.38
"""Size of Metropolis steps, over √d standard deviations: the best one for a normal posterior in
many dimensions d (Gelman, Roberts & Gilks 1996, Bayesian Statistics 5, 599)."""
_DENIED: Final = 4.0
"""Standard deviations above zero at which the readings around a reading of zero deny it."""

Loss = Callable[[Array], Array]  # from parameters (k, d) to -2 ln L, (k,)
Mask = NDArray[np.bool_]


@final
@dataclass(frozen=True, eq=False)
class GaussianProcesses:
    """Gaussian processes of some data that the same points say something of.

    - ``data``, (m,): numbers of the data
    - ``points``, (p,): numbers of these points
    - ``root``, (p, p): lower Cholesky factor of their covariance
    - ``weights``, (p, m): inverse covariance times values
    - ``centre``, ``width``, (m,): origin and scale of the values
    """

    data: NDArray[np.int64]
    points: NDArray[np.int64]
    root: Array
    weights: Array
    centre: Array
    width: Array


@final
@dataclass(frozen=True, eq=False)
class Process:
    """Gaussian processes of the data of one observable, which share their hyperparameters.

    - ``smooth``: scikit-learn's kernel of all but the white part
    - ``points``, (k, d): where runs were made
    - ``columns``: of all data
    """

    smooth: Any
    points: Array
    columns: tuple[GaussianProcesses, ...]

    def predict(self, shares: Array, means: Array, variances: Array) -> None:
        """Fill in the columns of means and variances of the smooth part for parameters (k, d)."""
        from scipy.linalg import solve_triangular

        near, prior = self.smooth(shares - 0.5, self.points), self.smooth.diag(shares - 0.5)
        for column in self.columns:
            own = near[:, column.points]
            known = solve_triangular(column.root, own.T, lower=True, check_finite=False)
            left = np.maximum(prior - (known**2).sum(axis=0), 0.0)
            means[:, column.data] = column.centre + column.width * (own @ column.weights)
            variances[:, column.data] = left[:, None] * column.width**2


@final
@dataclass(frozen=True, eq=False)
class Emulator:
    """Gaussian processes in place of runs.

    - ``processes``: one for each observable
    - ``lowest``, (n,): of (mean - datum) / σ: where the observable is 0 and cannot be negative;
      else -inf
    - ``scatter``, (n,): variance over runs and of their mean, s² (1 + 1/K) / σ²
    - ``noise``: of the data
    - ``prior``: of the parameters
    - ``shares``, (k, d), ``residuals``, (k, n): points, and (mean - datum) / σ there
    """

    processes: tuple[Process, ...]
    lowest: Array
    scatter: Array
    noise: Noise
    prior: Prior
    shares: Array
    residuals: Array

    def predict(self, shares: Array) -> tuple[Array, Array]:
        """Return (mean - datum) / σ and its variance for parameters (k, d): (k, n) each."""
        means = np.empty((len(shares), len(self.lowest)))
        variances = np.empty_like(means)
        for process in self.processes:
            process.predict(shares, means, variances)
        return _cut_off(means, variances, self.lowest)

    def means(self, shares: Array) -> Array:
        """Return (mean - datum) / σ for parameters (k, d): (k, n)."""
        return self.predict(shares)[0]

    def loss(self, shares: Array) -> Array:
        """Return -2 ln L for parameters (k, d), as if all data scattered independently: (k,)."""
        residuals, error = self.predict(shares)
        return self.noise.loss(residuals, self.scatter + error)


def _cut_off(means: Array, variances: Array, lowest: Array) -> tuple[Array, Array]:
    """Return means and variances of normal numbers whose values below a lowest one are that one."""
    from scipy.special import ndtr

    deviation = np.sqrt(variances)
    near = means < lowest + 8.0 * deviation  # elsewhere nothing is cut off
    above = (means - lowest)[near]
    sd = np.maximum(deviation[near], 1e-12)
    chance, density = ndtr(above / sd), np.exp(-0.5 * (above / sd) ** 2) / np.sqrt(2.0 * np.pi)
    mean = above * chance + sd * density
    square = (above**2 + sd**2) * chance + above * sd * density
    means[near] = np.broadcast_to(lowest, means.shape)[near] + np.maximum(mean, 0.0)
    variances[near] = np.maximum(square - mean**2, 0.0)
    return means, variances


def emulator(
    shares: Array,
    residuals: Array,
    scatter: Array,
    loss: Array,
    *,
    observables: Sequence[str] | None = None,
    lowest: Array | None = None,
    noise: Noise | None = None,
    prior: Prior | None = None,
) -> Emulator | None:
    """Return processes through the best of the points that were tried, None if these are too few.

    - ``shares``, (k, d): the points
    - ``residuals``, (k, n): (mean - datum) / σ; points with NaN are left out
    - ``scatter``, (k, n): s² (1 + 1/K) / σ²
    - ``loss``, (k,): -2 ln L of the runs
    - ``observables``: of the data; None: all are of one
    - ``lowest``, (n,): see :class:`Emulator`; None: no datum has a lowest value
    - ``noise``: of the data; None: independent errors
    - ``prior``: of the parameters; None: uniform
    """
    whole = np.isfinite(residuals).all(axis=1)
    shares, residuals, scatter, loss = (x[whole] for x in (shares, residuals, scatter, loss))
    if len(shares) < shares.shape[1] + 3:
        return None
    nearest = np.argsort(loss, kind="stable")[:_MAX_POINTS]
    names = np.array(observables or [""] * residuals.shape[1])
    floor = np.full(residuals.shape[1], -np.inf) if lowest is None else lowest
    processes = tuple(
        _process(shares[nearest] - 0.5, residuals[nearest], np.flatnonzero(names == name), floor)
        for name in dict.fromkeys(names.tolist())
    )
    return Emulator(
        processes,
        floor,
        _near_scatter(scatter, loss),
        noise or Noise.of_means(np.ones(residuals.shape[1])),
        Prior(shares.shape[1]) if prior is None else prior,
        shares[nearest],
        residuals[nearest],
    )


def _process(points: Array, residuals: Array, numbers: NDArray[np.int64], lowest: Array) -> Process:
    """Return the processes of the data of one observable."""
    from scipy.linalg import cho_solve, cholesky

    values, lowest = residuals[:, numbers], lowest[numbers]
    hidden: Mask = values <= lowest + 1e-9
    hidden &= (~hidden).sum(axis=0) >= _ABOVE
    seen = np.ma.masked_array(values, hidden)
    centre, width = np.asarray(seen.mean(axis=0)), np.asarray(seen.std(axis=0)) + 1e-9
    values, lowest = (values - centre) / width, (lowest - centre) / width
    patterns: dict[bytes, list[int]] = {}
    for k, column in enumerate(hidden.T):
        patterns.setdefault(column.tobytes(), []).append(k)
    groups = [np.array(group) for group in patterns.values()]
    kernel = _kernel(points, values, [(~hidden[:, group[0]], group) for group in groups])
    kernel = _with_zeros(kernel, points, values, hidden, lowest)
    covariance = kernel(points) + _JITTER * np.eye(len(points))
    columns = []
    for group in groups:
        # of readings of zero each datum has its own covariance
        for own in [group] if not hidden[:, group[0]].any() else group[:, None]:
            used, targets, noise = _targets(
                covariance, values[:, own], hidden[:, own[0]], float(lowest[own[0]])
            )
            root = cholesky(covariance[np.ix_(used, used)] + np.diag(noise), lower=True)
            weights = cho_solve((root, True), targets)
            columns.append(
                GaussianProcesses(numbers[own], used, root, weights, centre[own], width[own])
            )
    return Process(kernel.k1, points, tuple(columns))


def _kernel(points: Array, values: Array, groups: Sequence[tuple[Mask, NDArray[np.int64]]]) -> Any:
    """Return the kernel of largest marginal likelihood of the values that are seen.

    - ``points``, (k, d), ``values``, (k, m)
    - ``groups``: data and the points where they are seen
    """
    from scipy.linalg import cho_solve, cholesky
    from scipy.optimize import minimize
    from sklearn.gaussian_process.kernels import ConstantKernel, DotProduct, Matern, WhiteKernel

    rough = ConstantKernel(1.0, (1e-10, 1e4))
    rough *= Matern(np.full(points.shape[1], 0.5), (0.05, 50.0), nu=2.5)
    parabola = ConstantKernel(100.0, "fixed") * DotProduct(1.0, "fixed") ** 2
    kernel = parabola + rough + WhiteKernel(1e-4, (1e-9, 1.0))

    def loss(theta: Array) -> tuple[float, Array]:
        covariance, slope = kernel.clone_with_theta(theta)(points, eval_gradient=True)
        total, down = 0.0, np.zeros(len(theta))
        for seen, group in groups:
            own = np.ix_(seen, seen)
            count = int(seen.sum())
            try:
                root = cholesky(covariance[own] + _JITTER * np.eye(count), lower=True)
            except np.linalg.LinAlgError:
                return 1e25, np.zeros(len(theta))
            weights = cho_solve((root, True), values[np.ix_(seen, group)])
            total += 0.5 * float((values[np.ix_(seen, group)] * weights).sum())
            total += len(group) * float(np.log(np.diag(root)).sum())
            outer = weights @ weights.T - len(group) * cho_solve((root, True), np.eye(count))
            down -= 0.5 * np.einsum("ij,ijk->k", outer, slope[own])
        return total, down

    found = minimize(loss, kernel.theta, jac=True, method="L-BFGS-B", bounds=kernel.bounds)
    return kernel.clone_with_theta(found.x)


def _with_zeros(kernel: Any, points: Array, values: Array, hidden: Mask, lowest: Array) -> Any:
    """Return a kernel whose white part is large enough for the readings of zero.

    - ``points``, (k, d), ``values``, ``hidden``, (k, m), ``lowest``, (m,)

    Kernels are fitted to what is seen. If that denies a zero, both would be forced through the same
    points and expectation propagation has no solution: the white part is then the one of largest
    likelihood of both, each zero taken for itself.
    """
    from scipy.linalg import cho_factor, cho_solve
    from scipy.optimize import minimize_scalar
    from scipy.special import log_ndtr

    white, smooth = kernel.k2.noise_level, kernel.k1(points)
    data = np.flatnonzero(hidden.any(axis=0))

    def heights(white: float) -> tuple[Array, float]:
        """Return deviations by which zeros are denied, and -ln L of all other readings."""
        covariance = smooth + (white + _JITTER) * np.eye(len(points))
        found, total = [], 0.0
        for k in data:
            zero, seen = hidden[:, k], ~hidden[:, k]
            factor = cho_factor(covariance[np.ix_(seen, seen)], lower=True)
            across = covariance[np.ix_(seen, zero)]
            weights = cho_solve(factor, values[seen, k])
            known = (across * cho_solve(factor, across)).sum(axis=0)
            left = np.maximum(covariance[zero, zero] - known, white + _JITTER)
            found.append((across.T @ weights - lowest[k]) / np.sqrt(left))
            total += 0.5 * float(values[seen, k] @ weights) + np.log(np.diag(factor[0])).sum()
        return np.concatenate(found) if found else np.zeros(0), total

    if heights(white)[0].max(initial=0.0) <= _DENIED:
        return kernel

    def loss(log_white: float) -> float:
        above, total = heights(float(np.exp(log_white)))
        return total - float(log_ndtr(-above).sum())

    # no scatter is needed that exceeds the distance of the highest reading from zero
    most = 2.0 * np.log(np.abs(values[:, data] - lowest[data]).max())
    best = minimize_scalar(loss, bounds=(np.log(white), most), method="bounded").x
    return kernel.clone_with_theta(np.append(kernel.theta[:-1], best))


def _targets(
    covariance: Array, values: Array, hidden: Mask, lowest: float
) -> tuple[NDArray[np.int64], Array, Array]:
    """Return the points that say something, values that a process goes through, and their noise.

    - ``covariance``, (k, k): of the points, the white part included
    - ``values``, (k, m): at hidden points they are not above ``lowest``, and m is 1

    Where they are seen these are the values without noise; where not, the factors of expectation
    propagation.
    """
    from scipy.special import erfcx

    noise = np.zeros(len(hidden))
    if not hidden.any():
        return np.arange(len(hidden)), values, noise
    across = covariance[np.ix_(~hidden, hidden)]
    part = np.linalg.solve(covariance[np.ix_(~hidden, ~hidden)], across).T
    mean, spread = part @ values[~hidden, 0], covariance[np.ix_(hidden, hidden)] - part @ across
    precision, shift = np.zeros(len(mean)), np.zeros(len(mean))
    for _ in range(_SWEEPS):
        root = np.sqrt(precision)
        inner = np.linalg.solve(
            np.eye(len(mean)) + root[:, None] * spread * root, root[:, None] * spread
        )
        after = spread - (spread * root) @ inner
        variance = np.maximum(np.diag(after), _POSITIVE)
        without = 1.0 / np.maximum(1.0 / variance - precision, _POSITIVE)
        centre = without * ((mean + after @ (shift - precision * mean)) / variance - shift)
        # moments of a normal number that is not above the lowest one
        place = (lowest - centre) / np.sqrt(without)
        ratio = np.sqrt(2.0 / np.pi) / erfcx(-place / np.sqrt(2.0))
        cut = without * np.maximum(1.0 - ratio * (place + ratio), 1e-6)
        wanted = np.maximum(1.0 / cut - 1.0 / without, 0.0)
        pulled = (centre - np.sqrt(without) * ratio) / cut - centre / without
        change = np.abs(wanted - precision).max()
        precision = _OLD * precision + _NEW * wanted
        shift = _OLD * shift + _NEW * pulled
        if change <= _SETTLED * precision.max():
            break
    telling = precision > _TELLING
    targets, used = values.copy(), ~hidden
    places = np.flatnonzero(hidden)[telling]
    used[places] = True
    noise[places] = 1.0 / precision[telling]
    targets[places, 0] = shift[telling] / precision[telling]
    return np.flatnonzero(used), targets[used], noise[used]


def _near_scatter(scatter: Array, loss: Array) -> Array:
    """Return the mean scatter of the points that fit best."""
    above = loss - loss.min()
    # points that the data cannot distinguish count fully
    reach = max(float(np.sort(above)[min(len(above), 12) - 1]), 9.0)
    weights = 1.0 / (1.0 + (above / reach) ** 4)
    return np.asarray(np.average(scatter, axis=0, weights=weights), dtype=float)


def draws(loss: Loss, prior: Prior, seed: int, count: int = PARTICLES) -> Array:
    """Return draws from a posterior: (count, d), of equal weight.

    Sequential Monte Carlo: the likelihood's power rises from 0 to 1 so that half of the draws
    stay effective, and between two powers the draws move by random-walk Metropolis steps.
    """
    random = np.random.default_rng(seed)
    found = prior.draw(random, count)
    losses = loss(found)
    power = 0.0
    while power < 1.0:
        rise = _step(losses, 1.0 - power)
        power = 1.0 if rise >= 1.0 - power else power + rise
        places = (random.random() + np.arange(count)) / count  # systematic resampling
        rows = np.searchsorted(np.cumsum(_weights(losses, rise)), places)
        chosen = np.minimum(rows, count - 1)
        found, losses = _move(loss, prior, found[chosen], losses[chosen], power, random)
    return found


def best_of(loss: Loss, prior: Prior, found: Array) -> Array:
    """Return the parameters of least loss and prior, (d,), descended to from the best of some."""

    def value_and_slope(x: Array) -> tuple[float, Array]:
        steps = np.where(x < 0.5, _DIFFERENCE, -_DIFFERENCE)
        points = np.vstack([x, x + np.diag(steps)])
        found = loss(points) + prior.density_loss(points)
        return float(found[0]), (found[1:] - found[0]) / steps

    start = found[np.argmin(loss(found) + prior.loss(found))]
    return prior.constraints.descend(value_and_slope, start, range(len(start)))


def _move(
    loss: Loss,
    prior: Prior,
    found: Array,
    losses: Array,
    power: float,
    random: np.random.Generator,
) -> tuple[Array, Array]:
    """Return draws after Metropolis steps at a power of the likelihood."""
    dimensions = found.shape[1]
    spread = np.atleast_2d(np.cov(found.T)) + 1e-12 * np.eye(dimensions)
    root = np.linalg.cholesky(spread) * _WALK / np.sqrt(dimensions)
    before = prior.loss(found)
    for _ in range(_MOVES):
        tried = found + random.standard_normal(found.shape) @ root.T
        here = prior.loss(tried)
        inside = np.isfinite(here)
        there = np.full(len(found), np.inf)
        there[inside] = loss(tried[inside])
        gain = 0.5 * power * (losses - there) + 0.5 * (before - here)
        accepted = np.log(random.random(len(found))) < gain
        found = np.where(accepted[:, None], tried, found)
        losses, before = np.where(accepted, there, losses), np.where(accepted, here, before)
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
