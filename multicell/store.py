"""Result files: ``frames.h5`` that grows while a run goes on, and the files beside it.

Layout of ``frames.h5`` for k frames and m history rows::

    /cells/<column>                  all frames one after another, with a ``unit``
    /cells/concentration_<nutrient>  likewise, mM
    /frames/offset (k + 1)           frame j owns the rows offset[j] ... offset[j + 1] - 1
    /frames/time, /frames/step (k)
    /fields/<nutrient>/values        grids one after another in C order, with their offset
    /fields/<nutrient>/offset (k + 1), shape (k, 3), origin (k, 3), spacing, height, radial (k)
    /contacts/pair (., 2)            identities of pairs in contact, where the law remembers them
    /contacts/offset (k + 1)
    /progress/text, /progress/offset (k + 1)   JSON: what else a run needs to be resumed
    /lineage/<log>/<column>          logs of births, deaths and ends up to the last frame
    /lineage/<log>/offset (k + 1)
    /history/<column> (m)

The file is written in HDF5's single-writer multiple-reader mode: it can be opened while the run
goes on, and a run that is killed at any moment leaves all frames that it had finished, and the
history up to about a second before.
"""

from __future__ import annotations

import json
import time as clock
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self, final

import h5py
import numpy as np

from multicell.cells import Cells
from multicell.folder import FILES, package_version, prepare_folder, versions, words, write_text
from multicell.folder import write_summary as write_summary  # part of the public store
from multicell.frame import Frame
from multicell.frames import FORMAT, LIBVER
from multicell.frames import open_frames as open_frames  # part of the public store
from multicell.frames import open_history as open_history
from multicell.frames import open_lineage as open_lineage
from multicell.lineage import COLUMNS, Lineage
from multicell.quantities import unit_of

if TYPE_CHECKING:
    from multicell.scene import Scene

_ROWS: Final = 4096  # rows in a chunk of the long arrays: 32 kB
_SHORT: Final = 256  # rows in a chunk of the arrays with one entry per frame or step


def _column(group: Any, name: str, dtype: Any, *, width: int | None = None, unit: str = "") -> None:
    """Create an empty array in ``group`` that grows along its first axis."""
    tail = () if width is None else (width,)
    rows = _ROWS if group.name.startswith(("/cells", "/fields")) else _SHORT
    column = group.create_dataset(
        name, (0, *tail), dtype, maxshape=(None, *tail), chunks=(rows, *tail)
    )
    column.attrs["unit"] = unit


def _put(column: Any, start: int, values: Any) -> None:
    """Make ``values`` the rows from ``start`` on, and the last ones."""
    rows = np.asarray(values)
    column.resize(start + len(rows), axis=0)
    if len(rows):
        column[start:] = rows


