"""The page of a fit."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from multicell.calibration.fitting.plots import FitPlots
from multicell.calibration.fitting.predictive import predictive_check
from multicell.calibration.shared.wording import value_in_words
from multicell.errors import OutputError
from multicell.report.html import write_page
from multicell.report.wording import clock, time_unit, written

if TYPE_CHECKING:
    from multicell.calibration.fitting.numbers import FitNumbers


_DATA: Final = (
    "Data with their standard deviations, the best runs (lines) and the band that the posterior "
    "gives: what 95 % of tissues would show."
)
_DEVIATIONS: Final = (
    "Residual of each datum in standard deviations, positive where the best runs have more. "
    "Between the dashed lines lie 95 % of them if model and deviations are right."
)
_POSTERIOR: Final = (
    "Posterior of the parameters; axes are the ranges searched, or of narrow posteriors a part of "
    "them. Red: best. Dashed: before the data. Dotted: ends of 95 % intervals."
)


def write_fit_report(fit: FitNumbers, folder: str | Path | None = None) -> Path:
    """Write ``report.html`` and its pictures, and return the page."""
    place = fit.folder if folder is None else Path(folder)
    if place is None:
        raise OutputError("the fit has no folder to report to: name one")
    plots = FitPlots(fit)
    return write_page(
        place / "report.html",
        "fit.html",
        scene=fit.best.scene,
        title=f"{fit.scene.title or 'Untitled scene'}: fit",
        subtitle="best point by Optuna and Gaussian processes · data: "
        f"{fit.problem.measured.source}",
        tiles=_tiles(fit),
        misfit=fit.misfit,
        pictures={
            **({"deviations.png": (plots.deviations, _DEVIATIONS)} if fit.misfit else {}),
            "data.png": (plots.data, _DATA),
            "parameters.png": (plots.parameters, _POSTERIOR),
        },
        parameters=parameters_in_words(fit),
        undetermined=[str(entry) for entry in fit.undetermined],
        notes=[note for note in fit.notes if note != fit.misfit],
        emulated=fit.sample is not None,
        rows=data_in_words(fit),
        checked=_checked(fit),
    )


def _checked(fit: FitNumbers) -> str:
    """Return the outcome of posterior predictive checks in words."""
    if fit.sample is None:
        return ""
    found = predictive_check(fit)
    return (
        f"Data replicated from the posterior have a larger χ² than the data with probability "
        f"{found.chi_squared:.2g}, and a larger deviation of a single datum with probability "
        f"{found.largest:.2g}; {found.outside} of {len(found.table)} data are outside the interval "
        "of 95 % of their replicates. Probabilities near 0 speak against the model, or against the "
        "standard deviations."
    )


def _tiles(fit: FitNumbers) -> dict[str, str]:
    best = {f"best {key}": words for key, words in list(fit.best.words.items())[:4]}
    conditions = len(fit.problem.measured.conditions)
    runs = fit.facts["sets_of_parameters"] * len(fit.problem.tasks())
    runs += fit.facts["fresh_runs"] * conditions
    return {
        **best,
        "χ² per datum": f"{fit.best.per_datum:.3g}",
        "data": f"{len(fit.best.residuals)}",
        "conditions": f"{conditions}",
        "runs": f"{runs:,}",
        "wall time": clock(fit.facts["seconds"]),
    }


def parameters_in_words(fit: FitNumbers) -> list[dict[str, str]]:
    """Return the parameters one by one in words."""
    known = fit.intervals() if fit.sample is not None else {}
    rows = []
    for free in fit.problem.ranges:
        interval = known.get(free.name)
        low, high = value_in_words(free.low, free.unit), value_in_words(free.high, free.unit)
        row = {
            "key": free.key,
            "best": fit.best.words[free.key],
            "range": f"{low} to {high}",
            "median": "",
            "interval": "",
            "part": "",
        }
        if interval is not None:
            row["median"] = value_in_words(interval.median, free.unit)
            ends = [value_in_words(end, free.unit) for end in (interval.low, interval.high)]
            row["interval"] = " to ".join(ends)
            row["part"] = f"{100.0 * interval.part:.0f} %"
        rows.append(row)
    return rows


def data_in_words(fit: FitNumbers) -> list[dict[str, Any]]:
    """Return the data one by one in words."""
    rows = fit.rows()
    unit = time_unit(max((row["time"] for row in rows if row["time"] == row["time"]), default=0.0))
    for row in rows:
        row["unit"] = written(row["unit"])
        row["when"] = "at the end"
        if row["time"] == row["time"]:
            row["when"] = unit.text(row["time"])
        row["tissues"] = "their mean" if math.isinf(row["tissues"]) else f"{row['tissues']:g}"
    return rows
