"""A fit that was checked, and its runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

from multicell.calibration.fresh import CHECKS
from multicell.calibration.pool import Pool
from multicell.calibration.problem import Problem
from multicell.tables.fields import Table

if TYPE_CHECKING:
    from multicell.calibration.fresh import Fresh
    from multicell.calibration.profiles import End
    from multicell.calibration.search import Evaluation, Run
    from multicell.calibration.simulator import Reading
    from multicell.scene.scene import Scene

_SEARCHED: Final = 0.8  # part of a budget of time that the search takes; the rest is for fresh runs

Progress = Callable[[str, int, int], None]
"""Called with the stage, how much of it is done and how much is wanted."""


@final
@dataclass(frozen=True)
class FitPlan:
    """A fit that was checked and not begun.

    - ``points``: sets of parameters that the search will try
    - ``seconds``: time in s that the budget allows; infinite where it is a number of runs
    - ``coarse``: factor of the coarse runs that search first; 1 where there are none
    """

    problem: Problem
    scene: Scene
    table: Table
    points: int
    seconds: float
    sd: float
    repeats: int
    specimens: str = "same"
    profile_runs: int = 0
    request: Mapping[str, Any] = field(default_factory=dict)
    adopted: Sequence[Mapping[str, Any]] = ()
    coarse: float = 1.0

    @property
    def runs(self) -> int:
        """How many runs there will be at most."""
        fresh = fresh_runs(self.repeats, self.profile_runs, self.problem)
        searched = self.points * len(self.problem.tasks())
        return searched + fresh * len(self.problem.measured.conditions)

    def describe(self) -> dict[str, Any]:
        """Return what decides all numbers of the fit."""
        from multicell.calibration.fit_folder import describe

        times = [datum.time for datum in self.problem.measured.data]
        options: dict[str, Any] = {
            "sd": self.sd, "times": times, "specimens": self.specimens,
            "scatter": self.problem.scatter,
        }  # fmt: skip
        if stated := getattr(self.problem.simulator, "stated", None):
            options["simulator"] = stated
        return describe(self.problem, self.scene, self.table, options)

    def left(self, folder: str | Path | None) -> tuple[int, float]:
        """Return how many runs are left at most, and the time on one core in s that they take."""
        from multicell.calibration.fit_folder import work_done
        from multicell.studies.cost import cost_of

        if self.coarse != 1.0:
            from multicell.calibration.coarse_to_fine import expected

            return expected(self)
        done = 0 if folder is None else work_done(folder, self.describe())
        each = [cost_of(c.scene).seconds for c in self.problem.measured.conditions]
        count = max(0, self.runs - done)
        return count, float(sum(each) / len(each) * count)


def fresh_runs(repeats: int, profile_runs: int, problem: Problem) -> int:
    """Return how many runs of each condition have fresh seeds."""
    ends = 2 * len(problem.ranges) * profile_runs
    return repeats + ends + CHECKS


@final
@dataclass(frozen=True, eq=False)
class Made:
    """What the runs of a fit have come to; see :class:`Fit`. ``reused`` counts points."""

    evaluations: list[Evaluation]
    fresh: Fresh
    ends: tuple[End, ...]
    readings: Mapping[Run, Reading]
    reused: int


def make_runs(
    plan: FitPlan,
    folder: Path | None,
    pool: Pool,
    begin: float,
    progress: Progress = lambda what, done, wanted: None,
) -> Made:
    """Make all runs of a fit that are not there."""
    from multicell.calibration.fit_folder import SEARCH
    from multicell.calibration.fresh import fresh
    from multicell.calibration.profiles import check_ends
    from multicell.calibration.search import Search

    search = Search(plan.problem, None if folder is None else folder / SEARCH)
    search.adopt(plan.adopted)
    evaluations = search.run(
        pool, plan.points, deadline=begin + _SEARCHED * plan.seconds,
        progress=partial(progress, "runs of the search"),
    )  # fmt: skip
    note = partial(progress, "fresh runs")
    again = fresh(plan.problem, search, pool, search.emulator(), plan.repeats, note)
    note = partial(progress, "runs at the ends of profiles")
    ends = check_ends(plan.problem, search, pool, again, plan.profile_runs, note)
    return Made(evaluations, again, ends, search.readings, search.reused)
