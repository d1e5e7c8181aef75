"""Error of a whole spheroid run against its coupling step: splitting against integration.

Problem   the built-in spheroid in poor medium, nine days, three seeds; the coupling step is
          halved from 40 min to 2.5 min, with the integrator's tolerance at 1e-2 and at 1e-4 µm
Cost      about four minutes on 2 cores
Command   python docs/coupling_step.py
"""

from __future__ import annotations

import numpy as np

import multicell as mc

STEPS = (40.0, 20.0, 10.0, 5.0, 2.5)
TOLERANCES = ("0.01 um", "0.0001 um")
SEEDS = (1, 2, 3)


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
    """Return the observables of all seeds, (seeds, 2)."""
    runs = [mc.run(setup(minutes, atol, seed)).summary() for seed in SEEDS]
    return np.array([[run["cells"], run["diameter"]] for run in runs])


def main() -> None:
    """Print the table: means, and their standard errors over the seeds."""
    print("| coupling step | atol | cells | diameter / µm |")
    print("|---|---|---|---|")
    for atol in TOLERANCES:
        for minutes in STEPS:
            values = observed(minutes, atol)
            (cells, size), (c, d) = values.mean(axis=0), values.std(axis=0, ddof=1)
            root = len(SEEDS) ** 0.5
            print(f"| {minutes:g} min | {atol} | {cells:.0f} ± {c / root:.0f} "
                  f"| {size:.1f} ± {d / root:.1f} |", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
