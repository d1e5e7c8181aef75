"""Front of a monolayer: exponential growth first, then a front of constant speed
==============================================================================

Problem
    One cell grows to a monolayer of 2,000 (the scene ``openvt-monolayer``) whose cells grow the
    more slowly the higher their pressure. Early, their number follows an unlimited population,
    whose rate k follows from the cycle times (Euler-Lotka equation: 0.729 over the mean cycle).
    Later only the edge grows. Then the balance of area gives the speed of the front from the
    pressures p of single cells::

        2 pi R dR/dt = sum of k (1 - p / p_c) A over all cells

    with the areas A that share the monolayer, and no negative growth.
Scaling
    The speed goes with the width of the growing edge, which goes with the critical pressure.
Cost
    Half a minute on one core.
Command
    .. code-block:: sh

        python examples/monolayer_front.py [FOLDER]

    It writes FOLDER/monolayer_front.png.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import multicell as mc

CRITICAL = 0.003  # kPa
RATE = 0.729 / 5.0  # of an unlimited population, 1/h


def setup(**changes: Any) -> mc.Scene:
    """Return the scene; arguments are changes by dotted keys."""
    return mc.load_scene("openvt-monolayer").with_changes(
        {
            "growth.critical_pressure": CRITICAL,
            "duration": "95 h",
            "stop_cells": 2200,
            "output.every": "5 h",
            **changes,
        }
    )


def main(output: str | Path, **changes: Any) -> dict[str, float]:
    """Run, draw, and return the speeds of the front (µm/h) and early rates (1/h)."""
    run = mc.run(setup(**changes))
    hours = run.history["time"] / 3600.0
    radius, cells = run.history["radius"], run.history["cells"]
    early, late = (cells > 16) & (cells < 64), hours > hours[-1] - 30.0
    speed = np.polyfit(hours[late], radius[late], 1)[0]
    rate = np.polyfit(hours[early], np.log(cells[early]), 1)[0]
    balance = []
    for frame in run.frames:
        if frame.time / 3600.0 > hours[-1] - 30.0:
            outer = np.interp(frame.time / 3600.0, hours, radius)
            area = frame.cells.radius**2 / (frame.cells.radius**2).sum() * np.pi * outer**2
            free = np.maximum(1.0 - np.maximum(frame.cells.pressure, 0.0) / CRITICAL, 0.0)
            balance.append(RATE * float((free * area).sum()) / (2.0 * np.pi * outer))
    figure = Figure(figsize=(9.0, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.semilogy(hours, cells, color="#0072b2", label="cells")
    middle = np.log(cells[early]).mean() - RATE * hours[early].mean()
    left.semilogy(hours, np.exp(middle + RATE * hours), color="0.4", ls="--", label="unlimited")
    left.set(xlabel="time (h)", ylabel="cells", ylim=(1, 3.0 * cells.max()))
    left.legend(frameon=False)
    right.plot(hours, radius, color="#0072b2", label="radius")
    slope = float(np.mean(balance))
    line = radius[late].mean() + slope * (hours[late] - hours[late].mean())
    right.plot(hours[late], line, color="#e69f00", ls="--", label="balance of area")
    right.set(xlabel="time (h)", ylabel="radius (µm)", ylim=(0, None))
    right.legend(frameon=False)
    folder = Path(output)
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "monolayer_front.png", dpi=150)
    return {"speed": float(speed), "balance": slope, "rate": float(rate), "unlimited": RATE}


if __name__ == "__main__":
    for name, value in main(*(sys.argv[1:2] or ["out/monolayer_front"])).items():
        print(f"{name}: {value:.3f}")
