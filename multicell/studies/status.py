"""States of the runs of a study, from their folders alone.

A folder states all that there is to know: whoever killed the study, on whatever machine it ran, and
however many processes work on it. A run is

``done``
    where its summary is complete, its results are one whole file, and its scene is the one that its
    name stands for;
``running``
    while a process holds the lock of its folder;
``failed``
    where a note in its folder states why (:data:`NOTE`), or what is there is damaged, or may not be
    read at this moment;
``partial``
    where there are frames from which it can continue;
``waiting``
    where there is nothing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal, final

import numpy as np
from numpy.typing import NDArray

from multicell.errors import MulticellError, OutputError, is_machine_failure
from multicell.report.result import recorded_scene, same_text, scene_of_text
from multicell.results import hdf5, journal
from multicell.results.documents import read_document, write_table
from multicell.results.folder import in_use
from multicell.results.summary import read_summary, scene_mark
from multicell.scene.scene import load_scene
from multicell.studies.runs import run_digest

NOTE: Final = "failure.json"  # file in the folder of a run that failed: ``reason`` and ``kind``

STATES: Final = ("done", "running", "partial", "waiting", "failed")

Kind = Literal["", "run", "machine", "damage", "unreadable"]
"""What a run failed for: nothing yet; its scene, which fails again; what is no matter of its scene,
such as a full disk; a folder that holds something else than what was written to it; files of
unknown content, which cannot be read now."""


@final
@dataclass(frozen=True)
class RunStatus:
    """Status of a run.

    - ``state``: ``"done"``, ``"running"``, ``"partial"``, ``"waiting"`` or ``"failed"``
    - ``reason``: why it failed, or an empty string
    - ``cells``: number of cells at ``time``
    - ``time``: simulated time so far, s; as far as frames are saved where the run continues
    - ``wall``: wall time that it took, s; NaN until it is done
    - ``kind``: what it failed for
    - ``frames``: how many frames there are to continue from; not counted where it is done
    """

    name: str
    state: str
    reason: str = ""
    cells: int = 0
    time: float = 0.0
    wall: float = math.nan
    kind: Kind = ""
    frames: int = 0


def run_folder(folder: Path, name: str) -> Path:
    """Return the folder of a run of the study in ``folder``."""
    return folder / "runs" / name


def run_status(name: str, folder: Path, *, ours: bool = False, whole: bool = False) -> RunStatus:
    """Return the state of one run.

    - ``folder``: of the study
    - ``ours``: whether it is the caller who holds the lock of the run's folder
    - ``whole``: whether all frames of a run that is done are read, to see that none is damaged
    """
    place = run_folder(folder, name)
    try:
        if not place.is_dir():
            return RunStatus(name, "waiting")
        if not ours and in_use(place):
            return _unfinished_status(name, place, "running")
        done = _finished_status(name, place)
        if done is not None:
            if whole:
                read_finished(name, folder, whole=True)
            return done
        found, note = _unfinished_status(name, place, "partial"), read_document(place / NOTE)
        if note is None:
            return found
        kind = note.get("kind")
        known: Kind = kind if kind in ("machine", "damage") else "run"
        return replace(found, state="failed", reason=str(note.get("reason", "")), kind=known)
    except FAILURES as error:
        return failed_status(name, error)


FAILURES: Final = (MulticellError, OSError, MemoryError)
"""What reading the folder of a run may raise."""


def failed_status(name: str, error: Exception) -> RunStatus:
    """Return the state of a run that cannot be read."""
    if is_machine_failure(error):
        return RunStatus(name, "failed", f"cannot be read: {error}", kind="unreadable")
    return RunStatus(name, "failed", f"damaged: {error}", kind="damage")


_Stamps = tuple[tuple[int, int, int], ...]
_KNOWN: Final[dict[Path, tuple[_Stamps, RunStatus]]] = {}
"""Runs that are done, with the stamps of their files: what has not changed is not read again."""


def _finished_status(name: str, place: Path) -> RunStatus | None:
    """Return the state of a run that has come to its end; None before that."""
    try:
        if (place / journal.JOURNAL_FILE).exists():
            return None
        files = [(place / file).stat() for file in ("summary.json", hdf5.FRAMES_FILE, "scene.toml")]
    except OSError:  # missing, or worth an error where it is read
        return _read_finished(name, place)
    stamps = tuple((file.st_ino, file.st_size, file.st_mtime_ns) for file in files)
    before, found = _KNOWN.get(place, (None, None))
    if before != stamps:
        found = _read_finished(name, place)
        if found is not None:
            _KNOWN[place] = stamps, found
    return found


def _read_finished(name: str, place: Path) -> RunStatus | None:
    """Return the state of a run that has come to its end, from its files."""
    summary = read_document(place / "summary.json")
    if summary is None or summary.get("interrupted"):
        return None
    text, path = hdf5.check_whole(place / hdf5.FRAMES_FILE), place / "scene.toml"
    if run_digest(load_scene(path)) != name:
        raise OutputError(f"'{path}' is not the scene that the folder is named by")
    if not same_text(path, text) and run_digest(scene_of_text(text, path)) != name:
        raise OutputError(
            f"'{place / hdf5.FRAMES_FILE}' is of another run than its folder is named by"
        )
    if summary.get("scene_digest", scene_mark(text)) != scene_mark(text):
        raise OutputError(f"'{place / 'summary.json'}' is of another run than the frames beside it")
    try:
        time, cells = float(summary["time"]), int(summary["cells"])
        return RunStatus(name, "done", "", cells, time, float(summary["wall"]["total"]))
    except (KeyError, TypeError, ValueError):
        problem = f"'{place / 'summary.json'}' lacks what a run writes at its end"
        raise OutputError(problem) from None


def read_finished(
    name: str, folder: Path, *, whole: bool = False
) -> tuple[Mapping[str, NDArray[np.float64]], Mapping[str, Any]]:
    """Return history and summary of a run that is done.

    - ``whole``: whether all frames are read, too

    Raises OutputError if they are not of the scene that is beside them, or not what was written.
    """
    from multicell.results.reader import Contents

    place = run_folder(folder, name)
    contents = Contents(place)
    if not same_text(place / "scene.toml", contents.scene):
        recorded_scene(contents)
    summary, history = read_summary(contents), contents.history()
    if summary is None or "time" not in history:
        raise OutputError(f"'{place}' holds no results of a run that is done")
    if whole and contents.file is not None:
        contents.file.check()
    return history, summary


def _unfinished_status(name: str, place: Path, state: str) -> RunStatus:
    """Return how far a run has come that has not ended; one without frames waits, or runs."""
    from multicell.results.reader import Contents

    nothing = RunStatus(name, "waiting" if state == "partial" else state)
    if not any((place / file).exists() for file in (hdf5.FRAMES_FILE, journal.JOURNAL_FILE)):
        return nothing
    try:
        contents = Contents(place)
    except OutputError:
        if state == "partial":
            raise
        return nothing  # it may be about to begin, or to end
    if state == "partial":
        contents.whole()
    if not contents.places:
        return nothing
    last = contents.places[-1]
    cells = contents.history().get("cells", ())
    row = min(last.step_index, len(cells) - 1)
    count = int(cells[row]) if row >= 0 else 0
    return RunStatus(name, state, "", count, last.time, frames=len(contents.places))


def write_note(place: Path, reason: str, kind: Kind) -> None:
    """Write down why a run failed; raises OutputError if that cannot be written."""
    write_table(place / NOTE, {"reason": reason, "kind": kind})
