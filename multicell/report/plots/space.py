"""The cells of a frame in space: shaded spheres, cut open, with scale and legend."""

from __future__ import annotations

from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text

from multicell.errors import OutputError
from multicell.report.plots.colouring import Colouring
from multicell.report.plots.section import explain_colours, frame_window, scale_bar
from multicell.report.plots.spheres import View, spheres
from multicell.report.plots.style import DPI, SIZE, headed, moment, styled
from multicell.report.wording import cell_count, time_unit
from multicell.results.frame import Frame
from multicell.results.observables import centre
from multicell.scene.scene import Scene

FILM: Final = (8.0, 6.0)  # inches
FILM_DPI: Final = 80  # 640 x 480 pixels
_FINE: Final = 1.5  # pixels of the spheres to one of the figure
_WORDS: Final = {"none": "", "half": ", cut in half", "quarter": ", a quarter cut away"}
_GREY: Final = "#7d8994"  # is read on white and on black


@styled
def space(frame: Frame, scene: Scene, shade: Colouring, view: View) -> Figure:
    """Draw the cells as spheres of true size, seen without perspective, with what is cut away."""
    _refuse_flat(scene)
    figure = headed(scene, moment(frame) + _WORDS[view.cut])
    axes = figure.add_axes((0.03, 0.04, 0.66, 0.83))
    size = (_FINE * DPI * 0.66 * SIZE[0], _FINE * DPI * 0.83 * SIZE[1])
    _draw(axes, frame, shade, view, room(frame), size)
    explain_colours(figure, shade, "Cells")
    return figure


@styled
def film_picture(
    frame: Frame, scene: Scene, shade: Colouring, view: View, half: float, clear: bool = False
) -> Figure:
    """Draw one picture of a film: as :func:`space`, with the time instead of a heading.

    ``half`` is half the height of its window, µm. A ``clear`` one has no background, and letters
    that can be read on a light and on a dark page.
    """
    _refuse_flat(scene)
    figure = Figure(figsize=FILM, dpi=FILM_DPI)
    axes = figure.add_axes((0.0, 0.0, 0.72, 1.0))
    _draw(axes, frame, shade, view, half, (FILM_DPI * 0.72 * FILM[0], FILM_DPI * FILM[1]))
    time = time_unit(frame.time).text(frame.time)
    figure.text(0.02, 0.95, time, fontsize=22, weight="bold", va="center")
    figure.text(0.02, 0.885, cell_count(len(frame.cells)), fontsize=14, va="center")
    explain_colours(figure, shade, "Cells")
    if clear:
        figure.patch.set_alpha(0.0)
        axes.patch.set_alpha(0.0)
        for text in figure.findobj(Text):
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


def _refuse_flat(scene: Scene) -> None:
    if scene.dimensions == 2:
        raise OutputError("the cells lie in a plane: a section shows them all")


def _draw(
    axes: Axes, frame: Frame, shade: Colouring, view: View, half: float, size: tuple[float, float]
) -> None:
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
