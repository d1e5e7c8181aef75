"""Contents of the page of a study of stability."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from multicell.comparison.stability_limits.charts import COLOURS
from multicell.comparison.stability_limits.moving_states import STATES
from multicell.comparison.stability_limits.trial import KINDS, STABLE
from multicell.report.wording import clock

if TYPE_CHECKING:
    from multicell.comparison.files import Row
    from multicell.comparison.stability_limits.result import StabilityMap

CAPTION: Final = (
    "What happens at each step or tolerance. Each dot is one trial; a bar is the limit in theory."
)


def context(result: StabilityMap) -> dict[str, Any]:
    """Return what ``stability.html`` asks for."""
    first = result.table[0]
    failures = sum(row["kind"] != STABLE for row in result.table)
    return {
        "title": f"{result.title}: stability",
        "subtitle": STATES[first["state"]],
        "tiles": {
            "state": first["state"],
            "cells": f"{first['cells']:,}",
            "largest decay rate λmax": f"{first['rate']:.3g}/s",
            "Euler's limit 2/λmax": f"{2.0 / first['rate']:.3g} s",
            **_moving_tiles(first),
            "methods": f"{len(result.methods)}",
            "trials that failed": f"{failures} of {len(result.table):,}",
            "wall time": clock(result.facts["wall"]),
        },
        "colours": COLOURS,
        "kinds": KINDS,
        "failed": [row for row in result.table if row["kind"] != STABLE],
    }


def _moving_tiles(row: Row) -> dict[str, str]:
    """Return the tiles of a moving state."""
    if row["state"] == "settled":
        return {}
    return {
        "2/λmax at the end": f"{2.0 / row['end_rate']:.3g} s" if row["end_rate"] else "no contacts",
        "largest growth rate μ": f"{row['growth_rate']:.3g}/s",
        "length of a trial": f"{row['length']:.4g} s",
    }
