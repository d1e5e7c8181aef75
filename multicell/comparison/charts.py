"""Pictures of a comparison: error over cost, failures as crosses in a strip on top."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from multicell.comparison.norms import NORMS
from multicell.integrators.base import MethodInfo
from multicell.integrators.registry import find
from multicell.report.plots.style import QUIET, blank, cell_count, styled, time_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from multicell.comparison.conditioning import Conditioning
    from multicell.comparison.result import WorkPrecision
    from multicell.comparison.stability_limits.result import StabilityMap


_OTHERS: Final = ("#b5432f", "#f2b63c", "#6b7a86", "#2a9d6a", "#d16ba5", "#00798c")
_BANDS: Final = {"_uncertainty": "#dfe4e8", "_floor": "#fbf1d9"}
_LABELS: Final = {
    "wall": "wall time (s)",
    "cpu": "processor time (s)",
    "cost": "evaluations of the right-hand side, or equal work",
}


@styled
def workprecision(result: WorkPrecision, norm: str) -> Figure:
    """Draw error in one norm over time and over evaluations."""
    figure = _headed(result, result.norms[norm])
    strip = 0.07 if result.failures() else 0.0
    top = 0.83 if result.stepwise else 0.86
    height = top - 0.12 - strip
    left = figure.add_axes((0.085, 0.11, 0.35, height), label=f"{norm} wall")
    right = figure.add_axes((0.465, 0.11, 0.35, height), label=f"{norm} cost", sharey=left)
    for axes, cost in ((left, result.clock), (right, "cost")):
        _curves(axes, result, norm, cost)
        axes.set_xlabel(_LABELS[cost], fontsize=11)
    left.set_ylabel("error")
    right.tick_params(labelleft=False)
    _bands(left, result, norm)
    _bands(right, result, norm, words=True)
    if strip:
        place = (0.085, top - strip, 0.35, strip)
        _crosses(figure.add_axes(place, label="failures", sharex=left), result)
    _legend(figure, result)
    return figure


@styled
def norms(result: WorkPrecision) -> Figure:
    """Draw error over time in every norm."""
    open_ = "every norm; grey: what the reference leaves open"
    if result.conditioning is not None:
        open_ = f"grey: open in the reference; yellow: {_shift_words(result.conditioning)}"
    figure = _headed(result, open_)
    for k, (name, norm) in enumerate(NORMS.items()):
        row, column = divmod(k, 4)
        place = (0.055 + 0.1985 * column, 0.525 - 0.435 * row, 0.15, 0.285)
        axes = figure.add_axes(place, label=f"{name} wall")
        _curves(axes, result, name, result.clock, size=3.5)
        _bands(axes, result, name)
        axes.set_title(norm.title(result.stepwise), fontsize=8)
        axes.tick_params(labelsize=8.5)
        if row == 1:
            axes.set_xlabel(_LABELS[result.clock], fontsize=10)
    _legend(figure, result, crosses=False)
    return figure


def _headed(result: WorkPrecision, subtitle: str) -> Figure:
    """Return an empty figure that says what was computed."""
    facts = result.facts
    first, last = facts["cells"]
    count = cell_count(last) if first == last else f"{first:,} to {cell_count(last)}"
    time = time_unit(facts["time"]).text(facts["time"])
    title = result.scene.title or "Untitled scene"
    figure = blank(f"{title}", f"{count}, {time} · {subtitle}")
    if result.stepwise:
        text = f"{facts['mode']}, each from the same recorded state for every method; cost summed"
        figure.text(0.04, 0.868, text, fontsize=10.5, color=QUIET, va="center")
    return figure


def _curves(axes: Axes, result: WorkPrecision, norm: str, cost: str, size: float = 6.0) -> None:
    """Draw one line for each method."""
    for method in result.methods:
        colour, marker, line = look(method, result)
        points = [(row[cost], row[f"error_{norm}"]) for row in result.rows(method)]
        # an error of exactly zero has no place on a logarithmic axis
        points = [(x, y) for x, y in points if x > 0.0 and y > 0.0]
        if points:
            x, y = zip(*points, strict=True)
            axes.plot(x, y, line, color=colour, marker=marker, ms=size, lw=1.5, label=method)
    axes.set_xscale("log")
    axes.set_yscale("log")
    for axis in (axes.xaxis, axes.yaxis):
        low, high = axis.get_view_interval()
        if high < 15.0 * low:
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        # labels of minor ticks run into each other where an axis spans little more than a decade
        axis.set_minor_formatter(NullFormatter())


def _bands(axes: Axes, result: WorkPrecision, norm: str, *, words: bool = False) -> None:
    """Shade the errors that the reference cannot tell from zero, and those that mean nothing."""
    known = result.conditioning
    levels = [("_uncertainty", result.uncertainty[norm], "uncertainty of the reference", "top")]
    if known is not None:
        levels.insert(0, ("_floor", known.floor[norm], _shift_words(known), "bottom"))
    levels = [level for level in levels if math.isfinite(level[1]) and level[1] > 0.0]
    if not levels:
        return
    low, high = axes.get_ylim()
    bottom = min(low, *(0.3 * value for _, value, _, _ in levels))
    for order, (name, value, text, side) in enumerate(levels):
        axes.axhspan(bottom, value, color=_BANDS[name], zorder=-1 + order, label=name, lw=0)
        if words:
            axes.text(
                0.98, value * (0.97 if side == "top" else 1.03), text, ha="right", va=side,
                transform=axes.get_yaxis_transform(), fontsize=9, color=QUIET,
            )  # fmt: skip
    axes.set_ylim(bottom, max(1.3 * high, *(3.0 * value for _, value, _, _ in levels)))


def _shift_words(known: Conditioning) -> str:
    """Return what the floor of a chart is."""
    return f"shift of {known.shift:g} µm ends so far off"


def _crosses(strip: Axes, result: WorkPrecision) -> None:
    """Draw every failed solve as a cross at the time that it had taken."""
    failed = [method for method in result.methods if result.rows(method, "failed")]
    for level, method in enumerate(failed):
        rows = [row for row in result.rows(method, "failed") if row["spent"] > 0.0]
        height = 1.0 - (level + 0.5) / len(failed)
        strip.plot(
            [row["spent"] for row in rows], [height] * len(rows), "x", ms=6, mew=1.6,
            color=look(method, result)[0], label=f"{method} failed", clip_on=False,
        )  # fmt: skip
    strip.set_ylim(0.0, 1.0)
    strip.set_yticks([])
    strip.grid(visible=False)
    strip.spines["left"].set_visible(False)
    strip.tick_params(axis="x", which="both", labelbottom=False, length=0)
    strip.set_facecolor("#faf3f1")
    strip.set_ylabel("failed", fontsize=9, color="#b5432f", rotation=0, ha="right", va="center")


def _legend(figure: Figure, result: WorkPrecision, *, crosses: bool = True) -> None:
    """Name the methods, in the order of the table."""
    handles: list[Any] = []
    for method in result.methods:
        colour, marker, line = look(method, result)
        handles.append(Line2D([], [], color=colour, marker=marker, ls=line, label=method))
    if crosses and result.failures():
        handles.append(
            Line2D([], [], color="#b5432f", marker="x", ls="", mew=1.6, label="failed solve")
        )
    figure.legend(
        handles=handles, loc="upper left", bbox_to_anchor=(0.825, 0.87), fontsize=10,
        labelspacing=min(0.55, 10.0 / len(handles)), handlelength=1.8,
    )  # fmt: skip


def look(method: str, result: WorkPrecision | StabilityMap) -> tuple[str, str, str]:
    """Return colour, marker and line style of a method."""
    looks = {name: looks_of(name, result.facts) for name in result.methods}
    if looks[method][0]:
        return looks[method]
    unknown = [name for name, (colour, _, _) in looks.items() if not colour]
    return _OTHERS[unknown.index(method) % len(_OTHERS)], *looks[method][1:]


def looks_of(method: str, facts: Mapping[str, Any]) -> tuple[str, str, str]:
    """Return the looks that a method asks for; its colour may be empty."""
    own = facts.get("looks", {})
    if method in own:
        return tuple(own[method])
    info = find(method) or MethodInfo(method)
    return info.colour, info.marker, "--" if info.outside else "-"
