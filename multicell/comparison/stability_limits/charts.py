"""The picture of stability: how each method ends at each step or tolerance."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from multicell.comparison.stability_limits.trial import BLOW_UP, STABLE, STALL, WRONG
from multicell.report.plots.style import INK, blank, few_decades, styled
from multicell.report.wording import cell_count

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from multicell.comparison.base import Comparison, Row

# distinguishable by lightness as well as by hue (Okabe & Ito, darkened where white text is near)
TRIAL_COLOURS: Final = {
    STABLE: "#cfe8dc",
    BLOW_UP: "#8f1d14",
    STALL: "#5c6166",
    WRONG: "#e69f00",
}
"""Kind of end -> its colour."""

_OVERHANG: Final = 1.35  # of the first and last strip beyond its setting


@styled
def stability_map(result: Comparison, tolerance: str) -> Figure:
    """Draw one strip for each method, coloured by what happens at each step or tolerance.

    ``tolerance`` says what a tolerance is.
    """
    first = result.table[0]
    figure = blank(
        f"{result.title}: stability",
        f"{cell_count(first['cells'])} · λmax = {first['rate']:.3g}/s, Euler's limit 2/λmax = "
        f"{2.0 / first['rate']:.3g} s",
    )
    groups: dict[str, dict[str, list[Row]]] = {}
    for control in ("step", "tolerance"):
        for row in result.with_values(control=control):
            groups.setdefault(control, {}).setdefault(row["method"], []).append(row)
    left, width = 0.135, (0.845 if len(groups) == 1 else 0.455)
    for control, strips in groups.items():
        axes = figure.add_axes((left, 0.225, width, 0.61), label=control)
        steps = control == "step"
        _draw_strips(axes, strips, 2.0 / first["rate"] if steps else 1.0)
        axes.tick_params(labelsize=10.5)
        axes.set_xlabel("step / Euler's limit" if steps else tolerance, fontsize=11)
        axes.set_title("Fixed step" if steps else "Error control", fontsize=12)
        left, width = left + width + 0.125, 0.265
    kinds = [kind for kind in TRIAL_COLOURS if kind in result.column("kind")]
    handles: list[Any] = [Patch(color=TRIAL_COLOURS[kind], label=kind) for kind in kinds]
    handles.append(Line2D([], [], color=INK, marker=".", ls="", ms=4, alpha=0.55, label="a trial"))
    if "step" in groups:
        handles.append(Line2D([], [], color=INK, lw=2.0, label="limit in theory"))
    figure.legend(
        handles=handles,
        loc="lower left",
        bbox_to_anchor=(0.125, 0.015),
        ncols=4,
        fontsize=10.5,
        columnspacing=1.5,
        handlelength=1.4,
    )
    return figure


def _draw_strips(axes: Axes, strips: Mapping[str, Sequence[Row]], scale: float) -> None:
    """Draw how trials end over their settings, divided by ``scale``, one strip a method.

    Strips change midway between settings; a bar is the largest stable step in theory.
    """
    for level, (name, rows) in enumerate(strips.items()):
        settings = [row["setting"] / scale for row in rows]
        between = [math.sqrt(a * b) for a, b in itertools.pairwise(settings)]
        edges = [settings[0] / _OVERHANG, *between, settings[-1] * _OVERHANG]
        for row, (low, high) in zip(rows, itertools.pairwise(edges), strict=True):
            axes.barh(
                level,
                high - low,
                left=low,
                height=0.66,
                color=TRIAL_COLOURS[row["kind"]],
                lw=0,
                label=row["kind"],
                gid=f"{name}|{row['kind']}",
            )
        axes.plot(settings, [level] * len(settings), ".", ms=2.2, color=INK, alpha=0.55)
        limit = rows[0]["theory"] / scale
        if rows[0]["control"] == "step" and math.isfinite(limit):
            axes.plot([limit] * 2, [level - 0.44, level + 0.44], color=INK, lw=2.0)
    axes.set_xscale("log")
    few_decades(axes.xaxis)
    axes.set_yticks(range(len(strips)), list(strips))
    axes.set_ylim(len(strips) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")
    axes.spines["left"].set_visible(False)
    axes.tick_params(axis="y", length=0)
