"""The likelihood behind the intervals of a search: fresh runs, and a full covariance from them.

All points of a search have the same seeds, so that its best point leans towards what these seeds
happen to do, and readings of one run scatter together: a tissue that is large at one time is large
at the next. So R runs with fresh seeds are made at the best point. With their mean m and their
covariance S, all in σ of the data,

    C = errors + S shared + S/R + E

is the covariance of data minus mean (:mod:`multicell.measured.noise`), of which the emulator's
error E depends on the parameters. The emulator is shifted so that it has the mean m at the best
point.

S has R - 1 degrees of freedom, often fewer than there are data. It serves twice. The data are
weighted by the inverse of C with S shrunk (Ledoit & Wolf 2004, J. Multivariate Anal. 88, 365, of
its correlations; at least by a tenth), which decides how well parameters are determined and not
whether intervals are right. Weighted so, the scatter along the few directions in which the
parameters move the data has a covariance V of that many dimensions. It is estimated without
shrinkage, and each run with weights in which it had no part: weights seek out what happens to
scatter little in the runs that they come from, which would make V too small. The likelihood along
these directions is Hotelling's, a multivariate Student's with ν - k + 1 degrees of freedom for k
directions; ν is R - 1, or more where errors of measurement, which are known, make most of V
(Satterthwaite). The other directions, in which all parameters are alike except for curvature, count
as normal.

Runs at draws from the intervals check the emulator where it is used (:func:`fresh`): where it is
further off at a datum than scatter and its own error explain, that error is raised to what was
found, and the intervals are drawn again. Of data that jump the likelihood is that of a mosaic
(:mod:`~multicell.calibration.fitting.mosaic`), which these runs then join.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np
from scipy.linalg import eigh

from multicell.calibration.fitting.emulator import ENOUGH_DRAWS, PARTICLES, Emulator, best_of, draws
from multicell.calibration.fitting.mosaic import Mosaic, mosaic, mosaic_of
from multicell.calibration.fitting.pool import Pool
from multicell.calibration.fitting.problem import FitProblem, misfit
from multicell.calibration.fitting.search import Evaluation, Search
from multicell.calibration.fitting.unknown_scatter import with_scatter
from multicell.measured.noise import Array, Noise, shrink

MIN_REPEATS: Final = 4  # fresh runs of which a covariance can be estimated
_STILL: Final = 0.02
"""Standard deviations below which a direction of the data does not depend on the parameters."""
_EXACT: Final = 1e6  # degrees of freedom that stand for a variance that is known


@final
@dataclass(frozen=True, eq=False)
class Scatter:
    """Residuals of fresh runs at one point, in σ of the data.

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
    - ``mosaic``: of data that jump, in place of the processes and of C; else None
    """

    emulator: Emulator
    shift: Array
    error: Array
    whitening: Array
    directions: Array
    spread: Array
    freedom: float
    mosaic: Mosaic | None = None

    def predict(self, shares: Array) -> tuple[Array, Array]:
        """Return (mean - datum) / σ and the variance of its error for parameters (k, d)."""
        if self.mosaic is not None:
            return self.mosaic.predict(shares)
        means, variances = self.emulator.predict(shares)
        return np.maximum(means + self.shift, self.emulator.lowest), variances + self.error

    def loss(self, shares: Array) -> Array:
        """Return -2 ln L up to a constant for parameters (k, d): (k,)."""
        if self.mosaic is not None:
            return self.mosaic.loss(shares)
        return self.loss_of(*self.predict(shares))

    def loss_of(self, means: Array, variances: Array) -> Array:
        """Return -2 ln L for (mean - datum) / σ and the variances of their errors, (k, n): (k,).

        A mosaic has no part in it.
        """
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
    emulator: Emulator, noise: Noise, best: Array, scatter: Scatter, error: Array | float = 0.0
) -> Likelihood:
    """Return the likelihood with the scatter of fresh runs at the best point.

    - ``emulator``: of the search
    - ``noise``: of the data
    - ``best``, (d,): where the fresh runs were made
    - ``scatter``: what they show
    - ``error``, (n,): variance that check runs have found beyond the emulator's own, in σ²
    """
    means, variances = emulator.predict(best[None])
    error = np.broadcast_to(np.asarray(error, dtype=float), scatter.mean.shape)
    share = noise.shared + 1.0 / scatter.count
    # scatter of the tissues, and of the mean
    total = noise.errors + np.diag(variances[0] + error) + shrink(scatter.away) * share
    values, vectors = np.linalg.eigh(total)
    whitening = (vectors / np.sqrt(values)) @ vectors.T
    none = np.zeros((len(total), 0))
    working = Likelihood(
        emulator, scatter.mean - means[0], error, whitening, none, np.zeros((0, 0)), _EXACT
    )
    return _student(working, noise, noise.errors + np.diag(variances[0] + error), scatter.away)


def _student(working: Likelihood, noise: Noise, known: Array, away: Array) -> Likelihood:
    """Return a likelihood whose covariance counts as estimated where the parameters move data."""
    shares, count = working.draws(ENOUGH_DRAWS), len(away)
    white = working.predict(shares)[0] @ working.whitening.T
    _, sizes, vectors = np.linalg.svd(white - white.mean(axis=0), full_matrices=False)
    most = min(shares.shape[1], count - 3)
    along = int((sizes[:most] / np.sqrt(len(shares)) > _STILL).sum())
    directions = vectors[:along].T
    if along == 0:
        return working
    # how the parameters move the data themselves
    moved = np.linalg.solve(working.whitening, directions)
    share = noise.shared + 1.0 / count
    scatter = np.zeros((along, along))
    for k in range(count):
        others = np.delete(away, k, axis=0)
        total = known + shrink(others) * share
        weighted = np.linalg.solve(total, moved)
        estimate = np.linalg.solve(moved.T @ weighted, weighted.T)
        left_out = away[k] - others.mean(axis=0)  # of variance S (1 + 1/(R - 1))
        scatter += estimate @ (np.outer(left_out, left_out) * share) @ estimate.T
    scatter *= (count - 1.0) / count**2
    weights = working.whitening.T @ directions
    # the emulator's error is added where it is used
    spread = weights.T @ noise.errors @ weights + scatter
    uncertain = spent = float(np.trace(scatter) / np.trace(spread)) ** 2 / (count - 1.0)
    if noise.freedom < _EXACT:  # errors known from specimens, along what depends on them most; one
        # variance, unlike a covariance, loses none of its degrees of freedom to directions
        part = weights.T @ (noise.errors @ weights)
        way = eigh(part, spread)[1][:, -1]  # along which the spread is 1
        uncertain += (way @ part @ way) ** 2 / (noise.freedom + along - 1.0)
    freedom = min(1.0 / max(uncertain, 1e-12), _EXACT)
    left = freedom - along + 1.0
    wider = freedom / left
    if noise.residual:  # one variance of residuals widens all directions alike
        wider = 1.0 + (wider - 1.0) * spent / uncertain
    return replace(working, directions=directions, spread=spread * wider, freedom=left)


DEFAULT_REPEATS: Final = 12  # fresh runs at the best point
MAX_REPEATS: Final = 1000  # most of them
CHECKS: Final = 6  # draws from the intervals that are run
_CHANCE: Final = 0.01  # chance at which a check finds an error at a datum that is none
_NOTHING: Final = 1e-3  # of σ, by which runs and emulators may differ without account


@final
@dataclass(frozen=True, eq=False)
class Checks:
    """Checks of the emulator by runs at draws from the intervals, in σ of the data, (n,) each.

    - ``found``: root mean square of run less emulator
    - ``expected``: what scatter of runs and the emulator's own error explain of it
    - ``off``: where it is more than chance explains; nowhere of a mosaic, whose own these runs are
    """

    found: Array
    expected: Array
    off: Array


@final
@dataclass(frozen=True, eq=False)
class Fresh:
    """Fresh runs at the best point, summarised.

    - ``shares``, (d,): the best point
    - ``runs``, (R, n): readings there, on the scales of the data; NaN where a run has nothing
    - ``reasons``: why runs failed
    - ``scatter``: their mean and covariance; None of fewer than four whole runs
    - ``likelihood``: of the parameters; None without an emulator or without scatter
    - ``checks``: of the emulator; None without a likelihood
    - ``missed``: whether the emulator's best point was worse than one that had run, which is then
      the best, by more than a thousandth of σ at each datum makes
    - ``problem``: with the errors of data that residuals have shown; None: they are stated
    """

    shares: Array
    runs: Array
    reasons: tuple[str, ...]
    scatter: Scatter | None
    likelihood: Likelihood | None
    checks: Checks | None
    missed: bool = False
    problem: FitProblem | None = None


def most_fresh(count: int) -> int:
    """Return how many fresh runs a best point takes at most where ``count`` are wanted."""
    return max(count, max(1, count // 3) + MIN_REPEATS)


def _again(
    search: Search,
    pool: Pool,
    shares: Array,
    seeds: Sequence[int],
    done: tuple[int, int],
    progress: Callable[[int, int], None] | None,
) -> tuple[Array, list[str]]:
    """Run a point with some seeds, after some of so many."""

    def note(ready: int, wanted: int) -> None:
        each = wanted // len(seeds)
        if progress is not None:
            progress(done[0] * each + ready, done[1] * each)

    return search.extra(pool, [(shares.tolist(), seed) for seed in seeds], note)


def _is_worse(
    problem: FitProblem, shares: Array, runs: Array, ran: Evaluation, search: Search
) -> tuple[bool, bool]:
    """Return whether runs at a point fit worse than the best of a search did, beyond scatter.

    The first is beyond rounding of the readings, the second by an amount that counts.
    """
    if problem.scatter == "unknown":
        found = (ran.misfit.means - problem.observed) / problem.sigma
        problem = with_scatter(problem, found, ran.misfit.scatter / problem.sigma**2)
        ran = next(e for e in search.on(problem).evaluations() if (e.shares == ran.shares).all())
    there = misfit(problem.observed, problem.sigma, runs, None, problem.noise)
    before, here = problem.prior.loss(np.stack([ran.shares, shares]))
    scatter = np.maximum(there.scatter, ran.misfit.scatter)
    part = scatter / (scatter + problem.sigma**2)  # of what each datum adds to χ² by chance
    chance = part.sum() + 3.0 * np.sqrt(2.0 * (part**2).sum())
    excess = there.chi_squared + here - ran.misfit.chi_squared - before - chance
    residuals = np.abs(there.residuals)
    rounding = 8.0 * np.finfo(float).eps * (np.abs(problem.observed / problem.sigma) + residuals)
    slack = [float((2.0 * residuals * e + e**2).sum()) for e in (rounding, _NOTHING)]
    return bool(excess > slack[0]), bool(excess > slack[1])


def fresh(
    problem: FitProblem,
    search: Search,
    pool: Pool,
    count: int = DEFAULT_REPEATS,
    progress: Callable[[int, int], None] | None = None,
) -> Fresh:
    """Run the best point, and draws from the intervals that follow, with fresh seeds.

    - ``search``: of the same problem; keeps the runs
    - ``pool``: where runs are made
    - ``count``: runs at the best point; a third of them at another one that turns out worse
    - ``progress``: called with the numbers of runs done and wanted after each run
    """
    emulator = search.emulator()
    ran = min(search.evaluations(), key=lambda e: e.loss)
    best = ran.shares
    if emulator is not None:  # no single lucky run decides it
        likely = draws(emulator.loss, problem.prior, seed=0, count=ENOUGH_DRAWS)
        best = best_of(emulator.loss, problem.prior, likely)
    first = max(problem.seeds) + 1
    seeds = [first + k for k in range(count)]
    trial = count if np.array_equal(best, ran.shares) else max(1, count // 3)
    runs, reasons = _again(search, pool, best, seeds[:trial], (0, count), progress)
    worse = missed = False
    if trial < count:
        worse, missed = _is_worse(problem, best, runs, ran, search)
    if worse:  # the emulator misses something that its runs found
        best, seeds = (
            ran.shares,
            seeds[:trial] + [first + k for k in range(trial, most_fresh(count))],
        )
        runs, more = _again(search, pool, best, seeds[trial:], (trial, len(seeds)), progress)
        reasons += more
    elif trial < count:
        rest, more = _again(search, pool, best, seeds[trial:], (trial, count), progress)
        runs, reasons = np.concatenate([runs, rest]), reasons + more
    residuals = (runs - problem.observed) / problem.sigma
    whole = np.isfinite(residuals).any(axis=1)
    if whole.sum() < MIN_REPEATS:
        return Fresh(best, runs, tuple(reasons), None, None, None, missed)
    fitted = None
    if problem.scatter == "unknown":
        share = 1.0 / problem.tissues + 1.0 / whole.sum()
        found_there = residuals[whole].mean(axis=0), residuals[whole].var(axis=0, ddof=1) * share
        problem = fitted = with_scatter(problem, *found_there)
        search = search.on(problem)
        emulator = search.emulator()
        residuals = (runs - problem.observed) / problem.sigma
    residuals = residuals[whole]
    known = np.isfinite(residuals).all(axis=0)
    instead = 0.0 if emulator is None else emulator.means(best[None])[0]
    scatter = scatter_of(np.where(known, residuals, instead))
    if emulator is None:
        return Fresh(best, runs, tuple(reasons), scatter, None, None, missed, fitted)
    found = likelihood(emulator, problem.noise, best, scatter)
    others = np.diag(problem.noise.errors) + emulator.scatter
    tiles = mosaic_of(emulator, others)
    found = replace(found, mosaic=tiles)
    likely = found.draws(ENOUGH_DRAWS)
    chosen = likely[:: len(likely) // CHECKS][:CHECKS]
    tasks = [(x.tolist(), first + MAX_REPEATS + k) for k, x in enumerate(chosen)]
    runs_there, more = search.extra(pool, tasks, progress)
    residuals = (runs_there - problem.observed) / problem.sigma
    means, variances = found.predict(chosen)
    checks, error = _check(residuals - means, variances, scatter)
    if tiles is not None:
        whole = np.isfinite(residuals).all(axis=1)
        points = np.vstack([emulator.shares, best, chosen[whole]])
        values = np.vstack([emulator.residuals, scatter.mean, residuals[whole]])
        found = replace(found, mosaic=mosaic(points, values, others)[0])
        checks = replace(checks, off=np.zeros_like(checks.off))
    elif checks.off.any():
        found = likelihood(emulator, problem.noise, best, scatter, error)
    return Fresh(best, runs, (*reasons, *more), scatter, found, checks, missed, fitted)


def _check(away: Array, variances: Array, scatter: Scatter) -> tuple[Checks, Array]:
    """Check an emulator by runs; return the checks, and the variance missing in its error."""
    from scipy import stats

    known = np.isfinite(away).sum(axis=0)
    squares = np.nansum(away**2, axis=0) / np.maximum(known, 1)
    noise = scatter.variance * (1.0 + 1.0 / scatter.count)
    expected = noise + variances.mean(axis=0)
    limit = stats.f.isf(_CHANCE, np.maximum(known, 1), scatter.count - 1.0)
    off = (known > 0) & (squares > limit * expected + _NOTHING**2)
    error = np.where(off, squares - expected, 0.0)
    return Checks(np.sqrt(squares), np.sqrt(expected), off), error