@final
class Store:
    """The writer of a result folder; it is the only owner of the open file.

    Use :meth:`create`; as a context manager it closes itself. All methods raise
    :class:`~multicell.errors.OutputError` when the system refuses to write (disk full).
    A call that does not come to its end (Ctrl-C) leaves no trace: the next one writes over it.
    """

    def __init__(self, folder: Path, file: h5py.File, nutrients: Sequence[str], path: Path) -> None:
        self.folder = folder
        self._path = path
        self._file = file
        self._nutrients = tuple(nutrients)
        self._history: tuple[str, ...] = ()
        self._flushed = clock.monotonic()
        # what is complete: the only truth about where the next rows go
        self._frames = self._history_rows = self._rows = self._pairs = self._letters = 0
        self._logged = dict.fromkeys(COLUMNS, 0)
        self._points = dict.fromkeys(nutrients, 0)

    @classmethod
    def create(
        cls, folder: str | Path, scene: Scene, overwrite: bool = False, *, part: bool = False
    ) -> Self:
        """Prepare the folder, write ``scene.toml`` and open an empty ``frames.h5``.

        Parameters
        ----------
        folder
            Output folder (:func:`prepare_folder`).
        scene
            The scene of the run; it says which nutrients the frames have.
        overwrite
            Remove the files of an earlier run first.
        part
            Leave the folder as it is and write to ``frames.h5.part``, until :meth:`settle`.

        Raises
        ------
        OutputError
            If the folder cannot be used.
        """
        if part:
            folder = Path(folder)
        else:
            folder = prepare_folder(folder, overwrite=overwrite)
            write_text(folder / "scene.toml", scene.to_toml(versions()))
        path = folder / ("frames.h5.part" if part else "frames.h5")
        with words("write", path):
            file = h5py.File(path, "w", libver=LIBVER, locking="best-effort")
            store = cls(folder, file, list(scene.nutrients), path)
            store._lay_out()
            file.swmr_mode = True
        return store

    def _lay_out(self) -> None:
        """Create all arrays but the history, whose columns are known with its first row."""
        self._file.attrs.update(format=FORMAT, multicell=package_version())
        cells = self._file.create_group("cells")
        for name, spec in Cells.schema().items():
            _column(cells, name, spec["dtype"], width=spec["width"], unit=spec["unit"])
        frames = self._file.create_group("frames")
        _column(frames, "offset", np.int64)
        _column(frames, "time", np.float64, unit="s")
        _column(frames, "step", np.int64)
        _put(frames["offset"], 0, [0])
        contacts = self._file.create_group("contacts")
        _column(contacts, "pair", np.int64, width=2)
        _column(contacts, "offset", np.int64)
        _put(contacts["offset"], 0, [0])
        progress = self._file.create_group("progress")
        _column(progress, "text", np.uint8)
        _column(progress, "offset", np.int64)
        _put(progress["offset"], 0, [0])
        for log, columns in COLUMNS.items():
            group = self._file.create_group(f"lineage/{log}")
            for name, dtype in columns.items():
                _column(group, name, dtype, unit="s" if name == "time" else "")
            _column(group, "offset", np.int64)
            _put(group["offset"], 0, [0])
        for name in self._nutrients:
            _column(cells, f"concentration_{name}", np.float64, unit="mM")
            group = self._file.create_group(f"fields/{name}")
            _column(group, "values", np.float64, unit="mM")
            _column(group, "offset", np.int64)
            _column(group, "shape", np.int64, width=3)
            _column(group, "origin", np.float64, width=3, unit="um")
            _column(group, "spacing", np.float64, unit="um")
            _column(group, "height", np.float64, unit="um")
            _column(group, "radial", np.int8)
            _put(group["offset"], 0, [0])

    def append(self, frame: Frame, lineage: Lineage | None = None) -> None:
        """Write a frame to disk.

        Parameters
        ----------
        frame
        lineage
            Of the run up to the frame; what is not on disk yet is written.

        Raises
        ------
        ValueError
            If the frame's nutrients are not those of the scene, or the number of
            concentrations is not the number of cells.
        """
        if set(frame.concentrations) != set(self._nutrients):
            raise ValueError(
                f"frame has concentrations of {sorted(frame.concentrations)}, "
                f"the scene has {sorted(self._nutrients)}"
            )
        for name, values in frame.concentrations.items():
            if len(values) != len(frame.cells):
                raise ValueError(f"{len(values)} values of {name} for {len(frame.cells)} cells")
        with words("write", self._path):
            cells, rows = self._file["cells"], self._rows + len(frame.cells)
            for name, column in frame.cells.columns():
                _put(cells[name], self._rows, column)
            for name in self._nutrients:
                _put(cells[f"concentration_{name}"], self._rows, frame.concentrations[name])
            pairs = self._pairs + len(frame.contacts)
            _put(self._file["contacts"]["pair"], self._pairs, frame.contacts)
            _put(self._file["contacts"]["offset"], self._frames + 1, [pairs])
            points = {name: self._put_field(name, frame) for name in self._nutrients}
            letters = self._put_progress(frame)
            logged = self._put_lineage(lineage)
            # the rows must be on disk before the index that makes them a frame
            self._file.flush()
            index = self._file["frames"]
            _put(index["offset"], self._frames + 1, [rows])
            _put(index["step"], self._frames, [frame.step])
            _put(index["time"], self._frames, [frame.time])
            self._file.flush()
            self._frames, self._rows, self._points = self._frames + 1, rows, points
            self._pairs, self._letters, self._logged = pairs, letters, logged

    def _put_progress(self, frame: Frame) -> int:
        """Write what a run needs to go on, or nothing; return where it ends."""
        text = b"" if frame.progress is None else json.dumps(asdict(frame.progress)).encode()
        group, end = self._file["progress"], self._letters + len(text)
        _put(group["text"], self._letters, np.frombuffer(text, dtype=np.uint8))
        _put(group["offset"], self._frames + 1, [end])
        return end

    def _put_lineage(self, lineage: Lineage | None) -> dict[str, int]:
        """Write the new rows of the logs; return how long they are."""
        counts = dict(self._logged)
        for log, begin in self._logged.items():
            group = self._file["lineage"][log]
            if lineage is not None:
                for name, values in lineage.rows(log, begin).items():
                    _put(group[name], begin, values)
                counts[log] = lineage.counts()[log]
            _put(group["offset"], self._frames + 1, [counts[log]])
        return counts

    def _put_field(self, name: str, frame: Frame) -> int:
        """Write a field, an absent one as a grid of no points; return where it ends."""
        group, field = self._file["fields"][name], frame.fields.get(name)
        values = np.empty((0, 0, 0)) if field is None else field.values
        end = self._points[name] + values.size
        _put(group["values"], self._points[name], values.ravel())
        _put(group["offset"], self._frames + 1, [end])
        _put(group["shape"], self._frames, [values.shape])
        _put(group["origin"], self._frames, [np.full(3, np.nan) if field is None else field.origin])
        _put(group["spacing"], self._frames, [np.nan if field is None else field.spacing])
        _put(group["height"], self._frames, [np.nan if field is None else field.height])
        _put(group["radial"], self._frames, [field is not None and field.kind == "radial"])
        return end

    def append_history(self, row: Mapping[str, float]) -> None:
        """Write one row of the history; the first row says which columns there are.

        Raises
        ------
        ValueError
            If a later row has other columns.
        """
        with words("write", self._path):
            if not self._history:
                self._lay_out_history(tuple(row))
            if set(row) != set(self._history):
                changed = sorted(set(row) ^ set(self._history))
                raise ValueError(f"history columns differ from those of the first row: {changed}")
            group = self._file["history"]
            for name in self._history:
                _put(group[name], self._history_rows, [float(row[name])])
            self._history_rows += 1
            # a flush costs more than a small coupling step: a killed run loses one second
            if clock.monotonic() - self._flushed > 1.0:
                self._file.flush()
                self._flushed = clock.monotonic()

    def _lay_out_history(self, names: tuple[str, ...]) -> None:
        """Create the history's arrays: HDF5 allows that only outside its SWMR mode."""
        self._file.close()
        self._file = h5py.File(self._path, "r+", libver=LIBVER, locking="best-effort")
        group = self._file.require_group("history")
        for name in [name for name in names if name not in group]:
            _column(group, name, np.float64, unit=unit_of(name))
        self._file.swmr_mode = True
        self._history = names

    def settle(self, scene: Scene) -> None:
        """Let a file made as a part take the place of ``frames.h5``, and go on there.

        Files that describe the end of the earlier run are removed.
        """
        whole = self.folder / "frames.h5"
        with words("write", whole):
            self._file.flush()
            self._file.close()
            self._path.replace(whole)
            self._path = whole
            self._file = h5py.File(whole, "r+", libver=LIBVER, locking="best-effort")
            self._file.swmr_mode = True
        write_text(self.folder / "scene.toml", scene.to_toml(versions()))
        for name in FILES:
            if name not in ("scene.toml", "frames.h5"):
                with words("remove", self.folder / name):
                    (self.folder / name).unlink(missing_ok=True)

    def flush(self) -> None:
        """Hand everything to the operating system; appending a frame does so by itself."""
        with words("write", self._path):
            self._file.flush()

    def close(self) -> None:
        """Close the file; closing twice does no harm."""
        with words("write", self._path):
            self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
