"""Tables as CSV, and as Parquet with one group of rows for each frame."""

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


def write_csv(run: Result, frames: Frames, folder: Path, tables: Sequence[str]) -> list[str]:
    """Write tables as CSV into a folder and return the names of the files."""
    names = [f"{table}.csv" for table in tables]
    for table, name in zip(tables, names, strict=True):
        with (folder / name).open("w", newline="", encoding="utf-8") as file:
            _write_rows(csv.writer(file), TABLES[table](run, frames()))
    return names


def _write_rows(writer: Any, parts: Iterable[Table]) -> None:
    """Write the parts of a table below one header; nothing stands where there is no number."""
    for k, part in enumerate(parts):
        if k == 0:
            writer.writerow(part)
        # Python's numbers are written with all digits that tell them apart
        columns = [np.where(_missing(c), "", c.astype(object)).tolist() for c in part.values()]
        writer.writerows(zip(*columns, strict=True))


def write_parquet(run: Result, frames: Frames, folder: Path, tables: Sequence[str]) -> list[str]:
    """Write tables as Parquet into a folder and return the names of the files."""
    import pyarrow as arrow
    import pyarrow.parquet

    def array(values: NDArray[Any]) -> Any:
        # words stand in arrays of objects, and an empty one of them does not tell what it holds
        kind = arrow.string() if values.dtype.kind in "OU" else None
        return arrow.array(values, type=kind, mask=_missing(values))

    names = [f"{table}.parquet" for table in tables]
    for table, name in zip(tables, names, strict=True):
        writer = None
        try:
            for part in TABLES[table](run, frames()):
                rows = arrow.table({title: array(values) for title, values in part.items()})
                if writer is None:
                    writer = arrow.parquet.ParquetWriter(folder / name, rows.schema)
                writer.write_table(rows)
        finally:
            if writer is not None:
                writer.close()
    return names


def _missing(column: NDArray[Any]) -> NDArray[np.bool_]:
    return np.isnan(column) if column.dtype.kind == "f" else np.zeros(len(column), bool)
