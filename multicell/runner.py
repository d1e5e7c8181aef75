"""From a scene to a result: the loop with its record on disk."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial, wraps
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, final

from multicell.compiling.threads import thread_count
from multicell.errors import ExitCode, OutputError, SceneError
from multicell.host.call_stack import call_with_room
from multicell.host.interrupts import UNCUT, WHOLE_STEP
from multicell.host.memory import Returns, peak
from multicell.integrators.base import info_of
from multicell.integrators.own import own_integrator
from multicell.precompile import Precompilation
from multicell.report.bar import progress_callback
from multicell.report.result import Result, history_columns, load_result, recorded_scene
from multicell.report.wording import time_unit
from multicell.results.documents import read_document, write_table
from multicell.results.folder import lock_folder
from multicell.results.frame import Frame
from multicell.results.measures import check_observables
from multicell.results.quantities import units_of
from multicell.results.summary import scene_mark
from multicell.scene.scene import Scene, load_scene
from multicell.schema import near_miss, specs
from multicell.simulation import Simulation
from multicell.simulation.start_check import check_population
from multicell.units import shown

if TYPE_CHECKING:
    from multicell.integrators.base import Integrator
    from multicell.nutrient.reactions.own import OwnReaction
    from multicell.report.live import LivePage
    from multicell.results.lineage import Lineage
    from multicell.results.reader import Contents
    from multicell.results.writer import Store


P = ParamSpec("P")


@final
@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """How a scene is run; see :func:`run` for the meaning of each option."""

    output: str | Path | None = None
    integrator: str | type[Integrator] | Integrator | None = None
    overwrite: bool = False
    threads: int | None = None
    progress: Callable[[Simulation], None] | bool | None = None
    reactions: Mapping[str, OwnReaction] | None = None
    live: bool = False  # whether the folder has a picture that renews itself until the report
    brief: bool = False  # whether nothing is written if the run is killed in its first second


def _refusing_scene_keys(function: Callable[P, Result]) -> Callable[P, Result]:
    """Refuse options that a function does not have in words: many are keys of the scene."""
    known = signature(function).parameters
    positional = sum(p.kind is p.POSITIONAL_OR_KEYWORD for p in known.values())

    @wraps(function)
    def called(*given: P.args, **options: P.kwargs) -> Result:
        if len(given) > positional:
            hint = f"For example output={shown(given[positional])}."
            raise SceneError("", f"options of multicell.{function.__name__} have names", hint)
        for name in options:
            if name not in known:
                hint = near_miss(name, known)
                if name in specs(Scene):
                    hint = f"It is a key of the scene: scene.with_changes({name}=...)."
                raise SceneError(name, f"is no option of multicell.{function.__name__}", hint)
        return call_with_room(partial(function, *given, **options))

    return called


@_refusing_scene_keys
def run(
    scene: Scene | str | Path,
    *,
    output: str | Path | None = None,
    integrator: str | type[Integrator] | Integrator | None = None,
    overwrite: bool = False,
    threads: int | None = None,
    progress: Callable[[Simulation], None] | bool | None = None,
    report: bool = True,
    reactions: Mapping[str, OwnReaction] | None = None,
    cells: Any = None,
) -> Result:
    """Run a scene from its start to its end.

    Parameters
    ----------
    scene
        What to run: a scene, the name of a built-in one, or the path of a TOML file.
    output
        Folder for scene, frames, summary and report; None keeps all in memory.
    integrator
        Name of an integration method, instead of the scene's; or a method of the user's own
        (:class:`multicell.Integrator`): an object, a class that is made with the scene's options,
        or ``"file.py:Name"``. The folder records where it came from.
    overwrite
        Whether an earlier run in the folder may be replaced.
    threads
        Number of threads for large populations, by default all; it does not change results.
    progress
        True for a bar, in terminals and notebooks; or what is called after every coupling step.
    report
        Whether to write pictures and ``report.html``; only with a folder.
    reactions
        Name -> reaction of the user's own between fields (:func:`multicell.reaction`), besides
        those of the scene. The folder does not hold them: to resume the run needs them again.
    cells
        Cells to start with, in place of those of the scene: :class:`multicell.Cells` (of a frame),
        a pandas ``DataFrame``, columns by title, or the path of a table (CSV, Parquet, Excel,
        AnnData) with columns as an export has them (``position_x_um``) or of a known program; what
        else the columns are: ``{"file": "spots.csv", "columns": "x=X um, ..."}``. The folder holds
        them as
        ``initial.cells`` of its scene, so that the run can be repeated.

    Returns
    -------
    Result

    Raises
    ------
    DataError
        With row and column, for cells that cannot start in the scene.
    SceneError, OutputError
        For input that cannot be used, before the first step.
    OutputError
        With exit code 3 if results cannot be written later on, for example because the disk is
        full. What was saved before can be read, and resumed when there is room.
    StepFailed
        If a step cannot be solved. Like after Ctrl-C, the folder then holds all frames so far,
        the history and a summary with ``"interrupted": true``.
    """
    if isinstance(scene, str | Path):
        scene = load_scene(scene)
    if not isinstance(scene, Scene):
        raise SceneError("", f"the scene is {shown(scene)}, must be a Scene, a name or a path")
    options = RunOptions(
        output=output,
        integrator=integrator,
        overwrite=overwrite,
        threads=threads,
        progress=progress,
        reactions=reactions,
        live=report,
    )
    return finish_run(record_run(scene, options, cells), report)


def record_run(scene: Scene, options: RunOptions, cells: Any = None) -> Recorder:
    """Run a scene as :func:`run` does, and read nothing back of what was written."""
    if cells is not None:
        from multicell.scene.start_table import with_cells

        scene = with_cells(scene, cells)
    if scene.initial.cells is not None:
        from multicell.scene.start_checks import check_start_table

        check_start_table(scene)  # before the folder is made
    if options.output is not None and not isinstance(options.output, str | Path):
        raise OutputError(f"the output folder is {shown(options.output)}, must be a path")
    check_population(scene)
    check_observables(scene)
    scene, own = integrated_by(scene, options.integrator)
    begin = clock.perf_counter()
    threads = thread_count(options.threads)  # before the folder is made
    store = None
    if options.output is not None:
        from multicell.results.writer import Store  # HDF5 is loaded where there is a folder only

        store = Store.create(options.output, scene, options.overwrite, brief=options.brief)
    recorder = Recorder(scene, store)
    with ExitStack() as stack:
        stack.enter_context(failing_as_run())
        interrupt = stack.enter_context(WHOLE_STEP).deliver
        stack.callback(recorder.close)
        if options.live:
            stack.enter_context(recorder.shown_live())
        precompilation = None
        if own is None:
            precompilation = Precompilation(scene, threads)
            stack.callback(precompilation.close)
        simulation = Simulation(scene, threads=threads, integrator=own, reactions=options.reactions)
        recorder.note_startup(simulation, begin)
        recorder.record(simulation)
        advance_run(simulation, recorder, interrupt, options.progress, precompilation)
    return recorder


def integrated_by(
    scene: Scene, integrator: str | type[Integrator] | Integrator | None
) -> tuple[Scene, Integrator | None]:
    """Return a scene that names a method, and the integrator if it is one of the user's own."""
    if integrator is None:
        return scene, None
    if isinstance(integrator, str) and ":" not in integrator:
        return scene.with_changes({"integrator": integrator}), None
    options, own = own_integrator(integrator, scene.integrator)
    refused = info_of(own).refusal(scene.initial.count, friction=scene.friction is not None)
    if refused is not None:
        raise SceneError("integrator.method", *refused)
    return replace(scene, integrator=options), own


