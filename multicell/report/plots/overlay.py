"""A quantity of several runs over time, in one picture."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from multicell.errors import OutputError
from multicell.report.plots import style
from multicell.report.wording import time_unit, written
from multicell.results.quantities import known_unit, title_of
from multicell.schema import near_miss

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LINES = ("-", "--", "-.", ":")


@style.styled
def overlay(runs: Mapping[str, style.History], quantity: str) -> Figure:
    """Draw a column of the histories of runs against time.

    - ``runs``: histories by the names that the legend gives them
    - ``quantity``: name of the column
    """
    for label, history in runs.items():
        columns = [name for name in history if name != "time"]
        if not columns:
            raise OutputError(f"the run '{label}' has no history yet")
        if quantity not in history:
            hint = near_miss(quantity, columns)
            raise OutputError(f"the history of '{label}' has no {quantity!r}. {hint}")
    unit = time_unit(max(float(history["time"][-1]) for history in runs.values()))
    title = title_of(quantity).capitalize()
    count = "one run" if len(runs) == 1 else f"{len(runs)} runs"
    figure = style.blank(title, count)
    axes = figure.add_axes((0.1, 0.11, 0.86 if len(runs) == 1 else 0.6, 0.72))
    colours = style.type_colours(runs)
    for k, (label, history) in enumerate(runs.items()):
        time = history["time"] / unit.seconds
        axes.plot(
            time, history[quantity], color=colours[label], lw=2, label=style.type_label(label),
            ls=_LINES[k % len(_LINES)], marker="" if len(time) > 1 else "o",
        )  # fmt: skip
    dimension = known_unit(quantity)
    axes.set_xlabel(f"time ({unit.name})")
    axes.set_ylabel(f"{title.lower()} ({written(dimension)})" if dimension else title.lower())
    times = np.concatenate([history["time"] for history in runs.values()])
    axes.set_xlim(*style.span(np.sort(times) / unit.seconds))
    if len(runs) > 1:
        axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.02))
    return figure
