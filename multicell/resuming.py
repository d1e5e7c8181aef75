"""Going on with a run from one of its frames."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from multicell.errors import OutputError, SceneError
from multicell.frames import open_frames, open_history, open_lineage
from multicell.interrupts import between_steps
from multicell.lineage import Lineage
from multicell.running import Recorder, finished, go_on
from multicell.simulation import Simulation
from multicell.store import Store
from multicell.threads import thread_count

if TYPE_CHECKING:
    from multicell.frame import Frame
    from multicell.frames import Frames
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
    from multicell.scene import load_scene

    begin = clock.perf_counter()
    folder = Path(folder)
    frames = open_frames(folder)
    place = _place(frames, frame, folder)
    scene = _changed(load_scene(folder / "scene.toml"), changes or {})
    start = frames[place]
    lineage = open_lineage(folder, place)
    threads = thread_count(threads)
    simulation = _simulation(scene, start, lineage, threads, folder)
    with ExitStack() as stack:
        interrupt = stack.enter_context(between_steps())
        store = _copied(frames, place, folder, output, scene, overwrite)
        recorder = Recorder(scene, store)
        stack.callback(recorder.close)
        recorder.skip(start)
        recorder.startup = clock.perf_counter() - begin
        go_on(simulation, recorder, interrupt, progress)
    return finished(recorder, report)


def _place(frames: Frames, frame: int, folder: Path) -> int:
    """Return the number of a frame from the first."""
    count = len(frames)
    place = frame + count if frame < 0 else frame
    if not 0 <= place < count:
        have = f"it has the frames 0 to {count - 1}" if count else "it has no frames"
        raise OutputError(f"the run in '{folder}' has no frame {frame}: {have}")
    return place


def _simulation(
    scene: Scene, start: Frame, lineage: Lineage, threads: int, folder: Path
) -> Simulation:
    """Return the simulation at a frame, or say why it cannot go on."""
    if start.progress is None:
        raise OutputError(
            f"the frame at {start.time:g} s in '{folder}' does not hold what a run needs to go on"
        )
    simulation = Simulation(scene, threads=threads, frame=start, lineage=lineage)
    if simulation.finished:
        raise OutputError(
            f"the run in '{folder}' ends with the frame at {start.time:g} s. "
            "To prolong it, change duration or stop_cells"
        )
    return simulation


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


def _copied(
    frames: Frames,
    place: int,
    folder: Path,
    output: str | Path | None,
    scene: Scene,
    overwrite: bool,
) -> Store:
    """Return a store that holds all that came up to a frame."""
    here = output is None or Path(output).resolve() == folder.resolve()
    history = open_history(folder)
    lineages = [open_lineage(folder, k) for k in range(place + 1)]
    store = Store.create(folder if here else Path(output or folder), scene, overwrite, part=here)
    last = frames[place].step
    rows = int((history["step"] <= last).sum()) if history else 0
    for k in range(rows):
        store.append_history({name: float(column[k]) for name, column in history.items()})
    for k in range(place + 1):
        store.append(frames[k], lineages[k])
    if here:
        store.settle(scene)
    return store
