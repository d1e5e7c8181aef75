"""Pictures of a study, drawn from its table of runs, and the layout that pictures share."""

from __future__ import annotations

import textwrap
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final, final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from multicell.errors import SceneError
from multicell.report.plots import style
from multicell.report.plots.colour_vision import luminance
from multicell.report.wording import time_unit
from multicell.studies import picture_data as of

if TYPE_CHECKING:
    import xarray as xr
    from numpy.typing import NDArray

    from multicell.cells import FloatArray

_FEW: Final = 12  # runs at one place that stand apart
_COLOURS: Final = ListedColormap(mpl.colormaps["viridis"](np.linspace(0.0, 0.88, 256)))
_MIN_FONT: Final = 6.7  # points: 7 at the width of a page; smaller numbers cannot be read
_EMPTY, _FAILED = "#eceff2", "#f6dfd9"
_MAX_TICKS: Final = 8  # ticks at the values that ran; more are at round numbers
_TICK_ROOM: Final = 0.1  # least distance of such ticks, as a part of the axis
_MAX_NAMED: Final = 8  # curves with a name each; more share a scale of colours
_MAX_CURVES: Final = 200  # of a list; more would hide each other, and take a minute
_LOG_RATIO: Final = 20.0  # of largest to smallest value from which curves are on a logarithmic axis


def with_heading(title: str, subtitle: str, size: tuple[float, float]) -> Figure:
    """Return a figure whose panels find their own margins below a heading."""
    figure = style.blank(title, subtitle, size)
    figure.set_layout_engine(
        "constrained", rect=(0.03, 0.05, 0.94, 1.0 - 0.85 / size[1] - 0.05), w_pad=0.13, h_pad=0.08
    )
    figure.set_dpi(style.DPI)
    return figure


