"""What an observable comes to over each axis of a study: every run a dot, means with bars."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, MaxNLocator

from multicell.report.plots.style import BLUE, QUIET, RED, SIZE, styled
from multicell.studies.pictures import values as of
from multicell.studies.pictures.layout import panels, write_plainly

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from multicell.cells import FloatArray

_IN_A_ROW: Final = 3  # panels


@styled
def response(table: xr.Dataset, title: str, name: str) -> Figure:
    """Draw what :meth:`multicell.studies.plots.StudyPlots.response` describes."""
    if not of.axes_of(table):
        raise ValueError("nothing is varied: there are no axes to draw over")
    table = of.compact(table)
    values, names = of.at_end(table, name), of.axes_of(table)
    rows = -(-len(names) // _IN_A_ROW)
    columns = -(-len(names) // rows)  # rows of one length have no holes
    height = SIZE[1] if rows == 1 else 0.9 + 3.6 * rows
    figure, grid = panels(title, _subtitle(table, name), len(names), columns, height, sharey=True)
    for place, (axes, axis) in enumerate(zip(grid, names, strict=True)):
        _draw(axes, values, table[of.STATE], of.scale(table, axis), table[axis].values)
        if place % columns == 0:
            axes.set_ylabel(of.label(table, name))
            write_plainly(axes.yaxis)
    failed = int((table[of.STATE].values == "failed").sum())
    if failed:
        handle = Line2D([], [], ls="", marker="x", color=RED, label=f"failed ({failed:,})")
        figure.legend(handles=[handle], loc="upper right", bbox_to_anchor=(0.98, 0.99))
    return figure


def _subtitle(table: xr.Dataset, name: str) -> str:
    seeds, text = table.sizes[of.SEED], f"{of.sentence(of.words(name))} at the end of each run"
    if of.is_sampled(table):
        text += f", {table.sizes[of.POINT]} points"
    elif len(of.axes_of(table)) > 1:
        return f"{text}; line: mean over seeds and the other axes"
    bars = f"bars: ± one standard deviation over {seeds} seeds"
    return f"{text}; {bars if seeds > 1 else 'one seed: the scatter is unknown'}"


def _draw(
    axes: Axes, values: xr.DataArray, states: xr.DataArray, shown: of.Scale, own: FloatArray
) -> None:
    """Draw the panel of one axis, whose value at each place of the table is ``own``."""
    sampled = of.POINT in values.dims
    along = of.POINT if sampled else shown.name
    rest = [str(name) for name in values.dims if name != along]
    flat = values.transpose(along, *rest).values.reshape(len(own), -1)
    lost = (states == "failed").any(rest).values
    # words have a place of their own each
    words = shown.numbers is None
    places = np.array([shown.values.index(str(v)) for v in own]) if words else own / shown.factor
    gap = np.diff(np.sort(places)).min() if len(places) > 1 and not (sampled or shown.log) else 0.0
    apart = np.linspace(-0.05, 0.05, flat.shape[1]) * gap if flat.shape[1] > 1 else 0.0
    axes.plot(places[:, None] + apart, flat, "o", color=BLUE, ms=3.5, alpha=0.35, mew=0,
              zorder=2)  # fmt: skip
    mean, sd, _ = of.statistics(values, rest)
    bars = values.sizes[of.SEED] > 1 and rest == [of.SEED]
    order = np.argsort(places, kind="stable")
    axes.errorbar(
        places[order], mean.values[order], sd.values[order] if bars else None,
        fmt="o" if sampled or words else "o-", color=BLUE if sampled else QUIET, ms=4.5,
        lw=1.4, elinewidth=1.1, capsize=0 if sampled else 2.5, zorder=3,
    )  # fmt: skip
    axes.plot(places[lost], np.full(lost.sum(), 0.02), "x", color=RED, zorder=4,
              transform=axes.get_xaxis_transform())  # fmt: skip
    axes.set_xlabel(shown.label)
    if words:
        axes.set_xticks(range(len(shown.texts)), shown.texts)
        axes.set_xlim(-0.6, len(shown.texts) - 0.4)
    elif not shown.log:
        axes.xaxis.set_major_locator(MaxNLocator(5))
    else:
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
        write_plainly(axes.xaxis, of.number_text)
