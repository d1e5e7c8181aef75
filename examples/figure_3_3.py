"""Two adhesive spheres pushed together, at rest and pulled apart, to scale with their forces
==========================================================================================

Problem
    Two cells of radius 10 um (or unlike ones) under the approximate JKR law with E = 1 kPa,
    Poisson ratio 0.5 and surface energy 0.1 nN/um. At rest the elastic force and the
    adhesion of each cell cancel. At shorter distance the elastic force is larger, at longer
    distance adhesion.
Scaling
    None: three evaluations of a closed form. Lengths are to scale, in um; arrows are to one
    scale of force in all panels.
Cost
    About a second, nearly all of it to load matplotlib.
Command
    .. code-block:: sh

        python examples/figure_3_3.py [FOLDER]

    It writes FOLDER/figure_3_3.png.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np
from matplotlib.figure import Figure

from multicell.contact.hertz import Hertz
from multicell.contact.jkr import JKR
from multicell.contact.law import effective_modulus, effective_radius
from multicell.report.plots.style import BLUE, INK, QUIET, RED, styled

LENGTH_OF_FORCE = 0.62
"""Length of the arrow for 1 nN, um."""
SKINS = ("#f6d9b4", "#cfe3ef")
"""Fill of the first and of the second cell."""


@final
@dataclass(frozen=True)
class Doublet:
    """Two cells of given radii (um) at a given distance of their centres (um)."""

    radii: tuple[float, float]
    distance: float
    modulus: float
    law: JKR

    @property
    def overlap(self) -> float:
        """Overlap h, um."""
        return sum(self.radii) - self.distance

    @property
    def plane(self) -> float:
        """Where the contact plane cuts the axis, as distance from the first centre, um."""
        ri, rj = self.radii
        return (self.distance**2 + ri**2 - rj**2) / (2.0 * self.distance)

    @property
    def half_chord(self) -> float:
        """Radius of the circle in which the two drawn spheres cut each other, um."""
        return float(np.sqrt(self.radii[0] ** 2 - self.plane**2))

    @property
    def contact_radius(self) -> float:
        """Contact radius √(r_ij h) that the law assumes, um."""
        radius = effective_radius(*self.radii)
        return float(self.law.contact_radius(self.overlap, self.modulus, radius))

    @property
    def parts(self) -> tuple[float, float]:
        """Elastic force and adhesion, nN; their sum is the force of the law."""
        radius = effective_radius(*self.radii)
        elastic = float(Hertz().force(self.overlap, self.modulus, radius))
        return elastic, float(self.law.force(self.overlap, self.modulus, radius)) - elastic


def setup(
    radii: tuple[float, float] = (10.0, 10.0),
    young: float = 1.0,
    poisson: float = 0.5,
    surface_energy: float = 0.1,
) -> dict[str, Doublet]:
    """Return the pair in three positions: 1.2 um closer than at rest, at rest, 1.7 um further."""
    law = JKR(surface_energy=surface_energy)
    modulus = float(effective_modulus(young, poisson, young, poisson))
    overlap = float(law.equilibrium_overlap(modulus, effective_radius(*radii)))
    return {
        title: Doublet(radii, sum(radii) - overlap + shift, modulus, law)
        for title, shift in (("Pushed together", -1.2), ("At rest", 0.0), ("Pulled apart", 1.7))
    }


@styled
def draw(doublets: dict[str, Doublet]) -> Figure:
    """Return the figure."""
    figure = Figure(figsize=(15.0, 5.6), dpi=120)
    figure.text(0.02, 0.935, "Two cells under JKR contact", fontsize=16, weight="bold")
    figure.text(
        0.02,
        0.88,
        "Lengths to scale. Blue: elastic repulsion, red: adhesion, on each cell; "
        "dark: their sum, where it is not zero. Black line: contact plane.",
        color=QUIET,
    )
    for panel, (title, doublet) in enumerate(doublets.items()):
        axes = figure.add_axes((0.015 + 0.33 * panel, 0.0, 0.31, 0.83))
        _panel(axes, title, doublet, max(d.distance for d in doublets.values()))
        if panel == 0:
            _scale(axes, axes.get_xlim()[0] + 0.6, -max(doublet.radii) + 1.0, 5.0)
    return figure


def _panel(axes: Any, title: str, doublet: Doublet, widest: float) -> None:
    from matplotlib.patches import Circle

    ri, rj = doublet.radii
    left, right = -doublet.plane, doublet.distance - doublet.plane
    for centre, radius, skin in ((left, ri, SKINS[0]), (right, rj, SKINS[1])):
        axes.add_patch(Circle((centre, 0), radius, facecolor=skin, edgecolor="none", alpha=0.75))
        axes.add_patch(Circle((centre, 0), radius, facecolor="none", edgecolor=QUIET, lw=1.2))
        axes.plot(centre, 0, "o", color=INK, markersize=4)
    axes.plot([0, 0], np.array([-1, 1]) * doublet.half_chord, color=INK, lw=2.2)
    low = -max(ri, rj)
    axes.plot([0, 0], [low - 0.6, -doublet.half_chord], color=QUIET, lw=0.8, ls=(0, (4, 3)))
    _forces(axes, doublet, left, right)
    _distance(axes, left, right, low - 1.6, f"distance {doublet.distance:.2f} µm")
    total = sum(doublet.parts)
    verb = "no net force" if abs(total) < 5e-3 else "they push" if total > 0 else "they pull"
    axes.set_title(f"{title}: {verb}", pad=4)
    half = 0.5 * widest + max(ri, rj) + 0.6
    axes.text(
        0,
        low - 4.4,
        f"overlap {doublet.overlap:.2f} µm    contact radius {doublet.contact_radius:.2f} µm\n"
        f"elastic {doublet.parts[0]:.2f} nN    adhesion {doublet.parts[1]:.2f} nN    "
        f"sum {total + 0.0:.2f} nN".replace("-", "−").replace("−0.00", "0.00"),
        ha="center",
        va="top",
        fontsize=11,
        linespacing=1.5,
    )
    axes.set(xlim=(-half, half), ylim=(low - 8.2, max(ri, rj) + 0.6), aspect="equal")
    axes.axis("off")


def _forces(axes: Any, doublet: Doublet, left: float, right: float) -> None:
    """Draw elastic force, adhesion and their sum on both cells, from the centres."""
    elastic, adhesion = doublet.parts
    arrows = [(elastic, 2.2, BLUE), (adhesion, -2.2, RED), (elastic + adhesion, 0.0, INK)]
    for centre, side in ((left, -1.0), (right, 1.0)):
        for force, height, colour in arrows:
            if abs(force) > 0.05:
                axes.annotate(
                    "",
                    (centre + side * LENGTH_OF_FORCE * force, height),
                    (centre, height),
                    arrowprops={
                        "arrowstyle": "-|>,head_length=0.5,head_width=0.25",
                        "color": colour,
                        "lw": 2.6,
                        "shrinkA": 0,
                        "shrinkB": 0,
                    },
                )


def _scale(axes: Any, x: float, y: float, force: float) -> None:
    """Draw the scale of the forces."""
    axes.plot([x, x + LENGTH_OF_FORCE * force], [y, y], color=INK, lw=2.6, solid_capstyle="butt")
    axes.text(x, y - 0.5, f"{force:g} nN", va="top", fontsize=10)


def _distance(axes: Any, left: float, right: float, height: float, words: str) -> None:
    arrow = {"arrowstyle": "<|-|>", "color": QUIET, "lw": 1.0, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", (left, height), (right, height), arrowprops=arrow)
    for x in (left, right):
        axes.plot([x, x], [0, height - 0.4], color=QUIET, lw=0.7, ls=(0, (2, 3)))
    axes.text(0.5 * (left + right), height - 0.4, words, ha="center", va="top", color=INK)


def main(output: str | Path) -> dict[str, Doublet]:
    """Draw the figure; return the pair in its three positions."""
    doublets = setup()
    folder = Path(output)
    folder.mkdir(parents=True, exist_ok=True)
    draw(doublets).savefig(folder / "figure_3_3.png")
    return doublets


if __name__ == "__main__":
    for name, pair in main(*(sys.argv[1:2] or ["out/figure_3_3"])).items():
        forces = "elastic {:7.4f} nN   adhesion {:8.4f} nN".format(*pair.parts)
        print(f"{name:16s} distance {pair.distance:7.4f} um   {forces}")
