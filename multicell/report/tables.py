"""Tables of a run: cells, contacts, lineage and history, with units in the titles of columns.

A table comes in parts, one a frame, so that a long run need not be in memory as a whole; Parquet
files have one group of rows for each.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from multicell.errors import OutputError
from multicell.results.observables import touching
from multicell.results.quantities import known_unit, unit_of
from multicell.results.tables import cells_table, data_frame
from multicell.schema import near_miss
from multicell.tables.titles import titled

if TYPE_CHECKING:
    from pandas import DataFrame

    from multicell.report.result import Result
    from multicell.results.frame import Frame

Table = Mapping[str, NDArray[Any]]
Frames = Callable[[], "Iterator[tuple[int, Frame]]"]
"""What gives the chosen frames with their numbers, one at a time, each time that it is called."""


def _cells(run: Result, frames: Iterator[tuple[int, Frame]]) -> Iterator[Table]:
    kinds = np.array(list(run.scene.types) or [""], dtype=object)
    phases = run.scene.growth is not None and bool(run.scene.growth.phases)
    for number, frame in frames:
        n = len(frame.cells)
        place = {
            "frame": np.full(n, number),
            titled("time", unit_of("cells.time")): np.full(n, frame.time),
        }
        yield place | cells_table(frame, kinds=kinds, phases=phases)


def _contacts(run: Result, frames: Iterator[tuple[int, Frame]]) -> Iterator[Table]:
    for number, frame in frames:
        cells = frame.cells
        pairs = touching(frame)
        n, (first, second) = len(pairs), pairs.T
        apart = np.linalg.norm(cells.position[first] - cells.position[second], axis=1)
        table = {
            "frame": np.full(n, number),
            "time": np.full(n, frame.time),
            "first_id": cells.id[first],
            "second_id": cells.id[second],
            "distance": apart,
            "overlap": cells.radius[first] + cells.radius[second] - apart,
        }
        yield {titled(name, unit_of(f"contacts.{name}")): v for name, v in table.items()}


def _lineage(run: Result, frames: Iterator[tuple[int, Frame]]) -> Iterator[Table]:
    kinds = np.array(list(run.scene.types) or [""], dtype=object)
    yield {
        titled(name, unit_of(f"lineage.{name}")): kinds[column] if name == "kind" else column
        for name, column in run.lineage.items()
    }


def _history(run: Result, frames: Iterator[tuple[int, Frame]]) -> Iterator[Table]:
    names = sorted(run.history, key=lambda name: name != "time")  # time first
    yield {titled(name, known_unit(name)): run.history[name] for name in names}


TABLES: Final[Mapping[str, Callable[[Result, Iterator[tuple[int, Frame]]], Iterator[Table]]]] = {
    "lineage": _lineage,
    "history": _history,
    "cells": _cells,
    "contacts": _contacts,
}
"""What can be exported."""


def whole_table(run: Result, name: str) -> DataFrame:
    """Return a table of all frames."""
    if name not in TABLES:
        raise OutputError(f"there is no table {name!r}. {near_miss(name, TABLES)}")
    return data_frame(joined_table(TABLES[name](run, enumerate(run.frames))))


def joined_table(parts: Iterable[Table]) -> dict[str, NDArray[Any]]:
    """Return a table of the rows of all parts."""
    parts = list(parts)
    titles = parts[0] if parts else {}
    return {title: np.concatenate([part[title] for part in parts]) for title in titles}


def write_csv_files(run: Result, frames: Frames, folder: Path, tables: Sequence[str]) -> list[str]:
    """Write tables as CSV into a folder and return the names of the files."""
    names = [f"{table}.csv" for table in tables]
    for table, name in zip(tables, names, strict=True):
        with (folder / name).open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            for k, part in enumerate(TABLES[table](run, frames())):
                if k == 0:
                    writer.writerow(part)
                # Python's numbers are written with all digits that distinguish them
                columns = [np.where(_missing(c), "", c.astype(object)) for c in part.values()]
                writer.writerows(zip(*(column.tolist() for column in columns), strict=True))
    return names


def write_parquet(run: Result, frames: Frames, folder: Path, tables: Sequence[str]) -> list[str]:
    """Write tables as Parquet into a folder and return the names of the files."""
    import pyarrow as arrow
    import pyarrow.parquet

    def array(values: NDArray[Any]) -> Any:
        # words stand in arrays of objects, and an empty one of them does not show its type
        kind = arrow.string() if values.dtype.kind in "OU" else None
        return arrow.array(values, type=kind, mask=_missing(values))

    names = [f"{table}.parquet" for table in tables]
    for table, name in zip(tables, names, strict=True):
        with ExitStack() as stack:
            writer = None
            for part in TABLES[table](run, frames()):
                rows = arrow.table({title: array(values) for title, values in part.items()})
                if writer is None:
                    writer = arrow.parquet.ParquetWriter(folder / name, rows.schema)
                    stack.enter_context(writer)
                writer.write_table(rows)
    return names


def _missing(column: NDArray[Any]) -> NDArray[np.bool_]:
    return np.isnan(column) if column.dtype.kind == "f" else np.zeros(len(column), bool)
