"""Columns of measured data, by their titles ``NAME / UNIT``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, final

import numpy as np

from multicell.errors import DataError, SceneError
from multicell.measured.observables import (
    at_the_end,
    in_history,
    is_known_elsewhere,
    may_be_negative,
    suggest,
)
from multicell.scene.oxygen import concentration
from multicell.scene.scene import Scene
from multicell.schema import specs
from multicell.tables.columns import Table
from multicell.tables.mapping import equal_radius
from multicell.tables.titles import split_title
from multicell.units import PERCENT, to_base, unit_factor

ERRORS: Final = ("sd", "sem")
"""Kinds of columns that hold errors."""
NUMBER_KINDS: Final = ("time", "start", "depth", "value", *ERRORS, "n")
"""Kinds of columns that hold numbers."""
_NO_CONDITIONS: Final = ("title", "seed")
_ROW: Final = {"time": "s", "start": "s", "depth": "um", "label": "", "specimen": ""}
"""Base units of what is said of a row."""
_TIMES: Final = {"day": "d", "days": "d", "hour": "h", "hours": "h"}
"""Units of times by titles without one."""
_WORDS: Final = {
    "std": "sd",
    "stdev": "sd",
    "std dev": "sd",
    "stddev": "sd",
    "standard deviation": "sd",
    "se": "sem",
    "std err": "sem",
    "stderr": "sem",
    "standard error": "sem",
}
"""Other words for errors."""
_SIZES: Final = ("area", "volume")
"""Titles of what says a diameter: that of the disc or ball of this size."""


@final
@dataclass(frozen=True)
class DataColumn:
    """One column.

    - ``kind``: ``"time"``, ``"start"``, ``"depth"``, ``"specimen"``, ``"value"``, ``"sd"``,
      ``"sem"``, ``"n"``, ``"condition"`` or ``"label"``
    - ``name``: of the observable or the field, or key of the scene
    - ``unit``: as the title states it
    - ``base``: base unit of the numbers
    - ``title``: as it stands in the header
    - ``factor``: mM that a unit of gas is, of a field measured as one; else 0
    - ``power``: 2 or 3 where an area or a volume is measured in place of a length, else 1
    """

    kind: str
    name: str
    unit: str
    base: str
    title: str
    factor: float = 0.0
    power: int = 1

    @property
    def relative(self) -> bool:
        """Whether it holds errors as parts of the values."""
        return self.kind in ERRORS and self.unit in PERCENT

    def number(self, text: str, place: str) -> float:
        """Return a field as a number of base units; raises DataError if it is none."""
        number = finite_entry(text, place)
        if self.kind in ERRORS and not number > 0.0:
            hint = "Leave it empty where it is unknown."
            raise DataError(place, f"is {text}, must be above 0", hint)
        if self.kind == "n" and (number < 1.0 or number != int(number)):
            raise DataError(place, f"is {text}, must be a whole number of at least 1")
        if self.relative:
            return number / 100.0 / self.power
        signed = self.kind in ("time", "depth") or may_be_negative(self.name)
        if number < 0.0 and not signed:
            raise DataError(place, f"is {text}, must not be negative")
        if self.factor or not self.base:
            return number * (self.factor or 1.0)
        if self.power > 1:
            size = _convert(f"{number!r} {self.unit}", f"um^{self.power}", place)
            return size if self.kind in ERRORS else self._length(size)
        return _convert(f"{number!r} {self.unit}", self.base, place)

    def _length(self, size: float) -> float:
        """Return the length, µm, of the disc or ball of a size."""
        radius = float(equal_radius(np.array(size), self.power))
        return 2.0 * radius if self.name.endswith("diameter") else radius

    def error_of(self, error: float, value: float) -> float:
        """Return the error of a length from that of the area or volume that was measured.

        - ``error``: of the size, µm² or µm³
        - ``value``: the length, µm
        """
        if self.power == 1 or self.relative or value == 0.0:
            return error
        double = 2.0 if self.name.endswith("diameter") else 1.0
        radius = value / double
        return double * error / (2.0 * math.pi * radius * (2.0 * radius if self.power == 3 else 1))

    def of_scene(self, text: str) -> Any:
        """Return a field of a condition as :meth:`Scene.with_changes` takes it."""
        if self.unit:
            return f"{text} {self.unit}"
        if text in ("true", "false"):
            return text == "true"
        for kind in (int, float):
            try:
                return kind(text)
            except ValueError:
                continue
        return text


def finite_entry(text: str, place: str) -> float:
    """Return the finite number that a field of a table is; raises DataError if it is none."""
    try:
        number = float(text)
    except ValueError:
        hint = "Use '.' as decimal separator." if "," in text else ""
        raise DataError(place, f"is {text[:40]!r}, must be a number", hint) from None
    if not math.isfinite(number):
        hint = "Leave the field empty where nothing was measured."
        raise DataError(place, f"is {text[:40]}, must be a finite number", hint)
    return number


def columns_of(table: Table, scene: Scene) -> list[DataColumn]:
    """Return the columns of a table by their titles."""
    columns: list[DataColumn] = []
    for title in table.titles:
        try:
            columns.append(_column(title, scene, table.name, columns))
        except DataError as error:
            if columns or "no observable" not in error.problem:
                raise
            hint = f"A column of times is titled 'day' or 'time / h'. {error.hint}"
            raise DataError(error.place, error.problem, hint) from None
    seen: dict[tuple[str, str], str] = {}
    for column in columns:
        key = column.kind, column.name
        if key in seen:
            problem = f"says the same as '{seen[key]}'"
            raise DataError(f"{table.name}, '{column.title}'", problem)
        seen[key] = column.title
    values = {column.name for column in columns if column.kind == "value"}
    for column in columns:
        if column.kind in (*ERRORS, "n") and column.name not in values:
            problem = f"has no column '{column.name}' beside it"
            raise DataError(f"{table.name}, '{column.title}'", problem)
    power = {column.name: column.power for column in columns if column.kind == "value"}
    columns = [replace(c, power=power[c.name]) if c.relative else c for c in columns]
    if not values:
        hint = f"Observables of the scene: {', '.join(in_history(scene))}."
        raise DataError(table.name, "has no column of measured values", hint)
    return columns


def _column(title: str, scene: Scene, table: str, before: Sequence[DataColumn]) -> DataColumn:
    """Return the column of one title; ``before``: those to its left."""
    place = f"{table}, '{title}'"
    name, unit = split_title(title)
    name = _known_name(name, scene)
    if not unit:
        name, unit = _parted(name, scene)
    if not name:
        raise DataError(place, "is a column without a name")
    if title.endswith("/"):
        raise DataError(place, "has a '/' and no unit after it")
    if name in _ROW:
        return _with_unit(name, name, unit, _ROW[name], title, place)
    if title.lower() in _TIMES:
        return DataColumn("time", "time", _TIMES[title.lower()], "s", title)
    if name in (*ERRORS, "n"):  # of the values to its left, in their unit
        last = before[-1] if before else None
        if last is None or last.kind not in ("value", *ERRORS, "n"):
            raise DataError(place, "has no column of values to its left")
        name = f"{last.name} {name}"
        unit = unit or ("" if name.endswith(" n") else last.unit)
    stem, _, kind = name.rpartition(" ")
    if stem and kind in (*ERRORS, "n"):
        base = "" if kind == "n" else _unit_of(stem, scene, place)
        if kind != "n" and unit in PERCENT:
            return DataColumn(kind, stem, unit, base, title)
        return _measured(kind, stem, unit, base, title, place, scene)
    if _is_key(name, scene):
        if name in _NO_CONDITIONS:
            raise DataError(place, f"'{name}' is no condition that tissue can be under")
        return DataColumn("condition", name, unit, "", title)
    return _measured("value", name, unit, _unit_of(name, scene, place), title, place, scene)


def _known_name(name: str, scene: Scene) -> str:
    """Return a name as it is known: in small letters, without blanks, in multicell's words."""
    known = depth_fields(scene) | in_history(scene) | at_the_end(scene)
    if name in known or _is_key(name, scene):
        return name
    plain = " ".join(name.lower().replace(".", "").split()) if "." not in name else name
    if plain in _WORDS or plain in (*ERRORS, "n", *_ROW):
        return _WORDS.get(plain, plain)
    stem, kind = plain, ""
    for word in (*_WORDS, *ERRORS, "n"):
        if plain.endswith(f" {word}"):
            stem, kind = plain.removesuffix(f" {word}"), f" {_WORDS.get(word, word)}"
    stem = "diameter" if stem in _SIZES else stem.replace(" ", "_")
    return f"{stem}{kind}" if stem in known else name


