"""Pictures of field solvers: error over cost, a square panel for each problem; where they fail."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from multicell.comparison.field_solvers.equations import SHELLS
from multicell.comparison.field_solvers.measure import (
    NEGATIVE,
    NO_CONVERGENCE,
    NOT_FINITE,
    OFF,
    RAISES,
    RIGHT,
    RUNS_AWAY,
    TOO_SLOW,
)
from multicell.comparison.field_solvers.problems import KINDS
from multicell.comparison.field_solvers.solvers import SOLVERS
from multicell.comparison.files import CLOCKS, DONE, FAILED, Row
from multicell.comparison.panels import (
    UNCERTAIN,
    draw_band,
    draw_curves,
    draw_failures,
    draw_kinds,
    draw_legend,
    draw_strips,
    log_range,
    set_limits,
)
from multicell.comparison.styles import MAX_COLOURED, Point, Style, distinct, pareto_front
from multicell.report.plots.style import INK, QUIET, blank, styled
from multicell.report.wording import cell_count, time_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from multicell.comparison.field_solvers.result import FieldComparison

_LEFT, _TOP, _SIDE, _GAP, _LOW, _STRIP = 0.8, 1.12, 2.5, 0.5, 0.85, 0.3  # inches
_LEGEND = 2.3
_GRID: Final = "#8d99a3"
_SMALLEST: Final = 1e-9
"""Error at which all smaller ones are drawn."""

COLOURS: Final = {
    RIGHT: "#cfe8dc",
    OFF: "#f3d27a",
    NEGATIVE: "#e69f00",
    RUNS_AWAY: "#c2452d",
    NOT_FINITE: "#7a1009",
    NO_CONVERGENCE: "#56789c",
    RAISES: "#1b2a49",
    TOO_SLOW: "#9aa0a6",
}
"""Kind of end -> its colour."""

_MAPS, _MAP_WIDTH, _MAP_HEIGHT = 5, 1.85, 1.5  # maps in a row, inches of a map


@styled
def solvers(result: FieldComparison, field: str) -> Figure:
    """Draw error over time of all solvers at the field's own spacing."""
    shown = {g: result.own_spacing(field, g) for g in result.geometries(field)}
    kinds = [k for k in KINDS if result.rows(field=field, problem=k)]
    words = ", ".join(f"{g} of {h:.3g} µm" for g, h in shown.items())
    page = _page(result, f"{field}: error of solvers", words, len(shown), len(kinds), 3.6)
    styles = _styles(result, field, shown)
    for row, (geometry, spacing) in enumerate(shown.items()):
        for column, kind in enumerate(kinds):
            own = result.rows(field=field, problem=kind, geometry=geometry, spacing=spacing)
            axes = page.axes(row, column, f"{geometry} {kind}")
            strip = page.axes(row, column, f"{geometry} {kind} x", strip=True)
            _panel(axes, strip, result, own, styles)
            strip.set_title(f"{kind}, {geometry}", fontsize=11, pad=5)
            _label(axes, result, last=row == len(shown) - 1, first=column == 0)
    others: list[Line2D | Patch] = [
        Line2D([], [], color=INK, lw=4.5, alpha=0.13, label="Pareto front"),
        Line2D([], [], color=_GRID, lw=1.3, ls=":", label="error of the grid itself"),
        Patch(color=UNCERTAIN, label="reference unsure"),
    ]
    failures = bool(result.failed())
    draw_legend(page.figure, styles, page.corner(), failures=failures, others=others)
    return page.figure


@styled
def spacings(result: FieldComparison, field: str) -> Figure:
    """Draw what grid and solver together get wrong over time, along the ladder of spacings."""
    kinds = [k for k in KINDS if result.rows(field=field, problem=k)]
    words = "cheapest solve whose own error is below half of the grid's"
    page = _page(result, f"{field}: spacing of the grid", words, 1, len(kinds), 2.0)
    styles = {
        f"{geometry}, {group}": Style(colour, "o" if geometry == SHELLS else "s", line)
        for geometry in result.geometries(field)
        for group, colour, line in (("ours", "#0072b2", "-"), ("py-pde", "#e69f00", "--"))
    }
    for column, kind in enumerate(kinds):
        axes = page.axes(0, column, kind)
        axes.set_title(kind, fontsize=11, pad=5)
        series = {name: _ladder(result, field, kind, *name.split(", ")) for name in styles}
        draw_curves(axes, series, styles)
        found = [point for points in series.values() for point in points]
        errors = log_range((point.error for point in found), 1.5)
        set_limits(axes, log_range((point.cost for point in found), 1.5), errors)
        axes.tick_params(labelsize=9)
        _label(axes, result, last=True, first=column == 0)
    draw_legend(page.figure, styles, page.corner(), failures=False)
    below = page.corner()[1] - (0.25 * len(styles) + 0.1) / page.figure.get_figheight()
    page.figure.text(
        page.corner()[0] + 0.01, below, _sizes(result, field), fontsize=8, color=QUIET, va="top",
        linespacing=1.35,
    )  # fmt: skip
    return page.figure


