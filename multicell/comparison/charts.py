"""Pictures of a comparison: error over cost, failures as crosses in a strip on top.

At most eight methods are drawn in colour (:mod:`multicell.comparison.styles`), the others in
pale grey; decades of error and of cost have the same length, and axes end where the data end.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Final

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator

from multicell.comparison.styles import Style, appearance, points
from multicell.report.plots.colour_vision import PALE
from multicell.report.plots.style import QUIET, RED, blank, few_decades, styled
from multicell.report.wording import cell_count, time_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from multicell.comparison.numbers import SolveTable

_Range = tuple[float, float]  # smallest and largest value on a logarithmic axis

_UNCERTAIN: Final = "#e9edf0"  # colour of errors within the uncertainty of the reference
_MARGIN: Final = 0.12  # decades between the data and the end of an axis
_SHORTEST: Final = 0.8  # decades of an axis at least
_FLOOR: Final = "#fbf1d9"  # colour of errors that a shift of the start makes
_LABELS: Final = {
    "wall": "wall time (s)",
    "cpu": "CPU time (s)",
    "cost": "evaluations, or equal work",
}
_DISTANCES: Final = {
    "positions": "root mean square distance of the cells from the reference",
    "worst cell": "distance of the worst cell from the reference",
}
"""What a norm measures of positions, in words for its axis."""
_NOTE: Final[dict[str, Any]] = {"fontsize": 9, "color": QUIET, "ha": "center", "va": "center"}
_SLIMMEST: Final = 0.42  # width of a panel over its height at least
_LEFT, _GAP, _LEGEND, _BOTTOM, _STRIP = 1.25, 0.4, 2.1, 0.95, 0.5  # inches
_WIDTH, _TALLEST, _DECADE = 10.0, 6.2, 1.7  # inches: figure, tallest panel, longest decade


@styled
def workprecision(result: SolveTable, norm: str) -> Figure:
    """Draw error in one norm over time and over what the result counts."""
    costs = (result.clock, *result.counts)
    errors = _log_range(point.error for point in points(result, norm, result.clock))
    least = _SLIMMEST * _decades(errors)
    spans = [_log_range(_costs(result, norm, cost), least) for cost in costs]
    room = _WIDTH - _LEFT - _GAP - _LEGEND
    decade = min(room / sum(map(_decades, spans)), _TALLEST / _decades(errors), _DECADE)
    strip = _STRIP if result.failures() else 0.0
    top = 1.1 if result.stepwise else 0.9
    styles = appearance(result, norm)
    height = decade * _decades(errors)
    # of the legend, in which names in pale grey are smaller
    lines: float = sum(style.colour != PALE for style in styles.values())
    lines += 0.75 * len(_pale_names(styles)) + bool(result.failures())
    tall = max(top + strip + height + _BOTTOM, top + 0.6 + 0.24 * lines)
    facts = result.facts
    first, last = facts["cells"]
    count = cell_count(last) if first == last else f"{first:,} to {cell_count(last)}"
    time = time_unit(facts["time"]).text(facts["time"])
    figure = blank(result.title, f"{count}, {time} · {result.norms[norm]}", (_WIDTH, tall))
    if result.stepwise:
        text = f"{facts['mode']}, each from the same recorded state for every method; cost summed"
        figure.text(0.04, 1.0 - 0.825 / tall, text, fontsize=10.5, color=QUIET, va="center")
    left, base = _LEFT, tall - top - strip - height
    for cost, span in zip(costs, spans, strict=True):
        width = decade * _decades(span)
        place = (left / _WIDTH, base / tall, width / _WIDTH, height / tall)
        axes = figure.add_axes(place, label=f"{norm} {'cost' if cost == 'cost' else 'time'}")
        _panel(axes, result, norm, cost, (span, errors), styles)
        if not axes.lines:
            axes.text(0.5, 0.5, "no error above zero", transform=axes.transAxes, **_NOTE)
        axes.set_xlabel(_LABELS[cost], fontsize=11)
        if cost != "cost":
            axes.set_ylabel(_error_words(result, norm), fontsize=10)
            if strip:
                place = (left / _WIDTH, (base + height) / tall, width / _WIDTH, strip / tall)
                _draw_failures(figure.add_axes(place, label="failures"), result, styles, span)
        else:
            axes.tick_params(labelleft=False)
        left += width + _GAP
    corner = ((left - 0.1) / _WIDTH, 1.0 - (top - 0.1) / tall)
    _draw_legend(figure, styles, corner, failures=bool(result.failures()))
    _footnote(figure, result, norm, errors)
    return figure


def _error_words(result: SolveTable, norm: str) -> str:
    """Return the label of the axis of the error, in lines."""
    measure = result.measures()[norm]
    words = _DISTANCES.get(measure.quantity, measure.quantity)
    over = f" / {measure.scale}" if measure.scale else ""
    label = f"error: {words}{over}"
    lines = -(-len(label) // 36)
    return "\n".join(textwrap.wrap(label, len(label) // lines + 6))  # of about one length


def _costs(result: SolveTable, norm: str, cost: str) -> list[float]:
    """Return the costs that an axis has to show; without any, those of the failures."""
    found = [end for p in points(result, norm, cost) for end in (p.shortest, p.longest)]
    if not found and cost != "cost":
        found = [row["spent"] for row in result.failures() if row["spent"] > 0.0]
    return found


def _panel(
    axes: Axes,
    result: SolveTable,
    norm: str,
    cost: str,
    ends: tuple[_Range, _Range],
    styles: Mapping[str, Style],
) -> None:
    """Draw the curves of one norm over one cost, with decades of the same length.

    Thin bars go from the shortest to the longest repeat. Errors within the uncertainty of the
    reference, and within the effect of a shift, are shaded.
    """
    for method, (colour, marker, line) in styles.items():
        found = points(result, norm, cost, method)
        if not found:
            continue
        pale = colour == PALE
        axes.plot(
            [p.cost for p in found],
            [p.error for p in found],
            line,
            color=colour,
            marker=marker,
            ms=3.6 if pale else 6.0,
            lw=0.9 if pale else 1.5,
            label=method,
            zorder=1.5 if pale else 2.5,
        )
        spread = [p for p in found if p.longest > p.shortest]
        axes.hlines(
            [p.error for p in spread],
            [p.shortest for p in spread],
            [p.longest for p in spread],
            color=colour,
            lw=0.8,
            zorder=1.4 if pale else 2.4,
        )
    _set_limits(axes, *ends)
    axes.set_aspect("equal")
    known = result.conditioning
    if known is not None:
        _draw_band(axes, known.floor[norm], _FLOOR, "_floor")
    _draw_band(axes, result.uncertainty[norm], _UNCERTAIN, "_uncertainty", known is not None)


def _footnote(figure: Figure, result: SolveTable, norm: str, errors: _Range) -> None:
    """State the errors of the reference and of a shift, which are drawn as bands."""
    bands = [("grey band", "reference known to", result.uncertainty[norm])]
    known = result.conditioning
    if known is not None:
        words = f"a shift of {known.shift:g} µm moves the end by"
        bands.append(("yellow band", words, known.floor[norm]))
    said = [
        f"{words} {value:.0e}: {band if value > errors[0] else 'below this chart'}"
        for band, words, value in bands
        if math.isfinite(value) and value > 0.0
    ]
    height = 0.16 / figure.get_figheight()
    figure.text(0.985, height, " · ".join(said), fontsize=9, color=QUIET, ha="right")


def _log_range(values: Iterable[float], least: float = _SHORTEST) -> _Range:
    """Return the ends of a logarithmic axis: those of the data, with a margin.

    It has at least ``least`` decades.
    """
    logs = [math.log10(value) for value in values] or [-0.5, 0.5]
    low, high = min(logs) - _MARGIN, max(logs) + _MARGIN
    missing = max(0.0, _SHORTEST - (high - low), least - (high - low)) / 2.0
    return 10.0 ** (low - missing), 10.0 ** (high + missing)


def _decades(span: _Range) -> float:
    """Return the length of a range in decades."""
    return math.log10(span[1] / span[0])


def _set_limits(axes: Axes, costs: _Range, errors: _Range) -> None:
    """Set the ends of logarithmic axes, and their ticks."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(costs)
    axes.set_ylim(errors)
    for axis, span in ((axes.xaxis, costs), (axes.yaxis, errors)):
        few_decades(axis)
        if 15.0 * span[0] <= span[1] < 100.0 * span[0]:
            axis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def _draw_band(axes: Axes, value: float, colour: str, label: str, order: int = 0) -> None:
    """Shade the errors below a value, as far as the axis goes, which ends where data end."""
    if not (math.isfinite(value) and value > 0.0):
        return
    low, high = axes.get_ylim()
    axes.axhspan(
        min(low, 0.1 * value), min(value, high), color=colour, zorder=-1 + order, label=label, lw=0
    )
    axes.set_ylim(low, high)


