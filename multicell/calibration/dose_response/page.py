"""The page of a dose response, and its pictures: curves with bands, maps of two drugs."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from matplotlib.colors import TwoSlopeNorm
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter

from multicell.calibration.dose_response.curve import DOSES, TOTALS, DoseCurve
from multicell.report.html import write_page
from multicell.report.plots.style import BLUE, INK, QUIET, RED, SIZE, save_figure, styled
from multicell.report.wording import written
from multicell.studies.picture_data import number_text, sentence, with_unit
from multicell.studies.pictures import with_heading

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from multicell.calibration.dose_response.numbers import DoseNumbers


def write_dose_report(result: DoseNumbers, folder: Path) -> Path:
    """Write ``report.html`` and the picture as PNG and SVG, and return the page."""
    drugs = " and ".join(curve.name for curve in result.curves)
    caption = (
        f"Viability: {result.response} relative to the control; points: means, dots: single runs "
        "or data, band: 95 % interval of the curve."
    )
    if result.combination:
        caption += (
            " Right: Bliss excess, above zero where fewer survive than if the drugs acted "
            "independently, and Loewe index, below one where doses do more together than added up; "
            "grey: beyond the doses tested of a drug alone; –: one drug alone never leaves so few "
            "alive; bold: the 95 % interval excludes 0 (or 1)."
        )
    tiles = {
        f"IC50, {curve.name}": curve.ic50.words.partition(" (95 %")[0] for curve in result.curves
    }
    if len(result.curves) == 1:
        tiles["slope h"] = f"{result.curve.slope.value:.3g}"
    tiles |= {TOTALS[name]: f"{entry.value:.3g}" for name, entry in result.totals.items()}
    tiles["replicates" if result.scene is None else "seeds"] = f"{result.replicates}"
    save_figure(draw(result), folder / "dose_response.svg")
    return write_page(
        folder / "report.html",
        "dose_response.html",
        scene=result.scene,
        title=f"{result.title}: dose response",
        subtitle=f"{result.response} over {drugs}",
        tiles=tiles,
        pictures={"dose_response.png": (partial(draw, result), caption)},
        result=result,
    )


_ROOM: Final = 3.0
"""Ratio of the lowest dose to the place of the control, over that of two neighbours on average."""
_MAX_TILES: Final = 8  # along a side of a map with numbers


@styled
def draw(result: DoseNumbers) -> Figure:
    """Draw responses, curves with bands and IC50; of combinations also both references."""
    kind = "replicates" if result.scene is None else "seeds"
    about = f"{result.replicates} {kind}" if result.replicates > 1 else f"one {kind[:-1]}"
    subtitle = f"{sentence(result.response)} relative to the control · {about} · band: 95 %"
    size = (SIZE[0], 10.2) if result.combination else SIZE
    figure = with_heading(f"{result.title}: dose response", subtitle, size)
    panels = figure.subplots(2, 2).ravel() if result.combination else [figure.subplots()]
    tops = [row["viability"] for row in result.table if np.isfinite(row["viability"])]
    high = 1.06 * max(1.05, *tops)
    for axes, drug in zip(panels, range(len(result.curves)), strict=False):
        _draw_curve(axes, result, drug)
        axes.set_ylim(min(0.0, 1.06 * min(tops)), high)
        axes.set_ylabel("viability (control = 1)")
    if result.combination:
        _draw_map(panels[2], result, "bliss_excess", "Bliss excess", 0.0)
        _draw_map(panels[3], result, "loewe_index", "Loewe index", 1.0)
    return figure


def _draw_curve(axes: Axes, result: DoseNumbers, drug: int) -> None:
    """Draw one drug alone, with the control beside the logarithmic axis."""
    curve = result.curves[drug]
    low, high = float(curve.doses[1]), float(curve.doses[-1])
    control = low / (high / low) ** (_ROOM / (_ROOM + len(curve.doses)))
    titles = DOSES[len(result.curves)]
    alone = [
        row
        for row in result.table
        if all(row[title] == 0.0 for k, title in enumerate(titles) if k != drug)
    ]
    x = np.array([row[titles[drug]] or control for row in alone])
    y = np.array([row["viability"] for row in alone])
    axes.plot(x, y, "o", color=BLUE, ms=4, alpha=0.35, mew=0, zorder=2)
    means = np.where(curve.doses > 0.0, curve.doses, control)
    axes.plot(means, curve.viability, "o", color=BLUE, ms=6.5, mec="white", mew=0.8, zorder=4)
    fine = np.geomspace(low, high, 200)
    if len(curve.draws):
        axes.fill_between(fine, *curve.band(fine), color=BLUE, alpha=0.16, lw=0, zorder=1)
    axes.plot(fine, curve(fine), color=BLUE, lw=2.0, zorder=3)
    _mark_half(axes, curve, control)
    axes.set_xscale("log")
    axes.set_xlim(control / (low / control) ** 0.35, high * (low / control) ** 0.25)
    axes.axvline(np.sqrt(low * control), color="#c3ccd3", lw=1.0, ls=(0, (2, 3)))
    decades = np.log10(high / low)
    shares = (1.0,) if decades > 4.0 else (1.0, 3.0) if decades > 1.5 else (1.0, 2.0, 5.0)
    ticks = [
        t
        for t in LogLocator(subs=shares, numticks=99).tick_values(low, high)
        if low / 1.001 <= t <= high * 1.001
    ]
    axes.xaxis.set_major_locator(FixedLocator([control, *(ticks or [low, high])]))
    axes.xaxis.set_major_formatter(
        FuncFormatter(lambda v, _: "control" if v < 0.99 * low else number_text(v))
    )
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.xaxis.set_minor_locator(FixedLocator([]))
    axes.set_xlabel(_label(curve))


def _label(curve: DoseCurve) -> str:
    return with_unit(curve.name, written(curve.unit).replace("uM", "µM"))


def _mark_half(axes: Axes, curve: DoseCurve, left: float) -> None:
    """Draw IC50 with its interval, or say that half is not reached."""
    half, reached = curve.ic50, np.isfinite(curve.ic50.value)
    words = f"IC50 {half.words}".replace("uM", "µM").replace(" (95 %", "\n(95 %")
    axes.axhline(0.5, color=QUIET, lw=0.9, ls=(0, (4, 3)), zorder=1)
    axes.annotate(
        words,
        (0.97, 0.95),
        xycoords="axes fraction",
        ha="right",
        va="top",
        fontsize=11,
        color=RED if reached else QUIET,
        linespacing=1.4,
    )
    if not reached:
        return
    axes.plot([half.value] * 2, [-9.0, 0.5], color=RED, lw=1.2, zorder=3)
    if np.isfinite(half.low):
        ends = np.clip([half.low, half.high], curve.doses[1], curve.doses[-1])
        axes.plot(ends, [0.5, 0.5], color=RED, lw=2.4, solid_capstyle="butt", zorder=5)
    axes.plot([half.value], [0.5], "D", color=RED, ms=6.5, mec="white", zorder=6)


def _draw_map(axes: Axes, result: DoseNumbers, name: str, title: str, neutral: float) -> None:
    """Draw a reference over both doses; blue is synergy, red antagonism."""
    rows = result.combination
    sides = [sorted({row[dose] for row in rows}) for dose in DOSES[2]]
    tiles = np.full((len(sides[1]), len(sides[0])), np.nan)
    places = [(sides[1].index(row["dose B"]), sides[0].index(row["dose A"])) for row in rows]
    for row, place in zip(rows, places, strict=True):
        if not (neutral and row["extrapolated"]):
            tiles[place] = row[name]
    shown = np.log2(tiles) if neutral else tiles
    known = np.abs(shown[np.isfinite(shown)])
    wide = max(0.1, float(known.max(initial=0.0)))
    norm = TwoSlopeNorm(0.0, -1.6 * wide, 1.6 * wide)
    colours = "RdBu_r" if neutral else "RdBu"
    axes.pcolormesh(np.ma.masked_invalid(shown), cmap=colours, norm=norm, edgecolors="white")
    many = max(len(side) for side in sides) > _MAX_TILES
    for row, (y, x) in zip(rows, places, strict=True) if not many else ():
        low, high = row[f"{name}_low"], row[f"{name}_high"]
        clear = low > neutral or high < neutral
        pale = bool(neutral and row["extrapolated"]) or not np.isfinite(row[name])
        how: dict[str, Any] = {
            "weight": "bold" if clear else "normal",
            "color": QUIET if pale else INK,
        }
        text = f"{round(row[name], 2) + 0.0:.2f}" if np.isfinite(row[name]) else "–"
        axes.text(x + 0.5, y + 0.5, text, ha="center", va="center", fontsize=11, **how)
    for axis, side, curve in zip((axes.xaxis, axes.yaxis), sides, result.curves, strict=True):
        stride = -(-len(side) // 10)
        axis.set_ticks(
            [k + 0.5 for k in range(0, len(side), stride)], [number_text(v) for v in side[::stride]]
        )
        axis.set_label_text(_label(curve))
    axes.grid(False)
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0)
    axes.set_title(f"{title}: blue {'below 1' if neutral else 'above 0'}, synergy", fontsize=11.5)
