"""Reading result folders, also those of runs that go on, were killed, or met a full disk."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple, final, overload

import numpy as np
from numpy.typing import NDArray

from multicell.errors import OutputError
from multicell.results import hdf5, journal
from multicell.results.frame import Frame
from multicell.results.lineage import COLUMNS, Lineage
from multicell.results.records import Arrays, frame_of, lineage_of

_ATTEMPTS: Final = 5  # how often a folder is looked at that changes while it is


class _Place(NamedTuple):
    """Where a frame is."""

    time: float
    step: int
    digest: int
    in_file: int | None  # number in frames.h5
    record: journal.Record | None  # in the journal
    log: journal.Record | None  # new rows of the lineage, in the journal


class _Rows(NamedTuple):
    """Rows of the history, the first ``length`` of a record or of frames.h5."""

    record: journal.Record | None
    length: int


@final
class Contents:
    """What a result folder holds: ``frames.h5``, and the journal of what came after.

    Attributes
    ----------
    folder : Path
    scene : str
        Text of the scene that was run.
    nutrients : tuple of str
    places : list
        One entry for each frame.
    columns : tuple of str
        Of the history.
    file : hdf5.File or None
    journal : journal.Reader or None
        None also where the journal is part of ``frames.h5`` already.
    identity : str
        Of the journal, or an empty string.
    damage : str or None
        What ends the frames and the history early, in words.

    Raises
    ------
    OutputError
        If there are no results that this version can read.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self.file, self.journal = self._open()
        self.scene = ""
        self.nutrients: tuple[str, ...] = ()
        self.columns: tuple[str, ...] = ()
        self.places: list[_Place] = []
        self._rows: list[_Rows] = []
        self.identity = ""
        self.damage: str | None = None
        if self.file is not None:
            self._take_file(self.file)
        if self.journal is not None:
            self._take_journal(self.journal)

    def _open(self) -> tuple[hdf5.File | None, journal.Reader | None]:
        """Open both files; a run that ends meanwhile makes one of them."""
        path, beside = self.folder / hdf5.NAME, self.folder / journal.NAME
        for attempt in range(_ATTEMPTS):
            reader = None
            if beside.is_file():
                try:
                    reader = journal.Reader(beside)
                except OutputError:
                    if beside.is_file():
                        raise
            file = hdf5.File(path) if path.is_file() else None
            if file is None and reader is None:
                break
            if reader is None:
                return file, None
            facts = reader.records[0].facts
            if file is not None and file.absorbed == facts.get("identity"):
                return file, None
            if facts.get("base") == ("" if file is None else file.identity):
                return file, reader
            if attempt == _ATTEMPTS - 1:
                raise OutputError(
                    f"'{beside}' does not belong to the {hdf5.NAME} beside it: one of them is from "
                    "another run"
                )
        raise OutputError(f"there are no results in '{self.folder}': {hdf5.NAME} is missing")

    def _take_file(self, file: hdf5.File) -> None:
        self.scene, self.nutrients, self.columns = file.scene, file.nutrients, file.columns
        self.places = [
            _Place(float(time), int(step), int(check), k, None, None)
            for k, (time, step, check) in enumerate(
                zip(file.times, file.steps, file.digests, strict=True)
            )
        ]
        self._rows = [_Rows(None, file.rows)]

    def _take_journal(self, reader: journal.Reader) -> None:
        """Follow the journal as far as it makes sense."""
        self.damage = reader.damage
        log = None
        for record in reader.records:
            try:
                fits = self._take(record, log)
            except (KeyError, TypeError, ValueError, AttributeError):
                fits = False
            if not fits:
                self.damage = f"the record at byte {record.begin} does not follow from those before"
                return
            log = record if record.kind == "lineage" else None

    def _take(self, record: journal.Record, log: journal.Record | None) -> bool:
        """Follow one record if it fits to what came before; return whether it does."""
        facts = record.facts
        match record.kind:
            case "open":
                return self._begin(facts)
            case "back":
                return self._go_back(facts)
            case "rows":
                return self._add_rows(record)
            case "lineage":
                return bool(facts["number"] == len(self.places))
            case "frame":
                if log is None or facts["number"] != len(self.places):
                    return False
                place = float(facts["time"]), int(facts["step"]), record.digest
                self.places.append(_Place(*place, None, record, log))
                return True
        return False

    def _begin(self, facts: Mapping[str, Any]) -> bool:
        """Begin where a journal begins: after a frame of the file, or with nothing."""
        names = tuple(sorted(map(str, facts["nutrients"])))
        if self.identity or (self.file is not None and names != self.nutrients):
            return False
        self.identity, self.nutrients = str(facts["identity"]), names
        return self._go_back(facts)

    def _go_back(self, facts: Mapping[str, Any]) -> bool:
        """Forget what a run that was resumed from an earlier frame has left behind."""
        frames, rows, scene = facts["frames"], facts["rows"], facts["scene"]
        if not (0 <= frames <= len(self.places) and 0 <= rows <= self.rows):
            return False
        self._cut(int(frames), int(rows))
        self.scene = str(scene)
        return True

    def _add_rows(self, record: journal.Record) -> bool:
        """Add rows to the history."""
        columns = tuple(map(str, record.facts["columns"]))
        ((_, _, (length, width)),) = record.facts["arrays"]
        known = self.columns or columns
        if sorted(columns) != sorted(known) or width != len(set(columns)):
            return False
        if record.facts["start"] != self.rows:
            return False
        self.columns = known
        self._rows.append(_Rows(record, int(length)))
        return True

    def _cut(self, frames: int, rows: int) -> None:
        """Keep the first frames and rows only."""
        del self.places[frames:]
        kept, before = [], 0
        for part in self._rows:
            count = min(part.length, rows - before)
            if count > 0:
                kept.append(part._replace(length=count))
            before += part.length
        self._rows = kept

    @property
    def rows(self) -> int:
        """Number of rows of the history."""
        return sum(part.length for part in self._rows)

    def arrays(self, place: int) -> Arrays:
        """Return the arrays of a frame.

        Raises
        ------
        OutputError
            If they are not what was written.
        """
        where = self.places[place]
        if where.in_file is not None:
            assert self.file is not None
            return self.file.frame(where.in_file)
        assert self.journal is not None
        assert where.record is not None
        return self.journal.arrays(where.record)

    def log(self, place: int) -> Arrays:
        """Return the rows of the lineage that are new with a frame.

        Raises
        ------
        OutputError
            If they are not what was written.
        """
        where = self.places[place]
        if where.in_file is not None:
            assert self.file is not None
            return self.file.log(where.in_file)
        assert self.journal is not None
        assert where.log is not None
        return self.journal.arrays(where.log)

    def frame(self, place: int) -> Frame:
        """Return a frame.

        Raises
        ------
        OutputError
            If it is damaged; the text says which frame before it can still be read.
        """
        try:
            return frame_of(self.arrays(place), self.nutrients)
        except OutputError as error:
            raise OutputError(
                f"frame {place} in '{self.folder}' is damaged: {error}. {self._before(place)}"
            ) from error

    def _before(self, place: int) -> str:
        """Tell which frame before one can be read."""
        for k in range(place - 1, -1, -1):
            try:
                frame_of(self.arrays(k), self.nutrients)
            except OutputError:
                continue
            return f"Frame {k} can be read: go on from it with 'multicell resume --frame {k}'"
        return "No frame before it can be read"

    def lineage(self, place: int) -> Lineage:
        """Return the lineage up to a frame.

        Raises
        ------
        OutputError
            If it is damaged.
        """
        paths = [f"{log}/{name}" for log, columns in COLUMNS.items() for name in columns]
        parts = [self.log(k) for k in range(place + 1)]
        return lineage_of({path: np.concatenate([part[path] for part in parts]) for path in paths})

    def history(self, rows: int | None = None) -> dict[str, NDArray[np.float64]]:
        """Return the first rows of the history, by default all, by column.

        Raises
        ------
        OutputError
            If they are damaged.
        """
        wanted = self.rows if rows is None else rows
        parts: list[dict[str, Any]] = []
        for source in self._rows:
            count = min(source.length, wanted)
            if count > 0:
                part = self._part(source)
                parts.append({name: part[name][:count] for name in self.columns})
            wanted -= count
        none: list[NDArray[np.float64]] = [np.empty(0)]
        return {n: np.concatenate([*none, *(part[n] for part in parts)]) for n in self.columns}

    def _part(self, source: _Rows) -> dict[str, Any]:
        """Return a part of the history by column."""
        if source.record is None:
            assert self.file is not None
            return self.file.history()
        assert self.journal is not None
        table = self.journal.arrays(source.record)["rows"]
        return dict(zip(source.record.facts["columns"], table.T, strict=True))

    def whole(self) -> None:
        """Refuse results of which a part cannot be read any more.

        Raises
        ------
        OutputError
            If the journal ends in a damaged record; the text says what can still be read.
        """
        if self.damage is not None:
            count = len(self.places)
            rest = (
                f"The frames 0 to {count - 1} can be read: go on from the last of them with "
                f"'multicell resume --frame {count - 1} --output' and another folder"
                if count
                else "No frame can be read"
            )
            raise OutputError(f"'{self.folder / journal.NAME}' is damaged: {self.damage}. {rest}")


