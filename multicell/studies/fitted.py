"""What a fit has found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np

from multicell.extras import needs
from multicell.studies.data import Datum
from multicell.studies.distance import Array
from multicell.studies.posterior import Draws
from multicell.studies.problem import Problem
from multicell.studies.search import Evaluation, emulator_of
from multicell.studies.verdict import (
    Interval,
    Undetermined,
    correlations,
    in_words,
    intervals,
    quantiles,
    undetermined,
)

if TYPE_CHECKING:
    import pandas as pd

    from multicell.scene.scene import Scene
    from multicell.studies.fit_plots import FitPlots


@final
@dataclass(frozen=True, eq=False)
class Best:
    """The best parameters that were tried.

    Attributes
    ----------
    values
        By key of the scene, in base units.
    units
        Base unit by key; empty for a number without.
    words
        By key: value and unit for people, ``"15.2 h"``.
    readings : (n,)
        What the runs have in place of each datum (the mean over seeds), base units.
    residuals : (n,)
        In standard deviations; positive where the runs have more.
    chi_squared
        The sum of their squares.
    per_datum
        χ² over the number of data.
    settings
        By key: the values as :meth:`Scene.with_changes` takes them.
    """

    values: Mapping[str, float]
    units: Mapping[str, str]
    words: Mapping[str, str]
    readings: Array
    residuals: Array
    chi_squared: float
    per_datum: float
    settings: Mapping[str, Any]
    _fitted: Scene

    @cached_property
    def scene(self) -> Scene:
        """The scene with these values."""
        return self._fitted.with_changes(self.settings)


@final
@dataclass(frozen=True, eq=False)
class Fit:
    """Parameters of a scene, fitted to data; :func:`multicell.fit` makes it.

    Attributes
    ----------
    problem
        Data, ranges and what simulates.
    scene
        What was fitted.
    evaluations
        All parameters that the search tried; empty with ``method="posterior"``.
    draws
        From the posterior, sampled with runs; None with ``method="best"``.
    folder
        Of the results, or None.
    facts
        How the fit was made: method, numbers of runs, seconds.
    """

    problem: Problem
    scene: Scene
    evaluations: Sequence[Evaluation]
    draws: Draws | None
    folder: Path | None
    facts: Mapping[str, Any]

    @cached_property
    def best(self) -> Best:
        """The parameters whose runs are nearest to the data."""
        problem = self.problem
        if self.evaluations:
            found = min(self.evaluations, key=lambda e: e.misfit.loss)
            shares, means, residuals = found.shares, found.misfit.means, found.misfit.residuals
        else:
            assert self.draws is not None
            row = int(np.argmin((self.draws.residuals**2).sum(axis=1)))
            shares, residuals = self.draws.shares[row], self.draws.residuals[row]
            means = problem.observed + residuals * problem.sigma
        values = problem.values([float(x) for x in shares])
        units = {free.key: free.unit for free in problem.ranges}
        settings = {free.key: free.setting(values[free.key]) for free in problem.ranges}
        chi_squared = float((residuals**2).sum())
        return Best(
            values=values,
            units=units,
            words={key: in_words(value, units[key]) for key, value in values.items()},
            readings=unscaled(problem.measured.data, means),
            residuals=residuals,
            chi_squared=chi_squared,
            per_datum=chi_squared / len(residuals),
            settings=settings,
            _fitted=self.scene,
        )

    @property
    def exact(self) -> bool:
        """Whether the posterior is sampled with runs at temperature 1, and no approximation."""
        return self.draws is not None and self.draws.temperature <= 1.0

    @cached_property
    def sample(self) -> tuple[Array, Array] | None:
        """Draws from the posterior as places in the ranges (k, d), and their weights (k,).

        Sampled with runs where they were; otherwise by the polynomials of the search. None where
        too few points were tried for either.
        """
        if self.draws is not None:
            return self.draws.shares, self.draws.weights
        found = emulator_of(self.problem, self.evaluations)
        if found is None:
            return None
        shares = found.sample(seed=0)
        return shares, np.full(len(shares), 1.0 / len(shares))

    @property
    def posterior(self) -> pd.DataFrame:
        """Weighted draws: a column for each parameter in base units, and ``weight``.

        Its ``attrs`` hold the units, and whether the draws are ``"exact"``, ``"tempered"`` (too
        wide: the budget ended early) or ``"emulated"`` (polynomials in place of runs).
        """
        needs("pandas")
        import pandas

        shares, weights = self._some_sample()
        columns = {
            free.name: [free.value(float(x)) for x in column]
            for free, column in zip(self.problem.ranges, shares.T, strict=True)
        }
        frame = pandas.DataFrame({**columns, "weight": weights})
        frame.attrs = {
            "units": {free.name: free.unit for free in self.problem.ranges},
            "kind": self.kind,
        }
        return frame

    @property
    def kind(self) -> str:
        """What the posterior is: ``"exact"``, ``"tempered"``, ``"emulated"`` or ``"none"``."""
        if self.draws is None:
            return "emulated" if self.sample is not None else "none"
        return "exact" if self.exact else "tempered"

    def intervals(self, level: float = 0.95) -> dict[str, Interval]:
        """Return a central credible interval of each parameter by its name, base units."""
        return intervals(self.problem.ranges, *self._some_sample(), level)

    def correlations(self) -> pd.DataFrame:
        """Return the correlations of the parameters, on the scales of their ranges."""
        import pandas

        names = self.problem.names
        return pandas.DataFrame(correlations(*self._some_sample()), index=names, columns=names)

    @cached_property
    def undetermined(self) -> list[Undetermined]:
        """What the data do not determine; empty if they determine all."""
        if self.sample is None:
            return []
        return undetermined(self.problem.ranges, *self.sample)

    def predicted(self, levels: Sequence[float] = (0.025, 0.5, 0.975)) -> Array:
        """Return quantiles of what a tissue shows in place of each datum: (levels, n), base units.

        Over the posterior and over the scatter of runs; errors of measurement are not in it.
        """
        problem = self.problem
        if self.draws is not None:
            found, weights = self.draws.residuals, self.draws.weights
        else:
            polynomials = emulator_of(problem, self.evaluations)
            if polynomials is None:
                return np.full((len(levels), len(problem.observed)), np.nan)
            found, weights = polynomials.means(self._some_sample()[0]), self._some_sample()[1]
            random = np.random.default_rng(0)
            # that of tissues, without that of the mean of some runs
            spread = np.sqrt(polynomials.scatter / (1.0 + 1.0 / len(problem.seeds)))
            found = found + spread * random.standard_normal(found.shape)
        scaled = problem.observed + found * problem.sigma
        rows = np.array([quantiles(column, weights, levels) for column in scaled.T]).T
        return np.array([unscaled(problem.measured.data, row) for row in rows])

    def residuals(self) -> pd.DataFrame:
        """Return the data one by one: where, when, measured, in the runs, and how far apart."""
        import pandas

        return pandas.DataFrame(self.rows())

    def rows(self) -> list[dict[str, Any]]:
        """Return the data one by one beside the best runs, base units."""
        data, best = self.problem.measured, self.best
        rows = []
        for k, datum in enumerate(data.data):
            rows.append(
                {
                    "row": datum.place,
                    "condition": data.conditions[datum.condition].label,
                    "observable": datum.observable,
                    "unit": data.units[datum.observable],
                    "time": np.nan if datum.time is None else datum.time,
                    "at": "" if datum.at is None else f"{datum.at[0]} = {datum.at[1]:g}",
                    "measured": datum.value,
                    "sd": datum.deviation,
                    "assumed": datum.assumed,
                    "run": float(best.readings[k]),
                    "residual": float(best.residuals[k]),
                }
            )
        return rows

    @property
    def notes(self) -> list[str]:
        """What whoever reads the result must know of how it was found."""
        notes = []
        data = self.problem.measured.data
        assumed = sum(datum.assumed for datum in data)
        if assumed:
            said = f"{assumed} of {len(data)} data" if assumed < len(data) else "The data"
            notes.append(
                f"{said} come without a standard deviation: {100.0 * self.facts['sd']:g} % of the "
                "value was assumed, on which all intervals depend."
            )
        if self.evaluations and len(self.problem.seeds) == 1:
            notes.append("With one seed the scatter between runs is unknown and counted as none.")
        if self.kind == "emulated":
            notes.append(
                "Intervals are those of polynomials fitted to the runs of the search: "
                "method 'posterior' samples them with runs."
            )
        if self.kind == "tempered":
            assert self.draws is not None
            notes.append(
                f"The budget ended at temperature {self.draws.temperature:.3g}: intervals are too "
                "wide. A larger budget goes on from there."
            )
        if self.kind == "none":
            notes.append("Too few points were tried to tell intervals.")
        failed = [e for e in self.evaluations if e.reasons]
        if failed:
            words = failed[0].reasons[0]
            notes.append(f"Runs of {len(failed)} sets of parameters failed, for example: {words}.")
        absent = int((self.best.residuals == 100.0).sum())
        if absent:
            notes.append(f"The best runs have nothing in place of {absent} of the data.")
        return notes

    @property
    def plot(self) -> FitPlots:
        """Pictures: ``plot()`` shows data and runs, ``plot.parameters()`` the posterior."""
        from multicell.studies.fit_plots import FitPlots

        return FitPlots(self)

    def report(self, folder: str | Path | None = None) -> Path:
        """Write ``report.html`` with its pictures, and return the path of the page.

        Raises
        ------
        OutputError
            If there is no folder, or it cannot be written to.
        """
        from multicell.studies.fit_page import write_report

        return write_report(self, folder)

    def summary(self) -> dict[str, Any]:
        """Return the result as plain values."""
        best = self.best
        known = self.intervals() if self.sample is not None else {}
        parameters = {}
        for free in self.problem.ranges:
            interval = known.get(free.name)
            parameters[free.key] = {
                "name": free.name,
                "unit": free.unit,
                "best": best.values[free.key],
                "median": None if interval is None else interval.median,
                "interval": None if interval is None else [interval.low, interval.high],
                "part_of_range": None if interval is None else interval.part,
                "range": [free.low, free.high],
                "log": free.log,
            }
        return {
            "parameters": parameters,
            "posterior": self.kind,
            "chi_squared": best.chi_squared,
            "chi_squared_per_datum": best.per_datum,
            "data": len(best.residuals),
            "undetermined": [
                {"names": list(u.names), "kind": u.kind, "words": u.words}
                for u in self.undetermined
            ],
            "residuals": self.rows(),
            "notes": self.notes,
            **self.facts,
        }

    def _some_sample(self) -> tuple[Array, Array]:
        if self.sample is None:
            from multicell.errors import FitFailed

            raise FitFailed(
                "too few points were tried for a posterior", "A larger budget goes on with the fit."
            )
        return self.sample


def unscaled(data: Sequence[Datum], values: Array) -> Array:
    """Return values on the scales of comparison in base units."""
    return np.array([np.exp(v) if d.log else v for d, v in zip(data, values, strict=True)])
