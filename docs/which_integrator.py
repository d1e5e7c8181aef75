"""Regenerate the charts and the table of docs/which-integrator.md.

Problem   the scenes of the chart, each with all methods that can hold it
Cost      about half an hour on 2 cores; --quick takes a tenth of the time per scene
Command   python docs/which_integrator.py            (or with names of scenes: settle-1000 ...)
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import multicell as mc
from multicell.comparison.result import WorkPrecision

HERE = Path(__file__).parent
PAGE = HERE / "which-integrator.md"
BEGIN, END = "<!-- table: made by which_integrator.py -->", "<!-- end of table -->"


@dataclass(frozen=True)
class Case:
    """A scene of the chart: its name there, what it is made from, the norm that judges it."""

    name: str
    scene: str
    norm: str = "position"
    changes: dict[str, Any] = field(default_factory=dict)
    budget: float = 90.0


# In driven and in growing scenes single trajectories part when a contact forms a moment later: of
# `sorting` the median of the position error over the common times is judged, and of growth the
# radius of gyration: after two days positions differ by cell radii between any two methods.
EARLY = {"duration": "12 h"}
CASES = (
    Case("doublet", "doublet-settle"),
    Case("doublet, released at first contact", "doublet-settle", changes={"initial.spacing": 1.0}),
    Case("division-shock", "division-shock"),
    Case("settle-1000", "settle-1000"),
    Case("stiff-inclusions", "stiff-inclusions"),
    Case("settle-1000 in 2D", "settle-1000", changes={"dimensions": 2}),
    Case("sorting", "sorting", "position_median", {"duration": "1 h", "initial.count": 200}),
    Case("grow at 5 kPa s", "grow-2000", "gyration", EARLY | {"drag.viscosity": 5.0}),
    Case("grow at 0.5 kPa s", "grow-2000", "gyration", EARLY | {"drag.viscosity": 0.5}),
    Case("grow at 0.05 kPa s", "grow-2000", "gyration", EARLY | {"drag.viscosity": 0.05}, 150),
)


def file_name(case: Case) -> str:
    """Return the name of a case's picture."""
    words = "".join(c if c.isalnum() or c == "." else "-" for c in case.name.lower())
    return f"compare-{words.replace('.', '_').replace('--', '-')}.png"


def run(case: Case, quick: bool) -> WorkPrecision:
    """Compare all methods on a case and draw its picture."""
    scene = mc.load_scene(case.scene).with_changes(case.changes)
    share = 0.1 if quick else 1.0
    result = mc.compare(scene, budget=share * case.budget, patience=share * 20.0, repeats=2)
    result.figure(case.norm).savefig(HERE / "figures" / file_name(case), dpi=110)
    return result


def cell(row: dict[str, Any] | None) -> str:
    """Return method and time of a row of the table."""
    return "none" if row is None else f"{row['method']}, {1e3 * row['wall']:.3g} ms"


def line(case: Case, result: WorkPrecision) -> str:
    """Return one line of the table."""
    parts = [f"[{case.name}](figures/{file_name(case)})"]
    for error in (1e-2, 1e-3):
        within = result.within(error, case.norm)
        best = next(iter(within.values()), None)
        explicit = [r for m, r in within.items() if m in ("euler", "euler-adaptive", "rk4",
                    "heun", "ab2", "dopri5", "rkc2")]  # fmt: skip
        parts.append(cell(best))
        parts.append(cell(explicit[0] if explicit else None))
        for name in ("cvode", "auto", "euler"):
            row = within.get(name)
            parts.append("none" if row is None or best is None else
                         f"{row['wall'] / best['wall']:.2g}")  # fmt: skip
    return "| " + " | ".join(parts) + " |"


def write(lines: list[str]) -> None:
    """Put the table between its marks on the page."""
    head = [
        "| scene | 1 %: fastest | fastest explicit | cvode / fastest | auto / fastest "
        "| euler / fastest | 0.1 %: fastest | fastest explicit | cvode / fastest "
        "| auto / fastest | euler / fastest |",
        "|" + "---|" * 11,
    ]
    text = PAGE.read_text(encoding="utf-8")
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    table = "\n".join([*head, *lines])
    PAGE.write_text(f"{before}{BEGIN}\n\n{table}\n\n{END}{after}", encoding="utf-8")


def main() -> None:
    """Run the cases that are named, or all, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="*", help="names of cases; by default all")
    parser.add_argument("--quick", action="store_true", help="a tenth of the time")
    chosen = parser.parse_args()
    lines = []
    for case in CASES:
        if not chosen.cases or case.name in chosen.cases:
            result = run(case, chosen.quick)
            lines.append(line(case, result))
            print(lines[-1], flush=True)
    if not chosen.cases:
        write(lines)


if __name__ == "__main__":
    main()