@styled
def stability_map(result: FieldComparison) -> Figure:
    """Draw strips over steps or tolerances for each solver and Thiele modulus."""
    first = result.failures[0]
    trials: dict[str, list[Row]] = {}
    for row in sorted(result.failures, key=lambda row: row["control"]):
        trials.setdefault(row["solver"], []).append(row)
    names = list(trials)
    lines = [
        group[k : k + _MAPS]
        for stepping in (True, False)
        if (group := [n for n in names if (trials[n][0]["control"] == "step") == stepping])
        for k in range(0, len(group), _MAPS)
    ]
    wide = max(0.85 + max(map(len, lines)) * (_MAP_WIDTH + 0.28), 10.0)
    tall = 1.0 + len(lines) * (_MAP_HEIGHT + 0.95) + 0.85
    where = f"{first['nodes']:,} {first['geometry']} of {first['spacing']:.3g} µm"
    subtitle = f"{first['field']}: where solvers fail in a transient · {where}"
    figure = blank(result.title, subtitle, (wide, tall))
    for level, line in enumerate(lines):
        for column, name in enumerate(line):
            left = 0.85 + column * (_MAP_WIDTH + 0.28)
            base = tall - 1.0 - (level + 1) * (_MAP_HEIGHT + 0.95) + 0.65
            place = (left / wide, base / tall, _MAP_WIDTH / wide, _MAP_HEIGHT / tall)
            axes = figure.add_axes(place, label=name)
            _map(axes, trials[name])
            axes.set_title(name, fontsize=10.5, pad=4)
            if column:
                axes.tick_params(labelleft=False)
            else:
                axes.set_ylabel("Thiele modulus", fontsize=10)
    seen = {row["kind"] for row in result.failures}
    slow = f"{TOO_SLOW} (over {result.facts['trial_patience']:.2g} s)"
    colours = {slow if k == TOO_SLOW else k: c for k, c in COLOURS.items() if k in seen}
    stepping = any(row["control"] == "step" for row in result.failures)
    draw_kinds(figure, colours, 0.06, theory=stepping, columns=5)
    return figure


def _map(axes: Axes, rows: Sequence[Row]) -> None:
    """Draw the ends of one solver."""
    strips: dict[str, list[Row]] = {}
    limits: dict[str, float] = {}
    for row in sorted(rows, key=lambda row: (-row["thiele"], row["setting"])):
        modulus = f"{row['thiele']:.3g}"
        strips.setdefault(modulus, []).append(row)
        if row["control"] == "step":
            limits[modulus] = row["limit"] * SOLVERS[row["solver"]].stable
    draw_strips(axes, strips, COLOURS, limits)
    settings = [row["setting"] for row in rows]
    axes.set_xlim(min(settings) / 1.5, max(settings) * 1.5)
    stepping = rows[0]["control"] == "step"
    axes.set_xlabel("step / Euler's limit" if stepping else "tolerance / scale", fontsize=10)
    axes.tick_params(labelsize=9)


class _Page(NamedTuple):
    """A figure with panels of one size in rows and columns, and room for a legend."""

    figure: Figure

    def axes(self, row: int, column: int, label: str, *, strip: bool = False) -> Axes:
        """Return a panel, or the strip above one."""
        wide, tall = self.figure.get_size_inches()
        base = tall - _TOP - row * (_SIDE + _STRIP + _LOW) - _STRIP - _SIDE * (not strip)
        place = (_LEFT + column * (_SIDE + _GAP)) / wide, base / tall
        size = _SIDE / wide, (_STRIP if strip else _SIDE) / tall
        return self.figure.add_axes((*place, *size), label=label)

    def corner(self) -> tuple[float, float]:
        """Return the upper left corner of the legend in parts of the figure."""
        wide, tall = self.figure.get_size_inches()
        return 1.0 - (_LEGEND - 0.05) / wide, 1.0 - _TOP / tall


