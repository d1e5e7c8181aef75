"""The result of a study of stability: its trials and limits, with the map and the page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Final, final

from multicell.comparison.base import Comparison, Pictures, Row
from multicell.comparison.stability_limits.trial import STABLE, TRIAL_ENDS
from multicell.report.wording import clock

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STABILITY_FILES: Final = (
    "stability.csv",
    "limits.csv",
    "moments.csv",
    "stability.png",
    "report.html",
)
"""What a study of stability writes into its folder; only of networks there is ``moments.csv``."""

_CAPTION: Final = (
    "Outcome at each step or tolerance. Each dot is one trial; a bar is the limit in theory."
)


@final
@dataclass(frozen=True)
class StabilityWords:
    """Words of a map of stability.

    - ``ends``: kind of end of a trial -> its meaning
    - ``tolerance``: what a tolerance is; ``subtitle``, ``note``: of the page
    """

    ends: Mapping[str, str]
    tolerance: str
    subtitle: str
    note: str


OF_CELLS: Final = StabilityWords(
    ends=TRIAL_ENDS,
    tolerance="tolerance / mean radius",
    subtitle="The cells settle, are pushed a little along their stiffest mode, and must come to "
    "rest again.",
    note="Of a method under error control the loosest tolerance in mean radii is given, and its "
    "mean step there over Euler's limit.",
)
"""Words of the map of methods for positions."""


@final
@dataclass(frozen=True, eq=False)
class StabilityMap(Comparison):
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

    words: StabilityWords = OF_CELLS

    @property
    def kinds(self) -> list[str]:
        """The kinds that were seen, in the order of :data:`TRIAL_ENDS`."""
        return [kind for kind in TRIAL_ENDS if kind in self.column("kind")]

    def rows(self, method: str) -> list[Row]:
        """Return the trials of a method, from small to large settings."""
        return self.with_values(method=method)

    def limits(self) -> list[Row]:
        """Return the limit of each method.

        Returns
        -------
        list of dict
            ``rate``, ``method``, ``control``, ``limit`` (largest setting that is stable
            with all smaller ones that were tried; NaN if none is), ``beyond`` (smallest that is
            not; infinite if all are stable), ``theory``, ``of_theory``, ``of_euler`` (mean step at
            the limit over 2/λ_max), ``kind`` (of the failure at ``beyond``, or ``"stable"``),
            ``kinds`` (of all failures, from small to large settings).
        """
        return [self.limit(method) for method in self.methods]

    def limit(self, method: str) -> Row:
        """Return the limit of one method."""
        rows = self.rows(method)
        first = next((k for k, row in enumerate(rows) if row["kind"] != STABLE), len(rows))
        failed = first < len(rows)
        last = rows[first - 1] if first else None
        return {
            **{name: rows[0][name] for name in ("rate", "method", "control")},
            "limit": last["setting"] if last else math.nan,
            "beyond": rows[first]["setting"] if failed else math.inf,
            "theory": rows[0]["theory"],
            "of_theory": last["of_theory"] if last else math.nan,
            "of_euler": last["of_euler"] if last else math.nan,
            "kind": rows[first]["kind"] if failed else STABLE,
            "kinds": "; ".join(dict.fromkeys(r["kind"] for r in rows if r["kind"] != STABLE)),
        }

    def tables(self) -> Mapping[str, Sequence[Row]]:
        """Return all trials, and the limits."""
        found = {"stability.csv": self.table, "limits.csv": self.limits()}
        if "moments" in self.facts:
            found["moments.csv"] = self.facts["moments"]
        return found

    def figure(self) -> Figure:
        """Draw how each method goes over its step or tolerance."""
        from multicell.comparison.stability_limits.charts import stability_map

        return stability_map(self, self.words.tolerance)

    def pictures(self) -> Pictures:
        """Return the map."""
        return {"stability.png": (self.figure, _CAPTION)}

    def page(self) -> dict[str, Any]:
        """Return the fields of the page's template."""
        from multicell.comparison.stability_limits.charts import TRIAL_COLOURS

        first = self.table[0]
        failures = sum(row["kind"] != STABLE for row in self.table)
        return {
            "title": f"{self.title}: stability",
            "subtitle": self.words.subtitle,
            "tiles": {
                "cells": f"{first['cells']:,}",
                "largest decay rate λmax": f"{first['rate']:.3g}/s",
                "Euler's limit 2/λmax": f"{2.0 / first['rate']:.3g} s",
                "methods": f"{len(self.methods)}",
                "trials that failed": f"{failures} of {len(self.table):,}",
                "wall time": clock(self.facts["wall"]),
            },
            "colours": TRIAL_COLOURS,
            "kinds": self.words.ends,
            "moments": self.facts.get("moments", []),
            "failed": [row for row in self.table if row["kind"] != STABLE],
        }