def _draw_failures(
    strip: Axes, result: SolveTable, styles: Mapping[str, Style], span: _Range
) -> None:
    """Draw every failed solve as a cross at the time that it had taken.

    One that failed sooner or later than the axis goes is a triangle at its end.
    """
    spent = {
        method: [row["spent"] for row in rows if row["spent"] > 0.0]
        for method in result.methods
        if (rows := result.rows(method, "failed"))
    }
    for level, (method, times) in enumerate(spent.items()):
        height = 1.0 - (level + 0.5) / len(spent)
        style: dict[str, Any] = {"color": styles[method].colour}
        strip.plot(
            times, [height] * len(times), "x", ms=6, mew=1.6, label=f"{method} failed", **style
        )
        ends = [("<", span[0])] * any(time < span[0] for time in times)
        ends += [(">", span[1])] * any(time > span[1] for time in times)
        for marker, end in ends:
            strip.scatter([end], [height], s=25, marker=marker, clip_on=False, **style)
    strip.set_xscale("log")
    strip.set_xlim(span)
    strip.set_ylim(0.0, 1.0)
    strip.set_yticks([])
    strip.grid(visible=False)
    strip.spines["left"].set_visible(False)
    strip.tick_params(axis="x", which="both", labelbottom=False, length=0)
    strip.set_facecolor("#faf3f1")
    strip.set_ylabel("failed", fontsize=9, color=RED, rotation=0, ha="right", va="center")


