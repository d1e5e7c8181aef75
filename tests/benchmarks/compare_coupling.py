"""The error of coupling steps: as it is estimated and as it is; what steps that a run chooses save.

Question  is the estimated splitting error the true one, which tolerance is enough, what is saved?
Setting   (1) scenes without chance at three coupling steps, each against a quarter of the finest;
          (2) the spheroid of ``docs/coupling_step.py`` (200 alike cells, three days, a tolerance of
          0.001 µm), each seed against its own run with steps of 2.5 min; (3) built-in scenes with
          their own coupling step and with "auto", one seed each
Measures  volume, cells, radius and viable rim; coupling steps; CPU time of one thread
Cost      (1) 20 s, (2) some 5 min, (3) 3 min
Command   python tests/benchmarks/compare_coupling.py [--truth] [--seeds 6] [--scenes treatment ...]
"""

from __future__ import annotations

import argparse
import statistics
import time
from typing import Any

import numpy as np

import multicell as mc

STEPS = (2400.0, 1200.0, 600.0)
TOLERANCES = (0.005, 0.01, 0.02)
_CALM: dict[str, Any] = {
    "duration": "12 h", "initial": {"count": 8, "spacing": 2.0}, "contact": {"law": "hertz"},
    "cells": {"young_variation": 0}, "growth": {"cycle_time": "20 h", "cycle_variation": 0},
    "integrator": "rkc2", "output": {"every": "12 h"},
}  # fmt: skip
_FADING = {
    "boundary": "0.1 mM", "uptake": 0, "media": [["0 h", "0.1 mM"], ["12 h", "0 mM"]],
    "media_change": "linear", "growth_half_saturation": "0.05 mM", "regime": "steady",
}  # fmt: skip
_CLOSED = {
    "boundary": "1 mM", "uptake": "1.5 amol/s", "half_saturation": "0.1 mM",
    "growth_half_saturation": "0.3 mM", "regime": "transient", "time_tolerance": 1e-4,
    "sides": {"*": {"type": "derivative", "derivative": 0}}, "initial": "medium",
}  # fmt: skip
_BOX = {axis: [-40, 40] for axis in "xyz"}
_STAGES = {**_CALM["initial"], "stage": "uniform"}
CERTAIN: dict[str, dict[str, Any]] = {
    "a medium that fades": {**_CALM, "nutrients": {"oxygen": _FADING}},
    "a medium that is used up": {**_CALM, "domain": _BOX, "nutrients": {"glucose": _CLOSED}},
    "free growth with divisions": {**_CALM, "duration": "40 h", "initial": _STAGES},
    "divisions until the medium is used up": {
        **_CALM, "domain": _BOX, "nutrients": {"glucose": _CLOSED}, "duration": "20 h",
        "growth": {"cycle_time": "8 h", "cycle_variation": 0}, "initial": _STAGES,
    },
}  # fmt: skip


def truth() -> None:
    """Print the estimated error of the volume beside the true one."""
    print("| scene | " + " | ".join(f"{s / 60:.0f} min: true, told / %" for s in STEPS) + " |")
    print("|---|" + "---|" * len(STEPS))
    for name, entries in CERTAIN.items():
        found = []
        for step in (*STEPS, STEPS[-1] / 4):
            result = mc.run(mc.Scene.from_dict({**entries, "coupling_step": step}), threads=1)
            volume = float(result.frames[-1].cells.volume.sum())
            found.append((volume, result.summary()["splitting"]["relative_volume_error"]))
        volume, told = found[-1]
        cells = [f"{100 * (v / volume - 1):+.3f}, {100 * (e - told):+.3f}" for v, e in found[:-1]]
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


def spheroid(step: str, seed: int, tolerance: float | None = None) -> mc.Scene:
    """Return the scene of ``docs/coupling_step.py`` with a coupling step."""
    changes: dict[str, Any] = {
        "duration": "3 d", "seed": seed, "coupling_step": step, "integrator.atol": "0.001 um",
        "initial.count": 200, "initial.stage": "uniform", "cells.young_variation": 0.0,
        "growth.cycle_variation": 0.0, "nutrients.oxygen.uptake": "120 amol/s",
        "output.every": "3 d",
    }  # fmt: skip
    return mc.load_scene("spheroid").with_changes(changes | _tolerance(tolerance))


def _tolerance(tolerance: float | None) -> dict[str, float]:
    return {} if tolerance is None else {"coupling_tolerance": tolerance}


def measured(scene: mc.Scene) -> tuple[list[float], dict[str, Any], float]:
    """Return cells, radius and rim at the end of a run, its summary and its CPU time, s."""
    begin = time.process_time()
    summary = mc.run(scene, threads=1).summary()
    rim = summary["viable_rim"]
    values = [summary["cells"], 0.5 * summary["diameter"], np.nan if rim is None else rim]
    return values, summary, time.process_time() - begin


def ensemble(seeds: int) -> None:
    """Print what tolerances do to the observables of a spheroid, beside a fixed step."""
    finest = {seed: measured(spheroid("2.5 min", seed))[0] for seed in range(1, seeds + 1)}
    print("| coupling step | cells / % | radius / % | rim / % | told / % | steps | CPU time / s |")
    print("|---|---|---|---|---|---|---|")
    for step, tolerance in (("10 min", None), *(("auto", t) for t in TOLERANCES)):
        runs = {seed: measured(spheroid(step, seed, tolerance)) for seed in finest}
        away = np.array([100 * (np.array(r[0]) / finest[s] - 1) for s, r in runs.items()])
        mean, error = away.mean(axis=0), away.std(axis=0, ddof=1) / len(runs) ** 0.5
        told = statistics.mean(r[1]["splitting"]["relative_volume_error"] for r in runs.values())
        steps = statistics.mean(r[1]["steps"] for r in runs.values())
        cost = statistics.median(r[2] for r in runs.values())
        cells = [f"{m:+.2f} ± {e:.2f}" for m, e in zip(mean, error, strict=True)]
        name = step if tolerance is None else f"auto, {tolerance:g}"
        print(f"| {name} | {' | '.join(cells)} | {100 * told:+.2f} | {steps:.0f} | {cost:.1f} |",
              flush=True)  # fmt: skip


def scenes(names: list[str]) -> None:
    """Print what "auto" does in built-in scenes."""
    print("| scene | coupling step | cells | diameter / µm | told / % | steps | CPU time / s |")
    print("|---|---|---|---|---|---|---|")
    for name in names:
        own = mc.load_scene(name)
        for step, tolerance in ((own.coupling_step, None), *(("auto", t) for t in TOLERANCES[:2])):
            scene = own.with_changes({"coupling_step": step} | _tolerance(tolerance))
            _, found, cost = measured(scene)
            words = f"auto, {tolerance:g}" if tolerance else f"{own.coupling_step / 60:g} min"
            told = 100 * found["splitting"]["relative_volume_error"]
            print(f"| {name} | {words} | {found['cells']:,} | {found['diameter']:.1f} | "
                  f"{told:+.2f} | {found['steps']} | {cost:.1f} |", flush=True)  # fmt: skip


def main() -> None:
    """Print the tables that are asked for; by default all of them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--truth", action="store_true")
    parser.add_argument("--seeds", type=int, default=0)
    parser.add_argument("--scenes", nargs="*", default=[])
    given = parser.parse_args()
    every = not (given.truth or given.seeds or given.scenes)
    if given.truth or every:
        truth()
    if given.seeds or every:
        ensemble(given.seeds or 6)
    if given.scenes or every:
        scenes(given.scenes or ["treatment", "monolayer"])


if __name__ == "__main__":
    main()
