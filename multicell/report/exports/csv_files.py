"""Tables as CSV."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from multicell.report.tables import TABLES, Frames, Table

if TYPE_CHECKING:
    from multicell.report.result import Result


def write(run: Result, frames: Frames, folder: Path, tables: Sequence[str]) -> list[str]:
    """Write tables into a folder and return the names of the files."""
    names = [f"{table}.csv" for table in tables]
    for table, name in zip(tables, names, strict=True):
        with (folder / name).open("w", newline="", encoding="utf-8") as file:
            _write(csv.writer(file), TABLES[table](run, frames()))
    return names


def _write(writer: Any, parts: Iterable[Table]) -> None:
    """Write the parts of a table below one header."""
    for k, part in enumerate(parts):
        if k == 0:
            writer.writerow(part)
        writer.writerows(zip(*map(_written, part.values()), strict=True))


def _written(column: NDArray[Any]) -> list[Any]:
    """Return what is written of a column: nothing where there is no number."""
    # Python's numbers are written with all digits that tell them apart
    values: list[Any] = column.tolist()
    if column.dtype.kind == "f":
        missing = np.isnan(column)
        if missing.any():
            return ["" if no else value for value, no in zip(values, missing.tolist(), strict=True)]
    return values
