"""Designs: which points of the space of parameters a study runs.

A grid runs all combinations of its axes; a list runs the rows of a table.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, final

from multicell.errors import SceneError
from multicell.schema import near_miss
from multicell.studies.axes import Axis, with_unique_names
from multicell.studies.limits import check_runs
from multicell.units import shown

DESIGNS: Final = ("grid", "list")


@final
@dataclass(frozen=True)
class Point:
    """One point of a design.

    - ``changes``: dotted key -> value, as :meth:`Scene.with_changes` takes them
    - ``coordinates``: axis name -> number in base units, or word
    """

    changes: Mapping[str, Any]
    coordinates: Mapping[str, float | str]

    def __str__(self) -> str:
        return ", ".join(f"{key} = {value!r}" for key, value in self.changes.items())


@final
@dataclass(frozen=True)
class Design:
    """What is varied, and how.

    - ``kind``: one of :data:`DESIGNS`
    - ``axes``: of a grid, the last one running fastest; of a list its columns, all of one length
    """

    kind: str = "grid"
    axes: tuple[Axis, ...] = ()
    points: tuple[Point, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_form(self)
        object.__setattr__(self, "axes", tuple(with_unique_names(self.axes)))
        object.__setattr__(self, "points", tuple(_points(self)))


def check_form(design: Design) -> None:
    """Refuse a design whose parts do not go together, or that has too many points."""
    if design.kind not in DESIGNS:
        problem = f"is {shown(design.kind)}, must be one of {', '.join(DESIGNS)}"
        raise SceneError("design", problem, near_miss(design.kind, DESIGNS, listed=False))
    keys = [axis.key for axis in design.axes]
    for key in keys:
        if keys.count(key) > 1:
            raise SceneError(key, "is varied twice", "Give all its values at once.")
    lengths = [len(axis.values) for axis in design.axes]
    if design.kind == "grid":
        check_runs(math.prod(lengths), 1, "vary")
        return
    if not keys:
        raise SceneError("points", "is empty", "A list needs a column for each key.")
    if len(set(lengths)) > 1:
        words = ", ".join(f"{key} has {n}" for key, n in zip(keys, lengths, strict=True))
        hint = "The values of a point stand at the same places of their lists."
        raise SceneError(keys[0], f"goes with lists of other lengths: {words}", hint)
    check_runs(lengths[0], 1, "points")


def _points(design: Design) -> Iterator[Point]:
    """Yield all points, the last axis running fastest."""
    sides = [range(len(axis.values)) for axis in design.axes]
    places = zip(*sides, strict=True) if design.kind == "list" else itertools.product(*sides)
    for row in places:
        chosen = list(zip(design.axes, row, strict=True))
        yield Point(
            {axis.key: axis.values[place] for axis, place in chosen},
            {axis.name: axis.coordinates[place] for axis, place in chosen},
        )
