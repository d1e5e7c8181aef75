"""Numbers of a map of failures: all trials, and the worst of each method."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from multicell.comparison.base import Comparison, Row
from multicell.comparison.stability_limits.failures import POCKET, STEP_ENDS
from multicell.comparison.stability_limits.trial import STABLE
from multicell.scene.scene import Scene

FAILURE_FILES: Final = ("failures.csv", "worst.csv", "failures.png", "report.html")
"""What a map of failures writes into its folder."""


@dataclass(frozen=True, eq=False)
class FailureTable(Comparison):
    """End of each recorded coupling step by each method, without pictures."""

    scene: Scene
    table: list[Row]
    facts: dict[str, Any]

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
