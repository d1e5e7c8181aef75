"""Measured data with their errors over the curves of runs."""

from __future__ import annotations

from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from multicell.measured.compared import MeasuredComparison
from multicell.measured.observables import course_of
from multicell.report.plots import style
from multicell.report.wording import TimeUnit, time_unit, written
from multicell.results.quantities import title_of

_COLUMNS: Final = 2
_MAX_PANELS: Final = 8  # on one page


@style.styled
def compared(comparison: MeasuredComparison) -> Figure:
    """Draw each observable in a panel of its own: runs as lines, data as points with bars."""
    names = list(dict.fromkeys(datum.observable for datum in comparison.data))[:_MAX_PANELS]
    columns = min(len(names), _COLUMNS)
    runs = len(comparison.runs)
    lines = "line: the run" if runs == 1 else f"lines: {runs} runs"
    subtitle = f"{lines}, points: data with their errors; {comparison.words}"
    height = 2.0 + 4.0 * -(-len(names) // columns)
    figure = style.blank(comparison.title, subtitle, (style.SIZE[0], height))
    edges = 0.09, 0.6 / height, 0.97, 1.0 - 1.3 / height
    grid = style.panel_grid(figure, len(names), columns, edges, (0.22, 0.35))
    last = max(float(history["time"][-1]) for history in comparison.histories)
    unit = time_unit(max([last, *(d.time or 0.0 for d in comparison.data)]))
    for axes, name in zip(grid, names, strict=True):
        _panel(axes, comparison, name, unit)
    return figure


def _panel(axes: Axes, comparison: MeasuredComparison, name: str, unit: TimeUnit) -> None:
    dimension = written(comparison.units[name])
    title = title_of(name)
    axes.set_title(f"{title} ({dimension})" if dimension else title)
    for history in comparison.histories:
        if name in history:
            time = history["time"] / unit.seconds
            style.draw_line(axes, time, course_of(history, name), style.BLUE, alpha=0.8)
    data = [datum for datum in comparison.data if datum.observable == name]
    ends = [float(history["time"][-1]) for history in comparison.histories]
    times = np.array([max(ends) if d.time is None else d.time for d in data]) / unit.seconds
    values = np.array([d.value for d in data])
    bars = np.array([d.deviation for d in data])
    axes.errorbar(
        times, values, yerr=bars, fmt="o", ms=5, color=style.RED, capsize=3, lw=1.2, zorder=3
    )
    axes.set_xlabel(f"time ({unit.name})")
    axes.set_xlim(left=0.0)
    if all(d.log for d in data) and values.min() > 0.0 and values.max() > 5.0 * values.min():
        axes.set_yscale("log")
        style.counts(axes.yaxis)
    else:
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
