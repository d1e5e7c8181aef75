"""The data sets of ``frames.h5``: type, shape, unit and rows of each; frames as such, and back.

Each array of a frame is a data set of its own, under the path that it has in a journal. Only the
fields are coded (:mod:`multicell.results.coding`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final, NamedTuple, Protocol, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import Cells, FloatArray
from multicell.results.coding import decode, encode
from multicell.results.lineage import COLUMNS
from multicell.results.records import FIELD, SPARSE, UNIT, Arrays, without_zeros

FORMAT: Final = 5  # number of the layout that :mod:`multicell.results.writer` describes
_LONG: Final = 8192  # rows in a chunk of what grows with cells and nodes: 64 kB for a number each
_MIDDLE: Final = 4096  # ... of logs and texts
_SHORT: Final = 256  # ... of what has one row for each frame


@final
class Kind(NamedTuple):
    """The kind of a data set: one row for each frame, or ``pool`` rows in all.

    The pools ``frames`` and ``ends`` have one row for each frame and one more; any other is the
    path of the data set of offsets whose last entry is its length.
    """

    dtype: Any
    width: int | None
    pool: str
    unit: str = ""
    chunk: int = _SHORT


def layout(nutrients: Iterable[str]) -> dict[str, Kind]:
    """Return all data sets but those of the history, by path; checksums go by their order."""
    sets = {
        "frames/offset": Kind("<i8", None, "ends"),
        "frames/time": Kind("<f8", None, "frames", "s"),
        "frames/step": Kind("<i8", None, "frames"),
        "frames/digest": Kind("<u4", None, "frames"),
        "contacts/offset": Kind("<i8", None, "ends"),
        "contacts/pair": Kind("<i8", 2, "contacts/offset", chunk=_MIDDLE),
        "progress/offset": Kind("<i8", None, "ends"),
        "progress/text": Kind("|u1", None, "progress/offset", chunk=_MIDDLE),
        **{
            f"cells/{name}": Kind(
                np.dtype(spec["dtype"]).str, spec["width"], "frames/offset", spec["unit"], _LONG
            )
            for name, spec in Cells.schema().items()
        },
    }
    for log, columns in COLUMNS.items():
        offset = f"lineage/{log}/offset"
        sets[offset] = Kind("<i8", None, "ends")
        for name, dtype in columns.items():
            unit = "s" if name == "time" else ""
            kind = Kind(np.dtype(dtype).str, None, offset, unit, _MIDDLE)
            sets[f"lineage/{log}/{name}"] = kind
    for name in nutrients:
        group = f"fields/{name}"
        sets |= {
            f"{group}/offset": Kind("<i8", None, "ends"),
            f"{group}/coded": Kind("<u8", None, f"{group}/offset", chunk=_LONG),
            f"{group}/shape": Kind("<i8", 3, "frames"),
            f"{group}/faces": Kind("<f8", 6, "frames", UNIT),
        }
        for key, entry in FIELD.items():
            sets[f"{group}/{key}"] = Kind(entry.dtype, entry.width or None, "frames", entry.unit)
        sets[f"cells/concentration_{name}"] = Kind("<f8", None, "frames/offset", UNIT, _LONG)
    return sets


def of_rows(dtype: str, unit: str = "") -> Kind:
    """Return the kind of a data set of its own length: the scene, the history."""
    return Kind(dtype, None, "", unit, _MIDDLE)


Ends = Mapping[str, NDArray[np.int64]]  # path of a data set of offsets -> its values, (k + 1,)


class Source(Protocol):
    """A file that is open."""

    def __getitem__(self, path: str) -> Any:
        """Return a data set."""

    def __contains__(self, path: Any) -> bool:
        """Return whether there is a data set."""


def frame_rows(arrays: Mapping[str, NDArray[Any]], nutrients: Iterable[str]) -> Arrays:
    """Return the rows of a frame by data set; of those with one row a frame, that row."""
    found = {path: array for path, array in arrays.items() if not path.startswith("fields/")}
    found["frames/time"], found["frames/step"] = found.pop("time"), found.pop("step")
    for name in nutrients:
        found |= _field_rows(name, arrays)
    return found


def _field_rows(name: str, arrays: Mapping[str, NDArray[Any]]) -> Arrays:
    """Return the rows of a field, also of one that is not there."""
    group = f"fields/{name}"
    values: FloatArray = arrays.get(f"{group}/values", np.empty((0, 0, 0)))
    coded, faces = encode(values)
    found: Arrays = {
        f"{group}/coded": coded.reshape(-1),
        f"{group}/shape": np.array(values.shape),
        f"{group}/faces": faces,
    }
    for key, entry in FIELD.items():
        absent = np.full((entry.width,) if entry.width else (), entry.absent)
        found[f"{group}/{key}"] = arrays.get(f"{group}/{key}", absent)
    return found


def read_frame(file: Source, place: int, nutrients: Iterable[str], ends: Ends) -> Arrays:
    """Return the arrays of a frame, in the order in which a journal has them."""
    names = list(nutrients)
    columns = [*Cells.schema(), *(f"concentration_{name}" for name in names)]
    cells = {
        f"cells/{name}": rows_of(file, f"cells/{name}", ends["frames/offset"], place)
        for name in columns
        if f"cells/{name}" not in SPARSE or f"cells/{name}" in file
    }
    return frame_arrays(file, place, names, ends, without_zeros(cells))


def frame_arrays(
    file: Source, place: int, nutrients: Iterable[str], ends: Ends, cells: Arrays
) -> Arrays:
    """Return the arrays of a frame whose columns of cells are known."""
    arrays = {"time": np.array(file["frames/time"][place])}
    arrays["step"] = np.array(file["frames/step"][place])
    arrays |= cells
    for name in nutrients:
        arrays |= read_field(file, name, place, ends)
    for path in ("contacts/pair", "progress/text"):
        arrays[path] = rows_of(file, path, ends[f"{path.split('/')[0]}/offset"], place)
    return arrays


def read_field(file: Source, name: str, place: int, ends: Ends) -> Arrays:
    """Return the arrays of a field in a frame, none where there is no field."""
    group = f"fields/{name}"
    coded = rows_of(file, f"{group}/coded", ends[f"{group}/offset"], place)
    if not len(coded):
        return {}
    values = decode(coded.reshape(file[f"{group}/shape"][place]), file[f"{group}/faces"][place])
    rest = {f"{group}/{key}": np.array(file[f"{group}/{key}"][place]) for key in FIELD}
    return {f"{group}/values": values, **rest}


def rows_of(file: Source, path: str, ends: NDArray[np.int64], place: int) -> NDArray[Any]:
    """Return the rows of a data set that belong to a frame."""
    first, last = ends[place : place + 2]
    return np.asarray(file[path][int(first) : int(last)])
