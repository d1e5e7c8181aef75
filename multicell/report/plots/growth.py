"""Growth of a population: numbers, diameters and states against time; columns of several runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullFormatter

from multicell.cells import FloatArray
from multicell.errors import OutputError
from multicell.report.plots import style
from multicell.report.wording import TimeUnit, cell_count, time_unit, written
from multicell.results.quantities import known_unit, title_of
from multicell.scene.nutrient import Nutrient
from multicell.scene.scene import Scene
from multicell.schema import near_miss

_MAX_MARKED: Final = 12  # switches of the medium, above which lines would hide the curves


@style.styled
def growth(history: style.History, scene: Scene) -> Figure:
    """Draw number of cells, diameter and states against time; switches of media are marked."""
    unit, time, subtitle = _course(history)
    figure = style.headed(scene, subtitle)
    rim = np.isfinite(history["viable_rim"]).any()  # there is none without a core
    rows = 3 if rim else 2
    place = {"left": 0.1, "right": 0.97, "top": 0.82, "bottom": 0.11, "wspace": 0.3}
    grid = figure.add_gridspec(rows, 2, hspace=0.34, **place)
    _draw_count(figure.add_subplot(grid[0, 0]), time, history["cells"])
    _draw_size(figure.add_subplot(grid[1, 0]), time, history)
    if rim:
        _draw_rim(figure.add_subplot(grid[2, 0]), time, history)
    _draw_states(figure.add_subplot(grid[:, 1]), time, history)
    style.time_axes(figure.axes, time, unit)
    _mark_media(figure.axes[0], scene.nutrients, style.span(time), unit)
    for axes in figure.axes[: rows - 1]:
        axes.set_xlabel("")
        if rows == 3:  # little room between three
            axes.tick_params(labelbottom=False)
    return figure


@style.styled
def motion(history: style.History, scene: Scene) -> Figure:
    """Draw diameter and largest pressure against time, for cells that only move."""
    unit, time, subtitle = _course(history)
    figure = style.headed(scene, subtitle)
    upper, lower = style.panel_grid(figure, 2, 1, (0.1, 0.11, 0.97, 0.82), (0.0, 0.32))
    size = history["diameter"]
    if not np.isfinite(size).all():
        _draw_count(upper, time, history["cells"])
    else:
        _draw_size(upper, time, history)
        room = float(np.ptp(size))
        if room > 0.01 * float(size.max()):  # else noise would fill the picture
            upper.set_ylim(float(size.min()) - 0.1 * room, float(size.max()) + 0.1 * room)
    _draw_pressure(lower, time, history)
    style.time_axes((upper, lower), time, unit)
    upper.set_xlabel("")
    return figure


@style.styled
def overlay(runs: Mapping[str, style.History], quantity: str) -> Figure:
    """Draw a column of the histories of runs against time.

    - ``runs``: histories by the names that the legend gives them
    - ``quantity``: name of the column
    """
    for label, history in runs.items():
        columns = [name for name in history if name != "time"]
        if not columns:
            raise OutputError(f"the run '{label}' has no history yet")
        if quantity not in history:
            hint = near_miss(quantity, columns)
            raise OutputError(f"the history of '{label}' has no {quantity!r}. {hint}")
    unit = time_unit(max(float(history["time"][-1]) for history in runs.values()))
    title = title_of(quantity).capitalize()
    figure = style.blank(title, "one run" if len(runs) == 1 else f"{len(runs)} runs")
    axes = figure.add_axes((0.1, 0.11, 0.6, 0.72))
    colours = style.type_colours(runs)
    for k, (label, history) in enumerate(runs.items()):
        time = history["time"] / unit.seconds
        axes.plot(
            time,
            history[quantity],
            color=colours[label],
            lw=2,
            label=style.type_label(label),
            ls=("-", "--", "-.", ":")[k % 4],
            marker="" if len(time) > 1 else "o",
        )
    dimension = known_unit(quantity)
    axes.set_xlabel(f"time ({unit.name})")
    axes.set_ylabel(f"{title.lower()} ({written(dimension)})" if dimension else title.lower())
    times = np.concatenate([history["time"] for history in runs.values()])
    axes.set_xlim(*style.span(np.sort(times) / unit.seconds))
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.02))
    return figure


def _course(history: style.History) -> tuple[TimeUnit, FloatArray, str]:
    """Return the unit of time, the times in it, and number of cells and time in words."""
    if len(history.get("time", ())) == 0:
        raise ValueError("the history is empty: there is nothing to draw")
    last = float(history["time"][-1])
    unit = time_unit(last)
    subtitle = f"{cell_count(history['cells'][-1])} after {unit.text(last)}"
    return unit, history["time"] / unit.seconds, subtitle


def _draw_count(axes: Axes, time: FloatArray, cells: FloatArray) -> None:
    """Draw the number of cells, on a log scale where it grows much."""
    axes.set_title("Cells")
    style.draw_line(axes, time, cells, style.INK)
    if cells.min() > 0 and cells.max() >= 5 * cells.min():
        axes.set_yscale("log")
        style.counts(axes.yaxis)
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.set_ylabel("number")
    else:
        _count_axis(axes, 1.08 * float(cells.max()))


def _count_axis(axes: Axes, largest: float) -> None:
    axes.set_ylim(0.0, largest if largest > 0 else 1.0)
    axes.yaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
    style.counts(axes.yaxis)
    axes.set_ylabel("number")


def _draw_pressure(axes: Axes, time: FloatArray, history: style.History) -> None:
    style.draw_line(axes, time, 1000.0 * history["largest_pressure"], style.RED)
    axes.set(title="Largest pressure of a cell", ylabel="pressure (Pa)")


def _draw_size(axes: Axes, time: FloatArray, history: style.History) -> None:
    """Draw the diameter, or the largest pressure where space repeats: there is no diameter."""
    if not np.isfinite(history["diameter"]).all():
        _draw_pressure(axes, time, history)
        return
    whole, core = history["diameter"], 2.0 * history["necrotic_radius"]
    style.draw_line(axes, time, whole, style.BLUE, label="whole")
    if core.max() > 0:
        shown = np.where(core > 0, core, np.nan)
        axes.plot(
            time, shown, color=style.STATE_COLOURS["necrotic"], lw=2, ls="--", label="necrotic core"
        )
        axes.legend(loc="upper left", fontsize=9, ncols=2)
    # room for the legend above the line
    axes.set_ylim(0.0, (1.5 if core.max() > 0 else 1.1) * max(float(whole.max()), 1.0))
    axes.set(title="Diameter", ylabel="diameter (µm)")


def _draw_rim(axes: Axes, time: FloatArray, history: style.History) -> None:
    """Draw the layer outside the necrotic core, since there is one, and the one that grows."""
    for name, colour in (
        ("viable", style.INK),
        ("proliferating", style.STATE_COLOURS["proliferating"]),
    ):
        thickness = history.get(f"{name}_rim")  # older runs have no proliferating one
        if thickness is not None and np.isfinite(thickness).any():
            style.draw_line(axes, time, thickness, colour, label=name)
    top = 1.15 * max(float(np.nanmax(history["viable_rim"])), 1.0)
    axes.set(title="Rim", ylabel="thickness (µm)", ylim=(0.0, top))
    axes.legend(loc="upper left", fontsize=9, ncols=2)


def _draw_states(axes: Axes, time: FloatArray, history: style.History) -> None:
    axes.set_title("Cells by state")
    names = [name for name in reversed(style.STATE_COLOURS) if history[name].max() > 0]
    single = len(time) == 1
    axes.stackplot(
        style.span(time) if single else time,
        [np.repeat(history[name], 2 if single else 1) for name in names],
        colors=[style.STATE_COLOURS[name] for name in names],
        labels=names,
        lw=0,
    )
    # room for the legend above a flat top
    _count_axis(axes, 1.25 * float(history["cells"].max()))
    handles, labels = axes.get_legend_handles_labels()
    axes.legend(handles[::-1], labels[::-1], loc="upper left", handlelength=1.0)


def _mark_media(
    axes: Axes, nutrients: Mapping[str, Nutrient], span: tuple[float, float], unit: TimeUnit
) -> None:
    """Mark when the medium of a field is switched, with its new value where there is room."""
    begin, end = span[0] * unit.seconds, span[1] * unit.seconds
    found = sorted((time, name) for name, n in nutrients.items() for time in n.switches(begin, end))
    for time, name in found[:_MAX_MARKED]:
        axes.axvline(time / unit.seconds, color=style.INK, lw=1.0, ls=":", zorder=1)
        text = f" {style.type_label(name)} {nutrients[name].medium(time):.3g} mM"
        axes.text(
            time / unit.seconds,
            0.03,
            text,
            rotation=90,
            ha="right",
            va="bottom",
            fontsize=9,
            color=style.INK,
            transform=axes.get_xaxis_transform(),
        )