def _pale_names(styles: Mapping[str, Style]) -> list[str]:
    """Return lines that name the methods in pale grey."""
    names = [name for name, style in styles.items() if style.colour == PALE]
    return textwrap.wrap(f"pale: {', '.join(names)}", 27, break_on_hyphens=False) if names else []


def _draw_legend(
    figure: Figure,
    styles: Mapping[str, Style],
    place: tuple[float, float],
    *,
    failures: bool,
) -> None:
    """Name the methods in colour, in the order of the table, and below them the pale ones.

    ``place`` is the upper left corner in parts of the figure.
    """
    handles: list[Any] = [
        Line2D([], [], color=colour, marker=marker, ls=line, label=method)
        for method, (colour, marker, line) in styles.items()
        if colour != PALE
    ]
    if failures:
        handles.append(Line2D([], [], color=RED, marker="x", ls="", mew=1.6, label="failed solve"))
    figure.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=place,
        fontsize=10,
        labelspacing=0.5,
        handlelength=1.8,
        borderaxespad=0.0,
    )
    below = place[1] - (0.208 * len(handles) + 0.14) / figure.get_figheight()
    figure.text(
        place[0] + 0.01,
        below,
        "\n".join(_pale_names(styles)),
        fontsize=8,
        color=QUIET,
        va="top",
        linespacing=1.35,
    )
