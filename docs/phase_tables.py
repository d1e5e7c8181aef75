"""Best explicit against best implicit method: tables of the phase diagram."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from phase_race import REACHED
from phase_ratios import Interval, mean_crossing, mean_ratio

from multicell.cells import FloatArray
from multicell.comparison.files import Row

MIXED: Final = ("auto",)
"""Methods that choose between both kinds: they stand beside the ratio, not in it."""
FEWEST: Final = 3
"""Number of seeds below which nothing is called significant."""


@final
@dataclass(frozen=True)
class Point:
    """One tile of the diagram over its seeds.

    Attributes
    ----------
    state, cells, stiffness
        What was solved.
    ratio : Interval
        Cost of the best explicit over that of the best implicit method.
    bound : -1, 0 or 1
        Which side did not reach the accuracy in most seeds, so that the ratio is an upper (-1:
        implicit) or a lower (1: explicit) bound.
    ill : float
        Part of the seeds in which the step is too ill-conditioned for single cells to be judged.
    best : str
        Method of the cheaper kind that is the best of its kind in most seeds; empty if none gets
        there.
    costs : method -> median CPU time in s; of those that reached the accuracy in most seeds
    """

    state: str
    cells: int
    stiffness: float
    ratio: Interval
    bound: int
    ill: float
    best: str
    costs: dict[str, float]

    @property
    def verdict(self) -> str:
        """Which kind is cheaper, or that it is open."""
        if self.ratio.samples < FEWEST:
            return "open"
        if self.bound:
            return "explicit" if self.bound < 0 else "implicit"
        if self.ratio.low > 1.0:
            return "implicit"
        return "explicit" if self.ratio.high < 1.0 else "open"


def tiles(rows: Sequence[Row], accuracy: float) -> dict[tuple[str, int, float], list[list[Row]]]:
    """Return the rows of each state, number of cells and stiffness, seed by seed."""
    found: dict[tuple[str, int, float], dict[int, list[Row]]] = {}
    for row in rows:
        if row["accuracy"] == accuracy:
            key = (row["state"], int(row["cells"]), row["stiffness"])
            found.setdefault(key, {}).setdefault(int(row["seed"]), []).append(row)
    return {key: [by[seed] for seed in sorted(by)] for key, by in found.items()}


def ratio_of(rows: Sequence[Row]) -> tuple[float, int]:
    """Return the ratio of one seed, NaN if neither side gets there, and which side does not.

    The cost of a side that does not get there is the largest bound among its methods.
    """
    costs, reached = [], []
    for implicit in (0, 1):
        side = [r for r in rows if r["implicit"] == implicit and r["method"] not in MIXED]
        there = [row["cost_s"] for row in side if row["status"] == REACHED]
        bounds = [row["cost_s"] for row in side]
        reached.append(bool(there))
        costs.append(min(there) if there else max(bounds, default=math.nan))
    if not any(reached):
        return math.nan, 0
    return costs[0] / costs[1], reached[1] - reached[0]


def points(rows: Sequence[Row], accuracy: float) -> list[Point]:
    """Return all tiles at an accuracy."""
    found = []
    for (state, cells, stiffness), seeds in tiles(rows, accuracy).items():
        pairs = [ratio_of(of) for of in seeds]
        known = np.array([ratio for ratio, _ in pairs if math.isfinite(ratio)])
        ratio = mean_ratio(known) if len(known) else Interval(math.nan, 0.0, math.inf, 0)
        bounds = [bound for _, bound in pairs]
        bound = next((b for b in (-1, 1) if bounds.count(b) > 0.5 * len(bounds)), 0)
        ill = float(np.mean([of[0]["judged_by"] == "observable" for of in seeds]))
        winning = int(ratio.value > 1.0)
        best = Counter(_cheapest(of, winning) for of in seeds).most_common(1)[0][0]
        found.append(Point(state, cells, stiffness, ratio, bound, ill, best, _costs(seeds)))
    return found


def _cheapest(rows: Sequence[Row], implicit: int) -> str:
    there = [
        row
        for row in rows
        if row["status"] == REACHED and row["implicit"] == implicit and row["method"] not in MIXED
    ]
    return str(min(there, key=lambda row: row["cost_s"])["method"]) if there else ""


def _costs(seeds: Sequence[Sequence[Row]]) -> dict[str, float]:
    by: dict[str, list[float]] = {}
    for row in (row for of in seeds for row in of):
        by.setdefault(row["method"], []).append(
            row["cost_s"] if row["status"] == REACHED else math.inf
        )
    middle = {name: float(np.median(costs)) for name, costs in by.items()}
    return {name: cost for name, cost in middle.items() if math.isfinite(cost)}


def crossing(rows: Sequence[Row], accuracy: float, state: str, cells: int) -> Interval | None:
    """Return the λΔt above which implicit methods are cheaper; None if nothing is known."""
    known = {key: of for key, of in tiles(rows, accuracy).items() if key[:2] == (state, cells)}
    places = np.array(sorted(key[2] for key in known))
    seeds = sorted({int(row["seed"]) for of in known.values() for seed in of for row in seed})
    if not len(places):
        return None
    ratios: FloatArray = np.full((len(seeds), len(places)), np.nan)
    for k, place in enumerate(places):
        for of in known[state, cells, place]:
            ratios[seeds.index(int(of[0]["seed"])), k] = ratio_of(of)[0]
    return mean_crossing(places, ratios)


def points_table(found: Sequence[Point]) -> str:
    """Return the table of all tiles."""
    head = ["state", "cells", "λΔt", "explicit / implicit (95 %)", "seeds", "cheaper", "best",
            "auto / best", "judged by observables"]  # fmt: skip
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for p in found:
        sign = {-1: "≤ ", 0: "", 1: "≥ "}[p.bound]
        pure = [cost for name, cost in p.costs.items() if name not in MIXED]
        auto = f"{p.costs['auto'] / min(pure):.2f}" if "auto" in p.costs and pure else "–"
        best = f"{p.best} {p.costs[p.best]:.2g} s" if p.best in p.costs else p.best or "none"
        lines.append(
            f"| {p.state} | {p.cells:,} | {p.stiffness:.0e} | {sign}{p.ratio.text()} | "
            f"{p.ratio.samples} | {p.verdict} | {best} | {auto} | {100 * p.ill:.0f} % |"
        )
    return "\n".join(lines)


def crossings_table(rows: Sequence[Row], accuracy: float) -> str:
    """Return the table of the stiffness above which implicit methods are cheaper."""
    lines = ["| state | cells | implicit cheaper above λΔt (95 %) | seeds |", "|---|---|---|---|"]
    for state, cells in dict.fromkeys((r["state"], int(r["cells"])) for r in rows):
        found = crossing(rows, accuracy, state, cells)
        if found is not None:
            here = [r for r in rows if (r["state"], r["cells"]) == (state, cells)]
            largest = max(row["stiffness"] for row in here)
            low, high = limit_text(found.low, largest), limit_text(found.high, largest)
            value = limit_text(found.value, largest)
            lines.append(f"| {state} | {cells:,} | {value} ({low} to {high}) | {found.samples} |")
    return "\n".join(lines)


def limit_text(value: float, largest: float) -> str:
    """Return a crossing in words where it lies beyond what was tried."""
    if math.isnan(value):
        return "unknown"
    if math.isinf(value):
        return f"beyond {largest:.0e}"
    return f"{value:.1e}" if value > 0.0 else "everywhere"
