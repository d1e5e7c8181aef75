"""Contents of the page of a comparison."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from multicell.comparison.base import CLOCKS
from multicell.comparison.styles import appearance
from multicell.report.plots.colour_vision import PALE
from multicell.report.wording import time_unit

if TYPE_CHECKING:
    from multicell.comparison.numbers import SolveTable

VERDICT_NORMS: Final = (
    "position",
    "position_median",
    "worst_cell",
    "worst_cell_median",
    "energy",
    "gyration",
    "state",
    "state_median",
    "nodes",
)
"""Norms in which the page gives the time to reach an error."""

TARGETS: Final = (1e-1, 1e-2, 1e-3, 1e-4, 1e-6)
"""Errors for which the page names the fastest setting of each method."""

CAPTIONS: Final = {
    "workprecision.png": "Error over cost; lower and further left is better. Each point is one "
    "tolerance or step, a cross is a solve that failed, placed at the time it had taken. "
    "Time is the median of the repeats, with a thin bar from the shortest to the longest.",
    "worst-cell.png": "The same solves, judged by the one cell that is furthest from its place.",
}


def comparison_context(result: SolveTable) -> dict[str, Any]:
    """Return the fields of ``compare.html``."""
    return {
        "title": f"{result.title}: work and precision",
        "subtitle": _subtitle(result),
        "tiles": _tiles(result),
        "verdict": " ".join(result.verdict(error) for error in (0.01, 0.001)),
        "judge": CLOCKS[result.clock],
        "judged": result.norms[result.main],
        "verdicts": {
            norm: {f"{target:.4g}": result.within(target, norm) for target in TARGETS}
            for norm in VERDICT_NORMS
            if norm in result.uncertainty
        },
        "uncertainty": {
            result.norms[norm]: f"{value:.2e}" for norm, value in result.uncertainty.items()
        },
        "orders": _orders(result),
        "styles": appearance(result),
        "pale": PALE,
        "conditioning": _conditioning(result),
        "note": result.shown()[0],
        "columns": result.shown()[1],
        "below": [(row["method"], row["setting"]) for row in result.below_floor()],
    }


def _conditioning(result: SolveTable) -> dict[str, str]:
    """Return the effect of a shift of all positions on the ends of the steps; none of a run."""
    known = result.conditioning
    if known is None:
        return {}
    worst, rms = known.worst_cell, known.rms
    radius = result.facts["mean_radius"]
    return {
        "shift of each coordinate, root mean square": f"{known.shift:g} µm",
        "end, root mean square over the cells, median step": f"{np.median(rms):.2g} µm",
        "end, worst cell, median step": f"{np.median(worst):.2g} µm",
        "end, worst cell, worst step": f"{worst.max():.2g} µm",
        "worst cell / shift, median step": f"{np.median(known.amplification):.2g}",
        "steps in which a cell ends off by more than 1 % of a radius": (
            f"{int((worst > 0.01 * radius).sum())} of {len(worst)}"
        ),
        **{result.norms[norm]: f"{value:.1e}" for norm, value in known.floor.items()},
    }


def _subtitle(result: SolveTable) -> str:
    facts = result.facts
    if result.stepwise:
        compared = f"{facts['mode']}, each from the same recorded state for every method"
    else:
        compared = (
            f"{facts['coupling_steps']:,} common times, events at "
            f"{facts['steps_with_events']:,} of them"
        )
    return f"{compared} · reference: {facts['reference']} · threads: {facts['threads']}"


def _tiles(result: SolveTable) -> dict[str, str]:
    facts = result.facts
    first, last = facts["cells"]
    known, quantity = result.conditioning, result.measures()[result.main].quantity
    shift = {}
    if known is not None:
        title = f"worst cell after a shift of {known.shift:g} µm"
        shift[title] = f"{np.median(known.worst_cell):.2g} µm"
    return {
        "cells": f"{last:,}" if first == last else f"{first:,} → {last:,}",
        "simulated time": time_unit(facts["time"]).text(facts["time"]),
        "methods": f"{len(result.methods)}",
        "solves that failed": f"{len(result.failures())} of {len(result.table)}",
        "largest decay rate × time": f"{facts['largest_decay_rate'] * facts['time']:,.0f}",
        f"uncertainty of {quantity}": f"{result.uncertainty[result.main]:.1e}",
        "uncertainty of the worst cell": f"{result.uncertainty['worst_cell']:.1e}",
        **shift,
    }


def _orders(result: SolveTable) -> dict[str, str]:
    """Return the measured order of the methods with a fixed step."""
    fixed = dict.fromkeys(r["method"] for r in result.table if r["control"] == "step")
    orders = {method: result.order(method, finest=5) for method in fixed}
    return {m: f"{order:.2f}" for m, order in orders.items() if math.isfinite(order)}
