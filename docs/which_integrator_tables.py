"""The tables of docs/which-integrator.md: what is fastest, and how far behind others are.

Made from the results that which_integrator.py keeps; nothing is computed here.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any, final

from multicell.comparison.files import CLOCKS
from multicell.comparison.result import WorkPrecision
from multicell.integrators.registry import METHODS

Goal = tuple[float, str]
"""An error, and the norm in which it is to be reached."""

ERRORS = {1e-2: "1 %", 1e-3: "0.1 %"}
DEFAULTS = "sundials-defaults"
FIFTH, CLOSE = 0.2, 1.3
MET, MISSED, OPEN = "met", "missed", "open"
STIFF = ("stiff-inclusions", "grow-2000 at 0.05 kPa s")
"""Scenes on which `cvode` has to take at most a fifth of the time of `euler`."""


@final
@dataclass(frozen=True, eq=False)
class Entry:
    """One case: its name, its name in files, its result, and the wall time in s that it took."""

    name: str
    slug: str
    result: WorkPrecision
    took: float

    @property
    def norms(self) -> dict[str, str]:
        """The norms that judge -> what they are called in the tables.

        Where single steps are compared the worst one may be decided by one contact that forms
        or not; the median step is the typical one.
        """
        if self.result.stepwise:
            return {"position": "worst step", "position_median": "median step"}
        return {"position": "whole run"}

    @property
    def stiffness(self) -> float:
        """Largest decay rate in the run, as bounded from above, times the coupling step."""
        return float(self.result.facts["largest_decay_rate"] * self.result.scene.coupling_step)

    def best(self, goal: Goal) -> dict[str, dict[str, Any]]:
        """Return for each method of multicell that reaches a goal its cheapest row."""
        within = self.result.within(*goal)
        return {name: row for name, row in within.items() if name in METHODS}

    def time(self, method: str, goal: Goal) -> float | None:
        """Return the least time in s in which a method reaches a goal, or None."""
        row = self.result.within(*goal).get(method)
        return None if row is None else float(row[self.result.clock])

    def ratio(self, method: str, other: str | None, goal: Goal) -> float | None:
        """Return the time of a method over that of another, or of the fastest."""
        fastest = next(iter(self.best(goal)), None)
        ours = self.time(method, goal)
        theirs = self.time(other or fastest or "", goal)
        return None if ours is None or theirs is None else ours / theirs


def kind(method: str) -> str:
    """Return ``"explicit"``, ``"implicit"`` or ``""`` of a method."""
    info = METHODS.get(method)
    # auto is of no order of its own
    if info is None or info.outside or not (info.implicit or info.order):
        return ""
    return "implicit" if info.implicit else "explicit"


def first_of(entry: Entry, goal: Goal, wanted: str = "") -> str:
    """Return the fastest method of a kind that reaches a goal, with its time."""
    for name, row in entry.best(goal).items():
        if wanted in ("", kind(name)):
            return f"{name}, {shown(float(row[entry.result.clock]))}"
    return "none"


def shown(seconds: float) -> str:
    """Return a time in s or ms with three digits."""
    return f"{seconds:.3g} s" if seconds >= 1.0 else f"{1e3 * seconds:.3g} ms"


def times(ratio: float | None) -> str:
    """Return a ratio with two digits."""
    return "none" if ratio is None else f"{ratio:.2g}"


def fastest_table(entries: list[Entry], error: float) -> str:
    """Return the table of one error: the fastest methods, and ratios to them."""
    head = ["scene", "steps", "λΔt", "judged by", "fastest", "fastest explicit", "fastest implicit",
            "cvode / fastest", "auto / fastest", "euler / fastest", "cvode / euler",
            "cvode / defaults", "reference"]  # fmt: skip
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += [
        f"| {' | '.join(line(entry, (error, norm)))} |" for entry in entries for norm in entry.norms
    ]
    return "\n".join(lines)


def line(entry: Entry, goal: Goal) -> list[str]:
    """Return the cells of one line of the table."""
    result = entry.result
    ratios = [entry.ratio(method, None, goal) for method in ("cvode", "auto", "euler")]
    ratios += [entry.ratio("cvode", other, goal) for other in ("euler", DEFAULTS)]
    steps, whole = result.facts["coupling_steps"], result.facts["coupling_steps_in_all"]
    return [
        f"[{entry.name}](figures/compare-{entry.slug}.png)",
        f"{steps} of {whole}" if result.stepwise else f"{steps}",
        f"{entry.stiffness:,.0f}",
        entry.norms[goal[1]],
        first_of(entry, goal),
        first_of(entry, goal, "explicit"),
        first_of(entry, goal, "implicit"),
        *map(times, ratios),
        f"{result.uncertainty[goal[1]]:.0e}",
    ]


@final
@dataclass(frozen=True)
class Claim:
    """The ratio of two times in one line of the tables, and the limit that it is held against."""

    words: str
    ratio: float | None
    allowed: float

    @property
    def verdict(self) -> str:
        """Whether it is met; open where a method does not reach the error."""
        if self.ratio is None:
            return OPEN
        return MET if self.ratio <= self.allowed else MISSED


def claims(entries: list[Entry]) -> list[Claim]:
    """Return the ratios of all scenes, errors and norms that are held against a limit."""
    where = f" ({' and '.join(STIFF)})"
    pairs = (("cvode", "euler", FIFTH), ("cvode", DEFAULTS, 1.0), ("auto", None, CLOSE))
    return [
        Claim(
            f"`{method}` / {f'`{other}`' if other else 'fastest'}" + where * (other == "euler"),
            entry.ratio(method, other, (error, norm)), allowed,
        )
        for method, other, allowed in pairs
        for entry in entries
        if other != "euler" or entry.name in STIFF
        for norm in entry.norms
        for error in ERRORS
    ]  # fmt: skip


def tally(entries: list[Entry]) -> str:
    """Return how many of the lines keep each limit, miss it, or were cut short."""
    found = claims(entries)
    lines = [
        "| time of | at most | lines | kept | missed | not reached in time |",
        "|" + "---|" * 6,
    ]
    for words, allowed in dict.fromkeys((claim.words, claim.allowed) for claim in found):
        own = [claim.verdict for claim in found if claim.words == words]
        counts = (len(own), own.count(MET), own.count(MISSED), own.count(OPEN))
        lines.append(f"| {words} | {allowed:g} | {' | '.join(map(str, counts))} |")
    return "\n".join(lines)


def summary(entries: list[Entry]) -> str:
    """Return what the lines say together, and how the times were taken."""
    goals = [
        (entry, (error, norm)) for entry in entries for norm in entry.norms for error in ERRORS
    ]
    first = [next(iter(entry.best(goal)), "") for entry, goal in goals]
    ratios = [entry.ratio("cvode", None, goal) for entry, goal in goals]
    reached = [ratio for ratio in ratios if ratio is not None]
    clocks = " and ".join(sorted({CLOCKS[entry.result.clock] for entry in entries}))
    took = sum(entry.took for entry in entries) / 60.0
    return (
        f"Of {len(goals)} lines an explicit method is the fastest in "
        f"{sum(kind(name) == 'explicit' for name in first)}; `cvode` reaches the error in "
        f"{len(reached)}, in {min(reached):.2g} to {max(reached):.2g} times the time of the "
        f"fastest (median {median(reached):.2g}). Judged by {clocks}; all took {took:.0f} min."
    )


def write_page(entries: list[Entry], page: Path | None) -> None:
    """Put the tables between their marks on the page, or print them."""
    blocks = {
        **{f"fastest at {text}": fastest_table(entries, e) for e, text in ERRORS.items()},
        "lines together": f"{summary(entries)}\n\n{tally(entries)}",
    }
    if page is None:
        print("\n\n".join(blocks.values()))
        return
    text = page.read_text(encoding="utf-8")
    for name, block in blocks.items():
        text = replaced(text, name, block)
    page.write_text(text, encoding="utf-8")


def replaced(text: str, name: str, block: str) -> str:
    """Return a page with one of its marked blocks replaced.

    Raises
    ------
    ValueError
        If the page has no such marks.
    """
    begin, end = f"<!-- {name}: made by a script -->", f"<!-- end of {name} -->"
    before, found, rest = text.partition(begin)
    _, closed, after = rest.partition(end)
    if not (found and closed):
        raise ValueError(f"the page lacks the marks {begin!r} and {end!r}")
    return f"{before}{begin}\n\n{block}\n\n{end}{after}"
