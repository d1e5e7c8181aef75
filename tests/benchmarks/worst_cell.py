"""Is the worst cell of a coupling step off by more than what nobody can know of its start?

Problem   consecutive coupling steps (10 min) of few cells that grow and divide, each from its own
          recorded state, at four viscosities: approximate and exact JKR, cubic springs, friction
          between cells, cells of unlike sizes and of unlike stiffness, a box and a sphere with
          elastic walls, a plane, cells that move by themselves, packed and loose, and cells with
          adhesion molecules
Truth     SciPy's DOP853 at a relative tolerance of 1e-10 (some 1e-9 µm), 1e-7 from shifted
          starts, on a right-hand side in NumPy written out here; it shares no code with the
          package. Below 1 kPa·s LSODA solves the same equations (1e-6 from shifted starts) with a
          Jacobian in NumPy, at a tenth of the cost; --check compares it with DOP853 in the first
          step of each case
Ratio     error of the worst cell of a method at its default tolerance, over the conditioning of
          the step: the largest displacement at the end, in the truth, that normal random shifts
          of all start coordinates by 0.01 µm cause, or by the tolerance if that is larger; the
          largest of twelve shifts, since one alone may by chance do a thirtieth of another (of
          fewer, where that exceeds the error: then the ratio is an upper bound, below 1)
Measured  steps, largest ratio and the error in µm there, 95th percentile, steps with a ratio above
          3, and above 3 where the shift is 0.01 µm for all; worst error in µm; the summed effort in
          evaluations
Cost      printed; some 10 to 40 s of CPU for the 20 steps of a run, nearly all of it the truth
Command   python tests/benchmarks/worst_cell.py --results FOLDER    (--quick: 6 steps of 3 cases)

What is in FOLDER is not measured again: ``worst-cell.csv`` has a row for each step and method,
``truth`` the solutions. ``--again METHOD`` drops the rows of a method that has changed.
"""

from __future__ import annotations

import argparse
import csv
import math
import os
import time
from dataclasses import replace
from itertools import product
from pathlib import Path

# dense matrices of some hundred rows gain nothing from threads
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.integrate import solve_ivp
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

import multicell as mc
from multicell.comparison.conditioning import shift_starts
from multicell.comparison.record import record
from multicell.comparison.replay import advance_system
from multicell.integrators.registry import METHODS, from_options
from multicell.integrators.rkc import Rkc2
from multicell.scene.parts import IntegratorOptions

CASES = {
    "growing": {},
    "exact JKR": {"contact.law": "exact-jkr"},
    "springs": {"contact": {"law": "cubic"}},
    "friction": {"friction.normal": 0.1, "friction.tangential": 0.1},
    "unlike sizes": {},
    "box": {f"domain.{axis}": ["-17 um", "17 um"] for axis in "xyz"},
    "plane": {"dimensions": 2},
    "motile": {"motility.force": 0.8, "motility.persistence": 600.0},
    "loose motile": {
        "motility.force": 0.1, "motility.persistence": 600.0, "initial.spacing": 1.3,
        "contact.surface_energy": 0.02,
    },
    "bonds": {
        "adhesion.strength": 0.02,
        "types": {"a": {"receptor": 2, "ligand": [[0, 0], ["2 h", 2]]}, "b": {"ligand": 1}},
    },
    "unlike stiffness": {"types": {"soft": {"young": 0.5}, "stiff": {"young": 20.0}}},
    "sphere": {"domain.shape": "sphere", "domain.radius": "19 um"},
}  # fmt: skip
"""Name -> what is changed of the scene ``growth``; of unlike sizes, half are halved."""
QUICK = ("growing", "exact JKR", "plane")
VISCOSITIES = (5.0, 0.5, 0.05, 0.01)
SAFE = ("auto", "cvode", "rkc2")
"""Methods that are called safe at their defaults."""
OTHERS = ("rosenbrock", "cvode-adams", "dopri5")
LIMIT = 3.0
RUN = 20  # coupling steps that are taken from a run; the next ones are from a run of another seed
STIFF = 1.0  # kPa s, below which LSODA takes less time than DOP853
SHIFTS = (0.01, 0.1)  # µm; the second one for methods with this tolerance
DRAWS = 12
FIELDS = (
    "case", "viscosity_kPa_s", "seed", "step", "method", "atol_um", "cells", "error_um", "shift_um",
    "shift_0.01_um", "effort", "problem",
)  # fmt: skip


