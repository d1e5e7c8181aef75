"""The cells of a frame in space: shaded spheres, cut open, with scale and legend."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from multicell.errors import OutputError
from multicell.report.plots.colouring import Colouring, colouring
from multicell.report.plots.section import frame_window, group_legend, scale_bar, scale_legend
from multicell.report.plots.spheres import View, spheres
from multicell.report.plots.style import DPI, SIZE, headed, moment, styled
from multicell.report.wording import cell_count, time_unit
from multicell.results.frame import Frame
from multicell.results.observables import centre
from multicell.scene.scene import Scene

FILM: Final = (8.0, 6.0)  # inches
_FINE: Final = 1.5  # pixels of the spheres to one of the figure
_WORDS: Final = {"none": "", "half": ", cut in half", "quarter": ", a quarter cut away"}
_GREY: Final = "#7d8994"  # is read on white and on black


@styled
def space(
    frame: Frame,
    scene: Scene,
    *,
    view: View | None = None,
    colour: str | None = None,
    lineage: Mapping[str, NDArray[Any]] | None = None,
    half: float | None = None,
    limits: tuple[float, float] | None = None,
) -> Figure:
    """Draw the cells as spheres of true size, seen without perspective, with what is cut away.

    - ``view``: direction and cut; absent: a quarter is cut away and opens to the eye
    - ``colour``, ``lineage``, ``half``, ``limits``: as for
      :func:`multicell.report.plots.section.section`
    """
    view = view or View()
    shade = _shades(frame, scene, colour, lineage, limits)
    figure = headed(scene, moment(frame) + _WORDS[view.cut])
    axes = figure.add_axes((0.03, 0.04, 0.66, 0.83))
    size = (_FINE * DPI * 0.66 * SIZE[0], _FINE * DPI * 0.83 * SIZE[1])
    _draw(axes, frame, shade, view, half or room(frame), size)
    _explain(figure, frame, shade)
    return figure


@styled
def film_picture(
    frame: Frame,
    scene: Scene,
    *,
    view: View,
    half: float,
    dpi: float,
    colour: str | None = None,
    lineage: Mapping[str, NDArray[Any]] | None = None,
    limits: tuple[float, float] | None = None,
    transparent: bool = False,
) -> Figure:
    """Draw one picture of a film: as :func:`space`, with the time instead of a heading.

    A transparent one has letters that can be read on a light and on a dark page.
    """
    shade = _shades(frame, scene, colour, lineage, limits)
    figure = Figure(figsize=FILM, dpi=dpi)
    axes = figure.add_axes((0.0, 0.0, 0.72, 1.0))
    _draw(axes, frame, shade, view, half, (dpi * 0.72 * FILM[0], dpi * FILM[1]))
    time = time_unit(frame.time).text(frame.time)
    figure.text(0.02, 0.95, time, fontsize=22, weight="bold", va="center")
    figure.text(0.02, 0.885, cell_count(len(frame.cells)), fontsize=14, va="center")
    _explain(figure, frame, shade)
    if transparent:
        figure.patch.set_alpha(0.0)
        axes.patch.set_alpha(0.0)
        for text in [*figure.texts, *axes.texts, *_letters(figure)]:
            text.set_color(_GREY)
        for line in axes.lines:
            line.set_color(_GREY)
        for legend in figure.legends:  # dark dots on a dark page have an edge
            for handle in legend.findobj(Line2D):
                handle.set_markeredgecolor(_GREY)
    return figure


def room(frame: Frame) -> float:
    """Return half the height of a window that shows all cells of a frame from any side, µm."""
    cells = frame.cells
    away = np.linalg.norm(cells.position - centre(cells, 3), axis=1) + cells.radius
    return 1.1 * float(away.max())


def _shades(
    frame: Frame,
    scene: Scene,
    colour: str | None,
    lineage: Mapping[str, NDArray[Any]] | None,
    limits: tuple[float, float] | None,
) -> Colouring:
    if scene.dimensions == 2:
        raise OutputError("the cells lie in a plane: a section shows them all")
    return colouring(frame, scene, colour, lineage or {}, limits)


def _draw(
    axes: Axes, frame: Frame, shade: Colouring, view: View, half: float, size: tuple[float, float]
) -> None:
    """Draw the spheres and a scale into axes that are so many pixels wide and high."""
    wide, high = round(size[0]), round(size[1])
    half *= max(1.0, high / wide)
    across = half * wide / high
    place = frame.cells.position - centre(frame.cells, 3)
    picture = spheres(place, frame.cells.radius, shade.rgb, view, (across, half), (wide, high))
    middle = np.zeros(3)
    frame_window(axes, middle, half, across)
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)
    axes.imshow(picture, extent=(-across, across, -half, half), interpolation="antialiased")
    frame_window(axes, middle, half, across)
    scale_bar(axes, middle, half)


def _explain(figure: Figure, frame: Frame, shade: Colouring) -> None:
    """Explain the colours."""
    if shade.group is None:
        scale_legend(figure, shade)
        return
    title = "Cells" if shade.title in ("state", "type") else shade.title.capitalize()
    group_legend(figure, shade.group, shade.palette or {}, title)


def _letters(figure: Figure) -> list[Any]:
    """Return the letters of legends and of the axes of scales."""
    from matplotlib.text import Text

    return figure.findobj(Text)
