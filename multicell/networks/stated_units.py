"""Units that a document of SBML states, as this package writes them.

What a document leaves open is left open: Levels 1 and 2 have moles, litres and seconds where
nothing is said, which hardly any model means.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Final

import libsbml
from sbmlode.units import udef_to_string

from multicell.units import LISTED, unit_factor

_KINDS: Final = {
    "mole": ("amol", "mol"),
    "litre": ("um^3", "l"),
    "liter": ("um^3", "l"),
    "metre": ("um", "m"),
    "meter": ("um", "m"),
    "second": ("s", "s"),
    "gram": ("nN s^2/um", "g"),
    "kilogram": ("nN s^2/um", "kg"),
    "newton": ("nN", "N"),
    "pascal": ("nN/um^2", "Pa"),
    "joule": ("nN um", "J"),
    "hertz": ("1/s", "Hz"),
    "gray": ("Gy", "Gy"),
}
"""Base unit of each kind of SBML, and what one of it is called."""
_OLD: Final = {
    "substance": "mol",
    "time": "s",
    "volume": "l",
    "area": "m^2",
    "length": "m",
}
"""What the names of Levels 1 and 2 mean where a formula names them without defining them."""


def second_of(model: Any) -> float | None:
    """Return how many seconds the unit of time of a model is; None where it states none."""
    text = _of_model(model, "time")
    return None if text is None else unit_factor(text, "s")


def units_stated(model: Any) -> dict[str, str]:
    """Return the stated unit of each quantity of a model by its identifier.

    A unit that cannot be written as one of this package's is a text that nothing reads as a unit,
    such as ``"160 s"``.
    """
    pairs = [(one.getId(), _size_unit(model, one)) for one in model.getListOfCompartments()]
    pairs += [*_of_species(model), *_of_others(model)]
    return {name: unit for name, unit in pairs if unit is not None}


def _size_unit(model: Any, compartment: Any) -> str | None:
    if compartment.isSetUnits():
        return _text(model, compartment.getUnits())
    kinds = {3.0: "volume", 2.0: "area", 1.0: "length"}
    kind = kinds.get(compartment.getSpatialDimensionsAsDouble())
    return None if kind is None else _of_model(model, kind)


def _of_species(model: Any) -> Iterator[tuple[str, str | None]]:
    for one in model.getListOfSpecies():
        named = one.getSubstanceUnits()
        unit = _text(model, named) if named else _of_model(model, "substance")
        compartment = model.getCompartment(one.getCompartment())
        if not one.getHasOnlySubstanceUnits():
            size = None if compartment is None else _size_unit(model, compartment)
            unit = None if size is None or unit is None else _ratio(unit, size)
        yield one.getId(), unit


def _of_others(model: Any) -> Iterator[tuple[str, str | None]]:
    for one in model.getListOfParameters():
        yield one.getId(), _text(model, one.getUnits()) if one.isSetUnits() else None
    extent = _of_model(model, "extent" if model.getLevel() > 2 else "substance")
    time = _of_model(model, "time")
    for one in model.getListOfReactions():
        yield one.getId(), None if extent is None or time is None else _ratio(extent, time)


def _of_model(model: Any, kind: str) -> str | None:
    """Return the unit that a model states for all times, substances and so on; None for none."""
    if model.getLevel() > 2:
        named = getattr(model, f"get{kind.capitalize()}Units")()
        return _text(model, named) if named else None
    return _text(model, kind) if model.getUnitDefinition(kind) is not None else None


def _text(model: Any, name: str) -> str:
    """Return a unit by its name in a model."""
    definition = model.getUnitDefinition(name)
    if definition is None:
        return _KINDS[name][1] if name in _KINDS else _OLD.get(name, name.replace("less", "less "))
    parts = [(_one(unit), unit.getExponentAsDouble()) for unit in definition.getListOfUnits()]
    if any(text is None or not power.is_integer() for text, power in parts):
        return str(udef_to_string(definition, model))
    above = [_raised(text, power) for text, power in parts if text and power > 0.0]
    below = [_raised(text, -power) for text, power in parts if text and power < 0.0]
    return _plain("/".join([" ".join(above) or ("1" if below else ""), *below]))


def _one(unit: Any) -> str | None:
    """Return one factor of a unit without its exponent: empty for 1, None if nothing is like it."""
    kind, size = libsbml.UnitKind_toString(unit.getKind()), unit.getMultiplier()
    size *= 10.0 ** unit.getScale()
    if kind in ("dimensionless", "item"):
        return "" if size == 1.0 and kind == "dimensionless" else None
    if kind not in _KINDS:
        return None
    base, name = _KINDS[kind]
    wanted = size * (unit_factor(name, base) or math.nan)
    for names, factor in LISTED[base].items() if base in LISTED else ():
        if math.isclose(float(factor), wanted, rel_tol=1e-9):
            return next((n for n in names.split() if n == name), names.split()[0])
    return name if size == 1.0 else None


def _raised(text: str, power: float) -> str:
    return text if power == 1.0 else f"{text}^{int(power)}"


def _ratio(above: str, below: str) -> str:
    if not below:
        return above
    divided = f"({below})" if set(below) & set(" /*") else below
    return _plain(f"{above or '1'}/{divided}")


def _plain(text: str) -> str:
    """Return the usual name of a unit that has one, such as mM for mmol/l."""
    for base in ("amol/um^3", "s"):
        factor = unit_factor(text, base)
        for names, size in LISTED[base].items() if factor is not None and text else ():
            if math.isclose(float(size), factor or 0.0, rel_tol=1e-9) and names != "M":
                return names.split()[0]
    return text
