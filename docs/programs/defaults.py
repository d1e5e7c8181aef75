"""Methods and tolerances that change no observable: defaults of the built-in scenes from evidence.

Problem   every built-in scene, shortened where it would take long, grow-2000 at three
          viscosities; each with several seeds, the same for all candidates
Question  by how much a method and its tolerance change what a run is made for, beside auto at
          0.001 µm, in units of the scatter over the seeds
Verdict   the default is the cheapest candidate that changes no observable by more than a tenth of
          its scatter, as far as the seeds can tell: paired differences have an error of their own,
          because trajectories part, and it is printed beside them
Cost      printed at the beginning; one thread (--share 1/2 and --share 2/2 for two processes)
Command   python docs/programs/defaults.py                (--scenes, --candidates auto:0.1, --seeds)

What is done is kept in docs/chart-data and not computed again. With --tables nothing is computed.
"""

from __future__ import annotations

import argparse
import csv
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any, final

import numpy as np
from defaults_tables import candidate_table, default_table

import multicell as mc
from multicell.comparison.base import Row
from multicell.errors import MulticellError
from multicell.integrators import registry
from multicell.tables.text import table_text

DOCS = Path(__file__).parents[1]
RICH = str(DOCS / "rich-medium.toml")
NAME = "defaults"
SEEDS = 8
REFERENCE = ("auto", 0.001)
CANDIDATES = (
    ("auto", 1.0), ("auto", 0.3), ("auto", 0.1), ("auto", 0.03), ("auto", 0.01),
    ("cvode", 0.01), ("cvode", 0.001), ("rkc2", 0.1),
)  # fmt: skip
"""Methods with their absolute tolerance in µm."""
FAILED = "failed"


@final
@dataclass(frozen=True)
class Case:
    """A scene as it is run here; ``seconds`` is about what one run takes on 2.5 GHz."""

    name: str
    scene: str
    changes: dict[str, Any] = field(default_factory=dict)
    seconds: float = 2.0


def _growing(viscosity: float, seconds: float) -> Case:
    changes = {"drag.viscosity": viscosity, "stop_cells": 700}
    return Case(f"grow-2000 to 700 cells, {viscosity:g} kPa·s", "grow-2000", changes, seconds)


CASES = (
    Case("doublet", "doublet", {}, 1.4),
    Case("doublet-settle", "doublet-settle", {}, 0.1),
    Case("settle", "settle", {}, 0.1),
    Case("settle-1000", "settle-1000", {}, 0.1),
    Case("stiff-inclusions", "stiff-inclusions", {}, 0.1),
    Case("division-shock", "division-shock", {}, 0.1),
    Case("growth, 3.5 d", "growth", {"duration": "3.5 d"}, 0.5),
    _growing(5.0, 1.0),
    _growing(0.5, 2.6),
    _growing(0.05, 4.7),
    Case("sorting, 3 h", "sorting", {"duration": "3 h"}, 0.9),
    Case("sorting-cams, 3 h, sticky from the start", "sorting-cams",
         {"duration": "3 h", "types.sticky.receptor": 4.0, "types.sticky.ligand": 4.0}, 0.7),
    Case("chemotaxis, 3 h", "chemotaxis", {"duration": "3 h"}, 0.4),
    Case("spheroid, 5 d", "spheroid", {"duration": "5 d"}, 2.6),
    Case("emt6, 12 h", RICH, {"duration": "12 h"}, 0.8),
    Case("treatment, 2 d", "treatment", {"duration": "2 d"}, 1.0),
    Case("monolayer, 4 d", "monolayer", {"duration": "4 d"}, 1.1),
)  # fmt: skip


