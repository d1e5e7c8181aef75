"""By how much a method and its tolerance change observables, in units of the scatter over seeds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np
from scipy.stats import t as student

Row = dict[str, Any]
Candidate = tuple[str, float]

ALLOWED: Final = 0.1
"""Change of an observable over its scatter that a default may make."""
LEVEL: Final = 0.95
"""Confidence of the intervals: of twenty observables that do not change one seems to."""
_NO_SCATTER: Final = 1e-6  # part of its value below which an observable does not scatter
_PART: Final = 0.01  # of its value, taken for the scatter of what has none


@final
@dataclass(frozen=True)
class Change:
    """How far a candidate is from the reference in one observable.

    Attributes
    ----------
    observable : str
    mean : float
        Mean over the seeds of the paired difference, in standard deviations over the seeds.
    half : float
        Half width of its interval, in the same unit; infinite of a single seed.
    """

    observable: str
    mean: float
    half: float

    @property
    def beyond(self) -> bool:
        """Whether the change is larger than allowed, beyond its own error."""
        return abs(self.mean) - self.half > ALLOWED

    @property
    def within(self) -> bool:
        """Whether it is shown to be no larger than allowed."""
        return abs(self.mean) + self.half <= ALLOWED


def changes(rows: Sequence[Row], candidate: Candidate, reference: Candidate) -> list[Change]:
    """Return the changes of one scene, one for each observable that both have for each seed."""
    tables = [_by_observable(rows, *of) for of in (candidate, reference)]
    found = []
    for name in dict.fromkeys(tables[1]):
        ours, exact = tables[0].get(name, {}), tables[1][name]
        seeds = sorted(set(ours) & set(exact))
        if seeds:
            a, b = (np.array([table[seed] for seed in seeds]) for table in (ours, exact))
            found.append(_change(name, a, b))
    return found


def _by_observable(rows: Sequence[Row], method: str, atol: float) -> dict[str, dict[int, float]]:
    table: dict[str, dict[int, float]] = {}
    for row in rows:
        if (row["method"], row["atol_um"]) == (method, atol) and math.isfinite(row["value"]):
            table.setdefault(row["observable"], {})[row["seed"]] = row["value"]
    return table


def _change(name: str, ours: np.ndarray, exact: np.ndarray) -> Change:
    n = len(exact)
    scale = float(np.abs(exact).max())
    scatter = float(exact.std(ddof=1)) if n > 1 else 0.0
    unit = scatter if scatter > _NO_SCATTER * scale else _PART * scale
    difference = (ours - exact) / (unit or 1.0)
    if n < 2:
        return Change(name, float(difference.mean()), math.inf)
    error = float(difference.std(ddof=1)) / math.sqrt(n)
    return Change(
        name, float(difference.mean()), float(student.ppf(0.5 + LEVEL / 2, n - 1)) * error
    )


def candidates(rows: Sequence[Row]) -> list[Candidate]:
    """Return methods with tolerances in the order in which they first appear."""
    found = dict.fromkeys((row["method"], row["atol_um"]) for row in rows)
    return sorted(found, key=lambda of: (of[0], -of[1]))


def cost(rows: Sequence[Row], candidate: Candidate) -> float:
    """Return the mean CPU time of a run of one scene, s."""
    by = {r["seed"]: r["cpu_s"] for r in rows if (r["method"], r["atol_um"]) == candidate}
    return float(np.mean(list(by.values()))) if by else math.nan


def failures(rows: Sequence[Row], candidate: Candidate) -> int:
    """Return how many runs failed."""
    return sum(
        row["observable"] == "failed" and (row["method"], row["atol_um"]) == candidate
        for row in rows
    )


def candidate_table(rows: Sequence[Row], reference: Candidate) -> str:
    """Return the table of each scene and candidate: cost, and the observable changed most."""
    head = ["scene", "method", "CPU / s", "observable changed most", "change / scatter (95 %)",
            "beyond a tenth", "shown within", "seeds"]  # fmt: skip
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for case in dict.fromkeys(row["case"] for row in rows):
        of = [row for row in rows if row["case"] == case]
        seeds = len({row["seed"] for row in of})
        for candidate in candidates(of):
            lines.append(_line(case, of, candidate, reference, seeds))
    return "\n".join(lines)


def _line(
    case: str, rows: Sequence[Row], candidate: Candidate, reference: Candidate, seeds: int
) -> str:
    first = f"| {case} | {candidate[0]} {candidate[1]:g} µm | {cost(rows, candidate):.2f}"
    if candidate == reference:
        return f"{first} | reference |  |  |  | {seeds} |"
    failed = failures(rows, candidate)
    if failed:
        return f"{first} | {failed} runs failed |  |  |  | {seeds} |"
    found = changes(rows, candidate, reference)
    if not found:
        return f"{first} | nothing to compare |  |  |  | {seeds} |"
    worst = max(found, key=lambda c: abs(c.mean) - (c.half if math.isfinite(c.half) else 0.0))
    beyond = ", ".join(c.observable for c in found if c.beyond) or "–"
    within = f"{sum(c.within for c in found)} of {len(found)}"
    return (
        f"{first} | {worst.observable} | {worst.mean:+.2g} ± {worst.half:.2g} | {beyond} | "
        f"{within} | {seeds} |"
    )


def default_table(rows: Sequence[Row], reference: Candidate) -> str:
    """Return the table of the defaults: the cheapest candidate that changes nothing too much."""
    head = ["scene", "default", "CPU / s", "reference / s", "resolved to (median, largest)",
            "cheapest that is shown to be within"]  # fmt: skip
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for case in dict.fromkeys(row["case"] for row in rows):
        of = [row for row in rows if row["case"] == case]
        chosen = default(of, reference)
        if chosen is None:
            continue
        halves = [c.half for c in changes(of, chosen, reference)]
        resolved = "–" if not halves else f"{np.median(halves):.2g}, {max(halves):.2g} scatters"
        lines.append(
            f"| {case} | {chosen[0]} {chosen[1]:g} µm | {cost(of, chosen):.2f} | "
            f"{cost(of, reference):.2f} | {resolved} | {_named(default(of, reference, True))} |"
        )
    return "\n".join(lines)


def _named(candidate: Candidate | None) -> str:
    return "none" if candidate is None else f"{candidate[0]} {candidate[1]:g} µm"


def default(rows: Sequence[Row], reference: Candidate, shown: bool = False) -> Candidate | None:
    """Return the cheapest candidate of a scene with no change beyond a tenth of the scatter.

    Only candidates that were run with every seed of the reference and never failed are taken.
    With ``shown`` every change must be shown to be smaller, error included; without, none may be
    shown to be larger. Where trajectories part, a paired difference scatters by √2 of the scatter
    over seeds, and to show a tenth takes (2 · 1.4 / 0.1)², about 800 seeds.
    """
    wanted = {r["seed"] for r in rows if (r["method"], r["atol_um"]) == reference}
    good = []
    for candidate in candidates(rows):
        seeds = {r["seed"] for r in rows if (r["method"], r["atol_um"]) == candidate}
        if not seeds >= wanted or not wanted or failures(rows, candidate):
            continue
        found = changes(rows, candidate, reference)
        if all(change.within if shown else not change.beyond for change in found):
            good.append(candidate)
    return min(good, key=lambda candidate: cost(rows, candidate), default=None)
