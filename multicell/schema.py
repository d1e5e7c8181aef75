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
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
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
    key, usual
        The key of a variant that says which part it is, and what it is without the key.
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
    usual: str = ""
    examples: tuple[Any, ...] = ()

    @property
    def units(self) -> str:
        """The unit of a value, or of the two numbers of each point of a curve, for a reader."""
        first = {"schedule": "s", "course": "s", "responses": self.unit}.get(self.kind)
        if first is None:
            return self.unit
        return f"[{first}, {self.unit if self.kind == 'schedule' else 'number'}]"


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
        tail = f" {unit}" if unit else ""
        ends = ((name.replace("_", " "), end) for name, end in vars(self).items())
        return " and ".join(f"{name} {end:g}{tail}" for name, end in ends if end is not None)

    def require(self, value: float, given: object, path: str, unit: str, hint: str) -> None:
        """Raise ``SceneError`` if ``value``, which the user wrote as ``given``, lies outside."""
        if not self.contain(value):
            tail = f" {unit}" if unit else ""
            text = given if isinstance(given, str) else f"{shown(given)}{tail}"
            raise SceneError(path, f"is {text}, must be {self.words(unit)}", hint)


Read = Callable[[Any, str], float]
"""Turns what a user wrote and its path into a number in base units, or raises ``SceneError``."""


def _reader(unit: str, bounds: Bounds, wanted: str = "a number", hint: str = "") -> Read:
    """Return what reads a quantity, or a number without dimension where ``unit`` is empty."""

    def read(value: Any, path: str) -> float:
        result = to_base(value, unit, path) if unit else finite(value, path, wanted)
        bounds.require(result, value, path, unit, hint)
        return result

    return read


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
    return _declared(
        "quantity", _reader(unit, bounds, hint=hint), default,
        unit=unit, allowed=bounds.words(unit), doc=doc, bounds=bounds,
    )  # fmt: skip


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
    read = _reader("", bounds, "a number without unit and quotes", hint)
    return _declared("number", read, default, allowed=bounds.words(), doc=doc, bounds=bounds)


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

    return _declared("count", convert, default, allowed=bounds.words(), doc=doc, bounds=bounds)


def choice(
    options: Iterable[str],
    *,
    default: Any = MISSING,
    doc: str = "",
    other: Callable[[str], bool] = lambda _: False,
) -> Any:
    """Declare one name out of several; ``other`` tells which other texts are accepted."""
    known = tuple(options)

    def convert(value: object, path: str) -> str:
        if isinstance(value, str) and other(value):
            return value
        return chosen(value, known, path)

    return _declared("choice", convert, default, allowed=" or ".join(known), doc=doc, options=known)


def text(*, default: Any = MISSING, doc: str = "") -> Any:
    """Declare one line of printable text."""

    def convert(value: object, path: str) -> str:
        if not isinstance(value, str) or not value.isprintable():
            raise SceneError(path, f"is {shown(value)}, must be one line of text")
        return value

    return _declared("text", convert, default, doc=doc)


def flag(*, default: Any = MISSING, doc: str = "") -> Any:
    """Declare a yes or no."""

    def convert(value: object, path: str) -> bool:
        if not isinstance(value, bool):
            raise SceneError(path, f"is {shown(value)}, must be true or false")
        return value

    return _declared("flag", convert, default, allowed="true or false", doc=doc)


def names(options: Iterable[str], *, doc: str = "") -> Any:
    """Declare a list of names out of several, by default none."""
    known = tuple(options)

    def convert(value: object, path: str) -> tuple[str, ...]:
        if not isinstance(value, list | tuple):
            raise SceneError(path, f"is {shown(value)}, must be a list of names")
        return tuple(chosen(name, known, path) for name in value)

    return _declared(
        "names", convert, (), plain=list, allowed=", ".join(known), doc=doc, options=known
    )