def _parted(name: str, scene: Scene) -> tuple[str, str]:
    """Return name and unit of a title as multicell's own tables have them: ``diameter_um``."""
    known = _ROW | depth_fields(scene) | in_history(scene) | at_the_end(scene)
    for stem, base in () if name in known else known.items():
        unit = name.removeprefix(f"{stem}_")
        if base and unit != name and unit_factor(unit.replace("_per_", "/"), base) is not None:
            return stem, unit.replace("_per_", "/")
    return name, ""


def _measured(
    kind: str, name: str, unit: str, base: str, title: str, place: str, scene: Scene
) -> DataColumn:
    """Return a column of measured numbers or their errors; oxygen may be a pressure or in %."""
    if kind != "n" and name in depth_fields(scene):
        try:
            found = concentration(f"1 {unit}", name, place, scene.nutrients)
        except SceneError as error:
            raise DataError(place, error.problem, error.hint) from None
        if not isinstance(found, str):
            return DataColumn(kind, name, unit, base, title, found)
    return _with_unit(kind, name, unit, base, title, place)


def depth_fields(scene: Scene) -> dict[str, str]:
    """Return the base unit of what can be measured at a depth: the fields of a scene."""
    return dict.fromkeys(scene.nutrients, "mM")


def _is_key(name: str, scene: Scene) -> bool:
    """Return whether a name is a key of scenes and no observable."""
    first, dot, _ = name.partition(".")
    known = specs(type(scene))
    if dot:
        return first in known
    return name in known and name not in {*in_history(scene), *at_the_end(scene), "pull", "cells"}


