"""Columns of cells that most cells keep from frame to frame: written for those that change.

Modulus, cycle time, mother and type of a cell are what they were at its birth, its age what it was
then plus the time since. So a file keeps of such a column an entry (identity, value) where a cell
is new or its value is not the one expected from its last entry, and no more. What is expected is
compared bit by bit: what comes back is what was written, whatever a law or a user has done to it.

Columns that change together share the list of identities, a *pool*. Entries stand frame by frame,
those of a frame in the order of the identities.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import FloatArray, IntArray

POOLS: Final[Mapping[str, tuple[str, ...]]] = {
    "birth": ("parent", "kind", "young", "poisson", "cycle_time"),
    "age": ("age",),
    "phase": ("progress", "phase_length"),
    "surface": ("receptor", "ligand"),
}
"""Columns of each pool."""

CLOCKS: Final = ("age",)
"""Columns that advance with time."""

KEPT: Final = tuple(column for columns in POOLS.values() for column in columns)

Columns = dict[str, NDArray[Any]]


def differ(one: NDArray[Any], other: NDArray[Any]) -> NDArray[np.bool_]:
    """Return where two arrays of the same type have other bits."""
    kind = f"u{one.dtype.itemsize}"
    return np.asarray(one.view(kind) != other.view(kind))


@final
class Keeper:
    """Finds the entries of frames that are given one after another."""

    def __init__(self) -> None:
        self._ids: IntArray = np.empty(0, np.int64)
        self._last: dict[str, tuple[Columns, FloatArray]] = {}

    def entries(self, time: float, ids: IntArray, columns: Mapping[str, NDArray[Any]]) -> Columns:
        """Return the entries of a frame: ``pool/id`` and ``pool/column``.

        Parameters
        ----------
        time : s
        ids : (n,)
        columns : name -> (n,)
            All of :data:`KEPT`.
        """
        order = np.argsort(ids, kind="stable")
        ids = ids[order]
        place = np.searchsorted(self._ids, ids)
        there = place < len(self._ids)
        place = np.where(there, place, 0)
        if len(self._ids):
            there &= self._ids[place] == ids
        found: Columns = {}
        for pool, names in POOLS.items():
            now = {name: columns[name][order] for name in names}
            new, since = ~there, np.full(len(ids), time)
            if there.any():
                last, noted = self._last[pool]
                for name in names:
                    new |= differ(_expected(name, last[name][place], noted[place], time), now[name])
                now_last = {n: np.where(new, now[n], last[n][place]) for n in names}
                since = np.where(new, time, noted[place])
            else:
                now_last = now
            self._last[pool] = now_last, since
            found[f"{pool}/id"] = ids[new]
            found |= {f"{pool}/{name}": now[name][new] for name in names}
        self._ids = ids
        return found


@final
class Pool:
    """The entries of one pool of a file, in the order in which a cell's are found at once.

    Parameters
    ----------
    ids : (m,) int64
        Of all entries.
    ends : (k + 1,) int64
        Frame j owns the entries ends[j] ... ends[j + 1] - 1.
    times : (k,), s
        Of the frames.
    columns : name -> (m,)
    """

    def __init__(self, ids: IntArray, ends: IntArray, times: FloatArray, columns: Columns) -> None:
        self._order = np.argsort(ids, kind="stable")
        self._ids = ids[self._order]
        self._ends, self._times, self._columns = ends, times, columns

    def at(self, place: int, ids: IntArray) -> Columns:
        """Return the columns of a frame for the cells ``ids``, (n,) each.

        Raises
        ------
        ValueError
            If a cell has no entry up to that frame.
        """
        row = self._rows(int(self._ends[place + 1]), ids)
        frame = np.searchsorted(self._ends, row, side="right") - 1
        time = float(self._times[place])
        return {
            name: _expected(name, column[row], self._times[frame], time)
            for name, column in self._columns.items()
        }

    def _rows(self, end: int, ids: IntArray) -> IntArray:
        """Return the last entry before the entry ``end`` of each cell, (n,)."""
        early = self._order < end
        order, known = self._order[early], self._ids[early]
        last = np.searchsorted(known, ids, side="right") - 1
        if len(ids) and (not len(known) or (last < 0).any() or (known[last] != ids).any()):
            raise ValueError("a cell has no entry of what it keeps")
        return np.asarray(order[last])


def _expected(name: str, value: NDArray[Any], noted: FloatArray, time: float) -> NDArray[Any]:
    """Return what a column is to be at a time, from its last entries."""
    return np.asarray(value + (time - noted)) if name in CLOCKS else value
