"""Lineage: births, deaths and ends of all cells of a run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import Cells, IntArray, State, rows_before, rows_by_id

LINEAGE_COLUMNS: Final[Mapping[str, Mapping[str, Any]]] = {
    "births": {"id": np.int64, "parent": np.int64, "kind": np.int16, "time": np.float64},
    "deaths": {"id": np.int64, "time": np.float64},
    "ends": {"id": np.int64, "time": np.float64, "cause": np.int8},
}
"""The three logs of a lineage with the columns of each; times in s."""

_ALIVE, _DIVIDED = -1, -2  # causes of an end that are no state


Columns = dict[str, NDArray[Any]]


@final
class _Rows:
    """Rows of a log in arrays with room behind them: lists of numbers take five times as much.

    Lineages that follow from one another share them; each knows how many are its own.
    """

    def __init__(self, columns: Columns, filled: int) -> None:
        self.columns, self.filled = columns, filled

    def extended(self, begin: int, end: int, values: tuple[NDArray[Any] | float, ...]) -> _Rows:
        """Return rows with further ones from ``begin`` to ``end``; what lies before stays."""
        room = len(self.columns["id"])
        rows = self
        if end > room or begin != self.filled:  # others have continued from here already
            rows = self.separate(begin, max(end, 3 * room // 2))
        for column, found in zip(rows.columns.values(), values, strict=True):
            column[begin:end] = found
        rows.filled = end
        return rows

    def separate(self, length: int, room: int) -> _Rows:
        """Return a copy of so many rows, in arrays of another length."""
        columns = {name: np.empty(room, column.dtype) for name, column in self.columns.items()}
        for name, column in columns.items():
            column[:length] = self.columns[name][:length]
        return _Rows(columns, length)


@final
class Lineage:
    """Logs of births, deaths and ends, each in the order in which they happened.

    A lineage does not change: what comes to pass makes the next one.

    A cell's death is the moment at which it turned necrotic, its end the moment from which it is
    not there any more: it divided, or its remains were removed. The columns are those of
    :data:`LINEAGE_COLUMNS`; the cause of an end is the cell's state then, or -2 for a division.
    """

    def __init__(self) -> None:
        self._logs = {
            log: _Rows({name: np.empty(0, dtype) for name, dtype in columns.items()}, 0)
            for log, columns in LINEAGE_COLUMNS.items()
        }
        self._lengths = dict.fromkeys(LINEAGE_COLUMNS, 0)

    @property
    def logs(self) -> dict[str, Columns]:
        """The logs: name -> column -> array."""
        return {log: self.rows(log, 0) for log in LINEAGE_COLUMNS}

    def born(self, cells: Cells, time: float) -> Lineage:
        """Return the lineage with cells that came to be."""
        return self._with("births", (cells.id, cells.parent, cells.kind, time))

    def died(self, cells: Cells, dead: NDArray[np.bool_], time: float) -> Lineage:
        """Return it with cells that have died by a time in s, each at its own, by identity."""
        rows = np.flatnonzero(dead)
        rows = rows[np.argsort(cells.id[rows])]
        return self._with("deaths", (cells.id[rows], time - cells.age[rows]))

    def events(
        self, before: Cells, after: Cells, time: float, row: IntArray | None = None
    ) -> Lineage:
        """Return it with what changed between two populations: births, divisions and removals.

        - ``row``, (n,): where the cells after or their mothers were before; absent: searched for
        """
        row = rows_before(before, after) if row is None else row
        new, gone = (before.id.take(row) != after.id).nonzero()[0], np.ones(len(before), bool)
        mothers, cause = row[new], before.state.copy()
        gone[row], gone[mothers], cause[mothers] = False, True, _DIVIDED
        born = self._with("births", (after.id[new], after.parent[new], after.kind[new], time))
        return born._with("ends", (before.id[gone], time, cause[gone]))

    def retyped(self, ids: IntArray, kinds: NDArray[np.int16]) -> Lineage:
        """Return it with another type of cells of which births have been noted."""
        if not len(ids):
            return self
        length = self._lengths["births"]
        births = self._logs["births"].separate(length, length)
        births.columns["kind"][rows_by_id(births.columns["id"], ids)] = kinds
        return self._grown("births", births, length)

    def counts(self) -> dict[str, int]:
        """Return the length of each log."""
        return dict(self._lengths)

    def rows(self, log: str, begin: int) -> Columns:
        """Return the rows of a log from ``begin`` on, by column."""
        end = self._lengths[log]
        columns = self._logs[log].columns
        return {name: column[begin:end].copy() for name, column in columns.items()}

    @classmethod
    def of(cls, arrays: Mapping[str, NDArray[Any]]) -> Lineage:
        """Return the lineage of arrays, log/column -> rows.

        Raises ValueError if they can be none.
        """
        lineage = cls()
        for log, columns in LINEAGE_COLUMNS.items():
            lineage = lineage._with(log, tuple(arrays[f"{log}/{name}"] for name in columns))
        ids, mothers = arrays["births/id"], arrays["births/parent"]
        if ((mothers < -1) | (mothers >= ids)).any():
            raise ValueError("a mother is no older cell")
        for log in ("deaths", "ends"):
            if not np.isin(arrays[f"{log}/id"], ids).all():
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

    def _with(self, log: str, values: tuple[NDArray[Any] | float, ...]) -> Lineage:
        """Return it with further rows of a log; the first column has one entry for each."""
        begin = self._lengths[log]
        end = begin + np.size(values[0])
        if end == begin:
            return self
        return self._grown(log, self._logs[log].extended(begin, end, values), end)

    def _grown(self, log: str, rows: _Rows, length: int) -> Lineage:
        after = object.__new__(Lineage)
        after._logs = {**self._logs, log: rows}
        after._lengths = {**self._lengths, log: length}
        return after
