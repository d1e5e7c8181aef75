"""Oxygen in a scene as partial pressures and percentages of gas: concentrations once it is read."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import fields
from typing import Any, Final

from multicell.errors import SceneError
from multicell.scene.nutrient import Nutrient
from multicell.schema import specs
from multicell.units import PERCENT, oxygen_solubility, shown, to_base, vapour_pressure

_NAMES: Final = ("oxygen", "o2", "o\N{SUBSCRIPT TWO}", "po2", "dioxygen")
"""Names of the field whose concentrations may be written as partial pressures, in any case."""

HYPOXIA: Final = to_base("10 mmHg", "kPa", "hypoxia")
"""In kPa, below which pimonidazole marks cells."""

_BODY: Final = next(f.default for f in fields(Nutrient) if f.name == "temperature")
_LEVELS: Final = [name for name, spec in specs(Nutrient).items() if spec.unit == "mM"]
_DEEPEST: Final = 6  # levels of tables: no concentration of a scene lies deeper
_PERCENT: Final = re.compile(
    rf"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(?:{'|'.join(PERCENT)})\s*"
)
_ATMOSPHERE: Final = 101.325  # kPa


def in_concentrations(value: Any, path: tuple[str | int, ...], nutrients: Any) -> Any:
    """Return a part of a scene with oxygen's pressures and percentages as concentrations in mM.

    What is neither stays as it is, also what is wrong: those who read it say so.

    - ``value``: the part: a value, or tables and lists of such
    - ``path``: its keys, and the places in lists
    - ``nutrients``: the fields of the scene, of which oxygen has the temperature
    """
    if isinstance(value, str):
        field = _field(path)
        where = ".".join(key for key in path if isinstance(key, str))
        return value if field is None else concentration(value, field, where, nutrients)
    if len(path) >= _DEEPEST:
        return value
    if isinstance(value, Mapping):
        return {k: in_concentrations(x, (*path, k), nutrients) for k, x in value.items()}
    if isinstance(value, list | tuple):
        return [in_concentrations(x, (*path, k), nutrients) for k, x in enumerate(value)]
    return value


def _field(path: tuple[str | int, ...]) -> str | None:
    """Return the field that a text at a path is a concentration of; None if it is none."""
    match path:
        case (
            ("nutrients", str(field), "media", int(), 1)
            | ("nutrients", str(field), "sides", _, "value")
            | ("nutrients", str(field), "initial_file", "scale")
            | ("nutrients", _, "uptake_on", str(field), "half")
        ):
            return field
        case ("nutrients", str(field), str(key)) if key in _LEVELS:
            return field
    return None


def concentration(text: str, field: str, path: str, nutrients: Any) -> Any:
    """Return a text, if it is a pressure or a percentage as a concentration in mM."""
    percent = _PERCENT.fullmatch(text)
    if percent is not None:
        amount = to_base(f"{percent[1]} mM", "mM", path) / 100.0
        if amount > 1.0:
            raise SceneError(path, f"is {shown(text)}, must be at most 100 % of the gas")
    else:
        try:
            amount = to_base(text, "kPa", path)
        except SceneError:
            return text
    if not is_oxygen(field):
        what = "a partial pressure" if percent is None else "a part of a gas"
        hint = "Only of the field named 'oxygen' (O2, pO2) is known how much dissolves."
        raise SceneError(path, f"is {shown(text)}, {what}, must be a concentration", hint)
    temperature = _temperature(field, nutrients)
    dry = 1.0 if percent is None else _ATMOSPHERE - vapour_pressure(temperature)
    return amount * dry * oxygen_solubility(temperature)


def is_oxygen(name: str) -> bool:
    """Return whether a field of this name is oxygen: how much of it dissolves is known."""
    return name.casefold() in _NAMES


def saturated(temperature: float) -> float:
    """Return the solubility of pure, moist oxygen in water, mM; ``temperature`` in °C."""
    return (_ATMOSPHERE - vapour_pressure(temperature)) * oxygen_solubility(temperature)


def most_dissolved(temperature: float) -> float:
    """Return how much pure oxygen water dissolves, mM.

    1 mM is allowed at any temperature: at that of the body it dissolves so much, to 0.01 %.
    """
    return max(saturated(temperature), 1.0)


def check_dissolves(level: float, temperature: float, path: str) -> None:
    """Raise ``SceneError`` for more oxygen, mM, than water dissolves of it pure."""
    most = most_dissolved(temperature)
    if level > most:
        problem = f"is {level:.4g} mM, but under pure oxygen water dissolves {most:.3g} mM"
        hint = f"Percentages and pressures have a unit: '{level:.4g} %', '{level:.4g} mmHg'."
        raise SceneError(path, problem, hint)


def hypoxia_of(name: str, nutrients: Mapping[str, Nutrient]) -> float | None:
    """Return below which concentration of a field cells are hypoxic, mM; None if never."""
    field = nutrients[name]
    if field.hypoxia is None and is_oxygen(name):
        return HYPOXIA * oxygen_solubility(field.temperature)
    return field.hypoxia


def _temperature(name: str, nutrients: Any) -> float:
    """Return the temperature of a field, °C; that of the body if there is none."""
    table = nutrients.get(name) if isinstance(nutrients, Mapping) else None
    if isinstance(table, Nutrient):
        return table.temperature
    given = table.get("temperature", _BODY) if isinstance(table, Mapping) else _BODY
    spec = specs(Nutrient)["temperature"]
    return float(spec.convert(given, f"nutrients.{name}.temperature"))
