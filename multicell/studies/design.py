"""Designs: which points of the space of parameters a study runs.

A grid runs all combinations of its axes; a list runs the rows of a table; Latin hypercube and
Sobol' sequence (Sobol' 1967, scrambled after Owen 1995, both by :mod:`scipy.stats.qmc`) spread a
number of points evenly over ranges.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, final

from multicell.errors import SceneError
from multicell.scene.scene import Scene
from multicell.schema import near_miss
from multicell.studies import axes as of
from multicell.studies.axes import Axis, Range, is_numeric, parse_axis, parse_range
from multicell.studies.keys import key_of
from multicell.studies.limits import check_runs
from multicell.units import shown

DESIGNS: Final = ("grid", "list", "lhs", "sobol")
SAMPLED: Final = ("lhs", "sobol")  # designs that draw a number of points from ranges


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
    - ``axes``: of a grid, the last one running fastest; axes and ranges of samples; of a list its
      columns, all of one length
    - ``size``: number of points of a sample, else 0
    - ``sample_seed``: of a sample's random numbers
    """

    kind: str = "grid"
    axes: tuple[Axis | Range, ...] = ()
    size: int = 0
    sample_seed: int = 0
    points: tuple[Point, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_form(self)
        object.__setattr__(self, "axes", tuple(of.with_unique_names(self.axes)))
        object.__setattr__(self, "points", tuple(_points(self)))


def check_form(design: Design) -> None:
    """Refuse a design whose parts do not go together, or that has too many points."""
    if design.kind not in DESIGNS:
        problem = f"is {shown(design.kind)}, must be one of {', '.join(DESIGNS)}"
        raise SceneError("design", problem, near_miss(design.kind, DESIGNS, listed=False))
    if design.kind in SAMPLED:
        _check_sample(design)
    else:
        _check_lists(design)
    keys = [axis.key for axis in design.axes]
    for key in keys:
        if keys.count(key) > 1:
            raise SceneError(key, "is varied twice", "Give all its values at once.")


def _check_sample(design: Design) -> None:
    """Refuse a sample of nothing, and a size that is none."""
    if not design.axes:
        hint = "Give ranges, such as nutrients.oxygen.boundary = '0.05:0.3 mM'."
        raise SceneError("vary", f"is empty: a design of kind '{design.kind}' draws points", hint)
    size = design.size
    if design.kind == "sobol" and size & (size - 1):
        low = 1 << (size.bit_length() - 1)
        hint = f"Its points fill the space evenly then: take {low} or {2 * low}."
        raise SceneError("size", f"is {size}, must be a power of two in a Sobol' sequence", hint)


def _check_lists(design: Design) -> None:
    """Refuse ranges where values are needed, lists of unequal lengths, and too many points."""
    for axis in design.axes:
        if isinstance(axis, Range):
            ends = f"{axis.low:g}:{axis.high:g}"
            unit = f" {axis.unit}" if axis.unit else ""
            problem = (
                f"has a range, {ends}{unit}, but a design of kind '{design.kind}' needs values"
            )
            hint = f"'{ends}:5{unit}' are five of them; or sample it (--design lhs or sobol)."
            raise SceneError(axis.key, problem, hint)
    if design.size:
        problem = f"has no meaning in a design of kind '{design.kind}'"
        raise SceneError("size", problem, "It is the number of points of a sample.")
    columns = [axis for axis in design.axes if isinstance(axis, Axis)]
    if design.kind == "grid":
        check_runs(math.prod(len(axis.values) for axis in columns), 1, "vary")
        return
    if not columns:
        raise SceneError("points", "is empty", "A list needs a column for each key.")
    if len({len(axis.values) for axis in columns}) > 1:
        words = ", ".join(f"{axis.key} has {len(axis.values)}" for axis in columns)
        hint = "The values of a point stand at the same places of their lists."
        raise SceneError(columns[0].key, f"goes with lists of other lengths: {words}", hint)
    check_runs(len(columns[0].values), 1, "points")


def _points(design: Design) -> Iterator[Point]:
    """Yield all points, the last axis running fastest."""
    if design.kind in SAMPLED:
        yield from _sample_points(design)
        return
    axes = [axis for axis in design.axes if isinstance(axis, Axis)]
    sides = [range(len(axis.values)) for axis in axes]
    places = zip(*sides, strict=True) if design.kind == "list" else itertools.product(*sides)
    for row in places:
        chosen = list(zip(axes, row, strict=True))
        yield Point(
            {axis.key: axis.values[place] for axis, place in chosen},
            {axis.name: axis.coordinates[place] for axis, place in chosen},
        )


def _sample_points(design: Design) -> Iterator[Point]:
    """Yield points that fill ranges, and the values of axes, evenly."""
    from scipy.stats import qmc

    width = len(design.axes)
    if design.kind == "lhs":
        shares = qmc.LatinHypercube(width, rng=design.sample_seed).random(design.size)
    else:
        sampler = qmc.Sobol(width, scramble=True, rng=design.sample_seed)
        shares = sampler.random_base2(design.size.bit_length() - 1)
    for row in shares.tolist():
        values: dict[str, Any] = {}
        coordinates: dict[str, Any] = {}
        for axis, share in zip(design.axes, row, strict=True):
            if isinstance(axis, Range):
                number = axis.value(share)
                values[axis.key], coordinates[axis.name] = axis.setting(number), number
            else:
                place = min(int(share * len(axis.values)), len(axis.values) - 1)
                values[axis.key] = axis.values[place]
                coordinates[axis.name] = axis.coordinates[place]
        yield Point(values, coordinates)


def parse_axis_or_range(key: str, given: Any, scene: Scene, sampled: bool = False) -> Axis | Range:
    """Return the axis or the range that a text or a list describes.

    A text is a range where it has one colon (``"8:25 h"``), else it lists values; a tuple is one
    where points are sampled.
    """
    if sampled and isinstance(given, tuple):
        return parse_range(key, given, scene)
    colon = isinstance(given, str) and given.count(":") == 1
    if colon and not given.lstrip().startswith("[") and is_numeric(key_of(scene, key)):
        return parse_range(key, given, scene)
    return parse_axis(key, given, scene)
