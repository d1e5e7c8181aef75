"""Pictures of a comparison: error over cost, failures as crosses in a strip on top.

At most eight methods are drawn in colour (:mod:`multicell.comparison.styles`), the others in
pale grey; decades of error and of cost have the same length, and axes end where the data end.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from multicell.comparison import panels
from multicell.comparison.styles import Style, appearance, points
from multicell.report.plots.style import QUIET, RED, blank, styled
from multicell.report.wording import cell_count, time_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from multicell.comparison.conditioning import Conditioning
    from multicell.comparison.result import WorkPrecision

_FLOOR: Final = "#fbf1d9"  # colour of errors that a shift of the start makes
_LABELS: Final = {
    "wall": "wall time (s)",
    "cpu": "processor time (s)",
    "cost": "evaluations, or equal work",
}
_NOTE: Final[dict[str, Any]] = {"fontsize": 9, "color": QUIET, "ha": "center", "va": "center"}
_NARROW: Final = 0.9  # inches of a panel below which labels of all decades overlap
_SLIMMEST: Final = 0.42  # width of a panel over its height at least
_LEFT, _GAP, _LEGEND, _BOTTOM, _STRIP = 0.95, 0.4, 2.1, 0.95, 0.5  # inches
_WIDTH, _TALLEST, _DECADE = 10.0, 6.2, 1.7  # inches: figure, tallest panel, longest decade


@styled
def workprecision(result: WorkPrecision, norm: str) -> Figure:
    """Draw error in one norm over time and over evaluations."""
    costs = (result.clock, "cost")
    errors = panels.log_range(point.error for point in points(result, norm, result.clock))
    least = _SLIMMEST * panels.decades(errors)
    spans = [panels.log_range(_costs(result, norm, cost), least) for cost in costs]
    room = _WIDTH - _LEFT - _GAP - _LEGEND
    decade = min(room / sum(map(panels.decades, spans)), _TALLEST / panels.decades(errors), _DECADE)
    strip = _STRIP if result.failures() else 0.0
    top = 1.1 if result.stepwise else 0.9
    styles = appearance(result, norm)
    height = decade * panels.decades(errors)
    lines = panels.legend_lines(styles) + bool(result.failures())
    tall = max(top + strip + height + _BOTTOM, top + 0.6 + 0.24 * lines)
    figure = _comparison_figure(result, result.norms[norm], tall)
    left, base = _LEFT, tall - top - strip - height
    for cost, span in zip(costs, spans, strict=True):
        width = decade * panels.decades(span)
        place = (left / _WIDTH, base / tall, width / _WIDTH, height / tall)
        axes = figure.add_axes(place, label=f"{norm} {'cost' if cost == 'cost' else 'time'}")
        _panel(axes, result, norm, cost, (span, errors), styles)
        if not axes.lines:
            axes.text(0.5, 0.5, "no error above zero", transform=axes.transAxes, **_NOTE)
        axes.set_xlabel(_LABELS[cost], fontsize=11)
        if cost != "cost":
            axes.set_ylabel("error")
            if strip:
                place = (left / _WIDTH, (base + height) / tall, width / _WIDTH, strip / tall)
                _failures(figure.add_axes(place, label="failures"), result, styles, span)
        else:
            _name_floor(axes, result, norm)
            axes.tick_params(labelleft=False)
        left += width + _GAP
    corner = ((left - 0.1) / _WIDTH, 1.0 - (top - 0.1) / tall)
    panels.draw_legend(figure, styles, corner, failures=bool(result.failures()))
    _footnote(figure, result, norm, errors)
    return figure


@styled
def norms(result: WorkPrecision) -> Figure:
    """Draw error over time in every norm."""
    columns = 3
    measured = result.measures()
    rows = -(-len(measured) // columns)
    first, step = (1.45 if result.stepwise else 1.3), 3.75
    tall = first - 0.3 + step * rows
    left_open = "every norm; grey: uncertainty of the reference"
    if result.conditioning is not None:
        left_open = f"grey: uncertainty of the reference; yellow: {_floor(result.conditioning)}"
    figure = _comparison_figure(result, left_open, tall)
    styles = appearance(result)
    every = (point for name in measured for point in points(result, name, result.clock))
    span = panels.log_range(end for point in every for end in (point.shortest, point.longest))
    for k, (name, norm) in enumerate(measured.items()):
        row, column = divmod(k, columns)
        errors = panels.log_range(point.error for point in points(result, name, result.clock))
        decade = min(1.9 / panels.decades(span), 2.75 / panels.decades(errors))
        width, height = decade * panels.decades(span), decade * panels.decades(errors)
        left, base = 0.7 + 2.62 * column, tall - first - step * row - height
        place = (left / _WIDTH, base / tall, width / _WIDTH, height / tall)
        axes = figure.add_axes(place, label=f"{name} time")
        _panel(axes, result, name, result.clock, (span, errors), styles, size=3.5)
        if width < _NARROW:
            axes.xaxis.set_major_locator(LogLocator(100.0))
        axes.set_title(norm.title(result.stepwise), fontsize=10)
        axes.tick_params(labelsize=8.5)
        axes.set_xlabel(_LABELS[result.clock], fontsize=9)
    panels.draw_legend(figure, styles, (0.82, 1.0 - (first - 0.3) / tall), failures=False)
    return figure


def _comparison_figure(result: WorkPrecision, subtitle: str, tall: float) -> Figure:
    """Return an empty figure, so many inches high, that says what was computed."""
    facts = result.facts
    first, last = facts["cells"]
    count = cell_count(last) if first == last else f"{first:,} to {cell_count(last)}"
    time = time_unit(facts["time"]).text(facts["time"])
    figure = blank(result.title, f"{count}, {time} · {subtitle}", (_WIDTH, tall))
    if result.stepwise:
        text = f"{facts['mode']}, each from the same recorded state for every method; cost summed"
        figure.text(0.04, 1.0 - 0.825 / tall, text, fontsize=10.5, color=QUIET, va="center")
    return figure


def _costs(result: WorkPrecision, norm: str, cost: str) -> list[float]:
    """Return the costs that an axis has to show; without any, those of the failures."""
    found = [end for p in points(result, norm, cost) for end in (p.shortest, p.longest)]
    if not found and cost != "cost":
        found = [row["spent"] for row in result.failures() if row["spent"] > 0.0]
    return found


def _panel(
    axes: Axes, result: WorkPrecision, norm: str, cost: str,
    ends: tuple[panels.Range, panels.Range], styles: Mapping[str, Style], size: float = 6.0,
) -> None:  # fmt: skip
    """Draw the curves of one norm over one cost, with decades of the same length.

    Errors within the uncertainty of the reference, and within the effect of a shift, are shaded.
    """
    series = {method: points(result, norm, cost, method) for method in styles}
    panels.draw_curves(axes, series, styles, size)
    panels.set_limits(axes, *ends)
    axes.set_aspect("equal")
    known = result.conditioning
    if known is not None:
        panels.draw_band(axes, known.floor[norm], _FLOOR, "_floor")
    panels.draw_band(
        axes, result.uncertainty[norm], panels.UNCERTAIN, "_uncertainty", known is not None
    )


def _floor(known: Conditioning) -> str:
    """Return what the floor of a chart is."""
    return f"shift of {known.shift:g} µm ends so far off"


def _name_floor(axes: Axes, result: WorkPrecision, norm: str) -> None:
    """Write beside the floor what it is, where the axis shows it."""
    known = result.conditioning
    low, high = axes.get_ylim()
    if known is not None and known.floor[norm] > low:
        axes.text(
            0.98, min(known.floor[norm], high), _floor(known), ha="right", va="top", fontsize=9,
            transform=axes.get_yaxis_transform(), color=QUIET,
        )  # fmt: skip


def _footnote(figure: Figure, result: WorkPrecision, norm: str, errors: panels.Range) -> None:
    """Say how far the reference is known, and where the floor is that no axis shows."""
    known, uncertainty = result.conditioning, result.uncertainty[norm]
    said = []
    if math.isfinite(uncertainty) and uncertainty > 0.0:
        where = "grey band" if uncertainty > errors[0] else "below this chart"
        said.append(f"reference known to {uncertainty:.0e}: {where}")
    if known is not None and 0.0 < known.floor[norm] <= errors[0]:
        said.append(f"{_floor(known)}, {known.floor[norm]:.0e}: below this chart")
    if said:
        height = 0.16 / figure.get_figheight()
        figure.text(0.985, height, " · ".join(said), fontsize=9, color=QUIET, ha="right")


def _failures(
    strip: Axes, result: WorkPrecision, styles: Mapping[str, Style], span: panels.Range
) -> None:
    """Draw the failed solves of all methods."""
    spent = {
        method: [row["spent"] for row in rows if row["spent"] > 0.0]
        for method in result.methods
        if (rows := result.rows(method, "failed"))
    }
    panels.draw_failures(strip, spent, styles, span)
    strip.set_ylabel("failed", fontsize=9, color=RED, rotation=0, ha="right", va="center")
