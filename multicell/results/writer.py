"""Result files: a journal during a run, ``frames.h5`` when it has ended.

During a run each frame is appended to ``frames.journal`` (:mod:`multicell.results.journal`),
with what the history and the lineage have gained. A run that is killed at any moment, or meets a
full disk, leaves all frames that it had finished, and the history up to about a second before. A
loss of power may take what the last second added to the frames, and the last two to the history:
the journal is on the disk itself whenever :meth:`Store.append` returns later than that. At its end,
also an early one, all becomes one file ``frames.h5`` in HDF5, written beside its place and moved
there. If there is no room for it the journal stays, and is read, resumed and exported all the same.
A run that is resumed leaves ``frames.h5`` as it is and begins a journal that says from which frame
on it counts.

Layout of ``frames.h5`` for k frames and m history rows; a table is a data set with fields::

    /cells/<column>                  all columns of cells, all frames one after another, with a
                                     ``unit``; concentration_<nutrient> in mM; doomed and
                                     damage only where a cell of any frame has some
    /frames (k)                      table: time, step, digest (CRC-32 of all that a frame holds)
    /offsets (k + 1)                 table: frame j owns the rows of cells from field ``frames`` of
                                     row j up to that of row j + 1; of what follows likewise, by
                                     fields ``contacts``, ``progress``, ``lineage/<log>`` and
                                     ``fields/<nutrient>``; with some 500 fields and more that
                                     is a data set ``offset`` in the group of each
    /fields/<nutrient>/coded         grids one after another in C order, as differences from the
                                     prediction of a stencil (:mod:`multicell.results.coding`)
    /fields/<nutrient>/faces (k, 6)  what holds at the faces, for the same stencil
    /fields/<nutrient>/shape (k, 3), origin (k, 3), spacing, height, radial (k)
    /contacts/pair (., 2)            identities of pairs in contact, where the law remembers them
    /progress/text                   JSON: what else a run needs to be resumed
    /lineage/<log>                   tables: births, deaths and ends up to the last frame
    /history (m)                     table: a field for each observable; a group with a data set for
                                     each where there are none, or too many for a table (some 600)
    /scene                           bytes of ``scene.toml``

The ``unit`` of a table is a list, one for each field. Format 5, which is read too, has a group in
place of each table and a data set for each field; that of offsets is ``offset`` in its group.

Large data sets are compressed by filters that every HDF5 has (shuffle, gzip), small ones are part
of their headers. A frame is compared with its checksum whenever it is read.

It is an ordinary file without links to others: h5py, pandas and xarray open it, and a copy of it is
complete. The attributes ``identity`` and ``absorbed`` distinguish it from its journals, ``digest``
(of the file and of its history) are the checksums of what belongs to no single frame.
"""

from __future__ import annotations

import time as clock
import uuid
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, Final, Self, final

import numpy as np

from multicell.errors import OutputError
from multicell.host.interrupts import UNCUT
from multicell.results import hdf5
from multicell.results.folder import (
    LIVE,
    PASSING,
    RUN_FILES,
    begun_files,
    copied_files,
    copy_of,
    file_errors,
    is_begun,
    lock_folder,
    make_folder,
    put_in_place,
    remove,
    sync_folder,
    versions,
    write_bytes,
    write_copies,
    write_text,
)
from multicell.results.frame import Frame
from multicell.results.journal import JOURNAL_FILE as JOURNAL
from multicell.results.journal import Journal, array_digest
from multicell.results.lineage import LINEAGE_COLUMNS, Lineage
from multicell.results.reader import Contents
from multicell.results.records import Arrays, arrays_of, log_arrays
from multicell.scene.scene import Scene
from multicell.scene.start_table import COPIES

_OF_THE_START: Final = ("scene.toml", *COPIES)
_HISTORY_EVERY: Final = 1.0  # s of the wall clock


