"""Lineage: births, deaths and ends of all cells of a run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import Cells, IntArray, State, rows_by_id

LINEAGE_COLUMNS: Final[Mapping[str, Mapping[str, Any]]] = {
    "births": {"id": np.int64, "parent": np.int64, "kind": np.int16, "time": np.float64},
    "deaths": {"id": np.int64, "time": np.float64},
    "ends": {"id": np.int64, "time": np.float64, "cause": np.int8},
}
"""The three logs of a lineage with the columns of each; times in s."""

_ALIVE, _DIVIDED = -1, -2  # causes of an end that are no state


Columns = dict[str, NDArray[Any]]


@final
class Lineage:
    """Logs of births, deaths and ends, each in the order in which they happened.

    A cell's death is the moment at which it turned necrotic, its end the moment from which it is
    not there any more: it divided, or its remains were removed. The columns are those of
    :data:`LINEAGE_COLUMNS`; the cause of an end is the cell's state then, or -2 for a division.
    """

    def __init__(self) -> None:
        # arrays with room behind what counts: lists of numbers take five times as much
        self._logs: dict[str, Columns] = {
            log: {name: np.empty(0, dtype) for name, dtype in columns.items()}
            for log, columns in LINEAGE_COLUMNS.items()
        }
        self._lengths = dict.fromkeys(LINEAGE_COLUMNS, 0)

    @property
    def logs(self) -> dict[str, Columns]:
        """The logs: name -> column -> array."""
        return {log: self.rows(log, 0) for log in LINEAGE_COLUMNS}

    def born(self, cells: Cells, time: float) -> None:
        """Note cells that came to be."""
        self._note("births", (cells.id, cells.parent, cells.kind, time))

    def died(self, cells: Cells, dead: NDArray[np.bool_], time: float) -> None:
        """Note which cells have died by a time in s, each at its own, by identity."""
        rows = np.flatnonzero(dead)
        rows = rows[np.argsort(cells.id[rows])]
        self._note("deaths", (cells.id[rows], time - cells.age[rows]))

    def events(self, before: Cells, after: Cells, time: float) -> None:
        """Note what changed between two populations: births, divisions and removals."""
        new = np.flatnonzero(before.rows_of(after.id) < 0)
        gone = np.flatnonzero(after.rows_of(before.id) < 0)
        parent, ids = after.parent[new], before.id[gone]
        self._note("births", (after.id[new], parent, after.kind[new], time))
        cause = np.where(rows_by_id(np.unique(parent), ids) < 0, before.state[gone], _DIVIDED)
        self._note("ends", (ids, time, cause))

    def retype(self, ids: IntArray, kinds: NDArray[np.int16]) -> None:
        """Note another type of cells of which births have been noted."""
        if len(ids):
            births, length = self._logs["births"], self._lengths["births"]
            births["kind"][rows_by_id(births["id"][:length], ids)] = kinds

    def counts(self) -> dict[str, int]:
        """Return the length of each log."""
        return dict(self._lengths)

    def cut(self, counts: Mapping[str, int]) -> None:
        """Forget what came after the logs had these lengths."""
        self._lengths |= counts

    def rows(self, log: str, begin: int) -> Columns:
        """Return the rows of a log from ``begin`` on, by column."""
        end = self._lengths[log]
        return {name: column[begin:end].copy() for name, column in self._logs[log].items()}

    @classmethod
    def of(cls, arrays: Mapping[str, NDArray[Any]]) -> Lineage:
        """Return the lineage of arrays, log/column -> rows.

        Raises ValueError if they can be none.
        """
        lineage = cls()
        for log, columns in LINEAGE_COLUMNS.items():
            lineage._note(log, tuple(arrays[f"{log}/{name}"] for name in columns))
        for log in ("deaths", "ends"):
            if not np.isin(arrays[f"{log}/id"], arrays["births/id"]).all():
                raise ValueError(f"{log} are of cells that were not born")
        if not np.isin(arrays["ends/cause"], [_DIVIDED, *State]).all():
            raise ValueError("an end has no known cause")
        return lineage

    @staticmethod
    def check(arrays: Mapping[str, NDArray[Any]]) -> None:
        """Refuse arrays, log/column -> rows, that have not the columns of the logs: ValueError."""
        for log, columns in LINEAGE_COLUMNS.items():
            shape = arrays[f"{log}/id"].shape if f"{log}/id" in arrays else ()
            for path, dtype in ((f"{log}/{name}", dtype) for name, dtype in columns.items()):
                rows = arrays.get(path)
                if rows is None or rows.dtype != dtype or rows.ndim != 1 or rows.shape != shape:
                    raise ValueError(f"it has no {path} as it should be")

    def table(self) -> dict[str, NDArray[Any]]:
        """Return one row for every cell that ever was, in the order of the identities.

        Returns dict: ``id``, ``parent`` (-1: there at the start), ``kind``, ``birth_time``,
        ``death_time`` and ``end_time`` in s (NaN where it has not come), ``end``: ``"division"``,
        the name of the state in which the cell was removed, or ``""``.
        """
        births = self.rows("births", 0)
        order = np.argsort(births["id"])
        ids = births["id"][order]
        n = len(ids)
        death, end = np.full(n, np.nan), np.full(n, np.nan)
        cause = np.full(n, _ALIVE)
        deaths, ends = self.rows("deaths", 0), self.rows("ends", 0)
        death[np.searchsorted(ids, deaths["id"])] = deaths["time"]
        place = np.searchsorted(ids, ends["id"])
        end[place], cause[place] = ends["time"], ends["cause"]
        names = {_ALIVE: "", _DIVIDED: "division", **{int(s): s.name.lower() for s in State}}
        return {
            "id": ids,
            "parent": births["parent"][order],
            "kind": births["kind"][order],
            "birth_time": births["time"][order],
            "death_time": death,
            "end_time": end,
            "end": np.array([names[int(c)] for c in cause], dtype=object),
        }

    def _note(self, log: str, columns: tuple[NDArray[Any] | float, ...]) -> None:
        """Add rows to a log; the first column has one entry for each."""
        begin = self._lengths[log]
        end = begin + len(np.atleast_1d(columns[0]))
        for (name, held), values in zip(self._logs[log].items(), columns, strict=True):
            if end > len(held):
                room = np.empty(max(end, 3 * len(held) // 2), held.dtype)
                room[:begin] = held[:begin]
                self._logs[log][name] = held = room
            held[begin:end] = values
        self._lengths[log] = end
