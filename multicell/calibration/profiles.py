"""Profile likelihoods: how well the data are fitted at best where one parameter has a given value.

Over the values x of one parameter, the least -2 ln (L · prior) over all others, less the least of
all, is D(x). Of a linear model with normal errors D is the square of x in standard deviations, and
D <= χ² (one degree of freedom) is the interval. The likelihood of a search is a Student's along the
k directions in which the parameters move the data (:mod:`multicell.calibration.likelihood`); there
D = (ν + k) ln(1 + t²/ν), whose limit at Student's quantile t gives Student's interval.

D comes from the emulator. Runs at the ends of the intervals check it, with seeds of the runs at the
best point: what differs between both places is the same tissue twice, so that its scatter cancels
for the most part. Mean readings there are those at the best point plus the mean difference. Bias
and standard error of D by them are the jackknife's over the seeds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, final

import numpy as np

from multicell.calibration.emulator import FEW, Emulator, best_of, descend, draws
from multicell.calibration.likelihood import Likelihood
from multicell.calibration.noise import Array

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from multicell.calibration.likelihood import Fresh
    from multicell.calibration.pool import Pool
    from multicell.calibration.problem import Problem
    from multicell.calibration.search import Search

POINTS: Final = 15  # values of a profile
MIN_RUNS: Final = 3  # at each end of an interval, of which a standard error can be estimated
_EXACT: Final = 1e6  # degrees of freedom from which Student's distribution is normal


@final
@dataclass(frozen=True, eq=False)
class Profile:
    """The profile likelihood of one parameter, by the emulator.

    - ``number``: of the parameter
    - ``shares``, (p, d): the best parameters with each value, places in the ranges
    - ``rises``, (p,): D; inf where constraints allow nothing
    - ``level``, ``limit``: of the interval, and D at its ends
    - ``ends``, (2, d): the best parameters at its ends
    - ``end_rises``: D there
    - ``open``: whether the interval ends at the lower and upper end of the range
    """

    number: int
    shares: Array
    rises: Array
    level: float
    limit: float
    ends: Array
    end_rises: tuple[float, float]
    open: tuple[bool, bool]


@final
@dataclass(frozen=True)
class End:
    """What runs say at an end of a profile's interval.

    - ``number``, ``side``: of the parameter; 0 at the lower end, 1 at the upper one
    - ``claimed``: D by the emulator
    - ``found``, ``error``: D by runs, and its standard error; NaN where runs failed
    - ``runs``: how many there are
    """

    number: int
    side: int
    claimed: float
    found: float
    error: float
    runs: int

    @property
    def off(self) -> bool:
        """Whether runs and emulator differ by more than chance explains, and by what matters."""
        from scipy import stats

        chance = stats.t.ppf(0.995, max(self.runs - 1, 1)) * self.error
        return bool(abs(self.found - self.claimed) > chance + 0.25 * self.claimed)


def limit_of(likelihood: Likelihood | Emulator, level: float) -> float:
    """Return D at the ends of an interval."""
    from scipy import stats

    if isinstance(likelihood, Emulator) or likelihood.freedom >= _EXACT:
        return float(stats.chi2.ppf(level, 1))
    freedom, count = likelihood.freedom, likelihood.directions.shape[1]
    quantile = stats.t.ppf(0.5 + 0.5 * level, freedom)
    return float((freedom + count) * math.log1p(quantile**2 / freedom))


def profiles(
    likelihood: Likelihood | Emulator, numbers: Sequence[int], points: int = POINTS,
    level: float = 0.95,
) -> list[Profile]:  # fmt: skip
    """Return the profile likelihoods of some parameters.

    - ``points``: how many values of each, over somewhat more than its interval
    """
    emulator = likelihood if isinstance(likelihood, Emulator) else likelihood.emulator
    prior = emulator.prior
    drawn = draws(likelihood.loss, prior, seed=0, count=FEW)
    best = best_of(likelihood.loss, prior, drawn)
    return [_Course(likelihood, drawn, best, k).profile(points, level) for k in numbers]


@final
class _Course:
    """The search for the least loss where one parameter is fixed."""

    def __init__(
        self, likelihood: Likelihood | Emulator, drawn: Array, best: Array, number: int
    ) -> None:
        emulator = likelihood if isinstance(likelihood, Emulator) else likelihood.emulator
        self._likelihood, self._prior, self._number = likelihood, emulator.prior, number
        self._drawn, self._known, self._best = drawn, [best], best
        self._least = float(self._loss(best[None])[0])

    def _loss(self, shares: Array) -> Array:
        return self._likelihood.loss(shares) + self._prior.loss(shares)

    def at(self, value: float) -> tuple[Array, float]:
        """Return the best parameters with a value, and D there; inf where nothing is allowed."""
        near = np.argsort(np.abs(self._drawn[:, self._number] - value))[:20]
        starts = np.vstack([*self._known, self._drawn[near]])
        starts[:, self._number] = value
        starts = starts[np.isfinite(self._prior.loss(starts))]
        if len(starts) == 0:
            return np.where(np.arange(len(self._best)) == self._number, value, self._best), math.inf
        moving = np.arange(len(self._best)) != self._number
        start = starts[np.argmin(self._loss(starts))]
        found = descend(self._likelihood.loss, self._prior, start, moving)
        self._known.append(found)
        return found, max(float(self._loss(found[None])[0]) - self._least, 0.0)

    def profile(self, points: int, level: float) -> Profile:
        """Return the profile and its interval."""
        from scipy.optimize import brentq

        limit, centre = limit_of(self._likelihood, level), float(self._best[self._number])
        ends, opens, reach = [], [], []
        for side in (0.0, 1.0):
            outer = self._beyond(centre, side, limit)
            opens.append(self.at(outer)[1] <= limit)
            if not opens[-1]:
                # in √D, which is linear as far as the model is; beyond constraints D is infinite
                outer = brentq(
                    lambda x: min(math.sqrt(self.at(x)[1]), 1e3) - math.sqrt(limit),
                    centre, outer, xtol=1e-6, rtol=1e-6,
                )  # fmt: skip
            ends.append(self.at(outer))
            reach.append(min(max(outer + 0.35 * (outer - centre), 0.0), 1.0))
        found = [self.at(x) for x in np.linspace(reach[0], reach[1], points)]
        return Profile(
            self._number, np.array([x for x, _ in found]), np.array([d for _, d in found]),
            level, limit, np.array([x for x, _ in ends]), (ends[0][1], ends[1][1]),
            (opens[0], opens[1]),
        )  # fmt: skip

    def _beyond(self, centre: float, side: float, limit: float) -> float:
        """Return a value on one side where D is above its limit, or the end of the range."""
        spread = 2.0 * float(self._drawn[:, self._number].std()) + 1e-3
        while True:
            value = min(max(centre + (2.0 * side - 1.0) * spread, 0.0), 1.0)
            if value == side or self.at(value)[1] > limit:
                return value
            spread *= 1.5


def check_ends(
    problem: Problem,
    search: Search,
    pool: Pool,
    again: Fresh,
    runs: int,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[End, ...]:
    """Run the ends of the 95 % intervals of all parameters, with so many seeds; none without."""
    likelihood = again.likelihood
    if likelihood is None or runs == 0:
        return ()
    found = profiles(likelihood, range(len(problem.ranges)))
    first = max(problem.seeds) + 1
    seeds = range(first, first + runs)
    points = [(end.tolist(), seed) for p in found for end in p.ends for seed in seeds]
    readings, _ = search.extra(pool, points, progress)
    there = ((readings - problem.observed) / problem.sigma).reshape(-1, runs, len(problem.observed))
    here = (again.runs[:runs] - problem.observed) / problem.sigma
    assert again.scatter is not None
    results = []
    for k, profile in enumerate(found):
        for side in (0, 1):
            away = there[2 * k + side] - here
            away = away[np.isfinite(away).all(axis=1)]
            means, variances = likelihood.predict(np.stack([again.shares, profile.ends[side]]))
            claimed = profile.end_rises[side]
            begin = claimed - float(likelihood.loss_of(means[1:], variances[1:])[0])

            def rise(x: Array, means: Array = means, error: Array = variances[1:]) -> float:
                return float(likelihood.loss_of(means[:1] + x, error)[0])

            found_there, error = _jackknife(rise, away)
            by_runs = begin + found_there
            results.append(End(profile.number, side, claimed, by_runs, error, len(away)))
    return tuple(results)


def _jackknife(statistic: Callable[[Array], float], values: Array) -> tuple[float, float]:
    """Return a statistic of the mean of values (k, n) without its bias, and its standard error."""
    count = len(values)
    if count < MIN_RUNS:
        return math.nan, math.nan
    whole = statistic(values.mean(axis=0))
    parts = np.array([statistic(np.delete(values, k, axis=0).mean(axis=0)) for k in range(count)])
    error = math.sqrt((count - 1.0) / count * float(((parts - parts.mean()) ** 2).sum()))
    return float(count * whole - (count - 1.0) * parts.mean()), error
