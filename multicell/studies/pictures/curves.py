"""An observable over time, with bands over the seeds: one panel for each axis of a study."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.colors import LogNorm, Normalize
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter
from numpy.typing import NDArray

from multicell.errors import SceneError
from multicell.report.plots.style import BLUE, SIZE, span, styled, type_colours
from multicell.report.wording import time_unit
from multicell.studies.pictures.heatmap import laid_out
from multicell.studies.pictures.values import (
    DONE,
    POINT,
    SEED,
    TIME,
    Scale,
    at_point,
    axes_of,
    axis_named,
    compact,
    is_sampled,
    label,
    label_with,
    middle,
    number_text,
    observable,
    point_text,
    power,
    scale,
    sentence,
    states,
    words,
)

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from multicell.cells import FloatArray

_MOST_NAMED: Final = 8  # curves with a name each; more share a scale of colours
_GROWTH: Final = 20.0  # ratio of largest to smallest from which the axis is logarithmic


@styled
def curves(
    table: xr.Dataset, title: str, name: str,
    axes: Sequence[str] | None = None, at: Mapping[str, Any] | None = None,
) -> Figure:  # fmt: skip
    """Draw an observable over time: the mean over the seeds, and a band of one deviation each way.

    A panel for each axis, whose values are told by colour while the other axes are held. Where a
    run has no value, because it ended sooner than others of its point or the observable does not
    exist yet, those that have one are thin lines without mean and band.

    Parameters
    ----------
    table
        Of the study.
    title
        Of the picture.
    name
        Of an observable with a course.
    axes
        Which axes have a panel, by default all.
    at
        Axis -> value for axes that are held, by default their middle value; of a sample nothing
        is held.

    Raises
    ------
    SceneError
        For an unknown observable or axis, or an observable that is a single number of each run.
    """
    table = compact(table)
    values = observable(table, name)
    if TIME not in values.dims:
        courses = [str(n) for n, entry in table.data_vars.items() if TIME in entry.dims]
        hint = f"Those over time are {', '.join(courses)}."
        raise SceneError("", f"'{name}' is one number of each run and has no course", hint)
    names: list[str | None] = [axis_named(table, axis) for axis in axes or axes_of(table)]
    names = names or [None]
    factor, told = power(values.values)
    columns = min(2, len(names))
    rows = -(-len(names) // columns)
    size = (SIZE[0], SIZE[1] if rows == 1 else 0.9 + 3.9 * rows)
    figure = laid_out(title, _subtitle(table, name, at or {}), size)
    grid = figure.subplots(rows, columns, squeeze=False, sharey=True, sharex=True)
    held = {} if is_sampled(table) else middle(table, axes_of(table)) | dict(at or {})
    for place, panel in enumerate(grid.flat):
        if place >= len(names):
            panel.set_axis_off()
            continue
        axis = names[place]
        others = {other: value for other, value in held.items() if other != axis}
        part = at_point(table, others)
        if axis is None:
            _draw_only(panel, part, name, factor)
        else:
            _draw(figure, panel, part, name, axis, factor)
        if others:
            told_others = textwrap.fill(point_text(table, others), 110 // columns)
            panel.set_title(told_others, fontsize=9.5, weight="normal")
        if place % columns == 0:
            panel.set_ylabel(label_with(label(table, name), told))
        if place + columns >= len(names):
            panel.xaxis.set_tick_params(labelbottom=True)
            panel.xaxis.set_major_locator(MaxNLocator(6))
            panel.set_xlabel(f"time ({_unit(table).name})")
    _limits(grid[0, 0], values.values / factor)
    return figure


def _unit(table: xr.Dataset) -> Any:
    return time_unit(float(table[TIME].max()))


def _subtitle(table: xr.Dataset, name: str, at: Mapping[str, Any]) -> str:
    seeds = table.sizes[SEED]
    if seeds == 1:
        over = "one seed: the scatter is unknown, there are no bands"
    else:
        over = f"mean over {seeds} seeds, band: ± one standard deviation"
    return f"{sentence(words(name))} over time, {over}"


def _draw_only(axes: Axes, table: xr.Dataset, name: str, factor: float) -> None:
    """Draw the one curve of a study that varies nothing but seeds."""
    time = table[TIME].values / _unit(table).seconds
    courses = (table[name].astype(float) / factor).transpose(SEED, TIME).values
    _course(axes, time, courses, BLUE, 2.0)
    axes.set_xlim(*span(time))


def _draw(
    figure: Figure, axes: Axes, table: xr.Dataset, name: str, axis: str, factor: float
) -> None:
    """Draw one panel: a curve for each value of the axis (each point of a sample)."""
    shown = scale(table, axis)
    along = POINT if is_sampled(table) else axis
    values = (table[name].astype(float) / factor).transpose(along, SEED, TIME).values
    time = table[TIME].values / _unit(table).seconds
    own = list(shown.values)
    if is_sampled(table):
        own = [str(v) if shown.numbers is None else float(v) for v in table[axis].values]
    colour = _colours(shown)
    few = len(shown.values) <= _MOST_NAMED
    thin = len(own) > 2 * _MOST_NAMED
    for order, (value, courses) in enumerate(zip(own, values, strict=True)):
        # the first ones are the widest: they are seen also where others lie on top of them
        wide = 1.1 if thin else 1.8 + 1.6 * (1.0 - order / max(len(own) - 1, 1))
        _course(axes, time, courses, colour(value), wide)
    if few:
        lost = {} if is_sampled(table) else _lost(table, values, own, axis)
        entries = zip(shown.values, shown.texts, strict=True)
        handles = [
            mpl.lines.Line2D([], [], color=colour(v), lw=2.2, label=f"{text}{lost.get(v, '')}")
            for v, text in entries
        ]
        axes.legend(handles=handles, title=shown.label, fontsize=10, title_fontsize=10,
                    loc="best", alignment="left")  # fmt: skip
    else:
        bar = figure.colorbar(_mappable(shown), ax=axes, pad=0.02, aspect=28)
        bar.outline.set_visible(False)
        bar.ax.grid(False)
        bar.set_label(shown.label)
        bar.ax.yaxis.set_minor_formatter(NullFormatter())
        bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: number_text(value)))
    axes.set_xlim(*span(time))


def _lost(table: xr.Dataset, values: FloatArray, own: list[Any], axis: str) -> dict[Any, str]:
    """Return what the legend says of values of an axis that have no curve."""
    log = states(table).transpose(axis, SEED).values
    told = {}
    for value, courses, runs in zip(own, values, log, strict=True):
        if not np.isfinite(courses).any():
            failed = "failed" if (runs == "failed").all() else "not run"
            told[value] = f" ({'none' if (runs == DONE).any() else failed})"
    return told


def _course(axes: Axes, time: FloatArray, courses: FloatArray, colour: Any, wide: float) -> None:
    """Draw mean and band over the seeds, (n, m), where all that have any value have one."""
    known = courses[np.isfinite(courses).any(axis=1)]
    if not len(known):
        return
    whole: NDArray[np.bool_] = np.asarray(np.isfinite(known).all(axis=0))
    mean = np.where(whole, known.mean(axis=0), np.nan)
    style = "-" if whole.sum() > 1 else "o"
    axes.plot(time, mean, style, color=colour, lw=wide, ms=4)
    if len(known) > 1:
        sd = known.std(axis=0, ddof=1)
        axes.fill_between(
            time,
            mean - sd,
            mean + sd,
            where=whole,
            color=colour,
            alpha=0.1 if wide < 1.5 else 0.22,
            lw=0,
        )
        beyond = ~whole
        beyond[1:] |= ~whole[:-1]  # the thin lines begin where the mean ends
        beyond[:-1] |= ~whole[1:]
        for course in known if not whole.all() else ():
            axes.plot(time, np.where(beyond, course, np.nan), color=colour, lw=0.7, alpha=0.7)


def _colours(shown: Scale) -> Any:
    """Return the function from a value of an axis to its colour."""
    if shown.numbers is None:
        own = type_colours([str(value) for value in shown.values])
        return lambda value: own[value]
    if len(shown.values) <= _MOST_NAMED:
        places = np.linspace(0.0, 0.86, len(shown.values)) if len(shown.values) > 1 else [0.4]
        cmap = mpl.colormaps["viridis"]
        known = {float(v): cmap(p) for v, p in zip(shown.values, places, strict=True)}
        return lambda value: known[value]
    mappable = _mappable(shown)
    return lambda value: mappable.to_rgba(value / shown.factor)


def _mappable(shown: Scale) -> mpl.cm.ScalarMappable:
    assert shown.numbers is not None
    low, high = float(shown.numbers.min()), float(shown.numbers.max())
    norm = LogNorm(low, high) if shown.log else Normalize(low, high)
    cmap = mpl.colors.ListedColormap(mpl.colormaps["viridis"](np.linspace(0.0, 0.9, 256)))
    return mpl.cm.ScalarMappable(norm, cmap)


def _limits(axes: Axes, values: FloatArray) -> None:
    """Give the shared axis of values a logarithmic scale where they grow much, else zero below."""
    known = values[np.isfinite(values)]
    if not known.size:
        return
    low, high = float(known.min()), float(known.max())
    if low > 0.0 and high >= _GROWTH * low:
        axes.set_yscale("log")
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.6g}"))
    elif low >= 0.0:
        if low < 0.6 * high:
            axes.set_ylim(0.0, 1.08 * high or 1.0)
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.6g}"))
