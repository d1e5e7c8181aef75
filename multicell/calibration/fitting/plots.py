"""Pictures of a fit: data beside runs, and the posterior of the parameters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from multicell.calibration.fitting.constraints import values_at
from multicell.calibration.fitting.profile import LikelihoodProfile, profile_of
from multicell.calibration.fitting.verdict import quantiles
from multicell.calibration.shared.confidence import BAND, LEVEL, TAILS
from multicell.measured.noise import Array
from multicell.report.plots.style import BLUE, INK, QUIET, RED, counts, styled
from multicell.report.wording import TimeUnit, time_unit, written
from multicell.studies.picture_data import with_unit, words
from multicell.studies.pictures import panels, with_heading

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from multicell.calibration.fitting.numbers import FitNumbers
    from multicell.measured.data import Datum
    from multicell.studies.axes import Range

_COLOURS: Final = (
    "#0072b2",
    "#e69f00",
    "#009e73",
    "#cc79a7",
    "#56b4e9",
    "#a04000",
    "#6a5acd",
    "#7a8b00",
)
_MAX_PAIRED: Final = 6  # parameters that are drawn pairwise; of more the first ones
_UPRIGHT: Final = 9  # single data whose labels stand beside each other
_ZOOMED: Final = 0.35  # part of a range below which only that is drawn


@final
class FitPlots:
    """The pictures of one fit; calling it draws data and runs."""

    def __init__(self, fit: FitNumbers) -> None:
        self._fit = fit

    @styled
    def data(self) -> Figure:
        """Draw each observable in a panel of its own: against time, or datum by datum."""
        fit = self._fit
        shown = _panels(fit)
        single = [numbers for _, timed, numbers in shown if not timed]
        columns = 1 if any(len(numbers) > 4 for numbers in single) else min(len(shown), 2)
        height = 4.6 if any(len(numbers) > _UPRIGHT for numbers in single) else 3.9
        tissues = "" if fit.sample is None else ", band: 95 % of what tissues would show"
        misfit = f"χ² {fit.best.per_datum:.2g} a datum"
        subtitle = f"bars: standard deviations, lines: best runs{tissues}; {misfit}"
        height = 1.15 + height * -(-len(shown) // columns)
        figure, grid = panels(_title(fit), subtitle, len(shown), columns, height)
        band = fit.predicted(BAND)
        for axes, (name, over, numbers) in zip(grid, shown, strict=True):
            unit = fit.problem.measured.units[name]
            axes.set_title(with_unit(words(name), written(unit)))
            if over:
                _over_axis(axes, fit, numbers, band)
            else:
                _one_by_one(axes, fit, numbers, band)
            if fit.problem.measured.data[numbers[0]].log:
                axes.set_yscale("log")
                low, high = axes.get_ylim()
                few = high < 10.0 * low  # of 1, 2 and 5 perhaps a single one lies within
                axes.yaxis.set_major_locator(
                    LogLocator(subs=range(1, 10) if few else (1.0, 2.0, 5.0))
                )
                axes.yaxis.set_minor_formatter(NullFormatter())
                counts(axes.yaxis)
            else:
                axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
        return figure

    __call__ = data

    @styled
    def profile(self) -> Figure:
        """Draw the profile likelihood of each parameter, with its interval of 95 %."""
        ranges = self._fit.problem.ranges
        columns = min(len(ranges), 3)
        height = 1.4 + 3.3 * -(-len(ranges) // columns)
        subtitle = "red: best, dashed: 95 % of χ² with one degree of freedom, dotted: interval"
        figure, grid = panels(_title(self._fit), subtitle, len(ranges), columns, height)
        for axes, free in zip(grid, ranges, strict=True):
            _draw_profile(axes, profile_of(self._fit, free.name), free)
        return figure

    @styled
    def deviations(self) -> Figure:
        """Draw the residual of each datum, each observable in a colour."""
        fit, found = self._fit, self._fit.best.residuals
        names = list(dict.fromkeys(datum.observable for datum in fit.problem.measured.data))
        subtitle = (
            f"best runs less data, in standard deviations; χ² {fit.best.per_datum:.2g} a datum"
        )
        figure = with_heading(_title(fit), subtitle, (10.0, 4.6))
        axes = figure.subplots()
        for k, name in enumerate(names):
            chosen = [d.observable == name for d in fit.problem.measured.data]
            places, colour = np.flatnonzero(chosen), _COLOURS[k % len(_COLOURS)]
            axes.vlines(places, 0.0, found[places], color=colour)
            axes.plot(places, found[places], "o", color=colour, label=words(name))
        axes.axhline(0.0, color=INK, linewidth=0.8)
        for limit in (-1.96, 1.96):
            axes.axhline(limit, color=QUIET, linestyle="--", linewidth=0.8)
        axes.set(xlabel="datum, in the order of the table", ylabel="residual (sd)")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.legend(loc="best", fontsize=10)
        return figure

    @styled
    def parameters(self) -> Figure:
        """Draw the posterior: each parameter on the diagonal, pairs below it.

        Axes are the ranges that were searched; of a parameter whose posterior fills a small part of
        its range they are that part, and how much it is stands in its panel.
        """
        fit = self._fit
        ranges = fit.problem.ranges[:_MAX_PAIRED]
        count = len(ranges)
        size = max(6.25, 2.3 * count + 1.5)
        known = "too few points for a posterior"
        if fit.sample is not None:
            known = "posterior by Gaussian processes through the runs"
        subtitle = f"{known}; red: best, dashed: before the data, dotted: 95 %"
        figure = with_heading(_title(fit), subtitle, (max(size, 10.0), size))
        grid = figure.subplots(count, count, squeeze=False)
        sample = fit.sample
        windows = [_window(fit, k) for k in range(count)]
        for i in range(count):
            for j, axes in enumerate(grid[i]):
                if j > i:
                    axes.set_axis_off()
                    continue
                if i == j:
                    _marginal(axes, fit, ranges[i], i, sample, windows[i])
                else:
                    _pair(axes, fit, (ranges[j], ranges[i]), (j, i), sample)
                _edges(axes, (ranges[j], ranges[i]), (windows[j], windows[i]), (i, j), count)
        return figure


def _draw_profile(axes: Axes, profile: LikelihoodProfile, free: Range) -> None:
    from scipy import stats

    limit = float(stats.chi2.ppf(LEVEL, 1))
    size = _unit(free)[1]
    axes.plot(profile.values / size, profile.loss, color=BLUE, lw=2)
    axes.axhline(limit, color=QUIET, lw=1.0, ls="--")
    for end in profile.interval():
        if np.isfinite(end):
            axes.axvline(end / size, color=INK, lw=0.9, ls=":")
    axes.axvline(profile.best / size, color=RED, lw=1.6)
    axes.set_ylim(-0.2 * limit, 4.0 * limit)  # its foot keeps clear of the labels below
    axes.set_xlim(profile.values[0] / size, profile.values[-1] / size)
    if free.log and free.high > 10.0 * free.low:
        axes.set_xscale("log")
    known = "" if profile.identified() else ": not bounded"
    axes.set_title(f"{_label(free)}{known}")
    axes.set_ylabel("-2 ln (L / best)")


def _panels(fit: FitNumbers) -> list[tuple[str, bool, list[int]]]:
    """Return observable, whether it is over time, and the numbers of the data, by panel."""
    found: dict[tuple[Any, ...], list[int]] = {}
    for number, datum in enumerate(fit.problem.measured.data):
        when = datum.time is not None if datum.depth is None else datum.time
        found.setdefault((datum.observable, when), []).append(number)
    panels = []
    for (name, _), numbers in found.items():
        places = {_abscissa(fit.problem.measured.data[k]) for k in numbers}
        panels.append((name, None not in places and len(places) > 1, numbers))
    return panels


def _abscissa(datum: Datum) -> float | None:
    """Return the abscissa of a datum in a chart: its depth, else its time."""
    return datum.time if datum.depth is None else datum.depth


def _over_axis(axes: Axes, fit: FitNumbers, numbers: Sequence[int], band: Array) -> None:
    """Draw one observable against time or depth, each condition in a colour."""
    data = fit.problem.measured.data
    profile = data[numbers[0]].depth is not None
    unit = time_unit(max(data[k].time or 0.0 for k in numbers))
    if profile:
        unit = TimeUnit("µm", 1.0)
    conditions = list(dict.fromkeys(data[k].condition for k in numbers))
    for condition in conditions:
        own = sorted(
            (k for k in numbers if data[k].condition == condition),
            key=lambda k: _abscissa(data[k]) or 0.0,
        )
        colour = _COLOURS[condition % len(_COLOURS)]
        times = np.array([_abscissa(data[k]) or 0.0 for k in own]) / unit.seconds
        axes.fill_between(times, band[0, own], band[2, own], color=colour, alpha=0.22, linewidth=0)
        axes.plot(times, fit.best.readings[own], color=colour, linewidth=1.8)
        label = fit.problem.measured.conditions[condition].label
        _draw_data(axes, times, [data[k] for k in own], color=colour, label=label)
    axes.set_xlabel("depth below the surface (µm)" if profile else f"time ({unit.name})")
    if not profile:
        axes.set_xlim(left=0.0)
    if len(conditions) > 1:
        axes.legend(fontsize=9)


def _one_by_one(axes: Axes, fit: FitNumbers, numbers: Sequence[int], band: Array) -> None:
    """Draw the data of one observable side by side."""
    data, places = fit.problem.measured.data, np.arange(len(numbers))
    own = list(numbers)
    lower, upper = band[0, own], band[2, own]
    axes.bar(places, upper - lower, 0.5, bottom=lower, color=BLUE, alpha=0.22, linewidth=0)
    for place, value in zip(places, fit.best.readings[own], strict=True):
        axes.plot([place - 0.25, place + 0.25], [value, value], color=BLUE, linewidth=2.0)
    _draw_data(axes, places, [data[k] for k in own], color=INK)
    names = [_place(fit, data[k]) for k in own]
    if len(own) <= _UPRIGHT:
        axes.set_xticks(places, [name.replace(", ", "\n") for name in names], fontsize=9)
    else:
        axes.set_xticks(places, names, fontsize=8, rotation=90)
    same = {_when(data[k]) for k in own}
    if len(same) == 1:
        axes.set_xlabel(same.pop())
    axes.set_xlim(-0.6, len(own) - 0.4)
    axes.grid(False, axis="x")


def _draw_data(axes: Axes, places: Any, data: Sequence[Datum], **how: Any) -> None:
    """Draw data at places, with bars of one standard deviation."""
    lower = [d.value * -np.expm1(-d.sigma) if d.log else d.deviation for d in data]
    upper = [d.value * np.expm1(d.sigma) if d.log else d.deviation for d in data]
    edge: dict[str, Any] = {"markeredgecolor": "white", "markeredgewidth": 0.6}
    values, bars = [d.value for d in data], np.array([lower, upper])
    axes.errorbar(places, values, bars, fmt="o", markersize=5, capsize=3, **edge, **how)


def _place(fit: FitNumbers, datum: Datum) -> str:
    """Return where a datum belongs, in words; what all of them share stands below the panel."""
    measured = fit.problem.measured
    same = {_when(d) for d in measured.data if d.observable == datum.observable}
    parts = []
    if len(measured.conditions) > 1:
        parts.append(measured.conditions[datum.condition].label)
    if len(same) > 1:
        parts.append(_when(datum))
    return ", ".join(parts)


def _when(datum: Datum) -> str:
    """Return when a datum was measured, in words."""
    return "at the end" if datum.time is None else f"after {time_unit(datum.time).text(datum.time)}"


def _unit(free: Range) -> tuple[str, float]:
    """Return the unit that a parameter is shown in, and its size in base units."""
    if free.unit == "s":
        unit = time_unit(free.high)
        return unit.name, unit.seconds
    return written(free.unit), 1.0


def _label(free: Range) -> str:
    return with_unit(words(free.name), _unit(free)[0])


def _window(fit: FitNumbers, k: int) -> tuple[float, float]:
    """Return the part of a range that is drawn: all of it, or where the posterior is."""
    if fit.sample is None:
        return 0.0, 1.0
    low, high = quantiles(fit.sample[:, k], (0.001, 0.999))
    free = fit.problem.ranges[k]
    best = free.share(fit.best.values[free.key])
    low, high = min(low, best), max(high, best)
    if high - low > _ZOOMED:
        return 0.0, 1.0
    more = 0.35 * (high - low) + 1e-3
    return max(0.0, float(low - more)), min(1.0, float(high + more))


def _at(free: Range, shares: Array) -> Array:
    """Return the values at shares of a range in the unit that is shown, as if not whole."""
    return values_at(free, shares) / _unit(free)[1]


def _marginal(
    axes: Axes, fit: FitNumbers, free: Range, k: int, sample: Any, window: tuple[float, float]
) -> None:
    if sample is not None:
        edges = np.linspace(*window, 33)
        heights, _ = np.histogram(sample[:, k], edges)
        heights = heights / (len(sample) * (edges[1] - edges[0]))
        axes.stairs(heights, _at(free, edges), fill=True, color=BLUE, alpha=0.55)
        ends = quantiles(sample[:, k], TAILS)
        for x in _at(free, ends):
            axes.axvline(x, color=INK, linewidth=0.9, linestyle=":")
        axes.set_title(
            f"95 %: {100.0 * (ends[1] - ends[0]):.0f} % of its range", fontsize=10, weight="normal"
        )
    before = np.linspace(*window, 101)
    density = fit.problem.prior.marginal(k, before)
    axes.plot(_at(free, before), density, color=QUIET, linewidth=1.0, linestyle="--")
    axes.axvline(fit.best.values[free.key] / _unit(free)[1], color=RED, linewidth=1.6)
    axes.set_ylim(bottom=0.0)
    axes.set_yticks([])
    axes.grid(False)


def _pair(
    axes: Axes, fit: FitNumbers, pair: tuple[Range, Range], places: tuple[int, int], sample: Any
) -> None:
    if sample is not None:
        chosen = np.random.default_rng(0).choice(sample, 600)
        x, y = (_at(free, chosen[:, k]) for free, k in zip(pair, places, strict=True))
        axes.plot(x, y, ".", color=BLUE, alpha=0.3, markersize=4, markeredgewidth=0)
    at = [fit.best.values[free.key] / _unit(free)[1] for free in pair]
    axes.plot(*at, "x", color=RED, markersize=9, markeredgewidth=2.0, clip_on=False)


def _edges(
    axes: Axes,
    ranges: tuple[Range, Range],
    windows: tuple[tuple[float, float], tuple[float, float]],
    place: tuple[int, int],
    count: int,
) -> None:
    """Set the ends and the labels of one panel: of the range across, and of that upwards."""
    row, column = place
    for k, axis in enumerate((axes.xaxis, axes.yaxis)):
        if k == 1 and row == column:
            continue
        low, high = _at(ranges[k], np.array(windows[k]))
        (axes.set_xlim, axes.set_ylim)[k](low, high)
        if ranges[k].log and high > 10.0 * low:
            (axes.set_xscale, axes.set_yscale)[k]("log")
        else:
            axis.set_major_locator(MaxNLocator(4, prune="both"))
    if row == count - 1:
        axes.set_xlabel(_label(ranges[0]), fontsize=10)
    else:
        axes.tick_params(labelbottom=False)
    if column == 0 and row > 0:
        axes.set_ylabel(_label(ranges[1]), fontsize=10)
    elif row != column:
        axes.tick_params(labelleft=False)


def _title(fit: FitNumbers) -> str:
    return f"{fit.scene.title or 'Untitled scene'}: fit"