@final
class Frames(Sequence[Frame]):
    """The frames of a result folder, each read, and checked, when it is asked for.

    Supports ``len``, integer indices (negative ones too), slices (lists of frames) and
    iteration. The frames are those that were on disk when the object was made.

    Attributes
    ----------
    damage : str or None
        What ends the frames early, in words; None where all of them are there.
    """

    def __init__(self, contents: Contents) -> None:
        self._contents = contents
        self._known = list(contents.places)
        self.damage = contents.damage

    @property
    def times(self) -> NDArray[np.float64]:
        """Simulated time of every frame: (k,), s."""
        return np.array([place.time for place in self._known], dtype=np.float64)

    def __len__(self) -> int:
        return len(self._known)

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
        try:
            return self._contents.frame(place)
        except OutputError:
            if not self._found_again():
                raise
        return self._contents.frame(place)

    def _found_again(self) -> bool:
        """Look where the frames are now, if a run has ended and made one file of them."""
        now = Contents(self._contents.folder)
        before = self._contents
        if (now.file and now.file.identity) == (before.file and before.file.identity):
            return False
        known = [(place.digest, place.step) for place in self._known]
        found = [(place.digest, place.step) for place in now.places[: len(known)]]
        if known != found:
            raise OutputError(
                f"the frames in '{now.folder}' are not those that were there: it holds another run"
            )
        self._contents = now
        return True


def open_frames(folder: str | Path) -> Frames:
    """Return the frames of a result folder, also of a run that goes on or was killed.

    Where the folder is damaged these are the frames before the damage, which ``damage`` names.

    Raises
    ------
    OutputError
        If the folder holds no results that this version can read.
    """
    return Frames(Contents(folder))


def open_lineage(folder: str | Path, frame: int = -1) -> Lineage:
    """Return the lineage of a run up to a frame.

    Raises
    ------
    OutputError
        If the folder holds no results that this version can read.
    IndexError
        If there is no such frame.
    """
    contents = Contents(folder)
    count = len(contents.places)
    place = frame + count if frame < 0 else frame
    if not 0 <= place < count:
        raise IndexError(f"frame {frame} of {count}")
    return contents.lineage(place)


def open_history(folder: str | Path) -> dict[str, NDArray[np.float64]]:
    """Return the history of a run: column name -> (m,) float64, one entry per coupling step.

    Raises
    ------
    OutputError
        If the folder holds no results that this version can read.
    """
    return Contents(folder).history()
