"""Dose response of a population: viability, half-maximal doses, two drugs together."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from multicell.calibration.dose_response.curve import (
    DOSES,
    LEAST,
    Estimate,
    combine_drugs,
    draw_means,
    fit_curve,
)
from multicell.calibration.dose_response.numbers import Row
from multicell.calibration.dose_response.result import DoseResponse
from multicell.errors import DataError, ExitCode, FitFailed, OutputError, SceneError
from multicell.host.extras import needs
from multicell.measured.columns import finite_entry
from multicell.measured.table import read_measurements
from multicell.scene.scene import load_scene
from multicell.studies.axes import QUANTITY, Axis, is_numeric, parse_axis
from multicell.studies.keys import key_of
from multicell.studies.limits import check_seeds
from multicell.studies.picture_data import key_words, words
from multicell.studies.plan import Plan, make_plan
from multicell.studies.readings import chosen_observables, read_final
from multicell.studies.study import Study, write_study
from multicell.tables.titles import split_title, unknown_title
from multicell.units import shown

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from multicell.cells import FloatArray
    from multicell.scene.scene import Scene
    from multicell.studies.engine import RunOutcome

LIVING: Final = "proliferating+quiescent"
"""The living cells: columns of the history, added up."""
RESAMPLES: Final = 1000  # some 25 lie beyond each end of an interval of 95 %
_WRITTEN: Final = ("viability", "run", "reason")
"""Further columns of the table that an analysis writes."""


def dose_response(
    scene: Scene | str | Path | None = None,
    dose: str | None = None,
    doses: Any = None,
    *,
    combine: Sequence[str] | None = None,
    observable: str = LIVING,
    seeds: int = 5,
    data: Any = None,
    columns: str | None = None,
    where: str | None = None,
    output: str | Path | None = None,
    overwrite: bool = False,
    cores: int | None = None,
    scheduler: str | None = None,
    retry: bool = False,
    report: bool = True,
    progress: Callable[[RunOutcome], None] | None = None,
) -> DoseResponse:
    """Find the dose at which half of a population is left, from runs or from measured data.

    The runs are those of a study whose points are a list, in the same folder: one that was stopped
    continues with the same call, and more doses or seeds reuse the existing runs.

    Parameters
    ----------
    scene
        A scene, the name of a built-in one, or a path; None for measured data.
    dose
        The key that is the dose, ``"nutrients.drug.boundary"``. Of a schedule,
        ``"nutrients.drug.media"``, every concentration above zero takes it.
    doses
        0, the control, and at least four rising doses, as ``"0, log 0.01:10:8 uM"`` or a list.
    combine
        In place of ``dose`` two keys, of two drugs; ``doses`` is then one list for both, or a
        tuple of two, and all pairs of doses run.
    observable
        A column of a run's history at its end, or several joined by ``+``; by default the living
        cells.
    seeds
        Runs of each dose, with the same seeds at all doses.
    data
        In place of a scene a table of measured responses: a CSV file, a ``DataFrame`` or a mapping
        of columns, with the titles ``dose / UNIT`` (or ``dose A / UNIT`` and ``dose B / UNIT``),
        ``response`` and, where the same replicate is found at all doses, ``replicate``.
    columns, where
        What the columns of the table are and which rows are meant, as of :func:`multicell.fit`.
    output
        Folder; by default ``dose-response`` for runs and none for data.
    overwrite
        Whether the folder may hold another study, whose runs stay.
    cores, scheduler, retry
        As in :meth:`multicell.studies.study.Study.run`.
    report
        Whether to write the page and its pictures; tables are written in any case.
    progress
        Called with the outcome of each run.

    Raises
    ------
    SceneError
        For unknown keys and observables, doses without a control, too few or not rising, and any
        dose that the scene refuses.
    DataError
        For a table that cannot be used.
    FitFailed
        Where the responses have no curve: the same at all doses, or none at the control.
    MissingPackage, OutputError, ClusterError
        As for :func:`multicell.sensitivity`.
    """
    if data is not None:
        if any(given is not None for given in (scene, dose, doses, combine)):
            raise SceneError("data", "stands in place of a scene and doses", "Give one of them.")
        result = replace(
            of_table(data, columns, where), folder=None if output is None else Path(output)
        )
        if output is not None:
            result.write_tables()
    else:
        plan = plan_dose_response(
            scene, dose, doses, combine=combine, observable=observable, seeds=seeds
        )
        folder = Path("dose-response" if output is None else output)
        write_study(plan.study, folder, overwrite=overwrite)
        how = {"cores": cores, "scheduler": scheduler, "progress": progress, "retry": retry}
        result = run_dose_plan(plan, folder, **how)
    if report and result.folder is not None:
        result.report()
    return result


@final
@dataclass(frozen=True)
class DosePlan:
    """Runs at doses that were checked and not made.

    - ``scene``, ``observable``: as in :func:`dose_response`
    - ``names``, ``units``: of the doses of each drug
    - ``points``, (m, k): doses of the points of the study, in these units
    - ``study``: the plan of the runs
    """

    scene: Scene
    observable: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    points: FloatArray
    study: Plan


def plan_dose_response(
    scene: Scene | str | Path | None,
    dose: str | None,
    doses: Any,
    *,
    combine: Sequence[str] | None = None,
    observable: str = LIVING,
    seeds: int = 5,
) -> DosePlan:
    """Return the plan of runs at doses, in which everything is checked.

    Parameters and errors are those of :func:`dose_response`.
    """
    needs("distributed")
    if scene is None or doses is None or (dose is None) == (combine is None):
        problem = "needs a scene, doses, and the key of one drug (dose) or of two (combine)"
        raise SceneError("dose", problem, "Or measured data.")
    described = load_scene(scene) if isinstance(scene, str | Path) else scene
    check_seeds(seeds, described.seed)
    chosen_observables(described, observable.split("+"))
    if combine is None:
        assert dose is not None
        keys, given = [dose], [doses]
    else:
        if isinstance(combine, str) or len(combine) != 2 or combine[0] == combine[1]:
            raise SceneError("combine", f"is {shown(combine)}, must be two keys")
        keys = list(combine)
        given = list(doses) if isinstance(doses, tuple) and len(doses) == 2 else [doses] * 2
    axes = [_axis(described, key, values) for key, values in zip(keys, given, strict=True)]
    found = [_doses(axis) for axis in axes]
    grid = np.stack(np.meshgrid(*(np.arange(len(d)) for d, _ in found), indexing="ij"), axis=-1)
    places = grid.reshape(-1, len(found))
    table: dict[str, list[Any]] = {}
    for drug, (key, axis) in enumerate(zip(keys, axes, strict=True)):
        setting = _setting(described, key)
        table[key] = [setting(axis.values[place]) for place in places[:, drug]]
    names = tuple(key_words(key, key.rpartition(".")[2]) for key in keys)
    points = np.stack([d[places[:, k]] for k, (d, _) in enumerate(found)], axis=1)
    study = make_plan(described, points=table, seeds=seeds)
    units = tuple(unit for _, unit in found)
    return DosePlan(described, observable, names, units, points, study)


def _axis(scene: Scene, name: str, values: Any) -> Axis:
    """Return the doses that a key takes, which must be a control and rising doses above it."""
    field = name.removeprefix("nutrients.").partition(".")[0]
    if "." not in name and field in scene.nutrients:
        hint = f"For example nutrients.{field}.boundary."
        raise SceneError(name, "is a field, not a value: name one of its keys", hint)
    if field not in scene.nutrients and ("." not in name or name.startswith("nutrients.")):
        problem = f"the scene has no field '{field}'; its fields: {', '.join(scene.nutrients)}"
        hint = f"A drug is a field of its own: add [nutrients.{field}] to the scene."
        raise SceneError(name, problem, hint)
    key = key_of(scene, name)
    first = key.name
    if key.spec.kind == "schedule":  # its numbers are as those of the medium at the start
        first = f"{first.rpartition('.')[0]}.boundary"
    elif not is_numeric(key):
        raise SceneError(key.name, "is no number, which a dose must be")
    axis = parse_axis(first, values, scene)
    numbers = axis.numbers or ()
    hint = "For example '0, log 0.01:10:8 uM'."
    if not numbers or 0.0 not in numbers:
        raise SceneError(key.name, "has no dose 0, the control", hint)
    if list(numbers) != sorted(numbers) or numbers[0] != 0.0:
        raise SceneError(key.name, "has doses that do not rise from the control, 0", hint)
    if len(numbers) <= LEAST:
        problem = f"has {len(numbers) - 1} doses above the control, must have at least {LEAST}"
        raise SceneError(key.name, problem, hint)
    return axis


def _doses(axis: Axis) -> tuple[FloatArray, str]:
    """Return doses and their unit as they are given, in base units where units differ."""
    matches = [QUANTITY.fullmatch(value) for value in axis.values if isinstance(value, str)]
    units = {match[2] for match in matches if match is not None and float(match[1])}
    if len(matches) == len(axis.values) and len(units) == 1:
        return np.array([float(match[1]) for match in matches if match]), units.pop()
    assert axis.numbers is not None
    return np.array(axis.numbers), axis.unit


def _setting(scene: Scene, key: str) -> Callable[[Any], Any]:
    """Return a function from a dose to the value of a key."""
    found = key_of(scene, key)
    if found.spec.kind != "schedule":
        return lambda dose: dose
    course = getattr(found.part, found.name.rpartition(".")[2]) or ()
    if not any(level > 0.0 for _, level in course):
        hint = "Schedule the drug in the scene; a dose takes the place of every number above 0."
        raise SceneError(key, "has no concentration above 0", hint)
    return lambda dose: [[time, dose if level > 0.0 else 0.0] for time, level in course]


def run_dose_plan(plan: DosePlan, folder: Path, **how: Any) -> DoseResponse:
    """Do all runs of a plan that are not done, and return the result.

    - ``how``: as :meth:`multicell.studies.study.Study.run` takes it
    """
    study, parts = Study(plan.study, folder), plan.observable.split("+")
    outcomes = study.run(**how)
    final, failures = read_final(outcomes, folder, parts)
    values = np.sum([final[part] for part in parts], axis=0).reshape(len(plan.points), -1)
    rows = [
        {
            "replicate": run.coordinates["seed"],
            "run": run.name,
            "reason": failures.get(run.name, ""),
        }
        for run in study.runs
    ]
    notes = []
    if failures:
        first = next(failures[run.name] for run in study.runs if run.name in failures)
        notes.append(f"{len(failures)} runs failed and are left out, the first one: {first}")
    if plan.scene.stop_cells is not None:
        notes.append(
            f"runs end at {plan.scene.stop_cells:,} cells (stop_cells), so that those of different "
            "doses may end at different times"
        )
    known = "living cells" if plan.observable == LIVING else words(plan.observable)
    try:
        result = analyse_doses(
            plan.points,
            values,
            rows,
            names=plan.names,
            units=plan.units,
            response=known,
            shared=True,
            notes=notes,
            scene=plan.scene,
            folder=folder,
            title=plan.scene.title or "Untitled scene",
        )
    except FitFailed as error:
        stopped = [run.reason for run in outcomes if run.kind in ("machine", "unreadable")]
        if not stopped:
            raise
        problem = f"{len(stopped)} runs could not be made, the first one: {stopped[0]}"
        raise OutputError(problem, exit_code=ExitCode.MACHINE) from error
    result.write_tables()  # numbers do not wait for a page
    return result


def of_table(source: Any, columns: str | None = None, where: str | None = None) -> DoseResponse:
    """Return the dose response of measured data.

    Parameters and errors are those of :func:`dose_response`.
    """
    table = read_measurements(source, columns, where)
    titles = [split_title(title) for title in table.titles]
    words = {word.lower(): word for word in (*DOSES[1], *DOSES[2], "response", "replicate")}
    known = [(words.get(name.lower(), name), unit) for name, unit in titles]
    place_of = {name: place for place, (name, _) in enumerate(known)}
    pair = "dose A" in place_of or "dose B" in place_of
    drugs = list(DOSES[2] if pair else DOSES[1])
    allowed = [*drugs, "response", "replicate", *_WRITTEN]
    named = Counter(name for name, _ in known)
    for (name, _), title in zip(known, table.titles, strict=True):
        if named[name] > 1:
            raise DataError(f"{table.name}, '{title}'", "has the name of another column, too")
        if name not in allowed:
            raise unknown_title(title, dict.fromkeys(allowed[:-3], ""), table.name)
    for name in (*drugs, "response"):
        if name not in place_of:
            raise DataError(table.name, f"has no column '{name}'", "Titles: 'dose / uM, response'.")
    cells: dict[tuple[tuple[float, ...], str], float] = {}
    times: Counter[tuple[float, ...]] = Counter()
    shared = "replicate" in place_of
    for row_place, row in zip(table.places, table.rows, strict=True):
        if not row[place_of["response"]]:
            continue  # not measured, or a run that failed
        place = f"{table.name}, {row_place}"
        *doses, value = (
            finite_entry(row[place_of[name]], f"{place}, '{name}'") for name in (*drugs, "response")
        )
        point = tuple(doses)
        if min(point) < 0.0:
            raise DataError(place, "has a dose below 0")
        times[point] += 1
        label = row[place_of["replicate"]] if shared else f"{times[point]}"
        if (point, label) in cells:
            raise DataError(place, f"is the second one of the replicate '{label}' at this dose")
        cells[point, label] = value
    rising = sorted({point for point, _ in cells})
    labels = list(dict.fromkeys(label for _, label in cells))
    _check_points(rising, len(drugs), table.name)
    values = np.array([[cells.get((p, label), math.nan) for label in labels] for p in rising])
    rows = [{"replicate": label, "run": "", "reason": ""} for _ in rising for label in labels]
    return analyse_doses(
        np.array(rising),
        values,
        rows,
        names=drugs,
        units=[known[place_of[name]][1] for name in drugs],
        response="response",
        shared=shared,
        title=table.name,
    )


def _check_points(points: Sequence[tuple[float, ...]], drugs: int, table: str) -> None:
    """Refuse a table without the control, with too few doses, or without those of one drug."""
    if (0.0,) * drugs not in points:
        raise DataError(table, "has no response at dose 0, the control")
    for drug in range(drugs):
        alone = sum(point[drug] > 0.0 and sum(point) == point[drug] for point in points)
        if alone < LEAST:
            name = DOSES[drugs][drug]
            problem = f"has {alone} doses above 0 in '{name}', must have at least {LEAST}"
            raise DataError(table, problem, "" if drugs == 1 else "Each drug alone needs so many.")
    for point in points:
        for drug in range(drugs if min(point) > 0.0 else 0):
            single = tuple(d if k == drug else 0.0 for k, d in enumerate(point))
            if single not in points:
                problem = f"has the doses {point}, but no response at {single}"
                raise DataError(table, problem, "Both references need each dose alone.")


def analyse_doses(
    points: FloatArray,
    values: FloatArray,
    rows: Sequence[Row],
    *,
    names: Sequence[str],
    units: Sequence[str],
    response: str,
    shared: bool,
    title: str,
    notes: Sequence[str] = (),
    scene: Scene | None = None,
    folder: Path | None = None,
) -> DoseResponse:
    """Return the dose response of values (m, n) at points (m, k), NaN where there are none.

    The first point is the control, and ``rows`` says of each value where it comes from; other
    parameters are those of :class:`DoseResponse` and
    :mod:`multicell.calibration.dose_response.curve`.
    """
    there: NDArray[np.bool_] = np.asarray(np.isfinite(values).any(axis=1))
    means = np.array([np.mean(row[np.isfinite(row)]) for row in values[there]])
    control = float(means[0]) if there[0] else math.nan
    if not there[0]:
        reason = next((row["reason"] for row in rows[: values.shape[1]] if row.get("reason")), "")
        said = f": its runs failed, the first one: {reason}" if reason else ""
        raise FitFailed(f"nothing is known of the control{said}", "Everything is relative to it.")
    if not control > 0.0:
        hint = "Viability is relative to it: it must be above 0."
        raise FitFailed(f"the control has the response {control:g}", hint)
    found = list(notes)
    table: list[Row] = []
    for place, about in enumerate(rows):
        point, column = divmod(place, values.shape[1])
        value = float(values[point, column])
        if math.isnan(value) and not about["reason"]:
            continue
        doses = dict(zip(DOSES[len(names)], points[point].tolist(), strict=True))
        numbers = {"response": value, "viability": value / control}
        table.append({**doses, "replicate": about["replicate"], **numbers, **about})
    points, values = points[there], values[there]
    counts = np.isfinite(values).sum(axis=1).astype(float)
    draws = draw_means(values, shared, RESAMPLES)
    curves = []
    for drug, (name, unit) in enumerate(zip(names, units, strict=True)):
        alone = np.flatnonzero(np.delete(points, drug, axis=1).sum(axis=1) == 0.0)
        curve = fit_curve(
            points[alone, drug],
            means[alone],
            counts[alone],
            None if draws is None else draws[:, alone],
            name=name,
            unit=unit,
            resamples=RESAMPLES,
        )
        curves.append(curve)
    pairs: list[Row] = []
    totals: dict[str, Estimate] = {}
    if len(names) == 2:
        drawn = None
        if draws is not None:
            drawn = draws / np.where(draws[:, :1] > 0.0, draws[:, :1], np.nan)
        pairs, totals = combine_drugs(points, means / means[0], drawn, curves)
    if draws is None:
        found.append(
            "no replicates: intervals are from the scatter of the responses about the curve"
            + (", and there are none of the combinations" if pairs else "")
        )
    return DoseResponse(
        title,
        tuple(curves),
        response,
        int(counts.max()),
        table,
        pairs,
        totals,
        found,
        scene,
        folder,
    )
