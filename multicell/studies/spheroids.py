"""The picture of all tissues of a study: a section through each at the end of its run."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from multicell.cells import Cells
from multicell.errors import OutputError
from multicell.population.extents import centre
from multicell.report.plots import style
from multicell.report.plots.colouring import Colouring, colouring
from multicell.report.plots.section import draw_discs, frame_window, scale_bar, window
from multicell.report.wording import cell_count
from multicell.results.reader import Contents, Frames
from multicell.studies import picture_data as of
from multicell.studies.runs import StudyRun

if TYPE_CHECKING:
    import xarray as xr

    from multicell.results.frame import Frame
    from multicell.scene.scene import Scene
    from multicell.studies.status import RunStatus

MOST_SHOWN: Final = 24  # tissues of one picture; of more points those evenly between
_COLUMNS: Final = 4  # tissues in a row at most
_MOST_LETTERS: Final = 31  # of a line above a tissue, where four stand side by side
_MOST_NAMED: Final = 3  # axes whose values stand above a tissue


Tissue = tuple[StudyRun, "Frame"]


def last_tissues(
    folder: Path, runs: Sequence[StudyRun], states: Sequence[RunStatus]
) -> list[Tissue]:
    """Return the last frame of the first run that is done of each point; of many points some.

    A run whose frames are gone or damaged has none, nor has one without cells: the picture says of
    how many points it is.
    """
    found: dict[tuple[Any, ...], StudyRun] = {}
    for run, state in zip(runs, states, strict=True):
        if state.state == of.RUN_DONE:
            point = tuple(value for name, value in run.coordinates.items() if name != of.SEED)
            found.setdefault(point, run)
    first = list(found.values())
    places = np.linspace(0, len(first) - 1, min(len(first), MOST_SHOWN)).round().astype(int)
    read = [(first[place], _last_frame(folder / "runs" / first[place].name)) for place in places]
    return [(run, frame) for run, frame in read if frame is not None and len(frame.cells)]


@style.styled
def spheroids(table: xr.Dataset, title: str, tissues: Sequence[Tissue], points: int) -> Figure:
    """Draw the tissue at the end of each run: its cut through the centre, or a flat one as it is.

    - ``table``: of the study, for the names and units of its axes
    - ``title``: of the study
    - ``tissues``: those to show, at least one: runs with their last frames
    - ``points``: how many the study has, done or not
    """
    rows = -(-len(tissues) // _COLUMNS)
    columns = -(-len(tissues) // rows)  # rows of one length have no holes
    half = max(window(frame, run.scene) for run, frame in tissues)
    shades = [colouring(frame, run.scene, None, {}) for run, frame in tissues]
    lines = 1 + min(len(of.axes_of(table)), _MOST_NAMED)
    words = 0.18 * lines
    side = 0.94 * style.SIZE[0] / max(columns, 2)  # of a panel, with the space beside it
    high = 1.35 + (0.92 * side + words) * rows
    subtitle = "Tissue at the end of each run, on one scale"
    if len(tissues) < points:
        subtitle += f": {len(tissues)} of {points:,} points"
    figure = style.blank(title, subtitle, (style.SIZE[0], high))
    edges = 0.03, 0.45 / high, 0.97, 1.0 - (0.85 + words) / high
    gaps = 0.08, words / (0.92 * side)
    grid = style.panel_grid(figure, len(tissues), columns, edges, gaps)
    for axes, (run, frame), shade in zip(grid, tissues, shades, strict=True):
        above = f"{_point_words(run, table)}\n{cell_count(len(frame.cells))}".strip()
        axes.set_title(above, fontsize=9.5, weight="normal", pad=4)
        _draw_tissue(axes, frame, run.scene, shade, half)
    scale_bar(grid[0], np.zeros(3), half, size=9.0)
    figure.legend(
        handles=_legend(shades), loc="lower left", bbox_to_anchor=(0.025, 0.0), ncols=6, fontsize=10
    )
    return figure


def _last_frame(folder: Path) -> Frame | None:
    try:
        frames = Frames(Contents(folder))
        return frames[-1] if len(frames) else None
    except OutputError:
        return None


def _draw_tissue(axes: Axes, frame: Frame, scene: Scene, shade: Colouring, half: float) -> None:
    """Draw the cells of a frame about their centre."""
    cells: Cells = frame.cells
    frame_window(axes, np.zeros(3), half)
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)
    place = cells.position - centre(cells, scene.dimensions)
    away = place[:, 2] if scene.dimensions == 3 else np.zeros(len(cells))
    square = cells.radius**2 - away**2
    cut = square > 0.0
    draw_discs(axes, place[cut, :2], np.sqrt(square[cut]), shade.rgb[cut], edge=0.3)


def _point_words(run: StudyRun, table: xr.Dataset) -> str:
    """Return the values of the axes of a run, in lines."""
    words = []
    for name in of.axes_of(table)[:_MOST_NAMED]:
        shown, value = of.axis_scale(table, name), run.coordinates[name]
        text = value if isinstance(value, str) else of.number_text(float(value) / shown.factor)
        line = f"{shown.words} {text} {shown.unit}".strip()
        words.append(textwrap.shorten(line, _MOST_LETTERS, placeholder=" …"))
    return "\n".join(words)


def _legend(shades: Sequence[Colouring]) -> list[Line2D]:
    """Return an entry for each group of cells that is there."""
    known: dict[str, str] = {}
    for shade in shades:
        assert shade.group is not None
        present = np.unique(shade.group)
        known |= {n: c for k, (n, c) in enumerate((shade.palette or {}).items()) if k in present}
    return [
        Line2D([], [], ls="", marker="o", ms=8, color=colour, label=style.type_label(name))
        for name, colour in known.items()
    ]
