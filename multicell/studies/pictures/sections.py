"""Sections side by side: the last frames of one seed over two axes of a study, on one scale."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from multicell.errors import MulticellError, SceneError
from multicell.report.plots.section import (
    Cut,
    cut,
    draw_circles,
    frame_window,
)
from multicell.report.plots.style import INK, QUIET, RED, SIZE, blank, styled, type_label
from multicell.report.wording import cell_count, time_unit
from multicell.results.observables import uniform_radius
from multicell.studies.pictures.heatmap import arranged, spread
from multicell.studies.pictures.values import (
    POINT,
    SEED,
    Places,
    Scale,
    axes_of,
    compact,
    is_sampled,
    middle,
    nearest,
    point_text,
    scale,
    sides_of,
)

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

    from multicell.results.frame import Frame
    from multicell.scene.scene import Scene
    from multicell.studies.runs import Run
    from multicell.studies.status import RunStatus

_LENGTHS: Final = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000)  # µm
_MOST: Final = 6  # tiles in a row or column
_SAMPLE: Final = 8  # tiles of a sample
_RIGHT, _TOP, _FOOT, _GAP = 0.35, 1.3, 0.45, 0.06  # inches


class _Tile(NamedTuple):
    """What one tile shows: a section, or words in its place."""

    section: Cut | None
    size: float
    words: str
    failed: bool = False


@styled
def sections(
    table: xr.Dataset, title: str, runs: Sequence[Run], states: Sequence[RunStatus], folder: Path,
    x: str | None = None, y: str | None = None, seed: int | None = None,
    at: Mapping[str, Any] | None = None,
) -> Figure:  # fmt: skip
    """Draw the last frame of each run of one seed as a section, all on one scale.

    Parameters
    ----------
    table
        Of the study.
    title
        Of the picture.
    runs, states
        All runs and how they stand.
    folder
        Of the study.
    x, y
        Axes of the tiles, by default the first two; further ones are held. A sample shows some
        of its points, in the order of the first axis.
    seed
        By default the first one.
    at
        Axis -> value for axes that are held, by default their middle value.

    Raises
    ------
    SceneError
        For an unknown axis or value.
    """
    table = compact(table)
    seeds = [int(value) for value in table[SEED].values]
    chosen = seeds[0] if seed is None else int(seed)
    if chosen not in seeds:
        told = f"Its seeds are {seeds[0]} to {seeds[-1]}."
        raise SceneError("seed", f"is {chosen}, which is none of the study", told)
    points, sides, told = _sample(table) if is_sampled(table) else _grid(table, x, y, at or {})
    known = {state.name: state for state in states}
    whereabouts = Places(table)
    there = {whereabouts.of(run.coordinates): run for run in runs}
    places = [
        [None if point is None else (*point, seeds.index(chosen)) for point in row]
        for row in points
    ]
    tiles = [
        [_Tile(None, 0.0, "") if p is None else _tile(there.get(p), known, folder) for p in row]
        for row in places
    ]
    return _drawn(title, f"last frames of seed {chosen}, all on one scale{told}", tiles, sides)


Points = list[list[tuple[int, ...] | None]]
"""Places in an array over the axes, row by row; None for a tile that stays empty."""

Sides = tuple[str, list[str], str, list[str], list[list[str]]]
"""Label and texts across, label and texts up, and a heading of each tile."""


def _grid(
    table: xr.Dataset, x: str | None, y: str | None, at: Mapping[str, Any]
) -> tuple[Points, Sides, str]:
    """Return the points of a grid, the highest value of the second axis on top, and the labels."""
    dimensions = sides_of(table)[:-1]
    if not axes_of(table):
        return [[(0,) * len(dimensions)]], ("", [""], "", [""], [[""]]), ""
    across, up, third, held = arranged(table, x, y, at)
    if third is not None:
        held = held | middle(table, [third])
    told = f"; {point_text(table, held)}" if held else ""
    columns = spread(table.sizes[across], _MOST)
    rows = [0] if up is None else spread(table.sizes[up], _MOST)[::-1]
    if len(columns) < table.sizes[across] or (up is not None and len(rows) < table.sizes[up]):
        told += "; not all values"
    base = {name: nearest(table, name, value) for name, value in held.items()}
    points: Points = []
    for r in rows:
        own = base if up is None else base | {up: r}
        points.append([
            tuple((own | {across: k}).get(name, 0) for name in dimensions) for k in columns
        ])  # fmt: skip
    second = None if up is None else scale(table, up)
    headings = [["" for _ in columns] for _ in rows]
    return points, _sides(scale(table, across), columns, second, rows, headings), told


def _sides(
    side: Scale, columns: list[int], second: Scale | None, rows: list[int],
    headings: list[list[str]],
) -> Sides:  # fmt: skip
    label, texts = ("", [""]) if second is None else (second.label, [second.texts[r] for r in rows])
    return side.label, [side.texts[k] for k in columns], label, texts, headings


def _sample(table: xr.Dataset) -> tuple[Points, Sides, str]:
    """Return some points of a sample, in the order of its first axis, four in a row."""
    names = axes_of(table)
    order = np.argsort(table[names[0]].values, kind="stable")
    places = [int(order[k]) for k in spread(table.sizes[POINT], _SAMPLE)]
    found: list[tuple[int, ...] | None] = [(place,) for place in places]
    texts = [
        point_text(table, {name: table[name].values[place] for name in names[:3]})
        for place in places
    ]
    wide = min(4, len(found))
    found += [None] * (-len(found) % wide)
    texts += [""] * (len(found) - len(texts))
    rows = [found[k : k + wide] for k in range(0, len(found), wide)]
    headings = [texts[k : k + wide] for k in range(0, len(texts), wide)]
    told = f"; {len(places)} of {table.sizes[POINT]} points, in the order of their first value"
    return rows, ("", [""] * wide, "", [""] * len(rows), headings), told


def _tile(run: Run | None, states: Mapping[str, RunStatus], folder: Path) -> _Tile:
    """Return the section of a run, or why there is none."""
    from multicell.studies.status import run_folder

    state = None if run is None else states.get(run.name)
    if run is None or state is None:
        return _Tile(None, 0.0, "not run")
    failed = state.state == "failed"
    try:
        frame = _last_frame(run_folder(folder, run.name))
    except MulticellError:
        frame = None
    if frame is None or not len(frame.cells):
        words = {"failed": "failed", "running": "running"}
        words["done"] = "no frame" if frame is None else "no cells"
        return _Tile(None, 0.0, words.get(state.state, "not run"), failed)
    return _section(frame, run.scene, state.state)


def _section(frame: Frame, scene: Scene, state: str) -> _Tile:
    shown = cut(frame, scene)
    size = uniform_radius(frame.cells, shown.middle, scene.dimensions)
    words = cell_count(len(frame.cells))
    if state != "done":
        words += f", {state} after {time_unit(frame.time).text(frame.time)}"
    reach = 1.12 * size + float(frame.cells.radius.max())
    return _Tile(shown, reach, words, state == "failed")


def _last_frame(place: Path) -> Frame | None:
    """Return the last frame in the folder of a run, or None where there is none yet."""
    from multicell.results.reader import Contents, Frames

    if not place.is_dir():
        return None
    frames = Frames(Contents(place))
    return frames[-1] if len(frames) else None


def _drawn(title: str, subtitle: str, tiles: list[list[_Tile]], sides: Sides) -> Figure:
    """Lay out the tiles and draw them."""
    rows, columns = len(tiles), len(tiles[0])
    across, texts, up, marks, headings = sides
    left = 0.55 + 0.105 * max(map(len, marks)) if up else 0.4
    head = 0.42 if any(map(any, headings)) else 0.0
    side = min(2.9, (SIZE[0] - left - _RIGHT) / columns - _GAP)
    tall = _TOP + rows * (side + head + _GAP) + _FOOT + 0.2
    figure = blank(title, subtitle[0].upper() + subtitle[1:], (SIZE[0], tall))
    half = max((tile.size for row in tiles for tile in row), default=0.0) or 1.0
    for r, row in enumerate(tiles):
        base = tall - _TOP - (r + 1) * (side + head + _GAP)
        for k, tile in enumerate(row):
            place = (left + k * (side + _GAP), base, side, side)
            axes = figure.add_axes(
                tuple(np.array(place) / (SIZE[0], tall, SIZE[0], tall)), label=f"{r} {k}"
            )
            _fill(axes, tile, half, 0.9 + 2.6 * side)
            if headings[r][k]:
                axes.set_title(textwrap.fill(headings[r][k], 34), fontsize=7.5, weight="normal")
            if k == 0 and marks[r]:
                axes.set_ylabel(marks[r], rotation=0, ha="right", va="center")
            if r == rows - 1:
                axes.set_xlabel(textwrap.shorten(texts[k], 18, placeholder="…"))
    middle = (left + 0.5 * columns * (side + _GAP)) / SIZE[0]
    figure.text(middle, 0.16 / tall, across, ha="center", va="center")
    upright = (tall - _TOP - 0.5 * rows * (side + _GAP)) / tall
    figure.text(0.03, upright, up, rotation=90, ha="center", va="center")
    _legend(figure, tiles, tall)
    _scale_bar(figure, 2.0 * half / side, left + columns * (side + _GAP), tall)
    return figure


def _fill(axes: Axes, tile: _Tile, half: float, font: float) -> None:
    """Draw a section about the middle of its tile, or say why there is none."""
    frame_window(axes, np.zeros(3) if tile.section is None else tile.section.middle, half)
    axes.spines[:].set(visible=True, color="#d5dce1")
    colour = RED if tile.failed else QUIET
    if tile.section is None:
        axes.set_facecolor("#f6dfd9" if tile.failed else "#f4f6f8")
        axes.text(0.5, 0.5, tile.words, ha="center", va="center", color=colour, weight="bold",
                  fontsize=min(11.0, font + 1.5), transform=axes.transAxes)  # fmt: skip
        return
    shown = tile.section
    draw_circles(axes, shown.position, shown.radius, shown.group, list(shown.palette.values()))
    axes.text(0.97, 0.975, textwrap.fill(tile.words, 30), ha="right", va="top",
              color=colour if tile.failed else INK, fontsize=min(9.0, font),
              transform=axes.transAxes, zorder=6)  # fmt: skip


def _scale_bar(figure: Figure, microns: float, right: float, tall: float) -> None:
    """Draw a bar of a round length beside the legend; ``microns`` are those of an inch."""
    length = max(n for n in _LENGTHS if n <= 1.2 * microns or n == _LENGTHS[0])
    wide, high = length / microns / SIZE[0], 1.0 - 0.98 / tall
    end = right / SIZE[0]
    line = Line2D([end - wide, end], [high, high], color=INK, lw=4, solid_capstyle="butt")
    figure.add_artist(line)
    figure.text(end - wide - 0.012, high, f"{length:,} µm", ha="right", va="center", fontsize=10.5)


def _legend(figure: Figure, tiles: list[list[_Tile]], tall: float) -> None:
    """Explain the colours of the groups that are shown."""
    groups: dict[str, str] = {}
    for tile in (tile for row in tiles for tile in row if tile.section is not None):
        assert tile.section is not None
        there = np.unique(tile.section.group)
        names = list(tile.section.palette)
        groups |= {names[k]: tile.section.palette[names[k]] for k in there}
    handles = [
        Line2D([], [], ls="", marker="o", ms=8, color=colour, label=type_label(name))
        for name, colour in groups.items()
    ]
    if handles:
        figure.legend(
            handles=handles, loc="center left", bbox_to_anchor=(0.03, 1.0 - 0.98 / tall),
            ncols=len(handles), fontsize=10.5, handletextpad=0.2, columnspacing=1.4,
        )  # fmt: skip
