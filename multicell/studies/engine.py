"""Do all runs of a study: the longest first, nothing twice, nothing lost.

What is done is known from the folders of the runs alone, before Dask is even loaded. Workers write
results themselves; what travels is a scene one way and an :class:`RunOutcome` the other. There are
never more tasks than there are threads of workers, so that the order is ours, and a worker that
dies is known to have died of the run that it had.
"""

from __future__ import annotations

import itertools
import time as clock
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Final, NamedTuple, final

from multicell.errors import ClusterError, ExitCode, MulticellError, OutputError, exit_code_of
from multicell.host.call_stack import call_with_room
from multicell.host.garbage import without_what_there_is
from multicell.host.interrupts import WHOLE_STEP
from multicell.plugins.named import own_fault
from multicell.results.folder import (
    LOCK,
    PASSING,
    RUN_FILES,
    copied_files,
    file_errors,
    in_use,
    lock_folder,
    remove,
    sync_folder,
)
from multicell.studies.limits import check_cores
from multicell.studies.runs import PlainScene
from multicell.studies.status import NOTE, Kind, RunStatus, run_folder, run_status, write_note
from multicell.studies.workers import (
    ANSWER,
    CheckedClient,
    Refusal,
    bounded,
    check_folder,
    own_cores,
    own_versions,
    workers,
)

if TYPE_CHECKING:
    from multicell.scene.scene import Scene
    from multicell.simulation import Simulation
    from multicell.studies.runs import StudyRun

__all__ = ["RunOutcome", "run_study"]

_POLL: Final = 0.2  # s between checks for Ctrl-C
_RECOUNT: Final = 2.0  # s between counts of workers
_RECHECK: Final = 1.0  # s between checks of runs that another process does
_MAX_STOP: Final = 60.0  # s that runs have to end between two steps
_SYNC: Final = 1.0  # s after which the names of folders are on the disk itself
_SHORT: Final = 10.0
"""Runs of no more s are done by this process where there is one core for them: to start another
takes longer, and they need too little memory to be ended for want of it."""


def run_study(
    runs: Sequence[StudyRun],
    folder: str | Path,
    *,
    cores: int | None = None,
    scheduler: str | None = None,
    retry: bool = False,
    progress: Callable[[RunOutcome], None] | None = None,
) -> list[RunOutcome]:
    """Do all runs of a study that are not done; continue those that were begun.

    It may be stopped by anything, and called again: runs that are done are recognised by their
    folders, others continue from their last frame, with the same bits. Several processes may do it
    at the same time; each waits in the end for the runs that others do.

    - ``runs``: those of equal names are one
    - ``folder``: of the study; runs are in ``runs/<name>`` there
    - ``cores``, ``scheduler``: as in :func:`multicell.studies.workers.workers`
    - ``retry``: whether to try runs again that failed for what their scenes are, and to compute
      those anew whose folders are damaged; what was in these is set aside beside them. Runs that
      failed for another reason, such as a full disk, are tried again in any case; what cannot be
      read at this moment stays as it is.
    - ``progress``: called with each outcome once, in the order in which they come; with those that
      are known from before first

    Returns list of Outcome: in the order of ``runs``.

    Raises OutputError if the folder cannot be used; SceneError, MissingPackage, ClusterError as
    :func:`multicell.studies.workers.workers` and, for workers that do not see the folder,
    :func:`multicell.studies.workers.check_folder`: before anything runs. ``ClusterError`` with exit
    code 3 if the scheduler is lost later on; KeyboardInterrupt after Ctrl-C, once all runs have
    ended between two steps; all that they have is kept. A second one ends them at once.
    """
    folder = Path(folder).absolute()
    with file_errors("use the folder", folder):
        (folder / "runs").mkdir(parents=True, exist_ok=True)
    outcomes: dict[str, RunOutcome] = {}
    unsynced: list[str] = []
    synced = clock.monotonic()

    def report(outcome: RunOutcome) -> None:
        nonlocal synced
        outcomes[outcome.name] = outcome
        if not outcome.reused:
            unsynced.append(outcome.name)
            if clock.monotonic() - synced > _SYNC:
                _sync(folder, unsynced)
                synced = clock.monotonic()
        if progress is not None:
            progress(outcome)

    left: list[tuple[float, StudyRun]] = []
    for run in {run.name: run for run in runs}.values():
        found = run_status(run.name, folder, whole=retry)
        known = known_outcome(found, retry)
        if known is None:
            part = max(0.0, 1.0 - found.time / run.scene.duration)
            left.append((run.expected * part, run))
        else:
            report(known)
    ordered = [run for _, run in sorted(left, key=lambda entry: -entry[0])]
    short = not any(run.expected > _SHORT for run in ordered)
    if ordered:
        check_cores(cores)
        wanted = own_cores() if scheduler is None and cores is None else cores
        most = None if wanted is None else min(wanted, len(ordered))
        here = scheduler is None and most == 1 and short
        # what no worker could be given is refused here too
        plain = [PlainScene.of(run.scene) for run in ordered]
        tasks = [
            Task(run.name, str(folder), run.scene if here else scene, retry)
            for run, scene in zip(ordered, plain, strict=True)
        ]
        try:
            if here:
                _do_here(tasks, report)
            else:
                _do_there(tasks, folder, most, scheduler, report)
        finally:
            _sync(folder, unsynced + [run.name for run in ordered if run.name not in outcomes])
    return [outcomes[run.name] for run in runs]


