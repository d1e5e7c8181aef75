"""Pictures of runs with several fields: a map and a profile of each, and switched media."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, ScalarFormatter

from multicell.cells import FloatArray, State
from multicell.report.plots import style
from multicell.report.plots.section import (
    draw_discs,
    draw_field,
    draw_necrotic,
    frame_window,
    window,
)
from multicell.report.wording import TimeUnit
from multicell.results.frame import Frame
from multicell.results.observables import centre
from multicell.scene.nutrient import Nutrient
from multicell.scene.scene import Scene

_MAX_MARKED: Final = 12  # switches of the medium, above which lines would hide the curves


@style.styled
def field_maps(frame: Frame, scene: Scene) -> Figure:
    """Draw the cells that the plane z = centre cuts, and beside them a map of every field.

    A line shows where cells begin to rest, a dashed one where most are necrotic.
    """
    shown = [name for name in scene.nutrients if name in frame.fields]
    if not shown:
        raise ValueError("the frame has no fields: there is nothing to map")
    cells, middle = frame.cells, centre(frame.cells, scene.dimensions)
    cut = cells.radius**2 - (cells.position[:, 2] - middle[2]) ** 2
    place, radius = cells.position[cut > 0.0, :2], np.sqrt(cut[cut > 0.0])
    half = window(frame, scene)
    figure = style.headed(
        scene, f"{style.moment(frame)}: section through the centre, {2 * half:.0f} µm wide"
    )
    columns = min(len(shown) + 1, 3) if len(shown) < 3 else (len(shown) + 2) // 2
    grid = figure.add_gridspec(
        -(-(len(shown) + 1) // columns), columns,
        left=0.04, right=0.93, top=0.81, bottom=0.06, wspace=0.34, hspace=0.26,
    )  # fmt: skip
    words = [style.type_label(name.replace("_", " "), 15).capitalize() for name in shown]
    titles = ["Cells by state", *(f"{name} (mM)" for name in words)]
    windows = [figure.add_subplot(grid[k]) for k in range(len(titles))]
    for axes, title in zip(windows, titles, strict=True):
        axes.set_title(title)
        frame_window(axes, middle, half)
        axes.grid(False)
    colours = np.array([to_rgb(style.COLOURS[state.name.lower()]) for state in State])
    draw_discs(windows[0], place, radius, colours[cells.state[cut > 0.0]])
    for axes, name in zip(windows[1:], shown, strict=True):
        nutrient, field = scene.nutrients[name], frame.fields[name]
        # of a finite medium what was left
        ledger = {} if frame.progress is None else frame.progress.ledger.get(name, {})
        medium = float(ledger.get("level", nutrient.medium(frame.time)))
        viridis = mpl.colormaps["viridis"]
        shades, _ = draw_field(axes, field, float(middle[2]), nutrient, medium, None, viridis)
        if nutrient.necrosis is not None:
            draw_necrotic(axes, cells, cells.position, float(middle[2]))
        bar = figure.colorbar(shades, cax=axes.inset_axes((1.03, 0.0, 0.05, 1.0)))
        bar.outline.set_visible(False)
        bar.locator = MaxNLocator(5, prune="both")  # two bars may stand one above the other
        bar.formatter = ScalarFormatter(useOffset=False)
        bar.ax.tick_params(labelsize=9)
        bar.ax.grid(False)
    return figure


def draw_hypoxic(axes: Axes, time: FloatArray, history: Mapping[str, FloatArray]) -> float:
    """Draw the diameter within which cells lack each field; return the largest."""
    prefix, largest = "hypoxic_radius_", 0.0
    names = [column for column in history if column.startswith(prefix)]
    for k, column in enumerate(names):
        size = 2.0 * history[column]
        if size.max() > 0.0:
            label = f"lacks {style.type_label(column.removeprefix(prefix))}"
            shown = np.where(size > 0, size, np.nan)
            colour = (style.COLOURS["quiescent"], style.RED, style.QUIET)[k % 3]
            axes.plot(time, shown, color=colour, lw=1.8, ls=("-.", ":")[k % 2], label=label)
            largest = max(largest, float(size.max()))
    return largest


def mark_media(
    axes: Axes, nutrients: Mapping[str, Nutrient], span: tuple[float, float], unit: TimeUnit
) -> None:
    """Mark when the medium of a field is switched, with its new value where there is room."""
    begin, end = span[0] * unit.seconds, span[1] * unit.seconds
    found = sorted((time, name) for name, n in nutrients.items() for time in n.switches(begin, end))
    for time, name in found[:_MAX_MARKED]:
        axes.axvline(time / unit.seconds, color=style.INK, lw=1.0, ls=":", zorder=1)
        text = f" {style.type_label(name)} {nutrients[name].medium(time):.3g} mM"
        axes.text(
            time / unit.seconds, 0.03, text, rotation=90, ha="right", va="bottom",
            fontsize=9, color=style.INK, transform=axes.get_xaxis_transform(),
        )  # fmt: skip
