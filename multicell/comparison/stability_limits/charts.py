"""The picture of stability, how each method ends at each step or tolerance, and its page."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from matplotlib.figure import Figure

from multicell.comparison.panels import draw_kinds, draw_strips
from multicell.comparison.stability_limits.moving_states import STATES
from multicell.comparison.stability_limits.trial import BLOW_UP, DAMPED, KINDS, STABLE, STALL, WRONG
from multicell.report.plots.style import blank, styled
from multicell.report.wording import cell_count, clock

if TYPE_CHECKING:
    from multicell.comparison.base import Row
    from multicell.comparison.stability_limits.result import StabilityMap

CAPTION: Final = (
    "What happens at each step or tolerance. Each dot is one trial; a bar is the limit in theory."
)

# told apart by lightness as well as by hue (Okabe & Ito, darkened where white text is near)
COLOURS: Final = {
    STABLE: "#cfe8dc",
    BLOW_UP: "#8f1d14",
    STALL: "#5c6166",
    WRONG: "#e69f00",
    DAMPED: "#1565c0",
}
"""Kind of end -> its colour."""


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
    colours = {kind: COLOURS[kind] for kind in result.kinds}
    draw_kinds(figure, colours, 0.125, theory="step" in groups)
    return figure


def _control(result: StabilityMap, method: str) -> str:
    return str(next(row["control"] for row in result.table if row["method"] == method))


def context(result: StabilityMap) -> dict[str, Any]:
    """Return what ``stability.html`` asks for."""
    first = result.table[0]
    failures = sum(row["kind"] != STABLE for row in result.table)
    return {
        "title": f"{result.title}: stability",
        "subtitle": STATES[first["state"]],
        "tiles": {
            "state": first["state"],
            "cells": f"{first['cells']:,}",
            "largest decay rate λmax": f"{first['rate']:.3g}/s",
            "Euler's limit 2/λmax": f"{2.0 / first['rate']:.3g} s",
            **_moving_tiles(first),
            "methods": f"{len(result.methods)}",
            "trials that failed": f"{failures} of {len(result.table):,}",
            "wall time": clock(result.facts["wall"]),
        },
        "colours": COLOURS,
        "kinds": KINDS,
        "failed": [row for row in result.table if row["kind"] != STABLE],
    }


def _moving_tiles(row: Row) -> dict[str, str]:
    """Return the tiles of a moving state."""
    if row["state"] == "settled":
        return {}
    return {
        "2/λmax at the end": f"{2.0 / row['end_rate']:.3g} s" if row["end_rate"] else "no contacts",
        "largest growth rate μ": f"{row['growth_rate']:.3g}/s",
        "length of a trial": f"{row['length']:.4g} s",
    }
