"""Fitting a scene to measured data: the best parameters in few runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final

from multicell.calibration.fitting.likelihood import (
    CHECKS,
    DEFAULT_REPEATS,
    MAX_REPEATS,
    MIN_REPEATS,
    most_fresh,
)
from multicell.calibration.fitting.plan import FitPlan, Progress, make_runs, write_result
from multicell.calibration.fitting.pool import open_pool
from multicell.calibration.fitting.problem import SCATTERS, FitProblem, free_of
from multicell.calibration.fitting.result import Fit
from multicell.calibration.fitting.simulator import SceneSimulator, Simulator
from multicell.calibration.fitting.unknown_scatter import check_scatter
from multicell.errors import SceneError
from multicell.host.extras import needs
from multicell.measured.data import ASSUMED, read_data
from multicell.measured.table import read_measurements
from multicell.scene.scene import Scene, load_scene
from multicell.schema import chosen
from multicell.studies.limits import MAX_RUNS, check_cores, check_runs, check_seeds, whole_between

_LEAST: Final = 10  # sets of parameters that a search must be able to try


def fit(
    scene: Scene | str | Path,
    data: Any,
    free: Mapping[str, Any],
    *,
    output: str | Path | None = None,
    seeds: int = 2,
    repeats: int = DEFAULT_REPEATS,
    budget: int | None = None,
    sd: float = ASSUMED,
    specimens: str = "same",
    scatter: str = "stated",
    constraints: str | Sequence[str] = (),
    columns: str | Mapping[str, str] | None = None,
    where: str | None = None,
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
        Table (CSV, Excel), ``DataFrame`` or mapping of titles to columns, with units in the titles;
        see :mod:`multicell.measured.data`.
    free
        Key of the scene -> its range, ``"8:25 h"``, ``"log 1e-3:1 1/s"`` or two values, in which
        all values are equally likely beforehand (on a logarithmic range: all ratios); or its
        distribution, as ``"norm(18 h, 2 h)"``, ``"lognorm(median=0.02 mM/s, sigma=0.3)"``,
        ``"norm(18 h, 2 h) in 10:30 h"``: see :mod:`multicell.calibration.fitting.priors`.
    output
        Folder for everything. The same fit in the same folder continues: nothing is run twice,
        and a larger budget adds to what is there.
    seeds
        Runs with different random numbers of each set of parameters in the search.
    repeats
        Runs with fresh random numbers at the best point, from which the intervals of a search have
        the scatter of runs; 8 to 16 are sensible.
    budget
        Number of runs in all; by default as many as the number of free parameters asks for, and
        up to half of them again where the result contradicts itself.
    sd
        Relative standard deviation of data that come without one.
    specimens
        ``"single"``: each row is another specimen, measured once, also without a column that
        says so.
    scatter
        ``"unknown"``: the errors of each observable have an unknown size, a factor on what is
        stated (or on ``sd``) that is fitted too.
    constraints
        Orders of two free parameters, ``"necrosis < quiescence"``, or several.
    columns
        What the columns of the data are, ``"day=Day, radius=R um"``; absent: what their titles say.
    where
        Which rows are meant, ``"CellLine=983b, Day=3..7"``.
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
    plan = plan_fit(
        scene,
        data,
        free,
        seeds=seeds,
        repeats=repeats,
        budget=budget,
        sd=sd,
        specimens=specimens,
        scatter=scatter,
        constraints=constraints,
        columns=columns,
        where=where,
        simulator=simulator,
    )
    return run_fit_plan(
        plan,
        output=output,
        cores=cores,
        scheduler=scheduler,
        overwrite=overwrite,
        progress=progress,
    )


def plan_fit(
    scene: Scene | str | Path,
    data: Any,
    free: Mapping[str, Any],
    *,
    seeds: int = 2,
    repeats: int = DEFAULT_REPEATS,
    budget: int | None = None,
    sd: float = ASSUMED,
    specimens: str = "same",
    scatter: str = "stated",
    constraints: str | Sequence[str] = (),
    columns: str | Mapping[str, str] | None = None,
    where: str | None = None,
    simulator: Simulator | None = None,
) -> FitPlan:
    """Check all that a fit is given, and run nothing; parameters as of :func:`fit`."""
    if isinstance(scene, str | Path):
        scene = load_scene(scene)
    seeds = check_seeds(seeds, scene.seed)
    chosen(scatter, SCATTERS, "scatter")
    whole_between(
        "repeats", repeats, MIN_REPEATS, MAX_REPEATS, "It is the number of runs with fresh seeds."
    )
    table = read_measurements(data, columns, where)
    measured = read_data(table, scene, sd=sd, specimens=specimens)
    ranges, prior = free_of(free, measured, constraints)
    check_runs(len(measured.conditions), seeds)
    simulator = simulator or SceneSimulator.of(measured, ranges)
    numbers = tuple(range(scene.seed, scene.seed + seeds))
    problem = FitProblem(measured, ranges, simulator, numbers, prior, scatter)
    if scatter == "unknown":
        check_scatter(problem)
    points = _points(problem, budget, most_fresh(repeats) + CHECKS)
    extra = points // 2 if budget is None else 0
    return FitPlan(problem, scene, table, points, sd, repeats, specimens, extra)


def _points(problem: FitProblem, budget: int | None, fresh: int) -> int:
    """Return how many sets of parameters a search tries."""
    if budget is None:
        return 20 + 15 * len(problem.ranges)
    whole_between("budget", budget, 1, MAX_RUNS, "It is the number of runs in all.")
    conditions, each = len(problem.measured.conditions), len(problem.tasks())
    left = max(0, budget - fresh * conditions)
    points = left // each
    if points < _LEAST:
        words = (
            f"is {budget} runs: what {fresh * conditions} fresh runs leave tries {points} sets "
            f"of parameters, {each} runs each"
        )
        least = fresh * conditions + _LEAST * each
        raise SceneError("budget", words, f"Give at least {least} runs, for {_LEAST} sets.")
    return points


def run_fit_plan(
    plan: FitPlan,
    *,
    output: str | Path | None = None,
    cores: int | None = None,
    scheduler: str | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Fit:
    """Carry out a fit that was checked; parameters as of :func:`fit`."""
    needs("optuna", "distributed", "pandas", "sklearn")
    check_cores(cores)
    with ExitStack() as stack:
        folder = None
        if output is not None:
            folder = stack.enter_context(plan.open_folder(output, overwrite=overwrite))
        with open_pool(cores, scheduler) as pool:
            found = make_runs(plan, folder, pool, progress=progress or (lambda *state: None))
        if folder is not None:
            write_result(found, folder)
            found.report()
        return found
