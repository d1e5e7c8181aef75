"""One run of a fit: from values of the free parameters to what the data are compared with.

It happens on workers: what travels there are a scene as plain values and the data of one condition,
and back comes one number for each datum.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np
from numpy.typing import NDArray

from multicell.errors import MulticellError
from multicell.measured.data import Datum, Measured
from multicell.measured.observables import course_of, entry_of
from multicell.results.observables import centre, field_at, uniform_radius
from multicell.studies.axes import Range
from multicell.studies.runs import PlainScene

if TYPE_CHECKING:
    from multicell.simulation import Simulation

OUTGROWN: Final = {"cells": 3.0, "diameter": 1.5}
"""A run ends when one of these is so many times the largest one measured in its condition."""


@final
@dataclass(frozen=True)
class Reading:
    """Readings of a run in place of each datum.

    - ``values``: one for each datum of the condition, in base units; NaN where the run has none
    - ``reason``: why a run failed; empty for one that did not
    """

    values: tuple[float, ...]
    reason: str = ""


Simulator = Callable[[Sequence[float], int, int], Reading]
"""What stands for the runs of a scene: returns what a run gives.

Its arguments are the place of each free parameter in its range, from 0 to 1, the number of the
condition, and the seed of the run's random numbers. It must be able to travel to workers.
"""


@final
@dataclass(frozen=True)
class SceneSimulator:
    """Runs of a scene under the conditions of measured data.

    - ``scenes``: the scene of each condition
    - ``data``: the data of each condition
    - ``ranges``: the free parameters
    """

    scenes: tuple[PlainScene, ...]
    data: tuple[tuple[Datum, ...], ...]
    ranges: tuple[Range, ...]

    @classmethod
    def of(cls, measured: Measured, ranges: Sequence[Range]) -> SceneSimulator:
        """Return the simulator that stands for the conditions of some data."""
        scenes = tuple(PlainScene.of(condition.scene) for condition in measured.conditions)
        data = tuple(tuple(measured.of(k)) for k in range(len(scenes)))
        return cls(scenes, data, tuple(ranges))

    def __call__(self, shares: Sequence[float], condition: int, seed: int) -> Reading:
        """Run the scene; a run that fails is a reading of NaN with its reason."""
        data = self.data[condition]
        try:
            return Reading(tuple(self._run(shares, condition, seed)))
        except MulticellError as error:
            return Reading((float("nan"),) * len(data), str(error))

    def _run(self, shares: Sequence[float], condition: int, seed: int) -> list[float]:
        from multicell.simulation import Simulation

        data = self.data[condition]
        changes: dict[str, Any] = {
            free.key: free.setting(free.value(share))
            for free, share in zip(self.ranges, shares, strict=True)
        }
        scene = self.scenes[condition].load().with_changes({**changes, "seed": seed})
        simulation = Simulation(scene, threads=1)
        watch = _Watch(data)
        watch.add(simulation)
        while not simulation.finished and not watch.done:
            simulation.step()
            watch.add(simulation)
        of_the_end = any(datum.column not in watch.columns for datum in data)
        summary = simulation.summary() if of_the_end else {}
        return [watch.reading(datum, summary) for datum in data]


@final
class _Watch:
    """The history of a run as far as its data ask for it."""

    def __init__(self, data: Sequence[Datum]) -> None:
        self._data = data
        self._rows: list[dict[str, float]] = []
        self._limits: dict[str, float] = {}
        for datum in data:
            if (name := datum.observable) in OUTGROWN:
                limit = OUTGROWN[name] * datum.value
                self._limits[name] = max(limit, self._limits.get(name, 0.0))
        self.outgrown = False

    def add(self, simulation: Simulation) -> None:
        """Take in the state of a run."""
        row = simulation.history_row()
        # not at the start, which the fit may not change
        if self._rows:
            self.outgrown |= any(row[name] > limit > 0.0 for name, limit in self._limits.items())
        profiles = [d for d in self._data if d.depth is not None]
        asked = [d for d in profiles if self._asks(d, simulation)]
        row |= dict.fromkeys((d.column for d in profiles), math.nan) | _at_depths(simulation, asked)
        self._rows.append(row)

    def _asks(self, datum: Datum, simulation: Simulation) -> bool:
        """Return whether a profile is needed now: at the end, and next to the time of a datum."""
        if simulation.finished or self.outgrown:
            return True
        if datum.time is None:
            return False
        before = self._rows[-1]["time"] if self._rows else -math.inf
        return before < datum.time <= simulation.timeline.next_time * (1.0 + 1e-9)

    @property
    def columns(self) -> Mapping[str, float]:
        """The first row, whose names are those of the history."""
        return self._rows[0]

    @property
    def done(self) -> bool:
        """Whether no datum asks for more of the run."""
        now = self._rows[-1]["time"]
        return self.outgrown or all(d.time is not None and now >= d.time for d in self._data)

    def reading(self, datum: Datum, summary: Mapping[str, Any]) -> float:
        """Return the reading of a run's history in place of a datum, NaN if it has none."""
        if datum.column not in self.columns:
            return entry_of(summary, datum.observable)
        history = {name: np.array([row[name] for row in self._rows]) for name in self._rows[0]}
        return reading(history, datum, outgrown=self.outgrown)


def _at_depths(simulation: Simulation, data: Sequence[Datum]) -> dict[str, float]:
    """Return the mean of fields over shells at depths below the surface, by column, mM."""
    if not data:
        return {}
    cells, dimensions = simulation.cells, simulation.scene.dimensions
    middle = centre(cells, dimensions)
    radius = uniform_radius(cells, middle, dimensions)
    fields = simulation.fields
    return {
        d.column: field_at(fields[d.observable], middle, radius - (d.depth or 0.0)) for d in data
    }


def reading(
    history: Mapping[str, NDArray[np.float64]], datum: Datum, *, outgrown: bool = False
) -> float:
    """Return the run's reading in place of a datum, NaN if it has none.

    Values are linear between rows. Where there is no necrotic core the viable rim is taken to be
    the radius, which is what it tends to as a core vanishes. A run that has outgrown its data and
    was ended has its last values for later times.
    """
    times = history["time"]
    values = course_of(history, datum.column)
    when = float(times[-1]) if datum.time is None else datum.time
    # the last step may miss the end by rounding
    if not when <= times[-1] * (1.0 + 1e-9):
        return float(values[-1]) if outgrown else float("nan")
    return float(np.interp(when, times, values))
