"""Fits that are stored: opened without a run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

from multicell.calibration.columns import MAX_BYTES
from multicell.calibration.data import read_data
from multicell.calibration.fit_plan import FIT, FitPlan, make_runs
from multicell.calibration.fitted import Fit
from multicell.calibration.pool import Pool
from multicell.calibration.priors import Density, prior_of
from multicell.calibration.problem import Problem, ranges_of
from multicell.calibration.simulator import SceneSimulator
from multicell.errors import MulticellError, OutputError
from multicell.results.documents import read_table as read_document
from multicell.results.folder import to_json
from multicell.tables.columns import read_table

FACTS: Final = (
    "sd", "specimens", "seeds", "repeats", "sets_of_parameters", "fresh_runs", "seconds",
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
    plan = _stored_plan(folder, result)
    facts = {name: value for name, value in result.items() if name in FACTS}

    def refuse(*call: Any) -> None:
        raise OutputError(f"'{folder}' lacks runs of its fit: the same fit makes them again")

    return make_runs(plan, folder, Pool(call=refuse), facts)


def _stored_plan(folder: Path, result: dict[str, Any]) -> FitPlan:
    """Return what a folder holds a fit of."""
    from multicell.scene.scene import load_scene

    entry = read_document(folder / FIT)
    if entry is None:
        raise OutputError(f"'{folder}' holds no fit")
    try:
        problem = entry["problem"]
        scene = load_scene(folder / "scene.toml")
        table = read_table(folder / "data.csv", MAX_BYTES)
        measured = read_data(table, scene, sd=problem["sd"], specimens=problem["specimens"])
        given = {key: (r["low"], r["high"], *(["log"] if r["log"] else []))
                 for key, r in problem["free"].items()}  # fmt: skip
        ranges = ranges_of(given, measured)
        known_of = problem.get("densities", {})
        densities = [Density.of(*known_of[r.key]) if r.key in known_of else None for r in ranges]
        prior = prior_of(ranges, densities)
        simulator, seeds = SceneSimulator.of(measured, ranges), tuple(problem["seeds"])
        stated = Problem(measured, ranges, simulator, seeds, prior)
        plan = FitPlan(
            stated, scene, table, int(result.get("sets_of_parameters", 0)),
            float(problem["sd"]), int(result.get("repeats", 0)), problem["specimens"],
        )  # fmt: skip
    except MulticellError as error:
        raise OutputError(f"'{folder}' holds a fit that cannot be opened: {error}") from error
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError) as error:
        raise OutputError(f"'{folder}' holds a damaged fit: {error!r}") from error
    if json.loads(to_json(plan.describe())) != problem:
        raise OutputError(f"'{folder}' holds a fit that its scene or data have been changed in")
    return plan
