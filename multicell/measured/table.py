"""Tables of measurements as people have them: rows that are chosen, columns that are named."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain, compress, pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from multicell.errors import DataError
from multicell.tables.columns import Table, field_text, read_object
from multicell.tables.forms import FORM
from multicell.tables.mapping import (
    ColumnMap,
    column_source,
    like,
    mapped,
    parse_map,
    parse_where,
    rows_where,
)
from multicell.tables.sheets import ZIP, sheet_rows
from multicell.tables.text import Row, lines_above, read_bytes, rows_of, text_form
from multicell.tables.titles import split_title
from multicell.units import unit_factor, whole_number

MAX_BYTES: Final = 10_000_000  # of a file of measured data
_ELAPSED: Final = ("Date Time", "Elapsed")
"""The first titles of what an Incucyte exports: a column for each well, or image of one."""
_OF_ROWS: Final = ("time", "start", "depth", "specimen", "label", "day", "days", "hour", "hours")
"""Names that say where a row belongs, and nothing that was measured."""
_ERRORS: Final = re.compile(r"(?i)std\.? *(err|dev)")
_CLOCK: Final = re.compile(r"(\d+):([0-5]?\d)(?::([0-5]?\d(?:\.\d*)?))?")
"""A time as on a clock that does not begin again after a day: ``26:30:00``."""


def read_measurements(
    source: Any, columns: str | Mapping[str, str] | None = None, where: str | None = None
) -> Table:
    """Return a table of measurements as text, with the titles that a scene's data have.

    - ``source``: path of a table (CSV with any separator, Excel), a ``DataFrame``, or a mapping of
      titles to columns
    - ``columns``: what the columns are, as of ``--columns`` (:mod:`multicell.tables.mapping`);
      others are left out. Absent: as their titles say, or as an Incucyte exports them
    - ``where``: which rows are meant, as ``"CellLine=983b, Day=3..7"``
    """
    if isinstance(source, Table):
        return source
    names, chosen = parse_map(columns), parse_where(where)
    above: list[str] = []
    if isinstance(source, str | Path):
        table, above = _from_file(Path(source).expanduser(), names.setting("sheet"))
    else:
        table = read_object(source)
    table = _without_index(table)
    if chosen:
        table = _rows(table, chosen)
    if not names.columns and table.titles[:2] == _ELAPSED:
        table, names = _incucyte(table, above)
    if names.columns:
        return _in_hours(_mapped(table, names))
    table = _in_hours(table)
    used = {like(title) for title in chosen}
    kept = [k for k, title in enumerate(table.titles) if like(title) not in used]
    return _some_columns(table, kept)


def _from_file(path: Path, sheet: str) -> tuple[Table, list[str]]:
    """Return the table of a file, and the lines above its titles."""
    content = read_bytes(path, MAX_BYTES)
    form, above, word = FORM, [], "line"
    if content[: len(ZIP)] == ZIP:
        rows: Iterator[Row] = sheet_rows(content, path.name, sheet)
        word = "row"
    else:
        form = text_form(content, path.name)
        above = lines_above(content, form)
        rows = rows_of(content, path.name, form)
    (_, titles), *rest = rows
    if not rest:
        raise DataError(path.name, "holds no data")
    places = tuple(f"{word} {number}" for number, _ in rest)
    fields = tuple(tuple(row) for _, row in rest)
    said = f"{path.name} read: {form.words()}" if form.words() else ""
    return Table(path.name, tuple(titles), fields, places, said), above


def _without_index(table: Table) -> Table:
    """Leave columns without a title out that are empty, or number the rows."""
    kept = []
    for place, title in enumerate(table.titles):
        fields = [row[place] for row in table.rows]
        numbers = [number for field in fields if (number := whole_number(field)) is not None]
        counts = (
            place == 0
            and len(numbers) == len(fields)
            and all(b == a + 1 for a, b in pairwise(numbers))
        )
        if title or not (counts or not any(fields)):
            kept.append(place)
    return _some_columns(table, kept)


def _some_columns(table: Table, places: Sequence[int]) -> Table:
    return replace(
        table,
        titles=tuple(table.titles[k] for k in places),
        rows=tuple(tuple(row[k] for k in places) for row in table.rows),
    )


def _columns(table: Table) -> dict[str, NDArray[Any]]:
    """Return the columns of a table as text.

    Replicates below one heading get numbers: ``Control``, ``Control (2)``, and so on.
    """
    fields = np.array(table.rows, dtype=object).reshape(len(table.rows), len(table.titles))
    found: dict[str, NDArray[Any]] = {}
    heading, last = "", 1
    for k, title in enumerate(table.titles):
        heading, last = title or heading, last if not title or title == heading else 1
        name = title or heading
        while name in found:
            last += 1
            name = f"{heading} ({last})"
        found[name] = fields[:, k]
    return found


def _refuse_one_of_several(table: Table, titles: Iterable[str]) -> None:
    """Refuse the title of several columns where one is meant."""
    for title in titles:
        place = table.titles.index(title) if title in table.titles else len(table.titles)
        if title in table.titles[place + 1 :] or (title and table.titles[place + 1 :][:1] == ("",)):
            hint = f"Replicates side by side are named in one: '\"{title}*\" um'."
            raise DataError(f"{table.name}, '{title}'", "is the title of several columns", hint)


def _in_hours(table: Table) -> Table:
    """Return a table with hours in place of times as on a clock."""
    titles, rows = list(table.titles), [list(row) for row in table.rows]
    for place, title in enumerate(titles):
        times = [_CLOCK.fullmatch(row[place]) for row in rows if row[place]]
        if title.lower() in ("time", "start") and times and all(times):
            titles[place] = f"{title} / h"
            for row in rows:
                if (time := _CLOCK.fullmatch(row[place])) is not None:
                    hours, minutes, seconds = (float(part or 0.0) for part in time.groups())
                    row[place] = repr(hours + minutes / 60.0 + seconds / 3600.0)
    return replace(table, titles=tuple(titles), rows=tuple(map(tuple, rows)))


def _rows(table: Table, where: Mapping[str, str]) -> Table:
    """Return the rows that have certain values."""
    _refuse_one_of_several(table, where)
    chosen = rows_where(_columns(table), where, table.name)
    rows, places = tuple(compress(table.rows, chosen)), tuple(compress(table.places, chosen))
    said = f"{len(rows):,} of {len(table.rows):,} rows"
    return replace(table, rows=rows, places=places, said=_joined(table, said))


def _mapped(table: Table, names: ColumnMap) -> Table:
    """Return the columns that are named."""
    columns = _columns(table)
    for name, text in names.columns.items():
        source = column_source(name, text, list(columns), table.name)
        _refuse_one_of_several(table, () if source.wide else source.titles)

    def place(row: int, title: str) -> str:
        return f"{table.name}, {table.places[row]}, '{title}'"

    found = mapped(columns, names, place, table.name)
    texts = [[_or_empty(field_text(value)) for value in c.tolist()] for c in found.values()]
    times = len(texts[0]) // len(table.rows)  # columns side by side are below each other now
    rows = list(zip(zip(*texts, strict=True), chain(*[table.places] * times), strict=True))
    values = [k for k, name in enumerate(names.columns) if name not in _OF_ROWS and "." not in name]
    measured = [(row, where) for row, where in rows if not values or any(row[k] for k in values)]
    if not measured:
        raise DataError(table.name, "holds no data")
    said = ", ".join(f"{name} = {text}" for name, text in names.columns.items())
    empty = len(rows) - len(measured)
    said += f"; {empty:,} without a value are left out" if empty else ""
    fields, places = zip(*measured, strict=True)
    return Table(table.name, tuple(found), fields, places, _joined(table, said))


def _or_empty(field: str) -> str:
    """Return a field, empty where a program writes that there is none."""
    return "" if field.lower() in ("nan", "na", "n/a", "#n/a", "null", "-") else field


def _joined(table: Table, said: str) -> str:
    return f"{table.said}; {said}" if table.said else f"{table.name} read: {said}"


def _incucyte(table: Table, above: Sequence[str]) -> tuple[Table, ColumnMap]:
    """Return an Incucyte's export without dates and errors, and what its columns are.

    Raises DataError where the lines above the titles state no length, area or volume.
    """
    metric = next(
        (line.partition(":")[2].strip(" \t,;") for line in above if line.startswith("Metric")), ""
    )
    unit = split_title(metric)[1]
    sized = any(unit and unit_factor(unit, f"um^{power}") is not None for power in (1, 2, 3))
    if not sized:
        what = f"the metric '{metric}'" if metric else "no line 'Metric: NAME (UNIT)'"
        hint = "Say what it is: --columns 'hours=Elapsed, diameter=\"*: *\" um^2'."
        raise DataError(table.name, f"is an Incucyte's export with {what}", hint)
    kept = [k for k, title in enumerate(table.titles) if k and not _ERRORS.search(title)]
    said = _joined(table, f"an Incucyte's {metric} of {len(kept) - 1} wells")
    names = ColumnMap({"hours": "Elapsed", "diameter": f'"*" {unit}'})
    return replace(_some_columns(table, kept), said=said), names
