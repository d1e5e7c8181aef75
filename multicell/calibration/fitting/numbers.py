"""The numbers of a fit: best parameters, posterior, predictions, residuals, runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from multicell.calibration.fitting.emulator import draws as draws_of
from multicell.calibration.fitting.likelihood import Fresh
from multicell.calibration.fitting.problem import ABSENT_DEVIATIONS, FitProblem, misfit
from multicell.calibration.fitting.search import Evaluation, Run
from multicell.calibration.fitting.simulator import Reading
from multicell.calibration.fitting.unknown_scatter import (
    FittedScatter,
    drawn_factors,
    fitted_scatter,
)
from multicell.calibration.fitting.verdict import (
    EDGE,
    Interval,
    Undetermined,
    intervals,
    quantiles,
    undetermined,
)
from multicell.calibration.shared.confidence import BAND, LEVEL, TAILS
from multicell.calibration.shared.wording import value_in_words
from multicell.errors import FitFailed
from multicell.host.extras import needs
from multicell.measured.noise import Array
from multicell.report.wording import TimeUnit, time_unit

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from multicell.calibration.fitting.likelihood import Checks
    from multicell.measured.data import Datum
    from multicell.scene.scene import Scene


UNLIKELY: Final = 1e-3
"""Probability of a χ² below which a fit reports first that it does not fit."""


@final
@dataclass(frozen=True, eq=False)
class Best:
    """The best parameters: where the emulator's likelihood is largest, or the best that ran.

    The emulator keeps a single lucky run from deciding it. Where runs at its best point fit worse
    than the best of the search, by more than their scatter explains, that one is taken. The runs
    that stand for the best have seeds that had no part in finding it.

    - ``values``: by key of the scene, in base units
    - ``words``: by key: value and unit for people, ``"15.2 h"``
    - ``readings``, (n,): mean of fresh runs in place of each datum, base units
    - ``residuals``, (n,): in standard deviations; positive where the runs have more
    - ``chi_squared``: the sum of their squares
    - ``per_datum``: χ² over the number of data
    - ``settings``: by key: the values as :meth:`Scene.with_changes` takes them
    """

    values: Mapping[str, float]
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


@dataclass(frozen=True, eq=False)
class FitNumbers:
    """Numbers of a fit, without pages and pictures; fields: :class:`multicell.Fit`."""

    problem: FitProblem
    scene: Scene
    evaluations: Sequence[Evaluation]
    folder: Path | None
    facts: Mapping[str, Any]
    fresh: Fresh
    readings: Mapping[Run, Reading] = field(default_factory=dict)
    stated: FitProblem | None = None

    def __repr__(self) -> str:
        keys = ", ".join(r.key for r in self.problem.ranges)
        place = "in memory" if self.folder is None else f"in '{self.folder}'"
        counts = f"{len(self.problem.observed)} data, {len(self.evaluations)} points"
        return f"<Fit of {keys} to {counts}, {place}>"

    @cached_property
    def best(self) -> Best:
        """The best parameters, and what runs with other seeds than the search's show there."""
        problem = self.problem
        runs = self.fresh.runs
        whole = np.isfinite(runs).any(axis=1)
        again = runs[whole] if whole.any() else runs
        there = misfit(problem.observed, problem.sigma, again, None, problem.noise)
        values = problem.values([float(x) for x in self.fresh.shares])
        settings = {free.key: free.setting(values[free.key]) for free in problem.ranges}
        return Best(
            values=values,
            words={
                free.key: value_in_words(values[free.key], free.unit) for free in problem.ranges
            },
            readings=problem.unscale(there.means),
            residuals=there.residuals,
            chi_squared=there.chi_squared,
            per_datum=there.per_datum,
            settings=settings,
            _fitted=self.scene,
        )

    @cached_property
    def sample(self) -> Array | None:
        """Draws from the posterior as places in the ranges, (k, d).

        By the emulator of the search and fresh runs; None where too few points were tried, or
        fresh runs failed.
        """
        found = self.fresh.likelihood
        return None if found is None else draws_of(found.loss, self.problem.prior, seed=0)

    @property
    def posterior(self) -> pd.DataFrame:
        """Draws: a column for each parameter in base units, and ``weight``, which is the same.

        Where the scatter of the data is fitted, ``scatter_OBSERVABLE`` is the factor on the stated
        errors. Its ``attrs`` hold the units.
        """
        needs("pandas")
        import pandas

        shares = self.some_sample()
        columns = self.problem.columns(shares)
        more = {f"scatter_{name}": x for name, x in self._factors.items()}
        weight = np.full(len(shares), 1.0 / len(shares))
        frame = pandas.DataFrame({**columns, **more, "weight": weight})
        frame.attrs = {"units": {free.name: free.unit for free in self.problem.ranges}}
        return frame

    def intervals(self, level: float = LEVEL) -> dict[str, Interval]:
        """Return a central credible interval of each parameter by its name, base units."""
        return intervals(self.problem.ranges, self.some_sample(), level)

    def to_xarray(self) -> xr.Dataset:
        """Return the posterior as a data set: draws by name, with units and ranges.

        Coordinates are ``chain`` (one) and ``draw``; attributes of each variable are ``units``,
        ``key`` and ``range`` (base units).
        """
        needs("xarray")
        import xarray

        shares = self.some_sample()
        columns = self.problem.columns(shares)
        variables = {
            free.name: (
                ("chain", "draw"),
                np.array([columns[free.name]], dtype=float),
                {"units": free.unit, "key": free.key, "range": [free.low, free.high]},
            )
            for free in self.problem.ranges
        }
        return xarray.Dataset(
            variables,
            coords={"chain": [0], "draw": np.arange(len(shares))},
            attrs={"scene": self.scene.title or "", "chi_squared": self.best.chi_squared},
        )

    @cached_property
    def scatter(self) -> Mapping[str, FittedScatter]:
        """Size of the errors of each observable, where they were fitted (``scatter="unknown"``)."""
        if self.stated is None:
            return {}
        return fitted_scatter(self.problem, self.stated, self._factors)

    @cached_property
    def _factors(self) -> dict[str, Array]:
        """Draws of the factors on the stated errors, where they were fitted."""
        known, runs, problem = self.fresh.likelihood, self.fresh.scatter, self.problem
        if self.stated is None or known is None or runs is None:
            return {}
        means, variances = known.predict(self.some_sample())
        scale = problem.sigma / self.stated.sigma
        others = runs.variance * (1.0 / problem.tissues + 1.0 / runs.count) + variances
        return drawn_factors(problem, means * scale, others * scale**2)

    @cached_property
    def chance(self) -> float:
        """Probability of a χ² as large as the best one's, were model and deviations right."""
        from scipy.stats import chi2

        freedom = max(1, len(self.best.residuals) - len(self.problem.ranges))
        return float(chi2.sf(self.best.chi_squared, freedom))

    @cached_property
    def _time_unit(self) -> TimeUnit:
        times = [datum.time or 0.0 for datum in self.problem.measured.data]
        return time_unit(max(times, default=0.0))

    def _title(self, datum: Datum) -> str:
        """Return the title of the readings of a datum, with its time in a unit that suits all."""
        deep = "" if datum.depth is None else f" {datum.depth:g} um deep"
        name = f"{datum.observable}{deep}"
        if datum.time is None:
            return f"{name} at the end"
        return f"{name} at {self._time_unit.text(datum.time)}"

    @property
    def misfit(self) -> str:
        """In words that the scene does not fit the data, and which; empty if it does."""
        if self.chance >= UNLIKELY:
            return ""
        best, data = self.best, self.problem.measured.data
        worst = np.argsort(-np.abs(best.residuals))[:3]
        said = ", ".join(
            f"{self._title(data[k])} ({data[k].place}) by {best.residuals[k]:+.3g} sd"
            for k in worst
        )
        return (
            f"The scene does not fit the data: χ² is {best.chi_squared:.4g} for {len(data)} data, "
            f"{best.per_datum:.3g} a datum (probability {self.chance:.1g}). The best runs are "
            f"furthest off at {said}. Best values and intervals are those of a model that is "
            "wrong, or of standard deviations that are too small."
        )

    @cached_property
    def contradictions(self) -> list[str]:
        """Contradictions within the result; empty if there are none."""
        found = []
        known = self.fresh.likelihood
        if self.fresh.missed and (known is None or known.mosaic is None):
            found.append(
                "The emulator's best point was worse than one that had run, which was taken: the "
                "intervals follow the emulator and may miss it."
            )
        if self.sample is None:
            return found
        for k, free in enumerate(self.problem.ranges):
            low, high = np.quantile(self.sample[:, k], TAILS)
            if not low - EDGE <= self.fresh.shares[k] <= high + EDGE:
                best = value_in_words(self.best.values[free.key], free.unit)
                found.append(f"The best value of {free.name}, {best}, is outside its interval.")
        return found

    @cached_property
    def undetermined(self) -> list[Undetermined]:
        """Combinations of parameters that the data leave undetermined; empty if there are none."""
        if self.sample is None:
            return []
        return undetermined(self.problem.ranges, self.sample, self.problem.prior)

    def predicted(self, levels: Sequence[float] = BAND) -> Array:
        """Return quantiles of what a tissue shows in place of each datum: (levels, n), base units.

        Over the posterior and over the scatter of runs; errors of measurement are not in it.
        """
        problem, known = self.problem, self.fresh.likelihood
        if known is None:
            return np.full((len(levels), len(problem.observed)), np.nan)
        found = known.predict(self.some_sample())[0]
        found = found + self._scatter * np.random.default_rng(0).standard_normal(found.shape)
        scaled = problem.observed + np.maximum(found, problem.lowest) * problem.sigma
        return np.array([problem.unscale(row) for row in quantiles(scaled, levels)])

    @property
    def _scatter(self) -> Array:
        """Standard deviation of one run, in σ of the data, (n,)."""
        if self.fresh.scatter is None:
            return np.full(len(self.problem.observed), np.nan)
        return np.asarray(np.sqrt(self.fresh.scatter.variance))

    @cached_property
    def _emulator_errors(self) -> tuple[Array, Array]:
        """Errors of the emulator over the posterior, its own and by checks, in σ: (n,) each."""
        none = np.full(len(self.problem.observed), np.nan)
        if self.fresh.likelihood is None or self.sample is None:
            return none, none
        assert self.fresh.checks is not None
        own = np.sqrt(self.fresh.likelihood.predict(self.sample)[1].mean(axis=0))
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
        scatter, (own, checked) = self._scatter, self._emulator_errors
        return [
            {
                "row": datum.place,
                "condition": data.conditions[datum.condition].label,
                "observable": datum.observable,
                "unit": data.units[datum.observable],
                "time": np.nan if datum.time is None else datum.time,
                "depth": np.nan if datum.depth is None else datum.depth,
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
            for k, datum in enumerate(data.data)
        ]

    @property
    def runs(self) -> pd.DataFrame:
        """All runs of search and checks: a row for each, with parameters and readings.

        Columns are ``point``, ``stage`` (``"search"``, or ``"fresh"`` for seeds that had no part in
        it), ``condition``, ``seed``, the parameters, a column for each reading as
        ``diameter at 2 d``, and ``reason`` where a run failed; base units.
        """
        needs("pandas")
        import pandas

        return pandas.DataFrame(self.run_rows())

    def run_rows(self) -> list[dict[str, Any]]:
        """Return the runs one by one; see :attr:`runs`."""
        problem, found = self.problem, []
        columns = list(dict.fromkeys(map(self._title, problem.measured.data)))
        numbers: dict[tuple[float, ...], int] = {}
        for (shares, condition, seed), reading in self.readings.items():
            values = problem.values(shares)
            row: dict[str, Any] = {
                "point": numbers.setdefault(shares, len(numbers)),
                "stage": "search" if seed in problem.seeds else "fresh",
                "condition": problem.measured.conditions[condition].label,
                "seed": seed,
                **{free.name: values[free.key] for free in problem.ranges},
                **dict.fromkeys(columns, np.nan),
            }
            titles = map(self._title, problem.measured.of(condition))
            row.update(zip(titles, reading.values, strict=True))
            found.append({**row, "reason": reading.reason})
        return found

    @property
    def notes(self) -> list[str]:
        """Notes for readers of the result on how it was found."""
        notes = [self.misfit] if self.misfit else []
        notes += self.contradictions
        if self.contradictions:
            notes.append("A larger budget lets the search find where they agree.")
        data = self.problem.measured.data
        assumed = sum(datum.assumed for datum in data)
        if assumed:
            said = f"{assumed} of {len(data)} data" if assumed < len(data) else "The data"
            notes.append(
                f"{said} come without a standard deviation: {100.0 * self.facts['sd']:g} % of the "
                "value was assumed, on which all intervals depend."
            )
        orders = self.problem.prior.constraints.texts()
        if orders:
            notes.append(f"Only values with {' and '.join(orders)} were searched.")
        notes += [
            f"The errors of {name} were fitted: a standard deviation of {found.words}, "
            f"{found.best:.3g} times the stated or assumed ones (95 %: {found.low:.3g} to "
            f"{found.high:.3g}). χ² is therefore about 1 a datum and says nothing of the model."
            for name, found in self.scatter.items()
        ]
        several = sum(1.0 < d.tissues < np.inf and not d.specimens for d in data)
        if several:
            notes.append(
                f"{several} of {len(data)} data are means of several tissues. These count as the "
                "same ones at all times, so that their scatter is correlated as that of runs is."
            )
        if self.fresh.checks is None:
            notes.append(f"There are no intervals: {self._lacking}.")
        elif self.fresh.likelihood is not None and self.fresh.likelihood.mosaic is not None:
            notes.append(
                "Data jump between runs: intervals count that runs show up to which one readings "
                "stay the same, and not where between two runs they jump."
            )
        else:
            notes += _emulator_notes(self.fresh.checks, data)
        if self.fresh.reasons:
            count = len(self.fresh.reasons)
            notes.append(f"{count} fresh runs failed, for example: {self.fresh.reasons[0]}.")
        failed = [e for e in self.evaluations if e.reasons]
        if failed:
            words = failed[0].reasons[0]
            notes.append(f"Runs of {len(failed)} sets of parameters failed, for example: {words}.")
        absent = int((self.best.residuals == ABSENT_DEVIATIONS).sum())
        if absent:
            notes.append(f"The best runs have nothing in place of {absent} of the data.")
        return notes

    def some_sample(self) -> Array:
        """Return the draws of :attr:`sample`; raises FitFailed where there are none."""
        if self.sample is None:
            hint = "A larger budget continues the fit."
            raise FitFailed(f"there is no posterior: {self._lacking}", hint)
        return self.sample

    @property
    def _lacking(self) -> str:
        """Why there is no posterior."""
        if self.fresh.scatter is None:
            return "fresh runs at the best point failed"
        return "too few points were tried"


def _emulator_notes(checks: Checks, data: Sequence[Datum]) -> list[str]:
    """Return notes on the intervals that an emulator gives."""
    notes = ["Intervals are those of Gaussian processes through the runs of the search."]
    off = np.flatnonzero(checks.off)
    if len(off):
        ratio = checks.found / checks.expected
        worst = data[int(off[np.argmax(ratio[off])])]
        notes.append(
            f"At {len(off)} of {len(data)} data runs at draws from the intervals are further "
            "from the emulator than its error and scatter explain, most at "
            f"'{worst.observable}' of {worst.place}: intervals were widened by that. A larger "
            "budget makes them narrower."
        )
    return notes
