"""Error of single cells beside the conditioning of the coupling step, and how fast shifts grow.

Problem   consecutive coupling steps of grow-2000 at about 1,500 cells, each from the same recorded
          state for every method. The error of a step is that of its worst cell against the
          reference; beside it stands what a random shift of all positions by 0.01 µm does to the
          end, solved like the reference. Where a method is further off than that, it is the
          method; where it is not, trajectories tell nothing, and observables must. Each method
          is held against a shift of the size of its own tolerance.
Growth    μ, the largest eigenvalue of the Jacobian, at some times after the beginning of a step
Cost      printed; most of it is the reference
Command   python docs/conditioning.py            (--steps 50 --viscosities 5 0.5 0.05)

With --tables nothing is computed: the tables are printed from what is kept.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

import multicell as mc
from multicell.cells import Cells
from multicell.comparison.conditioning import SHIFT, shift_starts
from multicell.comparison.ladders import find_method
from multicell.comparison.norms import displacements
from multicell.comparison.reference import Reference, method_pair, reference
from multicell.comparison.replay import advance, replay
from multicell.mechanics.growth_rate import largest_growth_rate

HERE = Path(__file__).parent
VISCOSITIES = (5.0, 0.5, 0.05)
STEPS, COUNT = 50, 1500
METHODS = (("auto", 0.1), ("auto", 0.01), ("cvode", 0.01), ("rosenbrock", 0.01), ("rkc2", 0.1))
"""Methods with their absolute tolerance in µm."""
SHIFTS = (0.1,)
"""Further shifts, of the size of the methods' tolerances, µm; solved like the reference's check."""
REFERENCE = (("rkc2", 1e-5), ("dopri5", 1e-5))
"""Method and tolerance in µm of the reference, and of its check."""
AFTER = (0.0, 10.0, 60.0, 300.0)
"""Times after the beginning of a coupling step at which μ is taken, s."""
ASTRAY = 0.01
"""Part of a radius by which a cell is off that is called astray."""
PER_STEP = 13
"""About how many divisions a coupling step has at this number of cells."""
Row = dict[str, Any]


def grown(viscosity: float, steps: int) -> tuple[mc.Scene, Cells]:
    """Return the scene of the steps, and the cells from which they start."""
    scene = mc.load_scene("grow-2000").with_changes({"drag.viscosity": viscosity})
    first = max(COUNT - PER_STEP * steps // 2, scene.initial.count)
    simulation = mc.Simulation(scene)
    while len(simulation.cells) < first:
        simulation.step()
    changes = {"duration": steps * scene.coupling_step, "stop_cells": None}
    return scene.with_changes(changes), simulation.cells


def solved(viscosity: float, steps: int) -> Reference:
    """Return the steps with their reference and conditioning."""
    scene, cells = grown(viscosity, steps)
    radius = float(cells.radius.mean())
    pair = method_pair([(name, atol / radius) for name, atol in REFERENCE], scene, radius)
    return reference(scene, pair=pair, stepwise=steps, shift=SHIFT, cells=cells, cache=False)


def errors(exact: Reference, viscosity: float) -> list[Row]:
    """Return how far the shift and every method lead away, one row a step."""
    problem, known = exact.problem, exact.conditioning
    assert known is not None
    ends = [("shift", SHIFT, known.rms, known.worst_cell)]
    for shift in SHIFTS:
        solver = find_method("rkc2", problem.scene, problem.mean_radius).make(
            1e-4 / problem.mean_radius
        )
        found = replay(shift_starts(problem, shift), solver)
        ends.append(("shift", shift, *displacements(found.positions, exact.trajectory.positions)))
    for name, atol in METHODS:
        method = find_method(name, problem.scene, problem.mean_radius)
        found = replay(problem, method.make(atol / problem.mean_radius))
        if not found.done:
            raise SystemExit(f"{name} at {atol:g} µm and {viscosity:g} kPa·s: {found.problem}")
        ends.append((name, atol, *displacements(found.positions, exact.trajectory.positions)))
    return [
        {"viscosity_kPa_s": viscosity, "method": name, "tolerance_um": atol, "step": k,
         "cells": int(problem.counts[k]), "radius_um": problem.mean_radius,
         "rms_um": float(rms[k]), "worst_cell_um": float(worst[k])}
        for name, atol, rms, worst in ends
        for k in range(len(problem.steps))
    ]  # fmt: skip


def growth(exact: Reference, viscosity: float) -> list[Row]:
    """Return μ at the times of :data:`AFTER`, one row each for every step."""
    problem = exact.problem
    radius = problem.mean_radius
    solver = find_method("rkc2", problem.scene, radius).make(REFERENCE[0][1] / radius)
    rows = []
    for (k, step), after in product(enumerate(problem.steps), AFTER):
        system = problem.system()
        position = problem.beginning(k, problem.start)
        at = step.motion.begin + after
        if after > 0.0:
            system.begin(replace(step.motion, end=at))
            words, position = advance(system, solver, position)
            if words:
                raise SystemExit(words)
        system.begin(step.motion)
        found = largest_growth_rate(system, at, position)
        rows.append({"viscosity_kPa_s": viscosity, "step": k, "after_s": after,
                     "growth_rate_per_s": found.rate, "error_per_s": found.error,
                     "products": found.products})  # fmt: skip
    return rows


def chosen(rows: Iterable[Row], **wanted: Any) -> list[Row]:
    """Return the rows that have these values."""
    return [row for row in rows if all(row[name] == value for name, value in wanted.items())]


def error_table(rows: Sequence[Row]) -> str:
    """Return the table of the worst cell: median over the steps, and steps with one astray."""
    names = list(dict.fromkeys((row["method"], row["tolerance_um"]) for row in rows))
    head = ["viscosity / kPa·s", "steps", *(f"{name} {atol:g} µm" for name, atol in names)]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for viscosity in dict.fromkeys(row["viscosity_kPa_s"] for row in rows):
        here = chosen(rows, viscosity_kPa_s=viscosity)
        texts = []
        floors: dict[float, float] = {}
        for name, atol in names:
            of = chosen(here, method=name, tolerance_um=atol)
            worst = np.array([row["worst_cell_um"] for row in of])
            radius = of[0]["radius_um"]
            middle = float(np.median(worst))
            astray = int((worst > ASTRAY * radius).sum())
            text = f"{middle:.2g} µm, {100.0 * middle / radius:.2g} % ({astray})"
            if name == "shift":
                floors[atol] = middle
            elif atol in floors:
                text += f", {middle / floors[atol]:.2g} ×"
            texts.append(text)
        lines.append(f"| {viscosity:g} | {len(of)} | {' | '.join(texts)} |")
    return "\n".join(lines)


def growth_table(rows: Sequence[Row]) -> str:
    """Return the table of μ: median and largest over the steps, and steps where it is sure."""
    times = list(dict.fromkeys(row["after_s"] for row in rows))
    head = ["viscosity / kPa·s", *(f"μ after {after:g} s / (1/s)" for after in times)]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for viscosity in dict.fromkeys(row["viscosity_kPa_s"] for row in rows):
        texts = []
        for after in times:
            of = chosen(rows, viscosity_kPa_s=viscosity, after_s=after)
            rate, error = (
                np.array([row[name] for row in of]) for name in ("growth_rate_per_s", "error_per_s")
            )
            sure = int((rate > error).sum())
            texts.append(f"{np.median(rate):.2g}, up to {rate.max():.2g} ({sure} of {len(of)})")
        lines.append(f"| {viscosity:g} | {' | '.join(texts)} |")
    return "\n".join(lines)


def keep(path: Path, rows: Sequence[Row]) -> None:
    """Write rows as CSV."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def kept(path: Path) -> list[Row]:
    """Return rows from the CSV of an earlier run."""
    with path.open(encoding="utf-8", newline="") as file:
        return [
            {name: text if name == "method" else float(text) for name, text in row.items()}
            for row in csv.DictReader(file)
        ]


