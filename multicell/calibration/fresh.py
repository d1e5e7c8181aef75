"""What fresh seeds show after a search: runs at the best point, and at draws from the intervals.

The runs at the best point give its likelihood (:mod:`multicell.calibration.likelihood`). The runs
at draws check the emulator where it is used: where it is further off at a datum than scatter and
its own error explain, that error is raised to what was found, and the intervals are drawn again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from multicell.calibration.distance import Array
from multicell.calibration.emulator import FEW, Emulator, best_of, draws
from multicell.calibration.likelihood import (
    MIN_REPEATS,
    Likelihood,
    Scatter,
    likelihood,
    scatter_of,
)
from multicell.calibration.pool import Pool
from multicell.calibration.priors import Prior
from multicell.calibration.problem import Problem
from multicell.calibration.search import Search

DEFAULT_REPEATS: Final = 12  # fresh runs at the best point
MAX_REPEATS: Final = 1000  # most of them
CHECKS: Final = 6  # draws from the intervals that are run
_CHANCE: Final = 0.01  # chance at which a check finds an error at a datum that is none


@final
@dataclass(frozen=True, eq=False)
class Checks:
    """What runs at draws from the intervals say of the emulator, in σ of the data, (n,) each.

    - ``found``: root mean square of run less emulator
    - ``expected``: what scatter of runs and the emulator's own error explain of it
    - ``off``: where it is more than chance explains
    """

    found: Array
    expected: Array
    off: Array


@final
@dataclass(frozen=True, eq=False)
class Fresh:
    """What fresh runs have shown.

    - ``shares``, (d,): the best point
    - ``runs``, (R, n): readings there, on the scales of the data; NaN where a run has nothing
    - ``reasons``: why runs failed
    - ``scatter``: their mean and covariance; None of fewer than four whole runs
    - ``likelihood``: of the parameters; None without an emulator or without scatter
    - ``checks``: of the emulator; None without a likelihood
    """

    shares: Array
    runs: Array
    reasons: tuple[str, ...]
    scatter: Scatter | None
    likelihood: Likelihood | None
    checks: Checks | None


def fresh(
    problem: Problem,
    search: Search,
    pool: Pool,
    emulator: Emulator | None,
    count: int = DEFAULT_REPEATS,
    progress: Callable[[int, int], None] | None = None,
) -> Fresh:
    """Run the best point, and draws from the intervals that follow, with fresh seeds.

    - ``search``: of the same problem; keeps the runs
    - ``pool``: where runs are made
    - ``emulator``: of the search; None where too few points were tried, or none
    - ``count``: runs at the best point
    - ``progress``: called with the numbers of runs done and wanted after each run
    """
    best = _best(search, problem.prior, emulator)
    first = max(problem.seeds) + 1
    here = best.tolist()
    runs, reasons = search.extra(pool, [(here, first + k) for k in range(count)], progress)
    residuals = (runs - problem.observed) / problem.sigma
    whole = np.isfinite(residuals).any(axis=1)
    if whole.sum() < MIN_REPEATS:
        return Fresh(best, runs, tuple(reasons), None, None, None)
    residuals = residuals[whole]
    known = np.isfinite(residuals).all(axis=0)
    instead = 0.0 if emulator is None else emulator.means(best[None])[0]
    scatter = scatter_of(np.where(known, residuals, instead))
    if emulator is None:
        return Fresh(best, runs, tuple(reasons), scatter, None, None)
    found = likelihood(emulator, problem.noise, best, scatter)
    likely = found.draws(FEW)
    chosen = likely[:: len(likely) // CHECKS][:CHECKS]
    points = [(x.tolist(), first + MAX_REPEATS + k) for k, x in enumerate(chosen)]
    runs_there, more = search.extra(pool, points, progress)
    away = (runs_there - problem.observed) / problem.sigma - found.predict(chosen)[0]
    checks, error = _check(away, found.predict(chosen)[1], scatter)
    if checks.off.any():
        found = likelihood(emulator, problem.noise, best, scatter, error)
    return Fresh(best, runs, (*reasons, *more), scatter, found, checks)


def _best(search: Search, prior: Prior, emulator: Emulator | None) -> Array:
    """Return the point whose runs stand for the fit; no single lucky run decides it."""
    if emulator is None:
        return min(search.evaluations(), key=lambda e: e.loss).shares
    return best_of(emulator.loss, prior, draws(emulator.loss, prior, seed=0, count=FEW))


def _check(away: Array, variances: Array, scatter: Scatter) -> tuple[Checks, Array]:
    """Return what runs say of an emulator, and the variance that is missing in its error."""
    from scipy import stats

    known = np.isfinite(away).sum(axis=0)
    squares = np.nansum(away**2, axis=0) / np.maximum(known, 1)
    noise = scatter.variance * (1.0 + 1.0 / scatter.count)
    expected = noise + variances.mean(axis=0)
    limit = stats.f.isf(_CHANCE, np.maximum(known, 1), scatter.count - 1.0)
    # a thousandth of σ is of no account, and may be all that runs without scatter differ by
    off = (known > 0) & (squares > limit * expected + 1e-6)
    error = np.where(off, squares - expected, 0.0)
    return Checks(np.sqrt(squares), np.sqrt(expected), off), error
