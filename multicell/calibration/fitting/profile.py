"""Profile likelihood: how much worse the data are described as one parameter is held aside.

At each value of a parameter all others take the values that describe the data best. Twice the
loss of the logarithm of the likelihood against the best point is a χ² with one degree of freedom
where there are many data (Wilks 1938, Ann. Math. Stat. 9, 60), so that a parameter is identified
where the profile rises above its quantile at both sides (Raue et al. 2009, Bioinformatics 25,
1923; Simpson & Maclaren 2023, PLoS Comput. Biol. 19, e1011515). No prior enters.

The likelihood is that of the fit: its emulator with fresh runs, errors of the emulator that check
runs have found included (:mod:`multicell.calibration.fitting.likelihood`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, final

import numpy as np

from multicell.calibration.fitting.constraints import NO_CONSTRAINTS, Constraints, values_at
from multicell.calibration.fitting.emulator import Loss
from multicell.calibration.shared.confidence import LEVEL
from multicell.errors import FitFailed, SceneError
from multicell.measured.noise import Array
from multicell.schema import near_miss
from multicell.units import shown

if TYPE_CHECKING:
    from multicell.calibration.fitting.numbers import FitNumbers
    from multicell.studies.axes import Range

PROFILE_POINTS: Final = 41
"""Values of a parameter that a profile has."""
_DIFFERENCE: Final = 1e-5  # of shares, for slopes
_STARTS: Final = 4  # draws from which the other parameters descend, besides the neighbour's


@final
@dataclass(frozen=True, eq=False)
class LikelihoodProfile:
    """The profile likelihood of one parameter.

    - ``name``, ``unit``: of the parameter
    - ``values``, (m,): in base units, rising; the best one is among them
    - ``loss``, (m,): -2 ln (L / L at the best point), at least 0
    - ``others``, (m, d): shares of the ranges of all parameters there
    - ``best``: value of least loss
    - ``best_shares``, (d,): shares of the ranges of all parameters there
    """

    name: str
    unit: str
    values: Array
    loss: Array
    others: Array
    best: float
    best_shares: Array
    _shares: Array
    _free: Range

    def interval(self, level: float = LEVEL) -> tuple[float, float]:
        """Return the ends of the confidence interval, base units.

        An end that the searched range does not hold is infinite: the data do not bound the
        parameter at that side.
        """
        low, high = self._ends(level)
        return -np.inf if low is None else low[0], np.inf if high is None else high[0]

    def ends(self, level: float = LEVEL) -> list[tuple[float, Array]]:
        """Return the ends of the interval that the range holds.

        Each is a value in base units, and the shares of the ranges of all parameters there, (d,).
        """
        return [end for end in self._ends(level) if end is not None]

    def _ends(self, level: float) -> list[tuple[float, Array] | None]:
        from scipy import stats

        if not 0.0 < level < 1.0:
            raise SceneError("level", f"is {shown(level)}, must be between 0 and 1")
        limit = float(stats.chi2.ppf(level, 1))
        inside = np.flatnonzero(self.loss <= limit)
        ends: list[tuple[float, Array] | None] = []
        for place, way in ((int(inside[0]), -1), (int(inside[-1]), 1)):
            beyond = place + way
            if not 0 <= beyond < len(self.loss):
                ends.append(None)
                continue
            # near its least value a profile is a parabola: its root is nearly straight
            low, high = (float(np.sqrt(max(self.loss[k], 0.0))) for k in (place, beyond))
            part = (np.sqrt(limit) - low) / (high - low)
            share = self._shares[place] + part * (self._shares[beyond] - self._shares[place])
            others = self.others[place] + part * (self.others[beyond] - self.others[place])
            ends.append((float(values_at(self._free, np.array([share]))[0]), others))
        return ends

    def identified(self, level: float = LEVEL) -> bool:
        """Return whether the interval has both ends within the range."""
        return bool(np.isfinite(self.interval(level)).all())


def profile_of(fit: FitNumbers, name: str, points: int = PROFILE_POINTS) -> LikelihoodProfile:
    """Return the profile likelihood of a parameter of a fit, by its name or key.

    Raises SceneError for an unknown parameter or fewer than 5 points, FitFailed where the fit has
    no likelihood.
    """
    ranges = fit.problem.ranges
    place = next((k for k, free in enumerate(ranges) if name in (free.name, free.key)), None)
    if place is None:
        raise SceneError(name, "is no parameter of the fit", near_miss(name, fit.problem.names))
    if isinstance(points, bool) or not isinstance(points, int) or points < 5:
        raise SceneError("points", f"is {shown(points)}, must be a whole number of at least 5")
    if fit.fresh.likelihood is None:
        fit.some_sample()  # says what is lacking
        raise FitFailed("there is no likelihood")
    orders = fit.problem.prior.constraints
    return _profile(fit.fresh.likelihood.loss, ranges, place, fit.some_sample(), points, orders)


def _profile(
    loss: Loss,
    ranges: Sequence[Range],
    place: int,
    sample: Array,
    points: int,
    orders: Constraints = NO_CONSTRAINTS,
) -> LikelihoodProfile:
    best = _least(loss, sample[np.argsort(loss(sample))[:_STARTS]], None, orders)
    free = ranges[place]
    if orders.pairs:  # values for which the others have some
        cut = orders.apart()[place]
        low, high = free.share(cut.low), free.share(cut.high)
    else:
        low, high = 0.0, 1.0
    grid = np.unique(np.append(np.linspace(low, high, points), best[place]))
    middle = int(np.searchsorted(grid, best[place]))
    found = np.tile(best, (len(grid), 1))
    for way in (range(middle + 1, len(grid)), range(middle - 1, -1, -1)):
        before = best
        for k in way:
            near = sample[np.argsort(np.abs(sample[:, place] - grid[k]))[: 50 * _STARTS]]
            starts = np.vstack([before, near[np.argsort(loss(near))[:_STARTS]]])
            starts[:, place] = grid[k]
            starts = orders.mended(starts, place)
            before = found[k] = _least(loss, starts[orders.hold(starts)], place, orders)
    losses = loss(found)
    least = int(np.argmin(losses))  # where a point beside the best is better by rounding
    return LikelihoodProfile(
        free.name,
        free.unit,
        np.asarray(values_at(free, grid)),
        losses - losses[least],
        found,
        float(values_at(free, grid[least : least + 1])[0]),
        found[least],
        grid,
        free,
    )


def _least(loss: Loss, starts: Array, fixed: int | None, orders: Constraints) -> Array:
    """Return the place of least loss, (d,), from several starts; one parameter may be fixed."""
    moving = [k for k in range(starts.shape[1]) if k != fixed]
    order = starts[np.argsort(loss(starts), kind="stable")]
    if not moving:
        return np.asarray(order[0])

    def value_and_slope(x: Array, start: Array) -> tuple[float, Array]:
        steps = np.where(x < 0.5, _DIFFERENCE, -_DIFFERENCE)
        points = np.tile(start, (len(x) + 1, 1))
        points[:, moving] = np.vstack([x, x + np.diag(steps)])
        found = loss(points)
        return float(found[0]), (found[1:] - found[0]) / steps

    ends = [orders.descend(value_and_slope, start, moving, (start,)) for start in order[:2]]
    return np.asarray(ends[int(np.argmin(loss(np.array(ends))))])
