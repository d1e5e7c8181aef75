"""Who descends from whom: births, deaths and ends of all cells that ever were."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import Cells, IntArray, State

DIVISION: Final = "division"

COLUMNS: Final[Mapping[str, Mapping[str, Any]]] = {
    "births": {"id": np.int64, "parent": np.int64, "kind": np.int16, "time": np.float64},
    "deaths": {"id": np.int64, "time": np.float64},
    "ends": {"id": np.int64, "time": np.float64, "cause": np.int8},
}
"""The three logs of a lineage with the columns of each; times in s."""

_ALIVE, _DIVIDED = -1, -2  # causes of an end that are no state


@final
@dataclass
class Lineage:
    """Logs of births, deaths and ends, each in the order in which they happened.

    A cell's death is the moment at which it turned necrotic, its end the moment from which it is
    not there any more: it divided, or its remains were removed.

    Attributes
    ----------
    logs : name -> column -> list
        The columns are those of :data:`COLUMNS`; the cause of an end is the cell's state then,
        or -2 for a division.
    """

    logs: dict[str, dict[str, list[float]]] = field(
        default_factory=lambda: {
            log: {name: [] for name in columns} for log, columns in COLUMNS.items()
        }
    )

    def born(self, cells: Cells, time: float) -> None:
        """Note cells that came to be."""
        columns = (cells.id, cells.parent, cells.kind, np.full(len(cells), time))
        self._note("births", columns)

    def died(self, ids: IntArray, time: float) -> None:
        """Note cells that died."""
        self._note("deaths", (ids, np.full(len(ids), time)))

    def events(self, before: Cells, after: Cells, time: float) -> None:
        """Note what changed between two populations: births, divisions and removals."""
        new = after.take(_absent(after.id, before.id))
        gone = before.take(_absent(before.id, after.id))
        self.born(new, time)
        cause = np.where(_absent(gone.id, new.parent), gone.state, _DIVIDED)
        self._note("ends", (gone.id, np.full(len(gone), time), cause))

    def counts(self) -> dict[str, int]:
        """Return the length of each log."""
        return {log: len(columns["id"]) for log, columns in self.logs.items()}

    def cut(self, counts: Mapping[str, int]) -> None:
        """Forget what came after the logs had these lengths."""
        for log, length in counts.items():
            for column in self.logs[log].values():
                del column[length:]

    def rows(self, log: str, begin: int) -> dict[str, NDArray[Any]]:
        """Return the rows of a log from ``begin`` on, by column."""
        return {
            name: np.array(self.logs[log][name][begin:], dtype=dtype)
            for name, dtype in COLUMNS[log].items()
        }

    @classmethod
    def of(cls, logs: Mapping[str, Mapping[str, NDArray[Any]]]) -> Lineage:
        """Return the lineage with these logs."""
        return cls({log: {n: list(v.tolist()) for n, v in c.items()} for log, c in logs.items()})

    def table(self) -> dict[str, NDArray[Any]]:
        """Return one row for every cell that ever was, in the order of the identities.

        Returns
        -------
        dict
            ``id``, ``parent`` (-1: there at the start), ``kind``, ``birth_time``, ``death_time``
            and ``end_time`` in s (NaN where it has not come), ``end``: ``"division"``, the name
            of the state in which the cell was removed, or ``""``.
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
        names = {_ALIVE: "", _DIVIDED: DIVISION, **{int(s): s.name.lower() for s in State}}
        return {
            "id": ids,
            "parent": births["parent"][order],
            "kind": births["kind"][order],
            "birth_time": births["time"][order],
            "death_time": death,
            "end_time": end,
            "end": np.array([names[int(c)] for c in cause], dtype=object),
        }

    def _note(self, log: str, columns: tuple[NDArray[Any], ...]) -> None:
        for name, values in zip(COLUMNS[log], columns, strict=True):
            self.logs[log][name].extend(np.asarray(values).tolist())


def _absent(ids: IntArray, among: IntArray) -> NDArray[np.bool_]:
    """Return which identities are not among others (parents of the first cells are -1), (n,)."""
    present = np.zeros(max(int(ids.max(initial=0)), int(among.max(initial=0))) + 1, dtype=bool)
    present[among[among >= 0]] = True
    return ~present[ids]
