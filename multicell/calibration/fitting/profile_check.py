"""Checks of profiles by runs: whether the emulator is right where an interval ends."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, final

import numpy as np

from multicell.calibration.fitting.likelihood import MAX_REPEATS, MIN_REPEATS, Likelihood
from multicell.calibration.fitting.pool import Pool, open_pool
from multicell.calibration.fitting.profile import profile_of
from multicell.calibration.fitting.search import SEARCH, Search
from multicell.calibration.shared.confidence import LEVEL
from multicell.errors import FitFailed
from multicell.measured.noise import Array
from multicell.results.folder import lock_folder
from multicell.studies.limits import check_cores, whole_between

if TYPE_CHECKING:
    from multicell.calibration.fitting.numbers import FitNumbers

CHECK_RUNS: Final = 6  # at each end of an interval


@final
@dataclass(frozen=True)
class ProfileEnd:
    """An end of a profile's interval, with what runs show there.

    - ``value``: of the parameter, base units
    - ``loss``: -2 ln (L / L at the best point) by the emulator: the quantile of χ²
    - ``by_runs``: the same with fresh runs in place of the emulator, without the bias that the
      scatter of their mean has on squares (jackknife)
    - ``error``: standard error of the difference of both, by leaving each run out once
    - ``runs``: how many of them there are
    """

    value: float
    loss: float
    by_runs: float
    error: float
    runs: int

    @property
    def confirmed(self) -> bool:
        """Whether both agree within twice the error, or within a tenth of the loss."""
        return abs(self.by_runs - self.loss) <= max(2.0 * self.error, 0.1 * self.loss)


def checked_profile(
    fit: FitNumbers,
    name: str,
    *,
    level: float = LEVEL,
    repeats: int = CHECK_RUNS,
    cores: int | None = None,
    progress: Callable[[int, int], None] | None = None,
    pool: Pool | None = None,
) -> list[ProfileEnd]:
    """Run the ends of the interval of a parameter; see :meth:`Fit.check_profile`."""
    hint = "It is the number of runs at each end."
    whole_between("repeats", repeats, MIN_REPEATS, MAX_REPEATS, hint)
    check_cores(cores)
    profile, known = profile_of(fit, name), fit.fresh.likelihood
    assert known is not None
    if known.mosaic is not None:
        hint = "Runs on both sides of an edge are in fit.runs; a larger budget adds some."
        raise FitFailed("the data jump between runs, whose scatter shows no edge", hint)
    ends = profile.ends(level)
    if not ends:
        return []
    problem, again = fit.problem, fit.fresh.scatter
    assert again is not None
    best = known.predict(profile.best_shares[None])
    # the best of the profile is near the point where fresh runs were made
    there, error_there = _by_runs(known, again.mean + again.away)
    there += float((known.loss_of(*best) - known.loss(fit.fresh.shares[None]))[0])
    seeds = [max(problem.seeds) + 1 + 2 * MAX_REPEATS + k for k in range(repeats)]
    points = [(place.tolist(), seed) for _, place in ends for seed in seeds]
    with ExitStack() as stack:
        path = None
        if fit.folder is not None:
            stack.enter_context(lock_folder(fit.folder))
            path = fit.folder / SEARCH
        if pool is None:
            pool = stack.enter_context(open_pool(cores, None))
        runs, reasons = Search(problem, path).extra(pool, points, progress)
    found = []
    for k, (value, place) in enumerate(ends):
        residuals = (runs[k * repeats : (k + 1) * repeats] - problem.observed) / problem.sigma
        whole = residuals[np.isfinite(residuals).all(axis=1)]
        if len(whole) < MIN_REPEATS:
            said = reasons[0] if reasons else "they have none of some data"
            raise FitFailed(f"runs at {name} = {value:g} show nothing: {said}")
        here = known.predict(place[None])
        shifts = np.vstack([np.zeros(len(again.mean)), -again.away / (again.count - 1.0)])
        losses = np.array([_moved(known, here, d) - _moved(known, best, d) for d in shifts])
        by_runs, error = _by_runs(known, whole)
        spread = (again.count - 1.0) * losses[1:].var()
        error = float(np.sqrt(error**2 + error_there**2 + spread))
        found.append(ProfileEnd(value, float(losses[0]), by_runs - there, error, len(whole)))
    return found


def _moved(known: Likelihood, at: tuple[Array, Array], shift: Array) -> float:
    return float(known.loss_of(at[0] + shift, at[1])[0])


def _by_runs(known: Likelihood, runs: Array) -> tuple[float, float]:
    """Return -2 ln L where runs (K, n), in σ from the data, stand for the emulator; its error."""

    def loss(some: Array) -> float:
        return float(known.loss_of(some.mean(axis=0)[None], np.zeros((1, some.shape[1])))[0])

    count = len(runs)
    left = np.array([loss(np.delete(runs, row, axis=0)) for row in range(count)])
    # of a square the mean over K runs has the bias s²/K, that over K - 1 the bias s²/(K - 1)
    return count * loss(runs) - (count - 1.0) * left.mean(), float(
        np.sqrt((count - 1.0) * left.var())
    )
