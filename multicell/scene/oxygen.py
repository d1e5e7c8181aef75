"""Partial pressures of oxygen in a scene, which become concentrations where it is read."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any

from multicell.errors import SceneError
from multicell.scene.nutrient import Nutrient, Side
from multicell.schema import specs
from multicell.units import oxygen_solubility, shown, to_base

NAME = "oxygen"
"""The field whose concentrations may be written as partial pressures."""

_BODY = next(f.default for f in fields(Nutrient) if f.name == "temperature")


def in_concentrations(name: str, entries: Mapping[str, Any], path: str) -> Mapping[str, Any]:
    """Return the table of a field with partial pressures replaced by concentrations in mM.

    What is not a pressure stays as it is, also what is wrong: those who read it say so.

    Raises
    ------
    SceneError
        For a pressure in a field that is not oxygen.
    """
    specified = specs(Nutrient)

    def temperature() -> float:
        spec = specified["temperature"]
        given = entries.get("temperature", _BODY)
        return float(spec.convert(given, f"{path}.temperature"))

    made = dict(entries)
    for key, value in entries.items():
        spec = specified.get(key)
        if spec is not None and spec.unit == "mM" and spec.kind == "quantity":
            made[key] = _convert(name, value, temperature, f"{path}.{key}")
        elif key == "media" and isinstance(value, list | tuple):
            made[key] = [
                [point[0], _convert(name, point[1], temperature, f"{path}.{key}")]
                if isinstance(point, list | tuple) and len(point) == 2
                else point
                for point in value
            ]
        elif key == "sides" and isinstance(value, Mapping):
            made[key] = {
                face: {
                    inner: _convert(name, x, temperature, f"{path}.sides.{face}.{inner}")
                    if inner == "value"
                    else x
                    for inner, x in side.items()
                }
                if isinstance(side, Mapping) and not isinstance(side, Side)
                else side
                for face, side in value.items()
            }
    return made


def _convert(name: str, value: Any, temperature: Callable[[], float], path: str) -> Any:
    """Return a value, if it is a pressure as a concentration in mM."""
    if not isinstance(value, str):
        return value
    try:
        pressure = to_base(value, "kPa", path)
    except SceneError:
        return value
    if name != NAME:
        problem = f"is {shown(value)}, a partial pressure, must be a concentration"
        hint = f"Only of the field named '{NAME}' is known how much dissolves."
        raise SceneError(path, problem, hint)
    return pressure * oxygen_solubility(temperature())
