"""Say what the columns of any table are: ``x=POSITION_X um, radius=R um, type=class``."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Final, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from multicell.errors import DataError
from multicell.host.files import parse_toml, read_text
from multicell.schema import near_miss
from multicell.tables.titles import split_title
from multicell.units import unit_factor

SETTINGS: Final = ("pixel", "slice", "sheet", "image")
"""Names that say something of the whole table: lengths of a pixel and of a slice, Excel's sheet,
and the file of the image that labels are of.
"""
_MAX_BYTES: Final = 1_000_000  # of a TOML file that names columns
_ITEM: Final = re.compile(r"""((?:[^,"']|"[^"]*"|'[^']*')*)(?:,|$)""")
_SIZE: Final = re.compile(r"(\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+)?\s*(.*)")
_SPAN: Final = re.compile(r"(-?[\d.]+)\.\.(-?[\d.]+)")

Place = Callable[[int, str], str]
"""Return where the field of a row and a title stands, in words."""


@final
class ColumnSource(NamedTuple):
    """Where the numbers of a column come from.

    - ``titles``: of the columns whose product it is; several columns side by side if ``wide``;
      none for a number that holds in all rows
    - ``scale``, ``unit``: what a number of these columns is
    """

    titles: tuple[str, ...]
    scale: float
    unit: str
    wide: bool = False


@final
@dataclass(frozen=True)
class ColumnMap:
    """Names of the columns of a table.

    - ``entries``: text by name; :data:`SETTINGS` among them
    """

    entries: Mapping[str, str]

    def setting(self, name: str) -> str:
        """Return the text of one of :data:`SETTINGS`, empty if it is not given."""
        return self.entries.get(name, "").strip("\"'")

    @property
    def columns(self) -> dict[str, str]:
        """The entries that are columns."""
        return {name: text for name, text in self.entries.items() if name not in SETTINGS}

    def length(self, unit: str, place: str) -> tuple[float, str]:
        """Return size and unit of what may be a power of a pixel or a slice."""
        if unit not in ("pixel", "pixel^2", "pixel^3", "slice"):
            return 1.0, unit
        across = self._size("pixel", place)
        if unit in ("pixel", "pixel^2"):
            return across ** (2 if "^" in unit else 1), "um^2" if "^" in unit else "um"
        along = self._size("slice", place) if self.setting("slice") else across
        return (across**2 * along, "um^3") if unit == "pixel^3" else (along, "um")

    def _size(self, name: str, place: str) -> float:
        text = self.setting(name)
        if not text:
            problem = "has lengths whose unit it does not state, perhaps pixels"
            hint = "Say what one of them is: --columns \"pixel=0.65 um\" (and 'slice=2 um' along z)"
            raise DataError(place, problem, hint)
        size, unit = sized(text)
        factor = unit_factor(unit, "um")
        if factor is None or not size > 0.0:
            raise DataError(name, f"is '{text}', must be a length above 0", "Write '0.65 um'.")
        return size * factor


def parse_map(text: str | Mapping[str, str] | None) -> ColumnMap:
    """Return the names of columns of a text, a mapping of names to texts, or a TOML file.

    Raises DataError where it cannot be read, or names a column twice.
    """
    if not text:
        return ColumnMap({})
    if isinstance(text, str) and text.endswith(".toml") and "=" not in text:
        text = _from_toml(Path(text).expanduser())
    if isinstance(text, Mapping):
        return ColumnMap({name: str(value) for name, value in text.items()})
    found: dict[str, str] = {}
    for item in filter(None, (match[1].strip() for match in _ITEM.finditer(text))):
        name, equals, rest = (part.strip() for part in item.partition("="))
        name = name.strip("\"'")
        if not equals or not name or not rest:
            hint = 'Write for example "x=POSITION_X um, radius=R um, type=class".'
            raise DataError("columns", f"have '{item[:60]}', which is not NAME=TITLE", hint)
        if name in found:
            raise DataError("columns", f"name '{name}' twice")
        found[name] = rest
    return ColumnMap(found)


def _from_toml(path: Path) -> dict[str, str]:
    try:
        found = parse_toml(read_text(path, _MAX_BYTES))
    except (OSError, ValueError) as error:
        raise DataError(str(path), f"cannot be read: {error}") from None
    found = found.get("columns", found)
    if not isinstance(found, dict) or not all(isinstance(value, str) for value in found.values()):
        raise DataError(path.name, "is no table of texts", 'Write x = "POSITION_X um" and so on.')
    return found


def sized(text: str) -> tuple[float, str]:
    """Return number and unit of a text such as ``0.65 um``; 1 without a number."""
    match = _SIZE.fullmatch(text.strip())
    assert match is not None  # the unit takes everything
    return float(match[1] or 1.0), match[2]


def like(title: str) -> str:
    """Return a title as it is compared: letters of one look are one."""
    return unicodedata.normalize("NFKC", title).strip()


def column_source(name: str, text: str, titles: Sequence[str], place: str) -> ColumnSource:
    """Return where the numbers of a column come from.

    - ``text``: a title and perhaps a unit (``R um``, ``"Position X" um``, ``X 0.65 um``), a product
      of columns (``phi*R um``), columns side by side (``"A*" um``), or a number (``3 d``)
    - ``place``: the table in words, for errors
    """
    found = _title_and_unit(text, titles)
    if found is not None:
        return ColumnSource((found[0],), *_unit(name, found[1], place))
    *first, last = text.split("*")
    factors = [_title_and_unit(part, titles) for part in first]
    end = _title_and_unit(last, titles)
    if first and end is not None and all(part is not None and not part[1] for part in factors):
        names = tuple(part[0] for part in factors if part is not None)
        return ColumnSource((*names, end[0]), *_unit(name, end[1], place))
    quoted = re.fullmatch(r"""(["'])(.+)\1\s*(.*)""", text)
    if quoted and any(mark in quoted[2] for mark in "*?"):
        side = tuple(title for title in titles if fnmatchcase(like(title), like(quoted[2])))
        if side:
            return ColumnSource(side, *_unit(name, quoted[3], place), wide=True)
    if re.match(r"[\d.]", text):
        return ColumnSource((), *_unit(name, text, place))
    hint = near_miss(text.strip("\"'").split("*")[0], titles)
    raise DataError(f"columns, '{name}'", f"is '{text}', which {place} has no column for", hint)


def _title_and_unit(text: str, titles: Sequence[str]) -> tuple[str, str] | None:
    """Return the longest title that a text begins with, and what is behind it."""
    text = text.strip()
    quoted = re.match(r"""(["'])(.*?)\1""", text)
    inner = like(quoted[2] if quoted else text)
    for title in sorted(titles, key=len, reverse=True):
        plain = like(title)
        if quoted and inner == plain:
            return title, text[quoted.end() :].strip()
        if not quoted and plain and (inner == plain or inner.startswith(f"{plain} ")):
            return title, inner[len(plain) :].strip()
    return None


def _unit(name: str, text: str, place: str) -> tuple[float, str]:
    size, unit = sized(text)
    if not size > 0.0 and not text.strip().startswith("0"):
        raise DataError(f"columns, '{name}'", f"has the unit '{text}', must be one", place)
    return size, unit


def numbers_of(column: NDArray[Any], place: Place, title: str) -> NDArray[np.float64]:
    """Return the numbers of a column, NaN where a field is empty."""
    if column.dtype != object:
        return column.astype(np.float64)
    found = np.full(len(column), np.nan)
    for row, field in enumerate(column):
        try:
            found[row] = float(field) if field != "" else np.nan
        except ValueError:
            raise DataError(place(row, title), f"is {field[:40]!r}, must be a number") from None
    return found


def mapped(
    columns: Mapping[str, NDArray[Any]], names: ColumnMap, place: Place, table: str
) -> dict[str, NDArray[Any]]:
    """Return the columns that are named, titled ``NAME / UNIT``.

    A length whose unit is an area or a volume is that of the disc or ball of this size. Columns
    side by side are put below each other, the others repeated, with a column ``specimen``.
    """
    sources = {
        name: column_source(name, text, list(columns), table)
        for name, text in names.columns.items()
    }
    count = len(next(iter(columns.values()), ()))
    wide = [name for name, source in sources.items() if source.wide]
    if len(wide) > 1:
        raise DataError("columns", f"have several columns side by side for {' and '.join(wide)}")
    named = {title for source in sources.values() if not source.wide for title in source.titles}
    side = [title for title in sources[wide[0]].titles if title not in named] if wide else [""]
    found: dict[str, NDArray[Any]] = {}
    for name, source in sources.items():
        alone = [
            source._replace(titles=(title,), wide=False) if source.wide else source
            for title in side
        ]
        made = [_column(name, one, columns, names, place, table, count) for one in alone]
        found[made[0][0]] = np.concatenate([values for _, values in made])
    if wide and "specimen" not in sources:
        found["specimen"] = np.repeat(np.array(side, dtype=object), count)
    return found


def _column(
    name: str,
    source: ColumnSource,
    columns: Mapping[str, NDArray[Any]],
    names: ColumnMap,
    place: Place,
    table: str,
    count: int,
) -> tuple[str, NDArray[Any]]:
    """Return title and content of one column."""
    if not source.titles:
        return _titled(name, source.unit), np.full(count, source.scale)
    unit = source.unit or split_title(source.titles[-1])[1]
    power, unit = names.length(unit, table)
    scale = source.scale * power
    size = next((k for k in (2, 3) if unit_factor(unit, f"um^{k}") is not None), 0)
    is_length = name.endswith(("radius", "diameter"))
    if len(source.titles) == 1 and scale == 1.0 and not (size and is_length):
        return _titled(name, unit), columns[source.titles[0]]
    factors = [numbers_of(columns[title], place, title) for title in source.titles]
    values = np.asarray(np.prod(factors, axis=0) * scale)
    if size and is_length:
        factor = unit_factor(unit, f"um^{size}")
        assert factor is not None
        values = equal_radius(values * factor, size) * (2.0 if name.endswith("diameter") else 1.0)
        unit = "um"
    return _titled(name, unit), values


def equal_radius(size: NDArray[np.float64], dimensions: int) -> NDArray[np.float64]:
    """Return the radius of the disc of an area, µm², or of the ball of a volume, µm³."""
    if dimensions == 2:
        return np.asarray(np.sqrt(size / np.pi))
    return np.asarray(np.cbrt(0.75 * size / np.pi))


def _titled(name: str, unit: str) -> str:
    return f"{name} / {unit}" if unit else name


def parse_where(text: str | None) -> dict[str, str]:
    """Return the values that rows must have, by title: ``CellLine=983b, Condition=15..19``."""
    return dict(parse_map(text).entries)


def rows_where(
    columns: Mapping[str, NDArray[Any]], where: Mapping[str, str], table: str
) -> NDArray[np.bool_]:
    """Return which rows have one of the values that they must have, (n,)."""
    count = len(next(iter(columns.values()), ()))
    chosen = np.ones(count, dtype=bool)
    for name, text in where.items():
        title = next((title for title in columns if like(title) == like(name)), None)
        if title is None:
            raise DataError(table, f"has no column '{name}'", near_miss(name, columns))
        options = [option.strip().strip("\"'") for option in text.split("|")]
        column = columns[title]
        words, codes = np.unique(column.astype(str), return_inverse=True)
        chosen &= np.array([any(_same(word, o) for o in options) for word in words])[codes]
    if not chosen.any():
        said = ", ".join(f"{name}={text}" for name, text in where.items())
        raise DataError(table, f"has no row with {said}")
    return chosen


def _same(field: str, wanted: str) -> bool:
    """Return whether a field is a value, as text or as number, or in a span of numbers."""
    span = _SPAN.fullmatch(wanted)
    try:
        if span:
            return float(span[1]) <= float(field) <= float(span[2])
        return like(field) == like(wanted) or float(field) == float(wanted)
    except ValueError:
        return False
