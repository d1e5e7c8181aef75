"""One table of all that the runs of a study have found: an ``xarray.Dataset`` with units.

Dimensions are those of the design (the axes of a grid; ``point`` for a list),
``seed`` and ``time``. Variables are the columns of the histories, at common times, and the numbers
of the summaries that histories do not have, under their names with ``_`` for dots. A run that is
not done, has failed, or has ended before a time has NaN there; ``state`` and ``reason`` say which.
"""

from __future__ import annotations

import json
import os
import shlex
import sys
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from multicell.host.extras import needs
from multicell.results.folder import write_bytes
from multicell.results.netcdf import write_netcdf
from multicell.results.quantities import known_unit
from multicell.studies.runs import MODEL_VERSION, run_digest
from multicell.studies.status import FAILURES, RunStatus, failed_status, read_finished
from multicell.tables.titles import titled

if TYPE_CHECKING:
    import xarray

    from multicell.studies.plan import Plan

TABLE_FILE: Final = "study.nc"
TABLE_FORMAT: Final = 1
_SKIPPED: Final = ("units", "versions", "title", "notes", "seed")
FloatArray = NDArray[np.float64]


def common_times(plan: Plan) -> FloatArray:
    """Return the times of a table, s: multiples of ``output.every``, and the end of the longest."""
    every, end = plan.scene.output.every, max(scene.duration for scene in plan.scenes)
    count = int(end / every * (1.0 + 1e-12))
    times = every * np.arange(count + 1, dtype=np.float64)
    return times if times[-1] >= end * (1.0 - 1e-12) else np.append(times, end)


def dataset(plan: Plan, folder: Path, states: Sequence[RunStatus]) -> xarray.Dataset:
    """Return the table of a study.

    Histories are read one at a time, so that no more than the table itself is held in memory. A run
    that cannot be read is one that failed, as its row states (:func:`states_of`).

    - ``folder``: of the study, with ``runs/<name>``
    - ``states``: of all runs, in the order of ``plan.names``

    Returns xarray.Dataset: with attributes for its provenance, and for every variable its
    ``units``.
    """
    needs("xarray")
    import xarray

    times, made = common_times(plan), list[Mapping[str, str]]()
    states, units = list(states), defaultdict[str, str](str)
    columns = defaultdict[str, FloatArray](lambda: np.full((len(states), len(times)), np.nan))
    scalars = defaultdict[str, FloatArray](lambda: np.full(len(states), np.nan))
    for place, state in enumerate(states):
        if state.state != "done":
            continue
        try:
            rows, numbers, own_units, versions = _read(folder, state.name, times)
        except FAILURES as error:
            states[place] = failed_status(state.name, error)
            continue
        made.append(versions)
        units |= own_units
        for name, row in rows.items():
            columns[name][place] = row
        for name, number in numbers.items():
            scalars[name][place] = number
    shape, dims, coordinates = _space(plan)
    variables: dict[str, Any] = {
        name: ((*dims, "time"), column.reshape(*shape, len(times)), {"units": units[name]})
        for name, column in columns.items()
    }
    for name, column in scalars.items():
        variables.setdefault(name, (dims, column.reshape(shape), {"units": units[name]}))
    texts = {
        "state": [state.state for state in states],
        "reason": [state.reason for state in states],
        "run": [state.name for state in states],
    }
    for name, words in texts.items():
        variables[name] = (dims, np.array(words, dtype=object).reshape(shape))
    coordinates["time"] = ("time", times, {"units": "s"})
    return xarray.Dataset(variables, coordinates, provenance(plan, made))


def states_of(table: xarray.Dataset, states: Sequence[RunStatus]) -> list[RunStatus]:
    """Return states of runs, of which some have failed to be read into a table."""
    found = zip(table["state"].values.ravel(), table["reason"].values.ravel(), strict=True)
    return [
        known if known.state == state else RunStatus(known.name, str(state), str(reason))
        for known, (state, reason) in zip(states, found, strict=True)
    ]


