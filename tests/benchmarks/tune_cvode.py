"""What each part of the tuning of ``cvode`` brings, scene by scene.

Problem: six scenes of JKR cells (radius 5 µm, E 1 kPa, σ 0.1 nN/µm, ν ½) over one interval:
``settle``, a jittered ball of 1000 cells at 0.8 of their diameter settles for 600 s;
``division``, 2 % of 1000 settled cells have just divided, 360 s; ``inclusions``, ``settle``
with 1 % of the cells 1000 times stiffer, 600 s; ``clump``, with its ten innermost cells so;
``thin``, 2000 settled cells that grow, 1 % just
divided, in a medium of 0.05 kPa s, 600 s; ``spheroid``, 5000 settled cells that grow, 5
just divided, at 5 kPa s, 600 s. The error is the root mean square distance of the cells from
a run with a ten-thousandth of the tolerance; where contacts form and break in the thousands
(``inclusions``, ``thin``) it says little more than that both found a pocket to settle in.
Each row is a warm-up and the shortest of ``--repeats`` runs.
Cost: about two minutes on one core. The times leave out setting up the problem.
Command: python tests/benchmarks/tune_cvode.py
    [--scenes settle,thin] [--atol 0.01] [--csv FILE]
docs/theory/integrators.md has what was found.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from sksundae.cvode import CVODE

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))

from strategies import cluster, divided

from multicell import JKR
from multicell.integrators.base import Outcome
from multicell.integrators.cvode import Cvode
from multicell.mechanics import neighbours
from multicell.mechanics.motion import Motion
from multicell.mechanics.system import Mechanics

LAW = JKR(surface_energy=0.1)
ATTEMPT = Cvode(rtol=1e-6, max_steps=20_000)


@dataclass
class Case:
    position: np.ndarray
    radius: np.ndarray
    young: np.ndarray
    rate: np.ndarray
    viscosity: float
    duration: float

    def system(self, law=LAW):
        system = Mechanics(law, self.viscosity)
        half = np.full(len(self.radius), 0.5)
        system.begin(Motion(self.radius, self.rate, self.young, half, 0.0, self.duration))
        return system


def ball(n, spacing, viscosity, duration):
    position, radius, young = cluster(n, 1, spacing=spacing)
    order = neighbours.spatial_order(position, 10.0)
    return Case(position[order], radius[order], young[order], np.zeros(n), viscosity, duration)


def settled(n, viscosity, duration, number, growth):
    """Return a ball at rest in which the first of a random order of cells have divided."""
    case = ball(n, 0.88, 0.5, 2000.0)
    position = Cvode(atol=1e-2).integrate(case.system(), case.position).position
    mothers = np.random.default_rng(2).permutation(n)[:number]
    position, radius, young = divided(position, case.radius, case.young, mothers, 3)
    order = neighbours.spatial_order(position, 10.0)
    rate = np.full(len(order), growth)
    return Case(position[order], radius[order], young[order], rate, viscosity, duration)


def inclusions(innermost):
    """Return ``settle`` with ten cells 1000 times stiffer, at random or the innermost."""
    case = ball(1000, 0.8, 5.0, 600.0)
    order = np.random.default_rng(4).permutation(1000)
    if innermost:
        order = np.argsort(np.square(case.position).sum(axis=1), kind="stable")
    case.young[order[:10]] *= 1000.0
    return case


SCENES = {
    "settle": lambda: ball(1000, 0.8, 5.0, 600.0),
    "division": lambda: settled(1000, 5.0, 360.0, 20, 0.0),
    "inclusions": lambda: inclusions(False),
    "clump": lambda: inclusions(True),
    "thin": lambda: settled(2000, 0.05, 600.0, 20, 2.4e-5),
    "spheroid": lambda: settled(5000, 5.0, 600.0, 5, 2.4e-5),
}


@dataclass
class Defaults:
    """Scikit-sundae as it comes: GMRES of dimension 5, difference quotients."""

    atol: float = 1e-2

    def integrate(self, system, position):
        def velocity(t, y, out):
            system.velocity(t, y.reshape(-1, 3), out.reshape(-1, 3))

        solver = CVODE(
            velocity, rtol=1e-6, atol=self.atol, linsolver="gmres", max_num_steps=100_000
        )
        result = solver.solve([0.0, system.motion.end], position.ravel())
        system.work.steps = result.t.size
        return Outcome(system.motion.end, result.y[-1].reshape(-1, 3))


def variants(atol):
    """Return the rows of the table: what is changed, the method, and the law."""
    base = replace(ATTEMPT, atol=atol)
    full = replace(base, light=False)
    rows = [
        ("scikit-sundae as it comes", Defaults(atol), LAW),
        ("cvode", base, LAW),
        ("cvode without its light start", full, LAW),
    ]
    changes = {
        "preconditioner": ["none", "blocks", "incomplete", "gauss-seidel"],
        "side": ["left", "both"],
        "krylov_dim": [3, 5, 12, 20],
        "refresh": ["asked"],
        "far": [0.001, 0.01, 0.05],
        "max_order": [1, 2, 3],
        "newton": [4, 6],
        "softening": [0.1, 1.0, np.inf],
    }
    for name, values in changes.items():
        for value in values:
            if value != getattr(base, name):
                rows.append((f"{name} {value}", replace(full, **{name: value}), LAW))
    smooth = JKR(surface_energy=0.1, smoothing=0.5)
    rows.append(("smoothing 0.5 um (another model)", base, smooth))
    return rows


def measure(case, method, law, repeats, reference):
    best, outcome, work = np.inf, None, None
    for k in range(repeats + 1):
        system = case.system(law)
        begin = time.perf_counter()
        outcome = method.integrate(system, case.position)
        seconds = time.perf_counter() - begin
        best = min(best, seconds) if k else best
        work = system.work
    moved = np.square(outcome.position - reference).sum(axis=1).mean() ** 0.5
    error = moved if outcome.done and law is LAW else np.nan
    return best, error, work


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--scenes", default=",".join(SCENES))
    parser.add_argument("--atol", type=float, default=1e-2)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--only", default="", help="rows whose name contains this")
    parser.add_argument("--csv", type=Path)
    given = parser.parse_args()
    table = [["scene", "variant", "s", "error_um", "steps", "rejections", "evaluations",
              "linearisations", "products", "setups", "solves", "lists"]]  # fmt: skip
    for name in given.scenes.split(","):
        case = SCENES[name]()
        tight = Cvode(rtol=1e-10, atol=1e-4 * given.atol, max_steps=10**6)
        reference = tight.integrate(case.system(), case.position).position
        print(f"\n{name}: {len(case.radius)} cells, {case.duration:g} s, atol {given.atol:g} um")
        print(f"{'':34}{'s':>8}{'error':>9}{'steps':>6}{'f':>6}{'J':>6}{'Jv':>6}{'P':>5}")
        for label, method, law in variants(given.atol):
            if given.only and not any(part in label for part in given.only.split(",")):
                continue
            seconds, error, w = measure(case, method, law, given.repeats, reference)
            print(f"{label:34}{seconds:8.4f}{error:9.1e}{w.steps:6}{w.evaluations:6}"
                  f"{w.linearisations:6}{w.jacobian_products:6}{w.preconditioner_setups:5}",
                  flush=True)  # fmt: skip
            table.append(
                [name, label, f"{seconds:.4f}", f"{error:.2e}", w.steps, w.rejections,
                 w.evaluations, w.linearisations, w.jacobian_products, w.preconditioner_setups,
                 w.preconditioner_solves, w.list_builds]
            )  # fmt: skip
    if given.csv:
        with given.csv.open("w", newline="") as file:
            csv.writer(file).writerows(table)


if __name__ == "__main__":
    main()
