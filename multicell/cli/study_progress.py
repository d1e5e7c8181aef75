"""How a study reports its progress: a bar in a terminal, a line now and then elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, final

from multicell.cli.progress import display
from multicell.units import time_text

if TYPE_CHECKING:
    from multicell.studies.engine import Outcome
    from multicell.studies.runs import Run
    from multicell.studies.study import Study

Progress = Callable[["Outcome"], None]


@final
class Pace:
    """Progress of a study and prediction of the time that is left.

    What runs are expected to take is corrected by the ratio of what those that ended took to what
    they were expected to; the expectation counts as much as one more run.

    - ``runs``: all of the study
    - ``cores``: on which they go; None if that is not known
    - ``now``: of the clock, s
    """

    def __init__(self, runs: Sequence[Run], cores: int | None, now: float) -> None:
        self.expected = {run.name: run.expected for run in runs}
        self.left = dict(self.expected)
        self.total = len(self.expected)
        self.failed = self.computed = 0
        self._cores = cores
        self._usual = sum(self.expected.values()) / max(self.total, 1)
        self._took = self._foreseen = 0.0
        self._last = now

    @property
    def done(self) -> int:
        """How many runs have ended, well or not."""
        return self.total - len(self.left)

    @property
    def share(self) -> float:
        """The part of all work that has ended."""
        whole = sum(self.expected.values())
        return 1.0 - sum(self.left.values()) / whole if self.left and whole > 0.0 else 1.0

    def note(self, outcome: Outcome, now: float) -> None:
        """Note that a run has ended."""
        foreseen = self.left.pop(outcome.name, 0.0)
        self.failed += outcome.state != "done"
        self._last = now
        if not outcome.reused:
            self.computed += 1
        if not outcome.reused and outcome.state == "done":
            self._took, self._foreseen = self._took + outcome.wall, self._foreseen + foreseen

    def remaining(self, now: float) -> float | None:
        """Return the wall time that is left, s; None if nobody knows on how many cores."""
        if self._cores is None:
            return None
        factor = (self._took + self._usual) / (self._foreseen + self._usual)
        rest = self.left.values()
        time = max(sum(rest) / self._cores, max(rest, default=0.0))
        return max(0.0, factor * time - (now - self._last))

    def words(self, now: float) -> list[str]:
        """Return how the study stands in words."""
        left = self.remaining(now)
        return [
            f"{self.done:,} of {self.total:,} runs",
            *([f"{self.failed:,} failed"] if self.failed else []),
            *([] if left is None or not self.left else [f"about {time_text(left, 2)} left"]),
        ]


def reporter(
    study: Study, cores: int | None, *, show: bool = True
) -> AbstractContextManager[Progress | None]:
    """Return a context with what is called with every outcome."""
    pace = Pace(study.runs, cores, time.perf_counter())

    def note(outcome: Outcome) -> float | None:
        pace.note(outcome, time.perf_counter())
        return None if outcome.reused else pace.share

    return display(lambda: pace.words(time.perf_counter()), note, show=show)
