"""Columns of a table from a CSV, Parquet or AnnData file, a ``DataFrame`` or a mapping."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Number
from pathlib import Path
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from multicell.errors import DataError
from multicell.host.extras import needs
from multicell.tables.text import csv_rows, read_bytes

PARQUET: Final = b"PAR1"  # what a Parquet file begins with


@final
@dataclass(frozen=True, eq=False)
class Columns:
    """Columns of one length."""

    name: str  # of the file, or "cells"
    columns: Mapping[str, NDArray[Any]]  # (n,): float64, int64, or text where a field is no number
    lines: NDArray[np.int64] | None = None  # of the file, (n,); None where there are rows only

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    def place(self, row: int, title: str = "") -> str:
        """Return where a value stands, in words: lines of a file, else rows counted from 0."""
        where = f"row {row}" if self.lines is None else f"line {self.lines[row]}"
        return ", ".join(filter(None, (self.name, where, f"'{title}'" if title else "")))


def from_bytes(content: bytes, name: str) -> Columns:
    """Return the columns of a CSV or Parquet file."""
    if content[:4] == PARQUET:
        return _parquet(content, name)
    return _filled(_csv(content, name))


def from_object(source: Any, name: str) -> Columns:
    """Return the columns of a ``DataFrame`` or a mapping of titles to columns."""
    if hasattr(source, "columns") and hasattr(source, "itertuples"):
        titles = [str(title).strip() for title in source.columns]
        arrays = (source.iloc[:, k].to_numpy() for k in range(len(titles)))
    elif isinstance(source, Mapping):
        titles = [str(title).strip() for title in source]
        arrays = (_array(column, f"{name}, '{title}'") for title, column in source.items())
    else:
        raise DataError(
            name, f"is a {type(source).__name__}, must be a file, a DataFrame or columns by title"
        )
    return _filled(_gathered(titles, arrays, name))


def _array(column: Any, place: str) -> NDArray[Any]:
    try:
        return np.asarray(column)
    except ValueError:  # lists of different lengths
        raise DataError(place, "is not a column of single values") from None


def _gathered(titles: Sequence[str], arrays: Iterable[Any], name: str) -> Columns:
    _refuse_twins(titles, name)
    found: dict[str, NDArray[Any]] = {}
    for title, array in zip(titles, arrays, strict=True):
        if np.ndim(array) != 1:
            raise DataError(f"{name}, '{title}'", "is not a column of single values")
        found[title] = _typed(array)
    lengths = {title: len(column) for title, column in found.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"'{title}' {length}" for title, length in lengths.items())
        raise DataError(name, f"has columns of different lengths: {listed}")
    return Columns(name, found)


def _typed(array: Any) -> NDArray[Any]:
    """Return a column as float64, int64 or text; what is missing is NaN or empty text.

    Text stays text, whatever it says: who wants numbers of it asks :func:`parsed`. Moments,
    durations, logical values and lists are text too, which is never a number.
    """
    array = np.asarray(array)
    largest = np.iinfo(np.int64).max
    if array.dtype.kind == "i" or (array.dtype.kind == "u" and array.max(initial=0) <= largest):
        return np.asarray(array.astype(np.int64))
    if array.dtype.kind in "uf":
        return np.asarray(array.astype(np.float64))
    if array.dtype.kind == "M":  # as objects they would be numbers of nanoseconds
        return np.array(np.datetime_as_string(array, unit="s"), dtype=object)
    values = array.astype(object) if array.dtype.kind != "m" else array
    texts = [_text(value) for value in values]
    if array.dtype.kind == "O" and not any(isinstance(value, str) for value in values):
        return parsed(texts)
    return np.array(texts, dtype=object)


def _text(value: Any) -> str:
    if value is None or type(value).__name__ in ("NAType", "NaTType"):
        return ""
    text = str(value.tolist() if isinstance(value, np.ndarray) else value).strip()
    return "" if isinstance(value, Number) and text.lower() in ("nan", "snan") else text


def _refuse_twins(titles: Sequence[str], name: str) -> None:
    for title in titles:
        if titles.count(title) > 1:
            raise DataError(f"{name}, '{title}'", "is the title of two columns")


def _filled(columns: Columns) -> Columns:
    if not len(columns):
        raise DataError(columns.name, "holds no rows")
    return columns


def _parquet(content: bytes, name: str) -> Columns:
    needs("pandas", "pyarrow")
    import pyarrow as arrow
    import pyarrow.parquet

    try:
        table = arrow.parquet.read_table(arrow.BufferReader(content))
    except (arrow.ArrowException, OSError) as error:
        raise DataError(name, f"is no Parquet file: {error}") from None
    # without what pandas notes in a file: to it a column may be the index
    return from_object(table.to_pandas(ignore_metadata=True), name)


def _csv(content: bytes, name: str) -> Columns:
    (_, titles), *rows = csv_rows(content, name)
    _refuse_twins(titles, name)
    fields = zip(*(row for _, row in rows), strict=True) if rows else [()] * len(titles)
    columns = {title: parsed(column) for title, column in zip(titles, fields, strict=True)}
    return Columns(name, columns, np.array([number for number, _ in rows], np.int64))


def from_h5ad(path: Path, known: Callable[[str], bool]) -> dict[str, Any]:
    """Return the columns of AnnData by title: of ``obs``, of ``X``, and ``obsm["spatial"]`` in µm.

    - ``known``: whether a title is wanted; annotations of other programs are left out

    Raises DataError if it is no AnnData file, or none with coordinates.
    """
    needs("anndata")
    import anndata

    try:
        data = anndata.read_h5ad(path)
    except Exception as error:  # of several libraries
        raise DataError(path.name, f"is no AnnData file: {error}") from None
    found: dict[str, Any] = {title: data.obs[title].astype(object) for title in data.obs}
    numbers = {title: title not in found for title in data.var_names}
    found = {title: np.asarray(column) for title, column in found.items() if known(title)}
    for title in (title for title, new in numbers.items() if new and known(title)):
        column = data[:, title].X
        found[title] = np.asarray(column.todense() if hasattr(column, "todense") else column)
        found[title] = found[title].ravel()
    if "spatial" in data.obsm:
        place = np.asarray(data.obsm["spatial"])
        found |= {f"position_{axis}_um": x for axis, x in zip("xyz", place.T, strict=False)}
    return found


def parsed(column: Sequence[str]) -> NDArray[Any]:
    """Return fields of text as whole numbers, as numbers, or, where one is none, as they are."""
    for kind, dtype in ((int, np.int64), (float, np.float64)):
        try:
            return np.array(list(map(kind, column)), dtype)
        except (ValueError, OverflowError):
            continue
    try:
        return np.array([float(field) if field else np.nan for field in column])
    except ValueError:
        return np.array(column, dtype=object)


@final
@dataclass(frozen=True)
class Table:
    """Titles and fields of a table, without blanks around them."""

    name: str  # of the file, or "data"
    titles: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]  # fields; empty text where there is no value
    places: tuple[str, ...]  # each row in words: the line of the file, or the row counted from 0


def read_table(source: Any, largest: int) -> Table:
    """Return a table as text.

    - ``source``: path of a CSV file, a ``DataFrame``, or a mapping of titles to columns
    - ``largest``: number of bytes that a file may have
    """
    if isinstance(source, str | Path):
        path = Path(source).expanduser()
        (_, titles), *rows = csv_rows(read_bytes(path, largest), path.name)
        if not rows:
            raise DataError(path.name, "holds no data")
        places = tuple(f"line {number}" for number, _ in rows)
        return Table(path.name, tuple(titles), tuple(tuple(row) for _, row in rows), places)
    found = from_object(source, "data")
    columns = [
        [_field_text(value) for value in column.tolist()] for column in found.columns.values()
    ]
    rows_of_text = tuple(zip(*columns, strict=True))
    places = tuple(f"row {number}" for number in range(len(rows_of_text)))
    return Table("data", tuple(found.columns), rows_of_text, places)


def _field_text(value: Any) -> str:
    """Return a field as a CSV file has it; what is missing is empty."""
    if value != value:
        return ""
    text = str(value)
    return text.lower() if text in ("True", "False") else text
