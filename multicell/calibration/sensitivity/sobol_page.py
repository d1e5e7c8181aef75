"""The page of Sobol' indices, and their picture."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from multicell.calibration.sensitivity.index_page import sensitivity_title, write_indices
from multicell.report.html import Drawing
from multicell.report.plots.colour_vision import PALE
from multicell.report.plots.style import BLUE, QUIET, SIZE, styled
from multicell.studies.picture_data import key_words, sentence, words
from multicell.studies.pictures import with_heading

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from multicell.calibration.sensitivity.numbers import IndexTable


def write_sobol_report(result: IndexTable, folder: Path) -> Path:
    """Write ``report.html`` and its pictures, and return the page."""
    drawings: dict[str, Drawing] = {}
    for name in result.observables:
        if any(np.isfinite(row["ST"]) for row in result.ordered(name)):  # else a note says why
            caption = f"{sentence(words(name))}: parts of its variance, with 95 % intervals."
            drawings[name] = partial(sobol_bars, result, name), caption
    points = result.size * (len(result.ranges) + 2)
    return write_indices(result, folder, "sobol.html", "Sobol' indices", points, {}, drawings)


@styled
def sobol_bars(result: IndexTable, observable: str) -> Figure:
    """Draw first and total indices of an observable, the largest total one on top."""
    rows = result.ordered(observable)
    subtitle = (
        f"{sentence(words(observable))} at the end of each run · Sobol', {result.size:,} points, "
        f"{len(result.seeds)} seed(s) · bars: 95 % intervals"
    )
    figure = with_heading(
        sensitivity_title(result), subtitle, (SIZE[0], max(4.0, 1.9 + 0.6 * len(rows)))
    )
    axes = figure.subplots()
    places = np.arange(len(rows), dtype=float)
    pairs = (("ST", 0.18, PALE, "total, with interactions"), ("S1", -0.18, BLUE, "alone"))
    for column, shift, colour, label in pairs:
        values = np.array([row[column] for row in rows])
        halves = np.array([row[f"{column}_conf"] for row in rows])
        axes.barh(places + shift, np.nan_to_num(values), 0.34, color=colour, label=label)
        axes.errorbar(
            values,
            places + shift,
            xerr=halves,
            fmt="none",
            ecolor=QUIET,
            elinewidth=1.3,
            capsize=2.5,
        )
    axes.set_yticks(places, [key_words(str(row["key"]), str(row["parameter"])) for row in rows])
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.grid(False, axis="y")
    axes.axvline(0.0, color=QUIET, lw=0.8)
    axes.set_xlabel("part of the variance")
    axes.legend(loc="lower right")
    return figure
