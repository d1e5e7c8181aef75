"""Pictures of field solvers: error over cost, a square panel for each problem."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from multicell.comparison.charts import Look
from multicell.comparison.field_solvers.problems import KINDS, SHELLS
from multicell.comparison.field_solvers.solvers import SOLVERS
from multicell.comparison.files import CLOCKS, DONE, FAILED, Row
from multicell.comparison.highlights import MOST, Point, pareto_front
from multicell.report.plots.colour_vision import PALE, told_apart
from multicell.report.plots.marks import NAMED
from multicell.report.plots.style import INK, QUIET, RED, blank, styled
from multicell.report.wording import cell_count, time_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from multicell.comparison.field_solvers.result import FieldComparison

_LEFT, _TOP, _SIDE, _GAP, _LOW, _STRIP = 0.8, 1.12, 2.5, 0.5, 0.85, 0.3  # inches
_LEGEND = 2.15
_BAND: Final = "#e9edf0"
_GRID: Final = "#8d99a3"
_FLOOR: Final = 1e-9
_MARGIN, _SHORTEST = 0.15, 1.5  # decades


@styled
def solvers(result: FieldComparison, field: str) -> Figure:
    """Draw error over time of all solvers at the field's own spacing."""
    geometries = _geometries(result, field)
    shown = {g: result.own_spacing(field, g) for g in geometries}
    front = _front(result, field, shown)
    kinds = [k for k in KINDS if result.rows(field=field, problem=k)]
    words = ", ".join(f"{g} of {h:.3g} µm" for g, h in shown.items())
    figure, place = _page(
        result, f"{field}: error of solvers", words, len(geometries), len(kinds), 3.5
    )
    looks = _looks(result, front)
    for row, geometry in enumerate(geometries):
        for column, kind in enumerate(kinds):
            own = result.rows(field=field, problem=kind, geometry=geometry, spacing=shown[geometry])
            axes = figure.add_axes(place(row, column), label=f"{geometry} {kind}")
            strip = figure.add_axes(place(row, column, strip=True), label=f"{geometry} {kind} x")
            _panel(axes, strip, result, own, looks)
            strip.set_title(f"{kind}, {geometry}", fontsize=11, pad=5)
            if row == len(geometries) - 1:
                axes.set_xlabel(f"{CLOCKS[result.clock]} (s)", fontsize=10.5)
            if column == 0:
                axes.set_ylabel("error / highest concentration", fontsize=10.5)
    _legend(figure, result, looks, 1 if not result.failed() else 2)
    return figure


def _page(
    result: FieldComparison, title: str, words: str, rows: int, columns: int, legend: float
) -> tuple[Figure, Any]:
    """Return an empty figure with its heading, and where its panels stand."""
    pitch = _SIDE + _STRIP + _LOW
    wide = max(_LEFT + columns * (_SIDE + _GAP) + _LEGEND, 8.0)
    tall = max(_TOP + rows * pitch, _TOP + legend)
    facts = result.facts
    heading = f"{result.scene.title or 'Untitled scene'}"
    figure = blank(heading, f"{title} · {state(facts)}", (wide, tall))
    said = f"{words} · {facts['backend_words']}"
    figure.text(0.04, 1.0 - 0.815 / tall, said, fontsize=9.5, color=QUIET, va="center")

    def place(row: int, column: int, *, strip: bool = False) -> tuple[float, float, float, float]:
        left = _LEFT + column * (_SIDE + _GAP)
        base = tall - _TOP - row * pitch - _STRIP - _SIDE
        height = _STRIP if strip else _SIDE
        return left / wide, (base + _SIDE * strip) / tall, _SIDE / wide, height / tall

    return figure, place


def state(facts: Mapping[str, Any]) -> str:
    """Return how many cells there are, and when."""
    moment = facts["time"]
    when = "at the start" if moment == 0.0 else f"after {time_unit(moment).text(moment)}"
    return f"{cell_count(facts['cells'])} {when}"


