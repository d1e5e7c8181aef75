"""The JSON Schema of scene files, for editors that complete and check them.

It is made from the same declarations that read a scene (:mod:`multicell.schema`), so that it has
all keys with units, defaults, bounds and choices. What it cannot say, such as the bounds of a
quantity that is written with a unit, or what concerns several keys, is checked on reading.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, fields
from typing import Any, Final

from multicell.scene.scene import Scene
from multicell.schema import Bounds, Parameter, specs
from multicell.units import LISTED, PERCENT

Schema = dict[str, Any]

_DIALECT: Final = "https://json-schema.org/draft/2020-12/schema"
_NAMES: Final = [name for units in LISTED.values() for row in units for name in row.split()]
_MICRO: Final = [f"[uµμ]{name[1:]}" if name[0] == "u" else name for name in _NAMES]
_QUANTITY: Final = (
    r"^\s*[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?\s*("
    rf"{'|'.join(PERCENT)}|"
    rf"(({'|'.join(['mm Hg', *_MICRO])})(?![A-Za-zµμ])|[0-9.\s*·/()^+¹²³⁻-])+)\s*$"
)
"""A number and names of units that are listed, each of which may have a power."""
_TEXT: Final = {"$ref": "#/$defs/quantity"}
_MEASURE: Final = {"anyOf": [{"type": "number"}, _TEXT]}
_DRAW: Final = {
    "type": "object",
    "required": ["mean"],
    "propertyNames": {"enum": ["mean", "variation"]},
    "additionalProperties": {"type": "number", "minimum": 0},
}
_IDENTIFIER: Final = "^[A-Za-z_][A-Za-z0-9_]*$"
_LIMITS: Final[Mapping[str, str]] = {
    "above": "exclusiveMinimum",
    "at_least": "minimum",
    "at_most": "maximum",
    "below": "exclusiveMaximum",
}


def json_schema() -> Schema:
    """Return the JSON Schema (draft 2020-12) of scene files, of plain values only.

    Each key has a ``description`` with its unit and what is allowed, and its ``default`` where it
    has one. A quantity is a number in the base unit ``x-unit``, or a string with a unit.
    """
    parts: dict[str, Schema] = {}
    whole = _table(Scene, parts)
    parts["quantity"] = {"type": "string", "pattern": _QUANTITY}
    return {"$schema": _DIALECT, "title": "A scene of multicell", **whole, "$defs": parts}


def _table(part: type, parts: dict[str, Schema], also: Schema | None = None) -> Schema:
    """Return the schema of a part; those of the parts that it holds are added to ``parts``."""
    known = {spec.name: spec for spec in fields(part)}
    needed = [
        name
        for name, spec in known.items()
        if spec.default is MISSING and spec.default_factory is MISSING
    ]
    made = {
        "type": "object",
        "description": (inspect.getdoc(part) or "").partition("\n")[0],
        "properties": {
            **(also or {}),
            **{name: _describe(spec, parts) for name, spec in known.items()},
        },
        "additionalProperties": False,
    }
    return made | ({"required": needed} if needed else {})


def _reference(part: type, parts: dict[str, Schema]) -> Schema:
    if part.__name__ not in parts:
        parts[part.__name__] = {}
        parts[part.__name__] = _table(part, parts)
    return {"$ref": f"#/$defs/{part.__name__}"}


def _describe(field: Field[Any], parts: dict[str, Schema]) -> Schema:
    """Return the schema of a key with what a reader must know of it."""
    spec: Parameter = field.metadata["parameter"]
    unit = "" if spec.units in spec.allowed else f"in {spec.units}"
    about = "; ".join(filter(None, (spec.doc.rstrip("."), unit, spec.allowed)))
    made = _KINDS[spec.kind](spec, parts) | ({"description": about} if about else {})
    default = field.default
    if default is not MISSING and default is not None:
        made["default"] = spec.plain(default)
    return made


def _number(bounds: Bounds | None, kind: str = "number") -> Schema:
    ends = {} if bounds is None else vars(bounds)
    limits = {_LIMITS[name]: end for name, end in ends.items() if end is not None}
    return {"type": kind, **limits}


def _amount(unit: str, bounds: Bounds | None = None, words: tuple[str, ...] = ()) -> Schema:
    """Return the schema of a quantity, or one of some words, or of a number without a unit."""
    if not unit:
        return _number(bounds)
    text = {**_TEXT, "examples": [f"1 {unit}"]}
    named = [{"enum": list(words)}] if words else []
    return {"anyOf": [_number(bounds), text, *named], "x-unit": unit}


def _array(items: Schema, least: int = 1, most: int | None = None) -> Schema:
    ends = {"minItems": least} if most is None else {"minItems": least, "maxItems": most}
    return {"type": "array", "items": items, **ends}


def _curve(x: Schema, y: Schema) -> Schema:
    return _array({"type": "array", "prefixItems": [x, y], "minItems": 2, "maxItems": 2})


def _one_table(spec: Parameter, parts: dict[str, Schema]) -> Schema:
    """Return the schema of a table, or of the string that may stand in its place."""
    assert spec.table is not None
    whole = _reference(spec.table, parts)
    if not spec.shorthand:
        return whole
    short = specs(spec.table)[spec.shorthand]
    names = {"enum": list(short.options)} if short.options else _KINDS[short.kind](short, parts)
    return {"anyOf": [whole, names]}


def _tables(spec: Parameter, parts: dict[str, Schema]) -> Schema:
    assert spec.table is not None
    one = _reference(spec.table, parts)
    if spec.options:
        return {
            "type": "object",
            "properties": dict.fromkeys(spec.options, one),
            "additionalProperties": False,
        }
    names = {"pattern": _IDENTIFIER}
    named = {"type": "object", "additionalProperties": one, "propertyNames": names}
    return {"anyOf": [named, {"type": "array", "items": one}]} if spec.listed else named


def _variant(spec: Parameter, parts: dict[str, Schema]) -> Schema:
    """Return the schema of a table whose key says which part it is; without it the usual one."""
    assert spec.parts is not None
    cases = []
    for name, part in spec.parts.items():
        case = _table(part, parts, {spec.key: {"const": name}})
        if name != spec.usual:
            case["required"] = [spec.key, *case.get("required", ())]
        cases.append(case)
    if spec.further:
        own = {"type": "string", "pattern": spec.further}
        cases.append({"type": "object", "properties": {spec.key: own}, "required": [spec.key]})
    return {"anyOf": cases}


def _choice(spec: Parameter) -> Schema:
    names = {"enum": list(spec.options)}
    own = {"type": "string", "pattern": spec.further}
    return {"anyOf": [names, own]} if spec.further else names


_KINDS: Final[Mapping[str, Callable[[Parameter, dict[str, Schema]], Schema]]] = {
    "quantity": lambda spec, _: _amount(spec.unit, spec.bounds, spec.options),
    "measure": lambda spec, _: _MEASURE,
    "measure_points": lambda spec, _: _array(_array(_MEASURE, 2, 2)),
    "number": lambda spec, _: _number(spec.bounds),
    "count": lambda spec, _: _number(spec.bounds, "integer"),
    "choice": lambda spec, _: _choice(spec),
    "text": lambda spec, _: {"type": "string", "pattern": r"^[^\n\r\t]*$"},
    "file_path": lambda spec, _: {"type": "string", "minLength": 1},
    "flag": lambda spec, _: {"type": "boolean"},
    "names": lambda spec, _: {"type": "array", "items": {"enum": list(spec.options)}},
    "interval": lambda spec, _: _array(_amount(spec.unit, spec.bounds), 2, 2),
    "vector": lambda spec, _: _array(_amount(spec.unit, spec.bounds), 2, 3),
    "whole_numbers": lambda spec, _: {
        **_array({"type": "integer", "minimum": 0}),
        "uniqueItems": True,
    },
    "moments": lambda spec, _: _array(_amount(spec.unit, spec.bounds)),
    "course": lambda spec, _: {
        "anyOf": [_number(spec.bounds), _curve(_amount("s"), _number(spec.bounds))],
    },
    "schedule": lambda spec, _: _curve(_amount("s"), _amount(spec.unit, spec.bounds)),
    "quantities": lambda spec, _: {
        "type": "object",
        "additionalProperties": _amount(spec.unit, spec.bounds),
    },
    "texts": lambda spec, _: {"type": "object", "additionalProperties": {"type": "string"}},
    "drawn_numbers": lambda spec, _: {
        "type": "object",
        "additionalProperties": {"anyOf": [_number(None), _DRAW]},
    },
    "table": _one_table,
    "variant": _variant,
    "tables": _tables,
}
"""What makes the schema of a key, by the function that declared it."""