def _sync(folder: Path, names: list[str]) -> None:
    """Have the names in folders of runs on the disk, which brief runs leave to us; forget these."""
    while names:
        sync_folder(run_folder(folder, names[-1]))  # an interrupt forgets none
        del names[-1]
    sync_folder(folder / "runs")


def _do_there(
    tasks: Sequence[Task],
    folder: Path,
    cores: int | None,
    scheduler: str | None,
    report: Callable[[RunOutcome], None],
) -> None:
    """Have workers do tasks, in their order."""
    with WHOLE_STEP, workers(cores, scheduler) as client:
        if scheduler is not None:
            check_folder(client, folder)
        work = _Work(client, deque(tasks), report)
        try:
            while work.left:
                WHOLE_STEP.deliver()
                work.advance()
        except KeyboardInterrupt:
            work.stop()
            raise


def _do_here(tasks: Sequence[Task], report: Callable[[RunOutcome], None]) -> None:
    """Do tasks in this process; wait in the end for those that other processes have."""
    with WHOLE_STEP, without_what_there_is():
        while tasks:
            held = []
            for work in tasks:
                WHOLE_STEP.deliver()
                outcome = do_run(work)
                if outcome.state == "held":
                    held.append(work)
                else:
                    report(outcome)
            tasks = held
            if held:
                clock.sleep(_RECHECK)


class _UnderWay(NamedTuple):
    """A task that a worker has, and how many frames its run had when the worker got it."""

    work: Task
    future: Any
    frames: int