def advance_run(
    simulation: Simulation,
    recorder: Recorder,
    interrupt: Callable[[], None],
    progress: Callable[[Simulation], None] | bool | None,
    precompilation: Precompilation | None = None,
) -> None:
    """Advance to the scene's end and record each step; ``interrupt`` may end it between two."""
    try:
        with progress_callback(simulation.scene, progress) as note:
            while not simulation.finished:
                simulation.step()
                recorder.record(simulation)
                if precompilation is not None:
                    precompilation.watch(simulation)
                if note is not None:
                    note(simulation)
                interrupt()
    except OutputError as error:
        # what cannot be written now cannot be finished either
        raise OutputError(
            f"{error}. The run stopped at {simulation.time:g} s; what was saved before can be "
            "read, and 'multicell resume' continues from it once there is room"
        ) from error
    except BaseException as error:
        try:
            recorder.finish(simulation, interrupted=True)
        except OutputError as trouble:
            error.add_note(str(trouble))  # the first error is the one that counts
        raise
    finally:
        if precompilation is not None:
            precompilation.close()
    recorder.finish(simulation, interrupted=False)


@contextmanager
def failing_as_run() -> Iterator[None]:
    """Count what cannot be written from now on as a failure of the machine, not as bad input."""
    try:
        yield
    except OutputError as error:
        error.exit_code = ExitCode.MACHINE
        raise


