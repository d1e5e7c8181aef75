"""Frames and logs as named arrays, in which form they are written, checked and read."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any, Final, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import HAZARDS, Cells
from multicell.errors import OutputError
from multicell.host.files import parse_json
from multicell.results.frame import Field, Frame, Progress
from multicell.results.lineage import LINEAGE_COLUMNS, Lineage

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


FIELD_ARRAYS: Final[Mapping[str, FieldArray]] = {
    "origin": FieldArray("<f8", 3, "um", np.nan),
    "spacing": FieldArray("<f8", 0, "um", np.nan),
    "height": FieldArray("<f8", 0, "um", np.nan),
    # 1: shells; else the sum of 2, 4 and 8 for the axes x, y and z along which space repeats
    "radial": FieldArray("|i1", 0, "", 0),
}

INSIDE: Final = "cells/inside"
"""What networks in cells have; as wide as a scene needs, and in all frames of a run or in none."""
SPARSE: Final = frozenset(
    [*(f"cells/{name}" for name in ("doomed", "damage", "lag", *HAZARDS)), INSIDE]
)
"""Arrays that a frame has only where they are not all zero, and a file only if a frame has them."""

_OF_PARTS: Final = (
    "cavity",
    "driven",
    "exposures",
    "first_states",
    "inside",
    "learnt",
    "lengths",
    "replays",
    "stability",
)
"""Entries of a progress that only some runs have."""


def arrays_of(frame: Frame, nutrients: Iterable[str]) -> Arrays:
    """Return a frame as arrays, always in the same order."""
    names = sorted(nutrients)
    noted = {} if frame.progress is None else vars(frame.progress)
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
    return {
        path: a for path, a in arrays.items() if path not in SPARSE or path == INSIDE or a.any()
    }


def _of_field(field: Field) -> Arrays:
    shape = (field.kind == "radial") + sum(2 << k for k in range(3) if field.repeats[k])
    stored = {**vars(field), "radial": shape}
    arrays = {name: np.asarray(stored[name], entry.dtype) for name, entry in FIELD_ARRAYS.items()}
    return {"values": np.asarray(field.values, "<f8"), **arrays}


def frame_of(arrays: Mapping[str, NDArray[Any]], nutrients: Iterable[str]) -> Frame:
    """Return the frame that arrays describe; raises OutputError if they do not describe one."""
    names = sorted(nutrients)
    columns = [name for name in Cells.schema() if f"cells/{name}" not in SPARSE - arrays.keys()]
    try:
        there = [name for name in names if f"fields/{name}/values" in arrays]
        progress = arrays["progress/text"].tobytes()
        known = Progress(**parse_table(progress)) if progress else None
        if known and INSIDE in arrays and arrays[INSIDE].shape[1:] != (len(known.inside),):
            raise ValueError(f"{INSIDE} has other columns than progress.inside names")
        return Frame(
            time=float(arrays["time"]),
            step=int(arrays["step"]),
            cells=Cells(**{name: arrays[f"cells/{name}"] for name in columns}),
            concentrations={name: arrays[f"cells/concentration_{name}"] for name in names},
            fields={name: _field_of(name, arrays) for name in there},
            contacts=arrays["contacts/pair"].reshape(-1, 2),
            progress=known,
        )
    except KeyError as error:
        raise OutputError(f"it has no {error.args[0]}", damaged=True) from None
    except (ValueError, TypeError, AttributeError) as error:
        raise OutputError(str(error), damaged=True) from None


def _field_of(name: str, arrays: Mapping[str, NDArray[Any]]) -> Field:
    origin, spacing, height, radial, values = (
        arrays[f"fields/{name}/{key}"] for key in (*FIELD_ARRAYS, "values")
    )
    kind, shape = "radial" if radial == 1 else "box", int(radial)
    x, y, z = (bool(shape & 2 << k) for k in range(3))
    return Field(name, UNIT, origin, float(spacing), values, kind, float(height), (x, y, z))


def parse_table(text: bytes | str) -> dict[str, Any]:
    """Return a JSON table."""
    try:
        value = parse_json(text)
    except (ValueError, RecursionError) as error:
        problem = f"it is not JSON as multicell writes it: {error}"
        raise OutputError(problem, damaged=True) from None
    if not isinstance(value, dict):
        raise OutputError("it does not hold a table", damaged=True)
    return value


def log_arrays(lineage: Lineage | None, begin: Mapping[str, int]) -> Arrays:
    """Return the rows of a lineage's logs from some on, as arrays."""
    logs = Lineage() if lineage is None else lineage
    return {
        f"{log}/{name}": column
        for log in LINEAGE_COLUMNS
        for name, column in logs.rows(log, begin[log] if lineage is not None else 0).items()
    }