class Velocity:
    """dx/dt of a coupling step in NumPy: pairs of a k-d tree, laws as their sources write them."""

    def __init__(self, motion, template):
        self.motion, self.template = motion, template
        laws = {"JKR": self.jkr, "ExactJKR": self.exact, "CubicSpring": self.cubic}
        self.law = laws[type(template.law).__name__]
        self.margin = 0.6 * float(motion.radius.mean())
        self.soft = 0.75 * (1.0 - motion.poisson**2) / motion.young
        self.listed = None

    def _pull(self, t, h, reduced):
        """Return law and adhesion molecules, ½ f_ad (rec_i lig_j + lig_i rec_j) on π r h."""
        motion = self.motion
        force = self.law(h, self.modulus, reduced, self.rest)
        if motion.bonds is None:
            return force
        there = motion.bonds[:, :2] + (t - motion.begin) * motion.bonds[:, 2:]
        i, j = self.pairs
        count = there[i, 0] * there[j, 1] + there[i, 1] * there[j, 0]
        bond = 0.5 * np.pi * self.template.bond_strength
        return force - bond * count * reduced * np.maximum(h, 0.0)

    def _walls(self, x, radius):
        """Return the force of the walls on each cell, and minus its derivative, (n, 3, 3)."""
        walls, n = self.template.walls, len(x)
        total, stiffness = np.zeros((n, 3)), np.zeros((n, 3, 3))
        if walls is None:
            return total, stiffness
        strength = np.sqrt(radius) / (self.soft + walls.soft)
        if hasattr(walls, "rest"):
            away = np.sqrt((x * x).sum(axis=1))
            unit = x / away[:, None]
            pressed = np.maximum(away + radius - walls.rest, 0.0)
            outer = unit[:, :, None] * unit[:, None, :]
            total -= (strength * pressed**1.5)[:, None] * unit
            stiffness += (1.5 * strength * np.sqrt(pressed))[:, None, None] * outer
            bend = (strength * pressed**1.5 / away)[:, None, None]
            return total, stiffness + bend * (np.eye(3) - outer)
        for side, sign in ((walls.low, 1.0), (walls.high, -1.0)):
            pressed = np.maximum(radius[:, None] - sign * (x - side), 0.0)
            total += sign * strength[:, None] * pressed**1.5
            for axis in range(3):
                stiffness[:, axis, axis] += 1.5 * strength * np.sqrt(pressed[:, axis])
        return total, stiffness

    def _pairs(self, t, y):
        """Return x, radii, and of each pair the vector, its length, overlap and reduced radius."""
        x, motion = y.reshape(-1, 3), self.motion
        if self.listed is None or np.square(x - self.listed).sum(axis=1).max() > self.margin**2 / 4:
            self._list(x)
        radius = motion.radius + motion.radius_rate * (t - motion.begin)
        i, j = self.pairs
        away = x[j] - x[i]
        distance = np.sqrt((away * away).sum(axis=1))
        rest = self.rest = radius[i] + radius[j]
        return x, radius, away, distance, rest - distance, radius[i] * radius[j] / rest

    def jacobian(self, t, y):
        """Return the Jacobian, (3n, 3n), without what friction and neighbours change in the drag.

        Slopes are differences of the force; Newton's iteration needs no more.
        """
        x, radius, away, distance, h, reduced = self._pairs(t, y)
        i, j = self.pairs
        step = 1e-6
        above, below = (self._pull(t, h + sign * step, reduced) for sign in (1.0, -1.0))
        slope, across = (above - below) / (2.0 * step), 0.5 * (above + below) / distance
        unit = away / distance[:, None]
        block = -(slope + across)[:, None, None] * (unit[:, :, None] * unit[:, None, :])
        block += across[:, None, None] * np.eye(3)
        n = len(radius)
        whole = np.zeros((n, n, 3, 3))
        # the force on i is -F n, on j F n
        np.add.at(whole, (i, i), block)
        np.add.at(whole, (j, j), block)
        whole[i, j] = whole[j, i] = -block
        at = np.arange(n)
        whole[at, at] -= self._walls(x, radius)[1]
        whole = whole.transpose(0, 2, 1, 3).reshape(3 * n, 3 * n)
        drag = 6.0 * np.pi * self.template.viscosity * radius
        if max(self.template.friction) > 0.0:
            return np.linalg.solve(self._drags(drag, unit, h, reduced), whole)
        return whole / np.repeat(drag, 3)[:, None]

    def __call__(self, t, y):
        x, radius, away, distance, h, reduced = self._pairs(t, y)
        force = self._pull(t, h, reduced)
        total = self.incidence @ (away * (force / distance)[:, None])
        total += self._walls(x, radius)[0]
        push = self.motion.push
        if push is not None:
            total += push[:, :3] + (t - self.motion.begin) * push[:, 3:]
        drag = 6.0 * np.pi * self.template.viscosity * radius
        if max(self.template.friction) > 0.0:
            unit = away / distance[:, None]
            return np.linalg.solve(self._drags(drag, unit, h, reduced), total.ravel())
        return (total / drag[:, None]).ravel()

    def _list(self, x):
        """Note all pairs that may meet while no cell moves by more than half the margin."""
        motion, widest = self.motion, np.maximum(self.motion.radius, self.motion.end_radius).max()
        reach = 2.0 * widest * getattr(self.template.law, "cutoff", 1.2) + self.margin
        i, j = self.pairs = cKDTree(x).query_pairs(reach, output_type="ndarray").T
        self.modulus = 1.0 / (self.soft[i] + self.soft[j])
        m = np.arange(len(i))
        ones = np.ones(len(i))
        places = (np.concatenate([j, i]), np.concatenate([m, m]))
        shape = (len(x), len(i))
        self.incidence = csr_matrix((np.concatenate([ones, -ones]), places), shape=shape)
        touching = set() if motion.touching is None else set(map(tuple, motion.touching.tolist()))
        self.touching = np.array([(min(p), max(p)) in touching for p in self.pairs.T.tolist()])
        self.listed = x.copy()

    def jkr(self, h, modulus, reduced, rest):
        """Eq. 3.6 of the thesis: E √r h^(3/2) - √(6π σ E r^(3/2)) h^(3/4)."""
        h = np.maximum(h, 0.0)
        root = np.sqrt(h)
        sticky = np.sqrt(6.0 * np.pi * self.template.law.surface_energy * modulus * reduced**1.5)
        return modulus * np.sqrt(reduced) * h * root - sticky * np.sqrt(h * root)

    def exact(self, h, modulus, reduced, rest):
        """Johnson, Kendall & Roberts 1971: contact radius x² with x⁴ / r - √(2πw / E*) x = h."""
        work, star = self.template.law.surface_energy, 0.75 * modulus
        c = np.sqrt(2.0 * np.pi * work / star)
        # the least h is that of the turning point, 4 x³ = c r
        turning = np.cbrt(0.25 * c * reduced)
        lowest = turning**4 / reduced - c * turning
        held = np.flatnonzero(np.where(self.touching, h >= lowest, h >= 0.0))
        force = np.zeros_like(h)
        h, c, r, star = h[held], c[held], reduced[held], star[held]
        # Newton from the right of the largest root: the function is convex
        x = np.cbrt(c * r) + (np.maximum(h, 0.0) * r) ** 0.25
        for _ in range(60):
            less = (x**4 / r - c * x - h) / np.maximum(4.0 * x**3 / r - c, 1e-300)
            x = x - less
            if (np.abs(less) <= 1e-15 * x).all():
                break
        a3 = x**6
        force[held] = 4.0 * star * a3 / (3.0 * r) - np.sqrt(8.0 * np.pi * work * star * a3)
        return force

    def cubic(self, h, modulus, reduced, rest):
        """CBMOS: μ h (1 + h / H)², H the range beyond the rest distance."""
        law = self.template.law
        reach = (law.cutoff - 1.0) * rest
        return law.stiffness_at_rest * h * np.maximum(1.0 + h / reach, 0.0) ** 2

    def _drags(self, drag, unit, h, reduced):
        """Return Γ, (3n, 3n): Stokes drag and friction over the Hertz area π r h."""
        normal, tangential = self.template.friction
        near = np.flatnonzero(h > 0.0)
        unit, area = unit[near], np.pi * (reduced * h)[near]
        outer = unit[:, :, None] * unit[:, None, :]
        block = area[:, None, None] * ((normal - tangential) * outer + tangential * np.eye(3))
        n = len(drag)
        gamma = np.zeros((n, n, 3, 3))
        i, j = self.pairs[0][near], self.pairs[1][near]
        np.add.at(gamma, (i, i), block)
        np.add.at(gamma, (j, j), block)
        gamma[i, j] = gamma[j, i] = -block
        gamma[np.arange(n), np.arange(n)] += drag[:, None, None] * np.eye(3)
        return gamma.transpose(0, 2, 1, 3).reshape(3 * n, 3 * n)


