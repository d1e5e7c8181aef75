"""Read files of format 4, which leave out what follows from other parts of the file.

Of columns that most cells keep from frame to frame a *pool* has an entry (identity, values) only
where a cell is new, or its value is not the one expected from its last entry. A concentration at a
cell is there only where it is not the linear interpolation of the field, in sums, differences,
products, quotients and roots of float64, which IEEE 754 defines to the bit.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import Cells, FloatArray, IntArray
from multicell.results.layout import POOLS
from multicell.results.records import Arrays
from multicell.results.stored import Ends, Source, frame_arrays, read_field, rows_of

_KEPT: Final = [column for columns in POOLS.values() for column in columns]


def read_frame(file: Source, place: int, nutrients: Iterable[str], ends: Ends) -> Arrays:
    """Return the arrays of a frame, in the order in which a journal has them.

    Raises
    ------
    ValueError, IndexError, KeyError
        If the data sets contradict each other.
    """
    names = list(nutrients)
    columns = {
        name: rows_of(file, f"cells/{name}", ends["frames/offset"], place)
        for name in Cells.schema()
        if name not in _KEPT
    }
    for pool in POOLS:
        columns |= _read_pool(file, pool, place, columns["id"], ends)
    cells = {f"cells/{name}": columns[name] for name in Cells.schema()}
    for name in names:
        group = f"concentrations/{name}"
        found = _concentration(name, columns["position"], read_field(file, name, place, ends))
        rows = rows_of(file, f"{group}/row", ends[f"{group}/offset"], place)
        found[rows] = rows_of(file, f"{group}/value", ends[f"{group}/offset"], place)
        cells[f"cells/concentration_{name}"] = found
    return frame_arrays(file, place, names, ends, cells)


def _read_pool(file: Source, pool: str, place: int, ids: IntArray, ends: Ends) -> Arrays:
    """Return the columns of a pool in a frame, from the last entry of each cell up to it."""
    group = f"kept/{pool}"
    offset = ends[f"{group}/offset"]
    end = int(offset[place + 1])
    entry_ids = file[f"{group}/id"][:end]
    order = np.argsort(entry_ids, kind="stable")
    last = np.searchsorted(entry_ids, ids, side="right", sorter=order) - 1
    if len(ids) and (not end or (last < 0).any() or (entry_ids[order[last]] != ids).any()):
        raise ValueError("a cell has no entry of what it keeps")
    rows = order[last]
    columns = {name: file[f"{group}/{name}"][:end][rows] for name in POOLS[pool]}
    if pool == "age":
        times = file["frames/time"][()]
        noted = times[np.searchsorted(offset, rows, side="right") - 1]
        columns["age"] = columns["age"] + (times[place] - noted)
    return columns


def _concentration(name: str, position: FloatArray, field: Arrays) -> FloatArray:
    """Return what cells find of a nutrient by its field; NaN without one and outside of it."""
    group = f"fields/{name}"
    if not field:
        return np.full(len(position), np.nan)
    values, origin = field[f"{group}/values"], field[f"{group}/origin"]
    spacing = float(field[f"{group}/spacing"])
    with np.errstate(all="ignore"):
        if field[f"{group}/radial"]:
            return _on_shells(position, values.reshape(-1), origin, spacing)
        flat = float(field[f"{group}/height"]) > 0.0
        level = position * np.array([1.0, 1.0, 0.0 if flat else 1.0])
        return _in_box(level, values, origin, spacing)


def _on_shells(
    position: FloatArray, values: FloatArray, origin: FloatArray, spacing: float
) -> FloatArray:
    x, y, z = (position - origin).T
    u = np.sqrt(x * x + y * y + z * z) / spacing - 0.5
    inside = u <= len(values) - 0.5
    lower = np.floor(np.where(inside, u, 0.0)).astype(np.int64)
    weight = u - lower
    below = values[np.maximum(lower, 0)]
    above = values[np.minimum(lower + 1, len(values) - 1)]
    return np.where(inside, (1.0 - weight) * below + weight * above, np.nan)


def _in_box(
    position: FloatArray, values: FloatArray, origin: FloatArray, spacing: float
) -> FloatArray:
    inside = np.ones(len(position), dtype=bool)
    nodes: list[tuple[IntArray, IntArray, FloatArray]] = []
    for axis, count in enumerate(values.shape):
        u = (position[:, axis] - origin[axis]) / spacing
        there = (u >= 0.0) & (u <= count)
        u = np.where(there, u, 0.0) - 0.5
        lower = np.floor(u).astype(np.int64)
        nodes.append((np.maximum(lower, 0), np.minimum(lower + 1, count - 1), u - lower))
        inside &= there
    (i0, i1, wx), (j0, j1, wy), (k0, k1, wz) = nodes

    def between(i: NDArray[np.int64]) -> FloatArray:
        near = (1.0 - wz) * values[i, j0, k0] + wz * values[i, j0, k1]
        far = (1.0 - wz) * values[i, j1, k0] + wz * values[i, j1, k1]
        return np.asarray((1.0 - wy) * near + wy * far)

    return np.where(inside, (1.0 - wx) * between(i0) + wx * between(i1), np.nan)
