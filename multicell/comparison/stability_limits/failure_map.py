"""The map of methods, recorded states and tolerances: errors over conditioning, and failures."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Final, final

from multicell.comparison.base import Pictures
from multicell.comparison.stability_limits.failure_table import FailureTable
from multicell.comparison.stability_limits.failures import MAX_RATIO

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FAILURE_CAPTION: Final = (
    "Error of the worst cell over the effect of shifts of the start on it, for each method "
    f"(lines), state (columns) and setting (from fine to coarse); above {MAX_RATIO:g} an end is "
    "wrong, and a letter names its kind."
)


@final
class FailureMap(FailureTable):
    """Ends of recorded coupling steps by each method.

    Attributes
    ----------
    scene : Scene
        Of the first state.
    table : list of dict
        One row for each trial: ``state``, ``cells``, ``method``, ``control``, ``setting``
        (tolerance in µm or step in s), ``error_um`` (of the worst cell), ``shift_um``,
        ``conditioning_um`` (the most that twelve shifts of the start by that much do), ``ratio`` of
        the error to it, ``null_ratio`` (of the better one of two methods without mechanics),
        ``kind`` (a key of :data:`multicell.comparison.stability_limits.failures.STEP_ENDS`),
        ``words``, ``steps``, ``effort`` (evaluations), ``wall`` (s).
    facts : dict
        ``wall`` (s) and ``versions``.
    """

    template: ClassVar[str] = "failures.html"

    def figure(self) -> Figure:
        """Draw the error over conditioning of each method, state and setting."""
        from multicell.comparison.stability_limits.failure_charts import failure_figure

        return failure_figure(self)

    def pictures(self) -> Pictures:
        """Return the map."""
        return {"failures.png": (self.figure, FAILURE_CAPTION)}

    def page(self) -> dict[str, Any]:
        """Return the fields of the page's template."""
        from multicell.comparison.stability_limits.failure_charts import failure_context

        return failure_context(self)