def main() -> None:
    """Solve the steps, keep what was found, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=STEPS, help="coupling steps (%(default)s)")
    parser.add_argument("--viscosities", type=float, nargs="+", default=VISCOSITIES, help="kPa s")
    parser.add_argument("--tables", action="store_true", help="compute nothing")
    parser.add_argument("--results", type=Path, default=HERE / "chart-data")
    given = parser.parse_args()
    paths = [given.results / f"{name}.csv" for name in ("conditioning", "growth-rate")]
    if given.tables:
        found, rates = (kept(path) for path in paths)
    else:
        found, rates = [], []
        for viscosity in given.viscosities:
            begin = time.perf_counter()
            exact = solved(viscosity, given.steps)
            took = time.perf_counter() - begin
            found += errors(exact, viscosity)
            rates += growth(exact, viscosity)
            cells = exact.problem.counts
            open_error = exact.uncertainty["worst_cell_median"] * exact.problem.mean_radius
            print(
                f"{viscosity:g} kPa·s: {cells[0]:,} to {cells[-1]:,} cells, reference "
                f"{exact.words} (radii): worst cell open to {open_error:.1e} µm in the median; "
                f"{took:.0f} s for it, {time.perf_counter() - begin:.0f} s in all",
                flush=True,
            )
        for path, rows in zip(paths, (found, rates), strict=True):
            keep(path, rows)
    print(f"\n{error_table(found)}\n\n{growth_table(rates)}")


if __name__ == "__main__":
    main()
