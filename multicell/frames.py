"""Reading result files, also those of runs that go on or were killed."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, final, overload

import h5py
import numpy as np
from numpy.typing import NDArray

from multicell.cells import Cells
from multicell.errors import OutputError
from multicell.frame import Field, Frame, Progress
from multicell.lineage import COLUMNS, Lineage

FORMAT: Final = 2
"""Number of the layout that :mod:`multicell.store` describes."""

# the first format with SWMR; later ones would shut out older readers
LIBVER: Final = ("v110", "v110")


@contextmanager
def _reading(path: Path) -> Iterator[h5py.File]:
    """Open a result file, finished or not, and check that this version can read it."""
    if not path.is_file():
        raise OutputError(f"there are no results in '{path.parent}': {path.name} is missing")
    try:
        file = h5py.File(path, "r", swmr=True, libver=LIBVER, locking="best-effort")
    except OSError as error:
        raise OutputError(f"cannot read '{path}': {error}") from error
    with file:
        written = int(file.attrs.get("format", 0))
        if written != FORMAT:
            raise OutputError(
                f"'{path}' has result format {written}; this multicell reads format {FORMAT}"
            )
        yield file


@final
class Frames(Sequence[Frame]):
    """The frames of a result file, each read when it is asked for.

    Supports ``len``, integer indices (negative ones too), slices (lists of frames) and
    iteration. The frames are those that were on disk when the object was made.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        with _reading(path) as file:
            index = file["frames"]
            count = min(len(index["offset"]) - 1, len(index["step"]), len(index["time"]))
            self._offset = index["offset"][: count + 1]
            self._step = index["step"][:count]
            self._time = index["time"][:count]

    @property
    def times(self) -> NDArray[np.float64]:
        """Simulated time of every frame: (k,), s."""
        return np.asarray(self._time, dtype=np.float64)

    def __len__(self) -> int:
        return len(self._time)

    @overload
    def __getitem__(self, index: int) -> Frame: ...
    @overload
    def __getitem__(self, index: slice) -> list[Frame]: ...
    def __getitem__(self, index: int | slice) -> Frame | list[Frame]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        place = index + len(self) if index < 0 else index
        if not 0 <= place < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        with _reading(self._path) as file:
            return self._read(file, place)

    def _read(self, file: h5py.File, place: int) -> Frame:
        """Read frame ``place`` from the open file."""
        rows = slice(int(self._offset[place]), int(self._offset[place + 1]))
        names = list(file["fields"]) if "fields" in file else []
        fields = {name: _read_field(file["fields"][name], name, place) for name in names}
        first, last = file["contacts"]["offset"][place : place + 2]
        return Frame(
            time=float(self._time[place]),
            step=int(self._step[place]),
            cells=Cells(**{name: file["cells"][name][rows] for name in Cells.schema()}),
            concentrations={name: file["cells"][f"concentration_{name}"][rows] for name in names},
            fields={name: field for name, field in fields.items() if field is not None},
            contacts=file["contacts"]["pair"][first:last],
            progress=_read_progress(file["progress"], place),
        )


def _read_progress(group: Any, place: int) -> Progress | None:
    """Read what a run needs to go on, or nothing where the frame has none."""
    start, stop = group["offset"][place : place + 2]
    return None if start == stop else Progress(**json.loads(bytes(group["text"][start:stop])))


def open_lineage(folder: str | Path, frame: int = -1) -> Lineage:
    """Return the lineage of a run up to a frame.

    Raises
    ------
    OutputError
        If the folder holds no results that this version can read.
    IndexError
        If there is no such frame.
    """
    with _reading(Path(folder) / "frames.h5") as file:
        count = len(file["frames"]["time"])
        place = frame + count if frame < 0 else frame
        if not 0 <= place < count:
            raise IndexError(f"frame {frame} of {count}")
        logs = {}
        for log, columns in COLUMNS.items():
            group = file["lineage"][log]
            end = int(group["offset"][place + 1])
            logs[log] = {name: group[name][:end] for name in columns}
    return Lineage.of(logs)


def _read_field(group: Any, name: str, place: int) -> Field | None:
    """Read one field, or nothing where the frame has none."""
    start, stop = group["offset"][place : place + 2]
    if start == stop:
        return None
    return Field(
        name=name,
        unit=str(group["values"].attrs["unit"]),
        origin=group["origin"][place],
        spacing=float(group["spacing"][place]),
        values=group["values"][start:stop].reshape(group["shape"][place]),
        kind="radial" if group["radial"][place] else "box",
        height=float(group["height"][place]),
    )


def open_frames(folder: str | Path) -> Frames:
    """Return the frames of a result folder, also of a run that goes on or was killed.

    Raises
    ------
    OutputError
        If the folder holds no results that this version can read.
    """
    return Frames(Path(folder) / "frames.h5")


def open_history(folder: str | Path) -> dict[str, NDArray[np.float64]]:
    """Return the history of a run: column name -> (m,) float64, one entry per coupling step.

    Raises
    ------
    OutputError
        If the folder holds no results that this version can read.
    """
    with _reading(Path(folder) / "frames.h5") as file:
        group = file.get("history", {})
        rows = min((len(column) for column in group.values()), default=0)
        return {name: column[:rows] for name, column in group.items()}
