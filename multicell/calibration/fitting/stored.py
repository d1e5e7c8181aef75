"""Fits that are stored: opened without a run."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from multicell.calibration.fitting.fit import plan_fit
from multicell.calibration.fitting.plan import FIT, FitPlan, make_runs
from multicell.calibration.fitting.pool import Pool
from multicell.calibration.fitting.priors import Density
from multicell.calibration.fitting.result import Fit
from multicell.errors import MulticellError, OutputError
from multicell.results.documents import read_document
from multicell.results.folder import to_json
from multicell.studies.runs import MODEL_VERSION

_MENDS: Final = "The same 'multicell fit' in this folder writes them again, without a new run"


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
        why = "" if folder.is_dir() else ": there is no such folder"
        raise OutputError(f"'{folder}' holds no fit that is done{why}")
    plan = _stored_plan(folder, result)

    def refuse(*call: Any) -> None:
        raise OutputError(f"'{folder}' lacks runs of its fit: the same fit makes them again")

    return make_runs(plan, folder, Pool(call=refuse), result.get("seconds"))


def _stored_plan(folder: Path, result: dict[str, Any]) -> FitPlan:
    """Return the plan of the fit that a folder holds."""
    entry = read_document(folder / FIT)
    if entry is None:
        raise OutputError(f"'{folder}' holds no fit")
    try:
        problem = entry["problem"]
        if problem["model"] != MODEL_VERSION:
            raise OutputError(
                f"'{folder}' holds a fit of model version {problem['model']}, and this multicell "
                f"has {MODEL_VERSION}, whose runs have other numbers: fit again in another folder, "
                f"or open it with multicell {entry.get('multicell')}"
            )
        known = problem.get("densities", {})
        free = {
            key: (
                *(r["low"], r["high"]),
                *(["log"] if r["log"] else []),
                *([Density.of(*known[key])] if key in known else []),
            )
            for key, r in problem["free"].items()
        }
        plan = plan_fit(
            folder / "scene.toml",
            folder / "data.csv",
            free,
            seeds=len(problem["seeds"]),
            repeats=result["repeats"],
            sd=problem["sd"],
            specimens=problem["specimens"],
            scatter=problem.get("scatter", "stated"),
            constraints=problem.get("constraints", ()),
        )
        plan = replace(plan, points=int(result["sets_of_parameters"]), extra=0)
    except OutputError:
        raise
    except MulticellError as error:
        problem = f"'{folder}' holds a fit that cannot be opened: {error}. {_MENDS}"
        raise OutputError(problem) from error
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError) as error:
        raise OutputError(f"'{folder}' holds a damaged fit: {error!r}") from error
    if json.loads(to_json(plan.describe())) != problem:
        raise OutputError(f"'{folder}' holds a fit whose scene or data have been changed. {_MENDS}")
    return plan
