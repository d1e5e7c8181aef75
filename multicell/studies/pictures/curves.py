"""An observable over time, with bands over the seeds: one panel for each axis of a study."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.colors import LogNorm, Normalize
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from multicell.errors import SceneError
from multicell.report.plots.style import BLUE, SIZE, draw_style, span, styled, type_colours
from multicell.report.wording import time_unit
from multicell.studies.pictures import values as of
from multicell.studies.pictures.layout import panels, spread, write_plainly

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from multicell.cells import FloatArray

_MAX_NAMED: Final = 8  # curves with a name each; more share a scale of colours
_MAX_CURVES: Final = 200  # of a sample; more would hide each other, and take a minute
_LOG_RATIO: Final = 20.0  # of largest to smallest from which the axis is logarithmic


@styled
def curves(table: xr.Dataset, title: str, name: str, at: Mapping[str, Any] | None = None) -> Figure:
    """Draw what :meth:`multicell.studies.plots.StudyPlots.curves` describes."""
    table = of.compact(table)
    values = of.observable(table, name)
    if of.TIME not in values.dims:
        courses = [str(n) for n, entry in table.data_vars.items() if of.TIME in entry.dims]
        hint = f"Those over time are {', '.join(courses)}."
        raise SceneError("", f"'{name}' is one number of each run and has no course", hint)
    names = of.axes_of(table)
    columns = 2 if len(names) > 1 else 1
    rows = -(-len(names) // columns)
    height = SIZE[1] if rows < 2 else 0.9 + 3.9 * rows
    figure, grid = panels(title, _subtitle(table, name), max(1, len(names)), columns, height,
                          sharex=True, sharey=True)  # fmt: skip
    _set_limits(grid[0], values.values)
    unit = time_unit(float(table[of.TIME].max()))
    for place, panel in enumerate(grid):
        # limits are known: to find them from hundreds of curves takes minutes
        panel.set_autoscale_on(False)
        panel.set_xlim(*span(table[of.TIME].values / unit.seconds))
        if place % columns == 0:
            panel.set_ylabel(of.label(table, name))
        panel.xaxis.set_tick_params(labelbottom=True)
        panel.xaxis.set_major_locator(MaxNLocator(6))
    for panel in grid[-columns:]:
        panel.set_xlabel(f"time ({unit.name})")
    time = table[of.TIME].values / unit.seconds
    if not names:
        _draw_curve(grid[0], time, values.transpose(of.SEED, of.TIME).values, BLUE, 2.0)
    fixed = {} if of.is_sampled(table) else of.middle(table, of.axes_of(table)) | dict(at or {})
    for panel, axis in zip(grid, names, strict=False):
        others = {other: value for other, value in fixed.items() if other != axis}
        _draw(figure, panel, time, of.at_point(table, others), name, axis)
        if others:
            heading = textwrap.fill(of.point_text(table, others), 110 // columns)
            panel.set_title(heading, fontsize=9.5, weight="normal")
    return figure


def _subtitle(table: xr.Dataset, name: str) -> str:
    seeds = table.sizes[of.SEED]
    over = f"mean over {seeds} seeds, band: ± one standard deviation" if seeds > 1 else (
        "one seed: the scatter is unknown, there are no bands"
    )  # fmt: skip
    if table.sizes.get(of.POINT, 0) > _MAX_CURVES:
        over += f"; {_MAX_CURVES} of {table.sizes[of.POINT]:,} points"
    return f"{of.sentence(of.words(name))} over time, {over}"


def _draw(
    figure: Figure, axes: Axes, time: FloatArray, table: xr.Dataset, name: str, axis: str
) -> None:
    """Draw one panel: a curve for each value of the axis (each point of a sample)."""
    shown = of.scale(table, axis)
    along = of.POINT if of.is_sampled(table) else axis
    values = table[name].astype(float).transpose(along, of.SEED, of.TIME).values
    own = list(table[axis].values) if of.is_sampled(table) else list(shown.values)
    colour, mappable = _colours(shown)
    chosen = spread(len(own), _MAX_CURVES)
    for order, place in enumerate(chosen):
        # the first ones are the widest: they are seen also where others lie on top of them
        wide = 1.1 if len(chosen) > 2 * _MAX_NAMED else 3.4 - 1.6 * order / max(len(own) - 1, 1)
        _draw_curve(axes, time, values[place], colour(own[place]), wide)
    if mappable is not None:
        bar = figure.colorbar(mappable, ax=axes, pad=0.02, aspect=28)
        bar.outline.set_visible(False)
        bar.ax.grid(False)
        bar.set_label(shown.label)
        write_plainly(bar.ax.yaxis, of.number_text)
        return
    lost = {} if of.is_sampled(table) else _missing(table, values, axis)
    handles = [
        Line2D([], [], color=colour(value), lw=2.2, label=f"{text}{lost.get(place, '')}")
        for place, (value, text) in enumerate(zip(shown.values, shown.texts, strict=True))
    ]
    axes.legend(handles=handles, title=shown.label, fontsize=10, title_fontsize=10,
                loc="best", alignment="left")  # fmt: skip


def _missing(table: xr.Dataset, values: FloatArray, axis: str) -> dict[int, str]:
    """Return what the legend says of the values of an axis, by place, that have no curve."""
    found = {}
    states = table[of.STATE].transpose(axis, of.SEED).values
    for place, (courses, runs) in enumerate(zip(values, states, strict=True)):
        if not np.isfinite(courses).any():
            failed = "failed" if (runs == "failed").all() else "not run"
            found[place] = f" ({'none' if (runs == of.DONE).any() else failed})"
    return found


def _draw_curve(
    axes: Axes, time: FloatArray, courses: FloatArray, colour: Any, wide: float
) -> None:
    """Draw mean and band of courses (seeds, m), and single courses where a seed has no value."""
    known = courses[np.isfinite(courses).any(axis=1)]
    if not len(known):
        return
    whole: NDArray[np.bool_] = np.asarray(np.isfinite(known).all(axis=0))
    mean = np.where(whole, known.mean(axis=0), np.nan)
    axes.plot(time, mean, draw_style(mean[whole]), color=colour, lw=wide, ms=4)
    if len(known) == 1:
        return
    sd = known.std(axis=0, ddof=1)
    axes.fill_between(time, mean - sd, mean + sd, where=whole, color=colour, lw=0, alpha=0.22)
    if not whole.all():
        beyond = ~whole
        beyond[1:] |= ~whole[:-1]  # the single courses begin where the mean ends
        beyond[:-1] |= ~whole[1:]
        axes.plot(time, np.where(beyond, known, np.nan).T, color=colour, lw=0.7, alpha=0.7)


def _colours(shown: of.Scale) -> tuple[Callable[[Any], Any], mpl.cm.ScalarMappable | None]:
    """Return the colour of each value of an axis; and their scale where they are many numbers."""
    if shown.numbers is None:
        own = type_colours([str(value) for value in shown.values])
        return lambda value: own[str(value)], None
    cmap = mpl.colors.ListedColormap(mpl.colormaps["viridis"](np.linspace(0.0, 0.88, 256)))
    if len(shown.values) <= _MAX_NAMED:
        places = np.linspace(0.0, 1.0, max(2, len(shown.values)))
        known = dict(zip(map(float, shown.values), cmap(places), strict=False))
        return lambda value: known[float(value)], None
    norm = (LogNorm if shown.log else Normalize)(shown.numbers.min(), shown.numbers.max())
    mappable = mpl.cm.ScalarMappable(norm, cmap)
    return lambda value: mappable.to_rgba(value / shown.factor), mappable


def _set_limits(axes: Axes, values: FloatArray) -> None:
    """Set the shared axis of values: logarithmic where they grow much, from 0 where it is near."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    if low > 0.0 and high >= _LOG_RATIO * low:
        axes.set_yscale("log")
        axes.set_ylim(low / 1.15, high * 1.15)
    else:
        room = 0.06 * (high - low) or 0.05 * abs(high) or 1.0
        axes.set_ylim(0.0 if 0.0 <= low < 0.6 * high else low - room, high + room)
    write_plainly(axes.yaxis)
