"""Show how far a run or a study is: a bar in a terminal, a line now and then elsewhere.

All of it goes to stderr; stdout belongs to results.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import IO, TYPE_CHECKING, Any, Final, cast, final

from multicell.cli.remaining import Forecast
from multicell.cli.tables import time_text
from multicell.report.wording import time_unit

if TYPE_CHECKING:
    from rich.console import Console

    from multicell.scene.scene import Scene


Progress = Callable[[Any], None]  # called after every coupling step with the simulation


@contextmanager
def reporter(scene: Scene, *, show: bool = True) -> Iterator[Progress | None]:
    """Yield what a run calls after each coupling step, or None if nothing shall be shown."""
    if not show:
        yield None
        return
    clock = _Clock(scene)
    with display(lambda: clock.words, refresh=5, lines=10) as update:

        def advance(simulation: Any) -> None:
            clock.note(simulation)
            update(simulation.time / scene.duration)

        yield advance


@contextmanager
def display(
    words: Callable[[], str], *, refresh: float, lines: int
) -> Iterator[Callable[[float], None]]:
    """Yield what is called with the part that is done.

    - ``words``: returns what stands beside the bar, or in a line
    - ``refresh``: how often a terminal is drawn anew, 1/s
    - ``lines``: how many lines are printed in all where there is no terminal
    """
    console = on_stderr()
    if not console.is_terminal:
        printed = 0

        def show(done: float) -> None:
            nonlocal printed
            part = int(lines * done * (1.0 + 1e-12))
            if part != printed:  # it falls where another stage begins
                printed = part
                console.print(
                    f"{100 * part // lines:3d} %  {words()}", markup=False, soft_wrap=True
                )

        yield show
        return
    from rich import progress as rich_progress
    from rich.text import Text

    @final
    class Words(rich_progress.ProgressColumn):
        def render(self, task: Any) -> Text:
            return Text(words())

    columns = (
        rich_progress.BarColumn(bar_width=24),
        rich_progress.TaskProgressColumn(),
        Words(),
        rich_progress.TimeElapsedColumn(),
    )
    with rich_progress.Progress(*columns, console=console, refresh_per_second=refresh) as bar:
        task = bar.add_task("", total=1.0)
        yield lambda done: bar.update(task, completed=done)


def on_stderr() -> Console:
    """Return the console that shows progress; the cell of a notebook is no terminal.

    IPython runs commands in a terminal of its own, but adds up what a terminal would redraw.
    """
    from rich.console import Console

    from multicell.cli.process import Faltering

    stream = cast(IO[str], Faltering(sys.stderr))
    notebook = "JPY_PARENT_PID" in os.environ
    return Console(file=stream, highlight=False, force_terminal=False if notebook else None)


@contextmanager
def count_progress(what: str, *, show: bool = True) -> Iterator[Callable[[int, int], None] | None]:
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
    ahead = "" if left is None else f" · about {time_text(left, 2)} left"
    return (
        f"{simulation.time / size:.2f} of {simulation.scene.duration / size:.2f} {unit} · "
        f"{n:,} cell{'' if n == 1 else 's'} · step {simulation.step_index:,} · "
        f"{speed:.3g} h simulated per s{ahead}"
    )


_UPDATE_EVERY: Final = 0.5  # wall time between two predictions, s
_FORECAST_AFTER: Final = 10.0  # wall time of a run after which its end is predicted, s


@final
class _Clock:
    """Times a run and says where it stands; to be called after every step."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._start = self._predicted = time.perf_counter()
        self._forecast: Forecast | None = None
        self._since = 0.0, 0.0
        self._left: float | None = None
        self.words = "starting"

    def note(self, simulation: Any) -> None:
        """Note a step."""
        from multicell.compiling import COMPILATION  # loaded by then

        now = time.perf_counter()
        worked = now - COMPILATION.seconds
        if self._forecast is None:
            if now - self._start > _FORECAST_AFTER:
                self._forecast = Forecast.of(self._scene)
                self._since = simulation.time, time.perf_counter() - COMPILATION.seconds
        elif now - self._predicted > _UPDATE_EVERY:
            begin, before = self._since
            self._predicted = now
            self._left = self._forecast.left(begin, simulation.time, worked - before)
        self.words = status(simulation, now - self._start, self._left)
