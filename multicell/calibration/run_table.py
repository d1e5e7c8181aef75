"""All runs of a fit as rows, as the table of a study, and as a study."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from multicell.calibration.noise import Array
from multicell.calibration.predictive import predictive_of
from multicell.report.wording import time_unit

if TYPE_CHECKING:
    import xarray

    from multicell.calibration.data import Datum
    from multicell.calibration.fitted import Fit
    from multicell.studies.study import Study


def rows(fit: Fit) -> list[dict[str, Any]]:
    """Return the runs one by one, base units; see :attr:`Fit.runs`."""
    problem, found = fit.problem, []
    columns = list(dict.fromkeys(map(title_of, problem.measured.data)))
    numbers: dict[tuple[float, ...], int] = {}
    for (shares, condition, seed), reading in fit.readings.items():
        values = problem.values(shares)
        row: dict[str, Any] = {
            "point": numbers.setdefault(shares, len(numbers)),
            "stage": "search" if seed in problem.seeds else "fresh",
            "condition": problem.measured.conditions[condition].label,
            "seed": seed,
            **{free.name: values[free.key] for free in problem.ranges},
            **dict.fromkeys(columns, np.nan),
        }
        data = problem.measured.of(condition)
        row.update(zip(map(title_of, data), reading.values, strict=True))
        found.append({**row, "reason": reading.reason})
    return found


def title_of(datum: Datum) -> str:
    """Return the title of the readings of a datum."""
    deep = "" if datum.depth is None else f" {datum.depth:g} um deep"
    name = f"{datum.observable}{deep}"
    if datum.at is not None:
        return f"{name} at {datum.at[0]} = {datum.at[1]:g}"
    if datum.time is None:
        return f"{name} at the end"
    return f"{name} at {time_unit(datum.time).text(datum.time)}"


def dataset(fit: Fit) -> xarray.Dataset:
    """Return the runs in the form of a study's table; see :meth:`Fit.to_xarray`."""
    import xarray

    problem, measured = fit.problem, fit.problem.measured
    points = {p: k for k, p in enumerate(dict.fromkeys((s, c) for s, c, _ in fit.readings))}
    seeds = sorted({seed for *_, seed in fit.readings})
    times = sorted({datum.time for datum in measured.data if datum.time is not None})
    shape = len(points), len(seeds)
    state = np.full(shape, "missing", dtype=object)
    reason = np.full(shape, "", dtype=object)
    values: dict[str, tuple[tuple[str, ...], Any, dict[str, str]]] = {}
    for datum in measured.data:
        timed, name = _over_time(datum), _variable(datum)
        wide, dims = ((*shape, len(times)), ("time",)) if timed else (shape, ())
        about = {"units": measured.units[datum.observable]}
        values.setdefault(name, (("point", "seed", *dims), np.full(wide, np.nan), about))
    for (shares, condition, seed), reading in fit.readings.items():
        place = points[shares, condition], seeds.index(seed)
        state[place] = "failed" if reading.reason else "done"
        reason[place] = reading.reason
        for datum, value in zip(measured.of(condition), reading.values, strict=True):
            where = [times.index(t) for t in (datum.time,) if t is not None and _over_time(datum)]
            values[_variable(datum)][1][(*place, *where)] = value
    coordinates: dict[str, Any] = {
        "point": np.arange(len(points)), "seed": seeds,
        "time": ("time", np.array(times), {"units": "s"}),
        "condition": ("point", [measured.conditions[c].label for _, c in points]),
    }  # fmt: skip
    for k, free in enumerate(problem.ranges):
        column = [free.value(shares[k]) for shares, _ in points]
        coordinates[free.name] = ("point", column, {"units": free.unit, "key": free.key})
    states = {"state": (("point", "seed"), state), "reason": (("point", "seed"), reason)}
    return xarray.Dataset({**values, **states}, coordinates, {"title": fit.scene.title})


def _over_time(datum: Datum) -> bool:
    return datum.time is not None and datum.depth is None


def _variable(datum: Datum) -> str:
    return datum.observable.replace(".", "_") if _over_time(datum) else title_of(datum)


def to_study(fit: Fit, folder: str | Path) -> Study:
    """Write a study of all sets of parameters of the search; see :meth:`Fit.to_study`."""
    from multicell.studies.study import study

    problem, conditions = fit.problem, fit.problem.measured.conditions
    changed = {key for condition in conditions for key in condition.changes}
    points = []
    for evaluation in fit.evaluations:
        values = problem.values(evaluation.shares.tolist())
        settings = {free.key: free.setting(values[free.key]) for free in problem.ranges}
        points += [{**{key: condition.changes[key] for key in sorted(changed)}, **settings}
                   for condition in conditions]  # fmt: skip
    longest = max(condition.scene.duration for condition in conditions)
    scene = fit.scene.with_changes({"duration": longest})
    return study(scene, points=points, seeds=len(problem.seeds), output=folder)


def to_arviz(fit: Fit) -> Any:
    """Return draws, replicated data and pointwise likelihoods; see :meth:`Fit.to_arviz`."""
    import arviz

    found, problem = predictive_of(fit), fit.problem
    shares, weights = fit.some_sample()
    random = np.random.default_rng(0)
    count = len(shares)
    # ArviZ has no weights
    rows = np.arange(count) if np.ptp(weights) == 0.0 else random.choice(count, count, p=weights)
    data = problem.measured.data
    scaled = problem.observed + np.maximum(found.replicate(), problem.lowest) * problem.sigma
    again = np.array(list(map(problem.unscale, scaled[rows])))
    labels = [f"{title_of(d)}, {problem.measured.conditions[d.condition].label}" for d in data]

    def parameters(places: Array) -> dict[str, Array]:
        return {name: np.array([column]) for name, column in problem.columns(places).items()}

    made = arviz.from_dict(
        posterior=parameters(shares[rows]),
        prior=parameters(problem.prior.draw(random, count)),
        posterior_predictive={"data": again[None]},
        log_likelihood={"data": found.pointwise[rows][None]},
        observed_data={"data": np.array([d.value for d in data])},
        coords={"datum": labels},
        dims={"data": ["datum"]},
    )
    for group in (made.posterior, made.prior):
        for free in problem.ranges:
            group[free.name].attrs["units"] = free.unit
    return made
