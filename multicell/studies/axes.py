"""Axes of a study: values of keys, and ranges of free parameters.

A text is read as it is typed behind ``--vary`` or ``--free``: ``"0.07,0.14,0.28 mM"`` (a unit at
the end holds for all that have none), ``"0.05:0.30:6 mM"`` (six values, evenly spaced),
``"log 0.01:1:5 mM"``, ``"0, log 0.01:1:5 mM"`` (one more), ``"jkr,hertz"``, or a TOML list of
values; a range is ``"8:25 h"`` or ``"log 1e-3:1 1/s"``.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, final

from multicell.errors import SceneError
from multicell.host.files import parse_toml
from multicell.results.quantities import QUANTITY_UNITS
from multicell.scene.own_units import own_names
from multicell.scene.scene import Scene
from multicell.studies.keys import Key, key_of, refuse_ineffective
from multicell.studies.limits import MAX_POINTS
from multicell.units import shown

_NUMBER: Final = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
QUANTITY: Final = re.compile(rf"\s*({_NUMBER})\s*(.*?)\s*", re.DOTALL)
"""A number, and behind it a unit."""
_SPACED: Final = re.compile(rf"(log\s+)?({_NUMBER}):({_NUMBER}):(\d+)\s*(.*)")
_RANGE: Final = re.compile(rf"(log\s+)?({_NUMBER}):({_NUMBER})\s*(.*)")
_FIRST: Final = ("contact.law",)
"""Keys that are set before others: those that decide which others there are."""
_RANGES: Final = (
    "quantity",
    "number",
    "count",
    "measure",
    "quantities",
    "course",
    "drawn_numbers",
)


@final
@dataclass(frozen=True)
class Axis:
    """Values along one dimension.

    - ``key``: dotted key of a scene, ``"nutrients.oxygen.boundary"``
    - ``values``: as :meth:`Scene.with_changes` takes them: ``"0.07 mM"``, ``5``, ``"jkr"``
    - ``unit``: base unit of the key, empty for counts and words
    - ``numbers``: the values in base units; None where one of them is a word
    - ``name``: of the dimension: the last part of the key, or as much of it as makes it unique
    """

    key: str
    values: tuple[Any, ...]
    unit: str
    numbers: tuple[float, ...] | None
    name: str

    @property
    def coordinates(self) -> tuple[float | str, ...]:
        """The values as coordinates of a table: numbers in base units, or words."""
        if self.numbers is not None:
            return self.numbers
        return tuple(
            x if isinstance(x, str) else json.dumps(x, sort_keys=True) for x in self.values
        )


@final
@dataclass(frozen=True)
class Range:
    """The range of a free parameter.

    - ``key``: dotted key of a scene
    - ``low``, ``high``: ends in base units, ``low < high``
    - ``unit``: base unit of the key, empty for numbers without
    - ``log``: whether equal ratios count the same
    - ``name``: short name, as of an :class:`Axis`
    - ``whole``: whether only whole numbers are allowed
    """

    key: str
    low: float
    high: float
    unit: str
    log: bool
    name: str
    whole: bool

    def value(self, share: float) -> float:
        """Return the value in base units at a share from 0 (low) to 1 (high) of the range."""
        if self.whole:
            # the number k has the part of the range from k to k + 1
            beyond = self.high + 1.0
            place = _between(self.low, beyond, share, self.log)
            return float(min(math.floor(place), self.high))
        if share >= 1.0:
            return self.high
        return _between(self.low, self.high, share, self.log)

    def share(self, value: float) -> float:
        """Return where a value in base units lies in the range, 0 at low and 1 at high."""
        if self.log:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)

    def setting(self, value: float) -> Any:
        """Return a value in base units as :meth:`Scene.with_changes` takes it."""
        return round(value) if self.whole else value


def _between(low: float, high: float, share: float, log: bool) -> float:
    return low * math.pow(high / low, share) if log else low + share * (high - low)


def parse_axis(key: str, text: str | Sequence[Any], scene: Scene) -> Axis:
    """Return the axis that a text or a list of values describes.

    - ``key``: dotted key of the scene
    - ``text``: as typed behind ``--vary``, or the values as :meth:`Scene.with_changes` takes them
    - ``scene``: the scene that is varied
    """
    found = key_of(scene, key)
    given = _listed(found, text) if isinstance(text, str) else _sequence(found, text)
    if not given:
        raise SceneError(found.name, "has no values", f"For example {_example(found)}.")
    plain = [found.plain(value) for value in given]
    numeric = all(isinstance(x, int | float) and not isinstance(x, bool) for x in plain)
    return Axis(
        found.name,
        tuple(given),
        found.unit,
        tuple(map(float, plain)) if numeric else None,
        found.name.rpartition(".")[2],
    )


def parse_range(key: str, text: str | Sequence[Any], scene: Scene) -> Range:
    """Return the range that a text or two (or with ``"log"`` three) values describe.

    - ``key``: dotted key of the scene
    - ``text``: ``"8:25 h"``, ``"log 1e-3:1 1/s"``, or ``("8 h", "25 h")`` and ``(1e-3, 1.0,
      "log")``
    - ``scene``: the scene that is varied
    """
    found = key_of(scene, key)
    if not is_numeric(found):
        problem = f"is no number, so {shown(text)} cannot be its range"
        raise SceneError(found.name, problem, "Vary it along an axis of values.")
    log, ends = _ends(found, text)
    plain = [found.plain(end) for end in ends]
    if not all(isinstance(end, int | float) for end in plain):
        raise SceneError(found.name, f"has the range {shown(text)}, must have two numbers")
    low, high = map(float, plain)
    if not low < high:
        problem = f"has the range {_described(text)}, must have the lower end first"
        raise SceneError(found.name, problem)
    if log and low <= 0.0:
        problem = f"has the range {_described(text)}, which has no logarithm"
        raise SceneError(found.name, problem, "Leave 'log' away, or begin above zero.")
    name = found.name.rpartition(".")[2]
    return Range(found.name, low, high, found.unit, log, name, found.spec.kind == "count")


def parse_ranges(free: Mapping[str, Any], scene: Scene) -> tuple[Range, ...]:
    """Return the ranges of free parameters; that they go together is for :func:`check_ranges`."""
    if not free:
        raise SceneError("free", "names no parameter", "For example drag.viscosity='1:10 kPa s'.")
    return tuple(with_unique_names(parse_range(key, text, scene) for key, text in free.items()))


def with_unique_names(axes: Iterable[Axis | Range]) -> list[Any]:
    """Return axes or ranges with names that are unique: as much of the keys as that takes."""
    axes = list(axes)
    # names of observables and of other coordinates
    taken = {"point", "state", "reason", *own_names(), *(n for n in QUANTITY_UNITS if "." not in n)}
    keys = {axis.key for axis in axes}
    result = []
    for axis in axes:
        parts = axis.key.split(".")
        for count in range(1, len(parts) + 1):
            name = ".".join(parts[-count:])
            others = (key for key in keys if key != axis.key)
            if name not in taken and not any(f".{key}".endswith(f".{name}") for key in others):
                break
        result.append(replace(axis, name=name))
    return result


def _listed(key: Key, text: str) -> list[Any]:
    """Return the values that a text lists."""
    text = text.strip()
    if text.startswith("["):
        try:
            return list(parse_toml(f"value = {text}")["value"])
        except ValueError as error:
            problem = f"has values that are not valid TOML: {shown(text)}"
            raise SceneError(key.name, problem, str(error)) from None
    if re.search(r"\d *\.\. *\d|^[^:,]*\d[^:,]*:[^:,]*\d[^:,]*$", text) and is_numeric(key):
        problem = f"is {shown(text)}, which is a range"
        hint = f"List the values: {_example(key)}, or write 'low:high:count unit'."
        if (found := re.match(r"([^:]*:\s*[\d.e+-]*\d)(.*)", text)) and ":" not in found[2]:
            hint = f"Write how many values: '{found[1]}:5{found[2]}' has five."
        raise SceneError(key.name, problem, hint)
    items = [item.strip() for item in text.split(",")] if text else []
    if not all(items):
        problem = f"has an empty value in {shown(text)}"
        raise SceneError(key.name, problem, f"For example {_example(key)}.")
    if items and is_numeric(key):
        return _with_unit(key, [one for item in items for one in _spaced(key, item)])
    return [bare(item) for item in items]


def _with_unit(key: Key, items: list[str]) -> list[Any]:
    """Return quantities as texts with units: that of the last one where they have none."""
    matches = [QUANTITY.fullmatch(item) for item in items]
    units = [match[2] if match else None for match in matches]
    shared = units[-1]
    if not shared and any(units):
        problem = f"has values with units and without: {', '.join(items)}"
        raise SceneError(key.name, problem, f"A unit at the end holds for all: {_example(key)}.")
    if shared and not all(units):
        _refuse_several(key, shared)
    values: list[Any] = []
    for item, match, unit in zip(items, matches, units, strict=True):
        if match is None:
            values.append(item)  # a word, such as 'auto'
        elif unit or shared:
            values.append(f"{match[1]} {unit or shared}")
        else:
            values.append(bare(match[1]))
    return values


def _refuse_several(key: Key, unit: str) -> None:
    """Refuse the units of a time with several parts where one unit holds for several values."""
    if key.unit == "s" and re.search(r"\d\s*[A-Za-z]", unit):
        problem = f"has the unit {shown(unit)} at the end, must have a single one for all"
        raise SceneError(key.name, problem, "Write each time with its own units.")


def _spaced(key: Key, item: str) -> list[str]:
    """Return evenly spaced values, by ratio if ``log`` stands before them; else the item alone."""
    match = _SPACED.fullmatch(item)
    if match is None:
        return [item]
    log, count, unit = bool(match[1]), int(match[4][:10]), match[5]
    _refuse_several(key, unit)
    low, high = float(match[2]), float(match[3])
    if len(match[4]) > 9 or count > MAX_POINTS:
        problem = f"has more than {MAX_POINTS:,} values in {shown(match[0])}"
        raise SceneError(key.name, problem, "Vary less.")
    if count < 2 or not low < high or (log and low <= 0.0):
        hint = "Write 'low:high:count unit', the lower end first, with at least two values."
        raise SceneError(key.name, f"has the values {match[0]!r}, which are none", hint)
    shares = [k / (count - 1) for k in range(count)]
    numbers = [_between(low, high, share, log) for share in shares]
    numbers[-1] = high
    short = [float(f"{number:.12g}") for number in numbers]
    whole = key.spec.kind == "count" and all(number.is_integer() for number in short)
    texts = [repr(int(number) if whole else number) for number in short]
    return [f"{text} {unit}" if unit else text for text in texts]


def is_numeric(key: Key) -> bool:
    """Return whether the values of a key are numbers, which may lie in a range."""
    return key.spec.kind in _RANGES


def bare(text: str) -> Any:
    """Return the number, the truth value or the word that a text is."""
    try:
        value = parse_toml(f"value = {text}")["value"]
    except ValueError:
        return text
    return value if isinstance(value, bool | int | float | str) else text


def _sequence(key: Key, values: Any) -> list[Any]:
    """Return values that were given one by one."""
    if not isinstance(values, Iterable) or isinstance(values, dict):
        hint = f"For example {_example(key)}."
        raise SceneError(key.name, f"has the values {shown(values)}, must have a list", hint)
    as_list = getattr(values, "tolist", None)
    listed = as_list() if as_list is not None else values
    items = list(listed) if isinstance(listed, Iterable) else [listed]
    return [item.item() if hasattr(item, "dtype") else item for item in items]


def _ends(key: Key, text: str | Sequence[Any]) -> tuple[bool, list[Any]]:
    """Return whether a range is logarithmic, and its two ends."""
    hint = f"For example '{'8:25 h' if key.unit == 's' else f'1:10 {key.unit}'.strip()}'."
    if isinstance(text, str):
        match = _RANGE.fullmatch(text.strip())
        if match is None:
            problem = f"has the range {shown(text)}, must be two numbers with a colon and a unit"
            raise SceneError(key.name, problem, hint)
        return bool(match[1]), _with_unit(key, [match[2], f"{match[3]} {match[4]}".strip()])
    values = _sequence(key, text)
    log = len(values) == 3 and values[2] == "log"
    if len(values) != 2 and not log:
        problem = f"has the range {_described(text)}, must be two values"
        raise SceneError(key.name, problem, hint)
    return log, values[:2]


def _described(text: str | Sequence[Any]) -> str:
    return repr(text) if isinstance(text, str) else " to ".join(map(str, text))


def _example(key: Key) -> str:
    if key.spec.options:
        return "'" + ",".join(key.spec.options[:2]) + "'"
    return f"'1,2,5 {key.unit}'".replace(" '", "'")


def check_ranges(scene: Scene, ranges: Sequence[Range]) -> None:
    """Refuse ranges that do not fit to a scene."""
    for free in ranges:
        others = [other for other in ranges if other is not free]
        for end in _ends_of(free):
            _somewhere(scene, {free.key: end}, others)
    refuse_ineffective([({}, _somewhere(scene, {}, ranges))], [free.key for free in ranges])


def _ends_of(free: Range) -> tuple[Any, Any]:
    return free.setting(free.low), free.setting(free.high)


def _somewhere(scene: Scene, changes: Mapping[str, Any], others: Sequence[Range]) -> Scene:
    """Return the scene with changes and other parameters at the low or the high ends."""
    refused: SceneError | None = None
    for place in (0, 1):
        at = {other.key: _ends_of(other)[place] for other in others}
        try:
            return change(scene, {**at, **changes})
        except SceneError as error:
            refused = refused or error
    assert refused is not None
    raise refused


def change(scene: Scene, changes: Mapping[str, Any]) -> Scene:
    """Return a scene with other values, or say with which it is refused."""
    first = {key: changes[key] for key in _FIRST if key in changes}
    try:
        return scene.with_changes({**first, **changes})
    except SceneError as error:
        where = ", ".join(f"{key} = {value!r}" for key, value in changes.items())
        if error.path in changes and "not a known key" in error.problem:
            others = {key: value for key, value in changes.items() if key != error.path}
            where = ", ".join(f"{key} = {value!r}" for key, value in others.items())
            raise SceneError(error.path, f"has no meaning where {where}", error.hint) from None
        raise SceneError(error.path, f"{error.problem} (where {where})", error.hint) from None