def finish_run(recorder: Recorder, report: bool) -> Result:
    """Return the result of a run that has ended, with its report if there is a folder."""
    with failing_as_run():
        try:
            result = recorder.result()
            if report and result.folder is not None:
                _report(result)
        finally:
            recorder.end_live()  # what it shows is replaced by the report
    return result


def _report(result: Result) -> None:
    try:
        result.report()
    except OutputError as error:
        raise OutputError(
            f"{error}. The run is complete; only its report is missing: "
            f"multicell.load_result({str(result.folder)!r}).report() writes it"
        ) from error


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
        self._last_frame = self._last_row = -1
        self._summary: dict[str, Any] = {}
        self._memory = Returns()
        self._begin = self._startup = 0.0
        self._live: LivePage | None = None

    @contextmanager
    def shown_live(self, simulation: Simulation | None = None) -> Iterator[None]:
        """Show the tissue in the folder from now on, until :meth:`end_live` or an exception.

        - ``simulation``: absent while it is not ready yet
        """
        if self._store is None:
            yield
            return
        from multicell.report.live import LivePage

        self._live = LivePage(self._store.folder, self._scene)
        try:
            self._live.open(simulation)
            yield
        except BaseException:
            with suppress(OutputError):  # the first error is the one that counts
                self.end_live()
            raise

    def end_live(self) -> None:
        """Remove the page that shows the tissue, if there is one."""
        if self._live is not None:
            self._live.close()

    def note_startup(self, simulation: Simulation, begin: float) -> None:
        """Note that all is ready since a moment of the clock, for the account of wall time."""
        self._begin = begin
        self._startup = clock.perf_counter() - begin - sum(simulation.wall.values())

    def record(self, simulation: Simulation) -> None:
        """Add a row to the history, and a frame if one is due."""
        with simulation.phase("record"):
            row = simulation.history_row()
            if self._store is None:
                self._rows.append(row)
            else:
                self._store.append_history(row)
            self._last_row = simulation.step_index  # a row that an exception kept out is none
            if frame_due(simulation.time, self._next_frame) or simulation.finished:
                self._frame(simulation)
            self._memory.now_and_then(len(simulation.state.cells))
            if self._live is not None:
                self._live.note(simulation)

    def skip(self, frame: Frame) -> None:
        """Go on after a frame that is recorded already."""
        self._last_frame = self._last_row = frame.step
        self._next_frame = next_frame(self._scene.output.every, frame.time)

    def finish(self, simulation: Simulation, *, interrupted: bool) -> None:
        """Write the last state and the summary; signals wait for the end."""
        with UNCUT:
            self._finish(simulation, interrupted=interrupted)

    def _finish(self, simulation: Simulation, *, interrupted: bool) -> None:
        with simulation.phase("record"):
            # an observable of the user's own may have failed: no run could resume from there
            if self._last_frame < simulation.step_index == self._last_row:
                self._frame(simulation)
            if self._store is not None:
                self._store.settle()
        self._summary = simulation.summary()
        self._summary["wall"] = self._account(simulation)
        self._summary["peak_memory"] = peak()
        self._summary["units"] = units_of(self._summary)
        if interrupted:
            self._summary["interrupted"] = True
        if self._store is not None:
            self._summary["scene_digest"] = scene_mark(self._store.scene)
            path, synced = self._store.folder / "summary.json", not self._store.is_brief
            write_table(path, self._summary, synced=synced)

    def _account(self, simulation: Simulation) -> dict[str, float]:
        """Return the wall time from the start on by phases, which add up to the total, s."""
        parts = {"startup": self._startup, **simulation.wall}
        total = clock.perf_counter() - self._begin
        return {**parts, "rest": total - sum(parts.values()), "total": total}

    def close(self) -> None:
        """Close the files."""
        if self._store is not None:
            self._store.close()

    def result(self) -> Result:
        """Return the result of a run that has ended."""
        if self._store is None:
            history = history_columns(self._rows)
            lineage = {} if self._lineage is None else self._lineage.table()
            return Result(None, self._frames, history, self._summary, self._scene, lineage)
        return load_result(self._store.folder)

    def _frame(self, simulation: Simulation) -> None:
        frame = simulation.frame(shared=True)
        self.skip(frame)
        self._lineage = simulation.lineage
        if self._store is None:
            self._frames.append(frame)
        else:
            self._store.append(frame, simulation.lineage)


