"""Read result folders, also of runs that are running, were killed, or met a full disk."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Final, NamedTuple, final, overload

import numpy as np
from numpy.typing import NDArray

from multicell.errors import OutputError
from multicell.host.files import parse_toml
from multicell.results import hdf5, journal
from multicell.results.frame import Frame
from multicell.results.layout import check_frame, check_numbers
from multicell.results.lineage import LINEAGE_COLUMNS, Lineage
from multicell.results.records import Arrays, frame_of

_ATTEMPTS: Final = 5  # to open a folder that changes meanwhile


class _Place(NamedTuple):
    """A frame: when it is, its checksum, and what reads it and the new rows of the lineage."""

    time: float
    step_index: int
    digest: int
    arrays: Callable[[], Arrays]
    log: Callable[[], Arrays]


class _Rows(NamedTuple):
    """The first ``length`` rows of a part of the history, and what reads them by column."""

    length: int
    read: Callable[[], Mapping[str, NDArray[np.float64]]]


@lru_cache(maxsize=8)
def _types(scene: str) -> int:
    """Return how many types of cells a scene has: one where it names none."""
    try:
        named = parse_toml(scene).get("types")
    except ValueError as error:
        raise OutputError(f"its scene cannot be read: {error}", damaged=True) from error
    return len(named) if isinstance(named, dict) and named else 1


@final
class Contents:
    """The contents of a result folder: ``frames.h5``, and the journal of what came after.

    The journal is None also where it is part of ``frames.h5`` already. Raises OutputError if there
    are no results that this version can read.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self.file, self.journal = self._open()
        self.scene = ""  # text of the scene that was run
        self.nutrients: tuple[str, ...] = ()
        self.columns: tuple[str, ...] = ()  # of the history
        self.places: list[_Place] = []  # one entry for each frame
        self._rows: list[_Rows] = []
        self.identity = ""  # of the journal
        self.damage: str | None = None  # what ends the frames and the history early, in words
        if self.file is not None:
            self._follow_file(self.file)
        if self.journal is not None:
            self._follow_journal(self.journal)

    def _open(self) -> tuple[hdf5.File | None, journal.Reader | None]:
        """Open both files; a run that ends meanwhile makes one of them."""
        path, beside = self.folder / hdf5.FRAMES_FILE, self.folder / journal.JOURNAL_FILE
        for attempt in range(_ATTEMPTS):
            reader = None
            if beside.is_file():
                try:
                    reader = journal.Reader(beside)
                except OutputError:
                    if beside.is_file():
                        raise
            file = hdf5.opened(path) if path.is_file() else None
            if file is None and reader is None:
                break
            if reader is None:
                return file, None
            header = reader.records[0].header
            if file is not None and file.absorbed == header.get("identity"):
                return file, None
            if header.get("base") == ("" if file is None else file.identity):
                return file, reader
            if attempt == _ATTEMPTS - 1:
                raise OutputError(
                    f"'{beside}' does not belong to the {hdf5.FRAMES_FILE} beside it: "
                    "one of them is from another run",
                    damaged=True,
                )
        lacking = (
            f"{hdf5.FRAMES_FILE} is missing" if self.folder.exists() else "there is no such folder"
        )
        lacking = "it is a file, not a folder" if self.folder.is_file() else lacking
        raise OutputError(f"there are no results in '{self.folder}': {lacking}")

    def _follow_file(self, file: hdf5.File) -> None:
        self.scene, self.nutrients, self.columns = file.scene, file.nutrients, file.columns
        known = zip(file.times, file.steps, file.digests, strict=True)
        self.places = [
            _Place(
                float(time),
                int(step_index),
                int(check),
                partial(file.frame, k),
                partial(file.log, k),
            )
            for k, (time, step_index, check) in enumerate(known)
        ]
        self._rows = [_Rows(file.rows, file.history)]

    def _follow_journal(self, reader: journal.Reader) -> None:
        self.damage = reader.damage
        log: tuple[Any, Any] = None, None  # number and rows of the lineage before a frame
        for record in reader.records:
            header, read = record.header, partial(reader.arrays, record)
            follows = True
            match header["kind"]:
                case "open":
                    self.identity = header["identity"]
                    self.nutrients = tuple(sorted(header["nutrients"]))
                    follows = self._go_back(header)
                case "back":
                    follows = self._go_back(header)
                case "rows":
                    follows = self._add_rows(header, read)
                case "lineage":
                    log = header["number"], read
                case "frame":
                    # each is written behind its lineage
                    follows = header["number"] == log[0] == len(self.places)
                    when = header["time"], header["step"]
                    if follows:
                        self.places.append(_Place(*when, record.digest, read, log[1]))
            if not follows:
                self.damage = f"the record before byte {record.begin} does not follow the others"
                return

    def _go_back(self, header: Mapping[str, Any]) -> bool:
        """Forget what a run that was resumed from an earlier frame has left behind.

        Returns whether there is so much of it.
        """
        if header["frames"] > len(self.places) or header["rows"] > self.rows:
            return False
        del self.places[header["frames"] :]
        self._rows, before = [], self._rows
        for part in before:
            count = min(part.length, header["rows"] - self.rows)
            self._rows += [part._replace(length=count)] if count > 0 else []
        self.scene = header["scene"]
        return True

    def _add_rows(self, header: Mapping[str, Any], read: Callable[[], Arrays]) -> bool:
        """Add rows of the history; return whether they are such, with the columns of the others."""
        columns = tuple(header["columns"])
        arrays = [(name, kind, shape[1:]) for name, kind, shape in header.get("arrays", ())]
        if not {"time"} <= {*(self.columns or columns)} <= {*columns}:
            return False
        if arrays != [("rows", "<f8", [len(columns)])]:
            return False
        self.columns = self.columns or columns

        def by_column() -> dict[str, NDArray[np.float64]]:
            return dict(zip(columns, read()["rows"].T, strict=True))

        ((_, _, (length, _)),) = header["arrays"]
        self._rows.append(_Rows(length, by_column))
        return True

    @property
    def rows(self) -> int:
        """Number of rows of the history."""
        return sum(part.length for part in self._rows)

    def frame(self, place: int) -> Frame:
        """Return a frame."""
        try:
            arrays = self.places[place].arrays()
            check_frame(arrays, self.nutrients, _types(self.scene))
            return frame_of(arrays, self.nutrients)
        except OutputError as error:
            how = "is damaged" if error.damaged else "cannot be read"
            problem = f"frame {place} in '{self.folder}' {how}: {error}"
            if place and error.damaged:
                problem += f". Continue from an earlier one: multicell resume --frame {place - 1}"
            raise OutputError(problem, damaged=error.damaged) from error

    def lineage(self, place: int) -> Lineage:
        """Return the lineage up to a frame; raises OutputError if it is damaged."""
        paths = [f"{log}/{name}" for log, columns in LINEAGE_COLUMNS.items() for name in columns]
        parts = [entry.log() for entry in self.places[: place + 1]]
        try:
            for part in parts:
                Lineage.check(part)
            whole = {path: np.concatenate([part[path] for part in parts]) for path in paths}
            check_numbers("births/kind", whole["births/kind"], _types(self.scene))
            return Lineage.of(whole)
        except (ValueError, OutputError) as error:
            raise OutputError(
                f"the lineage in '{self.folder}' is damaged: {error}", damaged=True
            ) from error

    def history(self, rows: int | None = None) -> dict[str, NDArray[np.float64]]:
        """Return the first rows of the history, by default all, by column."""
        wanted = self.rows if rows is None else rows
        parts: list[dict[str, Any]] = [dict.fromkeys(self.columns, np.empty(0))]
        for length, read in self._rows:
            count = min(length, wanted)
            if count > 0:
                part = read()
                parts.append({name: part[name][:count] for name in self.columns})
            wanted -= count
        return {name: np.concatenate([part[name] for part in parts]) for name in self.columns}

    def whole(self) -> None:
        """Refuse results of which a part cannot be read any more."""
        if self.damage is not None:
            rest = "No frame can be read"
            if self.places:
                last = len(self.places) - 1
                rest = f"The frames 0 to {last} can be read: continue from the last of them with "
                rest += f"'multicell resume --frame {last} --output' and another folder"
            problem = f"'{self.folder / journal.JOURNAL_FILE}' is damaged: {self.damage}. {rest}"
            raise OutputError(problem, damaged=True)


@final
class Frames(Sequence[Frame]):
    """The frames of a result folder, each read, and checked, when it is asked for.

    Supports ``len``, integer indices (negative ones too), slices (lists of frames) and
    iteration. The frames are those that were on disk when the object was made.

    - ``damage``, str or None: what ends the frames early, in words; None where all of them are
      there
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
        known = [(place.digest, place.step_index) for place in self._known]
        found = [(place.digest, place.step_index) for place in now.places[: len(known)]]
        if known != found:
            raise OutputError(
                f"the frames in '{now.folder}' are not those that were there: it holds another run"
            )
        self._contents = now
        return True
