"""The picture of failures in moving tissue."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from multicell.comparison.stability_limits.failures import (
    COARSE,
    DAMPED,
    MAX_RATIO,
    MISSED,
    POCKET,
    SNAP,
)
from multicell.comparison.stability_limits.trial import BLOW_UP, STABLE, STALL, WRONG
from multicell.report.plots.style import INK, blank, styled

if TYPE_CHECKING:
    from multicell.comparison.base import Comparison

END_LETTERS: Final = {
    STABLE: "",
    POCKET: "p",
    BLOW_UP: "B",
    STALL: "S",
    DAMPED: "D",
    MISSED: "C",
    SNAP: "E",
    WRONG: "W",
    COARSE: "i",
}
"""Kind of end -> its letter in the map."""

_LEVELS: Final = (0.1, 1.0, MAX_RATIO, 30.0)  # of the ratio, at which the colour changes
_COLOURS: Final = ("#e3f1ea", "#b5dcc8", "#fff2cc", "#f3b25b", "#b3361e")


@styled
def failure_figure(result: Comparison) -> Figure:
    """Draw a line of squares for each method and state, one square a setting."""
    methods, states = result.methods, result.column("state")
    tall = max(0.3 * len(methods) + 3.1, 4.3)
    figure = blank(
        "How methods end coupling steps of real runs",
        "worst cell / effect of twelve shifts of the start; null: methods without mechanics",
        (11.0, tall),
    )
    left, bottom, gap = 0.15, 1.75 / tall, 0.012
    width = (0.835 - left) / len(states) + (0.15 - gap) / len(states)
    for k, state in enumerate(states):
        axes = figure.add_axes(
            (left + k * width, bottom, width - gap, 1.0 - 1.5 / tall - bottom), label=state
        )
        _draw_state(axes, result, state)
        axes.set_yticks(range(len(methods)), methods if k == 0 else [""] * len(methods))
    edges = [f"{level:g}" for level in _LEVELS]
    names = [f"up to {edges[0]}", *(f"to {e}" for e in edges[1:]), f"above {edges[-1]}"]
    handles = [Patch(color=c, label=name) for c, name in zip(_COLOURS, names, strict=True)]
    figure.legend(handles=handles, loc="lower left", bbox_to_anchor=(0.01, 0.0), fontsize=10)
    kinds = result.column("kind")
    said = [f"{letter}  {kind}" for kind, letter in END_LETTERS.items() if letter and kind in kinds]
    for k, text in enumerate(said):
        place = (0.27 + 0.36 * (k // 4), (1.15 - 0.26 * (k % 4)) / tall)
        figure.text(*place, text, fontsize=10, color=INK)
    return figure


def _draw_state(axes: Any, result: Comparison, state: str) -> None:
    """Draw the squares of one state; of a failure without an end they have the last colour."""
    null = max(row["null_ratio"] for row in result.with_values(state=state))
    axes.set_title("\nat ".join(state.split(" at ")) + f"\nnull: {null:.2g}", fontsize=9.5)
    most = max(len(result.with_values(state=state, method=m)) for m in result.methods)
    levels = np.full((len(result.methods), most), math.nan)
    for line, method in enumerate(result.methods):
        for place, row in enumerate(result.with_values(state=state, method=method)):
            levels[line, place] = np.searchsorted(_LEVELS, row["ratio"])  # NaN comes last
            letter = END_LETTERS[row["kind"]]
            dark = levels[line, place] >= len(_LEVELS)
            colour = "white" if dark else INK
            axes.text(place, line, letter, ha="center", va="center", fontsize=9.5, color=colour)
    axes.imshow(levels, ListedColormap(_COLOURS), vmin=-0.5, vmax=len(_LEVELS) + 0.5, aspect="auto")
    axes.set_xticks([0, most - 1], ["fine", "coarse"], fontsize=9.5)
    axes.grid(visible=False)
    axes.tick_params(length=0)
