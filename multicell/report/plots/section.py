"""A section through the middle of a population, with the nutrient around it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from matplotlib.collections import EllipseCollection
from matplotlib.colors import Colormap, ListedColormap, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from multicell.cells import Cells, FloatArray, IntArray, State
from multicell.report.plots.style import (
    COLOURS,
    HEADING,
    INK,
    RED,
    SIZE,
    headed,
    moment,
    styled,
    thresholds,
    type_colours,
    type_label,
)
from multicell.report.wording import cell_count
from multicell.results.frame import Field, Frame
from multicell.results.observables import centre, uniform_radius

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

    from multicell.scene.nutrient import Nutrient
    from multicell.scene.scene import Scene


# white to a light blue: cells must stand out against it
_GONE = 1e-9  # part of the highest concentration of a field below which it is not drawn
_WATER: Final = ListedColormap(np.linspace(to_rgb("#ffffff"), to_rgb("#8fbce0"), 256))


@styled
def section(frame: Frame, scene: Scene) -> Figure:
    """Draw the cells that the plane z = centre cuts, each with the radius of its cut.

    Two or three cells without a field are cut by the plane that holds their centres. The colour
    shows the state or, where there is more than one type, the type; cells that are necrotic are
    dark in both. Behind them is the scene's first field, with its thresholds as lines.

    Raises
    ------
    ValueError
        If the frame has no cells.
    """
    nutrients, dimensions = scene.nutrients, scene.dimensions
    shown = cut(frame, scene)
    middle, group, palette = shown.middle, shown.group, shown.palette
    cut_through = f": section through the centre ({cell_count(len(group))})"
    figure = headed(scene, moment(frame) + (cut_through if dimensions == 3 else ""))
    axes = figure.add_axes((0.03, 0.04, 0.66, 0.83))
    size = uniform_radius(frame.cells, middle, dimensions)
    half = 1.22 * size + 2.0 * float(frame.cells.radius.max())
    frame_window(axes, middle, half, half * (0.66 * SIZE[0]) / (0.83 * SIZE[1]))
    axes.spines[["top", "right"]].set_visible(True)
    draw_circles(axes, shown.position, shown.radius, group, list(palette.values()))
    name = next((name for name in nutrients if name in frame.fields), "")
    if name:
        _draw_behind(figure, axes, frame.fields[name], float(middle[2]), nutrients[name])
    _scale_bar(axes, middle, half)
    _section_legend(figure, group, palette, "Cells in this section" if dimensions == 3 else "Cells")
    return figure


class Cut(NamedTuple):
    """The cells that the plane z = centre cuts.

    Attributes
    ----------
    middle : (3,) µm
        Centre of the population.
    position : (k, 2) µm
    radius : (k,) µm
        Of the circles that the plane cuts out of the cells.
    group : (k,) int
        Place of each cell's group in the palette.
    palette
        Name of each group (state or type) and its colour.
    """

    middle: FloatArray
    position: FloatArray
    radius: FloatArray
    group: IntArray
    palette: dict[str, str]


def cut(frame: Frame, scene: Scene) -> Cut:
    """Return the cells of a section; see :func:`section` for plane and groups."""
    middle = centre(frame.cells, scene.dimensions)
    few = 1 < len(frame.cells) <= 3 and not frame.fields
    place = _in_plane(frame.cells.position, middle) if few else frame.cells.position
    square = frame.cells.radius**2 - (place[:, 2] - middle[2]) ** 2
    inside = square > 0.0
    group, palette = _groups(frame.cells.take(inside), list(scene.types))
    return Cut(middle, place[inside, :2], np.sqrt(square[inside]), group, palette)


def _in_plane(position: FloatArray, middle: FloatArray) -> FloatArray:
    """Return positions turned about the centre so that the last axis is their thinnest one."""
    _, _, axes = np.linalg.svd(position - middle)
    return np.asarray(middle + (position - middle) @ axes.T)


def _groups(cells: Cells, types: Sequence[str]) -> tuple[IntArray, dict[str, str]]:
    """Return the group of each cell, and name and colour of the groups in their order."""
    if len(types) < 2:
        return cells.state.astype(np.int64), {
            s.name.lower(): COLOURS[s.name.lower()] for s in State
        }
    dead = cells.state == State.NECROTIC
    colours = type_colours(types)
    # a type may be named like the state
    name = "necrotic" if "necrotic" not in colours else "dead (necrotic)"
    return np.where(dead, len(types), cells.kind), {**colours, name: COLOURS["necrotic"]}


def frame_window(axes: Axes, middle: FloatArray, half: float, width: float | None = None) -> None:
    """Give axes one scale about the centre and no ticks; ``width`` is half of it, as ``half``."""
    across = half if width is None else width
    axes.set_xlim(middle[0] - across, middle[0] + across)
    axes.set_ylim(middle[1] - half, middle[1] + half)
    axes.set(xticks=[], yticks=[], aspect="equal")


def draw_circles(
    axes: Axes, position: FloatArray, radius: FloatArray, group: IntArray, colours: list[str]
) -> None:
    """Draw circles of true size in the colour of the cells' groups."""
    palette = np.array([to_rgb(colour) for colour in colours])
    size = 2.0 * radius
    axes.add_collection(
        EllipseCollection(
            size,
            size,
            np.zeros(len(size)),
            units="xy",
            offsets=position,
            offset_transform=axes.transData,
            facecolors=palette[group],
            edgecolors="white",
            linewidths=0.5 if len(size) > 200 else 1.2,
            zorder=2,
        )
    )


