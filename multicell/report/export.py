"""Tables of a run as text: cells, contacts, lineage and history as CSV with units in the header."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import Cells, Phase, State
from multicell.errors import OutputError
from multicell.report.result import Result, load_result
from multicell.results.folder import file_errors, replacing
from multicell.results.frame import Frame
from multicell.results.observables import contact_rows
from multicell.results.quantities import known_unit, unit_of
from multicell.schema import near_miss

Table = Mapping[str, NDArray[Any]]

_AXES = ("x", "y", "z")
_NAMED: Final[Mapping[str, list[str]]] = {
    "state": [s.name.lower() for s in sorted(State)],
    "phase": [p.name for p in sorted(Phase)],
}
_OF_PHASES = ("phase", "progress", "phase_length")
_POWERS = str.maketrans({"^": "", "/": "_per_", " ": "_"})


def export(
    result: Result | str | Path,
    output: str | Path,
    *,
    tables: Sequence[str] | None = None,
    frame: int | None = None,
    overwrite: bool = False,
) -> list[Path]:
    """Write tables of a run as CSV files, ``cells.csv`` and so on.

    ``lineage`` has one row for every cell that ever was (:meth:`Lineage.table`), ``history`` one
    for each coupling step, ``cells`` and ``contacts`` one for each cell and each pair in contact in
    each frame. Where a run does not count its contacts (:attr:`Frame.contacts`), pairs whose
    spheres overlap are taken. A column with a dimension ends in its unit (``position_x_um``), and a
    number that does not exist, such as the viable rim without a core, is left empty.

    Parameters
    ----------
    result
        A run, or the folder of one.
    output
        Folder for the files; it is made if it does not exist.
    tables
        Names out of :data:`TABLES`; by default all.
    frame
        The one frame whose cells and contacts are written, counted from the end if negative; by
        default all.
    overwrite
        Replace files of the same names.

    Returns
    -------
    list of Path
        The files, in the order of ``tables``.

    Raises
    ------
    OutputError
        If the folder holds no results, has no such frame or table, or the files exist already or
        cannot be written.
    """
    run = result if isinstance(result, Result) else load_result(result)
    chosen = list(TABLES) if tables is None else list(tables)
    for name in chosen:
        if name not in TABLES:
            raise OutputError(f"there is no table {name!r}. {near_miss(name, TABLES)}")
    count = len(run.frames)
    if frame is not None and not -count <= frame < count:
        raise OutputError(f"there is no frame {frame}: the run has {count}")
    folder = Path(output)
    paths = [folder / f"{name}.csv" for name in chosen]
    with file_errors("use the output folder", folder):
        there = next((path for path in paths if path.exists() or path.is_symlink()), None)
        if there is not None and not overwrite:
            raise OutputError(f"'{there}' exists already: choose another folder or overwrite")
        folder.mkdir(parents=True, exist_ok=True)
    for name, path in zip(chosen, paths, strict=True):
        with replacing(path, "w", newline="", encoding="utf-8") as file:
            _write(csv.writer(file), TABLES[name](run, _frames(run, frame)))
    return paths


def _frames(run: Result, frame: int | None) -> Iterator[tuple[int, Frame]]:
    """Give the chosen frames with their numbers, one at a time."""
    count = len(run.frames)
    chosen: Iterable[int] = range(count) if frame is None else [frame % count]
    for k in chosen:
        yield k, run.frames[k]


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


def _cells(run: Result, frames: Iterator[tuple[int, Frame]]) -> Iterator[Table]:
    """Give the cells of each frame."""
    kinds = _kinds(run)
    phases = run.scene.growth is not None and run.scene.growth.phases
    for number, frame in frames:
        n = len(frame.cells)
        table: dict[str, NDArray[Any]] = {
            "frame": np.full(n, number),
            titled("time", unit_of("cells.time")): np.full(n, frame.time),
        }
        for name in Cells.schema():
            if name in _OF_PHASES and not phases:
                continue
            column, unit = getattr(frame.cells, name), unit_of(f"cells.{name}")
            if name == "kind":
                column = kinds[column]
            elif name in _NAMED:
                column = np.array(_NAMED[name], dtype=object)[column]
            if column.ndim == 1:
                table[titled(name, unit)] = column
            else:
                for axis, values in zip(_axes(column.shape[1]), column.T, strict=True):
                    table[titled(f"{name}_{axis}", unit)] = values
        for name, values in frame.concentrations.items():
            unit = unit_of(f"cells.concentration_{name}")
            table[titled(f"concentration_{name}", unit)] = values
        yield table


def _contacts(run: Result, frames: Iterator[tuple[int, Frame]]) -> Iterator[Table]:
    """Give the pairs in contact of each frame by their identities."""
    for number, frame in frames:
        cells = frame.cells
        pairs = contact_rows(cells, frame.contacts)
        if len(pairs) == 0:
            pairs = _overlapping(cells)
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


def _overlapping(cells: Cells) -> NDArray[np.int64]:
    """Return the rows of all pairs of cells whose spheres overlap: (m, 2)."""
    from scipy.spatial import cKDTree

    tree = cKDTree(cells.position)
    near = tree.query_pairs(2.0 * cells.radius.max(initial=0.0), output_type="ndarray")
    first, second = near.T
    apart = np.linalg.norm(cells.position[first] - cells.position[second], axis=1)
    near = near[apart < cells.radius[first] + cells.radius[second]].astype(np.int64)
    return np.asarray(near[np.lexsort((near[:, 1], near[:, 0]))])


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


def _axes(width: int) -> Sequence[str]:
    return _AXES if width == len(_AXES) else [str(k) for k in range(width)]


def titled(name: str, unit: str) -> str:
    """Return the title of a column: its name, and its unit where it has one."""
    return f"{name}_{unit.translate(_POWERS)}" if unit else name
