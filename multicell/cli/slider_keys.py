"""Sliders of ``multicell play``: keys of a scene that matter most, and units of their labels."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Final

from multicell.errors import SceneError
from multicell.schema import leaves

if TYPE_CHECKING:
    from multicell.scene.scene import Scene
    from multicell.studies.axes import Range

_FACTORS: Final = (2.0, 1.5, 1.2)  # of ranges about a value: the widest that the scene accepts
_MOST: Final = 5  # sliders of a scene of which nobody has named one
_OF_FIELDS: Final = ("boundary", "uptake", "quiescence", "necrosis")
_OTHERS: Final = (
    "growth.cycle_time",
    "motility.force",
    "motility.diffusion",
    "contact.surface_energy",
    "growth.critical_pressure",
    "drag.viscosity",
    "cells.young",
)
_UNIT: Final = re.compile(r".*:\s*([+-]?[\d.]+(?:[eE][+-]?\d+)?)\s*(.*?)\s*", re.DOTALL)


def default_ranges(scene: Scene) -> dict[str, str]:
    """Return ranges for the keys that matter most, each about the scene's value.

    Supply, uptake and thresholds of the first field that cells need, then growth and mechanics.
    A range goes from half to twice the value, or less far where other keys limit it.
    """
    known = {".".join(path): value for path, value, _ in leaves(scene)}
    found: dict[str, str] = {}
    for key in _candidates(scene):
        value = known.get(key)
        if isinstance(value, float) and value > 0.0 and len(found) < _MOST:
            found |= _widest(scene, found, key, value)
    if not found:
        raise SceneError("", "has no key for a slider", "Name one by --key KEY=LOW:HIGH.")
    return found


def _widest(scene: Scene, found: Mapping[str, str], key: str, value: float) -> dict[str, str]:
    """Return the widest range of a key that goes together with those found before, if any does."""
    from multicell.studies.axes import check_ranges, parse_ranges

    for factor in _FACTORS:
        text = {key: f"log {value / factor:.12g}:{value * factor:.12g}"}
        try:
            check_ranges(scene, parse_ranges({**found, **text}, scene))
        except SceneError:
            continue
        return text
    return {}


def _candidates(scene: Scene) -> Iterator[str]:
    needed = [name for name, field in scene.nutrients.items() if field.quiescence or field.necrosis]
    for name in (needed or list(scene.nutrients))[:1]:
        yield from (f"nutrients.{name}.{key}" for key in _OF_FIELDS)
    yield from _OTHERS


def asked_units(texts: Mapping[str, str], ranges: Sequence[Range]) -> dict[str, tuple[str, float]]:
    """Return the unit in which ranges were given, if in any, and how many base units it is."""
    units = {}
    for text, item in zip(texts.values(), ranges, strict=True):
        match = _UNIT.fullmatch(text)
        if match is not None and match[2] and float(match[1]):
            units[item.key] = match[2], item.high / float(match[1])
    return units
