"""Best explicit against best implicit method over the seeds of a tile, as tables of a page."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from scipy.stats import t as student
from tile_problems import GOALS, STATES
from tile_race import DEFAULT, REACHED, Row

from multicell.comparison.null_methods import NULL_METHODS

MIXED: Final = ("auto",)
"""Methods that choose between both kinds: they stand beside the ratio, not in it."""
KINDS: Final = ("explicit", "implicit")
FEWEST: Final = 3
"""Number of seeds below which nothing is called significant."""
EVEN: Final = 1.15
"""Lead below which both kinds are called even."""


@final
@dataclass(frozen=True)
class Point:
    """One tile of the diagram over its seeds.

    Attributes
    ----------
    state, cells, stiffness
        What was solved.
    seeds : int
    ratio, low, high : float
        Cost of the best explicit over that of the best implicit method: geometric mean over the
        seeds with its 95 % interval (Student's, of the logarithms).
    bound : -1, 0 or 1
        Which side did not reach the goal in most seeds, so that the ratio is an upper (-1:
        implicit) or a lower (1: explicit) bound.
    best : str
        Method that costs least, by the median over the seeds of its cost over the least; empty if
        none reaches the goal in most seeds.
    cost : float, s
        Its median CPU time.
    auto : float
        Cost of ``auto`` over the best method's, median over the seeds; NaN if it misses the goal.
    null : float
        Error of the best null method (the best dilation among them), median over the seeds.
    ill : float
        Part of the seeds in which a shift by a tenth of the goal ends further off than the goal.
    """

    state: str
    cells: int
    stiffness: float
    seeds: int
    ratio: float
    low: float
    high: float
    bound: int
    best: str
    cost: float
    auto: float
    null: float
    ill: float
    goal: float

    @property
    def nullity(self) -> bool:
        """Whether a null method reaches the goal: then nothing was asked."""
        return self.null <= self.goal

    @property
    def sure(self) -> bool:
        """Whether the seeds tell which kind is cheaper."""
        return self.seeds >= FEWEST and bool(self.bound or not self.low <= 1.0 <= self.high)

    @property
    def lead(self) -> str:
        """Cost of the other kind over the cheaper one."""
        if not math.isfinite(self.ratio):
            return "–"
        factor = max(self.ratio, 1.0 / self.ratio)
        if factor < EVEN and not self.bound:
            return "even"
        sign = "≥ " if self.bound else ""
        return f"{sign}{factor:.2g}×" if factor < 9.95 else f"{sign}{factor:.0f}×"


def points(tiles: Sequence[Row], rows: Sequence[Row], goal: float) -> list[Point]:
    """Return all tiles at a goal."""
    about: dict[tuple[str, int, float], list[Row]] = {}
    for tile in tiles:
        about.setdefault((tile["state"], int(tile["cells"]), tile["stiffness"]), []).append(tile)
    by: dict[tuple[object, ...], list[Row]] = {}
    for row in rows:
        if row["goal"] == goal:
            key = (row["state"], int(row["cells"]), row["stiffness"], row["seed"])
            by.setdefault(key, []).append(row)
    return [
        _point(key, of, [by[*key, tile["seed"]] for tile in of], goal) for key, of in about.items()
    ]


def _point(
    key: tuple[str, int, float], tiles: Sequence[Row], seeds: Sequence[Sequence[Row]], goal: float
) -> Point:
    pairs = [_ratio(rows) for rows in seeds]
    logs = np.log([ratio for ratio, _ in pairs if math.isfinite(ratio)])
    bounds = [bound for _, bound in pairs]
    bound = next((b for b in (-1, 1) if bounds.count(b) > 0.5 * len(bounds)), 0)
    mean = float(logs.mean()) if len(logs) else math.nan
    half = math.inf
    if len(logs) > 1:
        half = float(student.ppf(0.975, len(logs) - 1) * logs.std(ddof=1) / math.sqrt(len(logs)))
    leads = _leads(seeds)
    pure = {name: lead for name, lead in leads.items() if name not in MIXED}
    best = min(pure, key=pure.__getitem__, default="")
    costs = [
        r["cost"] for of in seeds for r in of if r["method"] == best and r["status"] == REACHED
    ]
    nulls = [
        min(tile["best_dilation"], *(r["error"] for r in of if r["method"] in NULL_METHODS))
        for tile, of in zip(tiles, seeds, strict=True)
    ]
    ill = float(np.mean([tile[f"conditioning_{goal:g}"] > 1.0 for tile in tiles]))
    low, high = (math.exp(min(max(mean + end * half, -700.0), 700.0)) for end in (-1.0, 1.0))
    return Point(
        *key, len(tiles), math.exp(mean), low, high, bound, best,
        float(np.median(costs)) if costs else math.nan, leads.get("auto", math.nan),
        float(np.median(nulls)), ill, goal,
    )  # fmt: skip


def _ratio(rows: Sequence[Row]) -> tuple[float, int]:
    """Return the ratio of one seed, NaN if neither side gets there, and which side does not.

    The cost of a side that does not get there is the largest bound among its methods.
    """
    costs, reached = [], []
    for implicit in (0, 1):
        side = [
            r for r in rows
            if r["implicit"] == implicit and r["method"] not in (*MIXED, *NULL_METHODS)
        ]  # fmt: skip
        there = [row["cost"] for row in side if row["status"] == REACHED]
        reached.append(bool(there))
        costs.append(min(there) if there else max((r["cost"] for r in side), default=math.nan))
    if not any(reached):
        return math.nan, 0
    return costs[0] / costs[1], reached[1] - reached[0]


def seed_range(found: Collection[Point], cells: int) -> str:
    """Return with how many seeds tiles of so many cells were solved, such as 1 to 5."""
    few, many = (choose(p.seeds for p in found if p.cells == cells) for choose in (min, max))
    return str(few) if few == many else f"{few} to {many}"


def _leads(seeds: Sequence[Sequence[Row]]) -> dict[str, float]:
    """Return method -> median over its seeds of its cost over the least of a method of one kind.

    Only methods that reach the goal in more than half of their seeds.
    """
    found: dict[str, list[float]] = {}
    for rows in seeds:
        there = {
            r["method"]: r["cost"] if r["status"] == REACHED else math.inf
            for r in rows if r["method"] not in NULL_METHODS
        }  # fmt: skip
        least = min((c for name, c in there.items() if name not in MIXED), default=math.inf)
        for name, cost in there.items():
            found.setdefault(name, []).append(cost / least if math.isfinite(cost) else math.inf)
    middle = {name: float(np.median(of)) for name, of in found.items()}
    return {name: lead for name, lead in middle.items() if math.isfinite(lead)}


def power(value: float) -> str:
    """Return for example ``10⁴``."""
    exponent = round(math.log10(value))
    if not math.isclose(value, 10.0**exponent):
        return f"{value:.2g}"
    return "10" if exponent == 1 else "10" + "".join("⁰¹²³⁴⁵⁶⁷⁸⁹"[int(d)] for d in str(exponent))


def duration(seconds: float) -> str:
    """Return a time with its unit, two digits."""
    number, unit = (seconds, "s") if seconds >= 0.995 else (1e3 * seconds, "ms")
    if not math.isfinite(number):
        return "–"
    return f"{number:.2g} {unit}" if number < 99.5 else f"{number:.0f} {unit}"


def markdown(head: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """Return a table of a page."""
    rule = "|" + "---|" * len(head)
    return "\n".join(["| " + " | ".join(head) + " |", rule,
                      *("| " + " | ".join(line) + " |" for line in lines)])  # fmt: skip


def main_table(tiles: Sequence[Row], rows: Sequence[Row], goal: float) -> str:
    """Return the best method of each tile, its cost, the other kind's factor and that of auto."""
    found = {(p.state, p.stiffness, p.cells): p for p in points(tiles, rows, goal)}
    counts = sorted({cells for _, _, cells in found})
    lines = []
    for state in STATES:
        for z in sorted({z for s, z, _ in found if s == state}):
            cells = [_entry(found.get((state, z, n))) for n in counts]
            lines.append([state, power(z), *cells])
    heads = [f"{power(n)} cells (seeds: {seed_range(found.values(), n)})" for n in counts]
    return markdown(["state", "λΔt", *heads], lines)


def _entry(point: Point | None) -> str:
    if point is None:
        return ""
    if point.nullity:
        return "a null method is within the error"
    if not point.best:
        return "reached by no method"
    doubt = "" if point.sure or point.lead == "even" else "?"
    auto = f"{point.auto:.2g}" if math.isfinite(point.auto) else "–"
    ill = "*" if point.ill > 0.5 else ""
    return f"`{point.best}` {duration(point.cost)}{ill}; {point.lead}{doubt}; {auto}"


def states_table(tiles: Sequence[Row]) -> str:
    """Return properties of the tiles of each state and number of cells."""
    lines = []
    for state in STATES:
        for n in sorted({t["cells"] for t in tiles if t["state"] == state}):
            of = [t for t in tiles if (t["state"], t["cells"]) == (state, n)]
            radius = np.array([t["radius_um"] for t in of])
            lines.append([
                state, power(n), f"{100 * np.mean([t['divided'] for t in of]):.2g} %",
                _span([100.0 * t["moved_um"] / r for t, r in zip(of, radius, strict=True)]),
                _span([100.0 * t["residual_um"] / r for t, r in zip(of, radius, strict=True)]),
                f"{max(t['uncertainty'] for t in of):.0e}",
                *(f"{sum(t[f'conditioning_{g:g}'] > 1.0 for t in of)} of {len(of)}" for g in GOALS),
            ])  # fmt: skip
    head = ["state", "cells", "divided just before", "motion / % of a radius",
            "left by dilation / %", "uncertainty of the reference",
            *(f"ill-conditioned at {100 * g:g} %" for g in GOALS)]  # fmt: skip
    return markdown(head, lines)


def _span(values: Sequence[float]) -> str:
    low, middle, high = np.percentile(values, [5, 50, 95])
    return f"{middle:.2g} ({low:.2g} to {high:.2g})"


def defaults_table(rows: Sequence[Row]) -> str:
    """Return results of methods at their default tolerance: error, and cost over the best one's."""
    least: dict[tuple[object, ...], float] = {}
    for r in rows:
        if r["goal"] == GOALS[0] and r["status"] == REACHED and r["method"] not in NULL_METHODS:
            key = _tile(r)
            least[key] = min(r["cost"], least.get(key, math.inf))
    lines = []
    for name in dict.fromkeys(r["method"] for r in rows if r["goal"] == DEFAULT):
        of = [r for r in rows if (r["method"], r["goal"]) == (name, DEFAULT) and _tile(r) in least]
        done = [r for r in of if r["status"] == REACHED]
        if not done:
            continue
        errors = 100.0 * np.array([r["error"] for r in done])
        worst = 100.0 * np.array([r["worst"] for r in done])
        costs = [r["cost"] / least[_tile(r)] for r in done]
        within = sum(r["error"] <= GOALS[0] for r in done) / len(of)
        lines.append([
            f"`{name}`", f"{len(of)}", f"{100 * within:.0f} %",
            f"{np.median(errors):.2g} %, {np.percentile(errors, 95):.2g} %",
            f"{np.median(worst):.2g} %, {np.percentile(worst, 95):.2g} %",
            f"{np.median(costs):.2g}, {np.percentile(costs, 95):.2g}",
        ])  # fmt: skip
    head = ["method", "steps", f"within {100 * GOALS[0]:g} %", "error (median, 95th percentile)",
            "worst cell (the same)", "cost / least for 10 % (the same)"]  # fmt: skip
    return markdown(head, lines)


def _tile(row: Row) -> tuple[object, ...]:
    return row["state"], row["cells"], row["stiffness"], row["seed"]


def again_table(tiles: Sequence[Row], rows: Sequence[Row], others: int) -> str:
    """Return the tiles that were repeated: ratios of both sets of seeds, and whether they agree.

    They agree if the two means differ by less than 1.96 standard errors of their difference, or by
    less than :data:`EVEN`.
    """
    lines = []
    for goal in GOALS[-1:]:
        first, second = (
            {(p.state, p.cells, p.stiffness): p for p in points(
                [t for t in tiles if (t["seed"] >= others) == late],
                [r for r in rows if (r["seed"] >= others) == late], goal)}
            for late in (False, True)
        )  # fmt: skip
        for key in sorted(second):
            a, b = first[key], second[key]
            gap = abs(math.log(a.ratio / b.ratio))
            errors = [math.log(p.high / p.low) / (2.0 * 1.96) for p in (a, b)]
            agrees = gap <= max(1.96 * math.hypot(*errors), math.log(EVEN))
            lines.append([
                key[0], power(key[1]), power(key[2]), f"{100 * goal:g} %", _interval(a),
                _interval(b), f"`{a.best}`, `{b.best}`", "yes" if agrees else "no",
            ])  # fmt: skip
    head = ["state", "cells", "λΔt", "error", "explicit / implicit (95 %)", "with other seeds",
            "best", "agree"]  # fmt: skip
    return markdown(head, lines)


def _interval(point: Point) -> str:
    sign = {-1: "≤ ", 0: "", 1: "≥ "}[point.bound]
    return f"{sign}{point.ratio:.2g} ({point.low:.2g} to {point.high:.2g})"