def _panel(
    axes: Axes, strip: Axes, result: FieldComparison, rows: Sequence[Row], looks: Mapping[str, Look]
) -> None:
    """Draw the points of one problem, and its failures in the strip above."""
    clock = result.clock
    done = [r for r in rows if r["status"] == DONE]
    failed = [r for r in rows if r["status"] == FAILED]
    costs = [r[clock] for r in done] or [r["spent"] for r in failed] or [1.0]
    errors = [max(r["error"], _FLOOR) for r in done]
    open_error, grid_error = rows[0]["uncertainty"], rows[0]["space_error"]
    if grid_error > 0.0:
        errors.append(grid_error)
    wide, high = _range(costs), _range(errors or [1e-2])
    _band(axes, open_error, high)
    if grid_error > 0.0:
        axes.axhline(grid_error, color=_GRID, lw=1.3, ls=":", zorder=1.2)
    for name, (colour, marker, line) in looks.items():
        own = [r for r in done if r["solver"] == name]
        pale = colour == PALE
        axes.plot(
            [r[clock] for r in own], [max(r["error"], _FLOOR) for r in own], line, color=colour,
            marker=marker, ms=3.0 if pale else 5.0, lw=0.8 if pale else 1.3,
            zorder=1.5 if pale else 2.5, gid=NAMED + name, label=name,
        )  # fmt: skip
    front = pareto_front([_point(r, clock) for r in done])
    axes.plot(
        [p.cost for p in front], [p.error for p in front], "-", color=INK, lw=4.5, alpha=0.13,
        zorder=1.3, solid_capstyle="round", label="_front",
    )  # fmt: skip
    _limits(axes, wide, high)
    if high[0] < _FLOOR:
        axes.set_ylim(0.5 * _FLOOR, high[1])
    _crosses(strip, failed, looks, wide)


def _point(row: Row, clock: str) -> Point:
    cost, ends = row[clock], (row[f"{clock}_shortest"], row[f"{clock}_longest"])
    return Point(row["solver"], cost, max(row["error"], _FLOOR), *ends)


def _band(axes: Axes, open_error: float, high: tuple[float, float]) -> None:
    """Shade the errors that the reference cannot tell from zero, as far as the axis goes."""
    if open_error > high[0]:
        axes.axhspan(high[0], min(open_error, high[1]), color=_BAND, lw=0, zorder=-1)


def _range(values: Sequence[float]) -> tuple[float, float]:
    """Return the ends of a logarithmic axis."""
    logs = [math.log10(value) for value in values if value > 0.0] or [0.0]
    low, high = min(logs) - _MARGIN, max(logs) + _MARGIN
    missing = max(0.0, _SHORTEST - (high - low)) / 2.0
    return 10.0 ** (low - missing), 10.0 ** (high + missing)


def _limits(axes: Axes, wide: tuple[float, float], high: tuple[float, float]) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(wide)
    axes.set_ylim(high)
    for axis, ends in ((axes.xaxis, wide), (axes.yaxis, high)):
        decades = math.log10(ends[1] / ends[0])
        axis.set_major_locator(LogLocator(numticks=6 if decades < 6 else 5))
        if decades < 2.0:
            axis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
    axes.tick_params(labelsize=9)


def _crosses(
    strip: Axes, failed: Sequence[Row], looks: Mapping[str, Look], wide: tuple[float, float]
) -> None:
    """Draw every failed solve as a cross at the time that it had taken."""
    names = [name for name in looks if any(r["solver"] == name for r in failed)]
    for level, name in enumerate(names):
        height = 1.0 - (level + 0.5) / len(names)
        spent = [min(max(r["spent"], wide[0]), wide[1]) for r in failed if r["solver"] == name]
        strip.plot(
            spent, [height] * len(spent), "x", ms=4.5, mew=1.3, color=looks[name][0],
            gid=f"{NAMED}{name} failed", clip_on=False,
        )  # fmt: skip
    strip.set_xscale("log")
    strip.set_xlim(wide)
    strip.set_ylim(0.0, 1.0)
    strip.set_yticks([])
    strip.tick_params(axis="x", which="both", labelbottom=False, length=0)
    strip.grid(visible=False)
    for side in ("left", "bottom"):
        strip.spines[side].set_visible(False)
    strip.set_facecolor("#faf3f1" if failed else "white")