def interval(
    unit: str, *, at_least: float | None = None, at_most: float | None = None, doc: str = ""
) -> Any:
    """Declare an optional pair of quantities, the lower one first; stored as a tuple."""
    bounds = Bounds(at_least=at_least, at_most=at_most)
    read = _reader(unit, bounds)

    def convert(value: object, path: str) -> tuple[float, float]:
        if not isinstance(value, list | tuple) or len(value) != 2:
            hint = f"For example ['-100 {unit}', '100 {unit}']."
            raise SceneError(path, f"is {shown(value)}, must be a list of two quantities", hint)
        low, high = (read(end, path) for end in value)
        if not low < high:
            problem = f"goes from {low:g} to {high:g} {unit}, must have the lower end first"
            raise SceneError(path, problem)
        return low, high

    return _declared(
        "interval", convert, None, plain=list, unit=unit, bounds=bounds, doc=doc,
        allowed=f"two quantities: {bounds.words(unit)}",
    )  # fmt: skip


Curve = tuple[tuple[float, float], ...]
"""Points (x, y) of a piecewise linear function, x rising."""


def _curve(given: object, path: str, x: Read, y: Read, wanted: str, example: str) -> Curve:
    """Return the points that a list of two-element lists gives, or raise ``SceneError``."""
    points = list(given) if isinstance(given, list | tuple) else []
    if not points or not all(isinstance(p, list | tuple) and len(p) == 2 for p in points):
        raise SceneError(path, f"is {shown(given)}, must be {wanted}", f"For example {example}.")
    return tuple((x(a, path), y(b, path)) for a, b in points)


def _rises(curve: Curve) -> bool:
    return all(a < b for (a, _), (b, _) in itertools.pairwise(curve))


def _in_time(given: object, path: str, unit: str, y: Read) -> Curve:
    """Return a curve over time in s, or raise ``SceneError``."""
    wanted = f"{'' if unit else 'a number or '}a list of [time, value]"
    example = f"[['10 h', '{f'0.1 {unit}' if unit else '0.1'}']]"
    result = _curve(given, path, _reader("s", Bounds()), y, wanted, example)
    if not _rises(result):
        times = [time for time, _ in result]
        raise SceneError(path, f"has the times {times} s, must have times that rise")
    return result


def course(*, default: float, at_least: float | None = None, doc: str = "") -> Any:
    """Declare a number that may change with time: a number, or a list of ``[time, value]``.

    The stored value is a tuple of (time in s, value), with times that rise.
    """
    bounds = Bounds(at_least=at_least)
    read = _reader("", bounds)

    def convert(value: object, path: str) -> Curve:
        found = _in_time(
            value if isinstance(value, list | tuple) else [(0.0, value)], path, "", read
        )
        # a single value holds always: its time says nothing, and would not be written
        return found if len(found) > 1 else ((0.0, found[0][1]),)

    def to_plain(value: Curve) -> Any:
        return value[0][1] if len(value) == 1 else _lists(value)

    return _declared("course", convert, ((0.0, default),), plain=to_plain, doc=doc, bounds=bounds)


def schedule(
    unit: str, *, at_least: float | None = None, at_most: float | None = None, doc: str = ""
) -> Any:
    """Declare a list of ``[time, quantity]`` with times that rise, by default None.

    The stored value is a tuple of (time in s, value in ``unit``).
    """
    bounds = Bounds(at_least=at_least, at_most=at_most)
    read = _reader(unit, bounds)
    return _declared(
        "schedule", lambda value, path: _in_time(value, path, unit, read), None,
        plain=_lists, unit=unit, doc=doc, bounds=bounds,
    )  # fmt: skip


def _lists(curve: Curve) -> list[list[float]]:
    return [list(point) for point in curve]


def responses(unit: str, *, at_least: float | None = None, doc: str = "") -> Any:
    """Declare an optional table of names to curves, lists of ``[quantity, number]``.

    The stored curves are tuples of (quantity in ``unit``, number), with quantities that rise.
    """
    bounds = Bounds(at_least=at_least)
    x, y = _reader(unit, Bounds()), _reader("", bounds)
    example = f"[['0 {unit}', 0.2], ['0.02 {unit}', 1]]"

    def one(curve: object, path: str) -> Curve:
        result = _curve(curve, path, x, y, f"a list of [{unit}, factor]", example)
        if not _rises(result):
            raise SceneError(path, "must have concentrations that rise")
        return result

    return _declared(
        "responses", lambda value, path: _named(value, path, one) or None, None,
        plain=lambda value: {name: _lists(curve) for name, curve in value.items()},
        unit=unit, doc=doc, bounds=bounds,
    )  # fmt: skip


