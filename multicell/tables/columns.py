"""Columns of a table from a CSV, Parquet or AnnData file, a ``DataFrame`` or a mapping."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from numbers import Number
from pathlib import Path
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from multicell.errors import DataError
from multicell.host.extras import needs
from multicell.tables.forms import FORM, Form
from multicell.tables.text import Row, rows_of, text_form

_ROWS: Final = 50_000  # of text that are turned into numbers at a time
PARQUET: Final = b"PAR1"  # what a Parquet file begins with


@final
@dataclass(frozen=True, eq=False)
class Columns:
    """Columns of one length."""

    name: str  # of the file, or "cells"
    columns: Mapping[str, NDArray[Any]]  # (n,): float64, int64, or text where a field is no number
    lines: NDArray[np.int64] | None = None  # of the file, (n,); None where there are rows only
    form: Form = FORM

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    def place(self, row: int, title: str = "") -> str:
        """Return where a value stands, in words: lines of a file, else rows counted from 0."""
        where = f"row {row}" if self.lines is None else f"line {self.lines[row]}"
        return ", ".join(filter(None, (self.name, where, f"'{title}'" if title else "")))


def from_bytes(
    content: bytes,
    name: str,
    *,
    form: Form | None = None,
    skip: int = 0,
    wanted: Callable[[str], bool] = lambda title: True,
) -> Columns:
    """Return the columns of a CSV or Parquet file.

    - ``form``: how text is written; absent: as it is found to be
    - ``skip``: rows below the titles that hold none
    - ``wanted``: which titles are needed, of text
    """
    if content[:4] == PARQUET:
        return _parquet(content, name)
    form = text_form(content, name) if form is None else form
    rows = partial(rows_of, content, name, form)
    found = from_rows(rows(), name, rows, form, skip, wanted)
    return _filled(found) if found.columns else found  # who wants columns names those it lacks


def from_titles(
    content: bytes, name: str, form: Form, marks: Sequence[str]
) -> tuple[list[str], list[list[str]]]:
    """Return the titles of a table of text, and further lines of titles and units below them.

    - ``marks``: titles of tables that have such lines: those without a number
    """
    rows = rows_of(content, name, form)
    titles = next(rows)[1]
    below: list[list[str]] = []
    if set(marks) <= set(titles):
        place = titles.index(marks[-1])
        for _, row in islice(rows, 3):
            if _is_number(row[place]):
                break
            below.append(row)
    return titles, below


def _is_number(field: str) -> bool:
    try:
        float(field)
    except ValueError:
        return False
    return True


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
    refuse_twins(titles, name)
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


def refuse_twins(titles: Sequence[str], name: str) -> None:
    """Raise ``DataError`` for two columns of one title."""
    times = Counter(titles)  # a table may have a column for each of many thousand cells
    for title in titles:
        if times[title] > 1:
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


def from_rows(
    rows: Iterator[Row],
    name: str,
    again: Callable[[], Iterator[Row]] | None = None,
    form: Form = FORM,
    skip: int = 0,
    wanted: Callable[[str], bool] = lambda title: True,
) -> Columns:
    """Return the columns of rows of text, the titles first.

    - ``again``: begins with the rows anew; absent: all are kept until the end
    """
    if again is None:
        stored = list(rows)
        again, rows = partial(iter, stored), iter(stored)
    _, titles = next(rows)
    places = [k for k, title in enumerate(titles) if wanted(title)]
    refuse_twins([titles[k] for k in places], name)
    rows = islice(rows, skip, None)
    parts: dict[int, list[NDArray[Any]]] = {place: [] for place in places}
    lines: list[NDArray[np.int64]] = []
    while block := list(islice(rows, _ROWS)):  # so many at a time: text takes ten times the memory
        lines.append(np.array([number for number, _ in block], np.int64))
        for place in places:
            parts[place].append(parsed([row[place] for _, row in block]))
    found = {place: _joined(part) for place, part in parts.items()}
    mixed: dict[int, list[str]] = {place: [] for place in places if found[place] is None}
    if mixed:  # numbers above, text below: it is text all through
        for _, row in islice(again(), 1 + skip, None):
            for place, fields in mixed.items():
                fields.append(row[place])
    texts = {place: np.array(fields, dtype=object) for place, fields in mixed.items()}
    columns = {titles[k]: column for k, column in (found | texts).items() if column is not None}
    _drop_index(columns)
    return Columns(name, columns, np.concatenate([np.empty(0, np.int64), *lines]), form)


def _drop_index(columns: dict[str, NDArray[Any]]) -> None:
    """Leave a column without a title out that is empty, or numbers the rows."""
    column = columns.get("")
    if column is None or len(columns) == 1:
        return
    counts = column.dtype.kind in "if" and len(column) > 0
    if counts and (np.isnan(column).all() or bool((np.diff(column) == 1).all())):
        del columns[""]


def _joined(parts: Sequence[NDArray[Any]]) -> NDArray[Any] | None:
    """Return the parts of a column as one; None where some are text and some are numbers."""
    if len({part.dtype == object for part in parts}) > 1:
        return None
    return np.concatenate(parts) if parts else np.empty(0, np.int64)


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
    said: str = ""  # what it was read as, in words, where that is not plain


def read_object(source: Any) -> Table:
    """Return a ``DataFrame``, or a mapping of titles to columns, as text."""
    found = from_object(source, "data")
    columns = [
        [field_text(value) for value in column.tolist()] for column in found.columns.values()
    ]
    rows_of_text = tuple(zip(*columns, strict=True))
    places = tuple(f"row {number}" for number in range(len(rows_of_text)))
    return Table("data", tuple(found.columns), rows_of_text, places)


def field_text(value: Any) -> str:
    """Return a field as a CSV file has it; what is missing is empty."""
    if value != value:
        return ""
    text = str(value)
    return text.lower() if text in ("True", "False") else text