def _geometries(result: FieldComparison, field: str) -> list[str]:
    return list(dict.fromkeys(row["geometry"] for row in result.rows(field=field)))


def _front(result: FieldComparison, field: str, shown: Mapping[str, float]) -> list[str]:
    """Return the solvers on the Pareto fronts of all panels, those that hold most of them first."""
    held: dict[str, int] = {}
    for geometry, spacing in shown.items():
        for kind in KINDS:
            done = result.rows(
                field=field, geometry=geometry, spacing=spacing, problem=kind, status=DONE
            )
            for point in pareto_front([_point(row, result.clock) for row in done]):
                held[point.method] = held.get(point.method, 0) + 1
    return sorted(held, key=lambda name: -held[name])


def _looks(result: FieldComparison, front: Sequence[str]) -> dict[str, Look]:
    """Return colour, marker and line style of each solver: ours, the front's, and others."""
    ours = [name for name in result.solvers if SOLVERS[name].ours]
    first = [name for name in result.solvers if SOLVERS[name].colour]
    best = [name for name in front if name not in ours]
    ranked = list(dict.fromkeys([*ours, *best[:3], *first, *result.solvers]))[:MOST]
    own = told_apart({name: SOLVERS[name].colour for name in ranked})
    return {
        name: (
            own.get(name, PALE), SOLVERS[name].marker, "-" if SOLVERS[name].ours else "--",
        )
        for name in result.solvers
    }  # fmt: skip


def _legend(figure: Figure, result: FieldComparison, looks: Mapping[str, Look], extra: int) -> None:
    """Name the solvers in colour, and below them the pale ones."""
    handles: list[Any] = [
        Line2D([], [], color=colour, marker=marker, ls=line, ms=5.5, label=name)
        for name, (colour, marker, line) in looks.items()
        if colour != PALE
    ]
    handles.append(Line2D([], [], color=INK, lw=4.5, alpha=0.13, label="Pareto front"))
    handles.append(Line2D([], [], color=_GRID, lw=1.3, ls=":", label="error of the grid itself"))
    handles.append(Patch(color=_BAND, label="open in the reference"))
    if extra > 1:
        handles.append(Line2D([], [], color=RED, marker="x", ls="", mew=1.3, label="failed solve"))
    wide, tall = figure.get_size_inches()
    left, top = 1.0 - (_LEGEND - 0.05) / wide, 1.0 - _TOP / tall
    figure.legend(
        handles=handles, loc="upper left", bbox_to_anchor=(left, top), fontsize=9.3,
        labelspacing=0.45, handlelength=1.9, borderaxespad=0.0,
    )  # fmt: skip
    names = [name for name, (colour, _, _) in looks.items() if colour == PALE]
    if names:
        below = top - (0.193 * len(handles) + 0.12) / tall
        text = "\n".join(textwrap.wrap(f"pale: {', '.join(names)}", 29, break_on_hyphens=False))
        figure.text(left + 0.01, below, text, fontsize=8, color=QUIET, va="top", linespacing=1.35)


_SERIES: Final = (
    ("ours", "#0072b2", "-"),
    ("py-pde", "#e69f00", "--"),
)