@final
@dataclass
class _Work:
    """The tasks of a study, on their way from one place to the next."""

    client: Any
    waiting: deque[Task]
    report: Callable[[RunOutcome], None]
    under_way: dict[str, _UnderWay] = field(default_factory=dict)
    held: list[Task] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._ended: SimpleQueue[str] = SimpleQueue()
        self._checked_client = CheckedClient(self.client)
        self._threads = 0
        self._counted = self._checked = -1e9

    @property
    def left(self) -> int:
        """How many runs have not come to their ends."""
        return len(self.waiting) + len(self.under_way) + len(self.held)

    def advance(self) -> None:
        """Submit runs while workers are free, and collect those that have ended."""
        self._count()
        self._reclaim()
        while self.waiting and len(self.under_way) < self._threads:
            self._submit(self.waiting.popleft())
        try:
            self._take(self._ended.get(timeout=_POLL))
        except Empty:
            return

    def stop(self) -> None:
        """End all runs between two steps, and wait until they have."""
        if not self.under_way:
            return
        futures = [entry.future for entry in self.under_way.values()]
        try:
            bounded(lambda: self.client.cancel(futures), ANSWER)
        except Exception:  # the scheduler is silent, or gone: nobody hears of it
            return
        begin = clock.monotonic()
        places = [run_folder(Path(e.work.folder), e.work.name) for e in self.under_way.values()]
        while any(map(in_use, places)) and clock.monotonic() - begin < _MAX_STOP:
            clock.sleep(0.05)

    def _count(self) -> None:
        """Count the threads of all workers, and see whether there is a scheduler at all."""
        if clock.monotonic() - self._counted < _RECOUNT and self.client.status == "running":
            return
        try:
            found = self._checked_client.threads()
        except Exception as error:
            raise _scheduler_lost() from error
        cluster = self.client.cluster
        if cluster is not None and found < self._threads:
            cluster.scale(self._threads)  # for what could not be started again
        self._threads = max(found, self._threads if cluster is not None else 1)
        self._counted = clock.monotonic()

    def _reclaim(self) -> None:
        """Take back runs that another process had, and has no more."""
        if self.waiting or not self.held or clock.monotonic() - self._checked < _RECHECK:
            return
        self._checked = clock.monotonic()
        free = [e for e in self.held if not in_use(run_folder(Path(e.folder), e.name))]
        self.held = [entry for entry in self.held if entry not in free]
        self.waiting.extend(free)

    def _submit(self, work: Task) -> None:
        found = run_status(work.name, Path(work.folder))
        future = self._checked_client.submit(_on_worker, work, pure=False, retries=0)
        self.under_way[future.key] = _UnderWay(work, future, found.frames)
        future.add_done_callback(lambda ended: self._ended.put(ended.key))

    def _take(self, key: str) -> None:
        """Take the answer of a worker about a run, or of Dask about the worker."""
        entry = self.under_way.pop(key)
        if entry.future.status == "finished":
            outcome = self._result(entry)
        elif entry.future.status == "error":
            outcome = self._trouble(entry, entry.future.exception())
        else:
            raise _scheduler_lost()
        if outcome is not None and outcome.state == "held":
            self.held.append(entry.work)
        elif outcome is not None:
            self.report(outcome)

    def _result(self, entry: _UnderWay) -> RunOutcome | None:
        """Return the answer of a worker; None if it died with its answer, or refused."""
        try:
            outcome: RunOutcome | Refusal = entry.future.result(timeout=_RECOUNT)
        except Exception:
            self.waiting.appendleft(entry.work)  # its folder says how it ended
            return None
        if isinstance(outcome, Refusal):
            self.waiting.appendleft(entry.work)
            self._checked_client.note(outcome)
            return None
        return outcome

    def _trouble(self, entry: _UnderWay, error: BaseException) -> RunOutcome | None:
        """Return why a run failed of which no worker could say so; None to try it again.

        A run loses its workers by chance, too. It is given up where it got no frame further until
        Dask gave it up.
        """
        from distributed.scheduler import KilledWorker

        work, folder = entry.work, Path(entry.work.folder)
        if isinstance(error, KilledWorker):
            if run_status(work.name, folder).frames > entry.frames:
                self.waiting.appendleft(work)
                return None
            reason = (
                f"its worker process died {error.allowed_failures + 1} times, such as by the "
                "system for want of memory, and the run got no frame further"
            )
        else:
            said = " ".join(str(error).split())
            reason = f"its worker could not begin it: {type(error).__name__}: {said[:300]}"
        place = run_folder(folder, work.name)
        kind: Kind = "run" if isinstance(error, KilledWorker) else "machine"
        try:
            place.mkdir(exist_ok=True)
            write_note(place, reason, kind)
        except (OSError, OutputError) as trouble:
            reason = f"{reason} ({trouble})"
        return RunOutcome(work.name, "failed", reason, kind=kind)


def _scheduler_lost() -> ClusterError:
    return ClusterError(
        "the scheduler has gone",
        "All that runs have saved is kept: run the study again, and it continues",
        exit_code=ExitCode.MACHINE,
    )


def _on_worker(work: Task) -> RunOutcome:
    """Do a run in a worker of Dask, as long as somebody waits for it."""
    from distributed import get_worker

    worker: Any = get_worker()
    key = worker.get_current_task()
    tasks = worker.state.tasks

    def wanted() -> bool:
        """Say whether scheduler and client are there, and none has taken the task back."""
        known = tasks.get(key)
        here = worker.status.name in ("running", "paused")
        return here and known is not None and known.state == "executing"

    return do_run(work, wanted)


_ATTEMPTS: Final = 5  # how often a folder is looked at that another process changes meanwhile


@final
@dataclass(frozen=True)
class RunOutcome:
    """How a run ended.

    - ``state``: ``"done"``, ``"failed"``, or ``"held"`` where another process works on it
    - ``reason``, ``kind``: why it failed, in words, and what for; otherwise empty strings
    - ``wall``: wall time that it took now, s; none for what was there
    - ``reused``: whether it had been done, or had failed, before
    - ``made``: versions of what has computed it now
    """

    name: str
    state: str
    reason: str = ""
    wall: float = 0.0
    reused: bool = False
    made: Mapping[str, str] = field(default_factory=dict)
    kind: Kind = ""


@final
@dataclass(frozen=True)
class Task:
    """A run as it travels to a worker: plain values only.

    - ``folder``: of the study
    - ``scene``: as it is where this process does the run
    - ``retry``: whether a run that failed, or whose folder is damaged, is tried again
    """

    name: str
    folder: str
    scene: PlainScene | Scene
    retry: bool


