"""The result of a comparison: a table of points, and what can be asked of it."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np
from numpy.typing import NDArray

from multicell.comparison.conditioning import Conditioning
from multicell.comparison.files import DONE, FAILED, Row, to_csv, write
from multicell.comparison.norms import NORMS, WORST_CELL
from multicell.results.folder import to_json
from multicell.scene.scene import Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure


FILES: Final = (
    "workprecision.csv",
    "workprecision.json",
    "conditioning.csv",
    "workprecision.png",
    "worst-cell.png",
    "norms.png",
    "report.html",
)
"""What a comparison writes into its folder; of a whole run there is no ``conditioning.csv``."""


@final
@dataclass(frozen=True, eq=False)
class WorkPrecision:
    """What each method reached, and at what cost.

    Attributes
    ----------
    scene : Scene
    table : list of dict
        One row for each method and setting, from coarse to fine: ``method``, ``control``
        (``"tolerance"`` in mean radii, or ``"step"`` in s), ``setting``, ``status`` (``"done"``,
        ``"failed"``, or ``"skipped"`` where it would have taken too long), ``words`` (of a
        failure), ``wall`` and ``cpu`` (s on the wall and of the processors, the minimum of several
        solves; ``wall_median``, ``wall_longest`` and the same of ``cpu`` tell how they spread),
        ``spent`` (s, the one solve that the errors are of, also of a failure),
        ``error_...`` in every norm of :data:`multicell.comparison.norms.NORMS`, dimensionless,
        ``worst_cell_um`` and ``worst_cell_median_um`` (the worst cell's error in µm),
        ``worst_cell_over_shift`` (its median over the steps, over that after a shift of all
        positions), ``cost``
        (evaluations, with linearisations and Jacobian products by their weights), the counts of
        :class:`multicell.mechanics.motion.Work`, and ``mode`` (``"whole run"``, or how many of the
        coupling steps were compared one by one). What a failed or skipped solve lacks is NaN.
    uncertainty : norm -> float
        Of the reference: an error is known no better than this.
    facts : dict
        About the problem and the reference.
    clock : "wall" or "cpu"
        The time that judges.
    conditioning : Conditioning or None
        Of single coupling steps: the floor below which a difference of trajectories tells nothing
        of a method (:mod:`multicell.comparison.conditioning`).
    """

    scene: Scene
    table: list[Row]
    uncertainty: dict[str, float]
    facts: dict[str, Any]
    clock: str = "wall"
    conditioning: Conditioning | None = None

    @classmethod
    def from_json(cls, text: str) -> WorkPrecision:
        """Return what :meth:`to_json` has written.

        Raises
        ------
        KeyError, ValueError
            If the text is something else.
        """
        held = json.loads(text)
        # a file of an earlier version lacks norms that came later
        late = (*(f"error_{norm}" for norm in NORMS), *WORST_CELL.values(), "worst_cell_over_shift")
        unknown = dict.fromkeys(late)
        table = [
            {name: math.nan if v is None else v for name, v in (row | unknown | row).items()}
            for row in held["table"]
        ]
        scene = Scene.from_dict(held["scene"])
        known = {n: math.nan if v is None else v for n, v in held["uncertainty"].items()}
        uncertainty = dict.fromkeys(NORMS, math.nan) | known
        conditioning = Conditioning.from_dict(held.get("conditioning"))
        return cls(scene, table, uncertainty, held["facts"], held["clock"], conditioning)

    @property
    def stepwise(self) -> bool:
        """Whether single coupling steps were compared, each from a recorded state."""
        return bool(self.facts.get("stepwise"))

    @property
    def norms(self) -> dict[str, str]:
        """Name of each norm -> what it measures here."""
        return {name: norm.words(self.stepwise) for name, norm in NORMS.items()}

    @property
    def methods(self) -> list[str]:
        """Names of the methods in the order of the table."""
        return list(dict.fromkeys(row["method"] for row in self.table))

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return the table as one array for each column."""
        return {name: np.array([row[name] for row in self.table]) for name in self.table[0]}

    def rows(self, method: str, status: str = DONE) -> list[Row]:
        """Return the rows of a method that have a status."""
        return [r for r in self.table if r["method"] == method and r["status"] == status]

    def failures(self) -> list[Row]:
        """Return the rows of all solves that failed."""
        return [row for row in self.table if row["status"] == FAILED]

    def within(self, error: float, norm: str = "position") -> dict[str, Row]:
        """Return for each method that reaches an error its cheapest row that does.

        Parameters
        ----------
        error
            Largest error; the uncertainty of the reference is added to what was measured.
        norm
            One of :data:`multicell.comparison.norms.NORMS`.

        Returns
        -------
        dict
            Method -> row, the fastest first. Only measured points count: nothing is interpolated.
        """
        self._check(norm)
        reached: dict[str, Row] = {}
        open_error = self.uncertainty[norm]
        for row in self.table:
            if row["status"] == DONE and row[f"error_{norm}"] + open_error <= error:
                best = reached.get(row["method"])
                if best is None or row[self.clock] < best[self.clock]:
                    reached[row["method"]] = row
        return dict(sorted(reached.items(), key=lambda item: item[1][self.clock]))

    def below_floor(self, norm: str = "worst_cell_median") -> list[Row]:
        """Return the rows whose error is not above what a shift of all positions does.

        Of these the difference of trajectories says nothing: the step changes a shift of that
        size by more. Without conditioning there are none.
        """
        self._check(norm)
        if self.conditioning is None:
            return []
        floor = self.conditioning.floor[norm]
        return [r for r in self.table if r["status"] == DONE and r[f"error_{norm}"] <= floor]

    def fastest(self, error: float = 0.01, norm: str = "position") -> Row | None:
        """Return the row of least time that reaches an error, or None (:meth:`within`)."""
        return next(iter(self.within(error, norm).values()), None)

    def order(self, method: str, norm: str = "position_final", finest: int | None = None) -> float:
        """Return the slope of log error over log setting: the order, if the setting is a step.

        Parameters
        ----------
        method
            Name of the method.
        norm
            One of :data:`multicell.comparison.norms.NORMS`.
        finest
            Number of finest settings to take, by default all. Points closer to the reference
            than ten times its uncertainty are left out.

        Returns
        -------
        float
            NaN if fewer than three points are left.
        """
        self._check(norm)
        floor = 10.0 * self.uncertainty[norm]
        points = [(r["setting"], r[f"error_{norm}"]) for r in self.rows(method)]
        points = [(s, e) for s, e in points if e > floor][-(finest or len(points) or 1) :]
        if len(points) < 3:
            return math.nan
        s, e = np.log(np.array(points)).T
        return float(np.polyfit(s, e, 1)[0])

    def figure(self, norm: str = "position") -> Figure:
        """Draw error over time and over evaluations; failures as crosses on top."""
        from multicell.comparison.charts import workprecision

        self._check(norm)
        return workprecision(self, norm)

    def norms_figure(self) -> Figure:
        """Draw error over time in every norm."""
        from multicell.comparison.charts import norms

        return norms(self)

    def to_csv(self) -> str:
        """Return the table as CSV; NaN is written as ``nan``."""
        return to_csv(self.table)

    def to_json(self) -> str:
        """Return table, uncertainty, facts and scene as JSON; NaN becomes null."""
        return to_json(
            {
                "scene": self.scene.to_dict(),
                "uncertainty": self.uncertainty,
                "norms": self.norms,
                "clock": self.clock,
                "conditioning": None if self.conditioning is None else self.conditioning.to_dict(),
                "facts": self.facts,
                "table": self.table,
            }
        )

    def save(self, folder: str | Path) -> Path:
        """Write CSV, JSON, pictures and ``report.html`` (:data:`FILES`) and return the page.

        Raises
        ------
        OutputError
            If the folder cannot be written to.
        """
        from multicell.comparison.page import CAPTIONS, context

        csv, document, steps, chart, worst, norms, _ = FILES
        texts = {csv: self.to_csv(), document: self.to_json() + "\n"}
        if self.conditioning is not None:
            texts[steps] = to_csv(self.conditioning.rows())
        drawings = {
            chart: (self.figure, CAPTIONS[chart]),
            worst: (lambda: self.figure("worst_cell"), CAPTIONS[worst]),
            norms: (self.norms_figure, CAPTIONS[norms]),
        }
        return write(folder, self.scene, texts, drawings, "compare.html", **context(self))

    def _check(self, norm: str) -> None:
        if norm not in NORMS:
            raise ValueError(f"there is no norm {norm!r}: choose from {', '.join(NORMS)}")