def observables(simulation: mc.Simulation) -> dict[str, float]:
    """Return the main observables of a run at its end; absent ones are left out.

    Number of cells and of proliferating ones, radius of the uniform ball or disc (µm), its
    elongation (largest over smallest root mean square extent), mean pressure (kPa), packing,
    necrotic radius (µm), contacts between unlike cells, the place of the centroid that chemotaxis
    moves (µm), and load and time at which two cells part.
    """
    row, cells, scene = simulation.history_row(), simulation.cells, simulation.scene
    found = {"radius": 0.5 * row["diameter"], "pressure": float(cells.pressure.mean())}
    if simulation.divisions or scene.growth is not None:
        found |= {name: row[name] for name in ("cells", "proliferating")}
    if len(cells) > scene.dimensions:
        extent = cells.position[:, : scene.dimensions]
        spread = np.linalg.eigvalsh(np.cov(extent.T))
        found["elongation"] = math.sqrt(spread[-1] / max(spread[0], 1e-30))
        found["packing"] = row["packing_ratio"]
    if scene.death is not None:
        found["necrotic radius"] = row["necrotic_radius"]
    if scene.chemotaxis:
        found["centroid"] = float(cells.position[:, 0].mean())
    if "heterotypic_fraction" in row:
        found["unlike contacts"] = row["heterotypic_fraction"]
    if simulation.separation is not None:
        found |= {"parting load": simulation.separation["force"],
                  "parting time": simulation.separation["time"]}  # fmt: skip
    return {name: float(value) for name, value in found.items() if math.isfinite(value)}


def run(case: Case, candidate: tuple[str, float], seed: int) -> list[Row]:
    """Run a scene to its end; return one row an observable, or one that names a failure."""
    scene = mc.load_scene(case.scene)
    method, atol = candidate
    changes = {"seed": scene.seed + seed, "integrator.method": method, "integrator.atol": atol}
    scene = scene.with_changes({**case.changes, **changes})
    begin = time.process_time()
    problem = ""
    try:
        simulation = mc.Simulation(
            scene, threads=1, integrator=registry.from_options(scene.integrator)
        )
        while not simulation.finished and len(simulation.cells):
            simulation.step()
    except MulticellError as error:
        problem = str(error)
    cost = time.process_time() - begin
    first = {"case": case.name, "method": method, "atol_um": atol, "seed": seed, "cpu_s": cost}
    if problem:
        print(f"{case.name}, {method} {atol:g}: {problem}", flush=True)
        return [{**first, "observable": FAILED, "value": math.nan}]
    return [{**first, "observable": n, "value": v} for n, v in observables(simulation).items()]


def kept(folder: Path) -> list[Row]:
    """Return all rows of earlier runs, shares included; of two the later one."""
    found: dict[tuple[Any, ...], Row] = {}
    words = ("case", "method", "observable")
    for path in sorted(folder.glob(f"{NAME}*.csv")):
        with path.open(encoding="utf-8", newline="") as file:
            for texts in csv.DictReader(file):
                row: Row = {n: t if n in words else float(t) for n, t in texts.items()}
                row["seed"] = int(row["seed"])
                keys = ("case", "method", "atol_um", "seed", "observable")
                found[tuple(row[name] for name in keys)] = row
    names = [case.name for case in CASES]
    rows = [found[key] for key in sorted(found)]
    return sorted(rows, key=lambda row: names.index(row["case"]) if row["case"] in names else 99)


def keep(path: Path, rows: Sequence[Row]) -> None:
    """Append rows to a table."""
    path.parent.mkdir(parents=True, exist_ok=True)
    text = table_text([{**row, "cpu_s": float(f"{row['cpu_s']:.4g}")} for row in rows])
    if path.exists():
        text = text.partition("\n")[2]
    with path.open("a", encoding="utf-8", newline="") as file:
        file.write(text)


def merge(folder: Path) -> list[Row]:
    """Write one table of all rows, and remove those of shares."""
    rows = kept(folder)
    if rows:
        partial = folder / f"{NAME}.part"
        partial.write_text(table_text(rows), encoding="utf-8")
        partial.replace(folder / f"{NAME}.csv")
        for path in folder.glob(f"{NAME}.*-of-*.csv"):
            path.unlink()
    return rows


