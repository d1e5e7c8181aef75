"""Pictures of stability: a map of how each method fails, and limits along sweeps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from multicell.comparison.panels import draw_kinds, draw_strips
from multicell.comparison.stability_limits.trial import BLOW_UP, DAMPED, STABLE, STALL, WRONG
from multicell.comparison.styles import MAX_COLOURED, Style, method_styles
from multicell.report.plots.marks import NAMED
from multicell.report.plots.style import QUIET, blank, few_decades, styled
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


@styled
def stability_map(result: StabilityMap) -> Figure:
    """Draw one strip for each method, coloured by what happens at each step or tolerance."""
    first = result.table[0]
    growth = first["growth_rate"]
    grows = f" · μ = {growth:.3g}/s" if growth > 0.0 else ""
    figure = blank(
        f"{result.title}: stability",
        f"{cell_count(first['cells'])} · λmax = {first['rate']:.3g}/s, Euler's limit 2/λmax = "
        f"{2.0 / first['rate']:.3g} s{grows}",
    )
    groups = {
        control: {m: result.rows(m) for m in result.methods if _control(result, m) == control}
        for control in ("step", "tolerance")
    }
    groups = {control: strips for control, strips in groups.items() if strips}
    left, width = 0.135, (0.845 if len(groups) == 1 else 0.455)
    for control, strips in groups.items():
        axes = figure.add_axes((left, 0.225, width, 0.61), label=control)
        steps = control == "step"
        limits = {method: rows[0]["theory"] for method, rows in strips.items() if steps}
        draw_strips(axes, strips, COLOURS, limits, 2.0 / first["rate"] if steps else 1.0)
        axes.tick_params(labelsize=10.5)
        axes.set_xlabel("step / Euler's limit" if steps else "tolerance / mean radius", fontsize=11)
        axes.set_title("Fixed step" if steps else "Error control", fontsize=12)
        left, width = left + width + 0.125, 0.265
    seen = {row["kind"] for row in result.table if not row["sweep"]}
    colours = {kind: COLOURS[kind] for kind in result.kinds if kind in seen}
    draw_kinds(figure, colours, 0.125, theory="step" in groups)
    return figure


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
    styles = method_styles(stepping, stepping[:MAX_COLOURED], result.facts)
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
            _limits(axes, own, styles[method].colour, size)
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
    _sweeps_legend(figure, styles, shown, (0.7, 0.46) if many else (0.81, 0.85))
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
    figure: Figure, styles: Mapping[str, Style], rows: Sequence[Row], place: tuple[float, float]
) -> None:
    kinds = {row["kind"] for row in rows} - {STABLE}
    handles: list[Any] = [
        Line2D([], [], color=styles[method].colour, lw=1.8, label=method)
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
