"""A fit that was checked, its runs, and its folder: what was tried, what was found."""

from __future__ import annotations

import json
import math
import time as clock
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

from multicell.calibration.fitting.likelihood import CHECKS, Fresh, fresh, most_fresh
from multicell.calibration.fitting.pool import Pool
from multicell.calibration.fitting.problem import FitProblem
from multicell.calibration.fitting.result import Fit
from multicell.calibration.fitting.search import SEARCH, Evaluation, Search
from multicell.errors import OutputError
from multicell.results.documents import Lines, read_document, write_table
from multicell.results.folder import (
    copied_files,
    copy_of,
    file_errors,
    is_begun,
    lock_folder,
    make_folder,
    package_version,
    remove,
    to_json,
    versions,
    with_copy,
    write_bytes,
    write_text,
)
from multicell.scene.start_table import COPIES
from multicell.studies.runs import MODEL_VERSION, canonical
from multicell.tables.columns import Table
from multicell.tables.text import csv_text, table_text

if TYPE_CHECKING:
    from multicell.scene.scene import Scene

FIT: Final = "fit.json"  # what the folder is a fit of
FIT_FILES: Final = (
    FIT,
    "scene.toml",
    "data.csv",
    SEARCH,
    "result.json",
    "best.toml",
    "posterior.csv",
    "residuals.csv",
    "runs.csv",
    "report.html",
    "data.png",
    "parameters.png",
    "profiles.png",
    "deviations.png",
    *COPIES,
)
_PACKAGES: Final = ("optuna", "distributed", "pandas", "scikit-learn")

_ROUNDS: Final = 2  # in which further sets of parameters are tried

Progress = Callable[[str, int, int], None]
"""Called with the stage, how much of it is done and how much is wanted."""


@final
@dataclass(frozen=True)
class FitPlan:
    """A fit that was checked and not begun.

    - ``points``: sets of parameters that the search will try
    - ``extra``: how many more it may try where results contradict each other
    """

    problem: FitProblem
    scene: Scene
    table: Table
    points: int
    sd: float
    repeats: int
    specimens: str = "same"
    extra: int = 0

    @property
    def runs(self) -> int:
        """How many runs there will be at most."""
        searched = (self.points + self.extra) * len(self.problem.tasks())
        rounds = 1 + math.ceil(self.extra / max(1, self.round))
        each = (most_fresh(self.repeats) + CHECKS) * len(self.problem.measured.conditions)
        return searched + rounds * each

    @property
    def round(self) -> int:
        """How many sets of parameters are tried at once where a result contradicts itself."""
        return math.ceil(self.extra / _ROUNDS)

    def describe(self) -> dict[str, Any]:
        """Return all that decides the numbers of the fit; a fit of anything else is another one."""
        problem, table = self.problem, self.table
        return {
            "model": MODEL_VERSION,
            "scene": canonical(self.scene),
            "data": {"titles": list(table.titles), "rows": [list(row) for row in table.rows]},
            "free": {
                free.key: {"low": free.low, "high": free.high, "unit": free.unit, "log": free.log}
                for free in problem.ranges
            },
            "seeds": list(problem.seeds),
            **problem.prior.describe(),
            "sd": self.sd,
            "times": [datum.time for datum in problem.measured.data],
            "specimens": self.specimens,
            **({"scatter": problem.scatter} if problem.scatter != "stated" else {}),
        }

    def left(self, folder: str | Path | None) -> tuple[int, float]:
        """Return how many runs are left at most, and the time on one core in s that they take."""
        from multicell.studies.cost import cost_of

        costs = [cost_of(condition.scene) for condition in self.problem.measured.conditions]
        count = max(0, self.runs - (0 if folder is None else self._done(Path(folder))))
        return count, count * sum(cost.seconds for cost in costs) / len(costs)

    def _done(self, folder: Path) -> int:
        """Return how many runs of the fit a folder has; nothing of another fit counts."""
        known = _read_fit(folder)
        if known is None or known.get("problem") != json.loads(to_json(self.describe())):
            return 0
        return sum("values" in entry for entry in Lines(folder / SEARCH).entries)

    @contextmanager
    def open_folder(self, place: str | Path, *, overwrite: bool = False) -> Iterator[Path]:
        """Make the folder of the fit, or open that of the same one; keep other processes out."""
        folder = Path(place)
        asked = json.loads(to_json(self.describe()))
        known = None if overwrite else _read_fit(folder)
        if known is None:
            make_folder(folder, overwrite=overwrite or is_begun(folder, self._first(folder)))
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
                remove(folder, (*FIT_FILES, *copied_files(folder)))
            new = _read_fit(folder) is None
            for name, content in self._first(folder).items():
                if new or not _holds(folder / name, content):  # damaged since, or changed
                    write_bytes(folder / name, content)
            if new:
                entry = {"multicell": package_version(), "problem": asked}
                write_table(folder / FIT, entry)  # the last: then all is there
            yield folder

    def _first(self, folder: Path) -> dict[str, bytes]:
        """Return the content of what is written to a folder first, by name."""
        scene, content = copy_of(self.scene, folder)
        return {
            **content,
            "scene.toml": scene.to_toml(beside=folder).encode(),
            "data.csv": csv_text(self.table.titles, self.table.rows).encode(),
        }


def _holds(path: Path, content: bytes) -> bool:
    with file_errors("read", path):
        return path.is_file() and path.read_bytes() == content


def make_runs(
    plan: FitPlan,
    folder: Path | None,
    pool: Pool,
    seconds: float | None = None,
    progress: Progress = lambda what, done, wanted: None,
) -> Fit:
    """Make all runs of a fit that are not there; it took ``seconds``, else as long as these runs.

    Where the result contradicts itself, and the plan allows more runs, the search continues.
    """
    begin = clock.monotonic()
    search = Search(plan.problem, None if folder is None else folder / SEARCH)
    points, most = plan.points, plan.points + plan.extra
    while True:
        evaluations = search.run(pool, points, partial(progress, "runs of the search"))
        note = partial(progress, "fresh runs")
        again = fresh(plan.problem, search, pool, plan.repeats, note)
        taken = clock.monotonic() - begin if seconds is None else seconds
        found = _found(plan, folder, search, evaluations, again, taken)
        if len(evaluations) >= most or not found.contradictions:
            return found
        points = min(len(evaluations) + plan.round, most)


def _found(
    plan: FitPlan,
    folder: Path | None,
    search: Search,
    evaluations: Sequence[Evaluation],
    again: Fresh,
    seconds: float,
) -> Fit:
    facts = {
        "sd": plan.sd,
        "specimens": plan.specimens,
        "seeds": list(plan.problem.seeds),
        "repeats": plan.repeats,
        "sets_of_parameters": len(evaluations),
        "fresh_runs": plan.repeats if again.checks is None else plan.repeats + CHECKS,
        "seconds": seconds,
    }
    problem, stated = plan.problem, None
    if again.problem is not None:
        problem, stated = again.problem, problem
        evaluations = search.on(problem).evaluations()
    return Fit(problem, plan.scene, evaluations, folder, facts, again, search.readings, stated)


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
    """Return the description of the fit in a folder, None where there is none."""
    try:
        return read_document(folder / FIT)
    except OutputError as error:
        raise OutputError(f"{error}. Allow overwriting to begin anew") from error
