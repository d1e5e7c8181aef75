"""Pictures of a comparison: error over cost, failures as crosses in a strip on top.

At most eight methods are drawn in colour (:mod:`multicell.comparison.highlights`), the others in
pale grey; decades of error and of cost have the same length, and axes end where the data end.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from multicell.comparison.highlights import in_colour, points
from multicell.comparison.norms import NORMS
from multicell.integrators.base import MethodInfo
from multicell.integrators.registry import find
from multicell.report.plots.colour_vision import PALE, told_apart
from multicell.report.plots.marks import NAMED
from multicell.report.plots.style import QUIET, RED, blank, few_decades, styled
from multicell.report.wording import cell_count, time_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from multicell.comparison.conditioning import Conditioning
    from multicell.comparison.result import WorkPrecision

Look = tuple[str, str, str]
"""Colour, marker and line style of a method."""

Range = tuple[float, float]
"""Smallest and largest value on a logarithmic axis."""

_BANDS: Final = {"_uncertainty": "#e9edf0", "_floor": "#fbf1d9"}
_LABELS: Final = {
    "wall": "wall time (s)",
    "cpu": "processor time (s)",
    "cost": "evaluations, or equal work",
}
_NOTHING: Final = "no error above zero"
_NOTE: Final[dict[str, Any]] = {"fontsize": 9, "color": QUIET, "ha": "center", "va": "center"}
_MARGIN: Final = 0.12  # decades between the data and the end of an axis
_SHORTEST: Final = 0.8  # decades of an axis at least
_SLIMMEST: Final = 0.42  # width of a panel over its height at least
_LEFT, _GAP, _LEGEND, _BOTTOM, _STRIP = 0.95, 0.4, 2.1, 0.75, 0.5  # inches
_WIDTH, _TALLEST, _DECADE = 10.0, 6.2, 1.7  # inches: figure, tallest panel, longest decade


@styled
def workprecision(result: WorkPrecision, norm: str) -> Figure:
    """Draw error in one norm over time and over evaluations."""
    costs = (result.clock, "cost")
    errors = _range(point.error for point in points(result, norm, result.clock))
    least = _SLIMMEST * _decades(errors)
    spans = [_range(_costs(result, norm, cost), least) for cost in costs]
    room = _WIDTH - _LEFT - _GAP - _LEGEND
    decade = min(room / sum(map(_decades, spans)), _TALLEST / _decades(errors), _DECADE)
    strip = _STRIP if result.failures() else 0.0
    top = 1.1 if result.stepwise else 0.9
    looks = appearance(result, norm)
    height = decade * _decades(errors)
    tall = max(top + strip + height + _BOTTOM, top + 0.6 + 0.24 * _entries(result, looks))
    figure = _headed(result, result.norms[norm], tall)
    left, base = _LEFT, tall - top - strip - height
    for cost, span in zip(costs, spans, strict=True):
        width = decade * _decades(span)
        place = (left / _WIDTH, base / tall, width / _WIDTH, height / tall)
        axes = figure.add_axes(place, label=f"{norm} {'cost' if cost == 'cost' else 'wall'}")
        _curves(axes, result, norm, cost, looks)
        _limits(axes, span, errors)
        if not axes.lines:
            axes.text(0.5, 0.5, _NOTHING, transform=axes.transAxes, **_NOTE)
        axes.set_xlabel(_LABELS[cost], fontsize=11)
        _bands(axes, result, norm, words=cost == "cost")
        if cost != "cost":
            axes.set_ylabel("error")
            if strip:
                place = (left / _WIDTH, (base + height) / tall, width / _WIDTH, strip / tall)
                _crosses(figure.add_axes(place, label="failures", sharex=axes), result, looks)
        else:
            axes.tick_params(labelleft=False)
        left += width + _GAP
    _legend(figure, result, looks, (left - 0.1) / _WIDTH, 1.0 - (top - 0.1) / tall)
    _footnote(figure, result, norm, errors)
    return figure


@styled
def norms(result: WorkPrecision) -> Figure:
    """Draw error over time in every norm."""
    columns = 3
    rows = -(-len(NORMS) // columns)
    first, step = (1.45 if result.stepwise else 1.3), 3.75
    tall = first - 0.3 + step * rows
    left_open = "every norm; grey: what the reference leaves open"
    if result.conditioning is not None:
        left_open = f"grey: open in the reference; yellow: {_shift_words(result.conditioning)}"
    figure = _headed(result, left_open, tall)
    looks = appearance(result)
    every = (point for name in NORMS for point in points(result, name, result.clock))
    span = _range(end for point in every for end in (point.shortest, point.longest))
    for k, (name, norm) in enumerate(NORMS.items()):
        row, column = divmod(k, columns)
        errors = _range(point.error for point in points(result, name, result.clock))
        decade = min(1.9 / _decades(span), 2.75 / _decades(errors))
        width, height = decade * _decades(span), decade * _decades(errors)
        left, base = 0.7 + 2.62 * column, tall - first - step * row - height
        place = (left / _WIDTH, base / tall, width / _WIDTH, height / tall)
        axes = figure.add_axes(place, label=f"{name} wall")
        _curves(axes, result, name, result.clock, looks, size=3.5)
        _limits(axes, span, errors)
        _bands(axes, result, name)
        axes.set_title(norm.title(result.stepwise), fontsize=10)
        axes.tick_params(labelsize=8.5)
        axes.set_xlabel(_LABELS[result.clock], fontsize=9)
    _legend(figure, result, looks, 0.82, 1.0 - (first - 0.3) / tall, crosses=False)
    return figure


def _headed(result: WorkPrecision, subtitle: str, tall: float) -> Figure:
    """Return an empty figure, so many inches high, that says what was computed."""
    facts = result.facts
    first, last = facts["cells"]
    count = cell_count(last) if first == last else f"{first:,} to {cell_count(last)}"
    time = time_unit(facts["time"]).text(facts["time"])
    title = result.scene.title or "Untitled scene"
    figure = blank(f"{title}", f"{count}, {time} · {subtitle}", (_WIDTH, tall))
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


def _range(values: Iterable[float], least: float = _SHORTEST) -> Range:
    """Return the ends of a logarithmic axis: those of the data, with a margin.

    It has at least so many decades.
    """
    logs = [math.log10(value) for value in values] or [-0.5, 0.5]
    low, high = min(logs) - _MARGIN, max(logs) + _MARGIN
    missing = max(0.0, _SHORTEST - (high - low), least - (high - low)) / 2.0
    return 10.0 ** (low - missing), 10.0 ** (high + missing)


def _decades(span: Range) -> float:
    return math.log10(span[1] / span[0])


def _limits(axes: Axes, costs: Range, errors: Range) -> None:
    """Set the ends of logarithmic axes, with decades of the same length, and their ticks."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(costs)
    axes.set_ylim(errors)
    axes.set_aspect("equal")
    few_decades(axes.xaxis)
    few_decades(axes.yaxis)


