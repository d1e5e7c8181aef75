"""The cells of a frame in space: shaded spheres, cut open, with scale and legend.

Spheres are drawn point by point, with a depth for each.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text
from numba import njit
from numpy.typing import NDArray

from multicell.cells import FloatArray
from multicell.compiling import INNER, KERNEL
from multicell.errors import OutputError
from multicell.population.extents import centre
from multicell.report.plots.colouring import Colouring
from multicell.report.plots.section import explain_colours, frame_window, scale_bar
from multicell.report.plots.style import DPI, SIZE, headed, moment, styled
from multicell.report.wording import cell_count, time_unit
from multicell.results.frame import Frame
from multicell.scene.scene import Scene

FILM: Final = (8.0, 6.0)  # inches
FILM_DPI: Final = 80  # 640 x 480 pixels
_FINE: Final = 1.5  # pixels of the spheres to one of the figure
_WORDS: Final = {"none": "", "half": ", cut in half", "quarter": ", a quarter cut away"}
_GREY: Final = "#7d8994"  # is read on white and on black
CUTS: Final = ("none", "half", "quarter")  # what can be cut away

_AZIMUTH: Final = -60.0  # degrees: viewing angle without a turn, towards which a cut opens
_HEIGHT: Final = 24.0  # degrees above the horizon
_LEVELS: Final = 3  # points along a side of which one pixel is the mean
_LIGHT: Final = np.array([0.30, 0.46, 0.836])  # direction of the light, of length one


@final
@dataclass(frozen=True)
class View:
    """From where a population is seen, and what is cut away of it.

    - ``turn``: degrees by which the eye goes round the vertical axis z, from where cuts open to it
    - ``cut``: one of :data:`CUTS`: nothing, the half that lies nearer, or a quarter
    """

    turn: float = 0.0
    cut: str = "quarter"

    def __post_init__(self) -> None:
        if self.cut not in CUTS:
            raise OutputError(f"{self.cut!r} is no cut: write {', '.join(CUTS)}")
        if not math.isfinite(self.turn):
            raise OutputError(f"turn must be finite, got {self.turn}")

    def axes(self) -> FloatArray:
        """Return the directions to the right, upwards and to the eye as rows, (3, 3)."""
        around, above = math.radians(_AZIMUTH + self.turn), math.radians(_HEIGHT)
        right = np.array([-math.sin(around), math.cos(around), 0.0])
        level = np.array([math.cos(around), math.sin(around), 0.0])
        eye = math.cos(above) * level + [0.0, 0.0, math.sin(above)]
        return np.array([right, np.cross(eye, right), eye])

    def planes(self) -> FloatArray:
        """Return the normals of the cuts through the centre; away goes what all point to."""
        wings = {"none": (), "half": (0.0,), "quarter": (-45.0, 45.0)}[self.cut]
        turns = [math.radians(_AZIMUTH + wing) for wing in wings]
        normals = [(math.cos(turn), math.sin(turn), 0.0) for turn in turns]
        return np.array(normals).reshape(len(wings), 3)


def spheres(
    place: FloatArray,
    radius: FloatArray,
    rgb: FloatArray,
    view: View,
    half: tuple[float, float],
    pixels: tuple[int, int],
) -> NDArray[np.uint8]:
    """Return a picture of spheres, seen without perspective.

    - ``place``, (n, 3) µm: centres, from the centre of the picture
    - ``radius``, (n,) µm
    - ``rgb``, (n, 3): colours, 0 to 1
    - ``view``: direction, and what is cut away
    - ``half``: half the width and half the height of the window, µm
    - ``pixels``: width and height of the picture; both have the same scale

    Returns (height, width, 4) uint8: red, green, blue and opacity, the first row uppermost.
    """
    wide, high = (_LEVELS * count for count in pixels)
    axes = view.axes()
    seen = np.ascontiguousarray(place @ axes.T)
    planes = np.ascontiguousarray(view.planes() @ axes.T)
    picture = np.zeros((high, wide, 4), np.uint8)
    depth = np.full((high, wide), -np.inf, np.float32)
    front, back = float(seen[:, 2].max()), float(seen[:, 2].min())
    colours = np.ascontiguousarray(255.0 * rgb)
    _draw(
        seen,
        radius,
        colours,
        planes,
        _LIGHT,
        0.5 * (front + back),
        front,
        float(half[0]),
        float(half[1]),
        picture,
        depth,
    )
    # means of squares of points; colours count as much as they are opaque
    blocks = picture.reshape(pixels[1], _LEVELS, pixels[0], _LEVELS, 4)
    opaque = blocks[..., 3] > 0
    count = opaque.sum(axis=(1, 3))
    # points where nothing is are black, and do not count
    colour = blocks[..., :3].sum(axis=(1, 3), dtype=np.float64) / np.maximum(count, 1)[..., None]
    alpha = 255.0 * count / _LEVELS**2
    whole: FloatArray = np.concatenate([colour, alpha[..., None]], axis=2)
    return np.rint(whole).astype(np.uint8)


@njit(**KERNEL)  # type: ignore[untyped-decorator]
def _draw(
    seen: Any,
    radius: Any,
    rgb: Any,
    planes: Any,
    light: Any,
    middle: float,
    front: float,
    half_wide: float,
    half_high: float,
    picture: Any,
    depth: Any,
) -> None:
    """Draw all spheres into a picture and its depths.

    ``seen`` (n, 3) are centres in the eye's axes, µm, the third towards the eye; ``rgb`` (n, 3)
    from 0 to 255; ``planes`` (k, 3) normals of cuts through the origin; ``light`` (3,) the
    direction it comes from; between the depths ``middle`` and ``front`` what is nearer is brighter.
    """
    high, wide = depth.shape
    pixel = 2.0 * half_wide / wide
    for i in range(len(radius)):
        r = radius[i]
        near = min(1.0, max(0.0, (seen[i, 2] - middle) / max(front - middle, 1e-9)))
        far = 0.72 + 0.28 * near
        left = max(0, int((seen[i, 0] - r + half_wide) / pixel))
        right = min(wide - 1, int((seen[i, 0] + r + half_wide) / pixel))
        first = max(0, int((half_high - seen[i, 1] - r) / pixel))
        last = min(high - 1, int((half_high - seen[i, 1] + r) / pixel))
        for row in range(first, last + 1):
            y = half_high - (row + 0.5) * pixel
            v = (y - seen[i, 1]) / r
            for column in range(left, right + 1):
                x = (column + 0.5) * pixel - half_wide
                u = (x - seen[i, 0]) / r
                out2 = u * u + v * v
                if out2 >= 1.0:
                    continue
                up = math.sqrt(1.0 - out2)
                z = seen[i, 2] + r * up
                down, face = _way_out(planes, x, y, z)
                if down > 2.0 * r * up:
                    continue
                z -= down
                if z <= depth[row, column]:
                    continue
                depth[row, column] = z
                if face >= 0:  # the line round a face is where its sphere ends
                    inward = (z - seen[i, 2]) / r
                    rim = _step(1.0, 0.8, out2 + inward * inward)
                    shade, gleam = (0.74 + 0.26 * rim) * (1.0 - 0.1 * face), 0.0
                else:
                    facing = u * light[0] + v * light[1] + up * light[2]
                    shade = (0.68 + 0.44 * facing) * (0.72 + 0.28 * _step(1.0, 0.72, out2)) * far
                    gleam = 255.0 * 0.16 * far * max(facing, 0.0) ** 16
                for k in range(3):
                    picture[row, column, k] = np.uint8(min(255.0, shade * rgb[i, k] + gleam))
                picture[row, column, 3] = 255


@njit(**INNER)  # type: ignore[untyped-decorator]
def _way_out(planes: Any, x: float, y: float, z: float) -> tuple[float, int]:
    """Return how far below a point, away from the eye, the cut ends, and at which of its faces.

    Zero and -1 where the point is not cut away; infinity where nothing below it is left.
    """
    down, face = np.inf, -1
    if len(planes) == 0:
        return 0.0, -1
    for k in range(len(planes)):
        beyond = planes[k, 0] * x + planes[k, 1] * y + planes[k, 2] * z
        if beyond <= 0.0:
            return 0.0, -1
        if planes[k, 2] > 0.0 and beyond / planes[k, 2] < down:
            down, face = beyond / planes[k, 2], k
    return down, face


@njit(**INNER)  # type: ignore[untyped-decorator]
def _step(low: float, high: float, value: float) -> float:
    share = min(1.0, max(0.0, (value - low) / (high - low)))
    return share * share * (3.0 - 2.0 * share)


@styled
def space(frame: Frame, scene: Scene, shade: Colouring, view: View) -> Figure:
    """Draw the cells as spheres of true size, seen without perspective, with what is cut away."""
    _refuse_flat(scene)
    figure = headed(scene, moment(frame) + _WORDS[view.cut])
    axes = figure.add_axes((0.03, 0.04, 0.66, 0.83))
    size = (_FINE * DPI * 0.66 * SIZE[0], _FINE * DPI * 0.83 * SIZE[1])
    _draw_spheres(axes, frame, shade, view, room(frame), size)
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
    _draw_spheres(axes, frame, shade, view, half, (FILM_DPI * 0.72 * FILM[0], FILM_DPI * FILM[1]))
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


def _draw_spheres(
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
