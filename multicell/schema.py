"""Parts of a scene as frozen dataclasses whose fields convert and check what they are given.

A part is declared once and the declaration says everything: unit, default, what is allowed::

    @final
    @parameters
    class Drag:
        viscosity: float = quantity("kPa s", default=5.0, above=0, doc="of the medium")

``Drag(viscosity="70 Pa s").viscosity`` is 0.07, and ``Drag(viscosity=0)`` raises
:class:`~multicell.errors.SceneError` with the value and what is allowed. A part may define
``check(self)`` for what concerns more than one field.
"""

from __future__ import annotations

import difflib
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields
from numbers import Integral
from typing import Any, TypeVar, dataclass_transform, final

from multicell.errors import SceneError
from multicell.units import finite, shown, to_base

T = TypeVar("T")
V = TypeVar("V")


@final
@dataclass(frozen=True)
class Parameter:
    """What a field of a part accepts; found with :func:`specs`.

    Attributes
    ----------
    convert
        Turns a given value and its path into the stored value, or raises ``SceneError``.
    plain
        Turns the stored value into numbers, strings and dicts that ``convert`` accepts.
    unit
        Base unit of a quantity, else empty.
    allowed
        The allowed range or names in words, else empty.
    doc
        What the parameter means.
    shorthand
        The key of a table that a bare string in the table's place stands for, else empty.
    table
        The class of a table, else None.
    kind
        Name of the function that declared it, such as ``"quantity"``.
    bounds
        The interval of its numbers.
    options
        The names that are allowed; of a variant the names of its parts.
    parts
        The parts of a variant by name.
    key
        The key of a variant that says which part it is.
    examples
        Values that are accepted, where ``kind`` does not say how to make some.
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
    examples: tuple[Any, ...] = ()


@final
@dataclass(frozen=True)
class Bounds:
    """An interval with open or closed ends."""

    above: float | None = None
    at_least: float | None = None
    at_most: float | None = None
    below: float | None = None

    def contain(self, value: float) -> bool:
        """Tell whether ``value`` lies inside."""
        return not (
            (self.above is not None and not value > self.above)
            or (self.at_least is not None and not value >= self.at_least)
            or (self.at_most is not None and not value <= self.at_most)
            or (self.below is not None and not value < self.below)
        )

    def words(self, unit: str = "") -> str:
        """Return for example ``"above 0 um and at most 5 um"``."""
        named = {
            "above": self.above,
            "at least": self.at_least,
            "at most": self.at_most,
            "below": self.below,
        }
        tail = f" {unit}" if unit else ""
        return " and ".join(
            f"{name} {end:g}{tail}" for name, end in named.items() if end is not None
        )

    def require(self, value: float, given: object, path: str, unit: str, hint: str) -> None:
        """Raise ``SceneError`` if ``value``, which the user wrote as ``given``, lies outside."""
        if not self.contain(value):
            tail = f" {unit}" if unit else ""
            text = given if isinstance(given, str) else f"{shown(given)}{tail}"
            raise SceneError(path, f"is {text}, must be {self.words(unit)}", hint)


def quantity(
    unit: str,
    *,
    default: Any = MISSING,
    above: float | None = None,
    at_least: float | None = None,
    at_most: float | None = None,
    below: float | None = None,
    doc: str = "",
    hint: str = "",
) -> Any:
    """Declare a quantity: a number in the base unit or a string with a unit.

    With ``default=None`` the value may be None: the quantity is absent. ``hint`` is given when a
    value lies outside the bounds.
    """
    bounds = Bounds(above, at_least, at_most, below)

    def convert(value: object, path: str) -> float:
        number = to_base(value, unit, path)
        bounds.require(number, value, path, unit, hint)
        return number

    parameter = Parameter(
        convert, unit=unit, allowed=bounds.words(unit), doc=doc, kind="quantity", bounds=bounds
    )
    return _field(parameter, default)


def number(
    *,
    default: Any = MISSING,
    above: float | None = None,
    at_least: float | None = None,
    at_most: float | None = None,
    below: float | None = None,
    doc: str = "",
    hint: str = "",
) -> Any:
    """Declare a number without dimension; strings are refused."""
    bounds = Bounds(above, at_least, at_most, below)

    def convert(value: object, path: str) -> float:
        result = finite(value, path, "a number without unit and quotes")
        bounds.require(result, value, path, "", hint)
        return result

    parameter = Parameter(convert, allowed=bounds.words(), doc=doc, kind="number", bounds=bounds)
    return _field(parameter, default)


def count(
    *,
    default: Any = MISSING,
    at_least: int = 0,
    at_most: int = 10**9,
    doc: str = "",
    hint: str = "",
) -> Any:
    """Declare a whole number."""
    bounds = Bounds(at_least=at_least, at_most=at_most)

    def convert(value: object, path: str) -> int:
        if isinstance(value, bool) or not isinstance(value, Integral):
            raise SceneError(path, f"is {shown(value)}, must be a whole number", hint)
        bounds.require(int(value), value, path, "", hint)
        return int(value)

    parameter = Parameter(convert, allowed=bounds.words(), doc=doc, kind="count", bounds=bounds)
    return _field(parameter, default)


def choice(
    options: Iterable[str],
    *,
    default: Any = MISSING,
    doc: str = "",
    other: Callable[[str], bool] = lambda _: False,
) -> Any:
    """Declare one name out of several; ``other`` tells which other texts are accepted."""
    names = list(options)

    def convert(value: object, path: str) -> str:
        if isinstance(value, str) and other(value):
            return value
        return chosen(value, names, path)

    parameter = Parameter(
        convert, allowed=" or ".join(names), doc=doc, kind="choice", options=tuple(names)
    )
    return _field(parameter, default)


def text(*, default: Any = MISSING, doc: str = "") -> Any:
    """Declare one line of printable text."""

    def convert(value: object, path: str) -> str:
        if not isinstance(value, str) or not value.isprintable():
            raise SceneError(path, f"is {shown(value)}, must be one line of text")
        return value

    return _field(Parameter(convert, doc=doc, kind="text"), default)


def table(
    part: type[Any],
    *,
    default: Any = MISSING,
    default_factory: Any = MISSING,
    shorthand: str = "",
    doc: str = "",
) -> Any:
    """Declare a table that holds the parameters of ``part``; with ``default=None`` it is optional.

    ``shorthand`` names the key that a bare string in the table's place stands for.
    """

    def convert(value: object, path: str) -> Any:
        if shorthand and isinstance(value, str):
            value = {shorthand: value}
        return value if isinstance(value, part) else build(part, value, path)

    parameter = Parameter(convert, plain, doc=doc, shorthand=shorthand, table=part, kind="table")
    return _field(parameter, default, default_factory)


def variant(
    options: Mapping[str, type[Any]], *, key: str, usual: str, default_factory: Any, doc: str = ""
) -> Any:
    """Declare a table whose ``key`` says which part it holds; without the key the ``usual`` one."""

    def convert(value: object, path: str) -> Any:
        if isinstance(value, tuple(options.values())):
            return value
        entries = _mapping(value, path)
        name = chosen(entries.pop(key, usual), options, f"{path}.{key}")
        return build(options[name], entries, path, also=(key,))

    def to_plain(value: Any) -> dict[str, Any]:
        name = next(name for name, part in options.items() if type(value) is part)
        return {key: name, **plain(value)}

    allowed = f"{key}: {' or '.join(options)}"
    parameter = Parameter(
        convert, to_plain, allowed=allowed, doc=doc, kind="variant", options=tuple(options),
        parts=options, key=key,
    )  # fmt: skip
    return _field(parameter, MISSING, default_factory)


def flag(*, default: Any = MISSING, doc: str = "") -> Any:
    """Declare a yes or no."""

    def convert(value: object, path: str) -> bool:
        if not isinstance(value, bool):
            raise SceneError(path, f"is {shown(value)}, must be true or false")
        return value

    return _field(Parameter(convert, allowed="true or false", doc=doc, kind="flag"), default)


def quantities(
    unit: str, *, at_least: float | None = None, at_most: float | None = None, doc: str = ""
) -> Any:
    """Declare an optional table of names to quantities, or to numbers where ``unit`` is empty."""
    bounds = Bounds(at_least=at_least, at_most=at_most)

    def convert(value: object, path: str) -> Tables[float] | None:
        entries = dict(value) if isinstance(value, Tables) else _mapping(value, path)
        # an empty table says no more than an absent one, which is how it would be written
        return Tables({name: one(name, e, path) for name, e in entries.items()}) or None

    def one(name: str, entry: object, path: str) -> float:
        where = f"{path}.{name}"
        converted = to_base(entry, unit, where) if unit else finite(entry, where, "a number")
        bounds.require(converted, entry, where, unit, "")
        return converted

    parameter = Parameter(convert, dict, unit=unit, doc=doc, kind="quantities", bounds=bounds)
    return _field(parameter, None)


def course(*, default: float, at_least: float | None = None, doc: str = "") -> Any:
    """Declare a number that may change with time: a number, or a list of ``[time, value]``.

    The stored value is a tuple of (time in s, value), with times that rise.
    """
    bounds = Bounds(at_least=at_least)

    def convert(value: object, path: str) -> tuple[tuple[float, float], ...]:
        points = value if isinstance(value, list | tuple) else [(0.0, value)]
        found = _course(points, path, "", bounds)
        # a single value holds always: its time says nothing, and would not be written
        return found if len(found) > 1 else ((0.0, found[0][1]),)

    def to_plain(value: tuple[tuple[float, float], ...]) -> Any:
        return value[0][1] if len(value) == 1 else [list(point) for point in value]

    parameter = Parameter(convert, to_plain, doc=doc, kind="course", bounds=bounds)
    return _field(parameter, ((0.0, default),))


def schedule(
    unit: str, *, at_least: float | None = None, at_most: float | None = None, doc: str = ""
) -> Any:
    """Declare a list of ``[time, quantity]`` with times that rise, by default None.

    The stored value is a tuple of (time in s, value in ``unit``).
    """
    bounds = Bounds(at_least=at_least, at_most=at_most)

    def convert(value: object, path: str) -> tuple[tuple[float, float], ...]:
        return _course(value, path, unit, bounds)

    def to_plain(value: tuple[tuple[float, float], ...]) -> Any:
        return [list(point) for point in value]

    parameter = Parameter(convert, to_plain, unit=unit, doc=doc, kind="schedule", bounds=bounds)
    return _field(parameter, None)


def _course(
    points: object, path: str, unit: str, bounds: Bounds
) -> tuple[tuple[float, float], ...]:
    """Return (time in s, value in ``unit``) for each point of a course, or raise ``SceneError``."""
    listed = list(points) if isinstance(points, list | tuple) else []
    if not listed or not all(isinstance(p, list | tuple) and len(p) == 2 for p in listed):
        single = "" if unit else "a number or "
        problem = f"is {shown(points)}, must be {single}a list of [time, value]"
        example = f"0.1 {unit}" if unit else "0.1"
        raise SceneError(path, problem, f"For example [['10 h', '{example}']].")

    def one(value: object) -> float:
        converted = to_base(value, unit, path) if unit else finite(value, path, "a number")
        bounds.require(converted, value, path, unit, "")
        return converted

    result = tuple((to_base(t, "s", path), one(v)) for t, v in listed)
    times = [time for time, _ in result]
    if any(b <= a for a, b in itertools.pairwise(times)):
        raise SceneError(path, f"has the times {times} s, must have times that rise")
    return result


def interval(unit: str, *, at_least: float | None = None, at_most: float | None = None,
             doc: str = "") -> Any:  # fmt: skip
    """Declare an optional pair of quantities, the lower one first; stored as a tuple."""
    bounds = Bounds(at_least=at_least, at_most=at_most)

    def convert(value: object, path: str) -> tuple[float, float]:
        if not isinstance(value, list | tuple) or len(value) != 2:
            hint = f"For example ['-100 {unit}', '100 {unit}']."
            raise SceneError(path, f"is {shown(value)}, must be a list of two quantities", hint)
        low, high = (to_base(end, unit, path) for end in value)
        for end, given in zip((low, high), value, strict=True):
            bounds.require(end, given, path, unit, "")
        if not low < high:
            problem = f"goes from {low:g} to {high:g} {unit}, must have the lower end first"
            raise SceneError(path, problem)
        return low, high

    allowed = f"two quantities: {bounds.words(unit)}"
    parameter = Parameter(
        convert, list, unit=unit, allowed=allowed, doc=doc, kind="interval", bounds=bounds
    )
    return _field(parameter, None)


def names(options: Iterable[str], *, doc: str = "") -> Any:
    """Declare a list of names out of several, by default none."""
    known = list(options)

    def convert(value: object, path: str) -> tuple[str, ...]:
        if not isinstance(value, list | tuple):
            raise SceneError(path, f"is {shown(value)}, must be a list of names")
        return tuple(chosen(name, known, path) for name in value)

    parameter = Parameter(
        convert, list, allowed=", ".join(known), doc=doc, kind="names", options=tuple(known)
    )
    return _field(parameter, ())


def responses(unit: str, *, at_least: float | None = None, doc: str = "") -> Any:
    """Declare an optional table of names to curves, lists of ``[quantity, number]``.

    The stored curves are tuples of (quantity in ``unit``, number), with quantities that rise.
    """
    bounds = Bounds(at_least=at_least)

    def convert(value: object, path: str) -> Tables[tuple[tuple[float, float], ...]] | None:
        entries = dict(value) if isinstance(value, Tables) else _mapping(value, path)
        curves = {name: one(curve, f"{path}.{name}") for name, curve in entries.items()}
        return Tables(curves) or None  # as an empty table of quantities

    def one(curve: object, path: str) -> tuple[tuple[float, float], ...]:
        points = list(curve) if isinstance(curve, list | tuple) else []
        if not points or not all(isinstance(p, list | tuple) and len(p) == 2 for p in points):
            hint = f"For example [['0 {unit}', 0.2], ['0.02 {unit}', 1]]."
            raise SceneError(path, f"is {shown(curve)}, must be a list of [{unit}, factor]", hint)
        result = tuple((to_base(x, unit, path), finite(y, path, "a number")) for x, y in points)
        for _, y in result:
            bounds.require(y, y, path, "", "")
        if any(b <= a for (a, _), (b, _) in itertools.pairwise(result)):
            raise SceneError(path, "must have concentrations that rise")
        return result

    def to_plain(value: Mapping[str, Any]) -> dict[str, Any]:
        return {name: [list(point) for point in curve] for name, curve in value.items()}

    parameter = Parameter(convert, to_plain, unit=unit, doc=doc, kind="responses", bounds=bounds)
    return _field(parameter, None)


def tables(
    part: type[Any], *, default_factory: Any, names: Iterable[str] | None = None, doc: str = ""
) -> Any:
    """Declare a table of named tables, each of them a ``part``; ``names`` are all that may be."""
    known = None if names is None else list(names)

    def convert(value: object, path: str) -> Tables[Any]:
        entries = dict(value) if isinstance(value, Tables) else _mapping(value, path)
        return Tables({name: one(name, entry, path) for name, entry in entries.items()})

    def one(name: str, entry: object, path: str) -> Any:
        if known is not None and name not in known:
            raise SceneError(f"{path}.{name}", "is not a known name here", near_miss(name, known))
        if known is None and not (name.isidentifier() and name.isascii()):
            problem = f"is named {shown(name)}, must have a name of letters, digits and '_'"
            raise SceneError(path, problem)
        return entry if isinstance(entry, part) else build(part, entry, f"{path}.{name}")

    def to_plain(value: Tables[Any]) -> dict[str, Any]:
        return {name: plain(entry) for name, entry in value.items()}

    parameter = Parameter(
        convert, to_plain, doc=doc, table=part, kind="tables", options=tuple(known or ())
    )
    return _field(parameter, MISSING, default_factory)


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


@dataclass_transform(
    frozen_default=True,
    kw_only_default=True,
    field_specifiers=(
        quantity,
        number,
        count,
        choice,
        text,
        table,
        variant,
        tables,
        flag,
        quantities,
        course,
        schedule,
        names,
        interval,
        responses,
    ),
)
def parameters(cls: type[T]) -> type[T]:
    """Make a frozen dataclass, with keyword arguments only, that converts and checks its fields.

    Raises
    ------
    TypeError
        At declaration, for a field that is not declared by one of this module's functions.
    """
    cls.__post_init__ = _convert_fields  # type: ignore[attr-defined]
    made = dataclass(frozen=True, kw_only=True)(cls)
    for spec in fields(made):  # type: ignore[arg-type]
        if "parameter" not in spec.metadata:
            raise TypeError(f"{cls.__name__}.{spec.name} must be declared by quantity(), ...")
    return made


def specs(part: Any) -> dict[str, Parameter]:
    """Return the declaration of every field of a part (its class or an instance) by name."""
    return {spec.name: spec.metadata["parameter"] for spec in fields(part)}


def build(part: type[T], value: object, path: str = "", also: tuple[str, ...] = ()) -> T:
    """Return a part made from a table.

    Parameters
    ----------
    part
        A class made by :func:`parameters`.
    value
        Mapping of keys to values, as read from TOML.
    path
        Where the table stands, as dotted keys.
    also
        Keys that the caller has taken out already, for the list of allowed keys.

    Raises
    ------
    SceneError
        For an unknown or missing key and for any value that is refused, with its full path.
    """
    entries = _mapping(value, path)
    known = specs(part)
    for key in entries:
        if key not in known:
            hint = near_miss(key, [*also, *known])
            raise SceneError(_join(path, key or "''"), "is not a known key here", hint)
    for spec in fields(part):  # type: ignore[arg-type]
        needed = spec.default is MISSING and spec.default_factory is MISSING
        if needed and spec.name not in entries:
            raise SceneError(_join(path, spec.name), "is missing", known[spec.name].doc)
    try:
        return part(**entries)
    except SceneError as error:
        raise SceneError(_join(path, error.path), error.problem, error.hint) from None


def plain(part: Any) -> dict[str, Any]:
    """Return a part as a dict of plain values in base units; what is absent has no key."""
    result = {}
    for name, spec in specs(part).items():
        value = getattr(part, name)
        empty = isinstance(value, Tables) and not value
        if value is not None and not empty:
            result[name] = spec.plain(value)
    return result


def chosen(value: object, options: Iterable[str], path: str) -> str:
    """Return ``value`` if it is one of the names, else raise ``SceneError`` with the nearest."""
    names = list(options)
    if isinstance(value, str) and value in names:
        return value
    listed = ", ".join(repr(name) for name in names)
    hint = near_miss(value, names, listed=False) if isinstance(value, str) else ""
    raise SceneError(path, f"is {shown(value)}, must be one of {listed}", hint)


def near_miss(name: str, options: Iterable[str], *, listed: bool = True) -> str:
    """Return ``"Did you mean 'viscosity'?"`` if a name is near, and the list of all names."""
    names = {option.lower(): option for option in options}
    near = difflib.get_close_matches(str(name).lower(), names, n=1, cutoff=0.6)
    parts = [f"Did you mean '{names[near[0]]}'?"] if near else []
    if listed:
        parts.append(f"Allowed: {', '.join(names.values()) or 'no keys at all'}")
    return " ".join(parts)


def _convert_fields(self: Any) -> None:
    """Convert and check every field, then what concerns several of them."""
    for spec in fields(self):
        value = getattr(self, spec.name)
        if value is None and spec.default is None:
            continue
        converted = spec.metadata["parameter"].convert(value, spec.name)
        object.__setattr__(self, spec.name, converted)
    check = getattr(self, "check", None)
    if check is not None:
        check()


def _field(parameter: Parameter, default: Any, default_factory: Any = MISSING) -> Any:
    metadata = {"parameter": parameter}
    if default_factory is not MISSING:
        return field(default_factory=default_factory, metadata=metadata)
    return field(default=default, metadata=metadata)


def _mapping(value: object, path: str) -> dict[str, Any]:
    """Return a copy of a table, or raise ``SceneError``."""
    if not isinstance(value, Mapping):
        raise SceneError(path, f"is {shown(value)}, must be a table")
    if not all(isinstance(key, str) for key in value):
        raise SceneError(path, "has keys that are not text, must be a table")
    return dict(value)


def _join(path: str, key: str) -> str:
    return f"{path}.{key}" if path and key else path or key
