"""Error of a whole spheroid run against its coupling step: splitting against integration.

Problem   200 cells in all stages of the cycle grow for three days to a spheroid with a starved
          core. All cells are alike (no spread of cycle times and moduli), so that chance has a
          part only in the axes of division, which are drawn anew in every coupling step. Each
          seed is its own reference: its run with the finest step and the tight tolerance. What is
          shown are means of the differences over the seeds, and their standard errors.
Separated the splitting error is the difference between coupling steps at the tight tolerance, the
          integration error that between the tolerances at the same coupling step
Cost      about three minutes on 2 cores (five coupling steps, two tolerances, six seeds)
Command   python docs/coupling_step.py
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from marked import replaced

import multicell as mc

HERE = Path(__file__).parent
STEPS = (40.0, 20.0, 10.0, 5.0, 2.5)
LOOSE, TIGHT = 0.1, 0.001
SEEDS = (1, 2, 3, 4, 5, 6)
OBSERVABLES = {"cells": "number of cells", "radius": "radius", "viable_rim": "viable rim"}
Run = tuple[float, float, int]
"""Coupling step in min, absolute tolerance in µm, seed."""


def setup(minutes: float, atol: float, seed: int, duration: str = "3 d") -> mc.Scene:
    """Return the scene of one run."""
    return mc.load_scene("spheroid").with_changes(
        {
            "duration": duration,
            "seed": seed,
            "coupling_step": f"{minutes} min",
            "integrator.atol": f"{atol} um",
            "initial.count": 200,
            "initial.stage": "uniform",
            "cells.young_variation": 0.0,
            "growth.cycle_variation": 0.0,
            "nutrients.oxygen.uptake": "120 amol/s",
            "output.every": duration,
        }
    )


def observed(run: Run) -> tuple[float, ...]:
    """Return the observables at the end of a run."""
    summary = mc.run(setup(*run), threads=1).summary()
    summary["radius"] = 0.5 * summary["diameter"]
    # a run without a necrotic core has no rim
    return tuple(np.nan if summary[n] is None else float(summary[n]) for n in OBSERVABLES)


def ensemble(seeds: Sequence[int], steps: Sequence[float], processes: int) -> np.ndarray:
    """Return the observables of all runs, (tolerances, steps, seeds, observables)."""
    runs = list(product((LOOSE, TIGHT), steps, seeds))
    # the long ones first, so that no process is left alone with one at the end
    order = sorted(range(len(runs)), key=lambda k: runs[k][1])
    arguments = [(runs[k][1], runs[k][0], runs[k][2]) for k in order]
    values = np.empty((len(runs), len(OBSERVABLES)))
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        for k, value in zip(order, pool.map(observed, arguments), strict=True):
            values[k] = value
    return values.reshape(2, len(steps), len(seeds), -1)


def relative(values: np.ndarray) -> np.ndarray:
    """Return each run's difference from the finest, tight one of its seed, in per cent of it."""
    finest = values[1, -1]
    return np.asarray(100.0 * (values - finest) / finest)


