"""Runs beside measured data: residuals and their sum of squares, without a fit."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import compress
from typing import TYPE_CHECKING, Any, final

import numpy as np

from multicell.cells import FloatArray
from multicell.errors import DataError
from multicell.host.extras import needs
from multicell.measured.data import ASSUMED, Datum, Measured, read_data
from multicell.measured.observables import value_at
from multicell.measured.table import read_measurements
from multicell.scene.scene import Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

Numbers = Mapping[str, FloatArray]


@final
@dataclass(frozen=True, eq=False)
class MeasuredComparison:
    """Runs of one scene beside measured data.

    Attributes
    ----------
    data
        The measurements that the runs have something to compare with.
    runs : (k, n) float64
        Value of each run in place of each datum, in base units.
    histories
        Of the runs: column -> (m,).
    units
        Base unit by observable.
    title
        Of the scene.
    notes
        What is not compared, and why.
    """

    data: tuple[Datum, ...]
    runs: FloatArray
    histories: tuple[Numbers, ...]
    units: Mapping[str, str]
    title: str
    notes: tuple[str, ...] = ()
    draw: Callable[[MeasuredComparison], Figure] | None = field(default=None, repr=False)

    @cached_property
    def _scaled(self) -> FloatArray:
        return _scaled(self.data, self.runs)

    @cached_property
    def model(self) -> FloatArray:
        """Mean of the runs in place of each datum, (n,) in base units."""
        mean = self._scaled.mean(axis=0)
        return np.array([math.exp(m) if d.log else m for d, m in zip(self.data, mean, strict=True)])

    @cached_property
    def residuals(self) -> FloatArray:
        """(runs - datum) / √(σ² + s² (1/N + 1/k)), (n,).

        σ is the error of the datum, N its number of tissues, s² the variance over the k runs: 0 for
        one run, of which nothing is known of it. Numbers of cells with a relative error compare by
        their logarithms.
        """
        count = len(self.runs)
        s = self._scaled.var(axis=0, ddof=1) if count > 1 else np.zeros(len(self.data))
        sigma = np.array([datum.sigma for datum in self.data])
        share = np.array([1.0 / datum.tissues for datum in self.data]) + 1.0 / count
        measured = np.array([datum.scaled(datum.value) for datum in self.data])
        found = (self._scaled.mean(axis=0) - measured) / np.sqrt(sigma**2 + s * share)
        return np.asarray(found)

    @property
    def chi_squared(self) -> float:
        """The sum of the squares of all residuals."""
        return float((self.residuals**2).sum())

    @property
    def words(self) -> str:
        """The sum of squares in words."""
        return f"χ² = {self.chi_squared:.3g} for {len(self.data)} data"

    def rows(self) -> list[dict[str, Any]]:
        """Return a row for each datum: observable, time in s, measured, sd, model, residual."""
        return [
            {
                "observable": datum.observable,
                "unit": self.units[datum.observable],
                "time_s": math.nan if datum.time is None else datum.time,
                "measured": datum.value,
                "sd": datum.deviation,
                "model": float(model),
                "residual": float(z),
                "place": datum.place,
            }
            for datum, model, z in zip(self.data, self.model, self.residuals, strict=True)
        ]

    def to_pandas(self) -> DataFrame:
        """Return :meth:`rows` as a table."""
        needs("pandas")
        import pandas as pd

        return pd.DataFrame(self.rows())

    def plot(self) -> Figure:
        """Draw the data with their errors over the runs, a panel for each observable."""
        assert self.draw is not None
        return self.draw(self)


def _scaled(data: Sequence[Datum], runs: FloatArray) -> FloatArray:
    """Return values of runs on the scales of comparison, (k, n)."""
    return np.array(
        [[d.scaled(v) for d, v in zip(data, run, strict=True)] for run in runs.tolist()]
    )


def compare_runs(
    scene: Scene,
    runs: Sequence[tuple[Numbers, Mapping[str, Any]]],
    source: Any,
    *,
    columns: str | Mapping[str, str] | None = None,
    where: str | None = None,
    sd: float | None = None,
    specimens: str = "same",
) -> MeasuredComparison:
    """Compare runs of one scene with measured data.

    - ``runs``: history and summary of each
    - ``source``, ``columns``, ``where``: as of :func:`read_measurements`
    - ``sd``, ``specimens``: as of :func:`read_data`

    Raises DataError for a table that cannot be used, or that has nothing that the runs have.
    """
    open_end = replace(scene, stop_cells=None)
    table = read_measurements(source, columns, where)
    sd = ASSUMED if sd is None else sd
    measured = read_data(table, open_end, sd=sd, specimens=specimens)
    data, notes = _of_scene(measured, open_end)
    values = np.array([[_value(datum, *run) for datum in data] for run in runs])
    known = np.asarray(np.isfinite(_scaled(data, values)).all(axis=0))
    if not known.any():
        problem = "has nothing to compare: no run has a value at the times of the data"
        raise DataError(measured.source, problem, "Times count from the start of the run.")
    if not known.all():
        first = data[int(np.argmin(known))]
        notes += [
            f"{int((~known).sum())} data have nothing to compare with, the first one "
            f"{first.observable} in {first.place}"
        ]
    kept = tuple(compress(data, known))
    if any(datum.assumed for datum in kept):
        notes += [f"data without an error have one of {100.0 * sd:g} %"]
    histories = tuple(history for history, _ in runs)
    title = scene.title or "Untitled run"
    return MeasuredComparison(
        kept, values[:, known], histories, measured.units, title, tuple(notes)
    )


def _of_scene(measured: Measured, scene: Scene) -> tuple[list[Datum], list[str]]:
    """Return the data that were measured under the conditions of a scene, without profiles."""
    same = {
        k
        for k, condition in enumerate(measured.conditions)
        if replace(condition.scene, duration=scene.duration) == scene
    }
    data = [datum for datum in measured.data if datum.condition in same]
    if not data:
        listed = "; ".join(condition.label for condition in measured.conditions[:4])
        problem = f"was measured under other conditions than those of the run: {listed}"
        raise DataError(measured.source, problem, "Choose rows by --where, or run the scene so.")
    notes, others = [], len(measured.data) - len(data)
    if others:
        notes.append(f"{others} data of other conditions are left out")
    deep = [datum for datum in data if datum.depth is not None]
    if deep:
        notes.append(f"{len(deep)} data at a depth are left out: fits compare those")
    return [datum for datum in data if datum.depth is None], notes


def _value(datum: Datum, history: Numbers, summary: Mapping[str, Any]) -> float:
    """Return a run's value in place of a datum; NaN where it has none."""
    time = None if datum.time is None else np.array([datum.time])
    return float(np.ravel(value_at(history, summary, datum.observable, time))[0])
