"""The result of a study of stability: its table, with the map and the page."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, final

from multicell.comparison.base import Pictures
from multicell.comparison.stability_limits.numbers import TrialTable

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@final
class StabilityMap(TrialTable):
    """Outcome of each method at each setting that was tried.

    Attributes
    ----------
    scene : Scene
    table : list of dict
        One row for each trial: ``cells``, ``rate`` (λ_max, 1/s), ``method``, ``control``
        (``"tolerance"`` in mean radii or ``"step"`` in s), ``setting``, ``theory`` (largest stable
        step, s; infinite for implicit methods, NaN where there is none), ``of_theory``,
        ``of_euler`` (mean step over 2/λ_max),
        ``kind`` (a key of :data:`multicell.comparison.stability_limits.trial.TRIAL_ENDS`),
        ``words`` (what was seen), ``steps``, ``wall`` (s).
    facts : dict
        ``precision`` of the bisection, ``wall`` (s), ``versions``; of a network also ``moments``:
        for each coupling step that is tried the largest rate and how long fixed steps may be.
    words : StabilityWords
    """

    template: ClassVar[str] = "stability.html"

    def figure(self) -> Figure:
        """Draw how each method goes over its step or tolerance."""
        from multicell.comparison.stability_limits.charts import stability_map

        return stability_map(self)

    def pictures(self) -> Pictures:
        """Return the map."""
        from multicell.comparison.stability_limits.charts import CAPTION

        return {"stability.png": (self.figure, CAPTION)}

    def page(self) -> dict[str, Any]:
        """Return the fields of the page's template."""
        from multicell.comparison.stability_limits.charts import stability_context

        return stability_context(self)
