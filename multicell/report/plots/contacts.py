"""Pictures of contact: how cell types mix, and how cells are pulled apart."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from multicell.cells import Cells, FloatArray
from multicell.contact.pair import Pair
from multicell.population.extents import sizes
from multicell.report.plots import style
from multicell.report.wording import TimeUnit, percent, time_unit
from multicell.results.frame import Frame
from multicell.scene.pairs import pair_of
from multicell.scene.scene import Scene


def random_mixing(cells: Cells) -> float:
    """Return the heterotypic part of all contacts if types were dealt to the cells at random.

    With n_k of N cells of type k it is 1 - Σ n_k (n_k - 1) / (N (N - 1)); NaN below two cells.
    """
    count = len(cells)
    if count < 2:
        return float("nan")
    numbers = np.bincount(cells.kind).astype(float)
    return float(1.0 - (numbers * (numbers - 1.0)).sum() / (count * (count - 1.0)))


@style.styled
def contacts(frames: Sequence[Frame], history: style.History, scene: Scene) -> Figure:
    """Draw heterotypic contacts, and all contacts."""
    if len(history.get("heterotypic_fraction", ())) == 0:
        raise ValueError("the history has no contacts of different types: nothing to draw")
    end = float(history["time"][-1])
    unit, time = time_unit(end), history["time"] / time_unit(end).seconds
    mixed = history["heterotypic_fraction"]
    change = f"heterotypic contacts {percent(mixed[0])} at first, {percent(mixed[-1])} at last"
    figure = style.headed(scene, f"After {unit.text(end)}: {change}")
    upper, lower = style.panel_grid(figure, 2, 1, (0.09, 0.11, 0.97, 0.82), (0.0, 0.34))
    _draw_fraction(upper, frames, 100.0 * mixed, time, unit)
    style.draw_line(lower, time, history["contacts"], style.INK)
    lower.set_ylim(0.0, 1.12 * max(float(history["contacts"].max()), 1.0))
    lower.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=5))
    style.counts(lower.yaxis)
    lower.set(title="Contacts", ylabel="number of pairs")
    style.time_axes(figure.axes, time, unit)
    upper.set_xlabel("")
    return figure


def _draw_fraction(
    axes: Axes, frames: Sequence[Frame], fraction: FloatArray, time: FloatArray, unit: TimeUnit
) -> None:
    style.draw_line(axes, time, fraction, style.BLUE, label="as simulated")
    when = np.array([frame.time for frame in frames]) / unit.seconds
    mixed = np.array([100.0 * random_mixing(frame.cells) for frame in frames])
    dashes = "--" if len(when) > 1 else "x"
    axes.plot(when, mixed, dashes, color=style.INK, lw=1.6, label="random mixing of these numbers")
    shown = np.concatenate([fraction, mixed])
    shown = shown[np.isfinite(shown)]
    low, high = (float(shown.min()), float(shown.max())) if len(shown) else (0.0, 100.0)
    room = max(high - low, 4.0)
    axes.set_ylim(max(low - 0.1 * room, 0.0), high + 0.5 * room)
    axes.set(title="Contacts between unlike cells", ylabel="of all contacts (%)")
    axes.legend(loc="upper right", fontsize=11)


def distance_of_two(diameter: FloatArray, cells: Cells, dimensions: int) -> FloatArray:
    """Return the distance of two cells of constant radii from their common diameter, µm.

    It inverts :func:`multicell.population.extents.uniform_radius`: with the parts p of the volume
    (in a plane of the area) and q = d / (d + 2), q R² = p₁ p₂ x² + q (p₁ r₁² + p₂ r₂²).
    """
    size = sizes(cells, dimensions)
    part = size / size.sum()
    own = float(part @ cells.radius**2)
    share = dimensions / (dimensions + 2)
    square = share * (0.25 * np.square(diameter) - own) / float(np.prod(part))
    return np.sqrt(np.maximum(square, 0.0))


def _pair(cells: Cells, scene: Scene, time: float) -> Pair:
    i, j = (int(kind) for kind in cells.kind[:2])
    one, other = (float(radius) for radius in cells.radius[:2])
    young = (float(cells.young[0]), float(cells.young[1]))
    return pair_of(scene, i, j, one, other, time, young)


@style.styled
def pull(frames: Sequence[Frame], history: style.History, scene: Scene) -> Figure:
    """Draw the pull over the distance of two cells, or over the diameter of more."""
    if len(history.get("pull", ())) == 0 or len(frames) == 0:
        raise ValueError("the run has no pull: nothing to draw")
    force, time = history["pull"], history["time"]
    last = int(np.flatnonzero(history["contacts"] > 0).max(initial=-1))  # -1: there never was one
    broken = 0 <= last < len(force) - 1
    top = float(force[min(last + 1, len(force) - 1)])
    progress = frames[-1].progress
    if broken and progress is not None and progress.separation is not None:
        top = progress.separation["force"]  # of its own time within the step
    outcome = f"the last contact broke at {top:.4g} nN" if broken else "not pulled apart"
    end = float(time[-1])
    figure = style.headed(scene, f"After {time_unit(end).text(end)}: {outcome}")
    axes = figure.add_axes((0.09, 0.12, 0.87, 0.63))
    axes.set_ylabel("force (nN)")
    two = len(frames[0].cells) == 2 and scene.growth is None
    x = history["diameter"]
    if two:
        x = distance_of_two(x, frames[0].cells, scene.dimensions)
    axes.set_xlabel("distance of the two centres (µm)" if two else "diameter of all cells (µm)")
    kept = slice(0, max(last, 0) + 1)
    style.draw_line(axes, x[kept], force[kept], style.BLUE, lw=2.4, label="pull", zorder=3)
    when = float(time[max(last, 0)])
    if two:
        _draw_law(axes, _pair(frames[0].cells, scene, when), x[kept])
    if broken:
        label = f"last contact broken at {top:.4g} nN"
        axes.plot(x[last], top, "o", color=style.RED, ms=10, label=label, zorder=4)
    axes.set_ylim(0.0, 1.1 * max(top, axes.dataLim.y1, 1e-3))
    figure.legend(loc="upper left", bbox_to_anchor=(0.08, 0.88), ncols=2)
    return figure


def _draw_law(axes: Axes, pair: Pair, x: FloatArray) -> None:
    load, _ = pair.deepest()
    nearest = min(float(x.min()), pair.distance())
    furthest = max(pair.rest + 1.05 * pair.reach(), float(x.max()))
    d = np.linspace(nearest, furthest, 600)
    attraction = -pair.force(pair.rest - d)
    shown = attraction > 0.0
    axes.plot(d[shown], attraction[shown], color=style.QUIET, lw=1.2, label="attraction of the law")
    if load > 0.0:
        label = f"theory: largest attraction = {load:.4g} nN"
        axes.axhline(load, color=style.INK, lw=1.6, ls="--", label=label)
    margin = 0.03 * (furthest - nearest)
    axes.set_xlim(nearest - margin, furthest + margin)
