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
from multicell.report.plots.section import Cut, cut, draw_circles, frame_window, scale_bar
from multicell.report.plots.style import INK, QUIET, RED, SIZE, styled, type_label
from multicell.report.wording import cell_count, time_unit
from multicell.results.observables import uniform_radius
from multicell.studies.pictures.heatmap import arrange
from multicell.studies.pictures.layout import panels, spread
from multicell.studies.pictures.values import (
    POINT,
    SEED,
    axes_of,
    compact,
    is_sampled,
    middle,
    nearest,
    point_text,
    scale,
    sentence,
    sides_of,
)

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

    from multicell.results.frame import Frame
    from multicell.scene.scene import Scene
    from multicell.studies.runs import Run
    from multicell.studies.status import RunStatus

_MAX_SIDE: Final = 6  # tiles in a row or column
_MAX_SAMPLE: Final = 8  # tiles of a sample
_HEAD, _FOOT, _GAP = 1.3, 0.6, 0.12  # inches


class _Tile(NamedTuple):
    """What one tile shows: a section, or words in its place."""

    section: Cut | None
    size: float
    words: str
    failed: bool = False


class _Plan(NamedTuple):
    """Which runs are shown: their places over the axes, row by row, and what stands beside them."""

    places: list[list[tuple[int, ...]]]
    across: str
    columns: list[str]
    up: str
    rows: list[str]
    note: str


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
        All runs and how they stand, in the order of the table.
    folder
        Of the study.
    x, y
        Axes of the tiles, by default the first two; further ones are fixed. A sample shows some
        of its points, in the order of the first axis.
    seed
        By default the first one.
    at
        Axis -> value for axes that are fixed, by default their middle value.

    Raises
    ------
    SceneError
        For an unknown axis or value.
    """
    table = compact(table)
    seeds = [int(value) for value in table[SEED].values]
    chosen = seeds[0] if seed is None else int(seed)
    if chosen not in seeds:
        hint = f"Its seeds are {seeds[0]} to {seeds[-1]}."
        raise SceneError("seed", f"is {chosen}, which is none of the study", hint)
    plan = _of_sample(table) if is_sampled(table) else _of_grid(table, x, y, at or {})
    shape = tuple(table.sizes[name] for name in sides_of(table))
    tiles = []
    for place in (place for row in plan.places for place in row):
        number = int(np.ravel_multi_index((*place, seeds.index(chosen)), shape))
        tiles.append(_tile(runs[number], states[number], folder))
    subtitle = sentence(f"last frames of seed {chosen}, all on one scale{plan.note}")
    return _draw(title, subtitle, tiles, plan)


def _of_grid(table: xr.Dataset, x: str | None, y: str | None, at: Mapping[str, Any]) -> _Plan:
    """Return the tiles of a grid, the highest value of the second axis on top."""
    dimensions = sides_of(table)[:-1]
    if not axes_of(table):
        return _Plan([[(0,) * len(dimensions)]], "", [""], "", [""], "")
    across, up, third, fixed = arrange(table, x, y, at)
    fixed |= middle(table, [third] if third is not None else [])
    note = f"; {point_text(table, fixed)}" if fixed else ""
    columns = spread(table.sizes[across], _MAX_SIDE)
    rows = [0] if up is None else spread(table.sizes[up], _MAX_SIDE)[::-1]
    if len(columns) < table.sizes[across] or (up is not None and len(rows) < table.sizes[up]):
        note += "; not all values"
    base = {name: nearest(table, name, value) for name, value in fixed.items()}
    places = [
        [
            tuple((base | {across: column, up: row}).get(name, 0) for name in dimensions)
            for column in columns
        ]
        for row in rows
    ]
    side, texts = scale(table, across), [""]
    label = "" if up is None else scale(table, up).label
    if up is not None:
        texts = [scale(table, up).texts[row] for row in rows]
    return _Plan(places, side.label, [side.texts[k] for k in columns], label, texts, note)


def _of_sample(table: xr.Dataset) -> _Plan:
    """Return some points of a sample, in the order of its first axis, four in a row."""
    names = axes_of(table)
    order = np.argsort(table[names[0]].values, kind="stable")
    found = [int(order[k]) for k in spread(table.sizes[POINT], _MAX_SAMPLE)]
    texts = [point_text(table, {n: table[n].values[k] for n in names[:3]}) for k in found]
    wide = min(4, len(found))
    places: list[list[tuple[int, ...]]] = [
        [(k,) for k in found[first : first + wide]] for first in range(0, len(found), wide)
    ]
    note = f"; {len(found)} of {table.sizes[POINT]} points, in the order of their first value"
    return _Plan(places, "", texts, "", [""] * len(places), note)


def _tile(run: Run, state: RunStatus, folder: Path) -> _Tile:
    """Return the section of a run, or why there is none."""
    from multicell.studies.status import run_folder

    failed = state.state == "failed"
    try:
        frame = last_frame(run_folder(folder, run.name))
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


def last_frame(place: Path) -> Frame | None:
    """Return the last frame in the folder of a run, or None where there is none yet."""
    from multicell.results.reader import Contents, Frames

    if not place.is_dir():
        return None
    frames = Frames(Contents(place))
    return frames[-1] if len(frames) else None


def _draw(title: str, subtitle: str, tiles: list[_Tile], plan: _Plan) -> Figure:
    """Lay out the tiles and draw them."""
    rows, columns = len(plan.places), len(plan.places[0])
    sample = len(plan.columns) > columns or not plan.across
    heading = 0.5 if sample and any(plan.columns) else 0.0
    side = min(2.9, (SIZE[0] - 1.2) / columns - _GAP)
    height = _HEAD + rows * (side + heading + _GAP) + _FOOT
    figure, grid = panels(title, subtitle, len(tiles), columns, height, _HEAD)
    half = max((tile.size for tile in tiles), default=0.0) or 1.0
    for number, (axes, tile) in enumerate(zip(grid, tiles, strict=True)):
        row, column = divmod(number, columns)
        _fill(axes, tile, half, 0.9 + 2.6 * side)
        if sample:
            axes.set_title(textwrap.fill(plan.columns[number], 34), fontsize=7.5, weight="normal")
        elif row == rows - 1:
            axes.set_xlabel(textwrap.shorten(plan.columns[column], 18, placeholder="…"))
        if column == 0 and plan.rows[row]:
            axes.set_ylabel(plan.rows[row], rotation=0, ha="right", va="center")
    if plan.across:
        figure.supxlabel(plan.across, fontsize=12)
    if plan.up:
        figure.supylabel(plan.up, fontsize=12)
    with_cells = [(axes, tile) for axes, tile in zip(grid, tiles, strict=True) if tile.section]
    if with_cells:
        axes, tile = with_cells[0]
        assert tile.section is not None
        scale_bar(axes, tile.section.middle, half)
    _legend(figure, [tile.section for _, tile in with_cells if tile.section], height)
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


def _legend(figure: Figure, cuts: Sequence[Cut], height: float) -> None:
    """Explain the colours of the groups that are shown."""
    groups: dict[str, str] = {}
    for shown in cuts:
        names = list(shown.palette)
        groups |= {names[k]: shown.palette[names[k]] for k in np.unique(shown.group)}
    handles = [
        Line2D([], [], ls="", marker="o", ms=8, color=colour, label=type_label(name))
        for name, colour in groups.items()
    ]
    if handles:
        figure.legend(
            handles=handles, loc="center left", bbox_to_anchor=(0.03, 1.0 - 0.98 / height),
            ncols=len(handles), fontsize=10.5, handletextpad=0.2, columnspacing=1.4,
        )  # fmt: skip
