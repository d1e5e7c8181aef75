"""Pages of sensitivity analyses, Morris' and Sobol', and pictures of indices with intervals."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from multicell.calibration.sensitivity.indices import CLEAR, CLEAR_SINGLE
from multicell.calibration.shared.wording import value_in_words
from multicell.report.html import Drawing, write_page
from multicell.report.plots.colour_vision import PALE
from multicell.report.plots.style import BLUE, QUIET, RED, SIZE, styled
from multicell.report.wording import written
from multicell.studies.picture_data import key_words, sentence, with_unit, words
from multicell.studies.pictures import with_heading

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from multicell.calibration.sensitivity.numbers import IndexTable, Row
    from multicell.cells import FloatArray
    from multicell.studies.axes import Range


def write_sensitivity_report(result: IndexTable, folder: Path) -> Path:
    """Write ``report.html`` and its pictures, and return the page."""
    names = ", ".join(key_words(free.key, free.name) for free in result.ranges)
    failed = {"runs that failed": f"{len(result.failures):,}"} if result.failures else {}
    pictures: dict[str, Drawing] = {}
    for name in result.observables:
        # where no index is known, or none above zero, a note says why
        if any(np.nan_to_num(row[result.leading]) for row in result.ordered(name)):
            caption = f"{sentence(words(name))}: {result.caption}"
            file = f"sensitivity-{name.replace('.', '_')}.png"
            pictures[file] = partial(result.plot, name), caption
    return write_page(
        folder / "report.html",
        result.template,
        scene=result.scene,
        title=sensitivity_title(result),
        subtitle=f"{result.kind} · {names}",
        tiles={
            "free parameters": f"{len(result.ranges)}",
            "points": f"{result.size * (len(result.ranges) + result.further):,}",
            "seeds": f"{len(result.seeds)}",
            **failed,
            **(_tiles(result) if result.leading == "mu_star" else {}),  # Morris' have verdicts
        },
        pictures=pictures,
        result=result,
        ends={free.key: _ends(free) for free in result.ranges},
    )


def sensitivity_title(result: IndexTable) -> str:
    """Return the title of pages and pictures."""
    return f"{result.scene.title or 'Untitled scene'}: sensitivity"


def _ends(free: Range) -> tuple[str, str]:
    """Return both ends of a range in words; long times in minutes, hours or days."""
    log = ", by ratio" if free.log else ""
    return value_in_words(free.low, free.unit), value_in_words(free.high, free.unit) + log


def _tiles(result: IndexTable) -> dict[str, str]:
    tiles = {"trajectories": f"{result.size:,}"}
    for name in result.observables[:3]:
        first = result.ordered(name)[0]
        if first["verdict"] in (CLEAR, CLEAR_SINGLE):
            tiles[f"decides {words(name)} most"] = key_words(first["key"], first["parameter"])
    return tiles


_MAX_LINES: Final = 7  # labels in the chart: more overlap
_NEAR_ORIGIN: Final = 0.02  # part of the chart's range within which labels would lie on each other


@styled
def indices(result: IndexTable, observable: str) -> Figure:
    """Draw the indices of an observable, the largest one on top, with 95 % intervals.

    What is not distinguishable from noise, or from zero, is pale; a red tick is what noise over
    the seeds alone would give.
    """
    rows = result.ordered(observable)
    seeds = f"{len(result.seeds)} seeds" if len(result.seeds) > 1 else "one seed: noise unknown"
    subtitle = (
        f"{sentence(words(observable))} at the end of each run · Morris, {result.size:,} "
        f"trajectories, {seeds} · bars: 95 % intervals"
    )
    figure = with_heading(
        sensitivity_title(result), subtitle, (SIZE[0], max(5.0, 1.9 + 0.36 * len(rows)))
    )
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    _bars(left, rows)
    _plane(right, rows)
    return figure


def _bars(axes: Axes, rows: list[Row]) -> None:
    """Draw bars with intervals, the first row on top; a red tick is the noise."""
    places, noise = np.arange(len(rows), dtype=float), np.array([row["noise"] for row in rows])
    colours = [BLUE if row["verdict"] in (CLEAR, CLEAR_SINGLE) else PALE for row in rows]
    _draw_column(axes, rows, "mu_star", places, 0.63, color=colours)
    there = noise > 0.0
    axes.vlines(noise[there], places[there] - 0.35, places[there] + 0.35, color=RED, lw=2, zorder=4)
    _name_rows(axes, [_shown(row) for row in rows])
    axes.set_xlabel(with_unit("mean size of the effect μ*", written(rows[0]["unit"])))


def _draw_column(
    axes: Axes, rows: list[Row], column: str, places: FloatArray, height: float, **how: Any
) -> None:
    """Draw a column of a table as bars with its intervals."""
    values, halves = (np.array([row[name] for row in rows]) for name in (column, f"{column}_conf"))
    axes.barh(places, np.nan_to_num(values), height, **how)
    axes.errorbar(
        values, places, xerr=halves, fmt="none", ecolor=QUIET, elinewidth=1.3, capsize=2.5
    )


def _name_rows(axes: Axes, names: list[str]) -> None:
    """Name bars, the first one on top, and draw the line where they begin."""
    axes.axvline(0.0, color=QUIET, lw=0.8)
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.grid(False, axis="y")


def _shown(row: Row) -> str:
    name = key_words(str(row["key"]), str(row["parameter"]))
    return name if len(name) <= 30 else f"{name[:29]}…"


def _plane(axes: Axes, rows: list[Row]) -> None:
    """Draw sigma over mu*: below the line effects are alike wherever the others are."""
    star = np.array([row["mu_star"] for row in rows])
    sigma = np.array([row["sigma"] for row in rows])
    half = np.array([row["mu_star_conf"] for row in rows])
    sure = np.array([row["verdict"] in (CLEAR, CLEAR_SINGLE) for row in rows])
    axes.errorbar(star, sigma, xerr=half, fmt="none", ecolor="#a9b5be", elinewidth=1.2, zorder=1)
    for clear, colour in ((True, BLUE), (False, "#a9b5be")):
        axes.plot(star[sure == clear], sigma[sure == clear], "o", color=colour, ms=7)
    ends = [v for v in (*(star + half), *sigma) if np.isfinite(v)]
    top = 1.12 * max(ends, default=1.0) or 1.0
    named: list[tuple[float, float]] = []
    for row, x, y in sorted(zip(rows[:_MAX_LINES], star, sigma, strict=False), key=lambda e: e[1]):
        if not max(x, y) > _NEAR_ORIGIN * top:
            continue  # names of what has no effect would lie on each other
        side: dict[str, Any] = {"ha": "right" if x > 0.55 * top else "left"}
        near = sum(abs(x - u) < 0.45 * top and abs(y - v) < 0.06 * top for u, v in named)
        named.append((x, y))
        axes.annotate(
            _shown(row),
            (x, y),
            (-6 if x > 0.55 * top else 6, 5 + 12 * near),
            textcoords="offset points",
            fontsize=8.5,
            **side,
        )
    axes.plot([0.0, top], [0.0, top], "--", color=QUIET, lw=1.0)
    axes.annotate("σ = μ*", (0.93 * top, 0.95 * top), ha="right", fontsize=9, color=QUIET)
    axes.set(xlim=(-0.02 * top, top), ylim=(-0.02 * top, top))
    axes.set_xlabel(with_unit("μ*", written(rows[0]["unit"])))
    axes.set_ylabel(with_unit("σ: interactions, curvature", written(rows[0]["unit"])))


@styled
def sobol_bars(result: IndexTable, observable: str) -> Figure:
    """Draw first and total indices of an observable, the largest total one on top."""
    rows = result.ordered(observable)
    subtitle = (
        f"{sentence(words(observable))} at the end of each run · Sobol', {result.size:,} points, "
        f"{len(result.seeds)} seed(s) · bars: 95 % intervals"
    )
    figure = with_heading(
        sensitivity_title(result), subtitle, (SIZE[0], max(4.0, 1.9 + 0.6 * len(rows)))
    )
    axes = figure.subplots()
    places = np.arange(len(rows), dtype=float)
    pairs = (("ST", 0.18, PALE, "total, with interactions"), ("S1", -0.18, BLUE, "alone"))
    for column, shift, colour, label in pairs:
        _draw_column(axes, rows, column, places + shift, 0.34, color=colour, label=label)
    _name_rows(axes, [key_words(str(row["key"]), str(row["parameter"])) for row in rows])
    axes.set_xlabel("part of the variance")
    axes.legend(loc="lower right")
    return figure
