"""A recorded problem with its reference solution as one file of plain arrays (``.npz``).

No objects are pickled: a cache file can be opened without trusting it. Arrays of all coupling
steps are laid end to end, with their lengths beside them.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from multicell.comparison.replay import Events, Problem, Step, Trajectory
from multicell.mechanics.system import Motion
from multicell.results.folder import replacing, words

_FORMAT = 2


def save(path: Path, problem: Problem, trajectory: Trajectory, facts: Mapping[str, Any]) -> bool:
    """Write a problem and its reference; return False if its motion has no plain form.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    motions = _flat([step.motion for step in problem.steps])
    if motions is None:
        return False
    with_events = [k for k, step in enumerate(problem.steps) if step.before is not None]
    events = [step.before for step in problem.steps if step.before is not None]
    arrays = {
        "format": np.array(_FORMAT),
        "facts": np.array(json.dumps(dict(facts))),
        "start": problem.start,
        "count": problem.counts,
        "positions": np.concatenate(trajectory.positions),
        "events": np.array(with_events, dtype=np.int64),
        "source": np.concatenate([e.source for e in events] or [np.zeros(0, np.int64)]),
        "offset": np.concatenate([e.offset for e in events] or [np.zeros((0, 3))]),
        "total": np.array(problem.total),
        **({} if problem.starts is None else {"starts": np.concatenate(problem.starts)}),
        **motions,
    }
    with words("write", path):
        path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as file:
        np.savez(file, **arrays)
    return True


def load(path: Path, blank: Problem) -> tuple[Problem, Trajectory, dict[str, Any]] | None:
    """Return what :func:`save` has written; None if there is no such file or it is damaged.

    Parameters
    ----------
    path
        The file.
    blank
        Problem with the scene and the mechanics, whose steps are still unknown.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        return _restored(arrays, blank)
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile):
        return None  # a cache: what it cannot give is computed again


def _restored(
    arrays: Mapping[str, Any], blank: Problem
) -> tuple[Problem, Trajectory, dict[str, Any]]:
    if int(arrays["format"]) != _FORMAT:
        raise ValueError("another format")
    count = arrays["count"]
    shocked = count[arrays["events"]]
    events: dict[int, Events] = {
        int(k): Events(source, offset)
        for k, source, offset in zip(
            arrays["events"], _cut(arrays["source"], shocked), _cut(arrays["offset"], shocked),
            strict=True,
        )
    }  # fmt: skip
    motions = _motions(arrays, count)
    steps = [Step(motion, events.get(k)) for k, motion in enumerate(motions)]
    starts = _cut(arrays["starts"], count) if "starts" in arrays else None
    problem = Problem(
        blank.scene, blank.template, arrays["start"], blank.radius, steps, starts,
        int(arrays["total"]),
    )  # fmt: skip
    facts: dict[str, Any] = json.loads(str(arrays["facts"]))
    return problem, Trajectory(_cut(arrays["positions"], count)), facts


def _flat(motions: Sequence[Motion]) -> dict[str, Any] | None:
    """Return every field of the motions as one array, or None if one has no plain form."""
    flat: dict[str, Any] = {}
    for spec in fields(Motion):
        values = [getattr(motion, spec.name) for motion in motions]
        known = [value for value in values if value is not None]
        if not known:
            continue
        if all(isinstance(value, int | float) for value in values):
            flat[f"scalar.{spec.name}"] = np.array(values)
        elif all(isinstance(v, np.ndarray) and v.dtype != object and v.ndim for v in known):
            flat[f"column.{spec.name}"] = np.concatenate(known)
            flat[f"length.{spec.name}"] = np.array([0 if v is None else len(v) for v in values])
            if len(known) < len(values):
                flat[f"absent.{spec.name}"] = np.array([value is None for value in values])
        else:
            return None
    return flat


def _motions(arrays: Mapping[str, Any], count: Any) -> list[Motion]:
    """Return the motions again; what was None, everywhere or in some steps, is None."""
    entries: dict[str, Any] = {spec.name: [None] * len(count) for spec in fields(Motion)}
    for name, array in arrays.items():
        kind, _, field = name.partition(".")
        if kind == "scalar":
            entries[field] = array.tolist()
        elif kind == "column":
            entries[field] = _cut(array, arrays[f"length.{field}"])
            for k in np.flatnonzero(arrays.get(f"absent.{field}", ())):
                entries[field][k] = None
    return [
        Motion(**{name: values[k] for name, values in entries.items()}) for k in range(len(count))
    ]


def _cut(array: Any, count: Any) -> list[Any]:
    """Cut an array into runs of the given lengths; each owns its memory."""
    parts = np.split(array, np.cumsum(count)[:-1])
    return [np.array(part) for part in parts] if len(count) else []
