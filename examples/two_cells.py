"""Two overlapping cells relax to their equilibrium distance: three integrations
=============================================================================

Problem
    Two cells of radius 10 um, released at a distance of 12 um, in a medium of 5 kPa s. Only
    their distance d changes: dd/dt = 2 F(20 um - d) / (6 pi eta r). Integrated by CVODE,
    by explicit Euler, and by SciPy's Radau, which gets the equation written out here.
Scaling
    Relaxation time 188 s at the equilibrium distance of 17.178 um; one hour is 19 of them.
Cost
    A few seconds, nearly all of it to load libraries.
Command
    .. code-block:: sh

        python examples/two_cells.py [FOLDER]

    It writes FOLDER/two_cells.png.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import multicell as mc
from multicell.scene.scene import Scene

RADIUS, YOUNG, POISSON, SURFACE_ENERGY, VISCOSITY = 10.0, 1.0, 0.5, 0.1, 5.0
START = 12.0
"""Distance at which the cells are released, um."""


def setup(method: str = "cvode", **integrator: Any) -> Scene:
    """Return the scene for a method; further arguments are keys of the integrator's table."""
    return Scene.from_dict(
        {
            "title": "Two cells relax",
            "duration": "1 h",
            "coupling_step": "1 min",
            "initial": {"count": 2, "spacing": START / (2.0 * RADIUS)},
            # cells start at half of the volume at which they would divide
            "cells": {
                "division_radius": RADIUS * 2.0 ** (1.0 / 3.0),
                "young": YOUNG,
                "young_variation": 0.0,
                "poisson": POISSON,
            },
            "contact": {"law": "jkr", "surface_energy": SURFACE_ENERGY},
            "drag": {"viscosity": VISCOSITY},
            "integrator": {"method": method, "atol": 1e-4, "step": "10 s"} | integrator,
            "output": {"every": "1 min"},
        }
    )


def distances(scene: Scene) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the times (s) of the frames of a run and the distance of the cells (um) at them."""
    frames = mc.run(scene).frames
    time = np.array([frame.time for frame in frames])
    apart = [np.diff(frame.cells.position, axis=0)[0] for frame in frames]
    return time, np.linalg.norm(apart, axis=1)


def reference(time: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distance (um) at times (s), by SciPy and the equations of the model page."""
    from scipy.integrate import solve_ivp

    modulus = 1.0 / (2.0 * 0.75 * (1.0 - POISSON**2) / YOUNG)
    radius = RADIUS / 2.0
    drag = 6.0 * np.pi * VISCOSITY * RADIUS

    def speed(_: float, distance: NDArray[np.float64]) -> NDArray[np.float64]:
        h = np.maximum(2.0 * RADIUS - distance, 0.0)
        adhesion = np.sqrt(6.0 * np.pi * SURFACE_ENERGY * modulus * (radius * h) ** 1.5)
        return 2.0 * (modulus * np.sqrt(radius) * h**1.5 - adhesion) / drag

    span = (float(time[0]), float(time[-1]))
    solution = solve_ivp(speed, span, [START], "Radau", t_eval=time, rtol=1e-10, atol=1e-10)
    return np.asarray(solution.y[0])


def main(output: str | Path) -> dict[str, float]:
    """Draw distance and error against time; return each method's largest error in um."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 6.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    errors = {}
    for method, colour in (("cvode", "tab:blue"), ("euler", "tab:orange")):
        time, distance = distances(setup(method))
        exact = reference(time)
        errors[method] = float(np.abs(distance - exact).max())
        upper.plot(time / 60.0, distance, "o", color=colour, markersize=4, label=method)
        # the first frame is the start itself: its error of zero has no place on a log scale
        lower.semilogy(time[1:] / 60.0, np.abs(distance - exact)[1:], color=colour, label=method)
    upper.plot(time / 60.0, exact, color="black", linewidth=1, label="SciPy")
    upper.set(ylabel="distance of the centres (µm)")
    lower.set(xlabel="time (min)", ylabel="|difference to SciPy| (µm)")
    upper.legend(frameon=False)
    folder = Path(output)
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "two_cells.png", dpi=150)
    return errors


if __name__ == "__main__":
    for name, error in main(*(sys.argv[1:2] or ["out/two_cells"])).items():
        print(f"{name:6s} largest difference to SciPy: {error:.2g} um")
