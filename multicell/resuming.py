"""Going on with a run from one of its frames."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from multicell.errors import OutputError, SceneError
from multicell.folder import locked
from multicell.frames import Contents
from multicell.interrupts import between_steps
from multicell.records import can_go_on
from multicell.result import read_summary, recorded_scene
from multicell.running import Recorder, finished, go_on, under_way
from multicell.simulation import Simulation
from multicell.store import Store
from multicell.threads import thread_count

if TYPE_CHECKING:
    from multicell.result import Result
    from multicell.scene import Scene

_MAY_CHANGE = ("duration", "stop_cells", "title", "output", "integrator")
_OF_A_NUTRIENT = ("boundary", "media", "media_change", "sides", "perfusion")


def resume(
    folder: str | Path,
    frame: int = -1,
    *,
    output: str | Path | None = None,
    changes: Mapping[str, Any] | None = None,
    overwrite: bool = False,
    threads: int | None = None,
    progress: Callable[[Simulation], None] | None = None,
    report: bool = True,
) -> Result:
    """Go on with a run from a frame; without changes it becomes what it would have been.

    A run that has come to its end but could not write all of its results (disk full) is finished
    now.

    Parameters
    ----------
    folder
        Of the run, finished or not.
    frame
        Number of the frame; negative ones count from the last.
    output
        Folder for the run with what came before the frame; by default that of the run, in which
        what came after the frame is replaced. Until the part before is copied nothing is lost.
    changes
        Dotted keys with new values, as in :meth:`Scene.with_changes`: of what may change while
        a run goes on, such as ``duration``, ``stop_cells``, ``output.every`` or the medium.
    overwrite
        Whether an earlier run in ``output`` may be replaced.
    threads, progress, report
        As for :func:`multicell.run`.

    Returns
    -------
    Result

    Raises
    ------
    OutputError
        For a folder without results that can be resumed, a frame that is not there, and a run
        that has come to its end.
    SceneError
        For changes that cannot be made.
    StepFailed
        As for :func:`multicell.run`.
    """
    begin = clock.perf_counter()
    folder = Path(folder)
    here = output is None or Path(output).resolve() == folder.resolve()
    with ExitStack() as stack:
        contents = Contents(folder)
        if here:
            stack.enter_context(locked(folder))
            contents = Contents(folder)  # another run may have come first
        place = _place(contents, frame)
        _check_damage(contents, frame, here)
        scene = _changed(recorded_scene(contents), changes or {})
        threads = thread_count(threads)
        simulation = _simulation(scene, contents, place, threads)
        rows = _rows(contents, simulation.step_index)
        interrupt = stack.enter_context(between_steps())
        if here:
            for k in range(place):  # what is damaged is better known before the run than after it
                contents.frame(k)
            store = Store.go_on(contents, place, rows, scene)
        else:
            store = Store.create(Path(output or folder), scene, overwrite)
        recorder = Recorder(scene, store)
        stack.callback(recorder.close)
        stack.enter_context(under_way())
        if not here:
            store.copy(contents, place, rows)
        recorder.skip(contents.frame(place))
        recorder.startup = clock.perf_counter() - begin
        go_on(simulation, recorder, interrupt, progress)
    return finished(recorder, report)


def _place(contents: Contents, frame: int) -> int:
    """Return the number of a frame from the first."""
    count = len(contents.places)
    place = frame + count if frame < 0 else frame
    if not 0 <= place < count:
        have = f"it has the frames 0 to {count - 1}" if count else "it has no frames"
        raise OutputError(f"the run in '{contents.folder}' has no frame {frame}: {have}")
    return place


def _check_damage(contents: Contents, frame: int, here: bool) -> None:
    """Let a run with a damaged journal go on from a frame that was named, and elsewhere."""
    if contents.damage is not None and (frame < 0 or here):
        contents.whole()


def _simulation(scene: Scene, contents: Contents, place: int, threads: int) -> Simulation:
    """Return the simulation at a frame, or say why it cannot go on."""
    folder, start = contents.folder, contents.frame(place)
    if start.progress is None:
        raise OutputError(
            f"the frame at {start.time:g} s in '{folder}' does not hold what a run needs to go on"
        )
    problem = can_go_on(start)
    if problem:
        raise OutputError(f"no run can go on from the frame at {start.time:g} s: {problem}")
    lineage = contents.lineage(place)
    simulation = Simulation(scene, threads=threads, frame=start, lineage=lineage)
    if simulation.finished and _complete(contents):
        raise OutputError(
            f"the run in '{folder}' ends with the frame at {start.time:g} s. "
            "To prolong it, change duration or stop_cells"
        )
    return simulation


def _rows(contents: Contents, step: int) -> int:
    """Return how many rows of the history there are up to a step."""
    steps = contents.history().get("step", np.empty(0))
    rows = int((steps <= step).sum())
    if rows != step + 1:
        raise OutputError(
            f"the history in '{contents.folder}' has {rows} rows up to step {step}, must have "
            f"{step + 1}: no run can go on from there"
        )
    return rows


def _complete(contents: Contents) -> bool:
    """Return whether a run has written all that it writes at its end."""
    summary = read_summary(contents.folder / "summary.json")
    return contents.journal is None and summary is not None and not summary.get("interrupted")


def _changed(scene: Scene, changes: Mapping[str, Any]) -> Scene:
    """Return the scene with changes that may be made while a run goes on."""
    for key in changes:
        parts = key.split(".")
        free = parts[0] in _MAY_CHANGE
        if parts[0] == "nutrients" and len(parts) > 2:
            free = parts[2] in _OF_A_NUTRIENT
        if not free:
            allowed = ", ".join([*_MAY_CHANGE, *(f"nutrients.<name>.{k}" for k in _OF_A_NUTRIENT)])
            raise SceneError(key, "cannot change while a run goes on", f"Allowed: {allowed}")
    return scene.with_changes(changes)
