"""From a scene to a result: the loop with its record on disk."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, final

from multicell.errors import OutputError
from multicell.folder import write_summary
from multicell.frame import Frame
from multicell.interrupts import between_steps
from multicell.quantities import units_of
from multicell.result import Result, history_arrays
from multicell.simulation import Simulation
from multicell.threads import thread_count

if TYPE_CHECKING:
    from multicell.lineage import Lineage
    from multicell.scene import Scene
    from multicell.store import Store


def run(
    scene: Scene,
    *,
    output: str | Path | None = None,
    integrator: str | None = None,
    overwrite: bool = False,
    threads: int | None = None,
    progress: Callable[[Simulation], None] | None = None,
    report: bool = True,
) -> Result:
    """Run a scene from its start to its end.

    Parameters
    ----------
    scene
        What to run.
    output
        Folder for scene, frames, summary and report; None keeps all in memory.
    integrator
        Name of an integration method, instead of the scene's.
    overwrite
        Whether an earlier run in the folder may be replaced.
    threads
        Number of threads for large populations, by default all; it does not change results.
    progress
        Called after every coupling step.
    report
        Whether to write pictures and ``report.html``; only with a folder.

    Returns
    -------
    Result

    Raises
    ------
    SceneError, OutputError
        For input that cannot be used, before the first step.
    OutputError
        With exit code 1 if results cannot be written later on, for example because the disk is
        full. What was saved before can be read, and resumed when there is room.
    StepFailed
        If a step cannot be solved. Like after Ctrl-C, the folder then holds all frames so far,
        the history and a summary with ``"interrupted": true``.
    """
    if integrator is not None:
        scene = scene.with_changes({"integrator": integrator})
    begin = clock.perf_counter()
    threads = thread_count(threads)  # before the folder is made
    recorder = Recorder(scene, _open_store(scene, output, overwrite))
    with ExitStack() as stack:
        stack.enter_context(under_way())
        interrupt = stack.enter_context(between_steps())
        stack.callback(recorder.close)
        simulation = Simulation(scene, threads=threads)
        recorder.startup = clock.perf_counter() - begin
        recorder.record(simulation)
        go_on(simulation, recorder, interrupt, progress)
    return finished(recorder, report)


def go_on(
    simulation: Simulation,
    recorder: Recorder,
    interrupt: Callable[[], None],
    progress: Callable[[Simulation], None] | None,
) -> None:
    """Advance to the scene's end and record each step; ``interrupt`` may end it between two."""
    try:
        while not simulation.finished:
            simulation.step()
            recorder.record(simulation)
            if progress is not None:
                progress(simulation)
            interrupt()
    except OutputError as error:
        # what cannot be written now cannot be finished either
        raise OutputError(
            f"{error}. The run stopped at {simulation.time:g} s; what was saved before can be "
            "read, and 'multicell resume' goes on from it when there is room"
        ) from error
    except BaseException as error:
        try:
            recorder.finish(simulation, interrupted=True)
        except OutputError as trouble:
            error.add_note(str(trouble))  # the first error is the one that counts
        raise
    recorder.finish(simulation, interrupted=False)


@contextmanager
def under_way() -> Iterator[None]:
    """Count what cannot be written from now on as a failure of the run, not as bad input."""
    try:
        yield
    except OutputError as error:
        error.exit_code = 1
        raise


def finished(recorder: Recorder, report: bool) -> Result:
    """Return the result of a run that has ended, with its report if there is a folder."""
    with under_way():
        result = recorder.result()
        if report and result.folder is not None:
            try:
                result.report()
            except OutputError as error:
                raise OutputError(
                    f"{error}. The run is complete; only its report is missing: "
                    f"multicell.load_result({str(result.folder)!r}).report() writes it"
                ) from error
    return result


@final
class Recorder:
    """Frames and history of a run, on disk or in memory."""

    def __init__(self, scene: Scene, store: Store | None) -> None:
        self._scene = scene
        self._store = store
        self._lineage: Lineage | None = None
        self._frames: list[Frame] = []
        self._rows: list[dict[str, float]] = []
        self._next_frame = 0.0
        self._last_frame = -1
        self._summary: dict[str, object] = {}
        self.startup = 0.0

    def record(self, simulation: Simulation) -> None:
        """Add a row to the history, and a frame if one is due."""
        begin = clock.perf_counter()
        row = simulation.history_row()
        if self._store is None:
            self._rows.append(row)
        else:
            self._store.append_history(row)
        if simulation.time >= self._next_frame * (1.0 - 1e-12) or simulation.finished:
            self._frame(simulation)
        simulation.wall["record"] += clock.perf_counter() - begin

    def skip(self, frame: Frame) -> None:
        """Go on after a frame that is recorded already."""
        self._last_frame = frame.step
        self._count_frames(frame.time)

    def finish(self, simulation: Simulation, *, interrupted: bool) -> None:
        """Write the last state and the summary."""
        if simulation.step_index > self._last_frame:
            self._frame(simulation)
        self._summary = simulation.summary()
        wall = self._summary["wall"]
        assert isinstance(wall, dict)
        wall["startup"] = self.startup
        self._summary["units"] = units_of(self._summary)
        if interrupted:
            self._summary["interrupted"] = True
        if self._store is not None:
            self._store.settle()
            write_summary(self._store.folder, self._summary)

    def close(self) -> None:
        """Close the files."""
        if self._store is not None:
            self._store.close()

    def result(self) -> Result:
        """Return the result of a run that has ended."""
        if self._store is None:
            history = history_arrays(self._rows)
            lineage = {} if self._lineage is None else self._lineage.table()
            return Result(None, self._frames, history, self._summary, self._scene, lineage)
        from multicell.result import load_result

        return load_result(self._store.folder)

    def _frame(self, simulation: Simulation) -> None:
        self._count_frames(simulation.time)
        self._last_frame = simulation.step_index
        self._lineage = simulation.lineage
        frame = simulation.frame()
        if self._store is None:
            self._frames.append(frame)
        else:
            self._store.append(frame, simulation.lineage)

    def _count_frames(self, time: float) -> None:
        """Find when the next frame after a time is due."""
        every, now = self._scene.output.every, time * (1.0 + 1e-12)
        due = (math.floor(now / every) + 1) * every
        # where the frames are closer than the rounding of the time, the next step has one
        self._next_frame = max(due, math.nextafter(now, math.inf))


def _open_store(scene: Scene, output: str | Path | None, overwrite: bool) -> Store | None:
    if output is None:
        return None
    from multicell.store import Store

    return Store.create(output, scene, overwrite)
