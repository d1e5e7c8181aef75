"""What an observable comes to over each axis of a study: every run a dot, means with bars."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from multicell.report.plots.style import BLUE, QUIET, RED, SIZE, styled
from multicell.studies.pictures.heatmap import laid_out
from multicell.studies.pictures.values import (
    POINT,
    SEED,
    Scale,
    at_end,
    axes_of,
    compact,
    is_sampled,
    label,
    label_with,
    number_text,
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

_PANELS: Final = 3  # in a row


@styled
def response(table: xr.Dataset, title: str, name: str) -> Figure:
    """Draw an observable at the end of each run over every axis, one panel for each.

    Dots are single runs. Each point of a sample, and each value of a single axis, has a bar of one
    standard deviation over its seeds; of several axes the line is the mean over all runs of a
    value. Runs that failed are crosses at the foot.

    Raises
    ------
    SceneError
        For an unknown observable.
    ValueError
        If nothing is varied.
    """
    if not axes_of(table):
        raise ValueError("nothing is varied: there are no axes to draw over")
    table = compact(table)
    values = at_end(table, name)
    factor, told = power(values.values)
    values = values / factor
    names = axes_of(table)
    columns = min(_PANELS, len(names))
    rows = -(-len(names) // columns)
    size = (SIZE[0], SIZE[1] if rows == 1 else 0.9 + 3.6 * rows)
    figure = laid_out(title, _subtitle(table, name), size)
    grid = figure.subplots(rows, columns, squeeze=False, sharey=True)
    log = states(table)
    for place, axes in enumerate(grid.flat):
        if place >= len(names):
            axes.set_axis_off()
            continue
        _draw(axes, values, log, scale(table, names[place]), table[names[place]].values)
        if place % columns == 0:
            axes.set_ylabel(label_with(label(table, name), told))
            axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.6g}"))
    failed = int((log.values == "failed").sum())
    if failed:
        handle = Line2D([], [], ls="", marker="x", color=RED, label=f"failed ({failed:,})")
        figure.legend(handles=[handle], loc="upper right", bbox_to_anchor=(0.98, 0.99))
    return figure


def _subtitle(table: xr.Dataset, name: str) -> str:
    seeds, told = table.sizes[SEED], f"{sentence(words(name))} at the end of each run"
    if is_sampled(table):
        told += f", {table.sizes[POINT]} points"
    elif len(axes_of(table)) > 1:
        return f"{told}; line: mean over seeds and the other axes"
    bars = f"bars: ± one standard deviation over {seeds} seeds"
    return f"{told}; {bars if seeds > 1 else 'one seed: the scatter is unknown'}"


def _draw(
    axes: Axes, values: xr.DataArray, log: xr.DataArray, shown: Scale, own: FloatArray
) -> None:
    """Draw the panel of one axis, whose value at each place of the table is ``own``."""
    sampled = POINT in values.dims
    along = POINT if sampled else shown.name
    rest = [name for name in values.dims if name != along]
    flat = values.transpose(along, *rest).values.reshape(len(own), -1)
    lost = (log.transpose(along, *rest).values == "failed").reshape(len(own), -1)
    places = _places(shown, own)
    dots = np.repeat(places, flat.shape[1])
    if not sampled:
        dots = dots + _shaken(flat.shape, places, shown)
    axes.plot(dots, flat.ravel(), "o", color=BLUE, ms=3.5, alpha=0.35, mew=0, zorder=2)
    bars = values.sizes[SEED] > 1 and set(rest) == {SEED}
    _means(axes, flat, places, sampled=sampled, joined=shown.numbers is not None, bars=bars)
    if lost.any():
        foot = axes.get_xaxis_transform()
        crossed = places[lost.any(axis=1)]
        axes.plot(crossed, np.full(len(crossed), 0.02), "x", color=RED, transform=foot, zorder=4)
    axes.set_xlabel(shown.label)
    if shown.numbers is None:
        axes.set_xticks(range(len(shown.texts)), shown.texts)
        axes.set_xlim(-0.6, len(shown.texts) - 0.4)
    elif not shown.log:
        axes.xaxis.set_major_locator(MaxNLocator(5))
    else:
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: number_text(value)))


def _places(shown: Scale, own: FloatArray) -> FloatArray:
    """Return where each value of an axis stands: words have a place of their own each."""
    if shown.numbers is None:
        order = {value: place for place, value in enumerate(shown.values)}
        return np.array([order[str(value)] for value in own], dtype=float)
    return np.asarray(own, dtype=float) / shown.factor


def _shaken(shape: tuple[int, ...], places: FloatArray, shown: Scale) -> FloatArray:
    """Return shifts that keep the dots of one value apart, always the same ones."""
    if shown.log or len(places) < 2:
        return np.zeros(shape[0] * shape[1])
    gap = float(np.diff(np.sort(places)).min())
    offsets = np.linspace(-0.05, 0.05, shape[1]) * gap if shape[1] > 1 else np.zeros(1)
    return np.tile(offsets, shape[0])


def _means(
    axes: Axes, flat: FloatArray, places: FloatArray, *, sampled: bool, joined: bool, bars: bool
) -> None:
    """Draw the mean of each row of (n, k) values and, where asked for, their deviation."""
    order = np.argsort(places, kind="stable")
    known = np.isfinite(flat)
    count = known.sum(axis=1)
    mean = np.where(known, flat, 0.0).sum(axis=1) / np.where(count, count, np.nan)
    squares = (np.where(known, flat - mean[:, None], 0.0) ** 2).sum(axis=1)
    sd = np.sqrt(squares / np.maximum(count - 1, 1))
    axes.errorbar(
        places[order], mean[order], sd[order] if bars else None,
        fmt="o" if sampled or not joined else "o-", color=BLUE if sampled else QUIET, ms=4.5,
        lw=1.4, elinewidth=1.1, capsize=0 if sampled else 2.5, zorder=3,
    )  # fmt: skip
