"""The history of a run: its columns by name, printed as a table of ten lines."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from multicell.results.frame import Named
from multicell.results.quantities import known_unit

_ROWS: Final = 3  # at either end
_WIDTH: Final = 96  # letters of a line


@final
class History(Named[NDArray[np.float64]]):
    """One entry per coupling step: column name -> (m,) float64."""

    def __init__(self, entries: Mapping[str, NDArray[np.float64]]) -> None:
        super().__init__(entries, "column of the history")

    def __reduce__(self) -> tuple[Any, ...]:
        return History, (dict(self),)

    def __repr__(self) -> str:
        """Return the first and the last rows of as many columns as a line holds."""
        names = list(self)
        rows = len(self[names[0]]) if names else 0
        head = f"<history: {rows:,} rows of {len(names)} columns; result.to_pandas() has them all>"
        if not rows:
            return head
        first = list(range(min(_ROWS, rows)))
        places = [*first, *(k for k in range(max(rows - _ROWS, 0), rows) if k not in first)]
        columns: list[list[str]] = []
        for name in names:
            unit = known_unit(name)
            title = f"{name} ({unit})" if unit else name
            column = [title, *(f"{self[name][k]:.6g}" for k in places)]
            width = max(map(len, column))
            if columns and sum(len(c[0]) + 2 for c in columns) + width > _WIDTH:
                break
            columns.append([text.rjust(width) for text in column])
        lines = ["  ".join(cells) for cells in zip(*columns, strict=True)]
        if rows > 2 * _ROWS:
            lines.insert(1 + _ROWS, "…".rjust(len(columns[0][0])))
        more = names[len(columns) :]
        return "\n".join([head, *lines, *([_listed(more)] if more else [])])

    def _repr_html_(self) -> str:
        return f"<pre>{escape(repr(self))}</pre>"


def _listed(names: list[str]) -> str:
    """Return the names of further columns, as many as a line holds."""
    text = f"further columns: {', '.join(names)}"
    return text if len(text) <= _WIDTH else f"{text[: text.rindex(', ', 0, _WIDTH - 2)]}, …"
