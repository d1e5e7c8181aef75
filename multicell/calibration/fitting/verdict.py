"""Intervals of the parameters from data, and combinations that the data leave undetermined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from multicell.calibration.fitting.priors import Prior
from multicell.calibration.shared.confidence import LEVEL
from multicell.calibration.shared.wording import value_in_words
from multicell.measured.noise import Array
from multicell.studies.axes import Range

OPEN: Final = 0.7
"""Part of its range from which a 95 % interval says that a parameter is not determined."""
RIDGE: Final = 0.9
"""Size of a correlation from which only a combination of two parameters is determined."""
EDGE: Final = 0.02  # part of a range next to its end in which half of the posterior is too much


@final
@dataclass(frozen=True)
class Interval:
    """A credible interval of one parameter, base units.

    - ``low``, ``median``, ``high``: of the posterior
    - ``part``: of the range (of its logarithm where that is logarithmic) that the interval covers
    """

    low: float
    median: float
    high: float
    part: float

    def __contains__(self, value: float) -> bool:
        return self.low <= value <= self.high


@final
@dataclass(frozen=True)
class Undetermined:
    """Something that the data do not determine.

    - ``names``: of one parameter, or of two that only have a combination
    - ``kind``: ``"open"``: its interval covers most of its range; ``"ridge"``: a strong
      correlation; ``"edge"``: the posterior presses against an end of the range
    - ``words``: in words
    """

    names: tuple[str, ...]
    kind: str
    words: str

    def __str__(self) -> str:
        return self.words


def intervals(ranges: Sequence[Range], shares: Array, level: float = LEVEL) -> dict[str, Interval]:
    """Return a central credible interval of each parameter from draws, (k, d)."""
    tails = (0.5 - level / 2.0, 0.5, 0.5 + level / 2.0)
    found = {}
    for free, column in zip(ranges, shares.T, strict=True):
        low, median, high = quantiles(column, tails)
        ends = [free.value(float(x)) for x in (low, median, high)]
        found[free.name] = Interval(ends[0], ends[1], ends[2], float(high - low))
    return found


def quantiles(values: Array, levels: Sequence[float]) -> Array:
    """Return quantiles of draws (k, ...) over the first axis, draws themselves: (levels, ...)."""
    return np.asarray(np.quantile(values, levels, axis=0, method="inverted_cdf"))


def undetermined(
    ranges: Sequence[Range], shares: Array, prior: Prior | None = None
) -> list[Undetermined]:
    """Return open intervals, ridges, and ends of ranges that the data leave undetermined."""
    found = []
    known = intervals(ranges, shares)
    prior = Prior(len(ranges)) if prior is None else prior
    for k, (free, column) in enumerate(zip(ranges, shares.T, strict=True)):
        interval, before = known[free.name], prior.part(k, LEVEL)
        if interval.part >= OPEN * before / LEVEL:
            of = "its range" if before == LEVEL else f"its range, {100.0 * before:.0f} % beforehand"
            low, high = (value_in_words(x, free.unit) for x in (interval.low, interval.high))
            words = (
                f"{free.name} is not determined: its 95 % interval, {low} to {high}, covers "
                f"{100.0 * interval.part:.0f} % of {of}"
            )
            found.append(Undetermined((free.name,), "open", words))
            continue
        edges = ("lower", free.low, column < EDGE), ("upper", free.high, column > 1.0 - EDGE)
        for end, value, near in edges:
            if near.mean() > 0.5:
                there = value_in_words(value, free.unit)
                words = (
                    f"{free.name} lies at the {end} end of its range, {there}:"
                    " the data may ask for more"
                )
                found.append(Undetermined((free.name,), "edge", words))
    covariance = np.atleast_2d(np.cov(shares.T))
    spread = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    correlation = covariance / np.outer(spread, spread)
    for i, j in zip(*np.nonzero(np.tril(np.abs(correlation) >= RIDGE, -1)), strict=True):
        names, size = (ranges[j].name, ranges[i].name), float(correlation[i, j])
        together = "rise together" if size > 0.0 else "make up for each other"
        words = (
            f"{names[0]} and {names[1]} {together} (correlation {size:+.2f}): the data "
            "determine a combination of them better than each"
        )
        found.append(Undetermined(names, "ridge", words))
    return found