def true_end(problem, k, start, rtol=1e-10, stiff=False):
    """Return where the cells are at the end of a coupling step, (n, 3) µm."""
    motion = problem.steps[k].motion
    span, velocity = (motion.begin, motion.end), Velocity(motion, problem.template)
    by = {"method": "LSODA", "jac": velocity.jacobian} if stiff else {"method": "DOP853"}
    found = solve_ivp(velocity, span, start.ravel(), rtol=rtol, atol=10.0 * rtol, **by)
    assert found.success, found.message
    return found.y[:, -1].reshape(-1, 3)


def scene_of(case, viscosity, steps, count=50):
    """Return the scene whose coupling steps are taken: few cells, some of which divide."""
    changes = {
        "initial.count": count, "initial.stage": "uniform", "initial.jitter": 0.02,
        "drag.viscosity": viscosity, "duration": 600.0 * (steps + 1),
    }  # fmt: skip
    changes |= CASES[case]
    if case == "plane":
        del changes["initial.jitter"]
    return mc.load_scene("growth").with_changes(changes)


def recorded(case, viscosity, steps, seed=1, method=None):
    """Return a step-wise problem: coupling steps of a run with the states they start from.

    - ``method``: of the run, by default Runge-Kutta-Chebyshev to 0.01 µm
    """
    scene = scene_of(case, viscosity, steps).with_changes({"seed": seed})
    cells = mc.Simulation(scene).cells
    if case == "unlike sizes":
        halves = np.where(np.arange(len(cells)) % 2, 1.0, 0.5)
        cells = replace(cells, radius=halves * cells.radius)
    return record(scene, method or Rkc2(atol=0.01), samples=10**6, cells=cells, threads=1)[0]


