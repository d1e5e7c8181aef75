"""The result of a comparison of field solvers: tables, and what can be asked of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Final, Self, final

from multicell.comparison.base import Pictures, StoredComparison, rows_from
from multicell.comparison.files import DONE, FAILED, Row
from multicell.scene.scene import Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FILES: Final = (
    "field-solvers.csv",
    "field-grids.csv",
    "field-stability.csv",
    "field-solvers.json",
    "field-solvers.png",
    "field-spacings.png",
    "field-stability.png",
    "report.html",
)
"""What a comparison writes; of several fields each later one has pictures of its own."""

_PICTURES_OF_FIELDS: Final = ("field-solvers.png", "field-spacings.png")
_MAX_FIELDS = 50


def picture_name(name: str, k: int) -> str:
    """Return the name of a picture of the k-th field, from 0 on."""
    return name if k == 0 else name.replace(".png", f"-{k + 1}.png")


def all_files() -> list[str]:
    """Return the names of everything that an earlier comparison may have written."""
    more = [picture_name(name, k) for name in _PICTURES_OF_FIELDS for k in range(1, _MAX_FIELDS)]
    return [*FILES, *more]


@final
@dataclass(frozen=True, eq=False)
class FieldComparison(StoredComparison):
    """What each solver of fields reached, and at what cost.

    Attributes
    ----------
    scene : Scene
    table : list of dict
        One row for each solver and setting on each problem, from coarse to fine: ``field``,
        ``geometry``, ``spacing`` (µm), ``nodes``, ``problem``, ``solver``, ``backend``,
        ``control`` (``"step"`` over explicit Euler's limit, ``"tolerance"`` over the scale,
        ``"time"`` over the slowest time, ``"once"``), ``setting``, ``status`` (``"done"``,
        ``"failed"``, ``"skipped"``), ``kind`` and ``words`` of a failure, ``error`` (largest at
        any node over the scale, against the same equation on the same grid), ``lowest``
        concentration over the scale, ``cpu`` and ``wall`` (s; median, ``_shortest``,
        ``_longest``) with start-up and ``assembly`` of the equation but without compilation,
        ``evaluations``, ``steps``, ``space_error`` of the grid, ``uncertainty`` of the reference,
        ``scale`` (mM), ``slowest_time`` and ``explicit_limit`` (s).
    grids : list of dict
        ``error`` of every grid itself against finer ones, and its ``uncertainty``.
    failures : list of dict
        How each solver ends (``kind``) for each ``setting`` and ``thiele`` modulus; ``limit`` is
        explicit Euler's with that uptake over its limit without.
    facts : dict
    clock : "cpu" or "wall"
        The time that judges.
    """

    scene: Scene
    table: list[Row]
    grids: list[Row]
    failures: list[Row]
    facts: dict[str, Any]
    clock: str = "cpu"

    template: ClassVar[str] = "fields.html"
    document: ClassVar[str] = "field-solvers.json"

    @classmethod
    def from_dict(cls, table: Mapping[str, Any]) -> Self:
        """Return what :meth:`to_dict` has described.

        Raises
        ------
        KeyError, ValueError
            If the table describes something else.
        """
        rows, grids, failures = (rows_from(table[name]) for name in ("table", "grids", "failures"))
        scene = Scene.from_dict(table["scene"])
        return cls(scene, rows, grids, failures, table["facts"], table["clock"])

    def to_dict(self) -> dict[str, Any]:
        """Return tables, facts and scene as numbers, text and lists."""
        return {
            "scene": self.scene.to_dict(), "clock": self.clock, "facts": self.facts,
            "table": self.table, "grids": self.grids, "failures": self.failures,
        }  # fmt: skip

    @property
    def fields(self) -> list[str]:
        """Names of the fields."""
        return self.column("field")

    @property
    def solvers(self) -> list[str]:
        """Names of the solvers in the order of the table."""
        return self.column("solver")

    def geometries(self, field: str) -> list[str]:
        """Return the geometries of the grids of a field."""
        return list(dict.fromkeys(row["geometry"] for row in self.rows(field=field)))

    def rows(self, **where: Any) -> list[Row]:
        """Return the rows of the table whose columns have these values."""
        return self.with_values(**where)

    def own_spacing(self, field: str, geometry: str) -> float:
        """Return the spacing of the ladder that is nearest to the field's own, µm."""
        wanted = self.facts["spacing"][field]
        found = {row["spacing"] for row in self.rows(field=field, geometry=geometry)}
        return float(min(found, key=lambda h: abs(math.log(h / wanted))))

    def cheapest(self, error: float, **where: Any) -> Row | None:
        """Return the row of least time that reaches an error, or None.

        The uncertainty of the reference is added to what was measured. Only measured points
        count.
        """
        reached = [
            row for row in self.rows(**where)
            if row["status"] == DONE and row["error"] + row["uncertainty"] <= error
        ]  # fmt: skip
        return min(reached, key=lambda row: row[self.clock], default=None)

    def text(self) -> str:
        """Return a report for the terminal: the cheapest solver of each problem."""
        from multicell.comparison.field_solvers.page import report

        return report(self)

    def figure(self, field: str | None = None) -> Figure:
        """Draw error over cost at the field's own spacing, one panel for each problem."""
        from multicell.comparison.field_solvers.charts import solvers

        return solvers(self, field or self.fields[0])

    def spacings_figure(self, field: str | None = None) -> Figure:
        """Draw the error of grid and solver together over cost, along the ladder of spacings."""
        from multicell.comparison.field_solvers.charts import spacings

        return spacings(self, field or self.fields[0])

    def stability_figure(self) -> Figure:
        """Draw how each solver ends over steps or tolerances and strength of uptake.

        Raises
        ------
        ValueError
            If that was not looked for.
        """
        from multicell.comparison.field_solvers.charts import stability_map

        if not self.failures:
            raise ValueError("the comparison was made without a stability map")
        return stability_map(self)

    def failed(self) -> list[Row]:
        """Return the rows of the solves that failed."""
        return self.with_values(status=FAILED)

    def tables(self) -> Mapping[str, Sequence[Row]]:
        """Return all solves, the errors of the grids, and how solvers fail."""
        found = {"field-solvers.csv": self.table, "field-grids.csv": self.grids}
        return found | ({"field-stability.csv": self.failures} if self.failures else {})

    def pictures(self) -> Pictures:
        """Return error over cost and over spacings of each field, and the stability map."""
        from multicell.comparison.field_solvers.page import CAPTIONS

        found: Pictures = {}
        draw = (self.figure, self.spacings_figure)
        for k, field in enumerate(self.fields):
            for name, drawn in zip(_PICTURES_OF_FIELDS, draw, strict=True):
                found[picture_name(name, k)] = (partial(drawn, field), CAPTIONS[name])
        if self.failures:
            name = "field-stability.png"
            found[name] = (self.stability_figure, CAPTIONS[name])
        return found

    def page(self) -> dict[str, Any]:
        """Return what the template of the page asks for."""
        from multicell.comparison.field_solvers.page import context

        return context(self)
