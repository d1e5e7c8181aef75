"""Pictures of runs with several fields: a map and a profile of each, and switched media."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from multicell.cells import FloatArray, State
from multicell.report.plots.section import draw_circles, refined
from multicell.report.plots.style import (
    BLUE,
    COLOURS,
    INK,
    QUIET,
    RED,
    TimeUnit,
    blank,
    moment,
    styled,
    thresholds,
    type_label,
)
from multicell.results.frame import Field, Frame
from multicell.results.observables import RadialProfile, centre, field_profile, uniform_radius

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from multicell.scene.nutrient import Nutrient


_MARKED: Final = 12  # switches of the medium, above which lines would hide the curves


@styled
def field_maps(
    frame: Frame, title: str, nutrients: Mapping[str, Nutrient], dimensions: int
) -> Figure:
    """Draw the cells that the plane z = centre cuts, and beside them a map of every field.

    Parameters
    ----------
    frame
        What to draw.
    title
        Heading.
    nutrients : name -> Nutrient
        Thresholds, drawn as contour lines, in the order of the maps.
    dimensions
        Of the scene.

    Raises
    ------
    ValueError
        If the frame has no cells or no fields.
    """
    shown = [name for name in nutrients if name in frame.fields]
    if not shown:
        raise ValueError("the frame has no fields: there is nothing to map")
    cells, middle = frame.cells, centre(frame.cells, dimensions)
    cut = cells.radius**2 - (cells.position[:, 2] - middle[2]) ** 2
    place, radius = cells.position[cut > 0.0, :2], np.sqrt(cut[cut > 0.0])
    half = 1.22 * uniform_radius(cells, middle, dimensions) + 2.0 * float(cells.radius.max())
    figure = blank(title, f"{moment(frame)}: section through the centre, {2 * half:.0f} µm wide")
    columns = min(len(shown) + 1, 3) if len(shown) < 3 else (len(shown) + 2) // 2
    grid = figure.add_gridspec(
        -(-(len(shown) + 1) // columns), columns,
        left=0.04, right=0.93, top=0.81, bottom=0.06, wspace=0.34, hspace=0.26,
    )  # fmt: skip
    axes = _window(figure, grid[0], middle, half, "Cells by state")
    draw_circles(
        axes, place, radius, cells.state[cut > 0.0], [COLOURS[s.name.lower()] for s in State]
    )
    for k, name in enumerate(shown, start=1):
        axes = _window(figure, grid[k], middle, half, f"{type_label(name).capitalize()} (mM)")
        _map(figure, axes, frame.fields[name], float(middle[2]), nutrients[name], frame.time)
    return figure


def _window(figure: Figure, place: object, middle: FloatArray, half: float, title: str) -> Axes:
    """Return axes of equal scale about the centre."""
    axes: Axes = figure.add_subplot(place)  # type: ignore[call-overload]
    axes.set(title=title, xticks=[], yticks=[], aspect="equal")
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)
    axes.grid(False)
    return axes


def _map(
    figure: Figure, axes: Axes, field: Field, z: float, nutrient: Nutrient, time: float
) -> None:
    """Draw one field over its own range, around it the medium, and its thresholds as lines."""
    field = field.in_plane(z) if field.kind == "radial" else field
    x, y, plane = refined(field, z)
    medium = nutrient.medium(time)
    low, top = min(float(plane.min()), medium), max(float(plane.max()), medium)
    top = top if top > low else low + 1.0
    colours = mpl.colormaps["viridis"]
    axes.set_facecolor(colours((medium - low) / (top - low)))
    window = axes.axis()
    step = 0.5 * (x[1] - x[0])
    extent = (x[0] - step, x[-1] + step, y[0] - step, y[-1] + step)
    shades = axes.imshow(
        plane, extent=extent, origin="lower", cmap=colours, vmin=low, vmax=top, zorder=0
    )
    for _, level, style in thresholds(nutrient):
        if plane.min() < level < plane.max():
            axes.contour(x, y, plane, levels=[level], colors="white", linewidths=3.4)
            axes.contour(x, y, plane, levels=[level], colors=RED, linewidths=1.7, linestyles=style)
    axes.axis(window)
    beside = axes.inset_axes((1.03, 0.0, 0.05, 1.0))
    bar = figure.colorbar(shades, cax=beside)
    bar.outline.set_visible(False)
    bar.ax.tick_params(labelsize=9)
    bar.ax.grid(False)


def draw_profile(
    axes: Axes,
    frame: Frame,
    profile: RadialProfile,
    name: str,
    nutrient: Nutrient,
    dimensions: int,
) -> None:
    """Draw one field against the radius in its own unit: line the field, points the cells."""
    values = profile.concentrations[name]
    shown = [float(np.nanmax(values))]
    if name in frame.fields:
        field = frame.fields[name]
        edges = np.arange(0.0, profile.edges[-1] + field.spacing, field.spacing)
        means = field_profile(field, centre(frame.cells, dimensions), edges)
        filled = np.isfinite(means)
        middles = 0.5 * (edges[1:] + edges[:-1])
        axes.plot(middles[filled], means[filled], color=BLUE, lw=2, alpha=0.6, label="field")
        shown.append(float(means[filled].max(initial=0.0)))
    axes.plot(profile.middles, values, "o", color=BLUE, ms=5, label="at the cells", zorder=4)
    for meaning, level, style in thresholds(nutrient):
        if 0.0 < level < 1.1 * max(shown):  # within the axis
            axes.axhline(level, color=RED, lw=1.4, ls=style, label=f"below: cells {meaning}")
    axes.set(title=type_label(name).capitalize(), ylabel="mM")
    top = max(shown)
    axes.set_ylim(0.0, 1.1 * top if top > 0.0 else 1.0)


def draw_hypoxic(axes: Axes, time: FloatArray, history: Mapping[str, FloatArray]) -> float:
    """Draw the diameter within which cells lack each field, and the rim; return the largest."""
    prefix, largest = "hypoxic_radius_", 0.0
    names = [column for column in history if column.startswith(prefix)]
    for k, column in enumerate(names):
        size = 2.0 * history[column]
        if size.max() > 0.0:
            label = f"lacks {type_label(column.removeprefix(prefix))}"
            shown = np.where(size > 0, size, np.nan)
            colour = (COLOURS["quiescent"], RED, QUIET)[k % 3]
            axes.plot(time, shown, color=colour, lw=1.8, ls=("-.", ":")[k % 2], label=label)
            largest = max(largest, float(size.max()))
    rim = history["viable_rim"]  # there is none without a core
    if np.isfinite(rim).any():
        axes.plot(time, rim, color=COLOURS["proliferating"], lw=1.8, label="viable rim (thickness)")
    return largest


def mark_media(
    axes: Axes, nutrients: Mapping[str, Nutrient], span: tuple[float, float], unit: TimeUnit
) -> None:
    """Mark when the medium of a field is switched, with its new value where there is room."""
    begin, end = span[0] * unit.seconds, span[1] * unit.seconds
    found = sorted((time, name) for name, n in nutrients.items() for time in n.switches(begin, end))
    for time, name in found[:_MARKED]:
        axes.axvline(time / unit.seconds, color=INK, lw=1.0, ls=":", zorder=1)
        text = f" {type_label(name)} {nutrients[name].medium(time):.3g} mM"
        axes.text(
            time / unit.seconds, 0.03, text, rotation=90, ha="right", va="bottom",
            fontsize=9, color=INK, transform=axes.get_xaxis_transform(),
        )  # fmt: skip
