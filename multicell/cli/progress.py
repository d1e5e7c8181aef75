"""How a run tells that it goes on: a bar in a terminal, a line now and then elsewhere.

All of it goes to stderr; stdout belongs to results.
"""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import IO, TYPE_CHECKING, Any, Final, cast, final

from multicell.cli.remaining import Forecast, Remaining, in_words
from multicell.report.wording import time_unit

if TYPE_CHECKING:
    from rich.console import Console

    from multicell.scene.scene import Scene


Progress = Callable[[Any], None]
"""Called after every coupling step with the simulation."""


@contextmanager
def reporter(scene: Scene, *, show: bool = True) -> Iterator[Progress | None]:
    """Yield what a run calls after each coupling step, or None if nothing shall be shown."""
    if not show:
        yield None
        return
    console = on_stderr()
    with _bar(scene, console) if console.is_terminal else _lines(scene, console) as progress:
        yield progress


def on_stderr() -> Console:
    """Return the console that progress is told on; the cell of a notebook is no terminal.

    IPython runs commands in a terminal of its own, but adds up what a terminal would redraw.
    """
    from rich.console import Console

    from multicell.cli.process import Faltering

    stream = cast(IO[str], Faltering(sys.stderr))
    notebook = "JPY_PARENT_PID" in os.environ
    return Console(file=stream, highlight=False, force_terminal=False if notebook else None)


@contextmanager
def counted(what: str, *, show: bool = True) -> Iterator[Callable[[int, int], None] | None]:
    """Yield what is called with how much is done and how much there is, or None to show nothing.

    A bar in a terminal; elsewhere nothing, since such work is short.
    """
    from rich.progress import Progress as Bar

    console = on_stderr()
    if not show or not console.is_terminal:
        yield None
        return
    with Bar(console=console, transient=True) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, of: bar.update(task, completed=done, total=of)


def status(simulation: Any, wall: float, left: float | None = None) -> str:
    """Return time, cells, step, speed and time left in words, ``wall`` s after the start."""
    speed = simulation.time / 3600.0 / wall if wall > 0.0 else 0.0
    n = len(simulation.cells)
    unit, size = time_unit(simulation.scene.duration)
    ahead = "" if left is None else f" · about {in_words(left)} left"
    return (
        f"{simulation.time / size:.2f} of {simulation.scene.duration / size:.2f} {unit} · "
        f"{n:,} cell{'' if n == 1 else 's'} · step {simulation.step_index:,} · "
        f"{speed:.3g} h simulated per s{ahead}"
    )


_TELL_EVERY: Final = 0.5  # s between two looks ahead
_WORTH: Final = 10.0  # s that are left, from which on the scene is asked for a forecast


@final
class _Clock:
    """Times a run and tells where it stands; to be asked after every step."""

    def __init__(self, scene: Scene) -> None:
        cycle = math.inf if scene.growth is None else scene.growth.mean_cycle
        self._remaining = Remaining(scene.duration, scene.stop_cells, cycle)
        self._start = self._before = self._told = time.perf_counter()
        self._left: float | None = None
        self._scene = scene

    def status(self, simulation: Any) -> str:
        """Return where the run stands in words."""
        now = time.perf_counter()
        self._remaining.note(simulation.time, len(simulation.cells), now - self._before)
        self._before = now
        if now - self._told > _TELL_EVERY:
            self._told, self._left = now, self._remaining.left()
            if self._remaining.forecast is None and (self._left or 0.0) > _WORTH:
                self._remaining.forecast = _forecast(self._scene)
                self._left = self._remaining.left()
                self._before = time.perf_counter()
        return status(simulation, now - self._start, self._left)


def _forecast(scene: Scene) -> Forecast:
    """Return how a scene's population is expected to grow; it takes about half a second."""
    from multicell.report.explain.cost import cost_of_step
    from multicell.report.explain.course import course

    found = course(scene)
    return Forecast(found.times, found.cells, *cost_of_step(scene))


@contextmanager
def _bar(scene: Scene, console: Console) -> Iterator[Progress]:
    """Draw a bar in simulated time."""
    from rich import progress as rich_progress

    columns = (
        rich_progress.BarColumn(bar_width=24),
        rich_progress.TaskProgressColumn(),
        rich_progress.TextColumn("{task.fields[status]}", markup=False),
    )
    clock = _Clock(scene)
    with rich_progress.Progress(*columns, console=console, refresh_per_second=5) as bar:
        task = bar.add_task("", total=scene.duration, status="starting")

        def advance(simulation: Any) -> None:
            text = clock.status(simulation)
            bar.update(task, completed=simulation.time, status=text)

        yield advance


@contextmanager
def _lines(scene: Scene, console: Console) -> Iterator[Progress]:
    """Print a line at every tenth of the simulated time, for logs."""
    clock, printed = _Clock(scene), 0

    def advance(simulation: Any) -> None:
        nonlocal printed
        text = clock.status(simulation)
        tenth = int(10.0 * simulation.time / scene.duration * (1.0 + 1e-12))
        if tenth > printed:
            printed = tenth
            console.print(f"{10 * tenth:3d} %  {text}", markup=False, soft_wrap=True)

    yield advance
