"""The result of a comparison of methods of integration for positions."""

from __future__ import annotations

from typing import ClassVar, Final, final

from multicell.comparison.norms import NORMS, Norm, described
from multicell.comparison.precision import Precision
from multicell.integrators.base import MethodInfo
from multicell.integrators.registry import find

_NOTE: Final = (
    "Times in s; errors of the positions (root mean square over the cells) and of the worst cell, "
    "each the largest over the times or steps, in mean radii and µm; beside it the median step's "
    "worst cell over that after a shift of all positions; cost in evaluations, where a "
    "linearisation counts 2 and a product J·v 0.65."
)
"""Note of the table of all solves, and its columns: of the result's table -> title, format."""
_COLUMNS: Final = {
    "wall": ("wall", "{:.3g}"),
    "cpu": ("processor", "{:.3g}"),
    "error_position": ("error", "{:.2e}"),
    "error_worst_cell": ("worst cell", "{:.2e}"),
    "worst_cell_um": ("worst cell / µm", "{:.2e}"),
    "worst_cell_over_shift": ("median step / shift", "{:.2g}"),
    "cost": ("cost", "{:,.0f}"),
    "evaluations": ("evaluations", "{:,.0f}"),
    "linearisations": ("linearisations", "{:,.0f}"),
    "jacobian_products": ("J·v", "{:,.0f}"),
    "steps": ("steps", "{:,.0f}"),
}


@final
class WorkPrecision(Precision):
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
    facts : dict
        About the problem and the reference.
    uncertainty : norm -> float
        Of the reference: an error is known no better than this.
    clock : "wall" or "cpu"
        The time that judges.
    conditioning : Conditioning or None
        Of single coupling steps: the floor below which the error of a method is indistinguishable
        from noise (:mod:`multicell.comparison.conditioning`).
    """

    main: ClassVar[str] = "position"
    last: ClassVar[str] = "position_final"

    def measures(self) -> dict[str, Norm]:
        """Return all norms of the table by their names, those of the user's own among them."""
        return NORMS | {name: described(name) for name in self.facts.get("metrics", ())}

    def info(self, method: str) -> MethodInfo | None:
        """Return the properties of a method in the registry."""
        return find(method)

    def shown(self) -> tuple[str, dict[str, tuple[str, str]]]:
        """Return a note and the columns of the page's table of all solves."""
        return _NOTE, _COLUMNS
