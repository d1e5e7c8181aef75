"""The data sets of ``frames.h5``: type, shape, unit, and how many rows each has."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final, NamedTuple, final

import numpy as np

from multicell.cells import Cells
from multicell.results.lineage import COLUMNS
from multicell.results.records import FIELD, UNIT

FORMAT: Final = 5  # number of the layout that :mod:`multicell.results.writer` describes
_LONG: Final = 8192  # rows in a chunk of what grows with cells and nodes: 64 kB for a number each
_MIDDLE: Final = 4096  # ... of logs and texts
_SHORT: Final = 256  # ... of what has one row for each frame


@final
class Kind(NamedTuple):
    """The kind of a data set: one row for each frame, or ``pool`` rows in all.

    The pools ``frames`` and ``ends`` have one row for each frame and one more; any other is the
    path of the data set of offsets whose last entry is its length.
    """

    dtype: Any
    width: int | None
    pool: str
    unit: str = ""
    chunk: int = _SHORT


def layout(nutrients: Iterable[str]) -> dict[str, Kind]:
    """Return all data sets but those of the history, by path; checksums go by their order."""
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
        sets |= _field(name)
        sets |= _concentration(name)
    return sets


def of_rows(dtype: str, unit: str = "") -> Kind:
    """Return the kind of a data set of its own length: the scene, the history."""
    return Kind(dtype, None, "", unit, _MIDDLE)


def _cells() -> dict[str, Kind]:
    """Return the columns of cells, of all frames one after another."""
    return {
        f"cells/{name}": Kind(
            np.dtype(spec["dtype"]).str, spec["width"], "frames/offset", spec["unit"], _LONG
        )
        for name, spec in Cells.schema().items()
    }


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


def _field(name: str) -> dict[str, Kind]:
    """Return the data sets of a field."""
    group = f"fields/{name}"
    return {
        f"{group}/offset": Kind("<i8", None, "ends"),
        f"{group}/coded": Kind("<u8", None, f"{group}/offset", chunk=_LONG),
        f"{group}/shape": Kind("<i8", 3, "frames"),
        f"{group}/faces": Kind("<f8", 6, "frames", UNIT),
        **{
            f"{group}/{key}": Kind(entry.dtype, entry.width or None, "frames", entry.unit)
            for key, entry in FIELD.items()
        },
    }


def _concentration(name: str) -> dict[str, Kind]:
    """Return the data set of the concentrations at the cells."""
    return {f"cells/concentration_{name}": Kind("<f8", None, "frames/offset", UNIT, _LONG)}
