"""Numbers that a user wrote without a unit where one matters: each key is named once, in words."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator, Mapping
from typing import Any, Final

from multicell.errors import UnitWarning
from multicell.schema import Parameter, leaves

_SHORT: Final = 500.0  # s; a number that is less is likely meant in hours
_NAMED: set[str] = set()


def note_bare(path: str, value: Any, unit: str, *, typed: bool = False) -> None:
    """Warn, once for each path, of a number without a unit: what it was read as.

    Whole numbers are a user's, and so are all that were ``typed``: what is computed or written by
    the package is a float. Zero is the same in all units.
    """
    bare = type(value) is int or (typed and type(value) is float)
    if not bare or not unit or value == 0 or path in _NAMED:
        return
    _NAMED.add(path)
    hours = unit == "s" and 0.0 < value < _SHORT and not path.endswith("step")
    other = f"'{value:g} h' for hours" if hours else f"'{value:g} {unit}' to say so"
    said = f"{path}: {value:g} was read as {value:g} {unit}. Write {other}."
    warnings.warn(said, UnitWarning, stacklevel=_depth())


def _depth() -> int:
    """Return how many calls lie between a warning and who called the package."""
    frame, depth = sys._getframe(1), 1
    while frame.f_back is not None and frame.f_globals["__name__"].startswith("multicell"):
        frame, depth = frame.f_back, depth + 1
    return depth


def note_written(scene: Any, written: Mapping[str, Any], *, typed: bool = False) -> None:
    """Note the bare numbers among the entries that a scene, or a part of it, was made from."""
    for path, _, spec in leaves(scene):
        value: Any = written
        for key in path:
            value = value.get(key) if isinstance(value, Mapping) else None
        for number, unit in _numbers(spec, value):
            note_bare(".".join(path), number, unit, typed=typed)


def nested(changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return dotted keys with values as tables in tables; what does not fit in is left out."""
    found: dict[str, Any] = {}
    for dotted, value in changes.items():
        *tables, last = dotted.split(".")
        node: Any = found
        for key in tables:
            node = node.setdefault(key, {}) if isinstance(node, dict) else None
        if isinstance(node, dict):
            node[last] = value
    return found


def _numbers(spec: Parameter, value: Any) -> Iterator[tuple[Any, str]]:
    """Yield the numbers in the value of a key, each with its base unit."""
    if spec.kind in ("schedule", "course") and isinstance(value, list | tuple):
        points = [point for point in value if isinstance(point, list | tuple) and len(point) == 2]
        yield from (
            (number, unit) for p in points for number, unit in zip(p, ("s", spec.unit), strict=True)
        )
    elif isinstance(value, list | tuple):
        yield from ((number, spec.unit) for number in value)
    else:
        yield value, spec.unit