@styled
def spacings(result: FieldComparison, field: str) -> Figure:
    """Draw what grid and solver together get wrong over time, along the ladder of spacings."""
    kinds = [k for k in KINDS if result.rows(field=field, problem=k)]
    words = "cheapest solve whose own error is below half of the grid's"
    figure, place = _page(result, f"{field}: spacing of the grid", words, 1, len(kinds), 2.0)
    geometries = _geometries(result, field)
    for column, kind in enumerate(kinds):
        axes = figure.add_axes(place(0, column), label=kind)
        axes.set_title(kind, fontsize=11, pad=5)
        found = {
            (geometry, group): _ladder(result, field, kind, geometry, group)
            for geometry in geometries
            for group, _, _ in _SERIES
        }
        points = [point for series in found.values() for point in series]
        for (geometry, group), series in found.items():
            _, colour, line = next(entry for entry in _SERIES if entry[0] == group)
            costs = [cost for cost, _, _, _ in series]
            errors = [error for _, error, _, _ in series]
            axes.plot(costs, errors, line, color=colour, lw=1.4, label=f"{geometry}, {group}")
            axes.scatter(
                costs, errors, [_size(result, field, geometry, h) for _, _, h, _ in series],
                color=colour if geometry != SHELLS else "white", edgecolors=colour, linewidths=1.4,
                marker="o" if geometry == SHELLS else "s", zorder=2.5,
            )  # fmt: skip
        _limits(
            axes, _range([cost for cost, _, _, _ in points] or [1.0]),
            _range([error for _, error, _, _ in points] or [1e-2]),
        )  # fmt: skip
        axes.set_xlabel(f"{CLOCKS[result.clock]} (s)", fontsize=10.5)
        if column == 0:
            axes.set_ylabel("error / highest concentration", fontsize=10.5)
    handles: list[Any] = [
        Line2D([], [], color=colour, ls=line, marker="o" if geometry == SHELLS else "s",
               mfc=colour if geometry != SHELLS else "white", label=f"{geometry}, {group}")
        for geometry in geometries for group, colour, line in _SERIES
    ]  # fmt: skip
    wide, tall = figure.get_size_inches()
    figure.legend(
        handles=handles, loc="upper left", fontsize=9.3, borderaxespad=0.0,
        bbox_to_anchor=(1.0 - (_LEGEND - 0.05) / wide, 1.0 - _TOP / tall),
    )  # fmt: skip
    below = 1.0 - (_TOP + 0.25 * len(handles) + 0.1) / tall
    figure.text(
        1.0 - (_LEGEND - 0.08) / wide, below, _sizes(result, field), fontsize=8, color=QUIET,
        va="top", linespacing=1.35,
    )  # fmt: skip
    return figure


def _size(result: FieldComparison, field: str, geometry: str, spacing: float) -> float:
    """Return the area of a marker in points²: larger for coarser grids."""
    known = sorted({row["spacing"] for row in result.rows(field=field, geometry=geometry)})
    return 22.0 + 38.0 * known.index(spacing)


def _sizes(result: FieldComparison, field: str) -> str:
    """Return the spacings of each geometry in words."""
    lines = []
    for geometry in _geometries(result, field):
        known = {row["spacing"] for row in result.rows(field=field, geometry=geometry)}
        steps = ", ".join(f"{h:.3g}" for h in sorted(known, reverse=True))
        several = len(known) > 1
        lines += [f"{geometry}, large to", f"small marker: {steps} µm"] if several else [
            f"{geometry} of {steps} µm"
        ]  # fmt: skip
    return "\n".join(lines)


def _ladder(
    result: FieldComparison, field: str, kind: str, geometry: str, group: str
) -> list[tuple[float, float, float, str]]:
    """Return cost, error of grid and solver, spacing and solver of the best solve on each grid."""
    rows = result.rows(field=field, problem=kind, geometry=geometry, status=DONE)
    found = []
    for spacing in sorted({row["spacing"] for row in rows}, reverse=True):
        own = [
            row for row in rows
            if row["spacing"] == spacing and SOLVERS[row["solver"]].ours == (group == "ours")
            and row["error"] <= 0.5 * row["space_error"]
        ]  # fmt: skip
        if own:
            best = min(own, key=lambda row: row[result.clock])
            error = best["space_error"] + best["error"]
            found.append((best[result.clock], error, spacing, best["solver"]))
    return found
