"""The functions that declare the fields of a part, one for each kind of value."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Container, Iterable, Mapping
from dataclasses import MISSING, FrozenInstanceError, dataclass, fields
from itertools import pairwise
from numbers import Integral
from typing import Any, Final, NamedTuple, NoReturn, TypeVar, dataclass_transform, final

from multicell.errors import SceneError
from multicell.schema.bounds import Bounds, Curve, in_time, lists, read_points, reader
from multicell.schema.part import (
    Tables,
    build_part,
    chosen,
    convert_fields,
    declare,
    mapping,
    near_miss,
    part_as_dict,
    read_named,
)
from multicell.units import finite, shown, whole_number

_THOUSANDS: Final = {"": 1, "k": 1000, "m": 1_000_000}  # of letters after a number
T = TypeVar("T")


def quantity(
    unit: str,
    *,
    default: Any = MISSING,
    doc: str = "",
    hint: str = "",
    words: tuple[str, ...] = (),
    **ends: float,
) -> Any:
    """Declare a quantity: a number in the base unit or a string with a unit.

    With ``default=None`` the value may be None: the quantity is absent. ``ends`` are those of its
    :class:`Bounds`; ``hint`` is given when a value lies outside. ``words`` are those that the part
    itself turns into quantities before they are read.
    """
    bounds = Bounds(**ends)
    return declare(
        "quantity",
        reader(unit, bounds, hint=hint),
        default,
        unit=unit,
        doc=doc,
        bounds=bounds,
        allowed=bounds.words(unit),
        options=words,
    )


def measure(*, default: Any = None, doc: str = "") -> Any:
    """Declare a number whose unit other keys decide: a number or text with a unit.

    Those who know the unit must turn text into a number.
    """
    return declare("measure", _measure, default, doc=doc)


def _measure(value: object, path: str) -> float | str:
    wanted = "a number or a string with a unit"
    return value if isinstance(value, str) else finite(value, path, wanted)


def _each(
    value: object,
    path: str,
    one: Callable[[Any, str], T],
    what: str,
    hint: str = "",
    sizes: Container[int] = range(1, 10**9),
) -> tuple[T, ...]:
    """Return the entries of a list, each read by ``one``; refuse what is no list of such a size."""
    if not isinstance(value, list | tuple) or len(value) not in sizes:
        raise SceneError(path, f"is {shown(value)}, must be a list of {what}", hint)
    return tuple(one(entry, path) for entry in value)


def measure_points(*, doc: str = "") -> Any:
    """Declare an optional list of pairs of numbers as :func:`measure` has them."""

    def convert(value: object, path: str) -> tuple[tuple[float | str, float | str], ...]:
        points = read_points(value, path, "a list of pairs", "[['0 mM', 1], ['0.1 mM', 0.2]]")
        return tuple((_measure(x, path), _measure(y, path)) for x, y in points)

    return declare("measure_points", convert, None, plain=lists, doc=doc)


def number(*, default: Any = MISSING, doc: str = "", hint: str = "", **ends: float) -> Any:
    """Declare a number without dimension within some :class:`Bounds`; strings are refused."""
    bounds = Bounds(**ends)
    read = reader("", bounds, "a number without unit and quotes", hint)
    return declare("number", read, default, allowed=bounds.words(), doc=doc, bounds=bounds)


def _whole(value: object) -> int | None:
    """Return the whole number that was meant by ``1e3``, ``"1,000"`` or ``"10k"``; None if none."""
    if isinstance(value, float) and value.is_integer():
        return int(value)
    text = str(value).strip().lower() if isinstance(value, str) else ""
    found = re.fullmatch(r"(\d+|\d{1,3}(?:[, _]\d{3})+)\s*([km]?)", text)
    number = whole_number(re.sub(r"\D", "", found[1])) if found else None
    return None if found is None or number is None else number * _THOUSANDS[found[2]]


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
            meant = _whole(value)
            asked = hint if meant is None else f"Write {meant}."
            raise SceneError(path, f"is {shown(value)}, must be a whole number", asked)
        bounds.require(int(value), value, path, "", hint)
        return int(value)

    return declare("count", convert, default, allowed=bounds.words(), doc=doc, bounds=bounds)


def choice(
    options: Iterable[str],
    *,
    default: Any = MISSING,
    doc: str = "",
    other: Callable[[str], bool] = lambda _: False,
    further: str = "",
    hint: Callable[[str], str] | None = None,
) -> Any:
    """Declare one name out of several.

    ``other`` returns whether another text is accepted; the pattern ``further`` describes them.
    ``hint`` may know more about a name that is refused than how it is spelt.
    """
    known = tuple(options)

    def convert(value: object, path: str) -> str:
        if isinstance(value, str) and other(value):
            return value
        return chosen(value, known, path, hint)

    return declare(
        "choice",
        convert,
        default,
        allowed=" or ".join(known),
        doc=doc,
        options=known,
        further=further,
    )


def text(*, default: Any = MISSING, doc: str = "") -> Any:
    """Declare one line of printable text."""
    return declare("text", _line, default, doc=doc)


def _line(value: object, path: str) -> str:
    if not isinstance(value, str) or not value.isprintable():
        raise SceneError(path, f"is {shown(value)}, must be one line of text")
    return value


def file_path(*, doc: str = "") -> Any:
    """Declare the path of a file; a relative one counts from the folder that this process is in."""

    def convert(value: object, path: str) -> str:
        given = os.fspath(value) if isinstance(value, os.PathLike) else value
        if not isinstance(given, str) or not given.isprintable():
            raise SceneError(path, f"is {shown(value)}, must be the path of a file")
        return os.path.abspath(os.path.expanduser(given)) if given else ""

    return declare("file_path", convert, MISSING, doc=doc)


def flag(*, default: Any = MISSING, doc: str = "") -> Any:
    """Declare a yes or no."""

    def convert(value: object, path: str) -> bool:
        if not isinstance(value, bool):
            raise SceneError(path, f"is {shown(value)}, must be true or false")
        return value

    return declare("flag", convert, default, allowed="true or false", doc=doc)


def names(options: Iterable[str], *, doc: str = "") -> Any:
    """Declare a list of names out of several, none twice, by default none."""
    known = tuple(options)

    def convert(value: object, path: str) -> tuple[str, ...]:
        found = _each(value, path, one, "names", sizes=range(10**9))
        for name in found:
            if found.count(name) > 1:
                raise SceneError(path, f"names {name!r} twice")
        return found

    def one(name: object, path: str) -> str:
        return chosen(name, known, path)

    return declare(
        "names", convert, (), plain=list, allowed=", ".join(known), doc=doc, options=known
    )


def interval(unit: str, *, doc: str = "", **ends: float) -> Any:
    """Declare an optional pair of quantities, the lower one first; stored as a tuple."""
    bounds = Bounds(**ends)
    read = reader(unit, bounds)

    def convert(value: object, path: str) -> tuple[float, float]:
        hint = f"For example ['-100 {unit}', '100 {unit}']."
        low, high = _each(value, path, read, "two quantities", hint, (2,))
        if not low < high:
            problem = f"goes from {low:g} to {high:g} {unit}, must have the lower end first"
            raise SceneError(path, problem)
        return low, high

    return declare(
        "interval",
        convert,
        None,
        plain=list,
        unit=unit,
        bounds=bounds,
        doc=doc,
        allowed=f"two quantities: {bounds.words(unit)}",
    )


def vector(unit: str, *, default: Any = MISSING, doc: str = "") -> Any:
    """Declare a vector of quantities along x, y and z; stored as a tuple of three.

    Of two quantities the third is zero, as it must be in two dimensions.
    """
    bounds = Bounds()
    read, kind = reader(unit, bounds), "quantities" if unit else "numbers"

    def convert(value: object, path: str) -> tuple[float, float, float]:
        hint = f"For example ['1 {unit}', 0, 0]." if unit else "For example [1, 0, 0]."
        x, y, z = (*_each(value, path, read, f"three {kind}", hint, (2, 3)), 0.0)[:3]
        return x, y, z

    return declare(
        "vector",
        convert,
        default,
        plain=list,
        unit=unit,
        bounds=bounds,
        doc=doc,
        allowed=f"three {kind}, along x, y and z",
    )


def whole_numbers(*, doc: str = "") -> Any:
    """Declare an optional list of different whole numbers from zero on; stored as a tuple."""

    def convert(value: object, path: str) -> tuple[int, ...]:
        found = _each(value, path, whole, "whole numbers", "For example [0, 7].")
        if len(set(found)) < len(found):
            raise SceneError(path, "names a number twice")
        return found

    return declare(
        "whole_numbers", convert, None, plain=list, doc=doc, allowed="whole numbers, none twice"
    )


def moments(*, doc: str = "") -> Any:
    """Declare an optional list of times since the start of the run, which rise; s, a tuple."""
    bounds = Bounds(at_least=0.0)
    read = reader("s", bounds)

    def convert(value: object, path: str) -> tuple[float, ...]:
        found = _each(value, path, read, "times", "For example ['1 d', '2 d'].")
        if any(b <= a for a, b in pairwise(found)):
            raise SceneError(path, f"has the times {list(found)} s, must have times that rise")
        return found

    return declare(
        "moments",
        convert,
        None,
        plain=list,
        unit="s",
        doc=doc,
        bounds=bounds,
        allowed="times from 0 s on that rise",
    )


def whole(value: object, path: str) -> int:
    """Return a whole number from zero on that fits into 64 bits."""
    number = int(value) if isinstance(value, Integral) and not isinstance(value, bool) else -1
    if not 0 <= number < 2**63:
        raise SceneError(path, f"holds {shown(value)}, must hold whole numbers from 0 on")
    return number


def course(*, default: float, doc: str = "", **ends: float) -> Any:
    """Declare a number that may change with time: a number, or a list of ``[time, value]``.

    The stored value is a tuple of (time in s, value), with times that rise.
    """
    bounds = Bounds(**ends)
    read = reader("", bounds)

    def convert(value: object, path: str) -> Curve:
        found = in_time(
            value if isinstance(value, list | tuple) else [(0.0, value)], path, "", read
        )
        # a single value holds always: its time says nothing, and would not be written
        return found if len(found) > 1 else ((0.0, found[0][1]),)

    def to_plain(value: Curve) -> Any:
        return value[0][1] if len(value) == 1 else lists(value)

    return declare("course", convert, ((0.0, default),), plain=to_plain, doc=doc, bounds=bounds)


def schedule(unit: str, *, doc: str = "", **ends: float) -> Any:
    """Declare a list of ``[time, quantity]`` with times that rise, by default None.

    The stored value is a tuple of (time in s, value in ``unit``).
    """
    bounds = Bounds(**ends)
    read = reader(unit, bounds)
    return declare(
        "schedule",
        lambda value, path: in_time(value, path, unit, read),
        None,
        plain=lists,
        unit=unit,
        doc=doc,
        bounds=bounds,
    )


def quantities(unit: str, *, doc: str = "", **ends: float) -> Any:
    """Declare an optional table of names to quantities, or to numbers where ``unit`` is empty."""
    bounds = Bounds(**ends)
    return _named("quantities", reader(unit, bounds), doc=doc, unit=unit, bounds=bounds)


def texts(*, doc: str = "") -> Any:
    """Declare an optional table of names to lines of text."""
    return _named("texts", _line, doc=doc)


def _named(kind: str, one: Callable[[Any, str], Any], plain: Any = dict, **more: Any) -> Any:
    """Declare an optional table of names to what ``one`` reads."""

    def convert(value: object, path: str) -> Any:
        # an empty table says no more than an absent one, which is how it would be written
        return read_named(value, path, one) or None

    return declare(kind, convert, None, plain=plain, **more)


@final
class Draw(NamedTuple):
    """A number that each cell draws: its mean, and its standard deviation over the mean."""

    mean: float
    variation: float


def drawn_numbers(*, doc: str = "") -> Any:
    """Declare an optional table of names to numbers, or to what each cell draws.

    A draw is written ``{ mean = 1.0, variation = 0.2 }`` and stored as a :class:`Draw`.
    """
    wanted = "a number, or a table of mean and variation"

    def one(value: object, path: str) -> float | Draw:
        if isinstance(value, Draw):
            return value
        if not isinstance(value, Mapping):
            return finite(value, path, wanted)
        entries = mapping(value, path)
        for key in entries:
            if key not in ("mean", "variation"):
                hint = near_miss(key, ["mean", "variation"])
                raise SceneError(f"{path}.{key}", "is not a known key here", hint)
        if "mean" not in entries:
            raise SceneError(f"{path}.mean", "is missing")
        mean = finite(entries["mean"], f"{path}.mean", "a number above 0")
        variation = finite(entries.get("variation", 0.0), f"{path}.variation", "a number")
        Bounds(above=0.0).require(mean, mean, f"{path}.mean", "", "")
        Bounds(at_least=0.0, at_most=2.0).require(variation, variation, f"{path}.variation", "", "")
        return Draw(mean, variation) if variation else mean

    def to_plain(value: Mapping[str, Any]) -> dict[str, Any]:
        return {name: x._asdict() if isinstance(x, Draw) else x for name, x in value.items()}

    return _named("drawn_numbers", one, to_plain, doc=doc)


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
        return value if isinstance(value, part) else build_part(part, value, path)

    return declare(
        "table",
        convert,
        default,
        default_factory,
        plain=part_as_dict,
        doc=doc,
        shorthand=shorthand,
        table=part,
    )


def variant(
    options: Mapping[str, type[Any]],
    *,
    key: str,
    usual: str,
    default_factory: Any,
    doc: str = "",
    hint: Callable[[str], str] | None = None,
    further: str = "",
) -> Any:
    """Declare a table whose ``key`` says which part it holds; without the key the ``usual`` one.

    A part of a class that the options only find when asked, and do not list, has its own name
    (``scene_name()``), which the pattern ``further`` describes to editors. ``hint`` may know more
    than the nearest name about one that is not there.
    """

    def convert(value: object, path: str) -> Any:
        if name_of(value) in options:
            return value
        entries = mapping(value, path)
        name = chosen(entries.pop(key, usual), options, f"{path}.{key}", hint)
        return build_part(options[name], entries, path, also=(key,))

    def name_of(value: object) -> str | None:
        own = getattr(type(value), "scene_name", None)
        if own is not None:
            return str(own())
        return next((name for name, part in options.items() if type(value) is part), None)

    def to_plain(value: Any) -> dict[str, Any]:
        return {key: name_of(value), **part_as_dict(value)}

    return declare(
        "variant",
        convert,
        MISSING,
        default_factory,
        plain=to_plain,
        doc=doc,
        allowed=f"{key}: {' or '.join(options)}",
        options=tuple(options),
        parts=options,
        key=key,
        usual=usual,
        further=further,
    )


def tables(
    part: type[Any], *, names: Iterable[str] | None = None, doc: str = "", listed: str = ""
) -> Any:
    """Declare a table of named tables, each of them a ``part``; ``names`` are all that may be.

    By default it is empty. With ``listed`` a list of tables is read too: they are named by it and
    their number from 1 on.
    """
    known = tuple(names or ())

    def convert(value: object, path: str) -> Tables[Any]:
        if listed and isinstance(value, list | tuple):
            value = {f"{listed}_{k}": entry for k, entry in enumerate(value, start=1)}
        entries = mapping(value, path)
        for name in entries:
            if known and name not in known:
                hint = near_miss(name, known)
                raise SceneError(f"{path}.{name}", "is not a known name here", hint)
            if not known and not (name.isidentifier() and name.isascii()):
                problem = f"is named {shown(name)}, must have a name of letters, digits and '_'"
                raise SceneError(path, problem)
        return read_named(entries, path, one)

    def one(entry: object, path: str) -> Any:
        return entry if isinstance(entry, part) else build_part(part, entry, path)

    return declare(
        "tables",
        convert,
        MISSING,
        Tables,
        plain=lambda value: {name: part_as_dict(entry) for name, entry in value.items()},
        doc=doc,
        table=part,
        options=known,
        listed=listed,
    )


def _refuse_change(self: Any, name: str, value: object) -> NoReturn:
    """Refuse to change a part in place, in words where dataclasses have only a name."""
    what, key = type(self).__name__, name if type(self).__name__ == "Scene" else f"….{name}"
    raise FrozenInstanceError(
        f"{what} does not change in place: scene.with_changes({{'{key}': {shown(value)}}}) "
        "returns a changed scene"
    )


@dataclass_transform(
    frozen_default=True,
    kw_only_default=True,
    field_specifiers=(
        quantity,
        measure,
        measure_points,
        number,
        count,
        choice,
        text,
        file_path,
        flag,
        names,
        interval,
        vector,
        whole_numbers,
        moments,
        course,
        schedule,
        quantities,
        texts,
        drawn_numbers,
        table,
        variant,
        tables,
    ),
)
def parameters(cls: type[T]) -> type[T]:
    """Make a frozen dataclass, with keyword arguments only, that converts and checks its fields."""
    cls.__post_init__ = convert_fields  # type: ignore[attr-defined]
    made = dataclass(frozen=True, kw_only=True)(cls)
    made.__setattr__ = _refuse_change  # type: ignore[method-assign]
    for spec in fields(made):  # type: ignore[arg-type]
        if "parameter" not in spec.metadata:
            raise TypeError(f"{cls.__name__}.{spec.name} must be declared by quantity(), ...")
    return made
