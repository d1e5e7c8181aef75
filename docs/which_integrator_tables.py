"""The tables of docs/which-integrator.md: what is fastest, and what had to be shown.

Made from the results that which_integrator.py keeps; nothing is computed here.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

from multicell.comparison.files import CLOCKS
from multicell.comparison.result import WorkPrecision
from multicell.integrators.registry import METHODS

Goal = tuple[float, str]
"""An error, and the norm in which it is to be reached."""

ERRORS = {1e-2: "1 %", 1e-3: "0.1 %"}
DEFAULTS = "sundials-defaults"
FIFTH, CLOSE = 0.2, 1.3
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
    head = ["scene", "steps", "judged by", "fastest", "fastest explicit", "fastest implicit",
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
    """A line that had to be shown: the ratio of two times, and the largest that is allowed."""

    words: str
    scene: str
    norm: str
    error: float
    ratio: float | None
    allowed: float

    @property
    def verdict(self) -> str:
        """Whether it is met; open where a method does not reach the error."""
        if self.ratio is None:
            return "open"
        return "met" if self.ratio <= self.allowed else "**not met**"


def claims(entries: list[Entry]) -> list[Claim]:
    """Return what had to be shown, in every norm that judges a scene."""
    pairs = (("cvode", "euler", FIFTH), ("cvode", DEFAULTS, 1.0), ("auto", None, CLOSE))
    return [
        Claim(
            f"`{method}` / {f'`{other}`' if other else 'fastest'}", entry.name, entry.norms[norm],
            error, entry.ratio(method, other, (error, norm)), allowed,
        )
        for method, other, allowed in pairs
        for entry in entries
        if other != "euler" or entry.name in STIFF
        for norm in entry.norms
        for error in ERRORS
    ]  # fmt: skip


def claims_table(entries: list[Entry]) -> str:
    """Return the table of what had to be shown."""
    head = "| time of | scene | judged by | error | ratio | allowed | |"
    lines = [head, "|" + "---|" * 7]
    for claim in claims(entries):
        lines.append(
            f"| {claim.words} | {claim.scene} | {claim.norm} | {ERRORS[claim.error]} "
            f"| {times(claim.ratio)} | {claim.allowed:g} | {claim.verdict} |"
        )
    return "\n".join(lines)


def summary(entries: list[Entry]) -> str:
    """Return how many of the lines are met, and how the times were taken."""
    verdicts = [claim.verdict for claim in claims(entries)]
    met, lost = verdicts.count("met"), verdicts.count("open")
    clocks = " and ".join(sorted({CLOCKS[entry.result.clock] for entry in entries}))
    took = sum(entry.took for entry in entries) / 60.0
    return (
        f"{met} of {len(verdicts)} lines are met; {lost} are open, since a method did not reach "
        f"the error in the time it was given. Judged by {clocks}; the chart took {took:.0f} min."
    )


def write_page(entries: list[Entry], page: Path | None) -> None:
    """Put the tables between their marks on the page, or print them."""
    blocks = {
        **{f"fastest at {text}": fastest_table(entries, e) for e, text in ERRORS.items()},
        "what had to be shown": f"{summary(entries)}\n\n{claims_table(entries)}",
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
