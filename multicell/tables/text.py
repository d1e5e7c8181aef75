"""Rows of CSV text: remarks and blank lines are left out, and each row knows its line."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from multicell.errors import DataError
from multicell.host.files import read_regular

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


def csv_rows(content: bytes, name: str) -> Iterator[Row]:
    """Yield the header and then the other rows of a CSV file, one at a time.

    - ``content``: of the file, UTF-8 with or without a byte order mark
    - ``name``: of the file, for errors
    """
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DataError(name, f"is not UTF-8 text (byte {error.start})") from None
    numbers: list[int] = []
    reader = csv.reader(_lines(text, numbers), skipinitialspace=True)
    width = 0
    try:
        for fields in reader:
            number = numbers[reader.line_num - 1]
            row = [field.strip() for field in fields]
            if not width:
                width = len(row)
                if width == 1 and any(mark in row[0] for mark in ";\t"):
                    raise DataError(name, "has one column", "Columns are separated by commas.")
            elif len(row) != width:
                problem = f"has {len(row)} fields, the header has {width}"
                raise DataError(f"{name}, line {number}", problem, "Use '.' as decimal separator.")
            yield number, row
    except csv.Error as error:
        raise DataError(f"{name}, line {numbers[reader.line_num - 1]}", str(error)) from None
    if not width:
        raise DataError(name, "holds no data")


def _lines(text: str, numbers: list[int]) -> Iterator[str]:
    """Yield the lines of a text that are no remarks and not blank, and note their numbers."""
    for number, line in enumerate(io.StringIO(text, newline=None), start=1):
        if line.strip(" \t,\n") and not line.lstrip().startswith("#"):
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
