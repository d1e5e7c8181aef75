"""A comparison with its charts and its page, of whatever is solved."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

from multicell.comparison.base import Pictures
from multicell.comparison.numbers import SolveTable

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Precision(SolveTable):
    """Error and cost of each method, with charts and page; abstract."""

    template: ClassVar[str] = "compare.html"

    def figure(self, norm: str | None = None) -> Figure:
        """Draw error over time and over evaluations; failures as crosses on top."""
        from multicell.comparison.charts import workprecision

        return workprecision(self, self.check_norm(norm))

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