def compute(given: argparse.Namespace) -> None:
    """Run what is missing, the candidates of a scene and a seed in turns."""
    index, count = given.share
    candidates = list(dict.fromkeys([REFERENCE, *given.candidates]))
    cases = [case for case in CASES if not given.scenes or case.scene in given.scenes]
    rows = kept(given.results)
    done = {(row["case"], row["method"], row["atol_um"], row["seed"]) for row in rows}
    ahead = []
    for k, (seed, case) in enumerate(product(range(given.seeds), cases)):
        # in another order for every seed: none is always the first one after a pause
        turn = (seed + k) % len(candidates)
        turned = [*candidates[turn:], *candidates[:turn]]
        if k % count == index - 1:
            ahead += [(case, c, seed) for c in turned if (case.name, *c, seed) not in done]
    total = sum(case.seconds for case, _, _ in ahead)
    print(f"{len(ahead)} runs to do, about {total / 60.0:.0f} min of CPU", flush=True)
    name = f"{NAME}.{index}-of-{count}.csv" if count > 1 else f"{NAME}.csv"
    begin = time.perf_counter()
    warm: set[tuple[str, str]] = set()
    for k, (case, candidate, seed) in enumerate(ahead):
        if time.perf_counter() - begin > 60.0 * given.budget_minutes:
            print(f"time is over: {len(ahead) - k} runs are left")
            return
        kind = (case.scene, candidate[0])
        if kind not in warm:
            _compile(case, candidate)
            warm.add(kind)
        new = run(case, candidate, seed)
        keep(given.results / name, new)
        print(
            f"{k + 1}/{len(ahead)} {case.name}, {candidate[0]} {candidate[1]:g} µm, seed {seed}: "
            f"{new[0]['cpu_s']:.2f} s",
            flush=True,
        )


def _compile(case: Case, candidate: tuple[str, float]) -> None:
    """Compile and load what a scene and a method need: two coupling steps."""
    scene = mc.load_scene(case.scene).with_changes(
        {**case.changes, "integrator.method": candidate[0], "integrator.atol": candidate[1]}
    )
    simulation = mc.Simulation(scene, threads=1)
    for _ in range(2):
        simulation.step()


def _candidate(text: str) -> tuple[str, float]:
    method, _, atol = text.rpartition(":")
    try:
        return method, float(atol)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is not like auto:0.1") from error


def _share(text: str) -> tuple[int, int]:
    index, _, count = text.partition("/")
    if not (index.isdecimal() and count.isdecimal() and 1 <= int(index) <= int(count)):
        raise argparse.ArgumentTypeError(f"{text!r} is not like 1/2")
    return int(index), int(count)


def main() -> None:
    """Run what is missing and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", nargs="+", default=[], help="built-in names; by default all")
    parser.add_argument("--candidates", "--methods", type=_candidate, nargs="+",
                        default=CANDIDATES, help="like auto:0.1, tolerance in µm")  # fmt: skip
    parser.add_argument("--seeds", type=int, default=SEEDS, help="number of seeds (%(default)s)")
    parser.add_argument("--share", type=_share, default=(1, 1), help="part of the work, like 1/2")
    parser.add_argument("--budget-minutes", type=float, default=math.inf)
    parser.add_argument("--tables", action="store_true", help="compute nothing")
    parser.add_argument("--results", type=Path, default=DOCS / "chart-data")
    given = parser.parse_args()
    if not given.tables:
        compute(given)
    if given.tables or given.share[1] == 1:
        rows = merge(given.results)
        if not rows:
            raise SystemExit("nothing is computed yet")
        print(f"\n{candidate_table(rows, REFERENCE)}\n\n{default_table(rows, REFERENCE)}")


if __name__ == "__main__":
    main()
