"""Fits that are stored: opened without a run, and their runs in a fit of other data."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from multicell.calibration.data import MAX_BYTES, read_data
from multicell.calibration.fit_plan import FIT, SEARCH, FitPlan, make_runs
from multicell.calibration.fitted import Fit
from multicell.calibration.pool import Pool
from multicell.calibration.priors import Density, prior_of
from multicell.calibration.problem import Problem, problem_of, ranges_of
from multicell.calibration.search import Search, entry_of
from multicell.calibration.simulator import OUTGROWN
from multicell.errors import MulticellError, OutputError, SceneError
from multicell.results.documents import read_table as read_document
from multicell.results.folder import to_json
from multicell.studies.axes import Range
from multicell.studies.runs import canonical
from multicell.tables.columns import read_table

if TYPE_CHECKING:
    from multicell.calibration.data import Condition, Datum
    from multicell.scene.scene import Scene


FACTS: Final = (
    "sd", "specimens", "scatter", "seeds", "repeats", "sets_of_parameters", "reused",
    "fresh_runs", "seconds", "coarse",
)  # fmt: skip


def load_fit(folder: str | Path) -> Fit:
    """Open the folder of a fit that is done; nothing is run.

    Parameters
    ----------
    folder
        Of the fit.

    Returns
    -------
    Fit

    Raises
    ------
    OutputError
        If there is no fit in it, it is not done, or files are damaged.
    """
    folder = Path(folder)
    result = read_document(folder / "result.json")
    if result is None:
        raise OutputError(f"'{folder}' holds no fit that is done")
    plan = stored_plan(folder, result)
    facts = {name: value for name, value in result.items() if name in FACTS}

    def refuse(*call: Any) -> None:
        raise OutputError(f"'{folder}' lacks runs of its fit: the same fit makes them again")

    return make_runs(plan, folder, Pool(call=refuse), facts)


def stored_plan(folder: Path, result: dict[str, Any] | None = None) -> FitPlan:
    """Return what a folder holds a fit of; without a result its runs are those of a search."""
    from multicell.scene.scene import load_scene

    entry = read_document(folder / FIT)
    if entry is None:
        raise OutputError(f"'{folder}' holds no fit")
    known = result or {}
    try:
        problem = entry["problem"]
        request = entry.get("request", {})
        scene = load_scene(folder / "scene.toml")
        table = read_table(folder / "data.csv", MAX_BYTES)
        measured = read_data(
            table, scene, start=request.get("start"), sd=problem["sd"],
            specimens=problem["specimens"],
        )  # fmt: skip
        given = {key: (r["low"], r["high"], *(["log"] if r["log"] else []))
                 for key, r in problem["free"].items()}  # fmt: skip
        ranges = ranges_of(given, measured)
        known_of = problem.get("densities", {})
        densities = [Density.of(*known_of[r.key]) if r.key in known_of else None for r in ranges]
        prior = prior_of(ranges, densities, request.get("constraints", ()))
        seeds = problem["seeds"]
        stated = problem_of(
            measured, ranges, len(seeds), seeds[0], scatter=problem["scatter"], prior=prior
        )
        plan = FitPlan(
            stated, scene, table, int(known.get("sets_of_parameters", 0)), float("inf"),
            float(problem["sd"]), int(known.get("repeats", 0)), problem["specimens"],
        )  # fmt: skip
    except MulticellError as error:
        raise OutputError(f"'{folder}' holds a fit that cannot be opened: {error}") from error
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError) as error:
        raise OutputError(f"'{folder}' holds a damaged fit: {error!r}") from error
    own = {name: value for name, value in problem.items() if name != "simulator"}
    if json.loads(to_json(plan.describe())) != own:
        raise OutputError(f"'{folder}' holds a fit that its scene or data have been changed in")
    return plan


def reusable(problem: Problem, folder: str | Path) -> list[dict[str, Any]]:
    """Return the entries of a search's log for those runs of another fit that serve this one too.

    They are of the same scene, conditions and seeds, with parameters within these ranges; a run
    kept no more than what the data of its fit asked for.
    """
    folder = Path(folder)
    other = stored_plan(folder).problem
    if "simulator" in (read_document(folder / FIT) or {})["problem"]:
        raise SceneError("reuse", f"names '{folder}', whose search made coarse runs")
    if {free.key for free in problem.ranges} != {free.key for free in other.ranges}:
        raise SceneError("reuse", f"names '{folder}', whose free parameters are others")
    if not set(problem.seeds) <= set(other.seeds):
        raise SceneError("reuse", f"names '{folder}', whose runs have other seeds")
    places = [_places(problem, other, k, folder) for k in range(len(problem.measured.conditions))]
    readings = Search(other, folder / SEARCH).readings
    order = [[free.key for free in other.ranges].index(free.key) for free in problem.ranges]
    entries: list[dict[str, Any]] = []
    points = []
    for shares in dict.fromkeys(point for point, *_ in readings):
        wanted = [(k, seed) for k, seed in problem.tasks()]
        old = [(shares, places[k][0], seed) for k, seed in wanted]
        here = [
            _share(free, other.ranges[i], shares[i])
            for free, i in zip(problem.ranges, order, strict=True)
        ]
        if not all(run in readings for run in old) or not problem.prior.allows(here):
            continue
        points.append(here)
        for (k, seed), run in zip(wanted, old, strict=True):
            values = tuple(readings[run].values[i] for i in places[k][1])
            found = replace(readings[run], values=values)
            entries.append(entry_of((tuple(here), k, seed), found, reused=True))
    return [{"points": points, "reused": True}, *entries] if points else []


def _share(free: Range, other: Range, share: float) -> float:
    """Return where a value of one range lies in another range, the same place in the same one."""
    if (free.low, free.high, free.log) == (other.low, other.high, other.log):
        return share
    value = other.value(share)
    if free.whole and not free.log:
        return (value + 0.5 - free.low) / (free.high + 1.0 - free.low)
    return free.share(value)


def _places(problem: Problem, other: Problem, number: int, folder: Path) -> tuple[int, list[int]]:
    """Return the condition of another fit that one is, and where its readings of the data are."""
    condition = problem.measured.conditions[number]
    scenes = [_without_end(there.scene) for there in other.measured.conditions]
    if (own := _without_end(condition.scene)) not in scenes:
        under = f" under the condition '{condition.label}'" if condition.changes else ""
        raise SceneError("reuse", f"names '{folder}', whose scene is another one{under}")
    k = scenes.index(own)
    there = other.measured.conditions[k]
    known = [_asked(datum, there) for datum in other.measured.of(k)]
    found = []
    for datum in problem.measured.of(number):
        asked = _asked(datum, condition)
        if asked not in known:
            missing = f"'{datum.observable}' of {datum.place}"
            hint = "Its fit had no datum there."
            raise SceneError("reuse", f"names '{folder}', whose runs did not keep {missing}", hint)
        found.append(known.index(asked))
    for name in OUTGROWN:
        sizes = [
            max((d.value for d in p.measured.of(c) if d.observable == name), default=0.0)
            for p, c in ((problem, number), (other, k))
        ]
        if sizes[0] > sizes[1] > 0.0:
            words = f"names '{folder}', whose runs may have ended before '{name}' was as large"
            raise SceneError("reuse", words)
    return k, found


def _without_end(scene: Scene) -> Any:
    return {key: value for key, value in canonical(scene).items() if key != "duration"}


def _asked(datum: Datum, condition: Condition) -> tuple[Any, ...]:
    """Return what a run has to be read for."""
    end = condition.scene.duration if datum.time is None and datum.at is None else None
    return datum.observable, datum.time, datum.at, datum.depth, end