class Truth:
    """True ends of the steps of a problem, also from shifted starts; kept in a file."""

    def __init__(self, problem, path=None):
        self.problem, self.path = problem, path
        self.known = dict(np.load(path)) if path is not None and path.is_file() else {}
        self.cost = 0.0

    def end(self, k, shift=0.0, draw=0):
        """Return the end of step ``k``, whose start is shifted by some µm in one of the draws."""
        start = self.problem.starts[k]
        if shift:
            scene = self.problem.scene.with_changes({"seed": draw + 1})
            start = shift_starts(replace(self.problem, scene=scene), shift).starts[k]
        name = f"{k}_{shift:g}_{draw}"
        if not np.array_equal(self.known.get(f"start_{name}", ()), start):
            begin, stiff = time.process_time(), self.problem.scene.drag.viscosity < STIFF
            rtol = 1e-10 if not shift else 1e-6 if stiff else 1e-7
            self.known[f"end_{name}"] = true_end(self.problem, k, start, rtol, stiff)
            self.known[f"start_{name}"] = start
            self.cost += time.process_time() - begin
        return self.known[f"end_{name}"]

    def moved(self, k, shift, error):
        """Return the effect of shifts on the worst cell in step ``k``, µm: the most of twelve.

        Of fewer, if that is more than an error that it is compared with.
        """
        most = 0.0
        for draw in range(DRAWS):
            most = max(most, distance(self.end(k, shift, draw), self.end(k)))
            if most >= error:
                break
        return most

    def save(self):
        self.path.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(self.path, **self.known)


def check(cases, viscosities):
    """Print how far LSODA is from DOP853 in the first step of each case, µm."""
    for case, viscosity in product(cases, [v for v in viscosities if v < STIFF]):
        problem = recorded(case, viscosity, 1)
        ends = [true_end(problem, 1, problem.starts[1], 1e-10, stiff) for stiff in (True, False)]
        print(f"{case}, {viscosity:g} kPa·s: LSODA and DOP853 differ by {distance(*ends):.1g} µm")


def distance(a, b):
    return float(np.sqrt(np.square(a - b).sum(axis=1)).max())


