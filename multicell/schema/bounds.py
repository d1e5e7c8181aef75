"""Numbers within bounds, and curves of them: how they are read from what a user wrote."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, final

from multicell.errors import SceneError
from multicell.units import RANGES, finite, shown, to_base


@final
@dataclass(frozen=True)
class Bounds:
    """An interval with open or closed ends."""

    above: float | None = None
    at_least: float | None = None
    at_most: float | None = None
    below: float | None = None

    def contain(self, value: float) -> bool:
        """Return whether ``value`` lies inside."""
        return not (
            (self.above is not None and not value > self.above)
            or (self.at_least is not None and not value >= self.at_least)
            or (self.at_most is not None and not value <= self.at_most)
            or (self.below is not None and not value < self.below)
        )

    def words(self, unit: str = "") -> str:
        """Return for example ``"above 0 um and at most 5 um"``."""
        tail = f" {unit}" if unit else ""
        ends = ((name.replace("_", " "), end) for name, end in vars(self).items())
        return " and ".join(f"{name} {end:g}{tail}" for name, end in ends if end is not None)

    def require(self, value: float, given: object, path: str, unit: str, hint: str) -> None:
        """Raise ``SceneError`` if ``value``, which the user wrote as ``given``, lies outside."""
        if not self.contain(value):
            tail = f" {unit}" if unit else ""
            text = given if isinstance(given, str) else f"{shown(given)}{tail}"
            raise SceneError(path, f"is {text}, must be {self.words(unit)}", hint)


Read = Callable[[Any, str], float]
"""Turns what a user wrote and its path into a number in base units, or raises ``SceneError``."""


def reader(unit: str, bounds: Bounds, wanted: str = "a number", hint: str = "") -> Read:
    """Return a reader of a quantity, or of a number without dimension where ``unit`` is empty.

    Besides the bounds its size is checked (:data:`multicell.units.RANGES`): these ranges are orders
    of magnitude beyond any use and keep out what would hang, overflow or end in nonsense.
    """
    smallest, largest = RANGES.get(unit, RANGES[""])
    if bounds.at_least:
        smallest = min(smallest, abs(bounds.at_least))

    def read(value: Any, path: str) -> float:
        result = to_base(value, unit, path) if unit else finite(value, path, wanted)
        bounds.require(result, value, path, unit, hint)
        if result == 0.0 or smallest <= abs(result) <= largest:
            return result
        tail, zero = f" {unit}" if unit else "", "0 or " if bounds.contain(0.0) else ""
        size = f"{zero}from {smallest:g} to {largest:g}{tail} in size"
        remark = "Anything beyond is far from cells, media and their world."
        raise SceneError(path, f"is {result:g}{tail}, must be {size}", remark)

    return read


Curve = tuple[tuple[float, float], ...]
"""Points (x, y) of a piecewise linear function, x rising."""


def read_points(given: object, path: str, wanted: str, example: str) -> list[tuple[Any, Any]]:
    """Return the points that a list of two-element lists gives, or raise ``SceneError``."""
    points = list(given) if isinstance(given, list | tuple) else []
    if not points or not all(isinstance(p, list | tuple) and len(p) == 2 for p in points):
        wrong = [p for p in points if not isinstance(p, list | tuple) or len(p) != 2]
        several = len(points) > 1 and len(wrong) > 0
        what = f"has the entry {str(wrong[0])[:40]}" if several else f"is {shown(given)}"
        raise SceneError(path, f"{what}, must be {wanted}", f"For example {example}.")
    return [(a, b) for a, b in points]


def rises(points: Curve) -> bool:
    """Return whether x rises from point to point."""
    return all(a < b for (a, _), (b, _) in itertools.pairwise(points))


def in_time(given: object, path: str, unit: str, y: Read) -> Curve:
    """Return a curve over time in s, or raise ``SceneError``."""
    wanted = f"{'' if unit else 'a number or '}a list of [time, value]"
    example = f"[['10 h', '{f'0.1 {unit}' if unit else '0.1'}']]"
    time = reader("s", Bounds())
    result = tuple(
        (time(a, path), y(b, path)) for a, b in read_points(given, path, wanted, example)
    )
    if not rises(result):
        times = [time for time, _ in result]
        raise SceneError(path, f"has the times {times} s, must have times that rise")
    return result


def lists(points: Curve) -> list[list[float]]:
    """Return a curve as a scene file has it."""
    return [list(point) for point in points]
