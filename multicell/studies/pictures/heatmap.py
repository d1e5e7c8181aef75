"""Heat maps: an observable over two axes of a study, with its scatter over the seeds."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.colors import Normalize, to_rgb
from matplotlib.ticker import FuncFormatter

from multicell.report.plots.colour_vision import luminance
from multicell.report.plots.style import DPI, INK, QUIET, RED, SIZE, blank, styled
from multicell.studies.pictures.values import (
    DONE,
    SEED,
    Scale,
    Statistics,
    at_end,
    at_point,
    axes_of,
    axis_named,
    compact,
    is_sampled,
    label,
    label_with,
    middle,
    number_text,
    point_text,
    power,
    scale,
    scatter_text,
    sentence,
    states,
    statistics,
    words,
)

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from multicell.cells import FloatArray

MOST_PANELS: Final = 6
_LEAST_FONT: Final = 6.5  # points; smaller numbers cannot be read
_LETTER: Final = 0.62  # width of a digit over its height
_EMPTY, _FAILED = "#eceff2", "#f6dfd9"
_COLOURS: Final = "viridis"


@styled
def heatmap(
    table: xr.Dataset, title: str, name: str,
    x: str | None = None, y: str | None = None, at: Mapping[str, Any] | None = None,
) -> Figure:  # fmt: skip
    """Draw the mean of an observable over two axes, one tile for each pair of values.

    Each tile tells mean and standard deviation over the seeds, and how many seeds there are where
    some failed or have not run. A third axis makes panels; further ones are held.

    Parameters
    ----------
    table
        Of the study, a grid.
    title
        Of the picture.
    name
        Of the observable; its values at the end of each run are shown.
    x, y
        Axes of the map, by default the first two; of a study of one axis the map has one row.
    at
        Axis -> value for axes that are held, by default their middle value.

    Raises
    ------
    SceneError
        For an unknown observable or axis.
    ValueError
        If the design is sampled or varies nothing: there are no tiles.
    """
    if is_sampled(table):
        raise ValueError("a sampled design has no tiles: draw the response over each axis")
    if not axes_of(table):
        raise ValueError("nothing is varied: there are no axes to draw over")
    table = compact(table)
    across, up, third, held = arranged(table, x, y, at or {})
    part = at_point(table, held)
    shown = _shown(part, third)
    values = at_end(part, name)
    factor, told = power(values.values)
    known = statistics(values / factor)
    subtitle = _subtitle(table, name, held, part.sizes[SEED])
    if third is not None and len(shown) < part.sizes[third]:
        subtitle += f"; {len(shown)} of {part.sizes[third]} values of {words(third)}"
    sides, log = (scale(part, across), None if up is None else scale(part, up)), _runs(part)
    rows = -(-len(shown) // 3)
    columns = min(len(shown), 3)
    size = (SIZE[0], _height(sides[1], rows))
    figure = laid_out(title, subtitle, size)
    grid = figure.subplots(rows, columns, squeeze=False, sharey=True)
    norm = _norm(known.mean.values)
    font = _font(size, sides, columns, rows, _longest(known))
    for place, axes in enumerate(grid.flat):
        if place >= len(shown):
            axes.set_axis_off()
            continue
        chosen = {} if third is None else {third: shown[place]}
        tiles = Statistics(*(entry.isel(chosen) for entry in known))
        _draw(axes, tiles, log.isel(chosen), sides, norm, font)
        if place % columns:
            axes.set_ylabel("")
        if third is not None:
            heading = point_text(part, {third: part[third].values[shown[place]]})
            axes.set_title(textwrap.fill(heading, int(84 / columns)), fontsize=10.5)
    if not font:
        figure.text(0.04, 0.02, _scatter_note(known), fontsize=10, color=QUIET)
    mappable = mpl.cm.ScalarMappable(norm, mpl.colormaps[_COLOURS])
    bar = figure.colorbar(mappable, ax=grid, shrink=0.9, aspect=26, pad=0.02)
    bar.outline.set_visible(False)
    bar.ax.grid(False)
    bar.set_label(label_with(label(table, name), told))
    counts = FuncFormatter(lambda value, _: f"{value:,.6g}")
    bar.ax.yaxis.set_major_formatter(counts)
    return figure


def arranged(
    table: xr.Dataset, x: str | None, y: str | None, at: Mapping[str, Any]
) -> tuple[str, str | None, str | None, dict[str, Any]]:
    """Return the axes across, up and of the panels, and the values of those that are held."""
    names = axes_of(table)
    taken = [axis_named(table, name) for name in (x, y) if name is not None]
    for name in at:
        axis_named(table, name)
    free = [name for name in names if name not in taken and name not in at]
    across = x if x is not None else free.pop(0)
    up = y if y is not None else (free.pop(0) if free else None)
    third = free.pop(0) if free else None
    return across, up, third, middle(table, free) | dict(at)


def _shown(table: xr.Dataset, third: str | None) -> list[int]:
    """Return the places along the third axis that have a panel: all, or some, evenly."""
    if third is None:
        return [0]
    return spread(table.sizes[third], MOST_PANELS)


def spread(count: int, most: int) -> list[int]:
    """Return at most so many places of ``count``, evenly, the first and last among them."""
    return sorted({round(place) for place in np.linspace(0, count - 1, min(count, most))})


def _subtitle(table: xr.Dataset, name: str, held: Mapping[str, Any], seeds: int) -> str:
    over = f"mean ± standard deviation over {seeds} seeds" if seeds > 1 else (
        "one seed: the scatter is unknown"
    )  # fmt: skip
    told = f"{sentence(words(name))} at the end of each run, {over}"
    return f"{told}; {point_text(table, held)}" if held else told


def laid_out(title: str, subtitle: str, size: tuple[float, float]) -> Figure:
    """Return a figure whose panels find their own margins below the heading."""
    figure = blank(title, subtitle, size)
    figure.set_layout_engine(
        "constrained", rect=(0.03, 0.05, 0.94, 1.0 - 0.85 / size[1] - 0.05), w_pad=0.13, h_pad=0.08
    )
    figure.set_dpi(DPI)
    return figure


def _norm(values: FloatArray) -> Normalize:
    """Return the range of the colours, which has a width even for one value."""
    known = values[np.isfinite(values)]
    if not known.size:
        return Normalize(0.0, 1.0)
    low, high = float(known.min()), float(known.max())
    room = 0.0 if high > low else (0.05 * abs(low) or 1.0)
    return Normalize(low - room, high + room)


def _runs(table: xr.Dataset) -> xr.DataArray:
    return states(table)


def _height(up: Scale | None, rows: int) -> float:
    """Return the height of the figure in inches."""
    if rows > 1:
        return 0.9 + 4.2 * rows
    return 3.4 if up is None else max(SIZE[1], 1.7 + 0.3 * len(up.texts))


def _font(
    size: tuple[float, float], sides: tuple[Scale, Scale | None], columns: int, rows: int,
    letters: int,
) -> float:  # fmt: skip
    """Return the size of letters that fit a tile, in points, 12 at most; 0 if none can be read."""
    across, up = sides
    wide = (0.8 * size[0] - 0.4 * columns) / columns / len(across.texts)
    high = (0.8 * size[1] - 0.7 * rows) / rows / (len(up.texts) if up is not None else 1)
    fits = min(12.0, 72.0 * wide / (letters * _LETTER), 72.0 * high / (3.0 * 1.3))
    return fits if fits >= _LEAST_FONT else 0.0


def _longest(known: Statistics) -> int:
    """Return the number of letters of the longest text of a tile, with a little margin."""
    pairs = zip(known.mean.values.flat, known.sd.values.flat, strict=True)
    texts = [text for mean, sd in pairs for text in scatter_text(float(mean), float(sd))]
    return 2 + max(6, *map(len, texts))


def _scatter_note(known: Statistics) -> str:
    """Return what is said of the scatter where tiles are too small for numbers."""
    sd = known.sd.values[np.isfinite(known.sd.values)]
    if not sd.size:
        return "Tiles are too small for numbers."
    return (
        "Tiles are too small for numbers. Standard deviation over the seeds: "
        f"{number_text(float(np.median(sd)), 2)} in the median tile, "
        f"{number_text(float(sd.max()), 2)} at most."
    )


def _draw(
    axes: Axes, tiles: Statistics, runs: xr.DataArray, sides: tuple[Scale, Scale | None],
    norm: Normalize, font: float,
) -> None:  # fmt: skip
    """Draw one map; ``font`` is the size of the numbers in its tiles, 0 for none."""
    across, up = sides
    order = [across.name] if up is None else [up.name, across.name]
    grids = [np.atleast_2d(entry.transpose(*order).values) for entry in tiles]
    log = np.atleast_3d(runs.transpose(*order, SEED).values)
    log = log.reshape((*grids[0].shape, -1))
    colours = mpl.colormaps[_COLOURS]
    axes.set_facecolor(_EMPTY)
    axes.pcolormesh(np.ma.masked_invalid(grids[0]), cmap=colours, norm=norm, edgecolors="white")
    for place in np.ndindex(*grids[0].shape):
        mean, sd, count = (float(grid[place]) for grid in grids)
        text, small = _tile_text(mean, sd, int(count), log[place])
        if not np.isfinite(mean):
            face = _FAILED if "failed" in text else _EMPTY
            corner = (place[1], place[0])
            axes.add_patch(mpl.patches.Rectangle(corner, 1, 1, facecolor=face, edgecolor="white"))
        if font:
            ink = _ink(colours(norm(mean))) if np.isfinite(mean) else _told_ink(text)
            _write(axes, place, text, small, ink, font)
    axes.grid(False)
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0)
    _ticks(axes.xaxis, across)
    axes.set_xlabel(across.label)
    if up is None:
        axes.set_yticks([])
    else:
        _ticks(axes.yaxis, up)
        axes.set_ylabel(up.label)


def _tile_text(mean: float, sd: float, count: int, runs: Any) -> tuple[str, str]:
    """Return what a tile tells: the number with its scatter, and what is missing from it."""
    total, failed = len(runs), int((runs == "failed").sum())
    if count:
        main, scatter = scatter_text(mean, sd)
        lacking = f"{count} of {total} seeds" if count < total else ""
        return main, "\n".join(line for line in (scatter, lacking) if line)
    if (runs == DONE).any():
        return "none", ""
    if failed:
        return "failed", "" if failed == total else f"{failed} of {total} seeds"
    return ("running" if (runs == "running").any() else "not run"), ""


def _told_ink(text: str) -> str:
    return RED if text == "failed" else QUIET


def _ink(colour: Any) -> str:
    """Return the colour of text that stands out more against a tile: dark or white.

    Contrast is the ratio of relative luminances, each with 0.05 added (WCAG 2).
    """
    own = luminance(colour)
    dark = (own + 0.05) / (luminance(to_rgb(INK)) + 0.05)
    return INK if dark > 1.05 / (own + 0.05) else "white"


def _write(
    axes: Axes, place: tuple[int, ...], text: str, small: str, ink: str, font: float
) -> None:
    x, y = place[1] + 0.5, place[0] + 0.5
    style: dict[str, Any] = {"ha": "center", "color": ink, "parse_math": False}
    if not small:
        axes.text(x, y, text, va="center", fontsize=font, weight="bold", **style)
        return
    axes.annotate(
        text, (x, y), (0, 0.15 * font), textcoords="offset points", va="bottom", fontsize=font,
        weight="bold", **style,
    )  # fmt: skip
    axes.annotate(
        small, (x, y), (0, -0.1 * font), textcoords="offset points", va="top",
        fontsize=0.8 * font, linespacing=1.1, **style,
    )  # fmt: skip


def _ticks(axis: Any, side: Scale) -> None:
    """Name the tiles along a side, every second or third where there are many."""
    every = -(-len(side.texts) // 12)
    places = range(0, len(side.texts), every)
    texts = [textwrap.shorten(side.texts[place], 16, placeholder="…") for place in places]
    axis.set_ticks([place + 0.5 for place in places], texts)
