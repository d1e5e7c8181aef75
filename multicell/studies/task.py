"""What a worker does with one run: begin or continue it, and report how that ended."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final, final

from multicell.errors import MulticellError, OutputError
from multicell.plugins.named import own_fault
from multicell.results.folder import FILES, PASSING, lock_folder, remove
from multicell.studies.runs import PlainScene
from multicell.studies.status import NOTE, Kind, RunStatus, run_folder, status, write_note

if TYPE_CHECKING:
    from multicell.simulation import Simulation
    from multicell.studies.runs import Run

_ATTEMPTS: Final = 5  # how often a folder is looked at that another process changes meanwhile


@final
@dataclass(frozen=True)
class Outcome:
    """How a run ended.

    - ``state``: ``"done"``, ``"failed"``, or ``"held"`` where another process works on it
    - ``reason``: why it failed, in words; otherwise an empty string
    - ``wall``, ``cpu``: wall time and CPU time that it took now, s; none for what was there
    - ``reused``: whether it had been done, or had failed, before
    """

    name: str
    state: str
    reason: str = ""
    wall: float = 0.0
    cpu: float = 0.0
    reused: bool = False


@final
@dataclass(frozen=True)
class Task:
    """A run as it travels to a worker: plain values only.

    - ``folder``: of the study
    - ``integrator``: ``file.py:Name`` of the user's own, or empty
    - ``retry``: whether a run that failed, or whose folder is damaged, is tried again
    """

    name: str
    folder: str
    scene: PlainScene
    integrator: str
    retry: bool


def task(run: Run, folder: Path, retry: bool) -> Task:
    """Return what a worker has to know of a run."""
    return Task(run.name, str(folder), PlainScene.of(run.scene), run.integrator, retry)


@final
class Stopped(BaseException):
    """Ends a run between two steps, since nobody waits for it any more."""


def do_run(work: Task, wanted: Callable[[], bool] = lambda: True) -> Outcome:
    """Do one run in its folder, unless it is done; this is all that a worker does.

    - ``wanted``: asked between steps; where it answers no the run ends there, and can be continued
    """
    begin, cpu = clock.perf_counter(), clock.thread_time()
    outcome = _do_in_words(work, wanted)
    if outcome.reused:
        return outcome
    spent = clock.perf_counter() - begin, clock.thread_time() - cpu
    return replace(outcome, wall=spent[0], cpu=spent[1])


def _do_in_words(work: Task, wanted: Callable[[], bool]) -> Outcome:
    """Do a run; put what kept it from its end into words, and into its folder."""
    place = run_folder(Path(work.folder), work.name)
    try:
        return _attempt(work, place, wanted)
    except Stopped:
        return Outcome(work.name, "held", "stopped")
    except Exception as error:
        if isinstance(error, OutputError) and error.in_use:
            return Outcome(work.name, "held")
        reason, kind = _in_words(error)
    with suppress(OutputError):  # where the disk is full there is no room for the reason either
        write_note(place, reason, kind)
    return Outcome(work.name, "failed", reason)


def _in_words(error: Exception) -> tuple[str, Kind]:
    """Return why a run failed, and what that was a matter of."""
    if isinstance(error, OutputError):
        if error.exit_code == 1 or getattr(error.__cause__, "errno", None) is not None:
            return str(error), "machine"
        return f"damaged: {error}", "damage"
    if isinstance(error, MulticellError):
        return str(error), "run"
    if isinstance(error, MemoryError):
        return "there was not enough memory for it", "machine"
    fault = own_fault(error)
    if fault is not None:
        return f"your own code fails: {fault}", "run"
    said = " ".join(str(error).split())
    return f"unexpected {type(error).__name__}: {said}. This is a bug of multicell", "run"


def _attempt(work: Task, place: Path, wanted: Callable[[], bool]) -> Outcome:
    """Do a run from wherever it stands; another process may come first at any moment."""
    for left in reversed(range(_ATTEMPTS)):
        found = status(work.name, Path(work.folder), work.integrator)
        if found.state == "running":
            return Outcome(work.name, "held")
        known = known_outcome(found, work.retry)
        if known is not None:
            return known
        try:
            _forward(work, place, found, wanted)
            return Outcome(work.name, "done")
        except OutputError as error:
            if error.exit_code == 1 or not left:
                raise
    raise AssertionError("unreachable")


def known_outcome(found: RunStatus, retry: bool) -> Outcome | None:
    """Return how a run ended that is not to be worked on any more; None for all others."""
    if found.state == "done":
        return Outcome(found.name, "done", reused=True)
    if found.state == "failed" and not (retry or found.kind == "machine"):
        return Outcome(found.name, "failed", found.reason, reused=True)
    return None


def _forward(work: Task, place: Path, found: RunStatus, wanted: Callable[[], bool]) -> None:
    """Begin or continue a run, up to its end."""
    from multicell import runner

    def between(_: Simulation) -> None:
        if not wanted():
            raise Stopped

    scene, integrator = work.scene.load(), work.integrator or None
    if not wanted():
        raise Stopped
    options = runner.RunOptions(output=place, integrator=integrator, threads=1, progress=between)
    if found.frames and found.kind != "damage":
        remove(place, [NOTE])
        runner.record_resumed(place, options, planned=True)
    else:
        _empty(work, place)
        runner.record_run(scene, options)


def _empty(work: Task, place: Path) -> None:
    """Remove what a run has left that was killed before its first frame, or damaged."""
    if not place.is_dir():
        return
    with lock_folder(place):
        now = status(work.name, Path(work.folder), work.integrator, ours=True)
        if now.kind == "damage" or not (now.frames or now.state == "done"):
            remove(place, (*PASSING, *FILES, NOTE))
