"""The folder of a fit: what it is a fit of, what was tried, what was found."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

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
    write_text,
)
from multicell.results.start_copy import with_copy
from multicell.scene.start_table import COPIES
from multicell.studies.runs import MODEL_VERSION, canonical
from multicell.tables.fields import Table
from multicell.tables.text import csv_text, table_text

if TYPE_CHECKING:
    from multicell.calibration.fitted import Fit
    from multicell.scene.scene import Scene

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
