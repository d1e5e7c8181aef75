"""How long a run will still take, from what its steps have cost and how its population grows.

A step costs about a + b n with n cells; both are fitted to the steps so far, late ones counting
more. The population is continued from its course over the last half of the simulated time:

    n(t + s) = n (1 + g s / m)^m,    m = -g^2 / g'

with its present rate of growth g = n'/n and the rate's derivative g'. That is exponential growth
where the rate is constant (m without end), and the power of time that it has become where only a
rim still grows (n ~ t^3: m = 3).

The beginning of a run does not show what will hold its growth back: there a forecast of the scene
says it, such as that of ``explain``. It is read from where it has as many cells as the run, and
counts the less the more of the time is done: log n is the mean of both, with weights of 1 - (t/T)^2
and (t/T)^2. What a step costs with more cells than there have been is unknown as well: one step of
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
_FEW: Final = 5  # steps before anything is said
_MOST_POINTS: Final = 400  # ahead at which the population is taken
_FITTED: Final = 65  # points of the course that the growth is taken from
_MOST_COURSE: Final = 4096  # points of the course that are kept


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
    """Notes steps and tells the wall time that is left.

    Parameters
    ----------
    duration : s
        Simulated time at the end.
    stop_cells
        Number of cells at which the run ends before, or None.
    cycle : s
        Time in which cells double at the fastest.

    Attributes
    ----------
    forecast : Forecast or None
        Of the scene.
    """

    def __init__(
        self, duration: float, stop_cells: int | None = None, cycle: float = math.inf
    ) -> None:
        self._duration, self._stop = duration, stop_cells
        self._fastest = math.log(2.0) / cycle if cycle < math.inf else math.inf
        self._times: list[float] = []
        self._logs: list[float] = []
        self._recent: list[float] = []
        self._waiting: list[tuple[float, float]] = []
        self._sums = [0.0] * 5
        self._count = 0
        self._length = 0.0
        self.forecast: Forecast | None = None

    def note(self, time: float, cells: int, wall: float) -> None:
        """Note a step that ended at a simulated time with so many cells, and its wall time, s."""
        self._recent = [*self._recent[-_USUAL + 1 :], wall]
        self._waiting.append((float(max(cells, 1)), wall))
        self._count += 1
        if self._count >= _FEW:
            usual = median(self._recent)
            for n, cost in self._waiting:
                self._add(n, min(cost, _OUTLIER * usual))
            self._waiting.clear()
        self._length = time - self._times[-1] if self._times else time
        self._times.append(time)
        self._logs.append(math.log(max(cells, 1)))
        if len(self._times) > _MOST_COURSE:
            del self._times[1::2], self._logs[1::2]

    def _add(self, n: float, cost: float) -> None:
        """Add a step to the sums of the fit."""
        new = (1.0, n, n * n, cost, n * cost)
        self._sums = [_FADING * old + x for old, x in zip(self._sums, new, strict=True)]

    def left(self) -> float | None:
        """Return the wall time that is left in s; None before it can be told."""
        ahead = self._duration - self._times[-1] if self._times else 0.0
        if self._count < _FEW or not self._length > 0.0:
            return None
        if ahead <= 0.0:
            return 0.0
        points = np.linspace(0.0, ahead, _MOST_POINTS)
        cells = self._population(points)
        if self._stop is not None and cells[-1] > self._stop:
            cells = cells[cells < self._stop]
        constant, slope = self._cost(float(cells.mean()) if len(cells) else 0.0)
        share = len(cells) / len(points)
        mean = float(cells.mean()) if len(cells) else 0.0
        return (constant + slope * mean) * share * ahead / self._length

    def _cost(self, ahead: float) -> tuple[float, float]:
        """Return a and b of a step's cost a + b n, s; neither is negative.

        With a forecast a step with ``ahead`` cells counts as one that has been measured.
        """
        sums = self._sums
        if self.forecast is not None:
            mean, a, b = sums[1] / sums[0], self.forecast.constant, self.forecast.slope
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

    def _population(self, ahead: np.ndarray) -> np.ndarray:
        """Return the numbers of cells expected at times from now on."""
        logs = self._continued(ahead)
        if self.forecast is not None:
            done = (self._times[-1] / self._duration) ** 2
            logs = done * logs + (1.0 - done) * self._foreseen(self.forecast, ahead)
        return np.asarray(np.exp(np.minimum(logs, 700.0)))

    def _foreseen(self, forecast: Forecast, ahead: np.ndarray) -> np.ndarray:
        """Return log n at times from now on as the forecast has it after as many cells."""
        logs, now = np.log(np.maximum(forecast.cells, 1.0)), self._times[-1]
        if (np.diff(logs) >= 0.0).all():
            now = float(np.interp(self._logs[-1], logs, forecast.times))
        last = float(forecast.times[-1])
        course = np.interp(np.minimum(now + ahead, last), forecast.times, logs)
        slope = (logs[-1] - logs[-2]) / (last - float(forecast.times[-2]))
        course += slope * np.maximum(now + ahead - last, 0.0)
        return np.asarray(self._logs[-1] + course - np.interp(now, forecast.times, logs))

    def _continued(self, ahead: np.ndarray) -> np.ndarray:
        """Return log n at times from now on as the population has grown of late."""
        rate, bend = self._growth()
        now = self._logs[-1]
        if rate <= 0.0 or bend >= -1e-6 * rate * rate:
            return np.asarray(now + rate * ahead)
        power = rate * rate / -bend
        return np.asarray(now + power * np.log1p(rate * ahead / power))

    def _growth(self) -> tuple[float, float]:
        """Return the rate of growth now and its derivative, over the last half of the time.

        Of the parabola, or where that bends upwards the line, that fits log n best: cells that
        divide in step make n a staircase.
        """
        now = self._times[-1]
        times = np.linspace(0.5, 1.0, _FITTED) * now
        logs = np.interp(times, self._times, self._logs)
        course = times / now - 1.0
        bend, rate, _ = np.polyfit(course, logs, 2)
        if bend >= 0.0 or rate <= 0.0:
            bend, (rate, _) = 0.0, np.polyfit(course, logs, 1)
        return min(float(rate) / now, self._fastest), 2.0 * float(bend) / now**2


def in_words(seconds: float) -> str:
    """Return a wall time as a person would say it."""
    for unit, size in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 1.5 * size:
            return f"{seconds / size:.0f} {unit}"
    return f"{seconds:.0f} s"
