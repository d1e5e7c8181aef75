"""Whole runs by the default method beside `cvode`: CPU time, and observables beside their scatter.

Problem: `grow-2000` from one cell to 2,000 at some viscosities. Every seed is run by all methods in
turn, so that other load on the machine meets all of them; the order changes with the seed. Times
are CPU times of whole runs on one thread, compilation excluded; ratios are medians over the seeds
of the ratio within a seed. Changes of observables are means over the seeds, over the scatter of the
observable between them.
Cost: about 40 s of CPU a seed and viscosity.
Command: python tests/benchmarks/compare_whole_runs.py [--viscosities 5 0.5] [--seeds 5]
"""

from __future__ import annotations

import argparse
import time
from statistics import median

import numpy as np

import multicell as mc
from multicell.integrators.auto import Auto
from multicell.integrators.cvode import Cvode

METHODS = {
    "cvode 0.01 µm, mean over cells": lambda: Cvode(each_cell=False),
    "cvode 0.01 µm": Cvode,
    "auto 0.1 µm": lambda: Auto(atol=0.1),
}
"""The first one is what the others are held against."""


def measured(scene, make):
    """Return CPU time in s and observables of a run."""
    begin = time.process_time()
    result = mc.run(scene, integrator=make(), threads=1)
    took = time.process_time() - begin
    cells = result.frames[-1].cells
    away = cells.position - cells.position.mean(axis=0)
    return took, {
        "cells": len(cells),
        "time / h": float(result.history["time"][-1]) / 3600.0,
        "gyration / µm": float(np.sqrt(np.square(away).sum(axis=1).mean())),
        "diameter / µm": float(result.history["diameter"][-1]),
        "packing": float(result.history["packing_ratio"][-1]),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--viscosities", type=float, nargs="+", default=[5.0, 0.5], help="kPa s")
    parser.add_argument("--seeds", type=int, default=5)
    given = parser.parse_args()
    names = list(METHODS)
    small = mc.load_scene("grow-2000").with_changes({"stop_cells": 60})
    for make in METHODS.values():
        measured(small, make)
    for viscosity in given.viscosities:
        found = {name: [] for name in names}
        for seed in range(1, given.seeds + 1):
            scene = mc.load_scene("grow-2000").with_changes(
                {"drag.viscosity": viscosity, "seed": seed}
            )
            turn = seed % len(names)
            for name in names[turn:] + names[:turn]:
                found[name].append(measured(scene, METHODS[name]))
        first = found[names[0]]
        print(f"\n{viscosity:g} kPa·s, {given.seeds} seeds")
        for name, runs in found.items():
            ratios = [old[0] / new[0] for old, new in zip(first, runs, strict=True)]
            print(
                f"{name}: CPU {median(run[0] for run in runs):.2f} s; {names[0]} takes "
                f"{median(ratios):.2f} times as long ({min(ratios):.2f} to {max(ratios):.2f})"
            )
            for key in first[0][1]:
                old, new = (np.array([run[1][key] for run in of]) for of in (first, runs))
                scatter = old.std(ddof=1) if len(old) > 1 else float("nan")
                change = (new - old).mean()
                print(f"    {key}: {new.mean():.5g} (change {change:+.2g}, scatter {scatter:.2g})")


if __name__ == "__main__":
    main()
