"""A table of sensitivity indices, as numbers and files."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from multicell.errors import OutputError
from multicell.results.folder import file_errors, package_version, to_json, versions, write_text
from multicell.results.quantities import known_unit
from multicell.tables.text import table_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from multicell.scene.scene import Scene
    from multicell.studies.axes import Range

Row = dict[str, Any]  # one row of a table: column -> value


def index_rows(
    observable: str, ranges: Sequence[Range], columns: Mapping[str, Sequence[Any]]
) -> list[Row]:
    """Return a row for each parameter, with its entries of the columns, (parameters,) each."""
    return [
        {
            "observable": observable,
            "unit": known_unit(observable),
            "parameter": free.name,
            "key": free.key,
            "low": free.low,
            "high": free.high,
            "parameter_unit": free.unit,
            **{name: entries[k] for name, entries in columns.items()},
        }
        for k, free in enumerate(ranges)
    ]


def failure_notes(failures: Mapping[str, str]) -> list[str]:
    """Return the note on runs that failed, name -> reason; none where there are none."""
    return [
        f"{len(failures)} runs failed, the first one: {reason}"
        for reason in list(failures.values())[:1]
    ]


@dataclass(frozen=True, eq=False)
class IndexTable(ABC):
    """Indices of each observable and parameter, and the sample that they come from.

    - ``leading``: the column that orders the rows of an observable
    - ``further``: points that each place of the sample has beside one for each parameter
    - ``kind``, ``caption``: of the analysis and its pictures, in words; ``template``: of its page
    """

    scene: Scene
    ranges: tuple[Range, ...]
    size: int
    seeds: tuple[int, ...]
    table: list[Row]
    notes: list[str]
    failures: Mapping[str, str]
    folder: Path | None = None

    leading: ClassVar[str]
    further: ClassVar[int]
    kind: ClassVar[str]
    caption: ClassVar[str]
    template: ClassVar[str]

    @abstractmethod
    def plot(self, observable: str | None = None) -> Figure:
        """Draw the indices of an observable (by default the first) with their intervals."""

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
