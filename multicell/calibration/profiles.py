"""Profile likelihoods: how well the data are fitted at best where one parameter has a given value.

Over the values x of one parameter, the least -2 ln (L · prior) over all others, less the least of
all, is D(x). Of a linear model with normal errors D is the square of x in standard deviations, and
D <= χ² (one degree of freedom) is the interval. The likelihood of a search is a Student's along the
k directions in which the parameters move the data (:mod:`multicell.calibration.likelihood`); there
D = (ν + k) ln(1 + t²/ν), whose limit at Student's quantile t gives Student's interval.

D comes from the emulator.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, final

import numpy as np

from multicell.calibration.emulator import FEW, best_of, descend
from multicell.calibration.likelihood import Likelihood
from multicell.calibration.noise import Array

if TYPE_CHECKING:
    from collections.abc import Sequence

POINTS: Final = 15  # values of a profile


@final
@dataclass(frozen=True, eq=False)
class Profile:
    """The profile likelihood of one parameter, by the emulator.

    - ``number``: of the parameter
    - ``shares``, (p, d): the best parameters with each value, places in the ranges
    - ``rises``, (p,): D; inf where the prior is zero
    - ``limit``: D at the ends of its interval
    - ``ends``, (2, d): the best parameters at its ends
    - ``open``: whether the interval ends at the lower and upper end of the range
    """

    number: int
    shares: Array
    rises: Array
    limit: float
    ends: Array
    open: tuple[bool, bool]


def limit_of(likelihood: Likelihood, level: float) -> float:
    """Return D at the ends of an interval."""
    from scipy import stats

    freedom, count = likelihood.freedom, likelihood.directions.shape[1]
    quantile = stats.t.ppf(0.5 + 0.5 * level, freedom)
    return float((freedom + count) * math.log1p(quantile**2 / freedom))


def profiles(likelihood: Likelihood, numbers: Sequence[int], level: float = 0.95) -> list[Profile]:
    """Return the profile likelihoods of some parameters, with intervals of a level."""
    drawn = likelihood.draws(FEW)
    best = best_of(likelihood.loss, likelihood.emulator.prior, drawn)
    return [_Course(likelihood, drawn, best, k).profile(level) for k in numbers]


@final
class _Course:
    """The search for the least loss where one parameter is fixed."""

    def __init__(self, likelihood: Likelihood, drawn: Array, best: Array, number: int) -> None:
        self._likelihood, self._prior = likelihood, likelihood.emulator.prior
        self._number = number
        self._drawn, self._known, self._best = drawn, [best], best
        self._least = float(self._loss(best[None])[0])

    def _loss(self, shares: Array) -> Array:
        return self._likelihood.loss(shares) + self._prior.loss(shares)

    def at(self, value: float) -> tuple[Array, float]:
        """Return the best parameters with a value, and D there; inf where the prior is zero."""
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

    def profile(self, level: float) -> Profile:
        """Return the profile over somewhat more than its interval, and this interval."""
        from scipy.optimize import brentq

        limit, centre = limit_of(self._likelihood, level), float(self._best[self._number])
        ends, opens, reach = [], [], []
        for side in (0.0, 1.0):
            outer = self._beyond(centre, side, limit)
            opens.append(self.at(outer)[1] <= limit)
            if not opens[-1]:
                # √D is linear as far as the model is; D is infinite where the prior is zero
                outer = brentq(
                    lambda x: min(math.sqrt(self.at(x)[1]), 1e3) - math.sqrt(limit),
                    centre, outer, xtol=1e-6, rtol=1e-6,
                )  # fmt: skip
            ends.append(self.at(outer)[0])
            reach.append(min(max(outer + 0.35 * (outer - centre), 0.0), 1.0))
        found = [self.at(x) for x in np.linspace(reach[0], reach[1], POINTS)]
        return Profile(
            self._number, np.array([x for x, _ in found]), np.array([d for _, d in found]),
            limit, np.array(ends), (opens[0], opens[1]),
        )  # fmt: skip

    def _beyond(self, centre: float, side: float, limit: float) -> float:
        """Return a value on one side where D is above its limit, or the end of the range."""
        spread = 2.0 * float(self._drawn[:, self._number].std()) + 1e-3
        while True:
            value = min(max(centre + (2.0 * side - 1.0) * spread, 0.0), 1.0)
            if value == side or self.at(value)[1] > limit:
                return value
            spread *= 1.5
