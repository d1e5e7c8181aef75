"""Regenerate the charts and the table of the scenes in docs/which-integrator.md.

Problem   the scenes of the chart, each with all methods that can hold it, beside CVODE as
          scikit-sundae sets it up; growing and driven scenes are compared step by step
Cost      about half an hour on a core (the budgets are printed); --quick takes a tenth
Command   python docs/which_integrator.py            (or with names of cases: settle-1000 ...)

Each case that is finished is kept as CSV and JSON in docs/chart-data, and is not computed again
unless it, the sources or the options have changed: an interrupted chart goes on where it was.
With --tables nothing is computed: the page is written from what is kept, whatever made it.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, final

import numpy as np
from which_integrator_tables import Entry, write_page

import multicell as mc
from multicell.comparison.cache import source_hash
from multicell.comparison.ladders import SMALLEST_TOLERANCE, Method
from multicell.comparison.result import WorkPrecision
from multicell.integrators.base import MethodInfo, Outcome
from multicell.integrators.registry import METHODS

HERE = Path(__file__).parent
QUICK = 0.1


@final
@dataclass(frozen=True)
class Case:
    """A scene of the chart: its name there, what it is made from, the time it may take.

    The budget is for the methods, in s; states and reference come on top. ``stepwise`` is the
    number of coupling steps that are compared one by one, 0 for the whole run.
    """

    name: str
    scene: str
    changes: dict[str, Any] = field(default_factory=dict)
    budget: float = 60.0
    stepwise: int = 0

    @property
    def title(self) -> str:
        """The name as the heading of a chart."""
        return self.name[0].upper() + self.name[1:].replace("kPa s", "kPa·s")

    @property
    def slug(self) -> str:
        """The name in names of files."""
        words = "".join(c if c.isalnum() else "-" for c in self.name.lower())
        return "-".join(part for part in words.split("-") if part)


FLAT = {"dimensions": 2}
STEPWISE = {
    # step by step cells have moved little when a step ends: finer tolerances tell no more
    "ladder": {
        "tolerance": [10.0 ** (-0.5 * k) for k in range(2, 10)],
        # takes so long on these scenes that its budget must not go where it misses 1 %
        "sundials-defaults": [1e-2, 1e-3, 1e-4],
    },
    # tighter ones would take longer than all that is compared
    "references": [("rkc2", 1e-6), ("dopri5", 1e-6)],
    "repeats": 2,
}
"""How single steps are compared."""
FEW = (
    "auto", "cvode", "cvode-adams", "rosenbrock", "rkc2", "dopri5", "ab2-adaptive", "ab2", "euler",
    "rk4", "multirate-euler",
)  # fmt: skip
"""Methods that are compared on single steps of large populations."""
OTHERS = (
    Case("growth at 1.5 kPa s", "growth", {"drag.viscosity": 1.5}, 150, 24),
    Case("monolayer", "monolayer", {"duration": "6 d"}, 150, 24),
    Case("emt6", str(HERE / "rich-medium.toml"), {"duration": "12 h"}, 200, 12),
)
"""Scenes by which nothing in `auto` was chosen."""
CASES = (
    Case("doublet", "doublet-settle", budget=20),
    Case("doublet, released at first contact", "doublet-settle", {"initial.spacing": 1.0}, 20),
    Case("division-shock", "division-shock", budget=40),
    Case("settle-1000", "settle-1000", budget=40),
    Case("stiff-inclusions", "stiff-inclusions", budget=60),
    Case("grow-2000 at 5 kPa s", "grow-2000", {"drag.viscosity": 5.0}, 150, 24),
    Case("grow-2000 at 0.5 kPa s", "grow-2000", {"drag.viscosity": 0.5}, 250, 24),
    Case("grow-2000 at 0.05 kPa s", "grow-2000", {"drag.viscosity": 0.05}, 250, 12),
    Case("sorting", "sorting", {}, 200, 24),
    Case("spheroid to 5000 cells", "spheroid", {"stop_cells": 5000}, 200, 24),
    Case("division-shock in 2D", "division-shock", FLAT, 30),
    Case("settle-1000 in 2D", "settle-1000", FLAT, 30),
    Case("sorting in 2D", "sorting", FLAT, 100, 24),
    Case("grow-2000 in 2D at 0.5 kPa s", "grow-2000", FLAT | {"drag.viscosity": 0.5}, 120, 24),
    *OTHERS,
)


@final
@dataclass(frozen=True)
class SundialsDefaults:
    """CVODE as scikit-sundae sets it up with GMRES: dimension 5, products by differences."""

    rtol: float
    atol: float

    def integrate(self, system: Any, position: np.ndarray) -> Outcome:
        """Integrate over the coupling step of ``system``."""
        from sksundae.cvode import CVODE

        motion = system.motion

        def velocity(t: float, y: np.ndarray, out: np.ndarray) -> None:
            # SUNDIALS may look a rounding error beyond the end
            at = min(motion.begin + t, motion.end)
            system.velocity(at, y.reshape(-1, 3), out.reshape(-1, 3))

        solver = CVODE(
            velocity, rtol=self.rtol, atol=self.atol, linsolver="gmres", max_num_steps=1_000_000
        )
        length = motion.end - motion.begin
        solver.init_step(0.0, np.array(position).ravel())
        result = solver.step(length, method="normal", tstop=length)
        problem = "" if result.success else f"SUNDIALS: {result.message}"
        return Outcome(motion.end, np.array(result.y).reshape(-1, 3), problem)


LOOKS = MethodInfo("sundials-defaults", implicit=True, colour="#6d8441", marker="H", outside=True)


def sundials_defaults(radius: float) -> Method:
    """Return the method under the tolerances of all others, for cells of a mean radius in µm."""

    def make(tolerance: float) -> SundialsDefaults:
        return SundialsDefaults(max(0.01 * tolerance, SMALLEST_TOLERANCE), tolerance * radius)

    return Method("sundials-defaults", "tolerance", make, LOOKS)


def compared(
    case: Case, share: float, clock: str, tell: Callable[[str], None] | None
) -> WorkPrecision:
    """Compare all methods on a case."""
    scene = mc.load_scene(case.scene).with_changes({"title": case.title, **case.changes})
    radius = float(mc.Simulation(scene).cells.radius.mean())
    return mc.compare(
        scene,
        [*(FEW if case.stepwise else METHODS), sundials_defaults(radius)],
        stepwise=case.stepwise or False,
        clock=clock,
        budget=share * case.budget,
        # a method that is hopeless here must not eat up the time of the others
        patience=share * case.budget / 15.0,
        progress=tell,
        **(STEPWISE if case.stepwise else {"repeats": 5}),
    )


def kept(case: Case, folder: Path, made_with: dict[str, Any] | None) -> Entry | None:
    """Return the entry of an earlier run; None if there is none, or one of something else."""
    path = folder / f"{case.slug}.json"
    if not path.exists():
        return None
    held = json.loads(path.read_text(encoding="utf-8"))
    if made_with is not None and held["made_with"] != made_with:
        return None
    result = WorkPrecision.from_json(json.dumps(held["result"]))
    return Entry(case.name, case.slug, result, held["took"])


def computed(
    case: Case,
    folder: Path,
    made_with: dict[str, Any],
    share: float,
    tell: Callable[[str], None] | None,
) -> Entry:
    """Compare on a case and keep the table, with what it was made with, and its chart."""
    begin = time.perf_counter()
    result = compared(case, share, made_with["clock"], tell)
    took = time.perf_counter() - begin
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{case.slug}.csv").write_text(result.to_csv(), encoding="utf-8")
    held = {"made_with": made_with, "took": took, "result": json.loads(result.to_json())}
    partial = folder / f"{case.slug}.part"
    partial.write_text(json.dumps(held), encoding="utf-8")
    partial.replace(folder / f"{case.slug}.json")
    return Entry(case.name, case.slug, result, took)


def entries(cases: list[Case], given: argparse.Namespace) -> Iterator[Entry]:
    """Give the entry of each case, from the folder where it is kept or computed now."""
    share = QUICK if given.quick else 1.0
    source = source_hash()
    for case in cases:
        made_with = {"case": asdict(case), "share": share, "clock": given.clock, "source": source}
        entry = kept(case, given.results, None if given.tables else made_with)
        if entry is not None:
            print(f"{case.name}: kept, took {entry.took:.0f} s", flush=True)
        elif given.tables:
            print(f"{case.name}: not computed yet", flush=True)
            continue
        else:
            entry = computed(case, given.results, made_with, share, say if given.verbose else None)
            print(f"{case.name}: {entry.took:.0f} s", flush=True)
        # of sampled steps the median is drawn: the worst one hangs on a contact that forms or not
        figure = entry.result.figure(entry.norm)
        figure.savefig(given.figures / f"compare-{case.slug}.png", dpi=110)
        yield entry


def say(text: str) -> None:
    """Print a line with the time of day."""
    print(time.strftime("%H:%M:%S"), text, flush=True)


def main() -> None:
    """Run the cases that are named, or all, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="*", help="names of cases; by default all")
    parser.add_argument("--quick", action="store_true", help="a tenth of the time")
    parser.add_argument("--verbose", action="store_true", help="name every solve")
    parser.add_argument("--clock", choices=["cpu", "wall"], default="cpu", help="what judges")
    parser.add_argument("--tables", action="store_true", help="compute nothing")
    parser.add_argument("--results", type=Path, default=HERE / "chart-data")
    parser.add_argument("--figures", type=Path, default=HERE / "figures")
    parser.add_argument("--page", type=Path, default=HERE / "which-integrator.md")
    given = parser.parse_args()
    names = [case.name for case in CASES]
    for name in given.cases:
        if name not in names:
            parser.error(f"no case is called {name!r}: choose from {', '.join(names)}")
    chosen = [case for case in CASES if not given.cases or case.name in given.cases]
    share = QUICK if given.quick else 1.0
    budget = share * sum(case.budget for case in chosen)
    print(f"{len(chosen)} cases, {budget / 60.0:.1f} min for the methods, and the references")
    given.figures.mkdir(parents=True, exist_ok=True)
    found = list(entries(chosen, given))
    print(f"took {sum(entry.took for entry in found) / 60.0:.1f} min in all")
    write_page(found, None if given.cases else given.page)


if __name__ == "__main__":
    main()
