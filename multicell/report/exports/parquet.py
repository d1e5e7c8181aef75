"""Tables as Parquet, one group of rows for each frame."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as arrow
import pyarrow.parquet
from numpy.typing import NDArray

from multicell.report.tables import TABLES, Frames

if TYPE_CHECKING:
    from multicell.report.result import Result


def write(run: Result, frames: Frames, folder: Path, tables: Sequence[str]) -> list[str]:
    """Write tables into a folder and return the names of the files."""
    names = [f"{table}.parquet" for table in tables]
    for table, name in zip(tables, names, strict=True):
        writer = None
        try:
            for part in TABLES[table](run, frames()):
                rows = arrow.table({title: _array(values) for title, values in part.items()})
                if writer is None:
                    writer = arrow.parquet.ParquetWriter(folder / name, rows.schema)
                writer.write_table(rows)
        finally:
            if writer is not None:
                writer.close()
    return names


def _array(values: NDArray[Any]) -> Any:
    """Return a column as Arrow's, with nothing in place of NaN."""
    missing = np.isnan(values) if values.dtype.kind == "f" else None
    # words stand in arrays of objects, and an empty one of them does not tell what it would hold
    kind = arrow.string() if values.dtype.kind in "OU" else None
    return arrow.array(values, type=kind, mask=missing)