def slice_at(field: Field, z: float) -> FloatArray:
    """Return the field on the plane at height z (µm), interpolated linearly: (nx, ny).

    Raises
    ------
    ValueError
        If the plane lies outside the grid.
    """
    if field.kind == "radial":
        field = field.in_plane(z)
    if field.values.shape[2] == 1:
        return np.asarray(field.values[:, :, 0])
    heights = field.axis(2)
    if not heights[0] <= z <= heights[-1]:
        raise ValueError(f"the plane z = {z:g} um lies outside the grid of {field.name}")
    below = min(max(int(np.searchsorted(heights, z)) - 1, 0), max(len(heights) - 2, 0))
    above = min(below + 1, len(heights) - 1)
    weight = (z - heights[below]) / field.spacing
    layers = field.values
    return np.asarray((1.0 - weight) * layers[:, :, below] + weight * layers[:, :, above])


def refined(field: Field, z: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return x, y and the field on the plane at z, four points to a grid spacing.

    The cubic spline is for the eye only: lines through the bare grid would look like polygons.
    """
    from scipy.ndimage import map_coordinates

    plane = slice_at(field, z)
    x, y = (np.linspace(0, n - 1, 4 * (n - 1) + 1) for n in plane.shape)
    fine = map_coordinates(plane, np.meshgrid(x, y, indexing="ij"), order=3, mode="nearest")
    at = [field.axis(k)[0] + index * field.spacing for k, index in enumerate((x, y))]
    return at[0], at[1], fine.T


def draw_field(
    axes: Axes, field: Field, z: float, nutrient: Nutrient, medium: float, low: float | None,
    colours: Colormap,
) -> tuple[AxesImage, list[tuple[str, float, str]]]:  # fmt: skip
    """Draw a field on the plane at z as shades, and its thresholds as lines over all else.

    Parameters
    ----------
    medium
        Concentration around the grid, mM.
    low
        Where the colours begin, mM; None for the lowest value.

    Returns
    -------
    shades
    thresholds
        Meaning, value and line style of those that are drawn.
    """
    x, y, plane = refined(field, z)
    low = min(float(plane.min()), medium) if low is None else low
    top = max(float(plane.max()), medium)
    top = top if top > low else low + 1.0
    axes.set_facecolor(colours((medium - low) / (top - low)))
    window = axes.axis()
    half = 0.5 * (x[1] - x[0])
    extent = (x[0] - half, x[-1] + half, y[0] - half, y[-1] + half)
    shades = axes.imshow(
        plane, extent=extent, origin="lower", cmap=colours, vmin=low, vmax=top, zorder=0
    )
    axes.axis(window)
    inside = [entry for entry in thresholds(nutrient) if plane.min() < entry[1] < plane.max()]
    for _, level, style in inside:
        line: dict[str, Any] = {"levels": [level], "zorder": 3}
        axes.contour(x, y, plane, colors="white", linewidths=3.6, **line)
        axes.contour(x, y, plane, colors=RED, linewidths=1.8, linestyles=style, **line)
    return shades, inside


def _draw_behind(figure: Figure, axes: Axes, field: Field, z: float, nutrient: Nutrient) -> None:
    """Draw a field behind the cells of a section, and explain its shades and lines.

    What is left of one that has been used up or has decayed is not: shades of it would be rounding.
    """
    if not max(float(field.values.max()), nutrient.boundary) > _GONE * nutrient.highest:
        return
    shades, inside = draw_field(axes, field, z, nutrient, nutrient.boundary, 0.0, _WATER)
    bar = figure.colorbar(shades, cax=figure.add_axes((0.73, 0.28, 0.018, 0.27)))
    bar.outline.set_visible(False)
    bar.ax.grid(False)
    figure.text(0.725, 0.585, f"{field.name.capitalize()} ({field.unit})", **HEADING)
    handles = []
    for meaning, level, style in inside:
        bar.ax.axhline(level, color=RED, ls=style, lw=1.8)
        label = f"below {level:.3g}: cells {meaning}"
        handles.append(Line2D([], [], color=RED, ls=style, lw=1.8, label=label))
    if handles:
        figure.legend(handles=handles, loc="upper left", bbox_to_anchor=(0.713, 0.25))


def _scale_bar(axes: Axes, middle: FloatArray, half: float) -> None:
    """Draw a bar of a round length in the lower left corner."""
    length = max(
        n for n in (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000) if n <= 0.6 * half
    )
    left = axes.get_xlim()[0] + 0.07 * half
    low = middle[1] - 0.93 * half
    axes.plot([left, left + length], [low, low], color=INK, lw=5, solid_capstyle="butt", zorder=5)
    axes.text(left + 0.5 * length, low + 0.035 * half, f"{length} µm", ha="center", zorder=5)


def _section_legend(
    figure: Figure, group: IntArray, palette: Mapping[str, str], title: str
) -> None:
    """Explain the colours, with the number of cells of each group in the section."""
    counts = np.bincount(group, minlength=len(palette)).tolist()
    shown = [(name, palette[name], n) for name, n in zip(palette, counts, strict=True) if n]
    handles = [Line2D([], [], ls="", marker="o", ms=11, color=colour) for _, colour, _ in shown]
    labels = [f"{type_label(name)} ({n:,})" for name, _, n in shown]
    figure.legend(
        handles,
        labels,
        loc="upper left",
        bbox_to_anchor=(0.71, 0.87),
        title=title,
        title_fontproperties={"weight": "bold", "size": 13},
        alignment="left",
    )
