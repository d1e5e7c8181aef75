"""Print tables and words on the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.table import Table


def time_text(seconds: float, digits: int = 3) -> str:
    """Return a time in the unit that suits it."""
    for unit, size in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= size:
            return f"{seconds / size:.{digits}g} {unit}"
    return f"{seconds:.{digits}g} s"


def bare_table(**options: Any) -> Table:
    """Return an empty table without lines."""
    from rich.table import Table

    return Table(box=None, pad_edge=False, header_style="bold", **options)


def plain(text: object) -> Any:
    """Return text in which square brackets are no markup."""
    from rich.text import Text

    return Text(str(text))
