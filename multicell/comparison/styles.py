"""Styles of methods in a chart, of which at most eight are in colour."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final, NamedTuple

from multicell.comparison.base import Row
from multicell.comparison.ladders import Method
from multicell.integrators.base import MethodInfo
from multicell.integrators.registry import find
from multicell.report.plots.colour_vision import PALE, distinguishable_colours

if TYPE_CHECKING:
    from multicell.comparison.numbers import SolveTable

MAX_COLOURED: Final = 8
"""Most series in colour; with more, neither colours nor a legend can be followed."""


class Style(NamedTuple):
    """Colour (may be empty where it is chosen later), marker and line of a method."""

    colour: str
    marker: str
    line: str


class ChartPoint(NamedTuple):
    """One solve in a chart.

    The cost is the median of the repeats, between the shortest and the longest of them; `error`
    is dimensionless.
    """

    method: str
    cost: float
    error: float
    shortest: float
    longest: float


def points(result: SolveTable, norm: str, cost: str, method: str = "") -> list[ChartPoint]:
    """Return the solves of a method, or of all, that have a place on logarithmic axes."""
    methods = [method] if method else result.methods
    found = [_point(row, norm, cost) for name in methods for row in result.rows(name)]
    # an error of exactly zero has no place on a logarithmic axis
    return [p for p in found if p.cost > 0.0 and p.error > 0.0]


def _point(row: Row, norm: str, cost: str) -> ChartPoint:
    # counts are the same in every repeat
    shortest: float = row[cost]
    middle, longest = (row.get(f"{cost}_{which}", shortest) for which in ("median", "longest"))
    return ChartPoint(row["method"], middle, row[f"error_{norm}"], shortest, longest)


def pareto_front(solves: list[ChartPoint]) -> list[ChartPoint]:
    """Return the solves that none at the same or less cost beats in error, the cheapest first."""
    front: list[ChartPoint] = []
    for point in sorted(solves, key=lambda p: (p.cost, p.error)):
        if not front or point.error < front[-1].error:
            front.append(point)
    return front


def in_colour(result: SolveTable, norm: str) -> list[str]:
    """Return the at most eight methods that a chart shows in colour.

    First those on the Pareto front of error over the time that judges, then those that the user
    named, the scene's own method and ``auto``, and then the others: outside references, and those
    without a point in the chart, last.
    """
    solves = points(result, norm, result.clock)
    drawn = {point.method for point in solves}
    others = sorted(result.methods, key=lambda name: (name not in drawn, _info(name).outside))
    front = [point.method for point in pareto_front(solves)]
    named = [*result.facts.get("named", []), result.scene.integrator.method, "auto"]
    ranked = dict.fromkeys([*front, *named, *others])
    return [name for name in ranked if name in result.methods][:MAX_COLOURED]


def _info(name: str) -> MethodInfo:
    return find(name) or MethodInfo(name)


def appearance(result: SolveTable, norm: str = "") -> dict[str, Style]:
    """Return the style of every method: at most eight in colour, the others in :data:`PALE`.

    Colours are distinguishable (:func:`distinguishable_colours`).
    """
    norm = norm or result.main
    own = result.facts.get("looks", {})  # the name in files on disk
    preferred = {
        name: Style(*own[name]) if name in own else _style_of(_info(name))
        for name in result.methods
    }
    colours = distinguishable_colours(
        {name: preferred[name].colour for name in in_colour(result, norm)}
    )
    return {n: style._replace(colour=colours.get(n, PALE)) for n, style in preferred.items()}


def _style_of(info: MethodInfo) -> Style:
    return Style(info.colour, info.marker, "--" if info.outside else "-")


def unregistered_styles(methods: Sequence[Method]) -> dict[str, Style]:
    """Return the styles of the methods that the registry does not know."""
    return {m.name: _style_of(m.info) for m in methods if find(m.name) is None}
