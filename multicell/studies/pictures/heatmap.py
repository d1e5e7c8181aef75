"""Heat maps: an observable over two axes of a study, with its scatter over the seeds."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.colors import Normalize, to_rgb

from multicell.report.plots.colour_vision import luminance
from multicell.report.plots.style import INK, QUIET, RED, SIZE, styled
from multicell.studies.pictures import values as of
from multicell.studies.pictures.layout import panels, spread, write_plainly

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from multicell.cells import FloatArray

_MAX_PANELS: Final = 6
_MIN_FONT: Final = 6.5  # points; smaller numbers cannot be read
_EMPTY, _FAILED = "#eceff2", "#f6dfd9"
_COLOURS: Final = "viridis"


@styled
def heatmap(
    table: xr.Dataset, title: str, name: str,
    x: str | None = None, y: str | None = None, at: Mapping[str, Any] | None = None,
) -> Figure:  # fmt: skip
    """Draw what :meth:`multicell.studies.plots.StudyPlots.heatmap` describes."""
    if of.is_sampled(table):
        raise ValueError("a sampled design has no tiles: draw the response over each axis")
    if not of.axes_of(table):
        raise ValueError("nothing is varied: there are no axes to draw over")
    table = of.compact(table)
    across, up, third, fixed = arrange(table, x, y, at or {})
    part = of.at_point(table, fixed)
    shown = [0] if third is None else spread(part.sizes[third], _MAX_PANELS)
    known = of.statistics(of.at_end(part, name))
    sides = of.scale(part, across), None if up is None else of.scale(part, up)
    subtitle = _subtitle(table, name, fixed)
    if third is not None and len(shown) < part.sizes[third]:
        subtitle += f"; {len(shown)} of {part.sizes[third]} values of {of.words(third)}"
    columns, rows = min(len(shown), 3), -(-len(shown) // 3)
    one_row = 3.4 if sides[1] is None else max(SIZE[1], 1.7 + 0.3 * len(sides[1].texts))
    height = 0.9 + 4.2 * rows if rows > 1 else one_row
    figure, grid = panels(title, subtitle, len(shown), columns, height, sharey=True)
    norm = _norm(known.mean.values)
    font = _font(sides, columns)
    for number, (axes, place) in enumerate(zip(grid, shown, strict=True)):
        chosen = {} if third is None else {third: place}
        tiles = of.Statistics(*(entry.isel(chosen) for entry in known))
        _draw(axes, tiles, part[of.STATE].isel(chosen), sides, norm, font)
        if number % columns:
            axes.set_ylabel("")
        if third is not None:
            heading = of.point_text(part, {third: part[third].values[place]})
            axes.set_title(textwrap.fill(heading, int(84 / columns)), fontsize=10.5)
    if not font:
        figure.text(0.04, 0.02, _scatter_note(known), fontsize=10, color=QUIET)
    mappable = mpl.cm.ScalarMappable(norm, mpl.colormaps[_COLOURS])
    bar = figure.colorbar(mappable, ax=grid, shrink=0.9, aspect=26, pad=0.02)
    bar.outline.set_visible(False)
    bar.ax.grid(False)
    bar.set_label(of.label(table, name))
    write_plainly(bar.ax.yaxis)
    return figure


def arrange(
    table: xr.Dataset, x: str | None, y: str | None, at: Mapping[str, Any]
) -> tuple[str, str | None, str | None, dict[str, Any]]:
    """Return the axes across, up and of the panels, and the values of those that are fixed."""
    taken = [of.axis_named(table, name) for name in (x, y, *at) if name is not None]
    free = [name for name in of.axes_of(table) if name not in taken]
    across = x if x is not None else free.pop(0)
    up = y if y is not None else (free.pop(0) if free else None)
    third = free.pop(0) if free else None
    return across, up, third, of.middle(table, free) | dict(at)


def _subtitle(table: xr.Dataset, name: str, fixed: Mapping[str, Any]) -> str:
    seeds = table.sizes[of.SEED]
    over = f"mean ± standard deviation over {seeds} seeds" if seeds > 1 else (
        "one seed: the scatter is unknown"
    )  # fmt: skip
    text = f"{of.sentence(of.words(name))} at the end of each run, {over}"
    return f"{text}; {of.point_text(table, fixed)}" if fixed else text


def _norm(values: FloatArray) -> Normalize:
    """Return the range of the colours, which has a width even for one value."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    room = 0.0 if high > low else (0.05 * abs(low) or 1.0)
    return Normalize(low - room, high + room)


