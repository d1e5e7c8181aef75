"""The base of all results: a table of solves, facts, pictures, and the folder that holds them."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from multicell.comparison.files import Row, to_csv
from multicell.errors import OutputError
from multicell.results.documents import read_table, write_table
from multicell.results.folder import file_errors, to_json, write_text
from multicell.results.records import parse_table
from multicell.scene.scene import Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Pictures = dict[str, tuple[Callable[[], "Figure"], str]]
"""Name of a file -> the function that draws it, and its caption."""


class Comparison(ABC):
    """What a comparison found: one row for each solve, and facts about the problem."""

    scene: Scene
    table: list[Row]
    facts: dict[str, Any]
    template: ClassVar[str]

    @property
    def title(self) -> str:
        """The title of the scene."""
        return self.scene.title or "Untitled scene"

    @abstractmethod
    def tables(self) -> Mapping[str, Sequence[Row]]:
        """Return the tables to write: name of a CSV file -> rows."""

    @abstractmethod
    def pictures(self) -> Pictures:
        """Return the pictures to write."""

    @abstractmethod
    def page(self) -> dict[str, Any]:
        """Return what the template of the page asks for."""

    def column(self, name: str) -> list[Any]:
        """Return the different entries of a column, in the order of the table."""
        return list(dict.fromkeys(row[name] for row in self.table))

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return the table as one array for each column."""
        return {name: np.array([row[name] for row in self.table]) for name in self.table[0]}

    def with_values(self, **values: Any) -> list[Row]:
        """Return the rows of the table whose columns have these values."""
        return [row for row in self.table if all(row[key] == x for key, x in values.items())]

    def to_csv(self) -> str:
        """Return the table as CSV; NaN is written as ``nan``."""
        return to_csv(self.table)

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
            write_text(folder / name, to_csv(rows))
        return write_page(
            folder / "report.html", self.template, scene=self.scene, result=self,
            pictures=self.pictures(), **self.page(),
        )  # fmt: skip


class StoredComparison(Comparison):
    """A comparison that is also written as JSON, and can be read again."""

    document: ClassVar[str]
    """Name of the file."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Return the result as numbers, text, lists and tables."""

    @classmethod
    @abstractmethod
    def from_dict(cls, table: Mapping[str, Any]) -> Self:
        """Return what :meth:`to_dict` has described, in this or an earlier version.

        Raises KeyError, ValueError if the table describes something else.
        """

    def to_json(self) -> str:
        """Return the result as JSON; NaN becomes null."""
        return to_json(self.to_dict())

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Return what :meth:`to_json` has written, in this or an earlier version.

        Raises OutputError if the text is no JSON table; KeyError, ValueError if the table describes
        something else.
        """
        return cls.from_dict(parse_table(text))

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Return the result in a JSON file of :meth:`save`, checked by the checksum in it.

        Raises OutputError if the file is not there or is not what was written. Files of earlier
        versions have no checksum: :meth:`from_json` reads their text; KeyError, ValueError if it
        describes something else.
        """
        table = read_table(Path(path))
        if table is None:
            raise OutputError(f"'{path}' is not there")
        return cls.from_dict(table)

    def save(self, folder: str | Path) -> Path:
        """Write tables, pictures, the JSON file and ``report.html`` and return the page.

        Raises OutputError if the folder cannot be written to.
        """
        page = super().save(folder)
        write_table(Path(folder) / self.document, self.to_dict())
        return page


def rows_from(table: Sequence[Row]) -> list[Row]:
    """Return the rows of a table in JSON, in which NaN was written as null."""
    return [{key: math.nan if x is None else x for key, x in row.items()} for row in table]