def panels(
    title: str, subtitle: str, count: int, columns: int, height: float, **shared: Any
) -> tuple[Figure, list[Axes]]:
    """Return a figure with so many panels in rows of so many columns; the rest of a row is empty.

    - ``title``, ``subtitle``: of the figure
    - ``count``, ``columns``: panels in all, and in a row
    - ``height``: of the figure, inches
    - ``**shared``: as ``Figure.subplots`` takes them: ``sharex``, ``sharey``
    """
    figure = with_heading(title, subtitle, (style.SIZE[0], height))
    grid = figure.subplots(-(-count // columns), columns, squeeze=False, **shared).ravel().tolist()
    for axes in grid[count:]:
        axes.set_axis_off()
    return figure, grid[:count]


def _write_plainly(axis: Any, text: Callable[[float], str] = "{:,.7g}".format) -> None:
    """Write the numbers of an axis with commas and without powers of ten, or as another text."""
    axis.set_minor_formatter(NullFormatter())
    axis.set_major_formatter(FuncFormatter(lambda value, _: text(value)))


def _colour_bar(figure: Figure, mappable: Any, axes: Any, label: str) -> Any:
    bar = figure.colorbar(mappable, ax=axes, aspect=28, pad=0.02)
    bar.outline.set_visible(False)
    bar.ax.grid(False)
    bar.set_label(label)
    return bar.ax.yaxis


def _varied(table: xr.Dataset) -> list[str]:
    names = of.axes_of(table)
    if not names:
        raise ValueError("nothing is varied: there are no axes to draw over")
    return names


def _subtitle(name: str, when: str, seeds: int, scatter: str) -> str:
    scatter = f"{scatter} over {seeds} seeds" if seeds > 1 else "one seed: the scatter is unknown"
    return f"{of.sentence(of.words(name))} {when}, {scatter}"


@final
class StudyPlots:
    """The pictures of one study, drawn from its table; each is a matplotlib ``Figure``.

    Every observable is a name of the table. The scatter over seeds is always part of a picture;
    where there is one seed it says so, and runs that failed or are missing are shown as such.

    - ``table``: of the study, as ``study.to_xarray()``
    - ``title``: of the pictures
    """

    def __init__(self, table: xr.Dataset, title: str) -> None:
        kept = (of.POINT, of.SEED)
        single = [n for n in table[of.STATE].dims if table.sizes[n] == 1 and n not in kept]
        self._table, self._title = table.squeeze(single, drop=True), title

    @style.styled
    def heatmap(self, observable: str) -> Figure:
        """Draw the mean of an observable over the first two axes, a tile for each pair of values.

        Each tile states mean and standard deviation over the seeds, and how many seeds there are
        where some failed or have not run. Further axes are at their middle value; of a study of
        one axis the map has one row.

        - ``observable``: its values at the end of each run are shown

        Raises SceneError for an unknown observable; ValueError if the design is a list or varies
        nothing: there are no tiles.
        """
        if of.is_list(self._table):
            raise ValueError("a list of points has no tiles: draw the response over each axis")
        across, *others = _varied(self._table)
        up = others[:1]
        part, fixed = of.at_middle(self._table, others[1:])
        sides = [of.axis_scale(part, axis) for axis in (across, *up)]
        high, wide = len(sides[1].texts) if up else 1, len(sides[0].texts)
        ends, states = (
            entry.transpose(*up, across, of.SEED).values.reshape(high, wide, -1)
            for entry in (of.at_end(part, observable), part[of.STATE])
        )
        mean, sd = of.statistics(ends)
        scatter = "mean ± standard deviation"
        # points: numbers that fit the tiles
        font = min(12.0, 84.0 / max(wide, high))
        if font < _MIN_FONT and np.isfinite(sd).any():
            scatter += f" ({of.number_text(float(np.nanmedian(sd)), 2)} in the median tile)"
        subtitle = _subtitle(observable, "at the end of each run", ends.shape[-1], scatter)
        subtitle += f"; {fixed}" if fixed else ""
        inches = 3.4 if high == 1 else max(style.SIZE[1], 1.7 + 0.3 * high)
        figure = with_heading(self._title, subtitle, (style.SIZE[0], inches))
        axes, norm = figure.subplots(), Normalize(*_range(mean))
        _draw_map(axes, mean, states, norm)
        for place in np.ndindex(*mean.shape) if font >= _MIN_FONT else ():
            _write_tile(axes, place, ends[place], states[place], norm, font)
        axes.set_yticks([])
        for axis, side in zip((axes.xaxis, axes.yaxis), sides, strict=False):
            _name_tiles(axis, side)
        mappable = mpl.cm.ScalarMappable(norm, _COLOURS)
        _write_plainly(_colour_bar(figure, mappable, axes, of.label(part, observable)))
        return figure

    @style.styled
    def curves(self, observable: str) -> Figure:
        """Draw an observable over time: the mean over the seeds, a band of one deviation each way.

        A panel for each axis, whose values have a colour each while the other axes of a grid are
        at their middle value. Where a run has no value, because it ended sooner than others of its
        point or the observable does not exist yet, those that have one are thin lines without mean
        and band.

        - ``observable``: one with a course

        Raises SceneError for an unknown observable, or one that is a single number of each run.
        """
        table = self._table
        if of.TIME not in of.table_variable(table, observable).dims:
            courses = [str(n) for n, entry in table.data_vars.items() if of.TIME in entry.dims]
            hint = f"Those over time are {', '.join(courses)}."
            problem = f"'{observable}' is one number of each run and has no course"
            raise SceneError("", problem, hint)
        names = of.axes_of(table)
        columns = 2 if len(names) > 1 else 1
        rows = -(-len(names) // columns)
        seeds, height = table.sizes[of.SEED], style.SIZE[1] if rows < 2 else 0.9 + 3.9 * rows
        subtitle = _subtitle(observable, "over time", seeds, "mean, band: ± one standard deviation")
        if table.sizes.get(of.POINT, 0) > _MAX_CURVES:
            subtitle += f"; {_MAX_CURVES} of {table.sizes[of.POINT]:,} points"
        figure, grid = panels(
            self._title, subtitle, max(1, len(names)), columns, height, sharex=True, sharey=True
        )
        unit = time_unit(float(table[of.TIME].max()))
        time = table[of.TIME].values / unit.seconds
        _set_limits(grid[0], table[observable].values)
        for place, axes in enumerate(grid):
            # limits are known: to find them from hundreds of curves takes minutes
            axes.set_autoscale_on(False)
            axes.set_xlim(*style.span(time))
            axes.xaxis.set_tick_params(labelbottom=True)
            axes.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
            axes.set_xlabel(f"time ({unit.name})" if place >= len(grid) - columns else "")
            axes.set_ylabel("" if place % columns else of.label(table, observable))
        for axes, axis in zip(grid, names, strict=False):
            others = [] if of.is_list(table) else [name for name in names if name != axis]
            part, words = of.at_middle(table, others)
            _draw_curves(figure, axes, time, part, observable, axis)
            axes.set_title(textwrap.fill(words, 110 // columns), fontsize=9.5, weight="normal")
        if not names:
            alone = table[observable].transpose(of.SEED, of.TIME).values
            _draw_curve(grid[0], time, alone, style.BLUE, 2.0)
        return figure

    @style.styled
    def response(self, observable: str) -> Figure:
        """Draw an observable at the end of each run over every axis, one panel for each.

        Dots are single runs. Each point of a list, and each value of a single axis, has a bar of
        one standard deviation over its seeds; of several axes the line is the mean over all runs of
        a value. Runs that failed are crosses at the foot.

        Raises SceneError for an unknown observable; ValueError if nothing is varied.
        """
        table = self._table
        names, values = _varied(table), of.at_end(table, observable)
        rows = -(-len(names) // 3)
        columns = -(-len(names) // rows)  # rows of one length have no holes
        height = style.SIZE[1] if rows == 1 else 0.9 + 3.6 * rows
        bars = "bars: ± one standard deviation"
        if len(names) > 1 and not of.is_list(table):
            bars = "line: mean over the other axes and"
        subtitle = _subtitle(observable, "at the end of each run", table.sizes[of.SEED], bars)
        figure, grid = panels(self._title, subtitle, len(names), columns, height, sharey=True)
        for place, (axes, axis) in enumerate(zip(grid, names, strict=True)):
            _draw_response(
                axes, values, table[of.STATE], of.axis_scale(table, axis), table[axis].values
            )
            if place % columns == 0:
                axes.set_ylabel(of.label(table, observable))
                _write_plainly(axes.yaxis)
        failed = int((table[of.STATE].values == "failed").sum())
        if failed:
            label = f"failed ({failed:,})"
            cross = Line2D([], [], ls="", marker="x", color=style.RED, label=label)
            figure.legend(handles=[cross], loc="upper right", bbox_to_anchor=(0.98, 0.99))
        return figure


def _range(values: FloatArray) -> tuple[float, float]:
    """Return the ends of what is finite, apart from each other."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    room = 0.0 if high > low else (0.05 * abs(low) or 1.0)
    return low - room, high + room


def _draw_map(axes: Axes, mean: FloatArray, states: NDArray[Any], norm: Normalize) -> None:
    """Draw tiles; points without a mean are grey, or red where runs failed."""
    failed = (states == "failed").any(axis=-1) & ~(states == of.RUN_DONE).any(axis=-1)
    missing = ListedColormap([_EMPTY, _FAILED])
    axes.pcolormesh(failed, cmap=missing, vmin=0, vmax=1, edgecolors="white")
    shown = np.ma.masked_invalid(mean)
    axes.pcolormesh(shown, cmap=_COLOURS, norm=norm, edgecolors="white")
    axes.grid(False)
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0)


def _write_tile(
    axes: Axes,
    place: tuple[int, ...],
    values: FloatArray,
    runs: NDArray[Any],
    norm: Normalize,
    font: float,
) -> None:
    """Write mean and deviation in a tile and of how many seeds; or why there is no number."""
    known = values[np.isfinite(values)]
    failed = (runs == "failed").sum()
    if len(known):
        (mean, sd), few = of.statistics(known), len(known) < len(values)
        lines = [of.number_text(float(mean))]
        lines += [f"± {of.number_text(float(sd), 2)}"] * bool(np.isfinite(sd))
        lines += [f"{len(known)} of {len(values)} seeds"] * few
        colour = style.INK if luminance(_COLOURS(norm(mean))) > 0.18 else "white"
    else:
        there = (runs == of.RUN_DONE).any()
        lines = ["none" if there else "failed" if failed else "not run"]
        colour = style.RED if failed and not there else style.QUIET
    axes.text(
        place[1] + 0.5,
        place[0] + 0.5,
        "\n".join(lines),
        ha="center",
        va="center",
        fontsize=font,
        color=colour,
        weight="bold",
        linespacing=1.2,
    )


def _name_tiles(axis: Any, side: of.Scale) -> None:
    """Name a side and the tiles along it, every second or third where there are many."""
    places = range(0, len(side.texts), -(-len(side.texts) // 12))
    texts = [textwrap.shorten(side.texts[place], 16, placeholder="…") for place in places]
    axis.set_ticks([place + 0.5 for place in places], texts)
    axis.set_label_text(side.label)


def _draw_curves(
    figure: Figure, axes: Axes, time: FloatArray, table: xr.Dataset, name: str, axis: str
) -> None:
    """Draw one panel: a curve for each value of the axis (each point of a list)."""
    shown, sampled = of.axis_scale(table, axis), of.is_list(table)
    side = of.POINT if sampled else axis
    values = table[name].astype(float).transpose(side, of.SEED, of.TIME).values
    states = table[of.STATE].transpose(side, of.SEED).values
    own = table[axis].values
    colours, mappable = _colours(shown)
    count = min(len(own), _MAX_CURVES)
    chosen = np.linspace(0, len(own) - 1, count).round().astype(int)
    for order, k in enumerate(chosen):
        # the first ones are the widest: they are seen also where others lie on top of them
        wide = 1.1 if len(chosen) > 2 * _MAX_NAMED else 3.4 - 1.6 * order / max(len(own) - 1, 1)
        _draw_curve(axes, time, values[k], colours(own[k]), wide)
    if mappable is not None:
        _write_plainly(_colour_bar(figure, mappable, axes, shown.label), of.number_text)
        return
    texts = list(shown.texts)
    for k, (courses, runs) in enumerate(zip(values, states, strict=True)) if not sampled else ():
        if not np.isfinite(courses).any():
            lost = "failed" if (runs == "failed").all() else "not run"
            texts[k] += f" ({'none' if (runs == of.RUN_DONE).any() else lost})"
    handles = [
        Line2D([], [], color=colours(value), lw=2.2, label=text)
        for value, text in zip(shown.values, texts, strict=True)
    ]
    axes.legend(
        handles=handles,
        title=shown.label,
        fontsize=10,
        title_fontsize=10,
        loc="best",
        alignment="left",
    )


def _draw_curve(
    axes: Axes, time: FloatArray, courses: FloatArray, colour: Any, wide: float
) -> None:
    """Draw mean and band of courses (seeds, m), and single courses where a seed has no value."""
    known = courses[np.isfinite(courses).any(axis=1)]
    if not len(known):
        return
    whole = np.isfinite(known).all(axis=0)
    mean = np.where(whole, known.mean(axis=0), np.nan)
    axes.plot(time, mean, style.draw_style(mean[whole]), color=colour, lw=wide, ms=4)
    if len(known) > 1:
        sd = known.std(axis=0, ddof=1)
        axes.fill_between(time, mean - sd, mean + sd, where=whole, color=colour, lw=0, alpha=0.22)
        if not whole.all():
            axes.plot(time, known.T, color=colour, lw=0.7, alpha=0.7)


def _colours(shown: of.Scale) -> tuple[Callable[[Any], Any], mpl.cm.ScalarMappable | None]:
    """Return the colour of each value of an axis; and their scale where they are many numbers."""
    if shown.numbers is None:
        own = style.type_colours(shown.values)
        return lambda value: own[str(value)], None
    if len(shown.values) <= _MAX_NAMED:
        places = np.linspace(0.0, 1.0, max(2, len(shown.values)))
        known = dict(zip(map(float, shown.values), _COLOURS(places), strict=False))
        return lambda value: known[float(value)], None
    norm = (LogNorm if shown.log else Normalize)(shown.numbers.min(), shown.numbers.max())
    mappable = mpl.cm.ScalarMappable(norm, _COLOURS)
    return lambda value: mappable.to_rgba(value / shown.factor), mappable


def _set_limits(axes: Axes, values: FloatArray) -> None:
    """Set the shared axis of values: logarithmic where they grow much, from 0 where it is near."""
    low, high = _range(values)
    if low > 0.0 and high >= _LOG_RATIO * low:
        axes.set_yscale("log")
        axes.set_ylim(low / 1.15, high * 1.15)
    else:
        room = 0.06 * (high - low)
        axes.set_ylim(0.0 if 0.0 <= low < 0.6 * high else low - room, high + room)
    _write_plainly(axes.yaxis)


def _draw_response(
    axes: Axes, values: xr.DataArray, states: xr.DataArray, shown: of.Scale, own: FloatArray
) -> None:
    """Draw the panel of one axis, whose value at each place of the table is ``own``."""
    sampled = of.POINT in values.dims
    along = of.POINT if sampled else shown.name
    flat, runs = (
        entry.transpose(along, *(n for n in entry.dims if n != along)).values.reshape(len(own), -1)
        for entry in (values, states)
    )
    # words have a place of their own each
    words = shown.numbers is None
    places = np.array([shown.values.index(str(v)) for v in own]) if words else own / shown.factor
    # the runs of a few seeds stand in front of their bar; many are a cloud behind it
    few = flat.shape[1] <= _FEW
    size, alpha, order_of = (5.0, 0.7, 4) if few else (3.5, 0.35, 2)
    axes.plot(places, flat, "o", color=style.BLUE, ms=size, alpha=alpha, mew=0, zorder=order_of)
    mean, sd = of.statistics(flat)
    order = np.argsort(places, kind="stable")
    axes.errorbar(
        places[order],
        mean[order],
        sd[order] if flat.shape[1] == values.sizes[of.SEED] else None,
        fmt="o" if sampled or words else "o-",
        color=style.BLUE if sampled else style.QUIET,
        ms=4.5,
        lw=1.4,
        elinewidth=1.1,
        capsize=0 if sampled else 2.5,
        zorder=3,
    )
    lost = places[(runs == "failed").any(axis=1)]
    axes.plot(
        lost,
        np.full(len(lost), 0.02),
        "x",
        color=style.RED,
        zorder=4,
        transform=axes.get_xaxis_transform(),
    )
    axes.set_xlabel(shown.label)
    if words:
        axes.set_xticks(range(len(shown.texts)), shown.texts)
        axes.set_xlim(-0.6, len(shown.texts) - 0.4)
        return
    if shown.log:
        axes.set_xscale("log")
    assert shown.numbers is not None
    if _readable(shown.numbers, shown.log):
        axes.set_xticks(shown.numbers, shown.texts)
        axes.minorticks_off()
    elif not shown.log:
        axes.xaxis.set_major_locator(MaxNLocator(5))
    else:
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
        _write_plainly(axes.xaxis, of.number_text)


def _readable(numbers: FloatArray, log: bool) -> bool:
    """Return whether ticks at all values leave room for their labels."""
    places = np.sort(np.log(numbers) if log else numbers)
    apart = np.diff(places)
    return len(places) <= _MAX_TICKS and bool((apart >= _TICK_ROOM * np.ptp(places)).all())
