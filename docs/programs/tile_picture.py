"""The diagram as one picture: three states of tissue, who is cheapest where, and by how much."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, LogNorm, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from matplotlib.patheffects import withStroke
from tile_problems import STATES
from tile_race import Row
from tile_tables import Point, points, power, seed_range

from multicell.report.plots.style import INK, QUIET, blank, styled

TITLES: Final = {"quiet": "Quiet: no recent division", "typical": "Typical: steady growth",
                 "fresh": "Fresh: a wave of divisions"}  # fmt: skip
# Okabe & Ito's orange and blue, which differ in lightness too, with a pale middle
_COLOURS: Final = LinearSegmentedColormap.from_list(
    "cheaper", ["#b35806", "#e69f00", "#fbe6bd", "#f7f7f7", "#c9e1f2", "#4a9fd4", "#004f7c"]
)
_NORM: Final = LogNorm(1.0 / 20.0, 20.0)
_NULL: Final = "#c3c9ce"
_HATCH: Final = "#8d98a1"
_SIZE: Final = (13.0, 6.9)
_BASE, _TALL = 0.19, 0.60


@styled
def draw(tiles: Sequence[Row], rows: Sequence[Row], goal: float) -> Figure:
    """Return the picture of all tiles at a goal."""
    found = points(tiles, rows, goal)
    figure = blank(
        "Implicit or explicit?",
        f"Cheapest method for an error of {100 * goal:g} % of the motion of a coupling step that "
        "no dilation explains; one thread, all costs counted",
        _SIZE,
    )
    states = [state for state in STATES if any(p.state == state for p in found)]
    xs = sorted({p.cells for p in found})
    ys = sorted({p.stiffness for p in found})
    left, wide, gap = 0.075, 0.795, 0.018
    each = (wide - gap * (len(states) - 1)) / len(states)
    for k, state in enumerate(states):
        axes = figure.add_axes((left + k * (each + gap), _BASE, each, _TALL))
        _panel(axes, [p for p in found if p.state == state], xs, ys)
        axes.set_title(TITLES[state])
        axes.set_xlabel("Number of cells")
        if k == 0:
            axes.set_ylabel("Stiffness of the step, λΔt")
        else:
            axes.tick_params(labelleft=False)
    _scale(figure)
    _legend(figure, {x: seed_range(found, x) for x in xs})
    return figure


def _panel(axes: Any, found: Sequence[Point], xs: Sequence[int], ys: Sequence[float]) -> None:
    axes.set(xlim=(0, len(xs)), ylim=(0, len(ys)), facecolor="white")
    axes.set_xticks(np.arange(len(xs)) + 0.5, [power(x) for x in xs])
    axes.set_yticks(np.arange(len(ys)) + 0.5, [power(y) for y in ys])
    axes.grid(False)
    axes.tick_params(length=0)
    for p in found:
        i, j = xs.index(p.cells), ys.index(p.stiffness)
        known = math.isfinite(p.ratio) and not p.nullity
        colour = _COLOURS(_NORM(np.clip(p.ratio, 0.05, 20.0))) if known else _NULL
        axes.add_patch(Rectangle((i, j), 1, 1, facecolor=colour, edgecolor="white", linewidth=1.5))
        if p.ill > 0.5:
            axes.add_patch(Rectangle((i, j), 1, 1, fill=False, hatch="////", edgecolor=_HATCH,
                                     linewidth=0))  # fmt: skip
        _words(axes, p, i + 0.5, j + 0.5, colour)


def _words(axes: Any, p: Point, x: float, y: float, ground: Any) -> None:
    """Write the best method, its lead over the other kind and what null methods leave."""
    dark = np.dot(to_rgb(ground), [0.299, 0.587, 0.114]) < 0.5
    style: dict[str, Any] = {
        "ha": "center", "color": "white" if dark else INK,
        "path_effects": [withStroke(linewidth=3, foreground=ground)],  # no hatch through letters
    }  # fmt: skip
    name = p.best.replace("-adaptive", "*").replace("multirate", "multi") or "none"
    if p.nullity:
        name = "null"
    # names of methods of up to twelve letters fit into a tile
    size = 9.5 if len(name) < 10 else 8.0
    weight = "bold" if p.sure and not p.nullity else "normal"
    axes.text(x, y + 0.14, name, va="center", fontsize=size, weight=weight, **style)
    lead = "" if p.nullity else p.lead if p.sure or p.lead == "even" else f"{p.lead} ?"
    axes.text(x, y - 0.11, lead, va="center", fontsize=9, **style)
    axes.text(x, y - 0.35, f"null {_percent(p.null)}", va="center", fontsize=7.5, **style)


def _percent(error: float) -> str:
    return f"{100 * error:.0f} %" if error >= 0.0095 else f"{100 * error:.1g} %"


def _scale(figure: Figure) -> None:
    axes = figure.add_axes((0.893, _BASE, 0.014, _TALL))
    bar = figure.colorbar(ScalarMappable(_NORM, _COLOURS), cax=axes)
    bar.set_ticks([0.05, 0.1, 0.3, 1.0, 3.0, 10.0, 20.0],
                  labels=["20×", "10×", "3×", "equal", "3×", "10×", "20×"])  # fmt: skip
    bar.ax.minorticks_off()
    bar.outline.set_visible(False)
    bar.ax.tick_params(length=0)
    figure.text(0.878, _BASE + _TALL + 0.02, "implicit cheaper", fontsize=10, color="#004f7c",
                weight="bold")  # fmt: skip
    figure.text(0.878, _BASE - 0.035, "explicit cheaper", fontsize=10, color="#b35806",
                weight="bold")  # fmt: skip


def _legend(figure: Figure, seeds: dict[int, str]) -> None:
    handles = [
        Patch(facecolor=_NULL, label="a null method has this error"),
        Patch(facecolor="white", hatch="////", edgecolor=_HATCH, linewidth=0,
              label="ill-conditioned: a shift by a tenth of the error ends further off"),
        Patch(facecolor="white", edgecolor=_NULL, label="not computed"),
    ]  # fmt: skip
    figure.legend(handles=handles, loc="lower left", bbox_to_anchor=(0.065, 0.062), ncols=3,
                  fontsize=10.5, columnspacing=1.6, handlelength=1.8)  # fmt: skip
    counts = ", ".join(f"{count} for {power(n)} cells" for n, count in seeds.items())
    figure.text(
        0.075, 0.046, "In each tile the best method, its lead over the best of the other kind and "
        "the error of the best null method. Bold: the lead is significant over the seeds; ?: it is "
        "not.", fontsize=9.5, color=QUIET,
    )  # fmt: skip
    figure.text(0.075, 0.018, f"* adaptive. Seeds: {counts}", fontsize=9.5, color=QUIET)
