"""Predict the wall time that a run still takes.

A forecast of the scene gives the number of cells n over time and the cost of a coupling step,
a + b n. What a part of the run cost, compared with the forecast, scales what is left.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self, final

import numpy as np

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.scene.scene import Scene


@final
@dataclass(frozen=True)
class Forecast:
    """Expected cost of a run.

    - ``times``, (k,): simulated times from 0 to the end, s
    - ``cost``, (k,): of all coupling steps up to then, in any unit
    """

    times: FloatArray
    cost: FloatArray

    @classmethod
    def of(cls, scene: Scene) -> Self:
        """Return the forecast of a scene; it takes about half a second."""
        from multicell.report.explain.cost import cost_of_step
        from multicell.report.explain.course import course

        found, (constant, slope) = course(scene), cost_of_step(scene)
        return cls.of_steps(found.times, found.cells, constant, slope, scene.stop_cells)

    @classmethod
    def of_steps(
        cls,
        times: FloatArray,
        cells: FloatArray,
        constant: float,
        slope: float,
        stop_cells: int | None = None,
    ) -> Self:
        """Return the forecast of steps that cost constant + slope n; it ends at ``stop_cells``."""
        full = np.flatnonzero(cells >= (np.inf if stop_cells is None else stop_cells))
        end = int(full[0]) + 1 if len(full) else len(times)
        rate = constant + slope * cells[:end]
        parts = 0.5 * (rate[1:] + rate[:-1]) * np.diff(times[:end])
        return cls(times[:end], np.concatenate([[0.0], np.cumsum(parts)]))

    def left(self, begin: float, now: float, wall: float) -> float | None:
        """Return the wall time that is left, s; None where the forecast does not know.

        - ``begin``, ``now``, s: simulated times between which the wall time ``wall``, s, has passed
        """
        before, here = np.interp([begin, now], self.times, self.cost)
        if not here > before:
            return None
        return float(wall * (self.cost[-1] - here) / (here - before))
