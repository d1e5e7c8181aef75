"""The map of methods, recorded states and tolerances: errors over conditioning, and failures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Final, final

from multicell.comparison.base import Comparison, Pictures, Row
from multicell.comparison.stability_limits.failures import MAX_RATIO, POCKET, STEP_ENDS
from multicell.comparison.stability_limits.trial import STABLE
from multicell.report.wording import clock

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FAILURE_FILES: Final = ("failures.csv", "worst.csv", "failures.png", "report.html")
"""What a map of failures writes into its folder."""
_CAPTION: Final = (
    "Error of the worst cell over the effect of shifts of the start on it, for each method "
    f"(lines), state (columns) and setting (from fine to coarse); above {MAX_RATIO:g} an end is "
    "wrong, and a letter names its kind."
)


@final
class FailureMap(Comparison):
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

    @property
    def states(self) -> list[str]:
        """Names of the states in the order of the table."""
        return self.column("state")

    @property
    def kinds(self) -> list[str]:
        """The kinds of ends that were seen, in the order of :data:`STEP_ENDS`."""
        return [kind for kind in STEP_ENDS if kind in self.column("kind")]

    def failures(self) -> list[Row]:
        """Return the trials that ended wrong, without those that no method can end right."""
        return [row for row in self.table if row["kind"] not in (STABLE, POCKET)]

    def worst(self) -> list[Row]:
        """Return for each method and setting the state that it ends worst.

        Returns
        -------
        list of dict
            ``method``, ``control``, ``setting`` (of fixed steps only the method), ``states``,
            ``wrong`` (number of states that end wrong), ``state``, ``ratio``, ``error_um`` and
            ``kind`` of the one with the largest ratio.
        """
        groups: dict[tuple[str, float], list[Row]] = {}
        for row in self.table:
            setting = row["setting"] if row["control"] == "tolerance" else math.inf
            groups.setdefault((row["method"], setting), []).append(row)
        rows = []
        for (method, setting), group in groups.items():
            most = max(group, key=lambda row: -1.0 if math.isnan(r := row["ratio"]) else r)
            wrong = {row["state"] for row in group if row["kind"] not in (STABLE, POCKET)}
            rows.append(
                {
                    "method": method,
                    "control": most["control"],
                    "setting": most["setting"] if math.isinf(setting) else setting,
                    "states": len({row["state"] for row in group}),
                    "wrong": len(wrong),
                    **{name: most[name] for name in ("state", "ratio", "error_um", "kind")},
                }
            )
        return rows

    def tables(self) -> Mapping[str, Sequence[Row]]:
        """Return all trials, and the worst of each method and setting."""
        return {"failures.csv": self.table, "worst.csv": self.worst()}

    def figure(self) -> Figure:
        """Draw the error over conditioning of each method, state and setting."""
        from multicell.comparison.stability_limits.failure_charts import failure_figure

        return failure_figure(self)

    def pictures(self) -> Pictures:
        """Return the map."""
        return {"failures.png": (self.figure, _CAPTION)}

    def page(self) -> dict[str, Any]:
        """Return the fields of the page's template."""
        from multicell.comparison.stability_limits.failure_charts import END_LETTERS

        return {
            "title": "How methods end coupling steps of real runs",
            "subtitle": "Each method starts from states that the runs have passed. An end is right "
            f"if the worst cell is off by at most {MAX_RATIO:g} times the effect of shifts of the "
            "start.",
            "tiles": {
                "states": f"{len(self.states)}",
                "methods": f"{len(self.methods)}",
                "trials that ended wrong": f"{len(self.failures())} of {len(self.table):,}",
                "wall time": clock(self.facts["wall"]),
            },
            "kinds": STEP_ENDS,
            "letters": END_LETTERS,
            "worst": self.worst(),
            "failed": [row for row in self.table if row["words"]],
        }
