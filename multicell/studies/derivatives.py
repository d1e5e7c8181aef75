"""Derivatives of observables by keys of a scene: central differences with common random numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from multicell.errors import SceneError
from multicell.results.quantities import known_unit
from multicell.scene.scene import Scene, load_scene
from multicell.studies.axes import is_numeric
from multicell.studies.keys import Key, key_of
from multicell.studies.limits import MAX_SEEDS, whole_between
from multicell.studies.plan import make_plan
from multicell.studies.readings import chosen_observables
from multicell.studies.run_table import (
    Row,
    RunTable,
    checked_times,
    folder_for,
    mean_and_error,
    values_of,
)
from multicell.studies.study import write_study
from multicell.units import finite, shown

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.studies.engine import RunOutcome


def gradient(
    scene: Scene | str | Path,
    observables: str | Sequence[str],
    keys: str | Sequence[str],
    *,
    step: float = 0.05,
    seeds: int = 8,
    times: Sequence[float | str] | None = None,
    output: str | Path | None = None,
    cores: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[RunOutcome], None] | None = None,
) -> RunTable:
    """Return derivatives of observables by keys of a scene.

    By central differences ``(y(x + h) - y(x - h)) / 2h``, with the same seeds on both sides, so
    that much of the scatter of runs cancels. That takes 2 x keys x seeds runs.

    Parameters
    ----------
    scene
        A scene, the name of a built-in one, or the path of a file.
    observables
        Columns of the history, or at the end also dotted entries of the summary.
    keys
        Dotted keys of numbers, such as ``"growth.cycle_time"``.
    step
        h over the value of the key, 0.001 to 0.5; 0.05 to 0.1 are sensible: tissues of one seed
        part whatever the step.
    seeds
        Runs on each side, at least 2: with the scene's seed and those that follow it.
    times
        When; by default at the end.
    output
        Folder of the study whose runs these are; what is there is not run again. By default the
        runs are not kept.
    cores, scheduler, progress
        As in :meth:`multicell.studies.study.Study.run`.

    Returns
    -------
    RunTable
        A row for each observable, time and key. ``derivative`` is in ``unit`` per ``key_unit``,
        ``elasticity`` is d ln y / d ln x, both with standard errors over the seeds (``..._se``).
        ``mean`` is that of y over both sides, ``seeds`` how many of them have both.
        ``variance_reduction`` is the variance that different seeds on both sides would give over
        the one that there is.

    Raises
    ------
    SceneError
        For an unknown observable; a key that is no number, absent, zero or without effect; a step
        after which the scene is refused; before anything runs.
    OutputError
        If the folder cannot be used, or holds another study.
    MissingPackage, ClusterError
        As :meth:`multicell.studies.study.Study.run`.
    """
    base = scene if isinstance(scene, Scene) else load_scene(scene)
    step = finite(step, "step", "a number")
    if not 0.001 <= step <= 0.5:
        raise SceneError("step", f"is {step:g}, must be from 0.001 to 0.5", "It is a part of x.")
    whole_between("seeds", seeds, 2, MAX_SEEDS, "It is the number of runs on each side.")
    named = chosen_observables(base, [observables] if isinstance(observables, str) else observables)
    at = checked_times(base, times)
    wanted = [keys] if isinstance(keys, str) else list(keys)
    if not wanted:
        raise SceneError("keys", "name none", "For example 'growth.cycle_time'.")
    found = [key_of(base, key) for key in wanted]
    values = [_value(base, key) for key in found]
    ends = [_ends(key, value, step) for key, value in zip(found, values, strict=True)]
    points = {
        key.name: [ends[k][side] if k == j else value for j in range(len(found)) for side in (0, 1)]
        for k, (key, value) in enumerate(zip(found, values, strict=True))
    }
    plan = make_plan(base, points=points, seeds=seeds)
    with folder_for(output) as folder:
        study = write_study(plan, folder)
        known, notes = values_of(study, named, at, cores, scheduler, progress)
    rows = [
        _row(name, time, key, values[j], ends[j], ys[2 * j : 2 * j + 2, :, t])
        for name, ys in known.items()
        for t, time in enumerate([base.duration] if at is None else at)
        for j, key in enumerate(found)
    ]
    lost = [f"{r['observable']} by {r['key']}" for r in rows if r["seeds"] < seeds]
    if lost:
        notes.append(f"not all seeds have both sides: {', '.join(lost)}")
    return RunTable(rows, notes, {"step": step, "seeds": seeds, "runs": len(set(plan.names))})


def _value(scene: Scene, key: Key) -> float:
    """Return the value of a key; raises SceneError for one that has no difference."""
    entry: Any = scene.to_dict()
    for name in key.name.split("."):
        entry = entry.get(name) if isinstance(entry, dict) else None
    if entry is None:
        hint = f"Set it first: with_changes({{'{key.name}': ...}})."
        raise SceneError(key.name, "is absent, so that there is nothing to change", hint)
    if not is_numeric(key) or isinstance(entry, bool) or not isinstance(entry, int | float):
        raise SceneError(key.name, f"is {shown(entry)}, must be a number")
    if entry == 0:
        raise SceneError(key.name, "is 0, of which no part is a step", "Give it another value.")
    return entry


def _ends(key: Key, value: float, step: float) -> tuple[float, float]:
    """Return the values on both sides, the lower one first."""
    low, high = sorted((value * (1.0 - step), value * (1.0 + step)))
    if key.spec.kind != "count":
        return low, high
    if round(low) == value or round(high) == value:
        problem = f"is {value:g}, of which a step of {step:g} is not one"
        raise SceneError(key.name, problem, "It is a whole number: take a larger step.")
    return round(low), round(high)


def _row(
    name: str, time: float, key: Key, value: float, ends: tuple[float, float], ys: FloatArray
) -> Row:
    """Return a row of the table; ``ys`` is (2, seeds)."""
    both = ys[:, np.isfinite(ys).all(axis=0)]
    slope, error = mean_and_error((both[1] - both[0]) / (ends[1] - ends[0]))
    mean = float(both.mean()) if both.size else float("nan")
    apart, common = (
        (both.var(axis=1, ddof=1).sum(), (both[1] - both[0]).var(ddof=1))
        if both.shape[1] > 1
        else (np.nan, np.nan)
    )
    scale = value / mean if mean else float("nan")
    return {
        "observable": name,
        "unit": known_unit(name),
        "time": float(time),
        "key": key.name,
        "key_unit": key.unit,
        "value": float(value),
        "low": float(ends[0]),
        "high": float(ends[1]),
        "derivative": slope,
        "derivative_se": error,
        "elasticity": slope * scale,
        "elasticity_se": error * abs(scale),
        "mean": mean,
        "seeds": both.shape[1],
        "variance_reduction": float(apart / common) if common > 0.0 else float("nan"),
    }
