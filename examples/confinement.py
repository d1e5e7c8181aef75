"""Confinement: spheroids in elastic gels compared with the growth that pressure leaves them
=========================================================================================

Problem
    Twelve cells grow in a cavity of 12 um within a gel of 30 or 100 kPa (the scene ``confined``).
    They widen the cavity until the pressure stops them. Compared with
    the pressure of a cavity in a neo-Hookean medium, and with one equation for the volume V of all
    cells, which knows nothing of single cells::

        dV/dt = ln 2 / T (1 - p / p_c) V,    p = P(R) / phi,    V = phi 4/3 pi R^3

    P(R) is the closed form, p_c the critical pressure, T the cycle time. The fraction of the
    cavity that cells fill, phi, is that of the run at its end.
Scaling
    The stiffer the gel, the earlier growth stops: a gel presses with at most 5/6 of its modulus.
Cost
    Forty seconds on one core. It is not run in the documentation, which is to be built quickly.
Command
    .. code-block:: sh

        python examples/confinement.py [FOLDER]

    It writes FOLDER/confinement.png.
"""

# sphinx_gallery_thumbnail_path = 'figures/confinement.png'

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.integrate import solve_ivp

import multicell as mc

REST = 12.0  # radius of the cavity without pressure, µm


def pressure(radius: np.ndarray, stiffness: float) -> np.ndarray:
    """Return the pressure (kPa) of a gel of a Young's modulus (kPa) on a widened cavity."""
    stretch = np.maximum(radius / REST, 1.0)
    return stiffness / 3.0 * (2.5 - 2.0 / stretch - 0.5 / stretch**4)


def predicted(time: np.ndarray, volume: float, filled: float, stiffness: float) -> np.ndarray:
    """Return the radius (µm) at times (s) by the equation for the volume (µm³) of all cells."""
    growth = mc.load_scene("confined").growth
    assert growth is not None
    assert growth.critical_pressure is not None
    rate, critical = np.log(2.0) / growth.cycle_time, growth.critical_pressure

    def radius(total: np.ndarray) -> np.ndarray:
        return np.maximum(np.cbrt(total / (filled * 4.0 / 3.0 * np.pi)), REST)

    def grow(_: float, total: np.ndarray) -> np.ndarray:
        part = 1.0 - pressure(radius(total), stiffness) / (filled * critical)
        return rate * np.maximum(part, 0.0) * total

    span = float(time[0]), float(time[-1])
    return radius(solve_ivp(grow, span, [volume], t_eval=time, rtol=1e-8).y[0])


def main(output: str | Path, **changes: Any) -> dict[float, tuple[float, float]]:
    """Run, draw, and return the last radii by stiffness: of the run and of the equation, µm."""
    figure = Figure(figsize=(9.0, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    found = {}
    for stiffness, colour in ((30.0, "#0072b2"), (100.0, "#e69f00")):
        scene = mc.load_scene("confined").with_changes(
            {"duration": "2.5 d", "coupling_step": "1 h"}
        )
        run = mc.run(scene.with_changes({"domain.stiffness": stiffness, **changes}))
        time, radius = run.history["time"], run.history["domain_radius"]
        start = 4.0 / 3.0 * np.pi * float((run.frames[0].cells.radius ** 3).sum())
        line = predicted(time, start, float(run.history["volume_fraction"][-1]), stiffness)
        left.plot(time / 86400.0, radius, "o", markersize=3, color=colour)
        left.plot(time / 86400.0, line, color=colour, label=f"gel of {stiffness:g} kPa")
        right.plot(radius / REST, run.history["wall_pressure"], "o", markersize=3, color=colour)
        wide = np.linspace(REST, radius.max(), 100)
        right.plot(wide / REST, pressure(wide, stiffness), color=colour)
        found[stiffness] = float(radius[-1]), float(line[-1])
    left.set(xlabel="time (d)", ylabel="radius of the cavity (µm)", title="dots: runs, lines: V(t)")
    left.legend(frameon=False)
    right.set(xlabel="radius / radius at rest", ylabel="pressure (kPa)", title="lines: neo-Hookean")
    folder = Path(output)
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "confinement.png", dpi=150)
    return found


if __name__ == "__main__":
    for gel, (ours, line) in main(*(sys.argv[1:2] or ["out/confinement"])).items():
        print(f"gel of {gel:g} kPa: {ours:.1f} um, equation {line:.1f} um")
