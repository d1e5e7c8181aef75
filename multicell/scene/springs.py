"""Springs between given pairs of cells: the keys of a table, and the pairs of the start.

Pairs are listed by identity, read from a table in a file, or found among the cells of the start.
"""

from __future__ import annotations

import csv
import io
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np
from numpy.typing import NDArray

from multicell.errors import SceneError
from multicell.files import read_regular
from multicell.schema import flag, id_pairs, parameters, quantity, specs, text

if TYPE_CHECKING:
    from multicell.cells import Cells
    from multicell.scene.scene import Scene

_COLUMNS: Final = ("first_id", "second_id")
_MAX_BYTES: Final = 10_000_000
"""Bytes of a file of pairs."""


@final
@parameters
class Springs:
    """Springs between pairs of cells at any distance, besides the law of contacts.

    The tension is ``stiffness`` x (distance of the centres - ``rest``). A spring goes with the
    death of one of its cells. Where one of them divides, the daughter takes it over that is nearer
    to the other end; daughters are joined only with ``sisters``. The pairs of a ``file`` become a
    part of the scene.
    """

    stiffness: float = quantity("nN/um", above=0, doc="of each spring")
    rest: float | None = quantity(
        "um", default=None, at_least=0, doc="length at rest; absent: that at the start"
    )
    pairs: tuple[tuple[int, int], ...] | None = id_pairs(
        doc="identities of the cells of each spring"
    )
    file: str | None = text(
        default=None,
        doc="CSV table with the columns first_id and second_id, in place of pairs; relative paths "
        "count from the folder of the scene",
    )
    within: float | None = quantity(
        "um", default=None, above=0, doc="joins all cells of the start whose centres are so near"
    )
    sisters: bool = flag(
        default=False, doc="whether the daughters of a cell that has such springs are joined"
    )
    breaking_length: float | None = quantity(
        "um", default=None, above=0, doc="beyond which a spring breaks; absent: never"
    )
    breaking_force: float | None = quantity(
        "nN", default=None, above=0, doc="tension beyond which a spring breaks; absent: never"
    )

    def check(self) -> None:
        """Take the pairs of a file; raise ``SceneError`` unless it is said once who is joined."""
        if self.file is not None:
            if self.pairs is not None:
                raise SceneError("pairs", "is given, and a file of pairs too")
            found = specs(Springs)["pairs"].convert(read_pairs(Path(self.file), "file"), "file")
            object.__setattr__(self, "pairs", found)
            object.__setattr__(self, "file", None)
        if (self.pairs is None) == (self.within is None):
            problem = "must be given, or within in its place; not both"
            raise SceneError("pairs", problem, "For example pairs = [[0, 1], [1, 2]].")
        longest, rest = self.breaking_length, self.rest
        if longest is not None and rest is not None and longest <= rest:
            problem = f"is {longest:g} um, must be above the length at rest, {rest:g} um"
            raise SceneError("breaking_length", problem)


def place_pairs(entries: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return the entries of a scene file with names of files that count from its folder."""
    tables = entries.get("springs")
    if not isinstance(tables, dict):
        return entries
    placed = {
        name: {**table, "file": str(folder / os.path.expanduser(table["file"]))}
        if isinstance(table, dict) and isinstance(table.get("file"), str)
        else table
        for name, table in tables.items()
    }
    return {**entries, "springs": placed}


def read_pairs(file: Path, path: str) -> list[list[int]]:
    """Return the pairs of a CSV table; columns beside first_id and second_id are passed over.

    Raises
    ------
    SceneError
        With the line, for a file that cannot be read or is no such table.
    """
    try:
        text = read_regular(file, _MAX_BYTES).decode("utf-8-sig")
        return _rows(csv.DictReader(io.StringIO(text, newline="")), str(file), path)
    except (OSError, ValueError, csv.Error) as error:  # text that is not UTF-8, names with \0
        reason = getattr(error, "strerror", None) or error
        raise SceneError(path, f"{str(file)!r} cannot be read: {reason}") from None


def _rows(table: csv.DictReader[str], file: str, path: str) -> list[list[int]]:
    missing = [name for name in _COLUMNS if name not in (table.fieldnames or ())]
    if missing:
        hint = f"It has {', '.join(table.fieldnames or ()) or 'nothing'}."
        raise SceneError(path, f"{file!r} has no column {missing[0]}", hint)
    pairs = []
    for row in table:
        try:
            pairs.append([int(row[name]) for name in _COLUMNS])
        except (TypeError, ValueError):
            problem = f"{file!r} has no two whole numbers in line {table.line_num}"
            raise SceneError(path, problem) from None
    return pairs


def check_springs(scene: Scene) -> None:
    """Raise ``SceneError`` for springs in a scene whose equations cannot hold them."""
    for name, law in scene.springs.items():
        if law.sisters and scene.growth is None:
            raise SceneError(f"springs.{name}.sisters", "has no effect: no cell divides")


def pairs_at_start(scene: Scene, name: str, cells: Cells) -> NDArray[np.int64]:
    """Return the identities of the pairs of a table, (m, 2), smaller first, in their order.

    Raises
    ------
    SceneError
        For a cell that is not there, cells that coincide, or no pair at all.
    """
    law = scene.springs[name]
    if law.pairs is not None:
        pairs = np.array(sorted(law.pairs), dtype=np.int64)
        missing = np.setdiff1d(pairs, cells.id)
        if len(missing):
            problem = f"joins the cell {int(missing[0])}, which is not there at the start"
            raise SceneError(f"springs.{name}.pairs", problem)
        return pairs
    from multicell.mechanics.neighbours import TooManyPairsError, neighbour_pairs

    assert law.within is not None
    try:
        near = neighbour_pairs(cells.position, law.within)
    except TooManyPairsError as error:
        raise SceneError(f"springs.{name}.within", f"joins too many cells ({error})") from error
    if not len(near):
        raise SceneError(f"springs.{name}.within", "is too short: it joins no cells")
    found = np.sort(cells.id[near], axis=1)
    return found[np.lexsort((found[:, 1], found[:, 0]))]
