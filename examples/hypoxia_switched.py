"""Hypoxia switched on and off: the hypoxic core compared with the closed form
===========================================================================

Problem
    A spheroid of 1,000 cells takes up oxygen at a constant rate while there is any. The medium has
    0.05 mM, then 0.028 mM for 12 hours, then 0.05 mM again. Below 0.01 mM cells are quiescent. The
    radius of that region is compared with the steady solution for a ball with uniform uptake q::

        c(r) = c0 - q R^3 / 3D (1/R - 1/(R + L)) - q / 6D (R^2 - r^2)

    with the radius R of the run at each time and an unstirred layer L around it.
Scaling
    The depth that oxygen reaches goes with the square root of c0 / q. Oxygen settles in seconds,
    so the core follows the medium at once, and growth hours later.
Cost
    Ten seconds on one core; longer when numba compiles the first time.
Command
    .. code-block:: sh

        python examples/hypoxia_switched.py [FOLDER]

    It writes FOLDER/hypoxia_switched.png.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import multicell as mc

LAYER, UPTAKE, DIFFUSION, THRESHOLD = 10.0, 40.0, 2000.0, 0.01  # µm, amol/s, µm²/s, mM
MEDIA = [(0.0, 0.05), (12.0, 0.028), (24.0, 0.05)]
"""Time (h) and oxygen (mM) from then on."""


def setup(**changes: Any) -> mc.Scene:
    """Return the scene; arguments replace parts, such as ``duration="1 h"``."""
    oxygen = {
        "diffusion": DIFFUSION,
        "boundary": MEDIA[0][1],
        "media": [[f"{hours} h", level] for hours, level in MEDIA[1:]],
        "layer": LAYER,
        "uptake": UPTAKE,
        "quiescent_uptake": 1.0,
        "half_saturation": "1e-5 mM",
        "quiescence": THRESHOLD,
        "hypoxia": THRESHOLD,
        "geometry": "radial",
        "spacing": "2 um",
    }
    scene = {
        "title": "Hypoxia switched on and off",
        "duration": "36 h",
        "coupling_step": "15 min",
        "initial": {"count": 1000, "spacing": 0.9, "stage": "asynchronous"},
        "contact": {"surface_energy": "0.02 nN/um"},
        "growth": {"cycle_time": "24 h"},
        "nutrients": {"oxygen": oxygen},
        "output": {"every": "6 h"},
    }
    return mc.Scene.from_dict(scene | changes)


def closed_form(radius: np.ndarray, cells: np.ndarray, medium: np.ndarray) -> np.ndarray:
    """Return the radius (µm) within which there is less than the threshold."""
    q = cells * UPTAKE / (4.0 / 3.0 * np.pi * radius**3)
    surface = medium - q * radius**3 / (3 * DIFFUSION) * (1 / radius - 1 / (radius + LAYER))
    return np.sqrt(np.maximum(radius**2 - 6 * DIFFUSION / q * (surface - THRESHOLD), 0.0))


def main(output: str | Path, **changes: Any) -> dict[str, float]:
    """Run, draw, and return the mean hypoxic radii (µm) while oxygen is low, and cells."""
    history = mc.run(setup(**changes)).history
    hours, radius = history["time"] / 3600.0, history["radius"]
    levels = np.array([level for _, level in MEDIA])
    medium = levels[np.searchsorted([begin for begin, _ in MEDIA], hours, side="right") - 1]
    found, exact = history["hypoxic_radius_oxygen"], closed_form(radius, history["cells"], medium)
    figure = Figure(figsize=(7.0, 4.0), layout="constrained")
    axes = figure.subplots()
    axes.axvspan(MEDIA[1][0], MEDIA[2][0], color="0.92", label=f"{MEDIA[1][1]} mM in the medium")
    axes.plot(hours, radius, color="0.3", label="spheroid")
    axes.plot(hours, found, "o", markersize=3, color="#0072b2", label="hypoxic core")
    axes.plot(hours, exact, color="#e69f00", label="closed form")
    axes.set(xlabel="time (h)", ylabel="radius (µm)", ylim=(0, 1.4 * radius.max()))
    axes.legend(frameon=False, loc="upper left", ncols=2)
    folder = Path(output)
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "hypoxia_switched.png", dpi=150)
    low = (hours > MEDIA[1][0]) & (hours < MEDIA[2][0])
    outside = ~low & (hours != MEDIA[1][0]) & (hours != MEDIA[2][0])
    return {
        "hypoxic": float(found[low].mean()),
        "closed form": float(exact[low].mean()),
        "otherwise": float(found[outside].max()),
    }


if __name__ == "__main__":
    radii = main(*(sys.argv[1:2] or ["out/hypoxia_switched"]))
    print(", ".join(f"{name} {value:.1f} um" for name, value in radii.items()))
