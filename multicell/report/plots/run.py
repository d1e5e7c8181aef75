"""Pictures of a run: growth, section, fields, radial profiles, contacts of types, pull.

Every function returns a :class:`matplotlib.figure.Figure` of about 1600 x 1000 pixels and
leaves matplotlib's global state alone. The colours of the states differ in lightness too, so
that they can be told apart with any colour vision and in grey.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullFormatter
from numpy.typing import NDArray

from multicell.cells import FloatArray
from multicell.report.plots.contacts import contacts, pull
from multicell.report.plots.fields import draw_hypoxic, field_maps, mark_media
from multicell.report.plots.overlay import overlay
from multicell.report.plots.plane import Plane
from multicell.report.plots.profiles import profiles
from multicell.report.plots.section import section
from multicell.report.plots.style import (
    BLUE,
    COLOURS,
    INK,
    RED,
    History,
    counts,
    draw_style,
    headed,
    span,
    styled,
)
from multicell.report.wording import TimeUnit, cell_count, time_unit
from multicell.results.frame import Frame

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from multicell.report.result import Result
    from multicell.scene.scene import Scene


@final
class Plots:
    """The pictures of one run; see :class:`multicell.report.result.Result`.

    Where there is nothing to draw (no history yet, a frame without cells, no second type, no
    pull) they raise ``ValueError``.
    """

    def __init__(
        self,
        frames: Sequence[Frame],
        history: History,
        scene: Scene,
        lineage: Mapping[str, NDArray[Any]] | None = None,
    ) -> None:
        self._frames = frames
        self._lineage = lineage or {}
        self._history = history
        self._scene = scene

    def growth(self) -> Figure:
        """Draw number of cells, diameter and states against time.

        Where nothing grows or starves these numbers stay: it is diameter and pressure then.
        """
        alive = self._scene.growth is not None or len(self._scene.nutrients) > 0
        return (growth if alive else motion)(self._history, self._scene)

    def section(
        self, frame: int = -1, *, plane: str | None = None, colour: str | None = None
    ) -> Figure:
        """Show the cells that a plane cuts, at frame number ``frame``.

        Parameters
        ----------
        frame
            Its number; negative ones count from the last.
        plane
            ``"x"``, ``"x=0"``, ``"z=12 um"``; absent: z through the centre of the cells.
        colour
            ``"state"``, ``"type"``, ``"phase"``, ``"clone"``, a quantity of the cells such as
            ``"pressure"``, or the name of a field; absent: the types or, where all cells are alike,
            the states.

        Raises
        ------
        OutputError
            For a plane that cuts no cell, and a colour that is none.
        """
        where = None if plane is None else Plane.parse(plane)
        return section(
            self._frames[frame], self._scene, plane=where, colour=colour, lineage=self._lineage
        )

    def space(
        self, frame: int = -1, *, cut: str = "quarter", turn: float = 0.0, colour: str | None = None
    ) -> Figure:
        """Show the cells in space as shaded spheres, at frame number ``frame``.

        Parameters
        ----------
        frame
            Its number; negative ones count from the last.
        cut
            What is cut away through the centre: ``"none"``, ``"half"`` or ``"quarter"``.
        turn
            Degrees by which the eye goes round the z axis, from where cuts open to it.
        colour
            As for :meth:`section`.

        Raises
        ------
        OutputError
            If the cells lie in a plane, and for a cut or a colour that is none.
        """
        from multicell.report.plots.space import space
        from multicell.report.plots.spheres import View

        return space(
            self._frames[frame], self._scene, view=View(turn, cut), colour=colour,
            lineage=self._lineage,
        )  # fmt: skip

    def quantity(self, name: str, others: Mapping[str, Result] | None = None) -> Figure:
        """Draw a column of the history against time, also those of other runs.

        Parameters
        ----------
        name
            Of the column, such as ``"diameter"``.
        others
            Further runs by the names that the legend gives them.

        Raises
        ------
        OutputError
            If a run has no such column.
        """
        runs = {"this run": self._history}
        runs |= {label: run.history for label, run in (others or {}).items()}
        return overlay(runs, name)

    def fields(self, frame: int = -1) -> Figure:
        """Show a map of every field in the plane z = centre, at frame number ``frame``."""
        return field_maps(self._frames[frame], self._scene)

    def profiles(self, frame: int = -1) -> Figure:
        """Concentration (or pressure) and states against the distance from the centre."""
        return profiles(self._frames[frame], self._scene)

    def contacts(self) -> Figure:
        """Draw the contacts between unlike cells against time, and where each type is."""
        return contacts(self._frames, self._history, self._scene)

    def pull(self) -> Figure:
        """Draw the pull against the distance of two cells, or the diameter of more."""
        return pull(self._frames, self._history, self._scene)


@styled
def growth(history: History, scene: Scene) -> Figure:
    """Draw number of cells, diameter and states against time; switches of media are marked.

    Raises
    ------
    ValueError
        If the history is empty.
    """
    unit, time, subtitle = _course(history)
    figure = headed(scene, subtitle)
    rim = np.isfinite(history["viable_rim"]).any()  # there is none without a core
    rows = 3 if rim else 2
    grid = figure.add_gridspec(
        rows, 2, left=0.1, right=0.97, top=0.82, bottom=0.11, wspace=0.3, hspace=0.34
    )
    _draw_count(figure.add_subplot(grid[0, 0]), time, history["cells"])
    _draw_size(figure.add_subplot(grid[1, 0]), time, history)
    if rim:
        _draw_rim(figure.add_subplot(grid[2, 0]), time, history["viable_rim"])
    _draw_states(figure.add_subplot(grid[:, 1]), time, history)
    for axes in figure.axes:
        axes.set_xlim(*span(time))
        axes.set_xlabel(f"time ({unit.name})")
    mark_media(figure.axes[0], scene.nutrients, span(time), unit)
    for axes in figure.axes[: rows - 1]:
        axes.set_xlabel("")
        if rim:  # little room between three
            axes.tick_params(labelbottom=False)
    return figure


@styled
def motion(history: History, scene: Scene) -> Figure:
    """Draw diameter and largest pressure against time, for cells that only move.

    Raises
    ------
    ValueError
        If the history is empty.
    """
    unit, time, subtitle = _course(history)
    figure = headed(scene, subtitle)
    grid = figure.add_gridspec(2, 1, left=0.1, right=0.97, top=0.82, bottom=0.11, hspace=0.32)
    upper, lower = figure.add_subplot(grid[0]), figure.add_subplot(grid[1])
    _draw_size(upper, time, history)
    size = history["diameter"]
    room = float(np.ptp(size))
    if room > 0.01 * float(size.max()):  # else noise would fill the picture
        upper.set_ylim(float(size.min()) - 0.1 * room, float(size.max()) + 0.1 * room)
    lower.plot(time, 1000.0 * history["largest_pressure"], draw_style(time), color=RED, lw=2)
    lower.set(title="Largest pressure of a cell", ylabel="pressure (Pa)")
    lower.set_xlabel(f"time ({unit.name})")
    for axes in (upper, lower):
        axes.set_xlim(*span(time))
    return figure


def _course(history: History) -> tuple[TimeUnit, FloatArray, str]:
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
    axes.plot(time, cells, draw_style(time), color=INK, lw=2)
    if cells.min() > 0 and cells.max() >= 5 * cells.min():
        axes.set_yscale("log")
        counts(axes.yaxis)
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.set_ylabel("number")
    else:
        _count_axis(axes, 1.08 * float(cells.max()))


def _count_axis(axes: Axes, largest: float) -> None:
    """Give an axis of counts that starts at zero."""
    axes.set_ylim(0.0, largest if largest > 0 else 1.0)
    axes.yaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
    counts(axes.yaxis)
    axes.set_ylabel("number")


def _draw_size(axes: Axes, time: FloatArray, history: History) -> None:
    """Draw the diameters of the population and of its necrotic core."""
    whole, core = history["diameter"], 2.0 * history["necrotic_radius"]
    axes.plot(time, whole, draw_style(time), color=BLUE, lw=2, label="whole")
    if core.max() > 0:
        shown = np.where(core > 0, core, np.nan)
        axes.plot(time, shown, color=COLOURS["necrotic"], lw=2, ls="--", label="necrotic core")
    parts = draw_hypoxic(axes, time, history) > 0 or core.max() > 0
    if parts:
        axes.legend(loc="upper left", fontsize=9, ncols=2)
    # room for the legend above the line
    axes.set_ylim(0.0, (1.7 if parts else 1.1) * max(float(whole.max()), 1.0))
    axes.set(title="Diameter", ylabel="diameter (µm)")


def _draw_rim(axes: Axes, time: FloatArray, rim: FloatArray) -> None:
    """Draw the thickness of the layer outside the necrotic core, since there is one."""
    axes.plot(time, rim, draw_style(time), color=COLOURS["proliferating"], lw=2)
    top = 1.15 * max(float(np.nanmax(rim)), 1.0)
    axes.set(title="Viable rim", ylabel="thickness (µm)", ylim=(0.0, top))


def _draw_states(axes: Axes, time: FloatArray, history: History) -> None:
    """Draw the numbers of cells in each state on top of each other, necrotic ones below."""
    axes.set_title("Cells by state")
    names = [name for name in reversed(COLOURS) if history[name].max() > 0]
    single = len(time) == 1
    axes.stackplot(
        span(time) if single else time,
        [np.repeat(history[name], 2 if single else 1) for name in names],
        colors=[COLOURS[name] for name in names],
        labels=names,
        lw=0,
    )
    held = history.get("held_by_pressure", np.zeros(1))
    if held.max() > 0:  # above the dead, whom nothing holds back
        dead = history["necrotic"] + history["apoptotic"]
        label = "living, growth halved by pressure"
        axes.plot(time, dead + held, draw_style(time), color=INK, lw=2, label=label)
    # room for the legend above a flat top
    _count_axis(axes, (1.25 if held.max() == 0 else 1.35) * float(history["cells"].max()))
    handles, labels = axes.get_legend_handles_labels()
    axes.legend(handles[::-1], labels[::-1], loc="upper left", handlelength=1.0)
