"""How long a run will still take, from what its steps have cost and how its population grows.

A step costs about a + b n with n cells; both are fitted to the steps so far, late ones counting
more. The population is that of the scene's forecast (``explain``), read from where it has as many
cells as the run. What a step costs with more cells than there have been is unknown: one step of
the forecast counts like a measured one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import median
from typing import Final, final

import numpy as np

_FADING: Final = 0.99  # weight of a step over that of the next
_OUTLIER: Final = 4.0  # times the usual cost: what was compiled, or kept waiting, comes once
_USUAL: Final = 15  # steps whose median cost is the usual one
_MIN_STEPS: Final = 5  # before anything is reported
_POINTS: Final = 400  # ahead at which the population is taken


@final
@dataclass(frozen=True)
class Forecast:
    """How a population is expected to grow, and what a step costs with it.

    Attributes
    ----------
    times, cells : (k,)
        Simulated times from 0 on, s, and the number of cells then.
    constant, slope
        Of the cost of a step, constant + slope n, in any unit.
    """

    times: np.ndarray
    cells: np.ndarray
    constant: float
    slope: float


@final
class Remaining:
    """Notes steps and estimates the wall time that is left.

    Parameters
    ----------
    duration : s
        Simulated time at the end.
    stop_cells
        Number of cells at which the run ends before, or None.
    """

    def __init__(self, duration: float, stop_cells: int | None = None) -> None:
        self._duration, self._stop = duration, stop_cells
        self._recent: list[float] = []
        self._waiting: list[tuple[float, float]] = []
        self._sums = [0.0] * 5
        self._count = self._cells = 0
        self._time = self._length = 0.0

    def note(self, time: float, cells: int, wall: float) -> None:
        """Note a step that ended at a simulated time with so many cells, and its wall time, s."""
        self._recent = [*self._recent[-_USUAL + 1 :], wall]
        self._waiting.append((float(max(cells, 1)), wall))
        self._count += 1
        if self._count >= _MIN_STEPS:
            usual = median(self._recent)
            for n, cost in self._waiting:
                self._add(n, min(cost, _OUTLIER * usual))
            self._waiting.clear()
        self._length, self._time, self._cells = time - self._time, time, max(cells, 1)

    def _add(self, n: float, cost: float) -> None:
        """Add a step to the sums of the fit."""
        new = (1.0, n, n * n, cost, n * cost)
        self._sums = [_FADING * old + x for old, x in zip(self._sums, new, strict=True)]

    def left(self, forecast: Forecast) -> float | None:
        """Return the wall time that is left in s; None before it can be estimated."""
        ahead = self._duration - self._time
        if self._count < _MIN_STEPS or not self._length > 0.0:
            return None
        if ahead <= 0.0:
            return 0.0
        cells = self._population(forecast, np.linspace(0.0, ahead, _POINTS))
        if self._stop is not None and cells[-1] > self._stop:
            cells = cells[cells < self._stop]
        mean = float(cells.mean()) if len(cells) else 0.0
        constant, slope = self._cost(forecast, mean)
        return (constant + slope * mean) * len(cells) / _POINTS * ahead / self._length

    def _cost(self, forecast: Forecast, ahead: float) -> tuple[float, float]:
        """Return a and b of a step's cost a + b n, s; neither is negative.

        A step with ``ahead`` cells, as the forecast has it, counts as one that has been measured.
        """
        sums, a, b = self._sums, forecast.constant, forecast.slope
        mean = sums[1] / sums[0]
        dearer = (a + b * ahead) / (a + b * mean) * sums[3] / sums[0]
        new = (1.0, ahead, ahead * ahead, dearer, ahead * dearer)
        sums = [old + x for old, x in zip(sums, new, strict=True)]
        one, n, squares, cost, product = sums
        spread = one * squares - n * n
        if spread > 1e-4 * n * n:
            slope = (one * product - n * cost) / spread
            constant = (cost - slope * n) / one
            if slope < 0.0:
                return cost / one, 0.0
            if constant >= 0.0:
                return constant, slope
        elif n < 1000.0 * one:
            return cost / one, 0.0  # so few cells are not what costs
        return 0.0, cost / n

    def _population(self, forecast: Forecast, ahead: np.ndarray) -> np.ndarray:
        """Return the numbers of cells at times from now on, by the forecast after as many."""
        logs, here = np.log(np.maximum(forecast.cells, 1.0)), math.log(self._cells)
        now, last = self._time, float(forecast.times[-1])
        if (np.diff(logs) >= 0.0).all():
            now = float(np.interp(here, logs, forecast.times))
        course = np.interp(np.minimum(now + ahead, last), forecast.times, logs)
        slope = (logs[-1] - logs[-2]) / (last - float(forecast.times[-2]))
        course += slope * np.maximum(now + ahead - last, 0.0) - np.interp(now, forecast.times, logs)
        return np.asarray(np.exp(np.minimum(here + course, 700.0)))


def in_words(seconds: float) -> str:
    """Return a wall time as a person would say it."""
    for unit, size in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 1.5 * size:
            return f"{seconds / size:.0f} {unit}"
    return f"{seconds:.0f} s"
