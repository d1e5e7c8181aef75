"""Fitting a scene to measured data: the best parameters in few runs, or their posterior."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

from multicell.calibration.data import ASSUMED, MAX_BYTES, read_data
from multicell.calibration.fitted import Fit
from multicell.calibration.fresh import CHECKS, DEFAULT_REPEATS, MAX_REPEATS
from multicell.calibration.likelihood import MIN_REPEATS
from multicell.calibration.pool import Pool, open_pool
from multicell.calibration.problem import Problem, problem_of, ranges_of
from multicell.errors import SceneError
from multicell.host.extras import needs
from multicell.schema import chosen
from multicell.studies.limits import MAX_POINTS, MAX_RUNS, check_runs, check_seeds, whole
from multicell.tables.fields import Table, read_table
from multicell.units import to_base

if TYPE_CHECKING:
    from multicell.calibration.fresh import Fresh
    from multicell.calibration.posterior import Draws
    from multicell.calibration.search import Evaluation
    from multicell.calibration.simulator import Simulator
    from multicell.scene.scene import Scene

METHODS: Final = ("best", "posterior")
_LEAST: Final = 10  # sets of parameters that a search must be able to try
_SEARCHED: Final = 0.8  # part of a budget of time that the search takes; the rest is for fresh runs

Progress = Callable[[str, int, int], None]
"""Called with the stage, how much of it is done and how much is wanted."""


def fit(
    scene: Scene | str | Path,
    data: Any,
    free: Mapping[str, Any],
    *,
    output: str | Path | None = None,
    method: str = "best",
    seeds: int = 2,
    repeats: int = DEFAULT_REPEATS,
    budget: int | str | None = None,
    population: int = 200,
    start: float | str | None = None,
    sd: float = ASSUMED,
    coarse: float = 1.0,
    cores: int | None = None,
    scheduler: str | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
    simulator: Simulator | None = None,
) -> Fit:
    """Fit parameters of a scene to measured data.

    Parameters
    ----------
    scene
        A scene, the name of a built-in one, or the path of a TOML file.
    data
        CSV file, ``DataFrame`` or mapping of titles to columns, with units in the titles; see
        :mod:`multicell.calibration.data`.
    free
        Key of the scene -> its range, ``"8:25 h"``, ``"log 1e-3:1 1/s"`` or two values. Within it
        all values are equally likely beforehand (on a logarithmic range: all ratios).
    output
        Folder for everything. The same fit in the same folder continues: nothing is run twice,
        and a larger budget adds to what is there.
    method
        ``"best"``: a best point in few runs, with intervals by an emulator fitted to them;
        ``"posterior"``: the posterior, sampled with runs.
    seeds
        Runs with different random numbers of each set of parameters in the search. Those of the
        posterior take one run each, with random numbers of its own.
    repeats
        Runs with fresh random numbers at the best point, from which the intervals of a search have
        the scatter of runs; 8 to 16 are sensible.
    budget
        Number of runs, or a time such as ``"2 h"``, in all. By default as many runs as the number
        of free parameters asks for.
    population
        Draws in a generation of the posterior.
    start
        Time of the data at which runs begin, where no column ``start`` says so.
    sd
        Relative standard deviation of data that come without one.
    coarse
        Search with runs of the scene that is coarse by this factor (:func:`multicell.coarsen`),
        corrected by fine runs at draws from the intervals; runs with fresh seeds are fine. See
        :mod:`multicell.calibration.coarse_to_fine`. With ``method="best"``; 1: all runs are fine.
    cores
        Processes on this machine, by default one for each core; 1 runs everything in this process.
    scheduler
        Address of a Dask scheduler whose workers are used instead.
    overwrite
        Whether another fit in the folder may be replaced.
    progress
        Called with the stage, how much is done and how much is wanted.
    simulator
        What stands for the runs, for tests and emulators of one's own.

    Returns
    -------
    Fit

    Raises
    ------
    SceneError, DataError, MissingPackage
        For input that cannot be used, before anything runs.
    OutputError
        For a folder that cannot be used.
    FitFailed
        If no run gives anything to compare, or a budget ends before there is a result.
    """
    plan = plan_of(
        scene, data, free, method=method, seeds=seeds, repeats=repeats, budget=budget,
        population=population, start=start, sd=sd, coarse=coarse, simulator=simulator,
    )  # fmt: skip
    return carry_out(
        plan, output=output, cores=cores, scheduler=scheduler, overwrite=overwrite,
        progress=progress,
    )  # fmt: skip


@final
@dataclass(frozen=True)
class FitPlan:
    """A fit that was checked and not begun.

    - ``points``: sets of parameters that the search will try
    - ``draws``: most draws of the posterior
    - ``seconds``: time in s that the budget allows; infinite where it is a number of runs
    - ``coarse``: factor of the coarse runs that search first; 1 where there are none
    """

    problem: Problem
    scene: Scene
    table: Table
    method: str
    points: int
    draws: int
    seconds: float
    population: int
    sd: float
    repeats: int
    coarse: float = 1.0

    @property
    def runs(self) -> int:
        """How many runs there will be at most."""
        return self._planned_runs + self.draws * self._conditions

    @property
    def _planned_runs(self) -> int:
        """How many runs are not draws: those of the search, and fresh ones."""
        each = len(self.problem.tasks())
        return self.points * each + _fresh_runs(self.method, self.repeats) * self._conditions

    @property
    def _conditions(self) -> int:
        return len(self.problem.measured.conditions)

    def describe(self) -> dict[str, Any]:
        """Return what decides all numbers of the fit."""
        from multicell.calibration.fit_folder import describe

        times = [datum.time for datum in self.problem.measured.data]
        options = {"sd": self.sd, "population": self.population, "times": times}
        options |= getattr(self.problem.simulator, "stated", {})
        return describe(self.problem, self.scene, self.table, options)

    def left(self, folder: str | Path | None) -> tuple[int, float]:
        """Return how many runs are left at most, and the time on one core in s that they take."""
        from multicell.calibration.fit_folder import work_done
        from multicell.studies.cost import cost_of

        if self.coarse != 1.0:
            from multicell.calibration.coarse_to_fine import expected

            return expected(self)
        runs, draws, finished = (
            (0, 0, False) if folder is None else work_done(folder, self.describe())
        )
        searched = max(0, self._planned_runs - runs)
        drawn = 0 if finished else max(0, self.draws - draws)
        each = [cost_of(c.scene).seconds for c in self.problem.measured.conditions]
        count = searched + drawn * self._conditions
        return count, float(sum(each) / len(each) * count)


def plan_of(
    scene: Scene | str | Path,
    data: Any,
    free: Mapping[str, Any],
    *,
    method: str = "best",
    seeds: int = 2,
    repeats: int = DEFAULT_REPEATS,
    budget: int | str | None = None,
    population: int = 200,
    start: float | str | None = None,
    sd: float = ASSUMED,
    coarse: float = 1.0,
    simulator: Simulator | None = None,
) -> FitPlan:
    """Check all that a fit is given, and run nothing; parameters as of :func:`fit`."""
    from multicell.scene.scene import load_scene

    if isinstance(scene, str | Path):
        scene = load_scene(scene)
    chosen(method, METHODS, "method")
    seeds = check_seeds(seeds, scene.seed)
    whole(
        "repeats", repeats, MIN_REPEATS, MAX_REPEATS, "It is the number of runs with fresh seeds."
    )
    whole("population", population, 10, MAX_POINTS, "It is the number of draws in a generation.")
    table = read_table(data, MAX_BYTES)
    measured = read_data(table, scene, start=start, sd=sd)
    ranges = ranges_of(free, measured)
    check_runs(len(measured.conditions), seeds)
    problem = problem_of(measured, ranges, seeds, scene.seed, simulator)
    fresh = _fresh_runs(method, repeats)
    points, draws, seconds = _spend(problem, method, budget, population, fresh)
    if coarse != 1.0:
        from multicell.calibration.coarse_to_fine import coarse_simulator

        if method != "best" or isinstance(budget, str):
            raise SceneError("coarse", "needs the method 'best' and a budget in runs")
        coarse_simulator(problem.simulator, coarse)
    return FitPlan(
        problem, scene, table, method, points, draws, seconds, population, sd, repeats, coarse
    )


def _fresh_runs(method: str, repeats: int) -> int:
    """Return how many runs of each condition have fresh seeds."""
    return repeats + (CHECKS if method == "best" else 0)


def _spend(
    problem: Problem, method: str, budget: int | str | None, population: int, fresh: int
) -> tuple[int, int, float]:
    """Return sets of parameters of the search, draws of the posterior, and s."""
    searched = method == "best"
    points = 20 + 15 * len(problem.ranges) if searched else 0
    draws = 0 if searched else 50 * population
    if budget is None:
        return points, draws, math.inf
    if isinstance(budget, str):
        seconds = to_base(budget, "s", "budget")
        if seconds <= 0.0:
            raise SceneError("budget", f"is {budget!r}, must be above 0")
        return 10 * points, 100 * draws, seconds
    whole("budget", budget, 1, MAX_RUNS, "It is the number of runs in all.")
    conditions, each = len(problem.measured.conditions), len(problem.tasks())
    left = max(0, budget - fresh * conditions)
    if not searched:
        draws, least = left // conditions, 2 * population
        if draws < least:
            words = f"leaves {draws} draws for the posterior, which takes at least {least}"
            raise SceneError("budget", words, "A smaller population takes fewer.")
        return 0, draws, math.inf
    points = left // each
    if points < _LEAST:
        words = (
            f"is {budget} runs: what {fresh * conditions} fresh runs leave tries {points} sets "
            f"of parameters, {each} runs each"
        )
        raise SceneError("budget", words, f"It takes at least {_LEAST} sets.")
    return points, 0, math.inf


def carry_out(
    plan: FitPlan,
    *,
    output: str | Path | None = None,
    cores: int | None = None,
    scheduler: str | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Fit:
    """Carry out a fit that was checked; parameters as of :func:`fit`."""
    needs("optuna", "pyabc", "distributed", "pandas", "sklearn", "sqlalchemy")
    if plan.coarse != 1.0:
        from multicell.calibration.coarse_to_fine import fit_coarse_first

        return fit_coarse_first(
            plan, carry_out, output, cores=cores, scheduler=scheduler, overwrite=overwrite,
            progress=progress,
        )  # fmt: skip
    from multicell.calibration.fit_folder import open_folder, write_result

    progress = progress or (lambda what, done, wanted: None)
    with ExitStack() as stack:
        folder = None
        if output is not None:
            folder = stack.enter_context(
                open_folder(output, plan.describe(), plan.scene, plan.table, overwrite=overwrite)
            )
        begin = clock.monotonic()
        with open_pool(cores, scheduler) as pool:
            evaluations, draws, again = _make_runs(plan, folder, pool, begin, progress)
        facts = {
            "method": plan.method,
            "sd": plan.sd,
            "seeds": list(plan.problem.seeds),
            "sets_of_parameters": len(evaluations),
            "draws": 0 if draws is None else draws.drawn,
            "generations": 0 if draws is None else draws.generations,
            "temperature": None if draws is None else draws.temperature,
            "fresh_runs": plan.repeats if again.checks is None else plan.repeats + CHECKS,
            "seconds": clock.monotonic() - begin,
        }
        found = Fit(plan.problem, plan.scene, evaluations, draws, folder, facts, again)
        if folder is not None:
            write_result(found, folder)
            found.report()
        return found


def _make_runs(
    plan: FitPlan, folder: Path | None, pool: Pool, begin: float, progress: Progress
) -> tuple[list[Evaluation], Draws | None, Fresh]:
    """Make all runs of a fit that are not there."""
    from multicell.calibration.fit_folder import SEARCH
    from multicell.calibration.fresh import fresh
    from multicell.calibration.posterior import posterior
    from multicell.calibration.search import Search

    def note_draws(generation: int, accepted: int, wanted: int, drawn: int) -> None:
        of = "calibration" if generation < 0 else f"generation {generation + 1}"
        progress(f"posterior, {of}, {drawn:,} draws", accepted, wanted)

    search = Search(plan.problem, None if folder is None else folder / SEARCH)
    evaluations: list[Evaluation] = []
    draws: Draws | None = None
    if plan.method == "best":
        evaluations = search.run(
            pool, plan.points, deadline=begin + _SEARCHED * plan.seconds,
            progress=partial(progress, "runs of the search"),
        )  # fmt: skip
    else:
        draws = posterior(
            plan.problem, pool, folder=folder, population=plan.population, most=plan.draws,
            deadline=begin + plan.seconds, progress=note_draws,
        )  # fmt: skip
    note = partial(progress, "fresh runs")
    again = fresh(plan.problem, search, pool, search.emulator(), draws, plan.repeats, note)
    return evaluations, draws, again
