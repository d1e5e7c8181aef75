"""The base of all results: a table of solves, facts, pictures, and the folder that holds them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final

from multicell.host.extras import needs
from multicell.results.folder import file_errors, write_text
from multicell.scene.scene import Scene
from multicell.tables.text import table_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

Row = dict[str, Any]  # one row of a table: column -> value

SOLVED: str = "done"  # how a solve went
FAILED, SKIPPED = "failed", "skipped"

CLOCKS: Final = {"wall": "wall time", "cpu": "CPU time"}
"""Column of the table that may judge -> what it is."""

Pictures = dict[str, tuple[Callable[[], "Figure"], str]]
"""Name of a file -> the function that draws it, and its caption."""


@dataclass(frozen=True, eq=False)
class Comparison(ABC):
    """Results of a comparison: one row for each solve, and facts about the problem."""

    scene: Scene
    table: list[Row]
    facts: dict[str, Any]

    template: ClassVar[str]

    @property
    def title(self) -> str:
        """The title of the scene."""
        return self.scene.title or "Untitled scene"

    @property
    def methods(self) -> list[str]:
        """Names of the methods in the order of the table."""
        return self.column("method")

    @abstractmethod
    def tables(self) -> Mapping[str, Sequence[Row]]:
        """Return the tables to write: name of a CSV file -> rows."""

    @abstractmethod
    def pictures(self) -> Pictures:
        """Return the pictures to write."""

    @abstractmethod
    def page(self) -> dict[str, Any]:
        """Return the fields of the page's template."""

    def column(self, name: str) -> list[Any]:
        """Return the different entries of a column, in the order of the table."""
        return list(dict.fromkeys(row[name] for row in self.table))

    def with_values(self, **values: Any) -> list[Row]:
        """Return the rows of the table whose columns have these values."""
        return [row for row in self.table if all(row[key] == x for key, x in values.items())]

    def to_pandas(self) -> DataFrame:
        """Return the table; its ``attrs`` are the facts about the problem.

        Raises
        ------
        MissingPackage
            If pandas is not installed.
        """
        needs("pandas")
        from pandas import DataFrame

        table = DataFrame(self.table)
        table.attrs = dict(self.facts)
        return table

    def to_csv(self) -> str:
        """Return the table as CSV; NaN is written as ``nan``."""
        return table_text(self.table)

    def save(self, folder: str | Path) -> Path:
        """Write tables, pictures and ``report.html`` and return the page.

        Raises
        ------
        OutputError
            If the folder cannot be written to.
        """
        from multicell.report.html import write_page

        folder = Path(folder)
        with file_errors("use the output folder", folder):
            folder.mkdir(parents=True, exist_ok=True)
        for name, rows in self.tables().items():
            write_text(folder / name, table_text(rows))
        return write_page(
            folder / "report.html",
            self.template,
            scene=self.scene,
            result=self,
            pictures=self.pictures(),
            **self.page(),
        )
