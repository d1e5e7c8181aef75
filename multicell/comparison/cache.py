"""References on disk, by version, scene and pair of methods: files of plain arrays (``.npz``).

No objects are pickled: a cache file can be opened without trusting it. Arrays of all coupling
steps are laid end to end, with their lengths beside them.
"""

from __future__ import annotations

import hashlib
import json
import os
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from multicell.cells import Cells
from multicell.comparison.replay import Events, Problem, Step, Trajectory
from multicell.mechanics.motion import Motion
from multicell.results.folder import file_errors, replace_file, versions
from multicell.scene.scene import Scene

FORMAT: Final = 5  # counts up whenever a reference is computed or written in another way

_NO_NUMBERS: Final = ("cli", "comparison", "report", "studies", "calibration")
"""Rooms that can change no number of a reference; for this one :data:`FORMAT` answers."""


def cache_folder() -> Path:
    """Return the folder of the user's cache: ``$MULTICELL_CACHE``, or below ``~/.cache``."""
    own = os.environ.get("MULTICELL_CACHE")
    if own:
        return Path(own)
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "multicell" / "references"


def source_hash(folder: Path | None = None) -> str:
    """Return a hash of all sources that can change a number of a reference.

    - ``folder``: folder of the package, by default that of multicell
    """
    root = Path(__file__).parent.parent if folder is None else folder
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        place = path.relative_to(root)
        if place.parts[0] not in _NO_NUMBERS:
            digest.update(str(place).encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def key(scene: Scene, cells: Cells | None, pair: Any) -> str:
    """Return what a reference depends on as one hash: versions, scene, cells, pair of methods.

    - ``scene``: its output and integrator have no part in a reference
    - ``pair``: how the reference is computed, as JSON can hold it
    """
    entries = scene.to_dict()
    entries.pop("output", None)
    entries["integrator"] = {"max_displacement": scene.integrator.max_displacement}
    version = [FORMAT, versions(), source_hash()]
    described = json.dumps([version, entries, pair], sort_keys=True)
    digest = hashlib.sha256(described.encode())
    for name, column in () if cells is None else cells.columns():
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(column).tobytes())
    return digest.hexdigest()[:32]


def save(path: Path, problem: Problem, trajectory: Trajectory, about: Mapping[str, Any]) -> Path:
    """Write a problem and its reference, and what else is known about it; return the path.

    Raises OutputError if the file cannot be written.
    """
    events = [step.before for step in problem.steps]
    columns: dict[str, Sequence[Any]] = {
        "ends": trajectory.positions,
        "starts": [] if problem.starts is None else problem.starts,
        "source": [None if event is None else event.source for event in events],
        "offset": [None if event is None else event.offset for event in events],
    }
    for spec in fields(Motion):
        columns[f"motion.{spec.name}"] = [getattr(s.motion, spec.name) for s in problem.steps]
    arrays: dict[str, Any] = {
        "about": np.array(json.dumps(dict(about))),
        "total": np.array(problem.total),
        "start": problem.start,
        "radius": problem.radius,
    }
    for name, values in columns.items():
        arrays |= _pack(name, values)
    with file_errors("write", path):
        path.parent.mkdir(parents=True, exist_ok=True)
    with replace_file(path) as file:
        np.savez(file, **arrays)
    return path


def load(path: Path, blank: Problem) -> tuple[Problem, Trajectory, dict[str, Any]] | None:
    """Return what :func:`save` has written; None if there is no such file or it is damaged.

    - ``blank``: problem with the scene and the mechanics; where it starts and its steps are still
      unknown
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        return _restore(arrays, blank)
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile):
        return None  # a cache: what it cannot give is computed again


def _restore(
    arrays: Mapping[str, Any], blank: Problem
) -> tuple[Problem, Trajectory, dict[str, Any]]:
    columns = {spec.name: _unpack(arrays, f"motion.{spec.name}") for spec in fields(Motion)}
    ends = _unpack(arrays, "ends") or []
    none = [None] * len(ends)
    sources, offsets = (_unpack(arrays, name) or none for name in ("source", "offset"))
    steps = []
    for k, (source, offset) in enumerate(zip(sources, offsets, strict=True)):
        motion = Motion(**{name: values[k] for name, values in columns.items() if values})
        steps.append(Step(motion, None if source is None else Events(source, offset)))
    about: dict[str, Any] = json.loads(str(arrays["about"]))
    problem = replace(
        blank, start=arrays["start"], radius=arrays["radius"], steps=steps,
        starts=_unpack(arrays, "starts"), total=int(arrays["total"]),
    )  # fmt: skip
    return problem, Trajectory(ends), about


def _pack(name: str, values: Sequence[Any]) -> dict[str, Any]:
    """Return numbers, or arrays and None, of all steps as one array; their lengths beside it."""
    known = [value for value in values if value is not None]
    if not known:
        return {}
    if all(isinstance(value, int | float) for value in values):
        return {name: np.array(values)}
    length = np.array([-1 if value is None else len(value) for value in values])
    return {name: np.concatenate(known), f"{name}.length": length}


def _unpack(arrays: Mapping[str, Any], name: str) -> list[Any] | None:
    """Return what :func:`_pack` was given; each array owns its memory."""
    if name not in arrays:
        return None
    if f"{name}.length" not in arrays:
        return list(arrays[name].tolist())
    length = arrays[f"{name}.length"]
    ends = np.cumsum(np.maximum(length, 0))
    parts = np.split(arrays[name], ends[:-1])
    return [None if n < 0 else np.array(part) for n, part in zip(length, parts, strict=True)]
