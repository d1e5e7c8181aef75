"""What `auto` expects of its candidates, what they cost, and how well it chooses.

Problem: single coupling steps of ten minutes from ``docs/tile_problems.py``: quiet, typical and
fresh tissue, of some numbers of cells, at λΔt from 10² to 10⁶. At each tolerance
all candidates are timed, an implicit one at the part of it that ``auto`` would give it. For each:
CPU milliseconds (the shortest of ``--repeats``), error of the worst cell in % of a radius,
evaluations, products, and the cost in evaluations that ``auto`` predicts. The last column is the
cost of the choice over that of the cheapest which is as exact (an error of at most three times
that of the choice).
Cost: about half a minute for 100 cells, ten minutes for 1,000; references are kept.
Command: python tests/benchmarks/calibrate_auto.py [--cells 100 1000] [--seeds 2] [--csv FILE]
"""

from __future__ import annotations

import argparse
import csv
import sys
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "docs"))

from tile_problems import STATES, Solved, Tile, solved

from multicell.comparison.ladders import find_method
from multicell.comparison.replay import replay
from multicell.integrators.adams_bashforth import AdaptiveAdams
from multicell.integrators.auto import CANDIDATES, Choice, choose

STIFFNESS = (1e2, 1e3, 1e4, 1e5, 1e6)
TOLERANCES = (0.1, 0.01, 0.001)
"""Absolute tolerances, µm."""
MOST_EVALUATIONS = 20_000
"""A candidate that is expected to need more is left out."""
AS_EXACT, NOTHING = 3.0, 1e-5
"""Errors that count as equal: their ratio, and in radii what no one asks for."""
Row = dict[str, Any]


def chosen(step: Solved, atol: float) -> tuple[Choice, float]:
    """Return what ``auto`` would choose, and what Adams-Bashforth expects after its first steps."""
    problem = step.problem
    system = problem.system()
    system.begin(problem.steps[0].motion)
    start = problem.beginning(0, problem.start)
    expected = AdaptiveAdams(1e-6, atol, 100_000, patience=1).attempt(system, start)[1]
    return choose(system, start, 1e-6, atol, expected), expected


def measured(step: Solved, atol: float, repeats: int) -> list[Row]:
    """Return a row for each candidate at a tolerance."""
    problem = step.problem
    choice, _ = chosen(step, atol)
    rows = []
    for name, predicted in choice.costs.items():
        if predicted > MOST_EVALUATIONS and name != choice.method:
            continue
        finer = choice.finer if CANDIDATES[name].info.implicit else 1.0
        method = find_method(name, problem.scene, problem.mean_radius)
        solver = method.make(finer * atol / problem.mean_radius)
        runs = [replay(problem, solver) for _ in range(repeats)]
        away = np.linalg.norm(runs[0].positions[0] - step.end, axis=1).max()
        rows.append({"method": name, "finer": finer, "ms": 1e3 * min(run.cpu for run in runs),
                     "error": float(away / problem.mean_radius), "predicted": predicted,
                     "evaluations": runs[0].work.evaluations,
                     "products": runs[0].work.jacobian_products})  # fmt: skip
    best = next(row for row in rows if row["method"] == choice.method)
    bound = max(AS_EXACT * best["error"], NOTHING)
    least = min(row["ms"] for row in rows if row["error"] <= bound)
    for row in rows:
        row["choice_over_best"] = best["ms"] / least if row is best else float("nan")
    return rows


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--cells", type=int, nargs="+", default=[20, 100])
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--csv", type=Path)
    given = parser.parse_args()
    rows: list[Row] = []
    seeds = range(1, given.seeds + 1)
    for n, seed, state, z in product(given.cells, seeds, STATES, STIFFNESS):
        step = solved(Tile(state, n, z, seed))
        for atol in TOLERANCES:
            print(f"\n{state}, {n} cells, z = {z:g}, seed {seed}, {atol:g} µm")
            for row in measured(step, atol, given.repeats):
                print(
                    f"  {row['method']:14}{row['ms']:9.2f} ms  error {100 * row['error']:8.2g} %  "
                    f"f {row['evaluations']:6}  Jv {row['products']:6}  "
                    f"predicted {row['predicted']:7.0f}  x {row['choice_over_best']:.2f}",
                    flush=True,
                )
                where = {"state": state, "cells": n, "z": z, "seed": seed, "atol_um": atol}
                rows.append({**where, **row})
    over = np.array([row["choice_over_best"] for row in rows])
    over = over[np.isfinite(over)]
    print(
        f"\nchoice over the cheapest that is as exact, {len(over)} cases: median "
        f"{np.median(over):.2f}, 90 % below {np.quantile(over, 0.9):.2f}, worst {over.max():.2f}"
    )
    if given.csv:
        with given.csv.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    main()
