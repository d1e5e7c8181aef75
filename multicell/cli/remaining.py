"""Predict the wall time that a run still takes.

A forecast of the scene gives the number of cells n over time and the cost of a coupling step,
a + b n. It is read from where it has as many cells as the run, and scaled by what the latest steps
cost compared with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import median
from typing import TYPE_CHECKING, Final, Self, final

import numpy as np

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.scene.scene import Scene

_FADING: Final = 0.99
"""Weight of a step over that of the next."""
_OUTLIER: Final = 4.0
"""A step counts at most this often the median cost: compilation comes once."""
_MEDIAN_OF: Final = 15
_MIN_STEPS: Final = 3
_POINTS: Final = 400


@final
@dataclass(frozen=True)
class Forecast:
    """Expected growth of a population and cost of a coupling step.

    Attributes
    ----------
    times, cells : (k,)
        Simulated times from 0 on, s, and the number of cells then.
    constant, slope
        Of the cost of a step, constant + slope n, in any unit.
    """

    times: FloatArray
    cells: FloatArray
    constant: float
    slope: float

    @classmethod
    def of(cls, scene: Scene) -> Self:
        """Return the forecast of a scene; it takes about half a second."""
        from multicell.report.explain.cost import cost_of_step
        from multicell.report.explain.course import course

        found = course(scene)
        return cls(found.times, found.cells, *cost_of_step(scene))

    def continued(self, time: float, cells: int, ahead: FloatArray) -> FloatArray:
        """Return the cells at times ``ahead`` of one with a number of cells, (k,)."""
        logs, now = np.log(np.maximum(self.cells, 1.0)), time
        if (np.diff(logs) >= 0.0).all():
            now = float(np.interp(np.log(max(cells, 1)), logs, self.times))
        last = float(self.times[-1])
        course = np.interp(np.minimum(now + ahead, last), self.times, logs)
        slope = (logs[-1] - logs[-2]) / (last - float(self.times[-2]))
        course += slope * np.maximum(now + ahead - last, 0.0)
        change = course - np.interp(now, self.times, logs)
        return np.asarray(max(cells, 1) * np.exp(np.minimum(change, 600.0)))


@final
class Remaining:
    """Notes steps and predicts the wall time that is left.

    Parameters
    ----------
    duration : s
        Simulated time at the end.
    forecast
        Of the scene.
    stop_cells
        Number of cells at which the run ends before, or None.
    """

    def __init__(self, duration: float, forecast: Forecast, stop_cells: int | None = None) -> None:
        self._duration, self._forecast, self._stop = duration, forecast, stop_cells
        self._recent: list[tuple[float, float]] = []
        self._wall = self._expected = self._time = self._step = 0.0
        self._cells = self._count = 0

    def note(self, time: float, step: float, cells: int, wall: float) -> None:
        """Note a coupling step of ``step`` s that ended at a simulated time, and its wall time."""
        expected = self._forecast.constant + self._forecast.slope * cells
        self._recent = [*self._recent[1 - _MEDIAN_OF :], (wall, expected)]
        usual = median(spent / foreseen for spent, foreseen in self._recent)
        self._wall = _FADING * self._wall + min(wall, _OUTLIER * usual * expected)
        self._expected = _FADING * self._expected + expected
        self._time, self._step, self._cells = time, step, cells
        self._count += 1

    def left(self) -> float | None:
        """Return the wall time that is left in s; None before it can be predicted."""
        ahead = self._duration - self._time
        if self._count < _MIN_STEPS or not self._step > 0.0:
            return None
        if ahead <= 0.0:
            return 0.0
        cells = self._forecast.continued(self._time, self._cells, np.linspace(0.0, ahead, _POINTS))
        if self._stop is not None:
            cells = cells[cells < self._stop]
        cost = self._forecast.constant * len(cells) + self._forecast.slope * cells.sum()
        return float(self._wall / self._expected * cost / _POINTS * ahead / self._step)


def in_words(seconds: float) -> str:
    """Return a wall time as a person would say it."""
    for unit, size in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 1.5 * size:
            return f"{seconds / size:.0f} {unit}"
    return f"{seconds:.0f} s"