def measured(case, viscosity, truth, steps, method, seed=1):
    atol, rows, problem = METHODS[method].atol, [], truth.problem
    solver = from_options(IntegratorOptions(method=method))
    for k in steps:
        system = problem.system()
        system.begin(problem.steps[k].motion)
        words, end = advance_system(system, solver, problem.starts[k])
        error = math.inf if words else distance(end, truth.end(k))
        rows.append({
            "case": case, "viscosity_kPa_s": viscosity, "seed": seed, "step": k, "method": method,
            "atol_um": atol, "cells": len(end), "error_um": error,
            "shift_um": truth.moved(k, atol if atol in SHIFTS else SHIFTS[0], error),
            "shift_0.01_um": truth.moved(k, SHIFTS[0], error / LIMIT),
            "effort": system.work.effort, "problem": words,
        })  # fmt: skip
    return rows


def table(rows, names=("case", "viscosity_kPa_s", "method")):
    """Return a line for each group of rows with the same values of these names."""
    head = [
        *(name.replace("_kPa_s", " / kPa·s") for name in names), "steps", "worst ratio",
        "its error / µm", "95 %", "over 3", "over 3 at 0.01 µm", "worst error / µm", "effort",
    ]  # fmt: skip
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    groups = {}
    for row in rows:
        groups.setdefault(tuple(str(row[name]) for name in names), []).append(row)
    for key, group in groups.items():
        error, shift, common, effort = (
            np.array([float(row[name]) for row in group])
            for name in ("error_um", "shift_um", "shift_0.01_um", "effort")
        )
        ratio = error / shift
        worst = ratio.argmax()
        lines.append(
            f"| {' | '.join(key)} | {len(group)} | {ratio[worst]:.2g} | {error[worst]:.2g} | "
            f"{np.quantile(ratio, 0.95):.2g} | {(ratio > LIMIT).sum()} | "
            f"{(error > LIMIT * common).sum()} | {error.max():.2g} | {effort.sum():.0f} |"
        )
    return "\n".join(lines)


def write(path, rows):
    order = {case: k for k, case in enumerate(CASES)}
    rows.sort(
        key=lambda row: (order[row["case"]], -float(row["viscosity_kPa_s"]), int(row["seed"]))
    )
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, FIELDS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, default=Path("worst-cell"))
    parser.add_argument("--steps", type=int, default=200, help="of each case (%(default)s)")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--viscosities", type=float, nargs="+", default=VISCOSITIES, help="kPa s")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=SAFE + OTHERS)
    parser.add_argument("--again", nargs="+", default=[], help="methods to measure anew")
    parser.add_argument("--check", action="store_true", help="compare LSODA with DOP853")
    parser.add_argument("--quick", action="store_true")
    given = parser.parse_args()
    if given.quick:
        given.cases, given.steps = QUICK, 6
    given.results.mkdir(parents=True, exist_ok=True)
    path, rows = given.results / "worst-cell.csv", []
    if path.is_file():
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
    if given.check:
        check(given.cases, given.viscosities)
    runs = range(1, math.ceil(given.steps / RUN) + 1)
    # a run of each case first: a part is a picture of the whole
    for seed, case, viscosity in product(runs, given.cases, given.viscosities):
        steps, key = min(RUN, given.steps - RUN * (seed - 1)), (case, viscosity, seed)
        here = [r for r in rows if (r["case"], float(r["viscosity_kPa_s"]), int(r["seed"])) == key]
        done = [r["method"] for r in here]
        missing = [
            m for m in given.methods
            if (m in given.again or done.count(m) < steps)
            and METHODS[m].refusal(0, friction=case == "friction") is None
        ]  # fmt: skip
        if not missing:
            continue
        begin = time.process_time()
        problem = recorded(case, viscosity, steps, seed)
        name = f"{case.replace(' ', '-')}-{viscosity:g}-{seed}.npz"
        truth = Truth(problem, given.results / "truth" / name)
        rows = [r for r in rows if r not in here or r["method"] not in missing]
        for method in missing:
            # the first step starts from a lattice
            rows += measured(case, viscosity, truth, range(1, steps + 1), method, seed)
        write(path, rows)
        truth.save()
        print(
            f"{case}, {viscosity:g} kPa·s, seed {seed}: {problem.counts[1]} to "
            f"{problem.counts[-1]} cells, {truth.cost:.0f} s of CPU for the truth, "
            f"{time.process_time() - begin:.0f} s in all", flush=True,
        )  # fmt: skip
    print(f"{table(rows)}\n\n{table(rows, ('viscosity_kPa_s', 'method'))}")


if __name__ == "__main__":
    main()
