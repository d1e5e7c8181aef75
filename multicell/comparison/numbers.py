"""Numbers of a comparison: a table of solves with errors and costs, of cells or of networks."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final, Self

import numpy as np

from multicell.comparison.base import FAILED, SOLVED, Comparison, Row
from multicell.comparison.conditioning import Conditioning
from multicell.comparison.norms import Norm
from multicell.errors import OutputError
from multicell.host.extras import needs
from multicell.integrators.base import MethodInfo
from multicell.results.documents import read_document, write_table
from multicell.results.folder import file_errors
from multicell.scene.scene import Scene

if TYPE_CHECKING:
    from xarray import Dataset


NUMBERS_FILE: Final = "workprecision.json"
"""All that was measured; it is written before anything is made of it."""
_CHEAPER: Final = 1.05  # ratio of costs below which a method is no cheaper in words

COMPARISON_FILES: Final = (
    "workprecision.csv",
    NUMBERS_FILE,
    "conditioning.csv",
    "workprecision.png",
    "worst-cell.png",
    "report.html",
)
"""What a comparison writes into its folder; of a whole run there is no ``conditioning.csv``."""


@dataclass(frozen=True, eq=False)
class SolveTable(Comparison):
    """Error and cost of each method as numbers, without pictures; abstract.

    Besides scene, table and facts of all comparisons:

    - ``uncertainty``, norm -> float: of the reference: an error is known no better than this
    - ``clock``, "wall" or "cpu": the time that judges
    - ``conditioning``: of single coupling steps, where it is known
    - ``main``, ``last``: names of the norm of charts and verdicts, and of that of orders
    - ``counts``: columns of work that charts draw errors over, besides time
    """

    uncertainty: dict[str, float]
    clock: str = "wall"
    conditioning: Conditioning | None = None

    main: ClassVar[str]
    last: ClassVar[str]
    counts: ClassVar[tuple[str, ...]] = ("cost",)

    @abstractmethod
    def measures(self) -> Mapping[str, Norm]:
        """Return all norms of the table by their names, those of the user's own among them."""

    @abstractmethod
    def info(self, method: str) -> MethodInfo | None:
        """Return the properties of a method, None where nothing is known."""

    @abstractmethod
    def shown(self) -> tuple[str, dict[str, tuple[str, str]]]:
        """Return a note and the columns of the page's table of all solves.

        Column of the table -> its title and format.
        """

    @classmethod
    def from_dict(cls, table: Mapping[str, Any]) -> Self:
        """Read the output of :meth:`to_dict`, with NaN where JSON has null.

        Raises
        ------
        KeyError, ValueError
            If the table describes something else.
        """
        rows = [table["uncertainty"], *table["table"]]
        uncertainty, *solves = (
            {key: math.nan if x is None else x for key, x in row.items()} for row in rows
        )
        return cls(
            Scene.from_dict(table["scene"]),
            solves,
            table["facts"],
            uncertainty,
            table["clock"],
            Conditioning.from_dict(table["conditioning"]),
        )

    def to_dict(self) -> dict[str, Any]:
        """Return table, uncertainty, facts and scene as numbers, text and lists."""
        return {
            "scene": self.scene.to_dict(),
            "uncertainty": self.uncertainty,
            "norms": self.norms,
            "clock": self.clock,
            "conditioning": None if self.conditioning is None else self.conditioning.to_dict(),
            "facts": self.facts,
            "table": self.table,
        }

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Return the result in a JSON file of :meth:`save`, checked by the checksum in it.

        Raises
        ------
        OutputError
            If the file is not there or is not what was written.
        KeyError, ValueError
            If it describes something else.
        """
        table = read_document(Path(path))
        if table is None:
            raise OutputError(f"'{path}' is not there")
        return cls.from_dict(table)

    def save(self, folder: str | Path) -> Path:
        """Write tables, pictures, the JSON file and ``report.html`` and return the page.

        Raises
        ------
        OutputError
            If the folder cannot be written to.
        """
        with file_errors("use the output folder", Path(folder)):
            Path(folder).mkdir(parents=True, exist_ok=True)
        write_table(Path(folder) / NUMBERS_FILE, self.to_dict())
        return super().save(folder)

    @property
    def stepwise(self) -> bool:
        """Whether single coupling steps were compared, each from a recorded state."""
        return bool(self.facts.get("stepwise"))

    @property
    def norms(self) -> dict[str, str]:
        """Name of each norm -> what it measures here."""
        return {name: norm.words(self.stepwise) for name, norm in self.measures().items()}

    def rows(self, method: str, status: str = SOLVED) -> list[Row]:
        """Return the rows of a method that have a status."""
        return self.with_values(method=method, status=status)

    def failures(self) -> list[Row]:
        """Return the rows of all solves that failed."""
        return self.with_values(status=FAILED)

    def within(self, error: float, norm: str | None = None) -> dict[str, Row]:
        """Return for each method that reaches an error its cheapest row that does.

        Parameters
        ----------
        error
            Largest error; the uncertainty of the reference is added to what was measured.
        norm
            One of ``norms``; absent: the first one, of verdicts.

        Returns
        -------
        dict
            Method -> row, the fastest first. Only measured points count: nothing is interpolated.
        """
        norm = self.check_norm(norm)
        reached: dict[str, Row] = {}
        open_error = self.uncertainty[norm]
        for row in self.table:
            if row["status"] == SOLVED and row[f"error_{norm}"] + open_error <= error:
                best = reached.get(row["method"])
                if best is None or row[self.clock] < best[self.clock]:
                    reached[row["method"]] = row
        return dict(sorted(reached.items(), key=lambda item: item[1][self.clock]))

    def fastest(self, error: float = 0.01, norm: str | None = None) -> Row | None:
        """Return the row of least time that reaches an error, or None (:meth:`within`)."""
        return next(iter(self.within(error, norm).values()), None)

    def verdict(self, error: float = 0.01, norm: str | None = None) -> str:
        """Return in a sentence which method reaches an error at the least cost, and by how much.

        It is compared with the cheapest of the other kind, implicit or explicit, or else with the
        next one. Methods of other packages that are drawn as references do not take part.

        Parameters
        ----------
        error, norm
            As for :meth:`within`.
        """
        norm = self.check_norm(norm)
        known = {name: info for name in self.methods if (info := self.info(name)) is not None}
        reached = {
            method: row[self.clock]
            for method, row in self.within(error, norm).items()
            if not (method in known and known[method].outside)
        }
        at, (best, *others) = f"At {100.0 * error:g} %", list(reached) or [""]
        if not best:
            return f"{at}: no method reaches this error."
        kinds = {method: info.implicit for method, info in known.items()}
        other = [m for m in others if best in kinds and kinds.get(m, kinds[best]) != kinds[best]]
        words = f"{at}: {best}"
        for rival in (other or others)[:1]:
            words += f", {_times(reached[rival] / reached[best])} than {rival}"
        if not other and best in kinds and len(set(kinds.values())) > 1:
            words += f"; no {'explicit' if kinds[best] else 'implicit'} method reaches this error"
        if self.conditioning is not None and self.conditioning.floor[norm] > error:
            shift = f"{self.conditioning.shift:g} µm"
            words += f". A shift of all positions by {shift} moves the end further than that"
        return f"{words}."

    def order(self, method: str, norm: str | None = None, finest: int | None = None) -> float:
        """Return the slope of log error over log setting: the order, if the setting is a step.

        Parameters
        ----------
        method
            Name of the method.
        norm
            One of ``norms``; absent: that of the end.
        finest
            Number of finest settings to take, by default all. Points closer to the reference
            than ten times its uncertainty are left out.

        Returns
        -------
        float
            NaN if fewer than three points are left.
        """
        norm = self.check_norm(norm or self.last)
        floor = 10.0 * self.uncertainty[norm]
        points = [(r["setting"], r[f"error_{norm}"]) for r in self.rows(method)]
        points = [(s, e) for s, e in points if e > floor][-(finest or len(points) or 1) :]
        if len(points) < 3:
            return math.nan
        s, e = np.log(np.array(points)).T
        return float(np.polyfit(s, e, 1)[0])

    def to_xarray(self) -> Dataset:
        """Return all numbers of the table along ``integrator`` and ``rung``, from coarse to fine.

        The method is not called so here, since ``sel`` of xarray has an option of that name.

        Raises
        ------
        MissingPackage
            If xarray is not installed.
        """
        needs("xarray")
        table = self.to_pandas().drop(columns=["control", "words", "mode"], errors="ignore")
        table = table.rename(columns={"method": "integrator"})
        table["rung"] = table.groupby("integrator", sort=False).cumcount()
        found: Dataset = table.set_index(["integrator", "rung"]).to_xarray()
        plain = {k: v for k, v in table.attrs.items() if isinstance(v, (int, float, str))}
        return found.assign_attrs(plain)

    def below_floor(self, norm: str = "worst_cell_median") -> list[Row]:
        """Return the rows whose error is not above the effect of a shift of all positions.

        Such errors are indistinguishable from noise. Without conditioning there are none.
        """
        if self.conditioning is None:
            return []
        self.check_norm(norm)
        floor = self.conditioning.floor[norm]
        return [r for r in self.table if r["status"] == SOLVED and r[f"error_{norm}"] <= floor]

    def tables(self) -> Mapping[str, Sequence[Row]]:
        """Return all solves, and the conditioning of single steps."""
        found: dict[str, Sequence[Row]] = {"workprecision.csv": self.table}
        if self.conditioning is not None:
            found["conditioning.csv"] = self.conditioning.rows()
        return found

    def check_norm(self, norm: str | None) -> str:
        """Return the norm that is meant; raise ValueError for one that the table does not have."""
        norm = norm or self.main
        if norm not in self.uncertainty:
            raise ValueError(f"there is no norm {norm!r}: choose from {', '.join(self.norms)}")
        return norm


def _times(ratio: float) -> str:
    """Return how much cheaper something is in words: nothing below a twentieth."""
    return f"{ratio:.2g} times cheaper" if ratio >= _CHEAPER else "no cheaper"