def _unit_of(name: str, scene: Scene, place: str) -> str:
    """Return the base unit of an observable."""
    known = depth_fields(scene) | in_history(scene) | at_the_end(scene)
    if name in known:
        return known[name]
    more = "of this scene" if is_known_elsewhere(name) else "and no key of the scene"
    raise DataError(place, f"'{name}' is no observable {more}", suggest(name, known))


def _with_unit(kind: str, name: str, unit: str, base: str, title: str, place: str) -> DataColumn:
    """Return a column of numbers once its unit has been checked."""
    stem = split_title(title)[0]
    if base and not unit:
        raise DataError(place, "has no unit", f"Write '{stem} / {'h' if base == 's' else base}'.")
    if unit and not base:
        raise DataError(place, f"has the unit '{unit}', must have none", f"Write '{stem}'.")
    if base == "um" and kind in ("value", *ERRORS) and name.endswith(("radius", "diameter")):
        for power in (2, 3):
            if unit_factor(unit, f"um^{power}") is not None:
                return DataColumn(kind, name, unit, base, title, power=power)
    if base and unit_factor(unit, base) is None:
        _convert(f"1 {unit}", base, place)
        raise DataError(place, f"has the unit '{unit}', must be a single one")
    return DataColumn(kind, name, unit, base, title)


def _convert(text: str, base: str, place: str) -> float:
    try:
        return to_base(text, base)
    except SceneError as error:
        raise DataError(place, error.problem, error.hint) from None