def spread(differences: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and standard error over the seeds, the last axis but one."""
    count = differences.shape[-2]
    error = differences.std(axis=-2, ddof=1) / count**0.5
    return differences.mean(axis=-2), error


def table(values: np.ndarray, steps: Sequence[float]) -> str:
    """Return the table: splitting error, and integration error, of each observable."""
    splitting, splitting_error = spread(relative(values)[1])
    gap = 100.0 * (values[0] - values[1]) / values[1, -1]
    integration, integration_error = spread(gap)
    names = list(OBSERVABLES.values())
    head = ["coupling step", *(f"{name}: splitting / %" for name in names)]
    head += [f"{name}: integration / %" for name in names]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for k, minutes in enumerate(steps):
        last = k + 1 == len(steps)
        cells = [f"{minutes:g} min"]
        cells += ["reference"] * len(names) if last else [
            f"{a:+.2f} ± {b:.2f}" for a, b in zip(splitting[k], splitting_error[k], strict=True)
        ]  # fmt: skip
        cells += [
            f"{a:+.2f} ± {b:.2f}" for a, b in zip(integration[k], integration_error[k], strict=True)
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def slopes(values: np.ndarray, steps: Sequence[float]) -> str:
    """Return in words the splitting error of each observable in 10 min of coupling step.

    A line through the reference is fitted to the differences of each seed; the error is the
    standard error over the seeds.
    """
    away = np.array(steps[:-1]) - steps[-1]
    differences = relative(values)[1, :-1]
    fitted = np.einsum("k,kso->so", away, differences) / (away**2).sum()
    mean, error = spread(fitted)
    words = [
        f"{name} {10.0 * a:+.2f} ± {10.0 * b:.2f} %"
        for name, a, b in zip(OBSERVABLES.values(), mean, error, strict=True)
    ]
    return (
        f"Per 10 min of coupling step the splitting changes: {', '.join(words)}. Means over "
        f"{values.shape[2]} seeds with standard errors; tolerances {LOOSE:g} and {TIGHT:g} µm."
    )


def figure(values: np.ndarray, steps: Sequence[float]) -> Any:
    """Draw the differences from the finest run over the coupling step, one panel each."""
    from matplotlib.figure import Figure

    drawn = Figure(figsize=(10.0, 4.6), dpi=160)
    drawn.text(0.04, 0.94, "A spheroid after three days, against its coupling step", fontsize=14,
               weight="bold", va="center")  # fmt: skip
    drawn.text(0.04, 0.875, f"difference from the run at {steps[-1]:g} min and {TIGHT:g} µm with "
               f"the same seed; mean and standard error over {values.shape[2]} seeds",
               fontsize=10.5, color="#6b7a86", va="center")  # fmt: skip
    mean, error = spread(relative(values))
    looks = ((LOOSE, "#e8590c", "o", 1.06), (TIGHT, "#1f7f54", "s", 1.0 / 1.06))
    handles: list[Any] = []
    for k, name in enumerate(OBSERVABLES.values()):
        axes = drawn.add_axes((0.075 + 0.31 * k, 0.24, 0.25, 0.53))
        axes.axhline(0.0, color="#9aa7b1", lw=1.0)
        handles = [
            axes.errorbar(np.array(steps) * aside, mean[which, :, k], error[which, :, k],
                          color=colour, marker=marker, ms=5, lw=1.4, capsize=3,
                          label=f"tolerance {atol:g} µm")
            for which, (atol, colour, marker, aside) in enumerate(looks)
        ]  # fmt: skip
        axes.set_xscale("log")
        axes.set_xticks(steps, [f"{step:g}" for step in steps])
        axes.minorticks_off()
        axes.set_title(name, fontsize=11, loc="left", weight="bold")
        axes.set_xlabel("coupling step (min)")
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(color="#e4e9ed")
        axes.set_axisbelow(True)
        if k == 0:
            axes.set_ylabel("difference (%)")
    drawn.legend(handles=handles, loc="lower center", ncols=2, frameon=False,
                 bbox_to_anchor=(0.5, 0.0))  # fmt: skip
    return drawn


def kept(path: Path) -> tuple[np.ndarray, list[float]]:
    """Return the observables and the steps of an earlier run from its CSV."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    steps = sorted({float(row["minutes"]) for row in rows}, reverse=True)
    seeds = sorted({int(row["seed"]) for row in rows})
    values = np.empty((2, len(steps), len(seeds), len(OBSERVABLES)))
    for row in rows:
        place = (
            (LOOSE, TIGHT).index(float(row["atol"])),
            steps.index(float(row["minutes"])),
            seeds.index(int(row["seed"])),
        )
        values[place] = [float(row[name]) for name in OBSERVABLES]
    return values, steps


def keep(path: Path, values: np.ndarray, seeds: Sequence[int], steps: Sequence[float]) -> None:
    """Write the observables of all runs as CSV."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["atol", "minutes", "seed", *OBSERVABLES])
        for (a, atol), (b, minutes), (c, seed) in product(
            enumerate((LOOSE, TIGHT)), enumerate(steps), enumerate(seeds)
        ):
            writer.writerow([atol, minutes, seed, *values[a, b, c].tolist()])


def main() -> None:
    """Run the ensemble, draw it, and put the table on the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="two seeds, no step below 10 min")
    parser.add_argument("--tables", action="store_true", help="compute nothing")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--results", type=Path, default=HERE / "chart-data")
    parser.add_argument("--figures", type=Path, default=HERE / "figures")
    parser.add_argument("--page", type=Path, default=HERE / "theory" / "coupling.md")
    given = parser.parse_args()
    path = given.results / "coupling-step.csv"
    if given.tables:
        values, steps = kept(path)
    else:
        steps = [step for step in STEPS if not given.quick or step >= 10.0]
        seeds = SEEDS[:2] if given.quick else SEEDS
        begin = time.perf_counter()
        values = ensemble(seeds, steps, given.processes)
        keep(path, values, seeds, steps)
        print(f"{time.perf_counter() - begin:.0f} s for {values[..., 0].size} runs")
    given.figures.mkdir(parents=True, exist_ok=True)
    figure(values, steps).savefig(given.figures / "coupling-step.png")
    block = f"{slopes(values, steps)}\n\n{table(values, steps)}"
    print(block)
    page = given.page.read_text(encoding="utf-8")
    given.page.write_text(replaced(page, "coupling step", block), encoding="utf-8")


if __name__ == "__main__":
    main()