def frame_due(time: float, planned: float) -> bool:
    """Return whether a frame that is planned for a time is due, both in s."""
    return time >= planned * (1.0 - 1e-12)


def next_frame(every: float, time: float) -> float:
    """Return when the next frame is due after a time: at a multiple of ``every``, all in s."""
    now = time * (1.0 + 1e-12)
    due = (math.floor(now / every) + 1) * every
    # where the frames are closer than the rounding of the time, the next step has one
    return max(due, math.nextafter(now, math.inf))


_MAY_CHANGE = ("duration", "stop_cells", "title", "output", "integrator")
_OF_A_NUTRIENT = ("boundary", "media", "media_change", "sides", "perfusion")


@_refusing_scene_keys
def resume(
    folder: str | Path,
    frame: int = -1,
    *,
    output: str | Path | None = None,
    changes: Mapping[str, Any] | None = None,
    integrator: str | type[Integrator] | Integrator | None = None,
    overwrite: bool = False,
    threads: int | None = None,
    progress: Callable[[Simulation], None] | bool | None = None,
    report: bool = True,
    reactions: Mapping[str, OwnReaction] | None = None,
) -> Result:
    """Resume a run from a frame; without changes the result is that of one uninterrupted run.

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
        Dotted keys with new values, as in :meth:`Scene.with_changes`: keys that may change
        during a run, such as ``duration``, ``stop_cells``, ``output.every`` or the medium.
    integrator
        As for :func:`multicell.run`; a run by a method of the user's own needs it again.
    overwrite
        Whether an earlier run in ``output`` may be replaced.
    threads, progress, report
        As for :func:`multicell.run`.
    reactions
        As for :func:`multicell.run`: those that the run was started with.

    Returns
    -------
    Result

    Raises
    ------
    OutputError
        For a folder without results that can be resumed, a frame that is not there, and a run
        that has come to its end.
    SceneError
        For changes that cannot be made: of a key that must not change, and of ``duration`` and
        ``stop_cells`` to what the frame is beyond already.
    StepFailed
        As for :func:`multicell.run`.
    """
    options = RunOptions(
        output=output,
        integrator=integrator,
        overwrite=overwrite,
        threads=threads,
        progress=progress,
        reactions=reactions,
        live=report,
    )
    return finish_run(record_resumed(folder, options, frame, changes=changes), report)


