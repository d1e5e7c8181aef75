"""Pictures of stability: a map of how each method fails, and limits along sweeps."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from multicell.comparison.charts import Look, looks_apart
from multicell.comparison.highlights import MOST
from multicell.comparison.stability_limits.trial import BLOW_UP, DAMPED, STABLE, STALL, WRONG
from multicell.report.plots.marks import NAMED
from multicell.report.plots.style import INK, QUIET, blank, few_decades, styled
from multicell.report.wording import cell_count

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from multicell.comparison.files import Row
    from multicell.comparison.stability_limits.result import StabilityMap


# told apart by lightness as well as by hue (Okabe & Ito, darkened where white text is near)
COLOURS: Final = {
    STABLE: "#cfe8dc",
    BLOW_UP: "#8f1d14",
    STALL: "#5c6166",
    WRONG: "#e69f00",
    DAMPED: "#1565c0",
}
"""Kind of end -> its colour."""

_TITLES: Final = {
    "cells.young": ("Young's modulus (kPa)", "log"),
    "contact.surface_energy": ("surface energy (nN/µm)", "log"),
    "drag.viscosity": ("viscosity (kPa s)", "log"),
    "overlap at division": ("overlap of two daughters / sum of radii", "linear"),
    "ratio of moduli": ("modulus of two neighbours / of the others", "log"),
}
_MARGIN = 1.35


@styled
def stability_map(result: StabilityMap) -> Figure:
    """Draw one strip for each method, coloured by what happens at each step or tolerance."""
    cells, rate = result.table[0]["cells"], result.table[0]["rate"]
    growth = result.table[0]["growth_rate"]
    grows = f" · μ = {growth:.3g}/s" if growth > 0.0 else ""
    figure = blank(
        f"{result.title}: stability",
        f"{cell_count(cells)} · λmax = {rate:.3g}/s, Euler's limit 2/λmax = {2.0 / rate:.3g} s"
        + grows,
    )
    groups = [
        (control, [m for m in result.methods if _control(result, m) == control])
        for control in ("step", "tolerance")
    ]
    groups = [(control, methods) for control, methods in groups if methods]
    left, width = 0.135, (0.845 if len(groups) == 1 else 0.455)
    for control, methods in groups:
        axes = figure.add_axes((left, 0.225, width, 0.61), label=control)
        _strips(axes, result, control, methods)
        left, width = left + width + 0.125, 0.265
    seen = {row["kind"] for row in result.table if not row["sweep"]}
    kinds = [kind for kind in result.kinds if kind in seen]
    _kinds_legend(figure, kinds, any(control == "step" for control, _ in groups))
    return figure


def _strips(axes: Axes, result: StabilityMap, control: str, methods: Sequence[str]) -> None:
    """Draw the strips of the methods that have one kind of setting."""
    scale = 2.0 / result.table[0]["rate"] if control == "step" else 1.0
    for level, method in enumerate(methods):
        rows = result.rows(method)
        settings = [row["setting"] / scale for row in rows]
        edges = _edges(settings)
        for row, low, high in zip(rows, edges[:-1], edges[1:], strict=True):
            axes.barh(
                level, high - low, left=low, height=0.66, color=COLOURS[row["kind"]], lw=0,
                label=row["kind"], gid=f"{method}|{row['kind']}",
            )  # fmt: skip
        axes.plot(settings, [level] * len(settings), ".", ms=2.2, color=INK, alpha=0.55)
        theory = rows[0]["theory"]
        if control == "step" and math.isfinite(theory):
            axes.plot([theory / scale] * 2, [level - 0.44, level + 0.44], color=INK, lw=2.0)
    axes.set_xscale("log")
    few_decades(axes.xaxis)
    axes.set_yticks(range(len(methods)), methods)
    axes.set_ylim(len(methods) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")
    axes.spines["left"].set_visible(False)
    axes.tick_params(axis="y", length=0, labelsize=10.5)
    axes.tick_params(axis="x", labelsize=10.5)
    steps = control == "step"
    axes.set_xlabel("step / Euler's limit" if steps else "tolerance / mean radius", fontsize=11)
    axes.set_title("Fixed step" if steps else "Error control", fontsize=12)


def _edges(settings: Sequence[float]) -> list[float]:
    """Return where strips begin and end: midway between settings on a logarithmic axis."""
    between = [math.sqrt(a * b) for a, b in itertools.pairwise(settings)]
    return [settings[0] / _MARGIN, *between, settings[-1] * _MARGIN]


def _kinds_legend(figure: Figure, kinds: Sequence[str], theory: bool) -> None:
    handles: list[Any] = [Patch(color=COLOURS[kind], label=kind) for kind in kinds]
    handles.append(Line2D([], [], color=INK, marker=".", ls="", ms=4, alpha=0.55, label="a trial"))
    if theory:
        handles.append(Line2D([], [], color=INK, lw=2.0, label="limit in theory"))
    figure.legend(
        handles=handles, loc="lower left", bbox_to_anchor=(0.125, 0.015), ncols=4, fontsize=10.5,
        columnspacing=1.5, handlelength=1.4,
    )  # fmt: skip


@styled
def sweeps(result: StabilityMap) -> Figure:
    """Draw the largest stable step of each method along every sweep, over the theory's."""
    cells = result.table[0]["cells"]
    figure = blank(
        f"{result.title}: largest stable step",
        f"{cell_count(cells)} · line: theory, marker: measured, in the colour of the failure "
        "beyond it; triangle: no limit found",
    )
    stepping = [m for m in result.methods if _control(result, m) == "step"]
    looks = looks_apart(stepping, stepping[:MOST], result.facts)
    limits = {
        sweep: [row for row in result.limits(sweep) if row["control"] == "step"]
        for sweep in result.sweeps()
    }
    many = len(limits) > 2
    columns = 3 if many else len(limits)
    height = 0.84 / (-(-(len(limits) + 1) // 3) if many else 1)
    width = (0.98 if many else 0.8) / columns
    for k, (sweep, rows) in enumerate(limits.items()):
        row, column = divmod(k, columns)
        left, bottom = 0.08 + column * width, 0.96 - (row + 1) * height
        axes = figure.add_axes((left, bottom, width - 0.09, height - 0.13), label=sweep)
        for level, method in enumerate(stepping):
            # where limits coincide the first one stays visible around the later ones
            size = 9.0 - 4.5 * level / len(stepping)
            own = [row for row in rows if row["method"] == method]
            _limits(axes, own, looks[method][0], size)
        name, scale = _TITLES.get(sweep, (sweep, _scale(result.sweeps()[sweep])))
        axes.set_xscale(scale)
        axes.set_yscale("log")
        axes.set_xlabel(name, fontsize=10.5)
        axes.tick_params(labelsize=9.5)
        few_decades(axes.yaxis)
        if scale == "log":
            few_decades(axes.xaxis)
        if column == 0:
            axes.set_ylabel("step (s)", fontsize=10.5)
    shown = [row for rows in limits.values() for row in rows]
    _sweeps_legend(figure, looks, shown, (0.7, 0.46) if many else (0.81, 0.85))
    return figure


def _limits(axes: Axes, rows: Sequence[Row], colour: str, size: float) -> None:
    """Draw the limits of one method; one without a limit gets a triangle at its largest step."""
    theory = [(row["value"], row["theory"]) for row in rows if math.isfinite(row["theory"])]
    if theory:
        axes.plot(*zip(*theory, strict=True), color=colour, lw=0.3 * size)
    for row in rows:
        open_end = math.isinf(row["beyond"])
        if not math.isnan(row["limit"]):
            axes.plot(
                row["value"], row["limit"], "^" if open_end else "o", ms=size, mew=1.5, mec=colour,
                mfc="white" if open_end else COLOURS[row["kind"]], ls="",
                gid=NAMED + row["method"],
            )  # fmt: skip


def _sweeps_legend(
    figure: Figure, looks: Mapping[str, Look], rows: Sequence[Row], place: tuple[float, float]
) -> None:
    kinds = {row["kind"] for row in rows} - {STABLE}
    handles: list[Any] = [
        Line2D([], [], color=looks[method][0], lw=1.8, label=method)
        for method in dict.fromkeys(row["method"] for row in rows)
    ]
    handles += [
        Line2D([], [], marker="o", ls="", ms=7, mec=QUIET, mfc=colour, label=kind)
        for kind, colour in COLOURS.items()
        if kind in kinds
    ]
    figure.legend(
        handles=handles, loc="upper left", bbox_to_anchor=place, fontsize=9.8, labelspacing=0.4
    )


def _control(result: StabilityMap, method: str) -> str:
    return str(next(row["control"] for row in result.table if row["method"] == method))


def _scale(values: Sequence[float]) -> str:
    """Return a logarithmic axis for positive values that span more than a factor of five."""
    return "log" if min(values) > 0.0 and max(values) > 5.0 * min(values) else "linear"
