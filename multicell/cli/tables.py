"""Print tables and words on the terminal."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.table import Table


def filled_table(columns: Sequence[str], rows: Iterable[Sequence[object]], **options: Any) -> Table:
    """Return a table without lines.

    - ``columns``: their titles; one that ends in ``" >"`` is set to the right
    - ``rows``: of texts, in which square brackets are no markup
    """
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold", **options)
    for title in columns:
        name, right, _ = title.partition(" >")
        table.add_column(name, justify="right" if right else "left")
    for row in rows:
        shown: list[Any] = [text if hasattr(text, "plain") else plain(text) for text in row]
        table.add_row(*shown)
    return table


def key_table(rows: Iterable[tuple[str, object]], *, justify: Any = "left") -> Table:
    """Return a table of names in bold and what belongs to them, without a header."""
    table = filled_table(("", ""), rows, show_header=False)
    table.columns[0].style = "bold"
    table.columns[1].justify = justify
    return table


def plain(text: object) -> Any:
    """Return text in which square brackets are no markup."""
    from rich.text import Text

    return Text(str(text))
