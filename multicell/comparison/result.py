"""The result of a comparison: its table, with charts and page."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, final

from multicell.comparison.base import Pictures
from multicell.comparison.numbers import SolveTable

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@final
class WorkPrecision(SolveTable):
    """Error and cost of each method.

    Attributes
    ----------
    scene : Scene
    table : list of dict
        One row for each method and setting, from coarse to fine: ``method``, ``control``
        (``"tolerance"`` in mean radii, or ``"step"`` in s), ``setting``, ``status`` (``"done"``,
        ``"failed"``, or ``"skipped"`` where it would have taken too long), ``words`` (of a
        failure), ``wall`` and ``cpu`` (s on the wall and of the processors, the minimum of several
        solves; ``wall_median``, ``wall_longest`` and the same of ``cpu`` show their spread),
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
        Of single coupling steps: the floor below which the error of a method is indistinguishable
        from noise (:mod:`multicell.comparison.conditioning`).
    """

    template: ClassVar[str] = "compare.html"

    def figure(self, norm: str = "position") -> Figure:
        """Draw error over time and over evaluations; failures as crosses on top."""
        from multicell.comparison.charts import workprecision

        self.check_norm(norm)
        return workprecision(self, norm)

    def pictures(self) -> Pictures:
        """Return error over cost, for all cells and for the worst one."""
        from multicell.comparison.page import CAPTIONS

        draw: dict[str, Callable[[], Figure]] = {
            "workprecision.png": self.figure,
            "worst-cell.png": partial(self.figure, "worst_cell"),
        }
        return {name: (drawn, CAPTIONS[name]) for name, drawn in draw.items()}

    def page(self) -> dict[str, Any]:
        """Return the fields of the page's template."""
        from multicell.comparison.page import comparison_context

        return comparison_context(self)
