"""Frames and logs as named arrays, in which form they are written, checked and read."""

from __future__ import annotations

import builtins
import json
from collections import abc
from collections.abc import Iterable, Mapping
from dataclasses import asdict, fields
from types import NoneType
from typing import Any, Final, NamedTuple, final, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from multicell.cells import Cells, Phase, State
from multicell.errors import OutputError
from multicell.integrators.shift import Replays
from multicell.integrators.stability import Stability
from multicell.results.frame import Field, Frame, Progress
from multicell.results.lineage import COLUMNS, Lineage

Arrays = dict[str, NDArray[Any]]

UNIT: Final = "mM"  # unit of all fields and concentrations


@final
class FieldArray(NamedTuple):
    """An array that is stored of a field beside its values.

    Type, entries (0: one number), unit, and what stands where there is no field.
    """

    dtype: str
    width: int
    unit: str
    absent: float


FIELD: Final[Mapping[str, FieldArray]] = {
    "origin": FieldArray("<f8", 3, "um", np.nan),
    "spacing": FieldArray("<f8", 0, "um", np.nan),
    "height": FieldArray("<f8", 0, "um", np.nan),
    "radial": FieldArray("|i1", 0, "", 0),
}

SPARSE: Final = frozenset({"cells/doomed", "cells/damage", "cells/lag"})
"""Arrays that a frame has only where they are not all zero, and a file only if a frame has them."""

_OF_PARTS: Final = ("driven", "first_states", "replays", "stability")
"""Entries of a progress that only some runs have."""
_KEYS: Final = {
    "first_states": {"quiescent", "necrotic", "unfit"},
    "replays": set(Replays._fields),
    "stability": set(Stability._fields),
}
"""What tables of a progress hold where they are not empty."""
_KINDS: Final = get_type_hints(Progress)

_MAX_DEPTH: Final = 32


def arrays_of(frame: Frame, nutrients: Iterable[str]) -> Arrays:
    """Return a frame as arrays, always in the same order."""
    names = sorted(nutrients)
    if sorted(frame.concentrations) != names:
        raise ValueError(
            f"frame has concentrations of {sorted(frame.concentrations)}, the scene has {names}"
        )
    for name, values in frame.concentrations.items():
        if len(values) != len(frame.cells):
            raise ValueError(f"{len(values)} values of {name} for {len(frame.cells)} cells")
    noted = {} if frame.progress is None else asdict(frame.progress)
    noted = {name: x for name, x in noted.items() if x or name not in _OF_PARTS}
    text = json.dumps(noted).encode() if noted else b""
    arrays = {"time": np.array(frame.time, "<f8"), "step": np.array(frame.step, "<i8")}
    arrays |= without_zeros({f"cells/{name}": a for name, a in frame.cells.columns()})
    for name in names:
        arrays[f"cells/concentration_{name}"] = np.asarray(frame.concentrations[name], "<f8")
    for name in names:
        field = frame.fields.get(name)
        if field is not None and np.size(field.values):
            arrays |= {f"fields/{name}/{key}": a for key, a in _of_field(field).items()}
    arrays["contacts/pair"] = np.asarray(frame.contacts, "<i8").reshape(-1, 2)
    arrays["progress/text"] = np.frombuffer(text, "|u1")
    return arrays


def without_zeros(arrays: Arrays) -> Arrays:
    """Return arrays without the sparse ones that are all zero."""
    return {path: a for path, a in arrays.items() if path not in SPARSE or a.any()}


def _of_field(field: Field) -> Arrays:
    if field.unit != UNIT:
        raise ValueError(f"field {field.name} is in {field.unit!r}, must be in {UNIT}")
    stored = {**vars(field), "radial": field.kind == "radial"}
    arrays = {name: np.asarray(stored[name], entry.dtype) for name, entry in FIELD.items()}
    return {"values": np.asarray(field.values, "<f8"), **arrays}


def frame_of(arrays: Mapping[str, NDArray[Any]], nutrients: Iterable[str]) -> Frame:
    """Return the frame that arrays describe; raises OutputError if they do not describe one."""
    names = sorted(nutrients)
    columns = [name for name in Cells.schema() if f"cells/{name}" not in SPARSE - arrays.keys()]
    try:
        there = [name for name in names if f"fields/{name}/values" in arrays]
        found = {name: _field_of(name, arrays) for name in there}
        frame = Frame(
            time=float(arrays["time"]),
            step=int(arrays["step"]),
            cells=Cells(**{name: arrays[f"cells/{name}"] for name in columns}),
            concentrations={name: arrays[f"cells/concentration_{name}"] for name in names},
            fields=found,
            contacts=arrays["contacts/pair"].reshape(-1, 2),
            progress=progress_of(arrays["progress/text"].tobytes(), names),
        )
    except KeyError as error:
        raise OutputError(f"it has no {error.args[0]}") from None
    except (ValueError, TypeError) as error:
        raise OutputError(str(error)) from None
    _check(frame)
    return frame