def _shift_words(known: Conditioning) -> str:
    """Return what the floor of a chart is."""
    return f"shift of {known.shift:g} µm ends so far off"


def _curves(
    axes: Axes, result: WorkPrecision, norm: str, cost: str, looks: Mapping[str, Look],
    size: float = 6.0,
) -> None:  # fmt: skip
    """Draw one line for each method, and thin bars from the shortest to the longest repeat."""
    for method, (colour, marker, line) in looks.items():
        found = points(result, norm, cost, method)
        if not found:
            continue
        pale = colour == PALE
        axes.plot(
            [p.cost for p in found], [p.error for p in found], line, color=colour, marker=marker,
            ms=0.6 * size if pale else size, lw=0.9 if pale else 1.5, label=method,
            zorder=1.5 if pale else 2.5, gid=NAMED + method,
        )  # fmt: skip
        spread = [p for p in found if p.longest > p.shortest]
        axes.hlines(
            [p.error for p in spread], [p.shortest for p in spread], [p.longest for p in spread],
            color=colour, lw=0.8, zorder=1.4 if pale else 2.4,
        )  # fmt: skip


def _bands(axes: Axes, result: WorkPrecision, norm: str, *, words: bool = False) -> None:
    """Shade the errors that the reference cannot tell from zero, and those that mean nothing.

    As far as the axis goes, which ends where data end.
    """
    known = result.conditioning
    low, high = axes.get_ylim()
    levels = [("_uncertainty", result.uncertainty[norm])]
    if known is not None:
        levels.insert(0, ("_floor", known.floor[norm]))
    for order, (name, value) in enumerate(levels):
        if not (math.isfinite(value) and value > 0.0):
            continue
        axes.axhspan(
            min(low, 0.1 * value),
            min(value, high),
            color=_BANDS[name],
            zorder=-1 + order,
            label=name,
            lw=0,
        )
        if words and known is not None and name == "_floor" and value > low:
            axes.text(
                0.98, min(value, high), _shift_words(known), ha="right", va="top", fontsize=9,
                transform=axes.get_yaxis_transform(), color=QUIET,
            )  # fmt: skip
    axes.set_ylim(low, high)


