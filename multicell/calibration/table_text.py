"""Tables as text: from a CSV file, a pandas ``DataFrame``, or a mapping of columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from multicell.errors import DataError
from multicell.tables.text import read_bytes, rows_of

_LARGEST: Final = 10_000_000
"""Bytes of a file of measured data."""


@final
@dataclass(frozen=True)
class Table:
    """Titles and fields of a table, without blanks around them.

    Attributes
    ----------
    name
        Of the file, or ``"data"``.
    titles
        Of the columns.
    rows
        The fields of each row; empty text where there is no value.
    places
        Each row in words: the line of the file, or the row of the frame.
    """

    name: str
    titles: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    places: tuple[str, ...]


def read_table(source: Any) -> Table:
    """Return a table as text.

    Parameters
    ----------
    source
        Path of a CSV file, a ``DataFrame``, or a mapping of titles to columns.

    Raises
    ------
    DataError
        For a file that cannot be read, a row of another length than the header, and a table
        without rows.
    """
    if isinstance(source, str | Path):
        table = _from_file(Path(source).expanduser())
    elif hasattr(source, "columns") and hasattr(source, "itertuples"):
        rows = [tuple(map(_text, row)) for row in source.itertuples(index=False, name=None)]
        places = tuple(f"row {label}" for label in source.index)
        table = Table("data", tuple(str(t).strip() for t in source.columns), tuple(rows), places)
    elif isinstance(source, Mapping):
        table = _from_columns(source)
    else:
        problem = f"is a {type(source).__name__}, must be a CSV file or a pandas DataFrame"
        raise DataError("data", problem)
    if not table.rows:
        raise DataError(table.name, "holds no data")
    return table


def _from_file(path: Path) -> Table:
    name = path.name
    rows = list(rows_of(read_bytes(path, _LARGEST), name))
    (_, titles), *rest = rows
    places = tuple(f"line {number}" for number, _ in rest)
    return Table(name, tuple(titles), tuple(tuple(row) for _, row in rest), places)


def _from_columns(source: Mapping[Any, Any]) -> Table:
    columns: list[Sequence[Any]] = []
    for title, column in source.items():
        single = isinstance(column, np.ndarray) and column.ndim == 0
        if single or isinstance(column, str) or not hasattr(column, "__len__"):
            raise DataError(f"data, '{title}'", "is one value, must be a column of them")
        columns.append(column)
    if len({len(column) for column in columns}) > 1:
        lengths = ", ".join(f"'{t}' {len(c)}" for t, c in source.items())
        raise DataError("data", f"has columns of different lengths: {lengths}")
    rows = tuple(tuple(map(_text, row)) for row in zip(*columns, strict=True))
    titles = tuple(str(title).strip() for title in source)
    return Table("data", titles, rows, tuple(f"row {k}" for k in range(len(rows))))


def _text(value: Any) -> str:
    """Return a field as text; what pandas marks as missing is empty."""
    if value is None or type(value).__name__ in ("NAType", "NaTType"):
        return ""
    if isinstance(value, str):
        return value.strip()
    if isinstance(value, bool | np.bool_):
        return str(value).lower()
    if isinstance(value, Integral):
        return str(int(value))
    if isinstance(value, Real):
        number = float(value)
        return "" if number != number else repr(number)
    return str(value)
