"""A run as a moving picture: every frame in one window, in one range of colours."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import matplotlib as mpl
import numpy as np

from multicell.errors import OutputError
from multicell.host.extras import needs
from multicell.report.plots.colouring import GROUPS, Colouring, cell_quantity, colouring, limits_of
from multicell.report.plots.run import one_spelling
from multicell.report.plots.section import Plane, section, window
from multicell.report.plots.space import FILM_DPI, View, film_picture, room
from multicell.results.folder import file_errors, write_bytes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from multicell.report.result import Result
    from multicell.results.frame import Frame

MOVIE_ENDINGS: Final = (".gif", ".webp", ".mp4")
TURN: Final = 90.0
"""Degrees between the outermost places of an eye that swings round cells in space."""
_REST: Final = 1.5  # s for which a film continues after the last frame


def movie(
    result: Result,
    path: str | Path,
    *,
    plane: str | None = None,
    colour: str | None = None,
    color: str | None = None,
    rate: float = 8.0,
    progress: Callable[[int, int], None] | None = None,
    space: bool = False,
    cut: str = "quarter",
    turn: float = TURN,
    transparent: bool = False,
) -> Path:
    """Write all frames of a run as a moving picture: their sections, or the cells in space.

    - ``path``: file that ends in ``.gif`` or ``.webp``, or in ``.mp4`` where ``multicell[movie]``
      is installed
    - ``plane``, ``colour``, ``color``: as for ``result.plot.section``
    - ``rate``: frames in a second
    - ``progress``: called with the number of pictures drawn and of all
    - ``space``: show whole cells in space, of which a part is cut away, instead of a section
    - ``cut``: what is cut away in space: ``"none"``, ``"half"`` or ``"quarter"``
    - ``turn``: degrees between the outermost places of the eye in space, which swings to one side
      and to the other in the course of the film; at its beginning and end it looks straight at the
      cut
    - ``transparent``: leave the background out, for ``.webp`` in space only; the letters can be
      read on light and on dark pages
    """
    path = Path(path)
    if path.suffix.lower() not in MOVIE_ENDINGS:
        raise OutputError(
            f"'{path}' is no movie: its name must end in {' or '.join(MOVIE_ENDINGS)}"
        )
    if not 0.0 < rate <= 60.0:
        raise OutputError(f"the rate is {rate:g} frames in a second, must be above 0, at most 60")
    if transparent and not (space and path.suffix.lower() == ".webp"):
        raise OutputError("a background can be left out of a .webp of cells in space only")
    if space and plane is not None:
        raise OutputError("cells in space are cut through their centre: name a cut, or a section")
    settings: dict[Any, str] = {}
    if path.suffix.lower() == ".mp4":
        needs("imageio_ffmpeg")
        import imageio_ffmpeg

        settings = {"animation.ffmpeg_path": imageio_ffmpeg.get_ffmpeg_exe()}
    numbers = [k for k, frame in enumerate(result.frames) if len(frame.cells)]
    if not numbers:
        raise OutputError("no frame of the run has cells: there is nothing to show")
    hold = max(1, round(_REST * rate))
    shades = _shades(result, numbers, one_spelling(colour, color))
    scene = result.scene
    figures: Iterator[Figure]

    def inside(number: int) -> Frame:
        return result.frames[number].within(scene.domain)

    if space:  # the eye turns on while the last frame stays
        numbers += hold * numbers[-1:]
        swing = View(turn, cut).turn * np.sin(np.linspace(0.0, 2.0 * np.pi, len(numbers)))
        views = [View(0.5 * float(angle), cut) for angle in swing]
        half = max(room(inside(k)) for k in dict.fromkeys(numbers))
        figures = (
            film_picture(inside(k), scene, shades(k), view, half, transparent)
            for k, view in zip(numbers, views, strict=True)
        )
        hold = 0
    else:
        half = max(window(inside(k), scene) for k in numbers)
        where = None if plane is None else Plane.parse(plane)
        figures = (section(inside(k), scene, shades(k), where, half) for k in numbers)

    with (
        file_errors("write", path),
        tempfile.TemporaryDirectory() as place,
        mpl.rc_context(settings),
    ):
        film = Path(place) / f"film{path.suffix.lower()}"
        for done in _save(figures, film, rate, hold):
            if progress is not None:
                progress(done, len(numbers))
        write_bytes(path, film.read_bytes())
    return path


def _shades(result: Result, numbers: list[int], colour: str | None) -> Callable[[int], Colouring]:
    """Return a function that colours the cells of a frame by its number, in one range for all."""
    limits = None
    if colour is not None and colour not in GROUPS:
        values = [cell_quantity(result.frames[k], colour)[0] for k in numbers]
        limits = limits_of(values, from_zero=colour in result.frames[numbers[0]].concentrations)
    return lambda k: colouring(result.frames[k], result.scene, colour, result.lineage, limits)


def _save(figures: Iterator[Figure], path: Path, rate: float, hold: int) -> Iterator[int]:
    """Write figures as a film, yield how many are done; the last one stays for ``hold`` more."""
    from matplotlib.animation import FFMpegWriter, PillowWriter

    fps: Any = rate  # annotated as whole numbers, but any will do
    writer = FFMpegWriter(fps=fps) if path.suffix == ".mp4" else PillowWriter(fps=fps)
    first = next(figures)
    with writer.saving(first, str(path), FILM_DPI):
        for done, figure in enumerate(chain([first], figures), start=1):
            writer.fig = figure
            writer.grab_frame()
            yield done
        for _ in range(hold):
            writer.grab_frame()
