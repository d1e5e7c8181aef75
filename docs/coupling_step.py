"""Error of a whole spheroid run against its coupling step: splitting against integration.

Problem   the built-in spheroid in poor medium, nine days, three seeds; the coupling step is
          halved from 40 min to 2.5 min, with the integrator's tolerance at 1e-2 and at 1e-4 µm
Cost      about four minutes on 2 cores
Command   python docs/coupling_step.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import multicell as mc

HERE = Path(__file__).parent
STEPS = (40.0, 20.0, 10.0, 5.0, 2.5)
TOLERANCES = ("0.01 um", "0.0001 um")
SEEDS = (1, 2, 3)
WHAT = {"cells": "number of cells", "diameter": "diameter", "viable_rim": "viable rim"}


def setup(minutes: float, atol: str, seed: int) -> mc.Scene:
    """Return the scene of one run."""
    return mc.load_scene("spheroid").with_changes(
        {
            "duration": "9 d",
            "seed": seed,
            "coupling_step": f"{minutes} min",
            "integrator.atol": atol,
            "nutrients.oxygen.boundary": "0.03 mM",
            "output.every": "9 d",
        }
    )


def observed(minutes: float, atol: str) -> np.ndarray:
    """Return the mean of the observables over the seeds, (3,)."""
    runs = [mc.run(setup(minutes, atol, seed)).summary() for seed in SEEDS]
    return np.array([[run[name] for name in WHAT] for run in runs]).mean(axis=0)


def main() -> None:
    """Print the table and draw the chart."""
    values = {atol: np.array([observed(m, atol) for m in STEPS]) for atol in TOLERANCES}
    finest = values[TOLERANCES[1]][-1]
    figure = Figure(figsize=(10.0, 4.2), dpi=130, layout="constrained")
    print("| coupling step | atol | cells | diameter / µm | viable rim / µm |")
    print("|---|---|---|---|---|")
    for atol, rows in values.items():
        for minutes, row in zip(STEPS, rows, strict=True):
            print(f"| {minutes:g} min | {atol} | {row[0]:.0f} | {row[1]:.1f} | {row[2]:.1f} |")
    for axes, (k, (_, label)) in zip(figure.subplots(1, 3), enumerate(WHAT.items()), strict=True):
        splitting = np.abs(values[TOLERANCES[1]][:-1, k] / finest[k] - 1.0)
        integrator = np.abs(values[TOLERANCES[0]][:, k] / values[TOLERANCES[1]][:, k] - 1.0)
        axes.loglog(STEPS[:-1], 100 * splitting, "o-", label="coupling step (splitting)")
        axes.loglog(STEPS, 100 * integrator, "s--", label="integrator: 0.01 against 0.0001 µm")
        axes.set_xlabel("coupling step (min)")
        axes.set_ylabel("difference (%)")
        axes.set_title(label)
        axes.grid(alpha=0.3)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    figure.savefig(HERE / "figures" / "coupling-step.png")


if __name__ == "__main__":
    main()
