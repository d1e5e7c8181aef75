"""Declare the fields of parts; build, walk and write parts by these declarations."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from functools import cache
from types import MappingProxyType
from typing import Any, Final, TypeVar, final

from multicell.errors import SceneError
from multicell.schema.bounds import Bounds
from multicell.units import shown

T = TypeVar("T")

_MEANT: Final = {
    "cells": ("count",),
    "consumption": ("uptake",),
    "diameter": ("division_radius",),
    "doubling_time": ("cycle_time",),
    "n": ("count",),
    "number": ("count",),
    "dt": ("coupling_step", "step"),
    "end": ("duration",),
    "radius": ("count",),
    "rate": ("cycle_time",),
    "stiffness": ("young",),
    "time": ("duration",),
    "timestep": ("coupling_step", "step"),
    "tolerance": ("rtol",),
    "youngs_modulus": ("young",),
}
"""Words that others use for our keys, which is no matter of spelling."""

_ELSEWHERE: Final = {
    "concentration": "That of the medium is nutrients.NAME.boundary.",
    "cycle_time": "The cycle of cells is growth.cycle_time.",
    "frames": "The time between frames is output.every.",
    "interval": "The time between frames is output.every.",
    "motility": "Cells move by the table [motility].",
    "stiffness": "The stiffness of cells is cells.young.",
    "viscosity": "That of the medium is drag.viscosity.",
}
"""Where keys stand that are written in another table, by what they are called there."""

_LISTED = 220
"""Letters of all names together that an error lists."""

V = TypeVar("V")


@final
@dataclass(frozen=True)
class Parameter:
    """The declaration of a field of a part; found with :func:`specs`.

    - ``convert``: turns a given value and its path into the stored value, or raises ``SceneError``
    - ``plain``: turns the stored value into numbers, strings and dicts that ``convert`` accepts
    - ``unit``: base unit of a quantity, else empty
    - ``allowed``: the allowed range or names in words, else empty
    - ``doc``: meaning of the parameter
    - ``shorthand``: the key of a table that a bare string in the table's place stands for, else
      empty
    - ``table``: the class of a table, else None
    - ``kind``: name of the function that declared it, such as ``"quantity"``
    - ``bounds``: the interval of its numbers
    - ``options``: the names that are allowed; of a variant the names of its parts
    - ``parts``: the parts of a variant by name
    - ``key``, ``usual``: the key of a variant that says which part it is, and what it is without
      the key
    - ``further``: a regular expression for names beyond the options, else empty
    - ``listed``: how the tables of a list are named that may stand for named tables, else empty
    """

    convert: Callable[[Any, str], Any]
    plain: Callable[[Any], Any] = lambda value: value
    unit: str = ""
    allowed: str = ""
    doc: str = ""
    shorthand: str = ""
    table: type | None = None
    kind: str = ""
    bounds: Bounds | None = None
    options: tuple[str, ...] = ()
    parts: Mapping[str, type] | None = None
    key: str = ""
    usual: str = ""
    further: str = ""
    listed: str = ""

    @property
    def units(self) -> str:
        """The unit of a value, or of the two numbers of each point of a curve, for a reader."""
        second = {"schedule": self.unit, "course": "number"}.get(self.kind)
        return self.unit if second is None else f"[s, {second}]"


@final
class Tables(Mapping[str, V]):
    """A read-only mapping of names to parts, which can be compared, hashed and pickled."""

    def __init__(self, entries: Mapping[str, V] | None = None) -> None:
        self._entries = dict(entries or {})

    def __getitem__(self, name: str) -> V:
        return self._entries[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    def __hash__(self) -> int:
        return hash(frozenset(self._entries.items()))

    def __repr__(self) -> str:
        return f"Tables({self._entries!r})"


def specs(part: Any) -> Mapping[str, Parameter]:
    """Return the declaration of every field of a part (its class or an instance) by name."""
    return _specs(part if isinstance(part, type) else type(part))


@cache
def _specs(part: type[Any]) -> Mapping[str, Parameter]:
    return MappingProxyType({spec.name: spec.metadata["parameter"] for spec in fields(part)})


def build_part(part: type[T], value: object, path: str = "", also: tuple[str, ...] = ()) -> T:
    """Return a part made from a table.

    - ``part``: a class made by :func:`parameters`
    - ``value``: mapping of keys to values, as read from TOML
    - ``path``: where the table stands, as dotted keys
    - ``also``: keys that the caller has taken out already, for the list of allowed keys
    """
    known = specs(part)
    entries = mapping(value, path, f"Its keys: {_listed([*also, *known])}.")
    for key in entries:
        if key not in known:
            hint = " ".join(filter(None, (place_of_key(key), near_miss(key, [*also, *known]))))
            raise SceneError(_join(path, key or "''"), "is not a known key here", hint)
    for spec in fields(part):  # type: ignore[arg-type]
        needed = spec.default is MISSING and spec.default_factory is MISSING
        if needed and spec.name not in entries:
            raise SceneError(_join(path, spec.name), "is missing", known[spec.name].doc)
    with below(path):
        return part(**entries)


@contextmanager
def below(path: str) -> Iterator[None]:
    """Let ``SceneError`` of a part say where the part stands: keys are found below ``path``."""
    try:
        yield
    except SceneError as error:
        raise SceneError(_join(path, error.path), error.problem, error.hint) from None


def leaves(
    part: Any, path: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], Any, Parameter]]:
    """Yield path, value and declaration of every value in a part and in those that it holds."""
    for name, spec in specs(part).items():
        value, where = getattr(part, name), (*path, name)
        entries = value.items() if isinstance(value, Tables) else [("", value)]
        for key, entry in entries:
            inner = (*where, key) if key else where
            if is_dataclass(entry):
                yield from leaves(entry, inner)
            elif entry is not None:
                yield inner, entry, spec


def part_as_dict(part: Any, names: Container[str] | None = None) -> dict[str, Any]:
    """Return a part as a dict of plain values in base units; absent values have no key.

    Parts in it that have none of the ``names`` stay as they are.
    """
    result = {}
    for name, spec in specs(part).items():
        value = getattr(part, name)
        empty = isinstance(value, Tables) and not value
        if value is not None and not empty:
            kept = names is not None and name not in names and is_dataclass(value)
            result[name] = value if kept else spec.plain(value)
    return result


def chosen(
    value: object,
    options: Iterable[str],
    path: str,
    hint: Callable[[str], str] | None = None,
) -> str:
    """Return ``value`` if it is one of the names, else raise ``SceneError`` with the nearest."""
    names = list(options)
    if isinstance(value, str) and (value in names or value in options):
        return value
    listed = ", ".join(repr(name) for name in names)
    known = hint(value) if hint is not None and isinstance(value, str) else ""
    near = near_miss(value, names, listed=False) if isinstance(value, str) else ""
    raise SceneError(path, f"is {shown(value)}, must be one of {listed}", known or near)


def near_miss(name: str, options: Iterable[str], *, listed: bool = True) -> str:
    """Return ``"Did you mean 'viscosity'?"`` if a name is near, and the list of all names."""
    known = list(dict.fromkeys(options))
    names = {option.lower(): option for option in known}
    word = str(name).lower()
    near = (
        [option for option in _MEANT.get(word, ()) if option in names]
        or difflib.get_close_matches(word, names, n=1, cutoff=0.6)
        or [option for option in names if word in option.split("_")]
    )
    parts = [f"Did you mean '{names[near[0]]}'?"] if near else []
    if listed:
        parts.append(f"Allowed: {_listed(known)}")
    return " ".join(parts)


def place_of_key(key: str) -> str:
    """Return where a key stands that was written in another table; empty if nobody knows."""
    return _ELSEWHERE.get(key.lower(), "")


def _listed(names: list[str]) -> str:
    """Return names as one text; of very many the first ones and how many there are besides."""
    text = ", ".join(names)
    if len(text) <= _LISTED:
        return text or "no keys at all"
    shown = text[: text.rindex(", ", 0, _LISTED)]
    return f"{shown} and {len(names) - shown.count(', ') - 1} more"


def convert_fields(self: Any) -> None:
    """Convert and check every field, then what concerns several of them.

    A part may change what it is given beforehand, in ``prepare``.
    """
    prepare = getattr(self, "prepare", None)
    if prepare is not None:
        prepare()
    for spec in fields(self):
        value = getattr(self, spec.name)
        if value is None and spec.default is None:
            continue
        converted = spec.metadata["parameter"].convert(value, spec.name)
        object.__setattr__(self, spec.name, converted)
    check = getattr(self, "check", None)
    if check is not None:
        check()


def declare(
    kind: str,
    convert: Callable[[Any, str], Any],
    default: Any,
    default_factory: Any = MISSING,
    **about: Any,
) -> Any:
    """Return a dataclass field with its declaration."""
    metadata = {"parameter": Parameter(convert, kind=kind, **about)}
    if default_factory is not MISSING:
        return field(default_factory=default_factory, metadata=metadata)
    return field(default=default, metadata=metadata)


def read_named(value: object, path: str, one: Callable[[Any, str], V]) -> Tables[V]:
    """Return a table of names whose entries are each read by ``one``."""
    entries = mapping(value, path).items()
    return Tables({name: one(entry, f"{path}.{name}") for name, entry in entries})


_ABSENT: Final = ("off", "no", "none", "false")


def mapping(value: object, path: str, hint: str = "") -> dict[str, Any]:
    """Return a copy of a table, or raise ``SceneError``."""
    if not isinstance(value, Mapping):
        asked = hint or "Its entries have names: NAME = VALUE, a line for each."
        if value is False or (isinstance(value, str) and value.lower() in _ABSENT):
            asked = f"A scene without it has no such table (--set {path}= takes it out)."
        raise SceneError(path, f"is {shown(value)}, must be a table", asked)
    if not all(isinstance(key, str) for key in value):
        raise SceneError(path, "has keys that are not text, must be a table")
    return dict(value)


def separated(text: str | None) -> tuple[str, ...]:
    """Return the names in a text that are separated by commas."""
    return tuple(name.strip() for name in (text or "").split(",") if name.strip())


def _join(path: str, key: str) -> str:
    return f"{path}.{key}" if path and key else path or key
