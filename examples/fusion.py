"""Fusion of two spheroids: like drops of a liquid at first, then held by the cells' contacts
==========================================================================================

Problem
    Two balls of 150 cells touch. The tension of their surface pulls them together, cells move at
    random. How long they are over their width (square roots of second moments) is compared with
    two drops of a viscous liquid (Frenkel's problem, equation of Pokluda, Bellehumeur and
    Vlachopoulos 1997), from when they are as long as balls that touch. One time scale is fitted
    to the first half of the way.
Scaling
    A liquid ends as a ball, with a ratio of 1. Tissue of elastic cells has a yield stress: it
    stops earlier, the later the more its cells move.
Cost
    Ten seconds on one core.
Command
    .. code-block:: sh

        python examples/fusion.py [FOLDER]

    It writes FOLDER/fusion.png.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

import multicell as mc
from multicell.results.frame import Frame

COLOURS = ("#0072b2", "#e69f00")


def setup(**changes: Any) -> mc.Scene:
    """Return the scene but for its cells; arguments replace parts."""
    scene = {
        "title": "Two spheroids fuse",
        "duration": "12 h",
        "coupling_step": "10 min",
        "cells": {"young_variation": 0.0},
        "contact": {"surface_energy": "0.1 nN/um"},
        "surface": {"tension": "0.3 nN/um"},
        "motility": {"force": "0.4 nN", "persistence": "10 min"},
        "drag": {"viscosity": "0.5 kPa s"},
        "output": {"every": "20 min"},
    }
    return mc.Scene.from_dict(scene | changes)


def pair() -> dict[str, np.ndarray]:
    """Return two balls of cells that touch."""
    start = {"count": 150, "spacing": 0.9, "stage": "uniform"}
    ball = mc.run(mc.Scene.from_dict({"duration": "1 h", "initial": start})).frames[-1].cells
    place = ball.position - ball.position.mean(axis=0)
    aside = np.array([0.9 * (np.linalg.norm(place, axis=1) + ball.radius).max(), 0.0, 0.0])
    both = np.concatenate([place - aside, place * [-1.0, 1.0, 1.0] + aside])
    titles = ("position_x_um", "position_y_um", "position_z_um")
    return dict(zip(titles, both.T, strict=True)) | {"radius_um": np.tile(ball.radius, 2)}


def aspect(frame: Frame) -> float:
    """Return the length of all cells together over their width."""
    away = frame.cells.position - frame.cells.position.mean(axis=0)
    second, first, longest = np.linalg.eigvalsh(np.cov(away.T))
    return float(np.sqrt(longest / np.sqrt(first * second)))


def drops(time: np.ndarray) -> np.ndarray:
    """Return the same of two drops; time over radius times viscosity over tension.

    The angle θ of the neck grows from 0 to a right one; each drop is a ball without a cap.
    """

    def turn(_: float, angle: np.ndarray) -> np.ndarray:
        c, s = np.cos(angle), np.sin(angle)
        shape = 2.0 ** (-5 / 3) * c * s * (2 - c) ** (1 / 3)
        return shape / ((1 - c) * (1 + c) ** (1 / 3))

    angle = solve_ivp(turn, (0.0, float(time[-1])), [0.02], t_eval=time, rtol=1e-8).y[0]
    c = np.minimum(np.cos(angle), 1.0)
    # second moments of a ball cut off at c from its centre, seen from there, in radii
    x = np.linspace(-1.0, c, 400)  # (400, times), in radii
    slices = 1.0 - x**2
    return np.sqrt(((x - c) ** 2 * slices).sum(axis=0) / (slices**2 / 4.0).sum(axis=0))


def main(output: str | Path, **changes: Any) -> dict[str, float]:
    """Run, draw, and return the last ratios of length to width, and the time scale in h."""
    run = mc.run(setup(**changes), cells=pair())
    hours = np.array([frame.time for frame in run.frames]) / 3600.0
    long = np.array([aspect(frame) for frame in run.frames])
    touching, half = np.sqrt(1.2 / 0.2), 0.5 * (long[0] + long.min())
    k = int(np.argmax(long < touching))  # the first frame in which they are one body
    begin = np.interp(-touching, -long[k - 1 : k + 1], hours[k - 1 : k + 1])
    since = np.append(0.0, hours[k:] - begin)
    first = np.arange(1, 2 + int(np.argmax(long[k:] < half)))  # to beyond half of the way

    def amiss(scale: float) -> float:
        return float(((drops(since / np.exp(scale))[first] - long[k - 1 + first]) ** 2).sum())

    scale = float(np.exp(minimize_scalar(amiss, bounds=(-4.0, 3.0), method="bounded").x))
    liquid = drops(since / scale)
    figure = Figure(figsize=(10.0, 3.8), layout="constrained")
    curve, *pictures = figure.subplots(1, 3)
    curve.plot(hours, long, "o", markersize=3, color="#0072b2", label="tissue")
    curve.plot(since + begin, liquid, color="#e69f00", label="two drops of a liquid")
    curve.set(xlabel="time (h)", ylabel="length / width", ylim=(0.8, None))
    curve.legend(frameon=False)
    for axes, frame in zip(pictures, (run.frames[0], run.frames[-1]), strict=True):
        cells = frame.cells
        for k in np.argsort(cells.position[:, 2]):
            colour = COLOURS[int(cells.id[k] >= 150)]
            axes.add_patch(
                Circle(cells.position[k, :2], cells.radius[k], fc=colour, ec="w", lw=0.5)
            )
        axes.set(title=f"{frame.time / 3600.0:.0f} h", xlim=(-55, 55), ylim=(-40, 40))
        axes.set(aspect="equal", xlabel="x (µm)")
    folder = Path(output)
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "fusion.png", dpi=150)
    return {"tissue": float(long[-1]), "liquid": float(liquid[-1]), "scale": scale}


if __name__ == "__main__":
    found = main(*(sys.argv[1:2] or ["out/fusion"]))
    print(f"length / width {found['tissue']:.2f}, of a liquid {found['liquid']:.2f}")
