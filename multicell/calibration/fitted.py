"""What a fit has found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np

from multicell.calibration.data import Datum
from multicell.calibration.distance import ABSENT, Array, misfit
from multicell.calibration.emulator import draws as draws_of
from multicell.calibration.fresh import Fresh
from multicell.calibration.posterior import Draws
from multicell.calibration.problem import Problem
from multicell.calibration.search import Evaluation, emulator_of
from multicell.calibration.verdict import (
    Interval,
    Undetermined,
    in_words,
    intervals,
    quantiles,
    undetermined,
)
from multicell.host.extras import needs

if TYPE_CHECKING:
    import pandas as pd

    from multicell.calibration.emulator import Emulator
    from multicell.calibration.fit_plots import FitPlots
    from multicell.calibration.likelihood import Likelihood
    from multicell.scene.scene import Scene


@final
@dataclass(frozen=True, eq=False)
class Best:
    """The best parameters: where the emulator's likelihood is largest, or the posterior's mean.

    No single lucky run decides it, and the runs that stand for it have seeds that had no part in
    finding it.

    - ``values``: by key of the scene, in base units
    - ``units``: base unit by key; empty for a number without
    - ``words``: by key: value and unit for people, ``"15.2 h"``
    - ``readings``, (n,): what fresh runs have in place of each datum (their mean), base units
    - ``residuals``, (n,): in standard deviations; positive where the runs have more
    - ``chi_squared``: the sum of their squares
    - ``per_datum``: χ² over the number of data
    - ``settings``: by key: the values as :meth:`Scene.with_changes` takes them
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
    fresh
        What runs with fresh seeds have shown at the best point and at draws from the intervals.
    """

    problem: Problem
    scene: Scene
    evaluations: Sequence[Evaluation]
    draws: Draws | None
    folder: Path | None
    facts: Mapping[str, Any]
    fresh: Fresh

    @cached_property
    def best(self) -> Best:
        """The best parameters, and what runs with other seeds than the search's show there."""
        problem = self.problem
        runs = self.fresh.runs
        whole = np.isfinite(runs).any(axis=1)
        again = runs[whole] if whole.any() else runs
        there = misfit(problem.observed, problem.sigma, again, None, problem.tissues)
        values = problem.values([float(x) for x in self.fresh.shares])
        units = {free.key: free.unit for free in problem.ranges}
        settings = {free.key: free.setting(values[free.key]) for free in problem.ranges}
        return Best(
            values=values,
            units=units,
            words={key: in_words(value, units[key]) for key, value in values.items()},
            readings=unscale(problem.measured.data, there.means),
            residuals=there.residuals,
            chi_squared=there.chi_squared,
            per_datum=there.per_datum,
            settings=settings,
            _fitted=self.scene,
        )

    @cached_property
    def sample(self) -> tuple[Array, Array] | None:
        """Draws from the posterior as places in the ranges (k, d), and their weights (k,).

        Sampled with runs where they were; otherwise by the emulator of the search and fresh runs.
        None where too few points were tried for either.
        """
        if self.draws is not None:
            return self.draws.shares, self.draws.weights
        found = self._likelihood
        if found is None:
            return None
        shares = draws_of(found.loss, len(self.problem.ranges), seed=0)
        return shares, np.full(len(shares), 1.0 / len(shares))

    @cached_property
    def _likelihood(self) -> Likelihood | Emulator | None:
        """What the intervals of a search come from; where fresh runs failed its emulator alone."""
        if self.fresh.likelihood is not None:
            return self.fresh.likelihood
        return emulator_of(self.problem, self.evaluations)

    @property
    def posterior(self) -> pd.DataFrame:
        """Weighted draws: a column for each parameter in base units, and ``weight``.

        Its ``attrs`` hold the units, and whether the draws are ``"exact"``, ``"tempered"`` (too
        wide: the budget ended early) or ``"emulated"`` (an emulator in place of runs).
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
        return "exact" if self.draws.temperature <= 1.0 else "tempered"

    def intervals(self, level: float = 0.95) -> dict[str, Interval]:
        """Return a central credible interval of each parameter by its name, base units."""
        return intervals(self.problem.ranges, *self._some_sample(), level)

    @cached_property
    def undetermined(self) -> list[Undetermined]:
        """What the data do not determine; empty if they determine all."""
        return [] if self.sample is None else undetermined(self.problem.ranges, *self.sample)

    def predicted(self, levels: Sequence[float] = (0.025, 0.5, 0.975)) -> Array:
        """Return quantiles of what a tissue shows in place of each datum: (levels, n), base units.

        Over the posterior and over the scatter of runs; errors of measurement are not in it.
        """
        problem = self.problem
        if self.draws is not None:
            found, weights = self.draws.residuals, self.draws.weights
        else:
            emulated = self._likelihood
            if emulated is None:
                return np.full((len(levels), len(problem.observed)), np.nan)
            found, weights = emulated.predict(self._some_sample()[0])[0], self._some_sample()[1]
            random = np.random.default_rng(0)
            found = found + self._scatter * random.standard_normal(found.shape)
            found = np.maximum(found, problem.lowest)
        scaled = problem.observed + found * problem.sigma
        rows = quantiles(scaled, weights, levels)
        return np.array([unscale(problem.measured.data, row) for row in rows])

    @property
    def _scatter(self) -> Array:
        """Standard deviation of one run, in σ of the data, (n,)."""
        if self.fresh.scatter is not None:
            return np.asarray(np.sqrt(self.fresh.scatter.variance))
        emulated = emulator_of(self.problem, self.evaluations)
        if emulated is None:
            return np.full(len(self.problem.observed), np.nan)
        # that of tissues, without that of the mean of some runs
        more = 1.0 / self.problem.tissues + 1.0 / len(self.problem.seeds)
        return np.asarray(np.sqrt(emulated.scatter / more))

    @cached_property
    def _emulator_errors(self) -> tuple[Array, Array]:
        """Errors of the emulator over the posterior, its own and by checks, in σ: (n,) each."""
        none = np.full(len(self.problem.observed), np.nan)
        if self.fresh.likelihood is None or self.sample is None:
            return none, none
        assert self.fresh.checks is not None
        own = np.sqrt(self.fresh.likelihood.predict(self.sample[0])[1].mean(axis=0))
        return own, self.fresh.checks.found

    def residuals(self) -> pd.DataFrame:
        """Return the data one by one: where, when, measured, in the runs, and how far apart."""
        import pandas

        return pandas.DataFrame(self.rows())

    def rows(self) -> list[dict[str, Any]]:
        """Return the data one by one beside the best runs, base units.

        ``scatter`` is the standard deviation of one run; ``emulator_error`` that of the emulator
        over the posterior, and ``check`` how far runs at draws from it are from the emulator (root
        mean square), of which scatter is a part.
        """
        data, best = self.problem.measured, self.best
        rows = []
        scatter, (own, checked) = self._scatter, self._emulator_errors
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
                    "tissues": datum.tissues,
                    "run": float(best.readings[k]),
                    "residual": float(best.residuals[k]),
                    "scatter": float(scatter[k]) * datum.deviation,
                    "emulator_error": float(own[k]) * datum.deviation,
                    "check": float(checked[k]) * datum.deviation,
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
        several = sum(1.0 < datum.tissues < np.inf for datum in data)
        if several:
            notes.append(
                f"{several} of {len(data)} data are means of several tissues. These count as the "
                "same ones at all times, so that their scatter is correlated as that of runs is."
            )
        if self.draws is not None and any(datum.tissues > 1.0 for datum in data):
            notes.append(
                "Draws of the posterior are single runs, whose scatter counts in full also for "
                "means of several tissues: intervals are too wide."
            )
        if "coarse" in self.facts:
            notes.append(self.facts["coarse"]["words"])
        if self.kind == "emulated":
            notes += self._emulator_notes()
        if self.kind == "tempered":
            assert self.draws is not None
            notes.append(
                f"The budget ended at temperature {self.draws.temperature:.3g}: intervals are too "
                "wide. A larger budget continues from there."
            )
        if self.kind == "none":
            notes.append("Too few points were tried for intervals.")
        if self.fresh.reasons:
            count = len(self.fresh.reasons)
            notes.append(f"{count} fresh runs failed, for example: {self.fresh.reasons[0]}.")
        failed = [e for e in self.evaluations if e.reasons]
        if failed:
            words = failed[0].reasons[0]
            notes.append(f"Runs of {len(failed)} sets of parameters failed, for example: {words}.")
        absent = int((self.best.residuals == ABSENT).sum())
        if absent:
            notes.append(f"The best runs have nothing in place of {absent} of the data.")
        return notes

    def _emulator_notes(self) -> list[str]:
        """Return what is known of intervals that an emulator gives."""
        notes = [
            "Intervals are those of Gaussian processes through the runs of the search: method "
            "'posterior' samples them with runs."
        ]
        if self.fresh.likelihood is None or self.fresh.checks is None:
            notes.append(
                "The scatter of runs is known from the seeds of the search alone, since fresh runs "
                "at the best point failed: intervals are too narrow where runs scatter."
            )
            return notes
        off = np.flatnonzero(self.fresh.checks.off)
        if len(off):
            data = self.problem.measured.data
            ratio = self.fresh.checks.found / self.fresh.checks.expected
            worst = data[int(off[np.argmax(ratio[off])])]
            notes.append(
                f"At {len(off)} of {len(data)} data runs at draws from the intervals are further "
                "from the emulator than its error and scatter explain, most at "
                f"'{worst.observable}' of {worst.place}: intervals were widened by that. A larger "
                "budget makes them narrower."
            )
        return notes

    @property
    def plot(self) -> FitPlots:
        """Pictures: ``plot()`` shows data and runs, ``plot.parameters()`` the posterior."""
        from multicell.calibration.fit_plots import FitPlots

        return FitPlots(self)

    def report(self, folder: str | Path | None = None) -> Path:
        """Write ``report.html`` with its pictures, and return the path of the page.

        Raises
        ------
        OutputError
            If there is no folder, or it cannot be written to.
        """
        from multicell.calibration.fit_page import write_report

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
                "too few points were tried for a posterior", "A larger budget continues the fit."
            )
        return self.sample


def unscale(data: Sequence[Datum], values: Array) -> Array:
    """Return values on the scales of comparison in base units."""
    return np.array([np.exp(v) if d.log else v for d, v in zip(data, values, strict=True)])