def _font(sides: tuple[of.Scale, of.Scale | None], columns: int) -> float:
    """Return the size of numbers that fit the tiles of maps side by side, points; 0 for none."""
    across, up = sides
    tiles = max(len(across.texts) * columns, 0 if up is None else len(up.texts))
    size = min(12.0, 84.0 / tiles)
    return size if size >= _MIN_FONT else 0.0


def _scatter_note(known: of.Statistics) -> str:
    """Return what is said of the scatter where tiles are too small for numbers."""
    sd = known.sd.values[np.isfinite(known.sd.values)]
    note = "Tiles are too small for numbers."
    if not sd.size:
        return note
    middle, most = (of.number_text(float(value), 2) for value in (np.median(sd), sd.max()))
    return f"{note} Standard deviation over the seeds: {middle} in the median tile, {most} at most."


def _draw(
    axes: Axes, tiles: of.Statistics, states: xr.DataArray, sides: tuple[of.Scale, of.Scale | None],
    norm: Normalize, font: float,
) -> None:  # fmt: skip
    """Draw one map; ``font`` is the size of the numbers in its tiles, 0 for none."""
    across, up = sides
    order = [across.name] if up is None else [up.name, across.name]
    mean, sd, number = (np.atleast_2d(entry.transpose(*order).values) for entry in tiles)
    runs = states.transpose(*order, of.SEED).values.reshape((*mean.shape, -1))
    failed = (runs == "failed").any(axis=-1) & ~(runs == of.DONE).any(axis=-1)
    colours = mpl.colormaps[_COLOURS]
    # what has no mean is grey, or red where it failed
    axes.pcolormesh(failed, cmap=mpl.colors.ListedColormap([_EMPTY, _FAILED]), vmin=0, vmax=1,
                    edgecolors="white")  # fmt: skip
    axes.pcolormesh(np.ma.masked_invalid(mean), cmap=colours, norm=norm, edgecolors="white")
    for place in np.ndindex(*mean.shape) if font else ():
        there = bool(np.isfinite(mean[place]))
        text = _tile_text(float(mean[place]), float(sd[place]), int(number[place]), runs[place])
        missing = RED if text.startswith("failed") else QUIET
        axes.text(
            place[1] + 0.5, place[0] + 0.5, text, ha="center", va="center", fontsize=font,
            color=_ink(colours(norm(mean[place]))) if there else missing, weight="bold",
            linespacing=1.2, parse_math=False,
        )  # fmt: skip
    axes.grid(False)
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0)
    _name_tiles(axes.xaxis, across)
    axes.set_xlabel(across.label)
    if up is None:
        axes.set_yticks([])
    else:
        _name_tiles(axes.yaxis, up)
        axes.set_ylabel(up.label)


def _tile_text(mean: float, sd: float, count: int, runs: Any) -> str:
    """Return what a tile states: the number with its scatter, and what is missing from it."""
    total, failed = len(runs), int((runs == "failed").sum())
    if count:
        lacking = f"{count} of {total} seeds" if count < total else ""
        return "\n".join(line for line in (*of.scatter_text(mean, sd), lacking) if line)
    if (runs == of.DONE).any():
        return "none"
    if failed:
        return "failed" if failed == total else f"failed\n{failed} of {total} seeds"
    return "running" if (runs == "running").any() else "not run"


def _ink(colour: Any) -> str:
    """Return the colour of text that stands out more against a tile: dark or white.

    Contrast is the ratio of relative luminances, each with 0.05 added (WCAG 2).
    """
    own = luminance(colour)
    dark = (own + 0.05) / (luminance(to_rgb(INK)) + 0.05)
    return INK if dark > 1.05 / (own + 0.05) else "white"


def _name_tiles(axis: Any, side: of.Scale) -> None:
    """Name the tiles along a side, every second or third where there are many."""
    places = range(0, len(side.texts), -(-len(side.texts) // 12))
    texts = [textwrap.shorten(side.texts[place], 16, placeholder="…") for place in places]
    axis.set_ticks([place + 0.5 for place in places], texts)
