"""Rows of CSV text: remarks and blank lines are left out, and each row knows its line."""

from __future__ import annotations

import csv
import io
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

from multicell.errors import DataError
from multicell.host.files import read_regular
from multicell.tables.forms import Form, encoding_of, form_of, with_point

Row = tuple[int, list[str]]
"""Number of a row's (last) line in the file, and its fields without blanks around them."""


def read_bytes(path: Path, largest: int) -> bytes:
    """Return the content of a regular file.

    - ``largest``: number of bytes that it may have
    """
    try:
        return read_regular(path, largest)
    except FileNotFoundError:
        raise DataError(str(path), "does not exist") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise DataError(str(path), f"cannot be read: {reason}") from None


def rows_of(content: bytes, name: str, form: Form | None = None) -> Iterator[Row]:
    """Yield the header and then the other rows of a table of text, one at a time.

    - ``content``: of the file, in any encoding, with any of the usual separators
    - ``name``: of the file, for errors
    - ``form``: how it is written; absent: as it is found to be
    """
    form = text_form(content, name) if form is None else form
    numbers = array("q")
    lines = _lines(content, form.encoding, numbers)
    for _ in range(form.above):
        next(lines)
    reader = csv.reader(lines, delimiter=form.separator, skipinitialspace=True)
    width = 0
    try:
        for fields in reader:
            number = numbers[form.above + reader.line_num - 1]
            row = [field.strip() for field in fields]
            if form.comma and width:
                row = [with_point(field, f"{name}, line {number}") for field in row]
            if not width:
                width = len(row)
            elif len(row) != width:
                problem = f"has {len(row)} fields, the header has {width}"
                raise DataError(f"{name}, line {number}", problem, "Use '.' as decimal separator.")
            yield number, row
    except csv.Error as error:
        number = numbers[form.above + reader.line_num - 1]
        raise DataError(f"{name}, line {number}", str(error)) from None
    except UnicodeDecodeError as error:
        raise DataError(name, f"is not {form.encoding} text: {error.reason}") from None
    if not width:
        raise DataError(name, "holds no data")


def text_form(content: bytes, name: str) -> Form:
    """Return how a table of text is written."""
    encoding = encoding_of(content, name)
    try:
        return form_of(_lines(content, encoding, array("q")), encoding, name)
    except UnicodeDecodeError as error:
        raise DataError(name, f"is not {encoding} text: {error.reason}") from None


def lines_above(content: bytes, form: Form) -> list[str]:
    """Return the lines above the titles of a table, without blanks around them."""
    return [line.strip() for line in islice(_lines(content, form.encoding, array("q")), form.above)]


def _lines(content: bytes, encoding: str, numbers: array[int]) -> Iterator[str]:
    """Yield the lines of a text that are no remarks and not blank, and note their numbers."""
    text = io.TextIOWrapper(io.BytesIO(content), encoding, newline=None)
    for number, line in enumerate(text, start=1):
        if line.strip(" \t,;|\n") and not line.lstrip().startswith("#"):
            numbers.append(number)
            yield line


def csv_text(titles: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    """Return rows as CSV text below a header."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([titles, *rows])
    return text.getvalue()


def table_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows with the same columns as CSV text; NaN is written as ``nan``."""
    titles = list(rows[0])
    return csv_text(titles, ([row[title] for title in titles] for row in rows))