def _space(plan: Plan) -> tuple[tuple[int, ...], tuple[str, ...], dict[str, Any]]:
    """Return shape, names and coordinates of the dimensions of points and seeds."""
    coordinates: dict[str, Any] = {}
    axes, grid = plan.axes, plan.design == "grid"
    if grid:
        shape, dims = tuple(len(axis.values) for axis in axes), tuple(axis.name for axis in axes)
    else:
        shape, dims = (len(plan.points),), ("point",)
        coordinates["point"] = ("point", np.arange(len(plan.points)))
    for axis in axes:
        about = {"units": axis.unit, "key": axis.key}
        entry = np.array(axis.coordinates, dtype=object if axis.numbers is None else float)
        coordinates[axis.name] = (axis.name if grid else "point", entry, about)
    seeds = plan.scene.seed + np.arange(plan.seeds, dtype=np.int64)
    coordinates["seed"] = ("seed", seeds)
    return (*shape, plan.seeds), (*dims, "seed"), coordinates


def _read(
    folder: Path, name: str, times: FloatArray
) -> tuple[dict[str, FloatArray], dict[str, float], dict[str, str], dict[str, str]]:
    """Return history at common times, numbers of the summary, units and versions of a run."""
    history, summary = read_finished(name, folder)
    rows = {
        column: at_times(times, history["time"], values)
        for column, values in history.items()
        if column != "time"
    }
    numbers: dict[str, float] = {}
    units = {column: known_unit(column) for column in rows}
    for path, value in _flat(summary):
        flat = "end_time" if path == "time" else path.replace(".", "_")
        if flat not in rows:
            numbers[flat], units[flat] = value, known_unit(path)
    made = summary.get("versions")
    return rows, numbers, units, made if isinstance(made, dict) else {}


def at_times(times: FloatArray, known: FloatArray, values: FloatArray) -> FloatArray:
    """Return a column of a history at other times: linear between its rows, NaN beyond the last.

    Where the value of a row does not exist (NaN), it does not between that row and the next ones
    either; at the time of a row it is that of the row.
    """
    result = np.interp(times, known, values, right=np.nan)
    # interpolation to the very time of a row beside one that is NaN must give the row
    place = np.searchsorted(known, times * (1.0 - 1e-12)).clip(max=len(known) - 1)
    exact = np.isclose(known[place], times, rtol=1e-12, atol=0.0)
    result[exact] = values[place[exact]]
    return result


def _flat(summary: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, float]]:
    """Yield the numbers of a summary by their dotted names; what does not exist is NaN."""
    for name, value in summary.items():
        if not path and name in _SKIPPED:
            continue
        if isinstance(value, Mapping):
            yield from _flat(value, f"{path}{name}.")
        elif value is None:
            yield f"{path}{name}", float("nan")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield f"{path}{name}", float(value)


def provenance(plan: Plan, made: Sequence[Mapping[str, str]]) -> dict[str, Any]:
    """Return where a table comes from: versions, the digest and text of its scene, the command.

    - ``made``: versions of what has computed each run; of a package of which runs have several the
      table states all
    """
    known: dict[str, list[str]] = {}
    for name, number in (entry for versions in made for entry in versions.items()):
        if number not in known.setdefault(name, []):
            known[name].append(number)
    several = {name: found if len(found) > 1 else found[0] for name, found in known.items()}
    return {
        "format": TABLE_FORMAT,
        "model_version": MODEL_VERSION,
        "title": plan.scene.title,
        "scene": plan.scene.to_toml(),
        "scene_digest": run_digest(plan.scene),
        "plan": plan.to_toml(),
        "versions": json.dumps(several),
        "command": shlex.join(sys.argv),
    }


def save_dataset(table: xarray.Dataset, path: Path) -> None:
    """Write a table as netCDF, so that the file is either the old one or complete."""
    packed = {
        name: {"zlib": True, "complevel": 1, "shuffle": True}
        for name, variable in table.data_vars.items()
        if variable.dtype.kind == "f" and variable.size
    }
    write_netcdf(table, path, packed, f"{os.getpid()}.part")  # two processes may write it


def write_study_csv(table: xarray.Dataset, path: Path) -> None:
    """Write a table as CSV, one row for each run and time, with units in the header."""
    needs("pandas")
    frame = table.to_dataframe().reset_index()
    names = {n: titled(n, table[n].attrs.get("units", "")) for n in frame if n in table.variables}
    text = frame.rename(columns=names).to_csv(index=False, lineterminator=os.linesep)
    write_bytes(path, text.encode())
