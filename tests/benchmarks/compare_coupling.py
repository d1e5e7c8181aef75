"""The error of coupling steps: its order, and steps compared pairwise for the same random numbers.

Question  how large is the error of the coupling step, of which order is it, is its estimate right?
Setting   (1) scenes without chance at three coupling steps, each against an eighth of the finest;
          (2) 100 cells of the built-in spheroid in all stages of the cycle with three times its
          uptake, so that cells rest and die, for a day at 10 and 0.6 min; (3) the built-in
          spheroid, twelve days, at 40 and 10 min: of order 2, the error at 10 min is a fifteenth of
          their difference. What the positions of cells lose of each other adds 0.5 % in a pair.
          Draws do not depend on the step, so that each seed is compared with itself; (4) cells that
          keep a drug from each other and die of it, a dose at odd times, each against 2.5 min; (5)
          the dead of a pulse on growing cells, by seed; (6) steps whose lengths the run chooses for
          three tolerances, and fixed ones of 10 min, each against 1.25 min: the scenes of (1),
          tissue that grows, spheroids whose cells rest and die, a pulse.
Measures  volume of all cells; damage, integrals of hazards and the dead; (6) resting and dead
          cells, numbers of steps, CPU time of all steps
Cost      CPU time: (1) 1 min, (2) 15 s a seed, (3) 3 min a seed, (4) 30 s, (5) 6 s a seed,
          (6) 1 min and 1 min a seed
Command   python tests/benchmarks/compare_coupling.py [--truth] [--pairs 8] [--spheroid 8]
          [--exposures] [--pulse 8] [--chosen 4] [--first 1]
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np

import multicell as mc
from multicell.cells import FloatArray, State

STEPS = (2400.0, 1200.0, 600.0)
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


def volume(scene: mc.Scene) -> tuple[float, float]:
    """Return the volume of all cells at the end of a run, µm³, and the error that it estimates."""
    result = mc.run(scene, threads=1)
    error = result.summary()["splitting"]["relative_volume_error"]
    return float(result.frames[-1].cells.volume.sum()), error


def truth() -> None:
    """Print the estimated error of the volume beside the true one, and its order."""
    heads = [f"{step / 60:.0f} min: true, estimated / %" for step in STEPS]
    print(f"| scene | {' | '.join(heads)} | order |\n|---|{'---|' * (len(STEPS) + 1)}")
    for name, entries in CERTAIN.items():
        scene = mc.Scene.from_dict(entries)
        finest, _ = volume(scene.with_changes({"coupling_step": STEPS[-1] / 8}))
        found = [volume(scene.with_changes({"coupling_step": step})) for step in STEPS]
        true = np.array([v / finest - 1.0 for v, _ in found])
        cells = [f"{100 * t:+.4f}, {100 * e:+.4f}" for t, (_, e) in zip(true, found, strict=True)]
        order = "exact"
        if np.abs(true).min() > 1e-9:
            order = f"{np.polyfit(np.log(STEPS), np.log(np.abs(true)), 1)[0]:.2f}"
        print(f"| {name} | {' | '.join(cells)} | {order} |", flush=True)


def pairs(scene: mc.Scene, steps: tuple[str, str], seeds: range) -> None:
    """Print by how much the volume at the first step departs from that at the second, by seed."""
    found = []
    for seed in seeds:
        coarse, fine = (
            volume(scene.with_changes({"seed": seed, "coupling_step": step}))[0] for step in steps
        )
        found.append(100 * (coarse / fine - 1.0))
        print(f"seed {seed}: {found[-1]:+.3f} %", flush=True)
    error = np.std(found, ddof=1) / len(found) ** 0.5 if len(found) > 1 else np.nan
    print(f"{steps[0]} against {steps[1]}: {np.mean(found):+.3f} ± {error:.3f} %")


_DOSE = {
    "boundary": 0, "uptake": "0.6 amol/s", "half_saturation": "5e-4 mM", "geometry": "radial",
    "diffusion": "50 um^2/s", "media_change": "linear", "time_tolerance": 1e-4,
    "media": [["0.713 h", "0 mM"], ["2.05 h", "3 uM"], ["3.377 h", "0 mM"]],
}  # fmt: skip
_HARM = {"signal": "drug", "law": "hill", "half": "1 uM", "power": 2}
_DYING: dict[str, Any] = {
    "duration": "4 h", "seed": 3, "initial": {"count": 40, "spacing": 1.5}, "death": {},
    "contact": {"law": "hertz"}, "output": {"every": "4 h"},
    "responses": [{"behaviour": "necrosis rate", "largest": "0.6 1/h", **_HARM},
                  {"behaviour": "damage rate", "largest": "0.01 1/h", **_HARM}],
}  # fmt: skip
_PULSE = {
    "initial.count": 100, "duration": "1.2 h", "death.damage_time": "15 min",
    "nutrients.drug.regime": "transient",
    "nutrients.drug.media": [["0.53 h", "3.5e-3 mM"], ["0.8633 h", "0 mM"]],
}  # fmt: skip


def _exposed(scene: mc.Scene) -> tuple[float, float, int, float]:
    """Return damage, integrals of hazards, the dead, and by how many these may be off."""
    run = mc.Simulation(scene, threads=1)
    while not run.finished:
        run.step()
    hazard = 0.0 if run.cells.necrosis_hazard is None else float(run.cells.necrosis_hazard.sum())
    dead = int(run.cells.dead.sum())
    return float(run.cells.damage.sum()), hazard, dead, abs(run.exposures["error"])


def exposures() -> None:
    """Print errors of damage and hazards where cells die, the dead, and orders."""
    heads = [f"{step / 60:.0f} min: damage, hazard / %, dead" for step in STEPS]
    print(f"| field, cells | {' | '.join(heads)} | dead at 2.5 min | orders |")
    print(f"|---|{'---|' * (len(STEPS) + 2)}")
    for regime in ("steady", "transient"):
        for growth in (None, {"cycle_time": "30 h"}):
            drug = {"drug": {**_DOSE, "regime": regime}}
            scene = mc.Scene.from_dict({**_DYING, "nutrients": drug, "growth": growth})
            true = _exposed(scene.with_changes({"coupling_step": "2.5 min"}))
            found = [_exposed(scene.with_changes({"coupling_step": step})) for step in STEPS]
            errors = np.array([x[:2] for x in found]) / true[:2] - 1.0
            rows = zip(100.0 * errors, found, strict=True)
            cells = [f"{d:+.4f}, {h:+.4f}, {x[2]}" for (d, h), x in rows]
            orders = np.polyfit(np.log(STEPS), np.log(np.abs(errors)), 1)[0]
            name = f"{regime}, {'still' if growth is None else 'growing'}"
            order = ", ".join(f"{x:.2f}" for x in orders)
            print(f"| {name} | {' | '.join(cells)} | {true[2]} | {order} |", flush=True)


def pulse(seeds: range) -> None:
    """Print the dead of a pulse that cells keep from each other, with the reported error."""
    steps = (15, 10, 5, 2.5, 1, 0.5)
    print("| seed | " + " | ".join(f"{step} min" for step in steps) + " |")
    print(f"|---|{'---|' * len(steps)}")
    for seed in seeds:
        row = []
        for step in steps:
            changes = {**_PULSE, "seed": seed, "coupling_step": f"{step} min"}
            *_, dead, error = _exposed(mc.load_scene("dosing").with_changes(changes))
            row.append(f"{dead} ± {error:.1f}")
        print(f"| {seed} | {' | '.join(row)} |", flush=True)


_RICH = {"nutrients.oxygen.boundary": "0.6 mM", "nutrients.oxygen.uptake": "5 amol/s"}
_MANY = {"initial.stage": "asynchronous", "duration": "1 d", "output.every": "1 d"}


def chosen_scenes() -> dict[str, tuple[mc.Scene, bool]]:
    """Return scenes for steps that runs choose, and whether chance matters in them."""
    spheroid = mc.load_scene("spheroid").with_changes(_MANY)
    limited = {"initial.count": 1500, "nutrients.oxygen.uptake": "120 amol/s"}
    emt6 = mc.load_scene("emt6").with_changes({**_MANY, "initial.count": 1000})
    certain = {name: (mc.Scene.from_dict(entries), False) for name, entries in CERTAIN.items()}
    return {
        **certain,
        "growth under pressure": (spheroid.with_changes({**_RICH, "initial.count": 1000}), True),
        "a spheroid short of oxygen": (spheroid.with_changes(limited), True),
        "EMT6": (emt6, True),
        "a pulse": (mc.load_scene("dosing").with_changes({**_PULSE, "duration": "12 h"}), True),
    }


def _stepped(scene: mc.Scene) -> tuple[FloatArray, float]:
    """Return volume, resting cells, dead cells and steps of a run, and its CPU time in s."""
    run, begin = mc.Simulation(scene, threads=1), time.process_time()
    while not run.finished:
        run.step()
    spent, cells = time.process_time() - begin, run.cells
    resting = int((cells.state == State.QUIESCENT).sum())
    numbers = float(cells.volume.sum()), resting, int(cells.dead.sum()), run.step_index
    return np.array(numbers, float), spent


def chosen(seeds: range) -> None:
    """Print errors and cost of steps that runs choose, beside those of 10 min."""
    print("| scene | steps | volume / % | resting, dead | steps | CPU of 10 min |")
    print("|---|---|---|---|---|---|")
    ways: dict[str, dict[str, Any]] = {"10 min": {"coupling_step": "10 min"}}
    for asked in (3e-3, 1e-3, 3e-4):
        ways[f"{100 * asked:g} %"] = {"coupling_step": "auto", "coupling_tolerance": asked}
    for name, (scene, by_chance) in chosen_scenes().items():
        found: dict[str, list[tuple[FloatArray, float]]] = {way: [] for way in ways}
        true = []
        for seed in seeds if by_chance else seeds[:1]:
            seeded = scene.with_changes({"seed": seed})
            true.append(_stepped(seeded.with_changes({"coupling_step": "1.25 min"}))[0])
            for way, changes in ways.items():
                found[way].append(_stepped(seeded.with_changes(changes)))
        usual = sum(spent for _, spent in found["10 min"])
        for way, runs in found.items():
            off = np.array(
                [numbers - exact for (numbers, _), exact in zip(runs, true, strict=True)]
            )
            part = 100.0 * off[:, 0] / np.array(true)[:, 0]
            spread = f" ± {part.std(ddof=1) / len(part) ** 0.5:.3f}" if len(part) > 1 else ""
            _, rest, dead, _ = off.mean(axis=0)
            steps = np.mean([numbers[3] for numbers, _ in runs])
            spent = sum(spent for _, spent in runs) / usual
            print(f"| {name} | {way} | {part.mean():+.4f}{spread} | {rest:+.1f}, {dead:+.1f} | "
                  f"{steps:.0f} | {spent:.2f} |", flush=True)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--truth", action="store_true")
    parser.add_argument("--exposures", action="store_true")
    for name in ("--pairs", "--spheroid", "--pulse", "--chosen"):
        parser.add_argument(name, type=int, default=0, help="number of seeds")
    parser.add_argument("--first", type=int, default=1, help="seed")
    given = parser.parse_args()
    asked = given.truth, given.pairs, given.spheroid, given.exposures, given.pulse, given.chosen
    every = not any(asked)
    if given.truth or every:
        truth()
    if given.exposures or every:
        exposures()
    if given.pulse or every:
        pulse(range(given.first, given.first + (given.pulse or 8)))
    if given.chosen or every:
        chosen(range(given.first, given.first + (given.chosen or 4)))
    spheroid = mc.load_scene("spheroid")
    if given.pairs or every:
        changes = {"initial.count": 100, "initial.stage": "asynchronous", "duration": "1 d",
                   "nutrients.oxygen.uptake": "120 amol/s"}  # fmt: skip
        seeds = range(given.first, given.first + (given.pairs or 8))
        pairs(spheroid.with_changes(changes), ("10 min", "0.6 min"), seeds)
    if given.spheroid or every:
        seeds = range(given.first, given.first + (given.spheroid or 8))
        pairs(spheroid, ("40 min", "10 min"), seeds)


if __name__ == "__main__":
    main()
