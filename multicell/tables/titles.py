"""Titles of columns: a name, and the unit of its numbers."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import NamedTuple, final

from multicell.errors import DataError
from multicell.schema import near_miss
from multicell.units import unit_factor, unit_hint

_IN_NAMES = str.maketrans({"^": "", "/": "_per_", " ": "_"})
_PARTS = re.compile(r"([^/\[(]*)(?:/(.*)|\[(.*)\]|\((.*)\))?")


def titled(name: str, unit: str) -> str:
    """Return the title of a column: its name, and its unit where it has one (``radius_um``)."""
    return f"{name}_{unit.translate(_IN_NAMES)}" if unit else name


def split_title(title: str) -> tuple[str, str]:
    """Return name and unit of a title: ``name / unit``, ``name [unit]`` or ``name (unit)``.

    The unit is empty where there is none. All tables that multicell reads have titles like these.
    """
    match = _PARTS.fullmatch(title.strip())
    if match is None:
        return title.strip(), ""
    name, *units = match.groups()
    return name.strip(), next((unit.strip() for unit in units if unit is not None), "")


@final
class Title(NamedTuple):
    """Title of a column: the known name, and the number of base units of its unit."""

    name: str
    factor: float


def read_title(title: str, known: Mapping[str, str], place: str) -> Title | None:
    """Read a title; return None if it begins with no known name.

    The unit stands behind the name: ``radius_um``, ``radius / um``, ``radius [um]`` or
    ``radius (um)``.

    - ``title``: of the column
    - ``known``: base unit by name, ``""`` for columns without a unit
    - ``place``: the table in words, for errors
    """
    name, text = _parted(title, known)
    if name not in known:
        return None
    unit, where = known[name], f"{place}, '{title}'"
    if not unit:
        if text:
            problem = f"has the unit '{text}', but {name} is a number or a word without a unit"
            raise DataError(where, problem, f"Title it '{name}'.")
        return Title(name, 1.0)
    hint = f"Title it '{titled(name, unit)}', or name another unit of this kind."
    if not text:
        raise DataError(where, "has no unit", hint)
    factor = unit_factor(text, unit)
    if factor is None:
        hint = unit_hint(text, unit) or hint
        raise DataError(where, f"has the unit '{text}', must be one like {unit}", hint)
    return Title(name, factor)


def _parted(title: str, known: Mapping[str, str]) -> tuple[str, str]:
    """Return name and unit of a title, the unit empty where there is none."""
    if title in known:
        return title, ""
    name, unit = split_title(title)
    if unit and name in known:
        return name, unit
    for name in sorted(known, key=len, reverse=True):
        if title.startswith(f"{name}_"):
            return name, title.removeprefix(f"{name}_").replace("_per_", "/").replace("_", " ")
    return title, ""


def unknown_title(title: str, known: Mapping[str, str], place: str) -> DataError:
    """Return the error of a column that nothing is known of."""
    hint = near_miss(title, [titled(name, unit) for name, unit in known.items()])
    return DataError(f"{place}, '{title}'", "is not a known column here", hint)
