"""The phase diagram as one picture: three states of tissue, who wins where, and by how much."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from matplotlib.patheffects import withStroke
from phase_tables import Point, crossing, points

from multicell.comparison.files import Row
from multicell.report.plots.style import INK, QUIET, blank, styled

TITLES: Final = {"rest": "At rest, strained", "growing": "Growing", "divided": "Freshly divided"}
# Okabe & Ito's orange and blue, which differ in lightness too, with a pale middle
_COLOURS: Final = LinearSegmentedColormap.from_list(
    "cheaper", ["#b35806", "#e69f00", "#fbe6bd", "#f7f7f7", "#c9e1f2", "#4a9fd4", "#004f7c"]
)
_MOST: Final = 20.0  # ratio at which the colours end
_SIZE: Final = (13.0, 6.4)
_HATCH: Final = "#b4bec6"
_SHORT: Final = {"ab2-adaptive": "ab2", "backward-euler": "b-euler"}


@styled
def draw(rows: Sequence[Row], accuracy: float) -> Figure:
    """Return the picture of all tiles at an accuracy, in mean radii."""
    found = points(rows, accuracy)
    seeds = max((p.ratio.samples for p in found), default=0)
    figure = blank(
        "Implicit or explicit?",
        f"Cheapest method for an error of {100 * accuracy:g} % of a radius over one coupling "
        f"step; up to {seeds} seeds, one thread, all costs counted",
        _SIZE,
    )
    states = [state for state in TITLES if any(p.state == state for p in found)]
    xs = sorted({p.cells for p in found})
    ys = sorted({p.stiffness for p in found})
    left, wide, gap = 0.075, 0.795, 0.018
    each = (wide - gap * (len(states) - 1)) / len(states)
    for k, state in enumerate(states):
        axes = figure.add_axes((left + k * (each + gap), 0.20, each, 0.59))
        _panel(axes, [p for p in found if p.state == state], xs, ys)
        _line(axes, rows, accuracy, state, xs, ys)
        axes.set_title(TITLES[state])
        axes.set_xlabel("Number of cells")
        if k == 0:
            axes.set_ylabel("Stiffness of the step, λΔt")
        else:
            axes.tick_params(labelleft=False)
    _scale(figure)
    _legend(figure)
    return figure


def _edges(values: Sequence[float]) -> np.ndarray:
    """Return the borders of tiles round values on a logarithmic axis."""
    logs = np.log10(values)
    if len(logs) == 1:
        return np.asarray(10.0 ** (logs[0] + np.array([-0.5, 0.5])))
    middles = 0.5 * (logs[1:] + logs[:-1])
    ends = (2.0 * logs[0] - middles[0], 2.0 * logs[-1] - middles[-1])
    return np.asarray(10.0 ** np.concatenate([[ends[0]], middles, [ends[1]]]))


def _panel(axes: Any, found: Sequence[Point], xs: Sequence[int], ys: Sequence[float]) -> None:
    """Draw the tiles of a state."""
    x, y = _edges(xs), _edges(ys)
    axes.set(xscale="log", yscale="log", xlim=(x[0], x[-1]), ylim=(y[0], y[-1]))
    axes.set_xticks(xs, [_power(x) for x in xs])
    axes.set_yticks(ys, [_power(y) for y in ys])
    axes.minorticks_off()
    axes.grid(False)
    axes.tick_params(length=0)
    axes.set_facecolor("#eef1f3")
    norm = _norm()
    for p in found:
        i, j = xs.index(p.cells), ys.index(p.stiffness)
        known = math.isfinite(p.ratio.value)
        colour = _COLOURS(norm(np.clip(p.ratio.value, 1.0 / _MOST, _MOST))) if known else "#d3d9de"
        place = (x[i], y[j], x[i + 1] - x[i], y[j + 1] - y[j])
        axes.add_patch(_tile(place, facecolor=colour, edgecolor="white", linewidth=1.5))
        if p.ill > 0.5:
            axes.add_patch(_tile(place, fill=False, hatch="////", edgecolor=_HATCH, linewidth=0))
        _words(axes, p, xs[i], ys[j], _dark(colour))


def _power(value: float) -> str:
    """Return for example ``10⁴``: the style reads no formulas."""
    exponent = round(math.log10(value))
    if not math.isclose(value, 10.0**exponent):
        return f"{value:.2g}"
    return "10" + "".join("⁰¹²³⁴⁵⁶⁷⁸⁹"[int(digit)] for digit in str(exponent))


def _tile(place: tuple[float, ...], **looks: Any) -> Rectangle:
    return Rectangle(place[:2], place[2], place[3], **looks)


def _dark(colour: Any) -> bool:
    from matplotlib.colors import to_rgb

    return bool(np.dot(to_rgb(colour), [0.299, 0.587, 0.114]) < 0.5)


def _words(axes: Any, point: Point, x: float, y: float, dark: bool) -> None:
    """Write the best method and its lead into a tile; in plain type where that is open."""
    ink = "white" if dark else INK
    sure = point.verdict != "open"
    name = _SHORT.get(point.best, point.best) or "none"
    # a rim of the other lightness: the line of equal cost may pass behind
    rim = [withStroke(linewidth=2.2, foreground=INK if dark else "white", alpha=0.75)]
    axes.text(x, y * 1.13, name, ha="center", va="bottom", fontsize=9.5, color=ink, zorder=6,
              path_effects=rim, weight="bold" if sure else "normal")  # fmt: skip
    if math.isfinite(point.ratio.value):
        lead = max(point.ratio.value, 1.0 / point.ratio.value)
        sign = "≥" if point.bound else ""
        text = f"{sign}{lead:.2g}×" if lead < 10.0 else f"{sign}{lead:.0f}×"
        axes.text(x, y / 1.13, text if sure else f"{text} ?", ha="center", va="top", fontsize=9,
                  color=ink, zorder=6, path_effects=rim)  # fmt: skip


def _line(
    axes: Any,
    rows: Sequence[Row],
    accuracy: float,
    state: str,
    xs: Sequence[int],
    ys: Sequence[float],
) -> None:
    """Draw the stiffness above which implicit methods are cheaper, with its interval."""
    low, tops = _edges(ys)[0], _edges(ys)[1:]
    known_to = {
        x: max(r["stiffness"] for r in rows if (r["state"], r["cells"]) == (state, x))
        for x in {int(r["cells"]) for r in rows if r["state"] == state}
    }
    known = [(x, crossing(rows, accuracy, state, x)) for x in xs]
    places = [(x, c) for x, c in known if c is not None and not math.isnan(c.value)]
    if not places:
        return
    at = np.array([x for x, _ in places], dtype=float)
    # what lies beyond the tiles that were tried ends at their border
    high = np.array([tops[ys.index(known_to[x])] for x, _ in places])
    value, lower, upper = (
        np.clip([getattr(c, name) for _, c in places], low, high)
        for name in ("value", "low", "high")
    )
    axes.fill_between(at, lower, upper, color=INK, alpha=0.14, linewidth=0, zorder=2)
    axes.plot(at, value, color=INK, linewidth=2.0, zorder=3)
    within = (value > low) & (value < high)
    axes.plot(at[within], value[within], "o", color=INK, markersize=4, zorder=3)


def _norm() -> LogNorm:
    return LogNorm(1.0 / _MOST, _MOST)


def _scale(figure: Figure) -> None:
    """Draw the scale of colours."""
    from matplotlib.cm import ScalarMappable

    axes = figure.add_axes((0.893, 0.20, 0.014, 0.59))
    bar = figure.colorbar(ScalarMappable(_norm(), _COLOURS), cax=axes)
    ticks = [0.05, 0.1, 0.3, 1.0, 3.0, 10.0, 20.0]
    bar.set_ticks(ticks, labels=["20×", "10×", "3×", "equal", "3×", "10×", "20×"])
    bar.ax.minorticks_off()
    bar.outline.set_visible(False)
    bar.ax.tick_params(length=0)
    figure.text(0.878, 0.815, "implicit cheaper", fontsize=10, color="#004f7c", weight="bold")
    figure.text(0.878, 0.165, "explicit cheaper", fontsize=10, color="#b35806", weight="bold")


def _legend(figure: Figure) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=INK, linewidth=2.0, marker="o", markersize=4, label="equal cost"),
        Patch(color=INK, alpha=0.14, linewidth=0, label="its 95 % interval"),
        Patch(facecolor="white", hatch="////", edgecolor=_HATCH, linewidth=0,
              label="ill-conditioned for single cells: judged by observables"),
        Patch(facecolor="#d3d9de", label="not measured, or reached by no method"),
    ]  # fmt: skip
    figure.legend(handles=handles, loc="lower left", bbox_to_anchor=(0.065, 0.045), ncols=4,
                  fontsize=10.5, columnspacing=1.6, handlelength=1.8)  # fmt: skip
    figure.text(
        0.075, 0.03, "In each tile the best method and its lead over the other kind; bold: "
        "the lead is significant over the seeds; ?: it is not. Without a dot the line lies beyond "
        "what was tried",
        fontsize=10, color=QUIET,
    )  # fmt: skip
