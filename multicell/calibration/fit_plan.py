"""A fit that was checked, its runs, and its folder: what was tried, what was found."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

from multicell.calibration.likelihood import CHECKS
from multicell.calibration.pool import Pool
from multicell.calibration.problem import Problem
from multicell.errors import OutputError
from multicell.results.documents import Lines, read_table, write_table
from multicell.results.folder import (
    lock_folder,
    make_folder,
    package_version,
    remove,
    to_json,
    versions,
    with_copy,
    write_text,
)
from multicell.scene.start_table import COPIES
from multicell.studies.runs import MODEL_VERSION, canonical
from multicell.tables.columns import Table
from multicell.tables.text import csv_text, table_text

if TYPE_CHECKING:
    from multicell.calibration.fitted import Fit
    from multicell.calibration.likelihood import Fresh
    from multicell.calibration.profiles import End
    from multicell.calibration.search import Evaluation, Run
    from multicell.calibration.simulator import Reading
    from multicell.scene.scene import Scene

PAIRS: Final = 8  # draws at which fine runs correct coarse ones
BESIDE: Final = 2  # coarse runs beside each of them
FURTHER: Final = 3  # one in so many points of the search is tried once more, after the correction
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
        from multicell.studies.cost import cost_of

        if self.coarse != 1.0:
            return _coarse_runs(self)
        done = 0 if folder is None else work_done(folder, self.describe())
        each = [cost_of(c.scene).seconds for c in self.problem.measured.conditions]
        count = max(0, self.runs - done)
        return count, float(sum(each) / len(each) * count)


def _coarse_runs(plan: FitPlan) -> tuple[int, float]:
    """Return how many runs there will be at most, and the time on one core that they take, s."""
    from multicell.scene.coarsening import coarsen
    from multicell.studies.cost import cost_of

    scenes = [condition.scene for condition in plan.problem.measured.conditions]
    fine = [cost_of(scene).seconds for scene in scenes]
    coarse = [cost_of(coarsen(scene, plan.coarse)).seconds for scene in scenes]
    searched = plan.runs + plan.runs // FURTHER + PAIRS * BESIDE * len(scenes)
    again = PAIRS * len(scenes) + plan.runs - plan.points * len(plan.problem.tasks())
    seconds = searched * sum(coarse) / len(scenes) + again * sum(fine) / len(scenes)
    return searched + again, float(seconds)


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
    from multicell.calibration.likelihood import fresh
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


FIT: Final = "fit.json"  # what the folder is a fit of
SEARCH: Final = "search.log"  # points and readings of the search, and of fresh runs
FILES: Final = (
    FIT, "scene.toml", "data.csv", SEARCH, "result.json", "best.toml", "posterior.csv",
    "residuals.csv", "runs.csv", "report.html", "data.png", "parameters.png", "profiles.png",
    *COPIES,
)  # fmt: skip
_PACKAGES: Final = ("optuna", "distributed", "pandas", "scikit-learn")


def describe(
    problem: Problem, scene: Scene, table: Table, options: Mapping[str, Any]
) -> dict[str, Any]:
    """Return what decides all numbers of a fit; a fit of anything else is another one."""
    return {
        "model": MODEL_VERSION,
        "scene": canonical(scene),
        "data": {"titles": list(table.titles), "rows": [list(row) for row in table.rows]},
        "free": {
            free.key: {"low": free.low, "high": free.high, "unit": free.unit, "log": free.log}
            for free in problem.ranges
        },
        "seeds": list(problem.seeds),
        **problem.prior.describe(),
        **options,
    }


@contextmanager
def open_folder(
    folder: str | Path,
    problem: Mapping[str, Any],
    scene: Scene,
    table: Table,
    *,
    overwrite: bool = False,
    request: Mapping[str, Any] | None = None,
) -> Iterator[Path]:
    """Make the folder of a fit, or open that of the same fit, and keep other processes out of it.

    - ``request``: what else opens it again (:func:`multicell.calibration.stored.load_fit`)
    """
    folder = Path(folder)
    asked = json.loads(to_json(problem))
    known = _read_fit(folder)
    if known is None or overwrite:
        make_folder(folder, overwrite=overwrite)
    elif known.get("problem") != asked:
        there = known.get("problem")
        parts = there if isinstance(there, dict) else {}
        other = [key for key in {**parts, **asked} if parts.get(key) != asked.get(key)]
        raise OutputError(
            f"'{folder}' holds another fit: {', '.join(other)} differ. Choose "
            "another folder, or allow overwriting (--overwrite, overwrite=True)"
        )
    with lock_folder(folder):
        if overwrite:
            remove(folder, FILES)
        if _read_fit(folder) is None:
            entry = {"multicell": package_version(), "problem": asked, "request": request or {}}
            kept = with_copy(scene, folder)
            write_text(folder / "scene.toml", kept.to_toml(beside=folder))
            write_text(folder / "data.csv", csv_text(table.titles, table.rows))
            write_table(folder / FIT, entry)  # the last: then all is there
        yield folder


def work_done(folder: str | Path, problem: Mapping[str, Any]) -> int:
    """Return how many runs of a fit a folder has; nothing of another fit counts."""
    folder = Path(folder)
    known = _read_fit(folder)
    if known is None or known.get("problem") != json.loads(to_json(problem)):
        return 0
    entries = Lines(folder / SEARCH).entries
    return sum("values" in e and not e.get("reused") for e in entries)


def write_result(fit: Fit, folder: Path) -> None:
    """Write what was found: ``result.json``, ``best.toml`` and the tables."""
    about = {**versions(), **{name: package_version(name) for name in _PACKAGES}}
    write_table(folder / "result.json", {**fit.summary(), "versions": about})
    best = with_copy(fit.best.scene, folder)
    write_text(folder / "best.toml", best.to_toml(beside=folder))
    write_text(folder / "residuals.csv", table_text(fit.rows()))
    write_text(folder / "runs.csv", table_text(fit.run_rows()))
    if fit.sample is not None:
        frame = fit.posterior
        units = frame.attrs["units"]
        titles = [f"{name} / {units[name]}" if units.get(name) else name for name in frame.columns]
        write_text(folder / "posterior.csv", csv_text(titles, frame.to_numpy().tolist()))


def _read_fit(folder: Path) -> dict[str, Any] | None:
    """Return what a folder is a fit of, None where there is none."""
    try:
        return read_table(folder / FIT)
    except OutputError as error:
        raise OutputError(f"{error}. Allow overwriting to begin anew") from error
