"""Numbers of a dose response: responses, curves with their intervals, combinations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from multicell.calibration.dose_response.curve import DOSES, TOTALS, DoseCurve, Estimate
from multicell.errors import OutputError
from multicell.results.folder import file_errors, to_json, versions, write_text
from multicell.tables.text import csv_text

if TYPE_CHECKING:
    from multicell.scene.scene import Scene

Row = dict[str, Any]
"""One row of a table: column -> value."""


@dataclass(frozen=True, eq=False)
class DoseNumbers:
    """Numbers and tables of a dose response; fields: :class:`multicell.DoseResponse`."""

    title: str
    curves: tuple[DoseCurve, ...]
    response: str
    replicates: int
    table: list[Row]
    combination: list[Row]
    totals: Mapping[str, Estimate]
    notes: list[str]
    scene: Scene | None = None
    folder: Path | None = None

    @property
    def curve(self) -> DoseCurve:
        """The curve of the first drug."""
        return self.curves[0]

    @property
    def ic50(self) -> Estimate:
        """The dose of the first drug at which half of the control is left."""
        return self.curve.ic50

    def to_csv(self) -> str:
        """Return the table as CSV, which :func:`multicell.dose_response` reads as data."""
        names = DOSES[len(self.curves)]
        units = {n: f"{n} / {c.unit}" for n, c in zip(names, self.curves, strict=True) if c.unit}
        rows = ({k: "" if v != v else v for k, v in row.items()}.values() for row in self.table)
        return csv_text((units.get(name, name) for name in self.table[0]), rows)

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain values."""
        return {
            "title": self.title,
            "response": self.response,
            "replicates": self.replicates,
            "curves": [
                {
                    "name": curve.name,
                    "unit": curve.unit,
                    "doses": curve.doses,
                    "viability": curve.viability,
                    "error": curve.error,
                    **{name: asdict(entry) for name, entry in curve.estimates.items()},
                }
                for curve in self.curves
            ],
            "combination": self.combination,
            "totals": {name: asdict(entry) for name, entry in self.totals.items()},
            "table": self.table,
            "notes": self.notes,
            "versions": versions(),
            "scene": None if self.scene is None else self.scene.to_dict(),
        }

    def to_json(self) -> str:
        """Return everything as strict JSON; what is NaN or infinite is null."""
        return to_json(self.to_dict()) + "\n"

    def text(self) -> str:
        """Return the estimates in words."""
        lines = []
        for curve in self.curves:
            unit = f" ({curve.unit})" if curve.unit else ""
            lines.append(f"{self.response} over {curve.name}{unit}, {len(curve.doses) - 1} doses")
            lines += [f"  {name:8} {entry.words}" for name, entry in curve.estimates.items()]
        lines += [f"{TOTALS[name]}: {entry.words}" for name, entry in self.totals.items()]
        return "\n".join([*lines, *(f"Note: {note}" for note in self.notes)])

    def write_tables(self, folder: str | Path | None = None) -> Path:
        """Write ``dose_response.csv`` and ``.json``, and ``combination.csv``; return the folder.

        Raises ``OutputError`` if there is no folder, or it cannot be written to.
        """
        place = self.folder if folder is None else Path(folder)
        if place is None:
            raise OutputError("there is no output folder: say where the report shall go")
        with file_errors("use the output folder", place):
            place.mkdir(parents=True, exist_ok=True)
        write_text(place / "dose_response.csv", self.to_csv())
        write_text(place / "dose_response.json", self.to_json())
        if self.combination:
            rows = (row.values() for row in self.combination)
            write_text(place / "combination.csv", csv_text(self.combination[0], rows))
        return place