def _field_of(name: str, arrays: Mapping[str, NDArray[Any]]) -> Field:
    origin, spacing, height, radial, values = (
        arrays[f"fields/{name}/{key}"] for key in (*FIELD, "values")
    )
    kind = "radial" if radial else "box"
    return Field(name, UNIT, origin, float(spacing), values, kind, float(height))


def _check(frame: Frame) -> None:
    cells = frame.cells
    if not np.isfinite(frame.time) or frame.step < 0:
        raise OutputError(f"its time is {frame.time:g} s, its step {frame.step}")
    ranges = {"state": max(State), "phase": max(Phase), "kind": np.iinfo(np.int16).max,
              "doomed": np.iinfo(np.int8).max, "damage": np.finfo(float).max}  # fmt: skip
    for name, most in ranges.items():
        values = getattr(cells, name)
        if len(values) and not (values.min() >= 0 and values.max() <= most):
            raise OutputError(f"cells.{name} holds values out of range")
    if len(np.unique(cells.id)) != len(cells):
        raise OutputError("cells.id holds an identity twice")
    for name, values in frame.concentrations.items():
        if values.shape != (len(cells),):
            raise OutputError(f"it has {len(values)} concentrations of {name}")


def resume_obstacle(frame: Frame) -> str:
    """Return why a run cannot be resumed from a frame, or an empty text."""
    cells = frame.cells
    for name in ("position", "radius", "young", "poisson"):
        if not np.isfinite(getattr(cells, name)).all():
            return f"cells.{name} holds values that are no numbers"
    if not (cells.radius > 0.0).all():
        return "cells.radius holds values that are not above 0"
    missing = sorted(set(frame.concentrations) - set(frame.fields))
    return f"it has no field of {missing[0]}" if missing else ""


def progress_of(text: bytes, nutrients: Iterable[str]) -> Progress | None:
    """Return what a run needs to be resumed, or None if nothing was noted."""
    if not text:
        return None
    entries = parse_table(text)
    expected = {spec.name for spec in fields(Progress)}
    if not expected - set(_OF_PARTS) <= set(entries) <= expected:
        raise OutputError(f"its progress has other entries: {sorted(set(entries) ^ expected)}")
    known = set(nutrients)
    for name, value in entries.items():
        fits = _fits(value, _KINDS[name])
        if name in ("ledger", "rates", "grids"):
            fits = fits and set(value) <= known
        if not fits or (value and name in _KEYS and set(value) != _KEYS[name]):
            raise OutputError(f"its progress has no usable {name}")
    return Progress(**entries)


def _fits(value: Any, kind: Any) -> bool:
    """Return whether a value out of JSON is of the type that :class:`Progress` states."""
    inner = get_args(kind)
    match get_origin(kind) or kind:
        case builtins.int:
            return type(value) is int and 0 <= value < 1 << 63
        case builtins.float:
            return type(value) is float or (type(value) is int and abs(value) < 1 << 63)
        case builtins.list:
            return isinstance(value, list) and all(_fits(x, inner[0]) for x in value)
        case abc.Mapping:
            return isinstance(value, dict) and all(_fits(x, inner[1]) for x in value.values())
    return any(value is None if one is NoneType else _fits(value, one) for one in inner)


def parse_table(text: bytes | str) -> dict[str, Any]:
    """Return a JSON table."""
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        reason = "it is nested too deeply" if isinstance(error, RecursionError) else str(error)
        raise OutputError(f"it is not JSON as multicell writes it: {reason}") from None
    if not isinstance(value, dict):
        raise OutputError("it does not hold a table")
    level: list[Any] = [value]
    for _ in range(_MAX_DEPTH):
        below = [x for v in level for x in (v.values() if isinstance(v, dict) else v)]
        if any(type(x) is int and abs(x) >= 1 << 64 for x in below):
            raise OutputError("it holds a number that no run can have written")
        level = [x for x in below if isinstance(x, dict | list)]
        if not level:
            return value
    raise OutputError("it is nested too deeply")


def log_arrays(lineage: Lineage | None, begin: Mapping[str, int]) -> Arrays:
    """Return the rows of a lineage's logs from some on, as arrays."""
    logs = Lineage() if lineage is None else lineage
    return {
        f"{log}/{name}": column
        for log in COLUMNS
        for name, column in logs.rows(log, begin[log] if lineage is not None else 0).items()
    }


def lineage_of(arrays: Mapping[str, NDArray[Any]]) -> Lineage:
    """Return the lineage whose logs are these arrays."""
    logs = {
        log: {name: arrays[f"{log}/{name}"] for name in columns} for log, columns in COLUMNS.items()
    }
    ids = logs["births"]["id"]
    if len(np.unique(ids)) != len(ids):
        raise OutputError("the lineage has a cell that was born twice")
    for log in ("deaths", "ends"):
        if not np.isin(logs[log]["id"], ids).all():
            raise OutputError(f"the lineage's {log} name cells that were never born")
    cause = logs["ends"]["cause"]
    if not np.isin(cause, [-2, *map(int, State)]).all():
        raise OutputError("the lineage has an end of unknown cause")
    return Lineage.of(logs)
