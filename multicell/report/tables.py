"""Tables of a run: cells, contacts, lineage and history, with units in the titles of columns.

A table comes in parts, one a frame, so that a long run need not be in memory as a whole.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
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
    """Give the cells of each frame."""
    kinds = _kinds(run)
    phases = run.scene.growth is not None and bool(run.scene.growth.phases)
    for number, frame in frames:
        n = len(frame.cells)
        place = {
            "frame": np.full(n, number),
            titled("time", unit_of("cells.time")): np.full(n, frame.time),
        }
        yield place | cells_table(frame, kinds=kinds, phases=phases)


def _contacts(run: Result, frames: Iterator[tuple[int, Frame]]) -> Iterator[Table]:
    """Give the pairs in contact of each frame by their identities."""
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
    """Give the table of all cells that ever were, with the names of their types."""
    kinds = _kinds(run)
    yield {
        titled(name, unit_of(f"lineage.{name}")): kinds[column] if name == "kind" else column
        for name, column in run.lineage.items()
    }


def _history(run: Result, frames: Iterator[tuple[int, Frame]]) -> Iterator[Table]:
    """Give the history, one row for each coupling step."""
    yield {titled(name, known_unit(name)): column for name, column in run.history.items()}


TABLES: Final[Mapping[str, Callable[[Result, Iterator[tuple[int, Frame]]], Iterator[Table]]]] = {
    "lineage": _lineage,
    "history": _history,
    "cells": _cells,
    "contacts": _contacts,
}
"""What can be exported."""


def _kinds(run: Result) -> NDArray[Any]:
    """Return the names of the cell types by their numbers."""
    return np.array(list(run.scene.types) or [""], dtype=object)


def whole_table(run: Result, name: str) -> DataFrame:
    """Return a table of all frames."""
    if name not in TABLES:
        raise OutputError(f"there is no table {name!r}. {near_miss(name, TABLES)}")
    parts = list(TABLES[name](run, enumerate(run.frames)))
    titles = parts[0] if parts else {}
    return data_frame({title: np.concatenate([part[title] for part in parts]) for title in titles})
