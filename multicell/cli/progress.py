"""Show how far a run or a study is: a bar in a terminal, a line now and then elsewhere.

All of it goes to stderr; stdout belongs to results.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from typing import IO, TYPE_CHECKING, Any, Final, NamedTuple, Self, cast, final

import numpy as np

from multicell.report.wording import cell_count, time_unit
from multicell.report.wording import clock as wall_time
from multicell.units import time_text

if TYPE_CHECKING:
    from pathlib import Path

    from rich.console import Console

    from multicell.cells import FloatArray
    from multicell.scene.scene import Scene
    from multicell.studies.engine import RunOutcome
    from multicell.studies.runs import StudyRun
    from multicell.studies.study import Study


Progress = Callable[[Any], None]  # called after every coupling step with the simulation


@contextmanager
def reporter(
    scene: Scene, *, show: bool = True, page: Path | None = None
) -> Iterator[Progress | None]:
    """Yield the callback of a run after each coupling step.

    - ``page``: of the live picture, if the run has one; a report is drawn at its end
    """
    clock = _Clock(scene, report=page is not None)
    if show:
        from multicell.report.explain.compilation import missing_parts

        console = on_stderr()
        for line in clock.foresee(missing_parts(scene)):
            console.print(line, markup=False, soft_wrap=not console.is_terminal)
        if page is not None:
            console.print(f"The tissue so far: {page}", markup=False, soft_wrap=True)
    with display(clock.words, clock.note, lines=10, show=show) as progress:
        yield progress


@contextmanager
def display(
    words: Callable[[], Sequence[str]],
    share: Callable[..., float | None],
    *,
    lines: int = 20,
    show: bool = True,
) -> Iterator[Callable[..., None] | None]:
    """Yield a callback with the arguments of ``share``, or None if nothing shall be shown.

    - ``words``: returns what stands beside the bar, or in a line: what matters most comes first,
      and what finds no room in a line of the terminal is left out
    - ``share``: returns the part that is done; None where that has not changed
    - ``lines``: how many lines are printed in all where there is no terminal
    """
    if not show:
        yield None
        return
    console = on_stderr()
    if not console.is_terminal:
        printed, last, over = 0, time.perf_counter(), threading.Event()

        def report(*event: Any) -> None:
            nonlocal printed, last
            last = time.perf_counter()
            done = share(*event)
            part = printed if done is None else int(lines * done * (1.0 + 1e-12))
            if part != printed:  # it falls where another stage begins
                printed = part
                text = f"{100 * part // lines:3d} %  {' · '.join(words())}"
                console.print(text, markup=False, soft_wrap=True)

        def watch() -> None:
            """Say now and then that something takes long."""
            while not over.wait(_LONG):
                if time.perf_counter() - last > _LONG:
                    console.print(f"      {' · '.join(words())}", markup=False, soft_wrap=True)

        threading.Thread(target=watch, daemon=True).start()
        try:
            yield report
        finally:
            over.set()
        return
    from rich import progress as rich_progress
    from rich.table import Column
    from rich.text import Text

    begin, wide = time.perf_counter(), console.width
    width = 24 if wide >= 100 else 16 if wide >= 80 else 8 if wide > 60 else 0
    utf = console.encoding.startswith("utf")
    room = console.width - 6 - (width + 1 if width else 0)  # beside percentage, bar and gaps

    @final
    class Words(rich_progress.ProgressColumn):
        def render(self, task: Any) -> Text:
            parts = list(words())
            if task.total is None and len(parts) == 1:  # nothing is done yet
                parts.append(wall_time(time.perf_counter() - begin))
            line = fitting(parts, room)
            line = line if utf else line.replace("✓", "+")
            return Text(line, no_wrap=True, overflow="ellipsis")

    bar_of = [rich_progress.BarColumn(width, table_column=Column(no_wrap=True))] if width else []
    columns = (rich_progress.TaskProgressColumn("{task.percentage:3.0f} %"), *bar_of, Words())
    with rich_progress.Progress(*columns, console=console, refresh_per_second=4) as bar:
        task = bar.add_task("", total=None)

        def advance(*event: Any) -> None:
            done = share(*event)
            if done is not None:
                bar.update(task, completed=done, total=1.0)

        yield advance


def fitting(parts: Sequence[str], width: int) -> str:
    """Return as many of the first parts as fit into a width, and at least one."""
    line = parts[0]
    for part in parts[1:]:
        if len(line) + len(part) + 3 > width:
            break
        line = f"{line} · {part}"
    return line


def on_stderr() -> Console:
    """Return the console that shows progress; the cell of a notebook is no terminal.

    IPython runs commands in a terminal of its own, but adds up what a terminal would redraw.
    """
    from rich.console import Console

    from multicell.cli.process import Faltering

    stream = cast(IO[str], Faltering(sys.stderr))
    notebook = "JPY_PARENT_PID" in os.environ
    return Console(file=stream, highlight=False, force_terminal=False if notebook else None)


def progress_line(simulation: Any, wall: float, left: float | None = None) -> list[str]:
    """Return time, time left, cells, speed and step in words, ``wall`` s after the start."""
    speed = simulation.time / 3600.0 / wall if wall > 0.0 else 0.0
    unit, size = time_unit(simulation.scene.duration)
    return [
        f"{simulation.time / size:.2f} of {simulation.scene.duration / size:.4g} {unit}",
        *([] if left is None else [f"{time_text(left, 2)} left"]),
        cell_count(len(simulation.state.cells)),
        f"{speed:.3g} h simulated per s",
        f"step {simulation.step_index:,}",
    ]


_SLOW: Final = 20.0  # wall time in a step from which on it is shown, s
_LONG: Final = 30.0  # wall time without news after which a line says so where there is no bar, s
_FORECAST_AFTER: Final = 2.0  # wall time of a run after which its end is predicted, s
_PRIOR: Final = 5.0  # expected wall time, s, that counts as if it had been measured as expected
_PICTURES: Final = 2.5  # wall time of the pictures and the report of a run, s
_PICTURE_OF_CELL: Final = 1.5e-4  # and for each cell


class Forecast(NamedTuple):
    """Expected cost of a run.

    - ``times``, (k,): simulated times from 0 to the end, s
    - ``cost``, (k,): wall time that is expected up to then, without compilation, s
    - ``cells``: expected at the end
    """

    times: FloatArray
    cost: FloatArray
    cells: float = 0.0

    @classmethod
    def of(cls, scene: Scene) -> Self:
        """Return the forecast of ``explain``; it takes about half a second."""
        from multicell.report.explain.cost import cost_of_step, predict

        expected, (constant, slope) = predict(scene), cost_of_step(scene)
        times = expected.course.times
        rate = constant + slope * expected.course.cells
        cost = np.cumsum(0.5 * np.diff(times, prepend=0.0) * (rate + np.roll(rate, 1)))
        return cls(times, cost * (expected.seconds / cost[-1]), float(expected.course.cells[-1]))

    def left(self, begin: float, now: float, wall: float) -> float:
        """Return the wall time that is left, s.

        Measured steps correct the expectation, which counts as much as some that took what was
        expected: the first steps are few, and load code from its cache.

        - ``begin``, ``now``, s: simulated times between which the wall time ``wall``, s, has passed
        """
        before, here = np.interp([begin, now], self.times, self.cost)
        return float((self.cost[-1] - here) * (wall + _PRIOR) / (here - before + _PRIOR))


@final
class _Clock:
    """Times a run and says where it stands; to be called after every step.

    - ``report``: whether pictures are drawn at its end
    """

    def __init__(self, scene: Scene, *, report: bool = False) -> None:
        self._scene, self._report = scene, report
        self._start = time.perf_counter()
        self._forecast: Forecast | None = None
        self._since = 0.0, 0.0
        self._left: float | None = None
        self._simulation: Any = None
        self._last = self._start
        self._missing: dict[str, float] = {}
        self._stepped: set[str] = set()  # parts that a step has used

    def foresee(self, missing: Mapping[str, float]) -> list[str]:
        """Note what must be compiled, and return what a first run says before it starts.

        - ``missing``: parts that have no code on disk, and the seconds that they are expected to
          take. Without any the forecast waits until the run has taken a while.
        """
        if not missing:
            return []
        from multicell.report.explain.compilation import LISTS_FROM

        self._forecast = Forecast.of(self._scene)
        few = {"neighbour lists"} if self._forecast.cells < LISTS_FROM else set()
        self._missing = {part: s for part, s in missing.items() if part not in few}
        if not self._missing:
            return []
        cells, run = self._forecast.cells, self._forecast.cost[-1]
        seconds = sum(self._missing.values())
        return [
            f"About {cell_count(_rounded(cells))}: {time_text(_rounded(run), 2)} to compute, and "
            f"some {_rounded(seconds):.0f} s to compile, once on this machine."
        ]

    def words(self) -> list[str]:
        """Return where the run stands in words, the most important first."""
        now = time.perf_counter()
        done = self._simulation
        if done is not None and done.finished:
            return self._closing(now)
        compiling = self._compiling(now)
        if done is None:
            return compiling or ["loading"]
        left = self._remaining(now)
        known = progress_line(done, now - self._start, left)
        if compiling:
            return [*compiling, *known[:1]]
        long = now - self._last
        return [*known, f"the next for {time_text(long, 2)}"] if long > _SLOW else known

    def _compiling(self, now: float) -> list[str]:
        """Return the part that numba compiles now, with those before; nothing where it does not."""
        from multicell.compiling import COMPILATION

        took, part = dict(COMPILATION.parts), COMPILATION.part
        if not part and self._missing and self._simulation is None:  # between two functions
            part = next(reversed(took), "")
        if not part:
            return []
        left = self._remaining(now)
        spent = took.get(part, 0.0) + (now - COMPILATION.begin if COMPILATION.part else 0.0)
        return [
            f"compiling {part}, {wall_time(spent)}",
            *([] if left is None else [f"{wall_time(left)} left"]),
            *(f"✓ {done}" for done in reversed(took) if done != part),
        ]

    def _remaining(self, now: float) -> float | None:
        """Return the wall time that is left, s: of steps, of compiling and of pictures."""
        if self._forecast is None:
            return None
        run = self._forecast.cost[-1] if self._left is None else self._left
        passed = 0.0 if self._left is None else now - self._last
        left = max(run - passed, 0.0) + self._compilation_left(now) + self._drawing()
        return max(left, 1.0)

    def _compilation_left(self, now: float) -> float:
        """Return the wall time of compiling that is left, s, at the pace of what is compiled.

        A part is over when another one has begun after it, or a step has been made since.
        """
        from multicell.compiling import COMPILATION

        took, part = dict(COMPILATION.parts), COMPILATION.part
        latest = part or next(reversed(took), "")
        over = {name for name in took if name != latest} | (self._stepped - {part})
        known = [name for name in over if name in self._missing]
        foreseen = sum(self._missing[name] for name in known)
        pace = (sum(took.get(name, 0.0) for name in known) + _PRIOR) / (foreseen + _PRIOR)
        if part:
            took[part] = took.get(part, 0.0) + now - COMPILATION.begin
        return sum(
            max(pace * seconds - took.get(name, 0.0), 0.0)
            for name, seconds in self._missing.items()
            if name not in over
        )

    def _drawing(self) -> float:
        """Return the expected wall time of the pictures, s."""
        if not self._report or self._forecast is None:
            return 0.0
        return _PICTURES + _PICTURE_OF_CELL * self._forecast.cells

    def _closing(self, now: float) -> list[str]:
        """Return the words of the time after the last step."""
        passed = now - self._last
        if not self._report:
            return ["writing results", wall_time(passed)]
        left = self._drawing() - passed
        when = f"{wall_time(left)} left" if left > 1.0 else f"for {wall_time(passed)}"
        return ["drawing pictures", when, cell_count(len(self._simulation.state.cells))]

    def note(self, simulation: Any) -> float:
        """Note a step, and return the part of the time that is simulated."""
        from multicell.compiling import COMPILATION

        self._simulation, compiled = simulation, simulation.wall["compile"]
        self._stepped = set(COMPILATION.parts)
        now = self._last = time.perf_counter()
        late = now - self._start > _FORECAST_AFTER and not simulation.finished
        if self._forecast is None and late:
            self._forecast = Forecast.of(self._scene)
            now = time.perf_counter()
            self._since = simulation.time, now - compiled
        elif self._forecast is not None and self._since == (0.0, 0.0):
            self._since = simulation.time, now - compiled
        if self._forecast is not None:
            begin, before = self._since
            self._left = self._forecast.left(begin, simulation.time, now - compiled - before)
        return float(simulation.time / self._scene.duration)


def _rounded(value: float) -> float:
    """Return a forecast with the digits that it deserves: three, or two below a hundred."""
    return float(f"{value:.{3 if value >= 100.0 else 2}g}")


@final
class Pace:
    """Progress of a study and prediction of the time that is left.

    What runs are expected to take is corrected by the ratio of what those that ended took to what
    they were expected to; the expectation counts as much as one more run.

    - ``runs``: all of the study
    - ``cores``: on which they go; None if that is not known
    - ``now``: of the clock, s
    - ``compiling``: expected wall time for which the first runs compile, s
    """

    def __init__(
        self, runs: Sequence[StudyRun], cores: int | None, now: float, compiling: float = 0.0
    ) -> None:
        self.expected = {run.name: run.expected for run in runs}
        self.left = dict(self.expected)
        self.total = len(self.expected)
        self.failed = 0
        self._cores = cores
        self._usual = sum(self.expected.values()) / max(self.total, 1)
        self._took = self._foreseen = 0.0
        self._last = now
        self._compiled = now + compiling  # when the first runs are expected to step

    @property
    def share(self) -> float:
        """The part of all work that has ended."""
        whole = sum(self.expected.values())
        return 1.0 - sum(self.left.values()) / whole if self.left and whole > 0.0 else 1.0

    def note(self, outcome: RunOutcome, now: float) -> None:
        """Note that a run has ended."""
        foreseen = self.left.pop(outcome.name, 0.0)
        self.failed += outcome.state != "done"
        self._last = now
        if not outcome.reused and outcome.state == "done":
            # without the time for which it compiled, and not below what was expected
            waited = max(self._compiled - (now - outcome.wall), 0.0)
            took = max(outcome.wall - waited, min(outcome.wall, foreseen))
            self._took, self._foreseen = self._took + took, self._foreseen + foreseen
            self._compiled = min(self._compiled, now)

    def remaining(self, now: float) -> float | None:
        """Return the wall time that is left, s; None if nobody knows on how many cores.

        It is negative where the study takes longer than predicted.
        """
        if self._cores is None:
            return None
        if not self.left:
            return 0.0
        factor = (self._took + self._usual) / (self._foreseen + self._usual)
        rest = self.left.values()
        time = max(sum(rest) / self._cores, max(rest, default=0.0))
        return factor * time - (now - max(self._last, self._compiled))

    def words(self, now: float) -> list[str]:
        """Return how the study stands in words."""
        left, when = self.remaining(now), []
        if self.left and left is not None:
            when = [f"about {time_text(max(left, 1.0), 2)} left"]  # whole seconds from one on
            if left < -1.0:
                when = [f"{wall_time(-left)} later than predicted"]
        return [
            f"{self.total - len(self.left):,} of {self.total:,} runs",
            *([f"{self.failed:,} failed"] if self.failed else []),
            *when,
        ]


def study_reporter(
    study: Study, cores: int | None, *, show: bool = True
) -> AbstractContextManager[Callable[[RunOutcome], None] | None]:
    """Return a context with what is called with every outcome."""
    from multicell.report.explain.compilation import missing_parts

    compiling = sum(missing_parts(study.runs[0].scene).values()) if show and cores else 0.0
    if compiling:
        words = f"The first runs compile: some {_rounded(compiling):.0f} s, once on this machine."
        on_stderr().print(words, markup=False)
    pace = Pace(study.runs, cores, time.perf_counter(), compiling)

    def note(outcome: RunOutcome) -> float | None:
        pace.note(outcome, time.perf_counter())
        return None if outcome.reused else pace.share

    return display(lambda: pace.words(time.perf_counter()), note, show=show)
