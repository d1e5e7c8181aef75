"""Tables as fields of text: from a CSV file, a ``DataFrame`` or a mapping of columns.

For tables whose columns may hold words, numbers with units and nothing at all; columns of numbers
are read by :mod:`multicell.tables.columns`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

from multicell.errors import DataError
from multicell.tables.columns import from_object
from multicell.tables.text import read_bytes, rows_of


@final
@dataclass(frozen=True)
class Table:
    """Titles and fields of a table, without blanks around them.

    - ``name``: of the file, or ``"data"``
    - ``titles``: of the columns
    - ``rows``: the fields of each row; empty text where there is no value
    - ``places``: each row in words: the line of the file, or the row counted from 0
    """

    name: str
    titles: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    places: tuple[str, ...]


def read_table(source: Any, largest: int) -> Table:
    """Return a table as text.

    - ``source``: path of a CSV file, a ``DataFrame``, or a mapping of titles to columns
    - ``largest``: number of bytes that a file may have
    """
    if isinstance(source, str | Path):
        path = Path(source).expanduser()
        (_, titles), *rows = rows_of(read_bytes(path, largest), path.name)
        if not rows:
            raise DataError(path.name, "holds no data")
        places = tuple(f"line {number}" for number, _ in rows)
        return Table(path.name, tuple(titles), tuple(tuple(row) for _, row in rows), places)
    found = from_object(source, "data")
    columns = [[_text(value) for value in column.tolist()] for column in found.columns.values()]
    rows_of_text = tuple(zip(*columns, strict=True))
    places = tuple(f"row {number}" for number in range(len(rows_of_text)))
    return Table("data", tuple(found.columns), rows_of_text, places)


def _text(value: Any) -> str:
    """Return a field as a CSV file has it; what is missing is empty."""
    if value != value:
        return ""
    text = str(value)
    return text.lower() if text in ("True", "False") else text