@final
class Store:
    """The writer of a result folder; it is the only owner of the open journal.

    Use :meth:`create` or :meth:`resume`. All methods raise
    :class:`~multicell.errors.OutputError` when the system refuses to write (disk full); what was
    written before stays. A call that does not come to its end (Ctrl-C) leaves no trace.
    """

    def __init__(
        self,
        folder: Path,
        scene: str,
        journal: Journal | None,
        nutrients: tuple[str, ...],
        held: ExitStack,
    ) -> None:
        self.folder = folder
        self.scene = scene  # text of ``scene.toml``
        self._journal = journal
        self._early: list[tuple[Mapping[str, Any], Arrays]] = []  # what a journal begins with
        self._nutrients = nutrients
        self._held = held
        self._columns: tuple[str, ...] = ()
        self._pending: list[list[float]] = []
        self._created = self._written = clock.monotonic()
        # what is complete: the only truth about what comes next
        self._frames = self._rows = 0
        self._logged = dict.fromkeys(LINEAGE_COLUMNS, 0)

    @classmethod
    def create(
        cls, folder: str | Path, scene: Scene, overwrite: bool = False, *, brief: bool = False
    ) -> Self:
        """Prepare the folder, write ``scene.toml`` and begin an empty journal.

        - ``folder``: output folder; from now on no other run may write to it
        - ``scene``: the scene of the run; it says which nutrients the frames have
        - ``overwrite``: remove the files of an earlier run first; one of the same scene that has
          no frame yet is begun anew in any case
        - ``brief``: write scene and journal only if the run takes longer than a second; before
          that a kill leaves an empty folder. Until the caller has this and the one above on the
          disk (:func:`multicell.results.folder.sync_folder`), names may be lost with the power
        """
        folder = Path(folder)
        make_folder(folder, overwrite=overwrite or _is_begun(folder, scene), synced=not brief)
        with ExitStack() as stack:
            stack.enter_context(lock_folder(folder))
            # another run may have come first
            make_folder(folder, overwrite=overwrite or _is_begun(folder, scene))
            # what the scene names may be one of the files that are removed
            scene, kept = copy_of(scene, folder)
            write_copies(folder, kept)
            old = (*PASSING, *LIVE, *RUN_FILES, *copied_files(folder))
            remove(folder, (name for name in old if name not in kept))
            text = scene.to_toml(versions(), beside=folder)
            store = cls(folder, text, None, tuple(scene.nutrients), stack)
            store._early.append((_first_record(text, store._nutrients, "", 0, 0), {}))
            if not brief:
                store._begin(late=False)
            store._held = stack.pop_all()
            return store

    def _begin(self, *, late: bool = True) -> None:
        """Write the scene, and a journal with the records so far.

        - ``late``: whether the folder was made without waiting for the disk
        """
        if late:
            sync_folder(self.folder.parent)
        write_text(self.folder / "scene.toml", self.scene, synced=False)
        (header, _), *records = self._early
        journal = Journal.create(self.folder, header)
        self._held.callback(journal.close)
        if records:
            journal.append(records)
            journal.sync()
        self._journal = journal
        self._early.clear()

    @classmethod
    def resume(cls, contents: Contents, place: int, rows: int, scene: Scene) -> Self:
        """Continue in a folder after one of its frames; the caller holds its lock.

        What came after the frame, and files that describe the end of the earlier run, do not
        count any more once this returns; until then nothing is lost.

        - ``contents``: of the folder
        - ``place``: number of the frame
        - ``rows``: how many rows of the history came up to it
        - ``scene``: the scene to continue with
        """
        folder, names = contents.folder, contents.nutrients
        lineage = contents.lineage(place)
        text = scene.to_toml(versions(), beside=folder)
        # beside its place, until the journal says that this is the scene from now on
        part = folder / "scene.toml.next"
        write_text(part, text)
        with ExitStack() as stack:
            if contents.journal is None:
                base = "" if contents.file is None else contents.file.identity
                journal = Journal.create(folder, _first_record(text, names, base, place + 1, rows))
            else:
                journal = Journal.reopen(contents.journal)
            stack.callback(journal.close)
            if contents.journal is not None:
                back = {"kind": "back", "scene": text, "frames": place + 1, "rows": rows}
                journal.append([(back, {})])
                journal.sync()
            with file_errors("write", folder / "scene.toml"):
                put_in_place(part, folder / "scene.toml")
            remove(
                folder,
                [name for name in RUN_FILES if name not in (*_OF_THE_START, hdf5.FRAMES_FILE)],
            )
            store = cls(folder, text, journal, names, stack.pop_all())
        store._frames, store._rows = place + 1, rows
        store._columns, store._logged = contents.columns, lineage.counts()
        return store

    def copy(self, contents: Contents, place: int, rows: int) -> None:
        """Begin with the content of another folder up to a frame."""
        history = contents.history(rows)
        self._columns = tuple(history)
        self._pending = [
            list(row) for row in zip(*(c.tolist() for c in history.values()), strict=True)
        ]
        for entry in contents.places[: place + 1]:
            self._add(entry.arrays(), entry.log())

    @property
    def is_brief(self) -> bool:
        """Whether there is no journal, and the caller has names on the disk."""
        return self._journal is None

    def append(self, frame: Frame, lineage: Lineage | None = None) -> None:
        """Write a frame.

        - ``lineage``: of the run up to the frame; what is not on disk yet is written
        """
        self._add(arrays_of(frame, self._nutrients), log_arrays(lineage, self._logged))

    def _add(self, arrays: Arrays, log: Arrays) -> None:
        """Write a frame with the new rows of the logs, and the history up to it."""
        number = {"number": self._frames}
        frame = {"time": float(arrays["time"]), "step": int(arrays["step"])}
        self._write(
            ({"kind": "lineage", **number}, log), ({"kind": "frame", **number, **frame}, arrays)
        )
        self._frames += 1
        for name in LINEAGE_COLUMNS:
            self._logged[name] += len(log[f"{name}/id"])

    def _write(self, *records: tuple[Mapping[str, Any], Arrays]) -> None:
        """Write what there is of the history, and records behind it."""
        rows = []
        if self._pending:
            header = {"kind": "rows", "start": self._rows, "columns": list(self._columns)}
            rows = [(header, {"rows": np.array(self._pending, "<f8")})]
        with UNCUT:
            if self._journal is None and clock.monotonic() - self._created > _HISTORY_EVERY:
                self._begin()
            if self._journal is None:
                self._early += [*rows, *records]
            else:
                self._journal.append([*rows, *records])
            self._rows += len(self._pending)
            self._pending.clear()
            self._written = clock.monotonic()

    def append_history(self, row: Mapping[str, float]) -> None:
        """Add one row to the history; the first row says which columns there are.

        It is on disk with the next frame, or after a second. A run that an older version began
        keeps the columns with which it did.
        """
        if not self._columns:
            self._columns = tuple(sorted(row))  # as they come back from HDF5
        self._pending.append([float(row[name]) for name in self._columns])
        # to write costs more than a small coupling step: a killed run loses one second
        if clock.monotonic() - self._written > _HISTORY_EVERY:
            self.flush()

    def flush(self) -> None:
        """Write what there is of the history."""
        if self._pending:
            self._write()

    def settle(self) -> None:
        """Make one file ``frames.h5`` of all that there is.

        The journal goes when that file has been read back.
        """
        self.flush()
        if self._journal is None:
            with suppress(OutputError):  # said where the journal meets it, too
                write_text(self.folder / "scene.toml", self.scene, synced=False)
                # there is no journal to remove; where a name is on the disk, those before it are
                image = hdf5.image(*self._results())
                write_bytes(self.folder / hdf5.FRAMES_FILE, image, synced=False)
                return
            self._begin()
        assert self._journal is not None
        contents = Contents(self.folder)
        contents.whole()
        frames = ((entry.arrays(), entry.digest, entry.log()) for entry in contents.places)
        held = contents.scene, contents.nutrients, frames, contents.history(), contents.identity
        try:
            hdf5.write_hdf5(self.folder / hdf5.FRAMES_FILE, *held)
        except OutputError as error:
            raise OutputError(
                f"{error}. All {len(contents.places)} frames of the run are kept in {JOURNAL} and "
                "can be read; 'multicell resume' makes one file of them when there is room"
            ) from error
        self._journal.close()
        with file_errors("remove", self.folder / JOURNAL):
            (self.folder / JOURNAL).unlink()  # one that comes back by a loss of power is known

    def _results(self) -> tuple[Any, ...]:
        """Return the content of ``frames.h5`` by the records so far."""
        found: dict[str, list[Arrays]] = {"open": [], "rows": [], "lineage": [], "frame": []}
        for header, arrays in self._early:
            found[header["kind"]].append(arrays)
        logs = zip(found["frame"], found["lineage"], strict=True)
        frames = ((arrays, array_digest(arrays), log) for arrays, log in logs)
        rows = np.concatenate([arrays["rows"] for arrays in found["rows"]])
        history = dict(zip(self._columns, rows.T, strict=True))
        names, identity = sorted(self._nutrients), self._early[0][0]["identity"]
        return self.scene, names, frames, history, identity

    def close(self) -> None:
        """Close the journal and let others write to the folder; closing twice does no harm."""
        self._held.close()


def _is_begun(folder: Path, scene: Scene) -> bool:
    """Return whether a folder holds the same run, which has ended before its first frame."""
    if not begun_files(folder):  # as for most runs, which need no text of the scene to say so
        return False
    copied, content = copy_of(scene, folder)
    text = copied.to_toml(versions(), beside=folder)
    first: dict[str, bytes | str] = {**content, "scene.toml": text, JOURNAL: b""}
    with suppress(OSError, OutputError):
        if (folder / JOURNAL).is_file() and not Contents(folder).places:
            first[JOURNAL] = (folder / JOURNAL).read_bytes()
    return is_begun(folder, first)


def _first_record(
    scene: str, nutrients: tuple[str, ...], base: str, frames: int, rows: int
) -> dict[str, Any]:
    return {
        "kind": "open",
        "identity": uuid.uuid4().hex,
        "base": base,
        "frames": frames,
        "rows": rows,
        "scene": scene,
        "nutrients": list(nutrients),
    }
