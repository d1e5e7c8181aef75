"""Force between two adhesive elastic cells against their distance, for four parameter sets
========================================================================================

Problem
    Two cells of radius 10 um; approximate JKR law with E = 1 kPa, Poisson ratio 0.5 and
    surface energy 0.1 nN/um (black), and with one parameter changed: Poisson ratio 0.75
    (blue; no isotropic solid has it, it serves comparison with the published figure),
    E = 2 kPa (red), surface energy 0.2 nN/um (green).
Scaling
    None: 4 x 8001 evaluations of a closed form.
Cost
    About a second, nearly all of it to load matplotlib.
Command
    .. code-block:: sh

        python examples/jkr_curves.py [FOLDER]

    It writes FOLDER/jkr_curves.png.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import final

import numpy as np
from numpy.typing import NDArray

from multicell.contact.jkr import JKR
from multicell.contact.law import effective_modulus, effective_radius

RADIUS = 10.0
"""Radius of both cells, um."""


@final
@dataclass(frozen=True)
class Curve:
    """One parameter set: its label and colour, E in kPa, Poisson ratio, and the law."""

    label: str
    colour: str
    young: float = 1.0
    poisson: float = 0.5
    law: JKR = JKR(surface_energy=0.1)  # noqa: RUF009 - a law is immutable

    @property
    def pair(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Effective modulus (kPa) and effective radius (um) of two such cells."""
        modulus = effective_modulus(self.young, self.poisson, self.young, self.poisson)
        return modulus, effective_radius(RADIUS, RADIUS)

    def force(self, distance: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the force in nN at centre distances in um, positive where it repels."""
        return self.law.force(2.0 * RADIUS - distance, *self.pair)

    def equilibrium(self) -> float:
        """Return the centre distance without force, um."""
        return 2.0 * RADIUS - float(self.law.equilibrium_overlap(*self.pair))


def setup(**changes: float) -> list[Curve]:
    """Return the four curves; ``young`` or ``poisson`` replace the values of the first one."""
    return [
        Curve("E = 1 kPa, ν = 0.5, σ = 0.1 nN/µm", "black", **changes),
        Curve("ν = 0.75", "tab:blue", poisson=0.75),
        Curve("E = 2 kPa", "tab:red", young=2.0),
        Curve("σ = 0.2 nN/µm", "tab:green", law=JKR(surface_energy=0.2)),
    ]


def main(output: str | Path) -> dict[str, tuple[float, float]]:
    """Draw the curves; return equilibrium distance (um) and deepest attraction (nN) by label."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 5.0), layout="constrained")
    whole = figure.subplots()
    near = whole.inset_axes((0.52, 0.5, 0.45, 0.34))
    distance = np.linspace(0.0, 2.0 * RADIUS, 8001)
    results = {}
    for curve in setup():
        force = curve.force(distance)
        results[curve.label] = curve.equilibrium(), float(force.min())
        for axes in (whole, near):
            axes.plot(distance, force, color=curve.colour, label=curve.label)
            axes.plot(curve.equilibrium(), 0.0, "o", color=curve.colour, markersize=4)
    for axes in (whole, near):
        axes.axhline(0.0, color="0.7", linewidth=0.8, zorder=0)
    whole.set(xlim=(0, 20), ylim=(-50, 300))
    whole.set(xlabel="distance of the centres (µm)", ylabel="force (nN), repulsion positive")
    near.set(xlim=(14, 20), ylim=(-6, 6), title="where attraction is felt")
    near.title.set_fontsize("small")
    whole.legend(loc="upper right", frameon=False, ncols=2, fontsize="small")
    folder = Path(output)
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "jkr_curves.png", dpi=150)
    return results


if __name__ == "__main__":
    for label, (distance_um, depth) in main(*(sys.argv[1:2] or ["out/jkr_curves"])).items():
        print(f"{label:32s} equilibrium {distance_um:7.3f} um   deepest {depth:8.4f} nN")
