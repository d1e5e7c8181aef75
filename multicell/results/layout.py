"""The data sets of ``frames.h5``: type, shape, unit, and how many rows each has."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final, NamedTuple, final

import numpy as np

from multicell.cells import Cells
from multicell.results.keeping import POOLS
from multicell.results.lineage import COLUMNS
from multicell.results.records import FIELD, UNIT

FORMAT: Final = 4
"""Number of the layout that :mod:`multicell.results.writer` describes."""

_LONG: Final = 8192  # rows in a chunk of what grows with cells and nodes: 64 kB for a number each
_MIDDLE: Final = 4096  # ... of logs and texts
_SHORT: Final = 256  # ... of what has one row for each frame


@final
class Kind(NamedTuple):
    """What a data set holds: one row for each frame, or ``pool`` rows in all.

    The pools ``frames`` and ``ends`` have one row for each frame and one more; any other is the
    path of the data set of offsets whose last entry is its length.
    """

    dtype: Any
    width: int | None
    pool: str
    unit: str = ""
    chunk: int = _SHORT


def layout(nutrients: Iterable[str]) -> dict[str, Kind]:
    """Return all data sets but those of the history, by path."""
    sets = {
        "frames/offset": Kind("<i8", None, "ends"),
        "frames/time": Kind("<f8", None, "frames", "s"),
        "frames/step": Kind("<i8", None, "frames"),
        "frames/digest": Kind("<u4", None, "frames"),
        "contacts/offset": Kind("<i8", None, "ends"),
        "contacts/pair": Kind("<i8", 2, "contacts/offset", chunk=_MIDDLE),
        "progress/offset": Kind("<i8", None, "ends"),
        "progress/text": Kind("|u1", None, "progress/offset", chunk=_MIDDLE),
        **_cells(),
        **_lineage(),
    }
    for name in nutrients:
        sets |= _nutrient(name)
    return sets


def of_rows(dtype: str, unit: str = "") -> Kind:
    """Return what a data set is whose length nothing else tells: the scene, the history."""
    return Kind(dtype, None, "", unit, _MIDDLE)


def _cells() -> dict[str, Kind]:
    """Return the columns of cells: of all frames one after another, and what cells keep."""
    columns = {
        name: Kind(np.dtype(spec["dtype"]).str, spec["width"], "frames/offset", spec["unit"], _LONG)
        for name, spec in Cells.schema().items()
    }
    sets: dict[str, Kind] = {}
    for pool, names in POOLS.items():
        offset = f"kept/{pool}/offset"
        sets[offset] = Kind("<i8", None, "ends")
        sets[f"kept/{pool}/id"] = Kind("<i8", None, offset, chunk=_MIDDLE)
        for name in names:
            kept = columns.pop(name)
            sets[f"kept/{pool}/{name}"] = kept._replace(pool=offset, chunk=_MIDDLE)
    return {f"cells/{name}": kind for name, kind in columns.items()} | sets


def _lineage() -> dict[str, Kind]:
    sets = {}
    for log, columns in COLUMNS.items():
        offset = f"lineage/{log}/offset"
        sets[offset] = Kind("<i8", None, "ends")
        for name, dtype in columns.items():
            unit = "s" if name == "time" else ""
            sets[f"lineage/{log}/{name}"] = Kind(
                np.dtype(dtype).str, None, offset, unit, chunk=_MIDDLE
            )
    return sets


def _nutrient(name: str) -> dict[str, Kind]:
    """Return the data sets of a field, and of what cells find of it that does not follow."""
    group, found = f"fields/{name}", f"concentrations/{name}"
    return {
        f"{group}/offset": Kind("<i8", None, "ends"),
        f"{group}/coded": Kind("<u8", None, f"{group}/offset", chunk=_LONG),
        f"{group}/shape": Kind("<i8", 3, "frames"),
        f"{group}/faces": Kind("<f8", 6, "frames", UNIT),
        **{
            f"{group}/{key}": Kind(entry.dtype, entry.width or None, "frames", entry.unit)
            for key, entry in FIELD.items()
        },
        f"{found}/offset": Kind("<i8", None, "ends"),
        f"{found}/row": Kind("<i8", None, f"{found}/offset", chunk=_MIDDLE),
        f"{found}/value": Kind("<f8", None, f"{found}/offset", UNIT, _MIDDLE),
    }