def quantities(
    unit: str, *, at_least: float | None = None, at_most: float | None = None, doc: str = ""
) -> Any:
    """Declare an optional table of names to quantities, or to numbers where ``unit`` is empty."""
    bounds = Bounds(at_least=at_least, at_most=at_most)
    read = _reader(unit, bounds)
    return _declared(
        # an empty table says no more than an absent one, which is how it would be written
        "quantities", lambda value, path: _named(value, path, read) or None, None,
        plain=dict, unit=unit, doc=doc, bounds=bounds,
    )  # fmt: skip


def _named(value: object, path: str, one: Callable[[Any, str], V]) -> Tables[V]:
    """Return a table of names whose entries are each read by ``one``."""
    entries = _mapping(value, path).items()
    return Tables({name: one(entry, f"{path}.{name}") for name, entry in entries})


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

    return _declared(
        "table", convert, default, default_factory,
        plain=plain, doc=doc, shorthand=shorthand, table=part,
    )  # fmt: skip


def variant(
    options: Mapping[str, type[Any]],
    *,
    key: str,
    usual: str,
    default_factory: Any,
    doc: str = "",
    hint: Callable[[str], str] | None = None,
) -> Any:
    """Declare a table whose ``key`` says which part it holds; without the key the ``usual`` one.

    ``hint`` may know more than the nearest name about one that is not there.
    """

    def convert(value: object, path: str) -> Any:
        if isinstance(value, tuple(options.values())):
            return value
        entries = _mapping(value, path)
        name = chosen(entries.pop(key, usual), options, f"{path}.{key}", hint)
        return build(options[name], entries, path, also=(key,))

    def to_plain(value: Any) -> dict[str, Any]:
        name = next(name for name, part in options.items() if type(value) is part)
        return {key: name, **plain(value)}

    return _declared(
        "variant", convert, MISSING, default_factory, plain=to_plain, doc=doc,
        allowed=f"{key}: {' or '.join(options)}", options=tuple(options), parts=options, key=key,
        usual=usual,
    )  # fmt: skip


def tables(
    part: type[Any], *, default_factory: Any, names: Iterable[str] | None = None, doc: str = ""
) -> Any:
    """Declare a table of named tables, each of them a ``part``; ``names`` are all that may be."""
    known = tuple(names or ())

    def convert(value: object, path: str) -> Tables[Any]:
        entries = _mapping(value, path)
        for name in entries:
            if known and name not in known:
                hint = near_miss(name, known)
                raise SceneError(f"{path}.{name}", "is not a known name here", hint)
            if not known and not (name.isidentifier() and name.isascii()):
                problem = f"is named {shown(name)}, must have a name of letters, digits and '_'"
                raise SceneError(path, problem)
        return _named(entries, path, one)

    def one(entry: object, path: str) -> Any:
        return entry if isinstance(entry, part) else build(part, entry, path)

    return _declared(
        "tables", convert, MISSING, default_factory,
        plain=lambda value: {name: plain(entry) for name, entry in value.items()},
        doc=doc, table=part, options=known,
    )  # fmt: skip


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
        quantity, number, count, choice, text, flag, names, interval, course, schedule, responses,
        quantities, table, variant, tables,
    ),
)  # fmt: skip
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


def plain(part: Any) -> dict[str, Any]:
    """Return a part as a dict of plain values in base units; what is absent has no key."""
    result = {}
    for name, spec in specs(part).items():
        value = getattr(part, name)
        empty = isinstance(value, Tables) and not value
        if value is not None and not empty:
            result[name] = spec.plain(value)
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


def _declared(
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


def _mapping(value: object, path: str) -> dict[str, Any]:
    """Return a copy of a table, or raise ``SceneError``."""
    if not isinstance(value, Mapping):
        raise SceneError(path, f"is {shown(value)}, must be a table")
    if not all(isinstance(key, str) for key in value):
        raise SceneError(path, "has keys that are not text, must be a table")
    return dict(value)


def _join(path: str, key: str) -> str:
    return f"{path}.{key}" if path and key else path or key
