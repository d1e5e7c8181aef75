"""The tables of docs/which-integrator.md: what is fastest, and how far behind others are.

Made from the results that which_integrator.py keeps; nothing is computed here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import final

from multicell.comparison.result import DONE, WorkPrecision
from multicell.integrators.registry import METHODS

Goal = tuple[float, str]
"""An error, and the norm in which it is to be reached."""

ERRORS = {1e-2: "1 %", 1e-3: "0.1 %"}


@final
@dataclass(frozen=True, eq=False)
class Entry:
    """One case: its name, its name in files, its result, and the wall time in s that it took."""

    name: str
    slug: str
    result: WorkPrecision
    took: float

    @property
    def norm(self) -> str:
        """The norm that judges: root mean square over the cells.

        Where single steps are compared the worst one may be decided by one contact that forms
        or not; the median step is the typical one.
        """
        return "position_median" if self.result.stepwise else "position"

    @property
    def stiffness(self) -> float:
        """Largest decay rate in the run, as bounded from above, times the coupling step."""
        return float(self.result.facts["largest_decay_rate"] * self.result.scene.coupling_step)

    def times(self, goal: Goal) -> dict[str, float]:
        """Return the time in s in which each method reaches a goal, the fastest first.

        Between the last setting that misses the goal and the first that reaches it the time is
        interpolated, both logarithms linearly: ladders have half decades, and where a rung lies is
        chance. What is faster at a setting that reaches the goal counts as it is.
        """
        methods = dict.fromkeys(row["method"] for row in self.result.table)
        found = {name: self._time(name, goal) for name in methods}
        reached = {name: time for name, time in found.items() if time < math.inf}
        return dict(sorted(reached.items(), key=lambda item: item[1]))

    def _time(self, method: str, goal: Goal) -> float:
        error, norm = goal
        clock, open_error = self.result.clock, self.result.uncertainty[norm]
        rows = [row for row in self.result.table if row["method"] == method]
        points = [
            (float(row[clock]), float(row[f"error_{norm}"]) + open_error)
            for row in sorted(rows, key=lambda row: -float(row["setting"]))
            if row["status"] == DONE
        ]
        best = min((time for time, found in points if found <= error), default=math.inf)
        for (coarse, above), (fine, below) in pairwise(points):
            if above > error >= below and fine > coarse:
                part = math.log(above / error) / math.log(above / below)
                best = min(best, coarse * (fine / coarse) ** part)
        return best


def kind(method: str) -> str:
    """Return ``"explicit"``, ``"implicit"`` or ``""`` of a method."""
    info = METHODS.get(method)
    # auto is of no order of its own
    if info is None or info.outside or not (info.implicit or info.order):
        return ""
    return "implicit" if info.implicit else "explicit"


def first_of(times: dict[str, float], wanted: str) -> str:
    """Return the fastest method of a kind, with its time."""
    for name, time in times.items():
        if kind(name) == wanted:
            return f"`{name}`, {shown(time)}"
    return "–"


def shown(seconds: float) -> str:
    """Return a time in s or ms with three digits."""
    return f"{seconds:.3g} s" if seconds >= 1.0 else f"{1e3 * seconds:.3g} ms"


def scenes_table(entries: list[Entry]) -> str:
    """Return the fastest method of each kind for each error, and ``auto`` over the best."""
    head = ["scene", "λΔt"]
    for text in ERRORS.values():
        head += [f"explicit, {text}", f"implicit, {text}", f"`auto` / best, {text}"]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join([*lines, *(f"| {' | '.join(line(entry))} |" for entry in entries)])


def line(entry: Entry) -> list[str]:
    """Return the cells of one line of the table."""
    cells = [f"[{entry.name}](figures/compare-{entry.slug}.png)", f"{entry.stiffness:,.0f}"]
    for error in ERRORS:
        times = entry.times((error, entry.norm))
        ratio = f"{times['auto'] / own(times):.2g}" if "auto" in times else "–"
        cells += [first_of(times, "explicit"), first_of(times, "implicit"), ratio]
    return cells


def own(times: dict[str, float]) -> float:
    """Return the least time of a method of multicell, s; NaN if none reaches the goal."""
    return next((time for name, time in times.items() if name in METHODS), math.nan)


def write_page(entries: list[Entry], page: Path | None) -> None:
    """Put the table between its marks on the page, or print it."""
    table = scenes_table(entries)
    if page is None:
        print(table)
        return
    text = replaced(page.read_text(encoding="utf-8"), "built-in scenes", table)
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
