"""The most that CVODE would gain if it lived on from one coupling step to the next.

Problem: `grow-2000` at some viscosities with about 800 cells that grow for an hour in which none
divides: one solve over the hour beside six over ten minutes each, from the same state. A division
would end a solve in any case, since its vector grows, and from some sixty cells on `grow-2000` has
one in every coupling step. So this is a bound; and one without exact resume, since the history of
a solver is no part of a frame. Errors are those of the worst cell at the end, against RKC2 at
1e-5 µm over the six steps.
Cost: about two minutes.
Command: python tests/benchmarks/compare_long_solves.py [--viscosities 5 0.5 0.05]
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np

import multicell as mc
from multicell.integrators.auto import Auto
from multicell.integrators.cvode import Cvode
from multicell.integrators.rkc import Rkc2
from multicell.integrators.rosenbrock import Rosenbrock

COUNT, STEPS, REPEATS = 800, 6, 3
METHODS = {
    "cvode 0.01 µm": Cvode(max_steps=10**6),
    "cvode 0.01 µm, mean over cells": Cvode(each_cell=False, max_steps=10**6),
    "rosenbrock 0.01 µm": Rosenbrock(atol=0.01, max_steps=10**6),
    "rkc2 0.1 µm": Rkc2(atol=0.1, max_steps=10**6),
    "auto 0.1 µm": Auto(atol=0.1, max_steps=10**6),
}


def parts(motion, count):
    """Return the motion of an hour in equal parts, without what they share being changed."""
    length = motion.end - motion.begin
    return [
        replace(
            motion,
            begin=motion.begin + k * STEPS * length / count,
            end=motion.begin + (k + 1) * STEPS * length / count,
            radius=motion.radius + k * STEPS * length / count * motion.radius_rate,
        )
        for k in range(count)
    ]


def solved(system, motions, method, position):
    """Return CPU time in s, where the hour ends, and the number of internal steps."""
    steps = system.work.steps
    begin = time.process_time()
    for motion in motions:
        system.begin(motion)
        outcome = method.integrate(system, position)
        if not outcome.done:
            raise SystemExit(outcome.problem)
        position = outcome.position
    return time.process_time() - begin, position, system.work.steps - steps


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--viscosities", type=float, nargs="+", default=[5.0, 0.5, 0.05])
    for viscosity in parser.parse_args().viscosities:
        scene = mc.load_scene("grow-2000").with_changes({"drag.viscosity": viscosity})
        simulation = mc.Simulation(scene, threads=1)
        while len(simulation.cells) < COUNT:
            simulation.step()
        start, system = simulation.cells.position, simulation.prepared()
        six, one = parts(system.motion, STEPS), parts(system.motion, 1)
        exact = solved(system, six, Rkc2(atol=1e-5, rtol=1e-9, max_steps=10**6), start)[1]
        print(f"\n{viscosity:g} kPa·s, {len(simulation.cells)} cells")
        for name, method in METHODS.items():
            found = {}
            for _ in range(REPEATS):
                for count, motions in ((STEPS, six), (1, one)):
                    took, end, steps = solved(system, motions, method, start)
                    best = min(took, found.get(count, (took,))[0])
                    found[count] = best, np.linalg.norm(end - exact, axis=1).max(), steps
            told = "; ".join(
                f"{'six' if count == STEPS else 'one'}: {1e3 * took:.0f} ms, {steps} steps, worst "
                f"cell {error:.2g} µm"
                for count, (took, error, steps) in found.items()
            )
            print(f"{name}: {told}; one / six {found[1][0] / found[STEPS][0]:.2f}", flush=True)


if __name__ == "__main__":
    main()
