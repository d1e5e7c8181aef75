"""The data sets of ``frames.h5``: type, shape, unit and rows of each; frames as such, and back.

Each array of a frame is a column, under the path that it has in a journal. What grows with cells,
contacts and nodes is a data set of its own; other columns of as many rows share a table
(:func:`column_places`), since HDF5 takes as long to create or open a small data set as to write or
read ten thousand numbers. Only the fields are coded (:mod:`multicell.results.coding`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cache, lru_cache
from types import MappingProxyType
from typing import Any, Final, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import ANY_WIDTH, Cells, FloatArray, Phase, State
from multicell.errors import OutputError
from multicell.results.coding import decode, encode
from multicell.results.lineage import LINEAGE_COLUMNS
from multicell.results.records import FIELD_ARRAYS, SPARSE, UNIT, Arrays, without_zeros

FRAMES_FORMAT: Final = 6  # number of the layout that :mod:`multicell.results.writer` describes
FORMAT_WITHOUT_TABLES: Final = 5  # in which every column is a data set; it is read, too
_LONG: Final = 8192  # rows in a chunk of what grows with cells and nodes: 64 kB for a number each
_MIDDLE: Final = 4096  # ... of logs and texts
_SHORT: Final = 256  # ... of what has one row for each frame
_TABLE: Final = 30_000  # bytes of a table's type; HDF5 has room for 64 kB
_FIELD: Final = 40  # ... of a field at most, beside its name


@final
class DatasetKind(NamedTuple):
    """The kind of a data set: one row for each frame, or ``pool`` rows in all.

    The pools ``frames`` and ``ends`` have one row for each frame and one more; any other is the
    path of the column of offsets whose last entry is its length. A table has several units.
    """

    dtype: Any
    width: int | None
    pool: str
    unit: str | tuple[str, ...] = ""
    chunk: int = _SHORT

    def shape(self, array: Any) -> tuple[int, ...]:
        """Return the shape of a row of an array of this kind; a width may be left open."""
        if self.width == ANY_WIDTH:
            return tuple(array.shape[1:2])
        return () if self.width is None else (self.width,)


def layout(nutrients: Iterable[str]) -> Mapping[str, DatasetKind]:
    """Return all data sets but those of the history, by path; checksums go by their order."""
    return _layout(tuple(nutrients))


@cache
def _layout(nutrients: tuple[str, ...]) -> Mapping[str, DatasetKind]:
    sets = {
        "frames/offset": DatasetKind("<i8", None, "ends"),
        "frames/time": DatasetKind("<f8", None, "frames", "s"),
        "frames/step": DatasetKind("<i8", None, "frames"),
        "frames/digest": DatasetKind("<u4", None, "frames"),
        "contacts/offset": DatasetKind("<i8", None, "ends"),
        "contacts/pair": DatasetKind("<i8", 2, "contacts/offset", chunk=_MIDDLE),
        "progress/offset": DatasetKind("<i8", None, "ends"),
        "progress/text": DatasetKind("|u1", None, "progress/offset", chunk=_MIDDLE),
        **{
            f"cells/{name}": DatasetKind(
                np.dtype(spec["dtype"]).str, spec["width"], "frames/offset", spec["unit"], _LONG
            )
            for name, spec in Cells.schema().items()
        },
    }
    for log, columns in LINEAGE_COLUMNS.items():
        offset = f"lineage/{log}/offset"
        sets[offset] = DatasetKind("<i8", None, "ends")
        for name, dtype in columns.items():
            unit = "s" if name == "time" else ""
            kind = DatasetKind(np.dtype(dtype).str, None, offset, unit, _MIDDLE)
            sets[f"lineage/{log}/{name}"] = kind
    for name in nutrients:
        group = f"fields/{name}"
        sets |= {
            f"{group}/offset": DatasetKind("<i8", None, "ends"),
            f"{group}/coded": DatasetKind("<u8", None, f"{group}/offset", chunk=_LONG),
            f"{group}/shape": DatasetKind("<i8", 3, "frames"),
            f"{group}/faces": DatasetKind("<f8", 6, "frames", UNIT),
        }
        for key, entry in FIELD_ARRAYS.items():
            sets[f"{group}/{key}"] = DatasetKind(
                entry.dtype, entry.width or None, "frames", entry.unit
            )
        sets[f"cells/concentration_{name}"] = DatasetKind("<f8", None, "frames/offset", UNIT, _LONG)
    return MappingProxyType(sets)


def of_rows(dtype: str, unit: str = "") -> DatasetKind:
    """Return the kind of a data set of its own length: the scene, the history."""
    return DatasetKind(dtype, None, "", unit, _MIDDLE)


def fits_table(names: Iterable[str]) -> bool:
    """Return whether a table can have these fields: some, and no more than HDF5 has room for."""
    return 0 < sum(len(name.encode()) + _FIELD for name in names) <= _TABLE


Places = Mapping[str, tuple[str, str]]  # path of a column -> path of its table, field there


def column_places(paths: Iterable[str], *, history: bool = True) -> Places:
    """Return where the columns are that share a table, by path.

    - ``history``: whether the history is a table; it is a group of columns where
      :func:`fits_table` says no
    """
    return _column_places(tuple(paths), history)


@lru_cache(maxsize=64)
def _column_places(paths: tuple[str, ...], history: bool) -> Places:
    places: dict[str, tuple[str, str]] = {}
    few = fits_table(path for path in paths if path.endswith("/offset"))  # not by the hundred
    for path in paths:
        group, _, name = path.rpartition("/")
        if group == "history":  # an observable can have any name
            places |= {path: (group, name)} if history else {}
        elif name == "offset" and (few or not group.startswith("fields/")):
            places[path] = "offsets", group
        elif group == "frames" or group.startswith("lineage/"):
            places[path] = group, name
    return MappingProxyType(places)


def stored_sets(sets: Mapping[str, DatasetKind], places: Places) -> dict[str, DatasetKind]:
    """Return the kinds of data sets that hold columns of some kinds, by path."""
    return dict(_stored_sets(tuple(sets.items()), tuple(places.items())))


@lru_cache(maxsize=64)
def _stored_sets(
    sets: tuple[tuple[str, DatasetKind], ...], places: tuple[tuple[str, tuple[str, str]], ...]
) -> Mapping[str, DatasetKind]:
    found: dict[str, DatasetKind] = {}
    tables: dict[str, list[tuple[str, DatasetKind]]] = {}
    shared = dict(places)
    for path, kind in sets:
        if path in shared:
            table, field = shared[path]
            tables.setdefault(table, []).append((field, kind))
        else:
            found[path] = kind
    for table, fields in tables.items():
        kind, units = fields[0][1], tuple(str(k.unit) for _, k in fields)
        dtype = np.dtype([(field, k.dtype) for field, k in fields])
        found[table] = kind._replace(dtype=dtype, unit=units)
    return found


Ends = Mapping[str, NDArray[np.int64]]  # path of a data set of offsets -> its values, (k + 1,)


def frame_rows(arrays: Mapping[str, NDArray[Any]], nutrients: Iterable[str]) -> Arrays:
    """Return the rows of a frame by data set; of those with one row a frame, that row."""
    found = {path: array for path, array in arrays.items() if not path.startswith("fields/")}
    found["frames/time"], found["frames/step"] = found.pop("time"), found.pop("step")
    for name in nutrients:
        found |= _field_rows(name, arrays)
    return found


def _field_rows(name: str, arrays: Mapping[str, NDArray[Any]]) -> Arrays:
    group = f"fields/{name}"
    values: FloatArray = arrays.get(f"{group}/values", np.empty((0, 0, 0)))
    coded, faces = encode(values)
    found: Arrays = {
        f"{group}/coded": coded.reshape(-1),
        f"{group}/shape": np.array(values.shape),
        f"{group}/faces": faces,
    }
    for key, entry in FIELD_ARRAYS.items():
        absent = np.full((entry.width,) if entry.width else (), entry.absent)
        found[f"{group}/{key}"] = arrays.get(f"{group}/{key}", absent)
    return found


def check_frame(arrays: Mapping[str, NDArray[Any]], nutrients: Iterable[str], types: int) -> None:
    """Refuse other arrays than a frame of a scene with so many types has; raises OutputError."""
    sets = layout(nutrients)
    sets = {**sets, "time": sets["frames/time"], "step": sets["frames/step"]}
    count = arrays["cells/id"].shape if "cells/id" in arrays else ()
    for path, array in arrays.items():
        kind = sets.get(
            path, DatasetKind("<f8", None, "values" if path.endswith("/values") else "")
        )
        axes = {"frames": 0, "values": 3}.get(kind.pool, 1)
        rows = count if path.startswith("cells/") else array.shape[:axes]
        width = kind.shape(array)
        right = kind.pool and len(rows) == axes and array.shape == (*rows, *width)
        if not right or array.dtype.str != kind.dtype:
            problem = f"{path} has the type {array.dtype.str} and shape {array.shape}"
            raise OutputError(problem, damaged=True)
    known = {"id": 1 << 62, "state": len(State), "phase": len(Phase), "kind": types}
    for name, many in known.items():
        check_numbers(f"cells/{name}", arrays.get(f"cells/{name}", np.zeros(0)), many)


def check_numbers(path: str, numbers: NDArray[Any], count: int) -> None:
    """Refuse numbers that are not 0 to ``count`` - 1; raises OutputError."""
    if numbers.size and not 0 <= numbers.min() <= numbers.max() < count:
        raise OutputError(f"{path} has numbers that stand for nothing", damaged=True)


def read_frame(file: Any, place: int, nutrients: Iterable[str], ends: Ends) -> Arrays:
    """Return the arrays of a frame of an open file, in the order in which a journal has them."""

    def rows(path: str, offset: str) -> NDArray[Any]:
        first, last = ends[offset][place : place + 2]
        return np.asarray(file[path][int(first) : int(last)])

    def row(path: str) -> NDArray[Any]:
        return np.array(file[path][place])

    names = list(nutrients)
    columns = [*Cells.schema(), *(f"concentration_{name}" for name in names)]
    paths = [f"cells/{name}" for name in columns]
    cells = {x: rows(x, "frames/offset") for x in paths if x not in SPARSE or x in file}
    arrays = {"time": row("frames/time"), "step": row("frames/step"), **without_zeros(cells)}
    for group in (f"fields/{name}" for name in names):
        coded = rows(f"{group}/coded", f"{group}/offset")
        if len(coded):
            coded = coded.reshape(row(f"{group}/shape"))
            arrays[f"{group}/values"] = decode(coded, row(f"{group}/faces"))
            arrays |= {f"{group}/{key}": row(f"{group}/{key}") for key in FIELD_ARRAYS}
    arrays["contacts/pair"] = rows("contacts/pair", "contacts/offset")
    arrays["progress/text"] = rows("progress/text", "progress/offset")
    return arrays