def _footnote(figure: Figure, result: WorkPrecision, norm: str, errors: Range) -> None:
    """Say how far the reference is known, and where the floor is that no axis shows."""
    known, uncertainty = result.conditioning, result.uncertainty[norm]
    said = []
    if math.isfinite(uncertainty) and uncertainty > 0.0:
        where = "grey band" if uncertainty > errors[0] else "below this chart"
        said.append(f"reference known to {uncertainty:.0e}: {where}")
    if known is not None and 0.0 < known.floor[norm] <= errors[0]:
        said.append(f"{_shift_words(known)}, {known.floor[norm]:.0e}: below this chart")
    if said:
        height = 0.16 / figure.get_figheight()
        figure.text(0.985, height, " · ".join(said), fontsize=9, color=QUIET, ha="right")


def _crosses(strip: Axes, result: WorkPrecision, looks: Mapping[str, Look]) -> None:
    """Draw every failed solve as a cross at the time that it had taken.

    One that failed sooner or later than the axis goes is a triangle at its end.
    """
    failed = [method for method in result.methods if result.rows(method, "failed")]
    low, high = strip.get_xlim()
    for level, method in enumerate(failed):
        spent = [row["spent"] for row in result.rows(method, "failed") if row["spent"] > 0.0]
        height = 1.0 - (level + 0.5) / len(failed)
        style: dict[str, Any] = {"color": looks[method][0], "gid": f"{NAMED}{method} failed"}
        strip.plot(
            spent, [height] * len(spent), "x", ms=6, mew=1.6, label=f"{method} failed", **style
        )
        ends = [("<", low)] * any(time < low for time in spent)
        ends += [(">", high)] * any(time > high for time in spent)
        for marker, end in ends:
            strip.scatter([end], [height], s=25, marker=marker, clip_on=False, **style)
    strip.set_xlim(low, high)
    strip.set_ylim(0.0, 1.0)
    strip.set_yticks([])
    strip.grid(visible=False)
    strip.spines["left"].set_visible(False)
    strip.tick_params(axis="x", which="both", labelbottom=False, length=0)
    strip.set_facecolor("#faf3f1")
    strip.set_ylabel("failed", fontsize=9, color=RED, rotation=0, ha="right", va="center")


def _entries(result: WorkPrecision, looks: Mapping[str, Look]) -> float:
    """Return how many lines of the legend's letters it takes, names in pale grey being smaller."""
    coloured = sum(colour != PALE for colour, _, _ in looks.values())
    return coloured + bool(result.failures()) + 0.75 * len(_pale_names(looks))


def _pale_names(looks: Mapping[str, Look]) -> list[str]:
    """Return lines that name the methods in pale grey."""
    names = [name for name, (colour, _, _) in looks.items() if colour == PALE]
    return textwrap.wrap(f"pale: {', '.join(names)}", 27, break_on_hyphens=False) if names else []


def _legend(
    figure: Figure, result: WorkPrecision, looks: Mapping[str, Look], left: float, top: float,
    *, crosses: bool = True,
) -> None:  # fmt: skip
    """Name the methods in colour, in the order of the table, and below them the pale ones."""
    handles: list[Any] = []
    for method, (colour, marker, line) in looks.items():
        if colour != PALE:
            handles.append(Line2D([], [], color=colour, marker=marker, ls=line, label=method))
    if crosses and result.failures():
        handles.append(Line2D([], [], color=RED, marker="x", ls="", mew=1.6, label="failed solve"))
    figure.legend(
        handles=handles, loc="upper left", bbox_to_anchor=(left, top), fontsize=10,
        labelspacing=0.5, handlelength=1.8, borderaxespad=0.0,
    )  # fmt: skip
    below = top - (0.203 * len(handles) + 0.12) / figure.get_figheight()
    text = "\n".join(_pale_names(looks))
    figure.text(left + 0.01, below, text, fontsize=8, color=QUIET, va="top", linespacing=1.35)


def appearance(result: WorkPrecision, norm: str = "position") -> dict[str, Look]:
    """Return the look of every method: at most eight in colour, the others in :data:`PALE`."""
    return looks_apart(result.methods, in_colour(result, norm), result.facts)


def looks_apart(
    methods: Iterable[str], coloured: Sequence[str], facts: Mapping[str, Any]
) -> dict[str, Look]:
    """Return the look of each method, in colours that can be told apart (:func:`told_apart`)."""
    wanted = {name: looks_of(name, facts) for name in methods}
    own = told_apart({name: wanted[name][0] for name in coloured})
    return {name: (own.get(name, PALE), mark, line) for name, (_, mark, line) in wanted.items()}


def look(method: str, result: WorkPrecision) -> Look:
    """Return colour, marker and line style of a method."""
    return appearance(result)[method]


def looks_of(method: str, facts: Mapping[str, Any]) -> Look:
    """Return the looks that a method asks for; its colour may be empty."""
    own = facts.get("looks", {})
    if method in own:
        return tuple(own[method])
    info = find(method) or MethodInfo(method)
    return info.colour, info.marker, "--" if info.outside else "-"
