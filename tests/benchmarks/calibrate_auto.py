"""What `auto` expects of its candidates, what they cost, and how well it chooses.

Problem: one interval of 600 s (360 s after division) of 100 to 5000 JKR cells, see
``tune_cvode.py``, in media from 5 to 0.005 kPa s, at tolerances of 0.01 and 0.0001 µm. For each
candidate: seconds (the shortest of ``--repeats`` runs after a warm-up), error against a run
with a thousandth of the tolerance, evaluations, and the cost in evaluations that ``auto``
predicts. The last line of a scene is ``auto`` itself, with its time over that of the fastest, and
over that of the fastest among those that are as exact: their error is at most three times its own.
Cost: about two minutes on one core.
Command: python tests/benchmarks/calibrate_auto.py [--repeats 3] [--scenes settle,thin] [--csv FILE]
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

import tune_cvode

from multicell.integrators.adams_bashforth import AdaptiveAdams
from multicell.integrators.auto import Auto, choose
from multicell.integrators.cvode import Cvode

CANDIDATES = ("ab2-adaptive", "dopri5", "rkc2", "cvode")
MOST_EVALUATIONS = 20_000
"""A candidate that is expected to need more is left out."""


def thinner(case, viscosity):
    case.viscosity = viscosity
    return case


def grown(n, viscosity, divided):
    return tune_cvode.settled(n, viscosity, 600.0, divided, 2.4e-5)


SCENES = {
    "settle": tune_cvode.SCENES["settle"],
    "settle 100 cells": lambda: tune_cvode.ball(100, 0.8, 5.0, 600.0),
    "settle 0.5 kPa s": lambda: tune_cvode.ball(1000, 0.8, 0.5, 600.0),
    "division": tune_cvode.SCENES["division"],
    "clump": tune_cvode.clump,
    "clump 0.05 kPa s": lambda: thinner(tune_cvode.clump(), 0.05),
    "inclusions": tune_cvode.inclusions,
    "inclusions 0.05 kPa s": lambda: thinner(tune_cvode.inclusions(), 0.05),
    "grown 2000, 0.5 kPa s": lambda: grown(2000, 0.5, 20),
    "grown 2000, 0.05 kPa s": lambda: grown(2000, 0.05, 20),
    "grown 2000, 0.005 kPa s": lambda: grown(2000, 0.005, 20),
    "grown 200, 0.05 kPa s": lambda: grown(200, 0.05, 2),
    "spheroid": tune_cvode.SCENES["spheroid"],
    "spheroid 0.5 kPa s": lambda: grown(5000, 0.5, 5),
    "spheroid 0.05 kPa s": lambda: grown(5000, 0.05, 5),
}


def expectation(case, atol):
    """Return how many evaluations Adams-Bashforth expects, told after its first steps."""
    impatient = AdaptiveAdams(1e-6, atol, 100_000, patience=1)
    return impatient.attempt(case.system(), case.position)[1]


def used(work):
    """Return the method that took most steps."""
    steps = {name: getattr(work, f"steps_{name.replace('-', '_')}") for name in CANDIDATES}
    return max(steps, key=steps.get)


def measure(case, method, repeats):
    """Return the shortest time, the end and the work."""
    times = []
    for _ in range(repeats + 1):
        system = case.system()
        begin = time.perf_counter()
        outcome = method.integrate(system, case.position)
        times.append(time.perf_counter() - begin)
        if times[-1] > 1.0:
            break
    return min(times[1:] or times), outcome, system.work


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--scenes", default=",".join(name.split(",")[0] for name in SCENES))
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--csv", type=Path)
    given = parser.parse_args()
    wanted = given.scenes.split(",")
    rows = [["scene", "atol_um", "stiffness", "method", "s", "error_um", "steps",
             "evaluations", "predicted", "over_fastest", "over_as_exact"]]  # fmt: skip
    ratios, fair = [], []
    for name, make in SCENES.items():
        if not any(name.startswith(part) for part in wanted):
            continue
        case = make()
        for atol in (1e-2, 1e-4):
            expected = expectation(case, atol)
            choice = choose(case.system(), case.position, 1e-6, atol, expected)
            tight = Cvode(1e-10, 1e-3 * atol, 10**6)
            exact = tight.integrate(case.system(), case.position).position
            print(f"\n{name}: {len(case.radius)} cells, atol {atol:g}, z = {choice.stiffness:.3g}")
            auto = Auto(1e-6, atol, 100_000)
            done = []
            for method in (*CANDIDATES, "auto"):
                predicted = choice.costs.get(method, min(choice.costs.values()))
                if method == "ab2-adaptive":
                    predicted = expected
                if predicted > MOST_EVALUATIONS:
                    continue
                runner = auto if method == "auto" else auto.method(method)
                seconds, outcome, work = measure(case, runner, given.repeats)
                error = np.square(outcome.position - exact).sum(axis=1).mean() ** 0.5
                done.append((seconds, error))
                over = seconds / min(s for s, _ in done)
                as_exact = seconds / min(s for s, e in done if e <= 3.0 * error)
                label = f"auto ({used(work)})" if method == "auto" else method
                print(f"  {label:14}{seconds:9.4f} s  error {error:8.1e}  steps {work.steps:5} "
                      f"f {work.evaluations:6}  predicted {predicted:7.0f}  x {over:.2f} "
                      f"{as_exact:.2f}",
                      outcome.problem, flush=True)  # fmt: skip
                rows.append([name, atol, f"{choice.stiffness:.4g}", label, f"{seconds:.4f}",
                             f"{error:.2e}", work.steps, work.evaluations, f"{predicted:.0f}",
                             f"{over:.2f}", f"{as_exact:.2f}"])  # fmt: skip
            ratios.append(over)
            fair.append(as_exact)
    for what, found in (("the fastest", ratios), ("the fastest that is as exact", fair)):
        print(f"auto over {what}: median {np.median(found):.2f}, worst {max(found):.2f}")
    if given.csv:
        with given.csv.open("w", newline="") as file:
            csv.writer(file).writerows(rows)


if __name__ == "__main__":
    main()