def record_resumed(
    folder: str | Path,
    options: RunOptions,
    frame: int = -1,
    *,
    changes: Mapping[str, Any] | None = None,
    planned: bool = False,
) -> Recorder:
    """Resume a run as :func:`resume`, without reading the results back.

    Where only ``planned`` frames are to be kept, and the run continues in its own folder, one that
    an interruption has added is left out once the run has continued from it: the folder becomes
    bitwise identical to that of an uninterrupted run.
    """
    from multicell.results.reader import Contents
    from multicell.results.writer import Store

    begin = clock.perf_counter()
    folder = Path(folder)
    target = folder if options.output is None else Path(options.output)
    here = target.resolve() == folder.resolve()
    with ExitStack() as stack:
        contents = Contents(folder)
        if here:
            stack.enter_context(lock_folder(folder))
            contents = Contents(folder)  # another run may have come first
        place = _place(contents, frame)
        if frame < 0 or here:  # behind a damaged end a frame is named, and a folder
            contents.whole()
        scene = _change(recorded_scene(contents), changes or {})
        check_observables(scene)
        simulation = _simulation(scene, contents, place, options)
        scene = simulation.scene
        # all of it is read: what is damaged is better known before the run than after it
        steps = contents.history().get("step")
        if steps is None:
            problem = f"'{folder}' is damaged: its history does not count steps"
            raise OutputError(problem, damaged=True)
        rows = int((steps <= simulation.step_index).sum())
        interrupt = stack.enter_context(WHOLE_STEP).deliver
        if here:
            for k in range(place):
                contents.frame(k)
            last = _last_planned(contents, place, simulation) if planned else place
            store = Store.resume(contents, last, rows, scene)
        else:
            last = place
            store = Store.create(target, scene, options.overwrite)
        recorder = Recorder(scene, store)
        stack.callback(recorder.close)
        stack.enter_context(failing_as_run())
        if not here:
            store.copy(contents, place, rows)
        recorder.skip(contents.frame(last))
        if options.live:
            stack.enter_context(recorder.shown_live(simulation))
        recorder.note_startup(simulation, begin)
        advance_run(simulation, recorder, interrupt, options.progress)
    return recorder


def _last_planned(contents: Contents, place: int, simulation: Simulation) -> int:
    """Return the number of the last frame up to one that the scene asks for."""
    if place == 0 or simulation.finished:
        return place
    before, time = contents.places[place - 1], contents.places[place].time
    due = frame_due(time, next_frame(simulation.scene.output.every, before.time))
    return place if due else place - 1


def _place(contents: Contents, frame: int) -> int:
    if not hasattr(frame, "__index__"):
        problem = f"the frame to resume from is a whole number, not {shown(frame)}"
        raise OutputError(f"{problem}. Changes are given by name: changes={{...}}")
    count = len(contents.places)
    place = frame + count if frame < 0 else frame
    if not 0 <= place < count:
        have = "it has no frames. 'multicell run' with the same scene and folder begins it anew"
        have = f"it has the frames 0 to {count - 1}" if count else have
        raise OutputError(f"the run in '{contents.folder}' has no frame {frame}: {have}")
    return place


def _simulation(scene: Scene, contents: Contents, place: int, options: RunOptions) -> Simulation:
    """Return the simulation at a frame, or state why it cannot continue."""
    scene, own = integrated_by(scene, options.integrator)
    folder, start = contents.folder, contents.frame(place)
    most = scene.stop_cells
    if most is not None and len(start.cells) > most != recorded_scene(contents).stop_cells:
        raise SceneError(
            "stop_cells",
            f"is {most}, but the frame at {start.time:g} s has {len(start.cells)} cells",
            "Name a larger number, or resume from an earlier frame.",
        )
    simulation = Simulation(
        scene,
        threads=thread_count(options.threads),
        frame=start,
        lineage=contents.lineage(place),
        integrator=own,
        reactions=options.reactions,
    )
    if simulation.finished and _complete(contents):
        end, twice = (time_unit(start.time).text(n * start.time) for n in (1, 2))
        raise OutputError(
            f"the run in '{folder}' is done: it ends with the frame at {end}. To prolong it, "
            f"change duration or stop_cells: --set duration='{twice}'"
        )
    return simulation


def _complete(contents: Contents) -> bool:
    summary = read_document(contents.folder / "summary.json")
    return contents.journal is None and summary is not None and not summary.get("interrupted")


def _change(scene: Scene, changes: Mapping[str, Any]) -> Scene:
    for key in changes:
        parts = key.split(".")
        free = parts[0] in _MAY_CHANGE
        if parts[0] == "nutrients" and len(parts) > 2:
            free = parts[2] in _OF_A_NUTRIENT
        if not free:
            allowed = ", ".join([*_MAY_CHANGE, *(f"nutrients.<name>.{k}" for k in _OF_A_NUTRIENT)])
            raise SceneError(key, "cannot change during a run", f"Allowed: {allowed}")
    return scene.with_changes(changes)
