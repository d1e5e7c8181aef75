"""A table of sensitivity indices, as numbers and files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from multicell.errors import OutputError
from multicell.results.folder import file_errors, package_version, to_json, versions, write_text
from multicell.tables.text import table_text

if TYPE_CHECKING:
    from multicell.scene.scene import Scene
    from multicell.studies.axes import Range

Row = dict[str, Any]  # one row of a table: column -> value


@dataclass(frozen=True, eq=False)
class IndexTable:
    """Indices of each observable and parameter, and the sample that they come from."""

    scene: Scene
    ranges: tuple[Range, ...]
    size: int
    seeds: tuple[int, ...]
    table: list[Row]
    notes: list[str]
    failures: Mapping[str, str]
    folder: Path | None = None

    leading: ClassVar[str]
    """The column that orders the rows of an observable."""

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain values."""
        return {
            "size": self.size,
            "seeds": self.seeds,
            "free": [asdict(free) for free in self.ranges],
            "table": self.table,
            "notes": self.notes,
            "versions": {**versions(), "SALib": package_version("SALib")},
            "scene": self.scene.to_dict(),
        }

    @property
    def observables(self) -> list[str]:
        """Names of the observables."""
        return list(dict.fromkeys(row["observable"] for row in self.table))

    def ordered(self, observable: str) -> list[Row]:
        """Return the rows of an observable, the largest index first."""
        rows = [row for row in self.table if row["observable"] == observable]
        return sorted(rows, key=lambda row: -np.nan_to_num(row[self.leading]))

    def to_csv(self) -> str:
        """Return the table as CSV."""
        return table_text(self.table)

    def to_json(self) -> str:
        """Return everything as strict JSON; NaN is null."""
        return to_json(self.to_dict()) + "\n"

    def write_tables(self, folder: str | Path | None = None) -> Path:
        """Write ``sensitivity.csv`` and ``sensitivity.json``; return the folder.

        Raises
        ------
        OutputError
            If there is no folder, or it cannot be written to.
        """
        place = self.folder if folder is None else Path(folder)
        if place is None:
            raise OutputError("the analysis has no output folder: say where the report shall go")
        with file_errors("use the output folder", place):
            place.mkdir(parents=True, exist_ok=True)
        write_text(place / "sensitivity.csv", self.to_csv())
        write_text(place / "sensitivity.json", self.to_json())
        return place
