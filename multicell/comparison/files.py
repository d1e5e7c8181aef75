"""Rows of tables, how a solve ends, and the folder that a comparison is written to."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

from multicell.results.folder import make_folder, remove

Row = dict[str, Any]  # one row of a table: column -> value

DONE: str = "done"  # how a solve went
FAILED, SKIPPED = "failed", "skipped"

CLOCKS: Final = {"wall": "wall time", "cpu": "processor time"}
"""Column of the table that may judge -> what it is."""


def prepare(output: str | Path | None, names: Iterable[str], overwrite: bool) -> None:
    """Make sure that results can be written, before they are computed; without output do nothing.

    - ``names``: files of an earlier comparison, which are removed if ``overwrite``; nothing else is
    - ``overwrite``: whether the folder may hold something

    Raises OutputError if the folder cannot be used.
    """
    if output is not None:
        remove(make_folder(output, overwrite=overwrite), names)
