"""What the charts of all comparisons share: panels of error over cost, and strips of outcomes."""

from __future__ import annotations

import itertools
import math
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator

from multicell.comparison.base import Row
from multicell.comparison.styles import Point, Style
from multicell.report.plots.colour_vision import PALE
from multicell.report.plots.style import INK, QUIET, RED, few_decades

Range = tuple[float, float]  # smallest and largest value on a logarithmic axis

UNCERTAIN: Final = "#e9edf0"
"""Colour of errors within the uncertainty of the reference."""

_MARGIN: Final = 0.12  # decades between the data and the end of an axis
_SHORTEST: Final = 0.8  # decades of an axis at least
_OVERHANG: Final = 1.35  # of the first and last strip beyond its setting


def log_range(values: Iterable[float], least: float = _SHORTEST) -> Range:
    """Return the ends of a logarithmic axis: those of the data, with a margin.

    It has at least ``least`` decades.
    """
    logs = [math.log10(value) for value in values] or [-0.5, 0.5]
    low, high = min(logs) - _MARGIN, max(logs) + _MARGIN
    missing = max(0.0, _SHORTEST - (high - low), least - (high - low)) / 2.0
    return 10.0 ** (low - missing), 10.0 ** (high + missing)


def decades(span: Range) -> float:
    """Return the length of a range in decades."""
    return math.log10(span[1] / span[0])


def set_limits(axes: Axes, costs: Range, errors: Range) -> None:
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


def draw_curves(
    axes: Axes,
    series: Mapping[str, Sequence[Point]],
    styles: Mapping[str, Style],
    size: float = 6.0,
) -> None:
    """Draw one line for each method, and thin bars from the shortest to the longest repeat."""
    for method, (colour, marker, line) in styles.items():
        found = series.get(method)
        if not found:
            continue
        pale = colour == PALE
        axes.plot(
            [p.cost for p in found], [p.error for p in found], line, color=colour, marker=marker,
            ms=0.6 * size if pale else size, lw=0.9 if pale else 1.5, label=method,
            zorder=1.5 if pale else 2.5,
        )  # fmt: skip
        spread = [p for p in found if p.longest > p.shortest]
        axes.hlines(
            [p.error for p in spread], [p.shortest for p in spread], [p.longest for p in spread],
            color=colour, lw=0.8, zorder=1.4 if pale else 2.4,
        )  # fmt: skip


def draw_band(axes: Axes, value: float, colour: str, label: str, order: int = 0) -> None:
    """Shade the errors below a value, as far as the axis goes, which ends where data end."""
    if not (math.isfinite(value) and value > 0.0):
        return
    low, high = axes.get_ylim()
    axes.axhspan(
        min(low, 0.1 * value), min(value, high), color=colour, zorder=-1 + order, label=label, lw=0
    )
    axes.set_ylim(low, high)


def draw_failures(
    strip: Axes, spent: Mapping[str, Sequence[float]], styles: Mapping[str, Style], span: Range
) -> None:
    """Draw every failed solve as a cross at the time that it had taken.

    One that failed sooner or later than the axis goes is a triangle at its end.
    """
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
    strip.set_facecolor("#faf3f1" if spent else "white")


def legend_lines(styles: Mapping[str, Style]) -> float:
    """Return how many lines a legend of methods takes, names in pale grey being smaller."""
    return sum(style.colour != PALE for style in styles.values()) + 0.75 * len(_pale_names(styles))


def _pale_names(styles: Mapping[str, Style]) -> list[str]:
    """Return lines that name the methods in pale grey."""
    names = [name for name, style in styles.items() if style.colour == PALE]
    return textwrap.wrap(f"pale: {', '.join(names)}", 27, break_on_hyphens=False) if names else []


def draw_legend(
    figure: Figure,
    styles: Mapping[str, Style],
    place: tuple[float, float],
    *,
    failures: bool,
    others: Sequence[Line2D | Patch] = (),
) -> None:
    """Name the methods in colour, in the order of the table, and below them the pale ones.

    ``place`` is the upper left corner in parts of the figure; ``others`` come after the methods.
    """
    handles: list[Any] = [
        Line2D([], [], color=colour, marker=marker, ls=line, label=method)
        for method, (colour, marker, line) in styles.items()
        if colour != PALE
    ]
    handles += others
    if failures:
        handles.append(Line2D([], [], color=RED, marker="x", ls="", mew=1.6, label="failed solve"))
    figure.legend(
        handles=handles, loc="upper left", bbox_to_anchor=place, fontsize=10,
        labelspacing=0.5, handlelength=1.8, borderaxespad=0.0,
    )  # fmt: skip
    below = place[1] - (0.208 * len(handles) + 0.14) / figure.get_figheight()
    figure.text(
        place[0] + 0.01, below, "\n".join(_pale_names(styles)), fontsize=8, color=QUIET, va="top",
        linespacing=1.35,
    )  # fmt: skip


def draw_strips(
    axes: Axes,
    strips: Mapping[str, Sequence[Row]],
    colours: Mapping[str, str],
    limits: Mapping[str, float],
    scale: float = 1.0,
) -> None:
    """Draw how trials end over their settings, one strip for each name.

    - ``strips``: name -> trials, from small to large settings
    - ``colours``: kind of end -> colour
    - ``limits``: name -> largest stable setting in theory; infinite ones and NaN are left out
    - ``scale``: what settings and limits are divided by
    """
    for level, (name, rows) in enumerate(strips.items()):
        settings = [row["setting"] / scale for row in rows]
        edges = _edges(settings)
        for row, low, high in zip(rows, edges[:-1], edges[1:], strict=True):
            axes.barh(
                level, high - low, left=low, height=0.66, color=colours[row["kind"]], lw=0,
                label=row["kind"], gid=f"{name}|{row['kind']}",
            )  # fmt: skip
        axes.plot(settings, [level] * len(settings), ".", ms=2.2, color=INK, alpha=0.55)
        limit = limits.get(name, math.inf) / scale
        if math.isfinite(limit):
            axes.plot([limit] * 2, [level - 0.44, level + 0.44], color=INK, lw=2.0)
    axes.set_xscale("log")
    few_decades(axes.xaxis)
    axes.set_yticks(range(len(strips)), list(strips))
    axes.set_ylim(len(strips) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")
    axes.spines["left"].set_visible(False)
    axes.tick_params(axis="y", length=0)


def _edges(settings: Sequence[float]) -> list[float]:
    """Return where strips begin and end: midway between settings on a logarithmic axis."""
    between = [math.sqrt(a * b) for a, b in itertools.pairwise(settings)]
    return [settings[0] / _OVERHANG, *between, settings[-1] * _OVERHANG]


def draw_kinds(
    figure: Figure, colours: Mapping[str, str], left: float, *, theory: bool, columns: int = 4
) -> None:
    """Name the colours of strips in a legend at the foot of a figure."""
    handles: list[Any] = [Patch(color=colour, label=kind) for kind, colour in colours.items()]
    handles.append(Line2D([], [], color=INK, marker=".", ls="", ms=4, alpha=0.55, label="a trial"))
    if theory:
        handles.append(Line2D([], [], color=INK, lw=2.0, label="limit in theory"))
    figure.legend(
        handles=handles, loc="lower left", bbox_to_anchor=(left, 0.015), ncols=columns,
        fontsize=10.5, columnspacing=1.5, handlelength=1.4,
    )  # fmt: skip
