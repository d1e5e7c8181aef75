"""An observable over time, with bands over the seeds: one panel for each axis of a study."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
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
    _limits(grid[0, 0], values.values / factor)
    held = {} if is_sampled(table) else middle(table, axes_of(table)) | dict(at or {})
    for place, panel in enumerate(grid.flat):
        if place >= len(names):
            panel.set_axis_off()
            continue
        panel.set_autoscale_on(False)
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
    if len(own) > 2 * _MOST_NAMED:
        _crowd(axes, time, values, [colour(value) for value in own])
    for order, (value, courses) in enumerate(zip(own, values, strict=True)):
        if len(own) <= 2 * _MOST_NAMED:
            # the first ones are the widest: they are seen also where others lie on top of them
            wide = 1.8 + 1.6 * (1.0 - order / max(len(own) - 1, 1))
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


class _Summary(NamedTuple):
    """A curve over the seeds: (m,) each.

    Mean and deviation where all seeds that have any value have one, else NaN; and the single
    courses (k, m) where that is not so.
    """

    mean: FloatArray
    sd: FloatArray
    rest: FloatArray


def _summary(courses: FloatArray) -> _Summary | None:
    """Return the summary of courses (seeds, m); None if there are none."""
    known = courses[np.isfinite(courses).any(axis=1)]
    if not len(known):
        return None
    whole: NDArray[np.bool_] = np.asarray(np.isfinite(known).all(axis=0))
    mean = np.where(whole, known.mean(axis=0), np.nan)
    if len(known) == 1:
        return _Summary(mean, np.full_like(mean, np.nan), known[:0])
    beyond = ~whole
    beyond[1:] |= ~whole[:-1]  # the single courses begin where the mean ends
    beyond[:-1] |= ~whole[1:]
    rest = np.where(beyond, known, np.nan)
    return _Summary(mean, known.std(axis=0, ddof=1), rest[:0] if whole.all() else rest)


def _course(axes: Axes, time: FloatArray, courses: FloatArray, colour: Any, wide: float) -> None:
    """Draw mean and band over the seeds, and single courses where there is none."""
    found = _summary(courses)
    if found is None:
        return
    mean, sd, rest = found
    whole = np.isfinite(mean)
    axes.plot(time, mean, "-" if whole.sum() > 1 else "o", color=colour, lw=wide, ms=4)
    if np.isfinite(sd).any():
        axes.fill_between(time, mean - sd, mean + sd, where=whole, color=colour, lw=0, alpha=0.22)
    for course in rest:
        axes.plot(time, course, color=colour, lw=0.7, alpha=0.7)


def _crowd(axes: Axes, time: FloatArray, values: FloatArray, colours: list[Any]) -> None:
    """Draw many curves, (n, seeds, m), as few artists: one by one they would take a minute."""
    found = [(one, c) for one, c in zip(map(_summary, values), colours, strict=True) if one]
    bands, shades = [], []
    for one, colour in found:
        for part in _pieces(np.isfinite(one.mean) & np.isfinite(one.sd)):
            upper, lower = (one.mean + one.sd)[part], (one.mean - one.sd)[part]
            around = np.append(time[part], time[part][::-1])
            bands.append(np.column_stack([around, np.append(upper, lower[::-1])]))
            shades.append(colour)
    axes.add_collection(PolyCollection(bands, facecolors=shades, alpha=0.1, lw=0))
    thin = [(np.column_stack([time, course]), c) for one, c in found for course in one.rest]
    lines = [(np.column_stack([time, one.mean]), c) for one, c in found]
    for drawn, wide in ((thin, 0.5), (lines, 1.1)):
        axes.add_collection(
            LineCollection([line for line, _ in drawn], colors=[c for _, c in drawn], lw=wide)
        )


def _pieces(there: NDArray[np.bool_]) -> list[slice]:
    """Return the parts without a gap, of two points at least."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], there, [False]]).astype(int)))
    return [slice(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a > 1]


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
    """Set the shared axis of values: logarithmic where they grow much, from zero where it is near.

    It is set before anything is drawn: to find it from hundreds of curves takes minutes.
    """
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    if low > 0.0 and high >= _GROWTH * low:
        axes.set_yscale("log")
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.set_ylim(low / 1.15, high * 1.15)
    else:
        room = 0.06 * (high - low) or 0.05 * abs(high) or 1.0
        bottom = 0.0 if 0.0 <= low < 0.6 * high else low - room
        axes.set_ylim(bottom, high + room)
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.6g}"))