def _page(
    result: FieldComparison, title: str, words: str, rows: int, columns: int, legend: float
) -> _Page:
    """Return an empty page with its heading, whose legend is ``legend`` inches high."""
    wide = max(_LEFT + columns * (_SIDE + _GAP) + _LEGEND, 8.0)
    tall = _TOP + max(rows * (_SIDE + _STRIP + _LOW), legend)
    figure = blank(result.title, f"{title} · {state(result.facts)}", (wide, tall))
    said = f"{words} · {result.facts['backend_words']}"
    figure.text(0.04, 1.0 - 0.815 / tall, said, fontsize=9.5, color=QUIET, va="center")
    return _Page(figure)


def state(facts: Mapping[str, Any]) -> str:
    """Return how many cells there are, and when."""
    moment = facts["time"]
    when = "at the start" if moment == 0.0 else f"after {time_unit(moment).text(moment)}"
    return f"{cell_count(facts['cells'])} {when}"


def _label(axes: Axes, result: FieldComparison, *, last: bool, first: bool) -> None:
    """Name the axes of the panels at the left and at the foot of a page."""
    if last:
        axes.set_xlabel(f"{CLOCKS[result.clock]} (s)", fontsize=10.5)
    if first:
        axes.set_ylabel("error / highest concentration", fontsize=10.5)


def _panel(
    axes: Axes,
    strip: Axes,
    result: FieldComparison,
    rows: Sequence[Row],
    styles: Mapping[str, Style],
) -> None:
    """Draw the points of one problem, and its failures in the strip above."""
    done = [_point(row, result.clock) for row in rows if row["status"] == DONE]
    failed = [row for row in rows if row["status"] == FAILED]
    grid_error = rows[0]["space_error"]
    known = [grid_error] if grid_error > 0.0 else []
    costs = log_range([p.cost for p in done] or [row["spent"] for row in failed] or [1.0], 1.5)
    errors = log_range([*(point.error for point in done), *known] or [1e-2], 1.5)
    draw_curves(axes, {n: [p for p in done if p.method == n] for n in styles}, styles, 5.0)
    front = pareto_front(done)
    axes.plot(
        [p.cost for p in front], [p.error for p in front], "-", color=INK, lw=4.5, alpha=0.13,
        zorder=1.3, solid_capstyle="round", label="_front",
    )  # fmt: skip
    set_limits(axes, costs, errors)
    draw_band(axes, rows[0]["uncertainty"], UNCERTAIN, "_uncertainty")
    if known:
        axes.axhline(grid_error, color=_GRID, lw=1.3, ls=":", zorder=1.2)
    axes.tick_params(labelsize=9)
    spent = {
        name: [row["spent"] for row in failed if row["solver"] == name]
        for name in styles
        if any(row["solver"] == name for row in failed)
    }
    draw_failures(strip, spent, styles, costs)


def _point(row: Row, clock: str) -> Point:
    ends = row[f"{clock}_shortest"], row[f"{clock}_longest"]
    return Point(row["solver"], row[clock], max(row["error"], _SMALLEST), *ends)


def _styles(result: FieldComparison, field: str, shown: Mapping[str, float]) -> dict[str, Style]:
    """Return the style of each solver: in colour ours, three of the Pareto fronts, and others."""
    on_fronts: dict[str, int] = {}
    for geometry, spacing in shown.items():
        for kind in KINDS:
            where = {"field": field, "geometry": geometry, "spacing": spacing, "problem": kind}
            done = [_point(row, result.clock) for row in result.rows(**where, status=DONE)]
            for point in pareto_front(done):
                on_fronts[point.method] = on_fronts.get(point.method, 0) + 1
    known = {name: SOLVERS[name] for name in result.solvers}
    ours = [name for name, solver in known.items() if solver.ours]
    best = sorted((n for n in on_fronts if n not in ours), key=lambda name: -on_fronts[name])
    first = [name for name, solver in known.items() if solver.colour]
    coloured = list(dict.fromkeys([*ours, *best[:3], *first, *known]))[:MAX_COLOURED]
    preferred = {
        name: Style(solver.colour, solver.marker, "-" if solver.ours else "--")
        for name, solver in known.items()
    }
    return distinct(preferred, coloured)


def _sizes(result: FieldComparison, field: str) -> str:
    """Return the spacings of each geometry in words."""
    lines = []
    for geometry in result.geometries(field):
        known = {row["spacing"] for row in result.rows(field=field, geometry=geometry)}
        steps = ", ".join(f"{h:.3g}" for h in sorted(known, reverse=True))
        lines.append(f"{geometry}, coarse to fine:\n{steps} µm")
    return "\n".join(lines)


def _ladder(
    result: FieldComparison, field: str, kind: str, geometry: str, group: str
) -> list[Point]:
    """Return cost and error of grid and solver together of the best solve on each grid."""
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
            found.append(_point({**best, "error": error}, result.clock))
    return found
