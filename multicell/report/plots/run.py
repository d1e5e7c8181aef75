"""Pictures of a run: growth, section, radial profiles, contacts of types, pull.

Every function returns a :class:`matplotlib.figure.Figure` of about 1600 x 1000 pixels and
leaves matplotlib's global state alone. The colours of the states differ in lightness too, so
that they can be told apart with any colour vision and in grey.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter
from numpy.typing import NDArray

from multicell.cells import FloatArray
from multicell.report.plots.contacts import contacts, pull
from multicell.report.plots.fields import draw_hypoxic, draw_profile, field_maps, mark_media
from multicell.report.plots.section import section
from multicell.report.plots.style import (
    BLUE,
    COLOURS,
    INK,
    RED,
    TimeUnit,
    blank,
    cell_count,
    moment,
    styled,
    thresholds,
    time_unit,
    type_colours,
    type_label,
)
from multicell.results.frame import Field, Frame
from multicell.results.observables import (
    RadialProfile,
    centre,
    distances,
    field_profile,
    radial_profile,
    uniform_radius,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from multicell.scene.nutrient import Nutrient
    from multicell.scene.scene import Scene


History = Mapping[str, NDArray[np.float64]]


@final
class Plots:
    """The pictures of one run; see :class:`multicell.report.result.Result`."""

    def __init__(self, frames: Sequence[Frame], history: History, scene: Scene) -> None:
        self._frames = frames
        self._history = history
        self._scene = scene
        self._title = scene.title or "Untitled run"

    def growth(self) -> Figure:
        """Draw number of cells, diameter and states against time.

        Where nothing grows or starves these numbers stay: it is diameter and pressure then.

        Raises
        ------
        ValueError
            If the run has no history yet.
        """
        alive = self._scene.growth is not None or len(self._scene.nutrients) > 0
        if alive:
            return growth(self._history, self._title, self._scene.nutrients)
        return motion(self._history, self._title)

    def section(self, frame: int = -1) -> Figure:
        """Show the cells that the plane z = centre cuts, at frame number ``frame``."""
        scene, shown = self._scene, self._frames[frame]
        return section(shown, self._title, scene.nutrients, list(scene.types), scene.dimensions)

    def fields(self, frame: int = -1) -> Figure:
        """Show a map of every field in the plane z = centre, at frame number ``frame``."""
        scene, shown = self._scene, self._frames[frame]
        return field_maps(shown, self._title, scene.nutrients, scene.dimensions)

    def profiles(self, frame: int = -1) -> Figure:
        """Concentration (or pressure) and states against the distance from the centre."""
        scene = self._scene
        shown = self._frames[frame]
        return profiles(shown, self._title, scene.nutrients, list(scene.types), scene.dimensions)

    def contacts(self) -> Figure:
        """Draw the contacts between unlike cells against time, and where each type is.

        Raises
        ------
        ValueError
            If the scene has fewer than two cell types, or there is no history yet.
        """
        return contacts(self._frames, self._history, self._scene, self._title)

    def pull(self) -> Figure:
        """Draw the pull against the distance of two cells, or the diameter of more.

        Raises
        ------
        ValueError
            If the scene does not pull, or there is no history yet.
        """
        return pull(self._frames, self._history, self._scene, self._title)


@styled
def growth(history: History, title: str, nutrients: Mapping[str, Nutrient] | None = None) -> Figure:
    """Draw number of cells, diameter and states against time.

    Parameters
    ----------
    history : column name -> (m,)
        Columns of :func:`multicell.results.observables.history_row`.
    title
        Heading.
    nutrients : name -> Nutrient, optional
        Their switches of the medium are marked.

    Raises
    ------
    ValueError
        If the history is empty.
    """
    unit, time, subtitle = _course(history)
    cells = history["cells"]
    figure = blank(title, subtitle)
    grid = figure.add_gridspec(
        2, 2, left=0.1, right=0.97, top=0.82, bottom=0.11, wspace=0.3, hspace=0.34
    )
    _draw_count(figure.add_subplot(grid[0, 0]), time, cells)
    _draw_size(figure.add_subplot(grid[1, 0]), time, history)
    _draw_states(figure.add_subplot(grid[:, 1]), time, history)
    for axes in figure.axes:
        axes.set_xlim(*_span(time))
        axes.set_xlabel(f"time ({unit.name})")
    mark_media(figure.axes[0], nutrients or {}, _span(time), unit)
    figure.axes[0].set_xlabel("")
    return figure


@styled
def motion(history: History, title: str) -> Figure:
    """Draw diameter and largest pressure against time, for cells that only move.

    Parameters and errors are those of :func:`growth`.
    """
    unit, time, subtitle = _course(history)
    figure = blank(title, subtitle)
    grid = figure.add_gridspec(2, 1, left=0.1, right=0.97, top=0.82, bottom=0.11, hspace=0.32)
    upper = figure.add_subplot(grid[0])
    _draw_size(upper, time, history)
    size = history["diameter"]
    room = float(np.ptp(size))
    if room > 0.01 * float(size.max()):  # else noise would fill the picture
        upper.set_ylim(float(size.min()) - 0.1 * room, float(size.max()) + 0.1 * room)
    lower = figure.add_subplot(grid[1])
    lower.plot(time, 1000.0 * history["largest_pressure"], _mark(time), color=RED, lw=2)
    lower.set(title="Largest pressure of a cell", ylabel="pressure (Pa)")
    lower.set_xlabel(f"time ({unit.name})")
    for axes in (upper, lower):
        axes.set_xlim(*_span(time))
    return figure


def _course(history: History) -> tuple[TimeUnit, FloatArray, str]:
    """Return the unit of time, the times in it, and number of cells and time in words."""
    if len(history.get("time", ())) == 0:
        raise ValueError("the history is empty: there is nothing to draw")
    last = float(history["time"][-1])
    unit = time_unit(last)
    subtitle = f"{cell_count(history['cells'][-1])} after {unit.text(last)}"
    return unit, history["time"] / unit.seconds, subtitle


def _span(time: FloatArray) -> tuple[float, float]:
    """Return the range of times to show, which has a width even for one moment."""
    first, last = float(time[0]), float(time[-1])
    return (first, last) if last > first else (first - 0.5, first + 0.5)


def _mark(time: FloatArray) -> str:
    """Return a line, or a point where one moment makes no line."""
    return "-" if len(time) > 1 else "o"


def _draw_count(axes: Axes, time: FloatArray, cells: FloatArray) -> None:
    """Draw the number of cells, on a log scale where it grows much."""
    axes.set_title("Cells")
    axes.plot(time, cells, _mark(time), color=INK, lw=2)
    if cells.min() > 0 and cells.max() >= 5 * cells.min():
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.set_ylabel("number (log scale)")
    else:
        _count_axis(axes, 1.08 * float(cells.max()))


def _count_axis(axes: Axes, largest: float) -> None:
    """Give an axis of counts that starts at zero."""
    axes.set_ylim(0.0, largest if largest > 0 else 1.0)
    axes.yaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
    axes.set_ylabel("number")


def _draw_size(axes: Axes, time: FloatArray, history: History) -> None:
    """Draw the diameters of the population and of its necrotic core."""
    axes.set_title("Diameter")
    whole, core = history["diameter"], 2.0 * history["necrotic_radius"]
    axes.plot(time, whole, _mark(time), color=BLUE, lw=2, label="whole")
    if core.max() > 0:
        shown = np.where(core > 0, core, np.nan)
        axes.plot(time, shown, color=COLOURS["necrotic"], lw=2, ls="--", label="necrotic core")
    lacking = draw_hypoxic(axes, time, history)
    if core.max() > 0 or lacking > 0:
        axes.legend(loc="upper left", fontsize=9, ncols=2)
    # room for the legend above the line
    room = 1.7 if core.max() > 0 or lacking > 0 else 1.1
    axes.set_ylim(0.0, room * max(float(whole.max()), 1.0))
    axes.set_ylabel("diameter (µm)")


def _draw_states(axes: Axes, time: FloatArray, history: History) -> None:
    """Draw the numbers of cells in each state on top of each other, necrotic ones below."""
    axes.set_title("Cells by state")
    names = [name for name in reversed(COLOURS) if history[name].max() > 0]
    single = len(time) == 1
    axes.stackplot(
        _span(time) if single else time,
        [np.repeat(history[name], 2 if single else 1) for name in names],
        colors=[COLOURS[name] for name in names],
        labels=names,
        lw=0,
    )
    held = history.get("held_by_pressure", np.zeros(1))
    if held.max() > 0:  # above the dead, whom nothing holds back
        dead = history["necrotic"] + history["apoptotic"]
        label = "living, growth halved by pressure"
        axes.plot(time, dead + held, _mark(time), color=INK, lw=2, label=label)
    # room for the legend above a flat top
    _count_axis(axes, (1.25 if held.max() == 0 else 1.35) * float(history["cells"].max()))
    handles, labels = axes.get_legend_handles_labels()
    axes.legend(handles[::-1], labels[::-1], loc="upper left", handlelength=1.0)


@styled
def profiles(
    frame: Frame,
    title: str,
    nutrients: Mapping[str, Nutrient],
    types: Sequence[str],
    dimensions: int,
) -> Figure:
    """Draw concentrations, or pressure without nutrients, and states against the radius.

    Where there is more than one cell type the lower part shows types instead of states.

    Parameters
    ----------
    frame
        What to draw.
    title
        Heading.
    nutrients : name -> Nutrient
        Thresholds to mark.
    types
        Names of the cell types.
    dimensions
        Of the scene: 3 for shells about the centre, 2 for rings.

    Raises
    ------
    ValueError
        If the frame has no cells.
    """
    middle = centre(frame.cells, dimensions)
    # shells about a cell wide, but never so few that a profile cannot be seen
    size = uniform_radius(frame.cells, middle, dimensions)
    bins = int(np.clip(size / (2.0 * frame.cells.radius.mean()), 4, 40))
    profile = radial_profile(frame, dimensions, bins)
    shells = "shells" if dimensions == 3 else "rings"
    figure = blank(title, f"{moment(frame)}: averages over {shells} about the centre")
    if len(profile.concentrations) > 1:
        _field_panels(figure, frame, profile, nutrients, types, dimensions)
        return figure
    grid = figure.add_gridspec(2, 1, left=0.09, right=0.77, top=0.82, bottom=0.11, hspace=0.32)
    upper = figure.add_subplot(grid[0])
    lower = figure.add_subplot(grid[1], sharex=upper)
    r = profile.middles
    if frame.concentrations:
        for name, values in profile.concentrations.items():
            _draw_concentration(upper, r, values, name, nutrients[name])
            if name in frame.fields:
                _draw_field_line(upper, frame.fields[name], middle, profile.edges)
        upper.set(title="Concentration", ylabel="concentration (mM)")
        upper.set_ylim(bottom=0.0)
    else:
        upper.plot(r, 1000.0 * profile.pressure, "o-", color=BLUE, lw=2, label="mean pressure")
        upper.set(title="Pressure", ylabel="pressure (Pa)")
    _draw_parts(lower, frame, profile, types, dimensions)
    for axes in (upper, lower):
        handles, labels = axes.get_legend_handles_labels()
        axes.legend(handles[::-1], labels[::-1], loc="upper left", bbox_to_anchor=(1.01, 1.03))
    return figure


def _field_panels(
    figure: Figure,
    frame: Frame,
    profile: RadialProfile,
    nutrients: Mapping[str, Nutrient],
    types: Sequence[str],
    dimensions: int,
) -> None:
    """Draw a panel for each field in its own range, and one for the states or types."""
    names = list(profile.concentrations)
    rows = (len(names) + 2) // 2
    grid = figure.add_gridspec(
        rows, 2, left=0.1, right=0.97, top=0.82, bottom=0.1, wspace=0.24, hspace=0.5
    )
    for k, name in enumerate(names):
        axes = figure.add_subplot(grid[k // 2, k % 2])
        draw_profile(axes, frame, profile, name, nutrients[name], dimensions)
        axes.set_xlim(0.0, float(profile.edges[-1]))
        axes.legend(loc="best", fontsize=9)
    axes = figure.add_subplot(grid[len(names) // 2, len(names) % 2])
    _draw_parts(axes, frame, profile, types, dimensions)
    axes.set_ylim(0, 125)  # room for the legend above the bars
    axes.set_yticks([0, 25, 50, 75, 100])
    axes.legend(loc="upper left", fontsize=9, ncols=3)
    for axes in figure.axes[-2:]:
        axes.set_xlabel("distance from the centre (µm)")


def _draw_parts(
    axes: Axes, frame: Frame, profile: RadialProfile, types: Sequence[str], dimensions: int
) -> None:
    """Draw which part of the cells of each shell is in a state or of a type."""
    middle, bottom = centre(frame.cells, dimensions), np.zeros(len(profile.counts))
    width = np.diff(profile.edges)
    by_type = len(types) > 1
    parts = _types_by_shell(frame, middle, profile.edges, types) if by_type else profile.fractions
    colours = {**COLOURS, **(type_colours(types) if by_type else {})}
    for name in [n for n in reversed(colours) if n in parts and np.nansum(parts[n]) > 0]:
        part = np.nan_to_num(100.0 * parts[name])
        axes.bar(
            profile.middles, part, width, bottom, color=colours[name], label=type_label(name), lw=0
        )
        bottom += part
    title_below = "Cells by type" if by_type else "Cells by state"
    axes.set(title=title_below, ylabel="part of the cells (%)", ylim=(0, 100))
    axes.set(xlabel="distance from the centre (µm)", xlim=(0.0, float(profile.edges[-1])))


def _types_by_shell(
    frame: Frame, middle: FloatArray, edges: FloatArray, types: Sequence[str]
) -> dict[str, FloatArray]:
    """Return the part of the cells of each shell that are of a type: name -> (b,)."""
    radius = distances(frame.cells, middle)
    counts = [np.histogram(radius[frame.cells.kind == k], edges)[0] for k in range(len(types))]
    whole = np.maximum(np.sum(counts, axis=0), 1)
    return {name: count / whole for name, count in zip(types, counts, strict=True)}


def _draw_concentration(
    axes: Axes, r: FloatArray, values: FloatArray, name: str, nutrient: Nutrient
) -> None:
    """Draw the mean concentration at the cells, and thresholds that lie in its range."""
    top = float(np.nanmax(values))
    for meaning, level, style in thresholds(nutrient):
        if 0.0 < level < 1.2 * top:
            label = f"below {level:.3g} mM:\ncells {meaning}"
            axes.axhline(level, color=RED, lw=1.4, ls=style, label=label)
    axes.plot(r, values, "o", color=BLUE, ms=6, label=f"{name}\nat the cells", zorder=4)


def _draw_field_line(axes: Axes, field: Field, middle: FloatArray, edges: FloatArray) -> None:
    """Draw the mean of the field by shell, one shell to a grid spacing."""
    shells = np.arange(0.0, edges[-1] + field.spacing, field.spacing)
    means = field_profile(field, middle, shells)
    filled = np.isfinite(means)
    axes.plot(
        0.5 * (shells[1:] + shells[:-1])[filled],
        means[filled],
        color=BLUE,
        lw=2,
        alpha=0.6,
        label=f"{field.name}\nfield",
    )