@final
class Stopped(BaseException):
    """Ends a run between two steps, since nobody waits for it any more."""


def do_run(work: Task, wanted: Callable[[], bool] = lambda: True) -> RunOutcome:
    """Do one run in its folder, unless it is done; this is all that a worker does.

    - ``wanted``: asked between steps; where it answers no the run ends there, and can be continued
    """
    begin = clock.perf_counter()
    place = run_folder(Path(work.folder), work.name)
    try:
        outcome = _attempt(work, place, wanted)
    except Stopped:
        outcome = RunOutcome(work.name, "held", "stopped")
    except Exception as error:
        if isinstance(error, OutputError) and error.in_use:
            return RunOutcome(work.name, "held")
        reason, kind = _in_words(error)
        with suppress(OutputError):  # where the disk is full there is no room for the reason either
            write_note(place, reason, kind)
        outcome = RunOutcome(work.name, "failed", reason, kind=kind)
    wall = clock.perf_counter() - begin
    return outcome if outcome.reused else replace(outcome, wall=wall, made=own_versions())


def _in_words(error: Exception) -> tuple[str, Kind]:
    """Return why a run failed, and what that was a matter of."""
    if isinstance(error, MulticellError | OSError) and exit_code_of(error) == ExitCode.MACHINE:
        return str(error), "machine"
    if isinstance(error, OutputError):
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


def _attempt(work: Task, place: Path, wanted: Callable[[], bool]) -> RunOutcome:
    """Do a run from wherever it stands; another process may come first at any moment."""
    for left in reversed(range(_ATTEMPTS)):
        found = run_status(work.name, Path(work.folder), whole=work.retry)
        if found.state == "running":
            return RunOutcome(work.name, "held")
        known = known_outcome(found, work.retry)
        if known is not None:
            return known
        try:
            _forward(work, place, found, wanted)
            return RunOutcome(work.name, "done")
        except OutputError as error:
            # what has gone since it was looked at, another process may have changed
            if error.exit_code == ExitCode.MACHINE or not left:
                raise
    raise AssertionError("unreachable")


def known_outcome(found: RunStatus, retry: bool) -> RunOutcome | None:
    """Return how a run ended that is not to be worked on any more; None for all others."""
    if found.state == "done":
        return RunOutcome(found.name, "done", reused=True)
    if found.kind == "unreadable":
        return RunOutcome(found.name, "failed", found.reason, kind=found.kind)
    if found.state == "failed" and not (retry or found.kind == "machine"):
        return RunOutcome(found.name, "failed", found.reason, reused=True, kind=found.kind)
    return None


def _forward(work: Task, place: Path, found: RunStatus, wanted: Callable[[], bool]) -> None:
    """Begin or continue a run, up to its end."""
    from multicell import runner

    def between(_: Simulation) -> None:
        if not wanted():
            raise Stopped

    scene = work.scene.load() if isinstance(work.scene, PlainScene) else work.scene
    if not wanted():
        raise Stopped
    options = runner.RunOptions(output=place, threads=1, progress=between, brief=True)
    if found.frames and found.kind != "damage":
        remove(place, [NOTE])
        runner.record_resumed(place, options, planned=True)
    else:
        _empty(work, place)
        call_with_room(partial(runner.record_run, scene, options))


def _empty(work: Task, place: Path) -> None:
    """Remove the folder of a run that was killed before its first frame; set aside damage."""
    if not place.is_dir():
        return
    with lock_folder(place):
        now = run_status(work.name, Path(work.folder), ours=True, whole=work.retry)
        if now.kind == "damage":
            _set_aside(place)
        elif now.kind == "unreadable":
            raise OutputError(now.reason, exit_code=ExitCode.MACHINE)
        elif not (now.frames or now.state == "done"):
            remove(place, (*PASSING, *RUN_FILES, *copied_files(place), NOTE))


def _set_aside(place: Path) -> None:
    """Move all that is in the folder of a run to a new folder beside it, of which nothing is read.

    The folder itself stays, with its lock.
    """
    with file_errors("set aside", place):
        numbers = itertools.count(1)
        while (aside := place.with_name(f"{place.name}.damaged-{next(numbers)}")).exists():
            pass
        aside.mkdir()
        for entry in list(place.iterdir()):
            if entry.name != LOCK:
                entry.rename(aside / entry.name)
