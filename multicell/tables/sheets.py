"""Rows of a sheet of an Excel workbook."""

from __future__ import annotations

import datetime
import io
import zipfile
from collections.abc import Iterator
from typing import Any, Final

from multicell.errors import DataError
from multicell.host.extras import needs
from multicell.tables.text import Row

ZIP: Final = b"PK\x03\x04"  # what a workbook begins with
_LARGEST: Final = 4_000_000_000  # bytes of what is packed in it


def sheet_rows(content: bytes, name: str, sheet: str = "") -> Iterator[Row]:
    """Yield the titles and then the other rows of a sheet, as texts, one at a time.

    - ``name``: of the file, for errors
    - ``sheet``: its name; empty: the first one that is not empty

    A formula has the value that Excel stored with it. Raises DataError where there is none, for
    errors of formulas, and for what is no workbook.
    """
    needs("openpyxl")
    import openpyxl

    try:
        with zipfile.ZipFile(io.BytesIO(content)) as packed:
            unpacked = sum(entry.file_size for entry in packed.infolist())
        if unpacked > _LARGEST:
            raise DataError(name, f"holds {unpacked:,} bytes unpacked, which is too much")
        values, formulas = (
            openpyxl.load_workbook(io.BytesIO(content), read_only=True, data_only=stored)
            for stored in (True, False)
        )
    except (zipfile.BadZipFile, KeyError, ValueError, OSError) as error:
        raise DataError(name, f"is no Excel workbook: {error}") from None
    sheets = [one.title for one in values.worksheets]
    if sheet and sheet not in sheets:
        raise DataError(name, f"has no sheet '{sheet}'", f"It has: {', '.join(sheets)}.")
    for title in [sheet] if sheet else sheets:
        rows = _rows(values[title], formulas[title], f"{name}, sheet '{title}'")
        first = next(rows, None)
        if first is not None:
            yield first
            yield from rows
            return
    raise DataError(name, "holds no data")


def _rows(values: Any, formulas: Any, place: str) -> Iterator[Row]:
    """Yield the rows of a sheet that are not blank, cut to the width of the first one."""
    width = 0
    pairs = zip(values.iter_rows(), formulas.iter_rows(), strict=False)
    for number, (stored, written) in enumerate(pairs, start=1):
        fields = [
            _field(cell, other, f"{place}, row {number}")
            for cell, other in zip(stored, written, strict=False)
        ]
        if not any(fields) or fields[0].startswith("#"):
            continue
        if not width:
            width = max(k for k, field in enumerate(fields, start=1) if field)
        if any(fields[width:]):
            raise DataError(f"{place}, row {number}", "has a field beyond the titles")
        yield number, [*fields, *[""] * width][:width]


def _field(cell: Any, written: Any, place: str) -> str:
    """Return a cell of a sheet as text."""
    value = cell.value
    if value is None and getattr(written, "data_type", "") == "f":
        where = f"{place}, {written.coordinate}"
        hint = "Open the workbook in Excel and save it, or paste the values."
        raise DataError(where, f"is the formula {written.value!r:.40} without a value", hint)
    if getattr(cell, "data_type", "") == "e":
        raise DataError(f"{place}, {cell.coordinate}", f"is the error {value}")
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, datetime.datetime | datetime.date | datetime.time):
        return value.isoformat()
    if isinstance(value, datetime.timedelta):
        minutes, seconds = divmod(value.total_seconds(), 60.0)
        return f"{int(minutes) // 60}:{int(minutes) % 60:02}:{seconds:g}"
    return str(value).strip()
