"""What two cells of a scene do to each other, before anything is run."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numpy.typing import ArrayLike

from multicell import celltypes
from multicell.cells import FloatArray
from multicell.contact import PairLaw, effective_modulus, effective_radius

if TYPE_CHECKING:
    from multicell.scene import Scene

_POINTS = 401
_ZOOMS = 8


@final
@dataclass(frozen=True)
class Pair:
    """Two cells with all that pulls and pushes them along the line of their centres.

    Attributes
    ----------
    law
        Contact law, with the surface energy of these two types.
    modulus, radius, rest : float
        E_ij in kPa, r_ij and r_i + r_j in µm.
    bonds : float, kPa
        Adhesive force per contact area of receptors and ligands (eq. 3.7).
    """

    law: PairLaw
    modulus: float
    radius: float
    rest: float
    bonds: float = 0.0

    def force(self, overlap: ArrayLike) -> FloatArray:
        """Return the force in nN of a pair in contact at overlaps in µm."""
        force = self.law.force(overlap, self.modulus, self.radius, rest=self.rest, touching=True)
        return np.asarray(force - math.pi * self.radius * self.bonds * np.maximum(overlap, 0.0))

    def stiffness(self, overlap: float) -> float:
        """Return dF/dh in nN/µm of a pair in contact."""
        slope = self.law.stiffness(
            overlap, self.modulus, self.radius, rest=self.rest, touching=True
        )
        return float(slope) - math.pi * self.radius * self.bonds * (overlap > 0.0)

    def reach(self) -> float:
        """Return how far beyond first contact the force can act, µm."""
        return float(self.law.reach(self.modulus, self.radius, rest=self.rest))

    def equilibrium_overlap(self) -> float:
        """Return the largest overlap without force in µm; bonds make it larger than the law's."""
        low = float(self.law.equilibrium_overlap(self.modulus, self.radius))
        if self.bonds == 0.0:
            return low
        high = max(low, 1e-6 * self.rest)
        most = (1.0 - 1e-9) * self.rest  # there the centres meet, and no law goes on
        while self.force(high) < 0.0 and high < most:
            high = min(2.0 * high, most)
        for _ in range(100):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.force(middle) < 0.0 else (low, middle)
        return 0.5 * (low + high)

    def distance(self) -> float:
        """Return the distance of the centres in equilibrium, µm."""
        return self.rest - self.equilibrium_overlap()

    def deepest(self) -> tuple[float, float]:
        """Return the strongest attraction in nN, as a positive number, and its overlap in µm.

        It is the least load that separates the pair: (3/2) π σ r_ij for a law with a surface
        energy, which a test confirms, and zero where nothing sticks.
        """
        low, high = -self.reach(), self.equilibrium_overlap()
        overlap = np.linspace(low, high, _POINTS)
        for _ in range(_ZOOMS):
            place = int(np.argmin(self.force(overlap)))
            low, high = overlap[max(place - 1, 0)], overlap[min(place + 1, _POINTS - 1)]
            overlap = np.linspace(low, high, _POINTS)
        force = self.force(overlap)
        place = int(np.argmin(force))
        return max(-float(force[place]), 0.0), float(overlap[place])


def birth_radius(scene: Scene) -> float:
    """Return the radius of a cell of half the division volume, µm."""
    return float(scene.cells.division_radius / np.cbrt(2.0))


def typical_radius(scene: Scene) -> float:
    """Return the radius half-way (geometrically) between birth and division, µm.

    Where all cells are as at birth and none grows, it is the birth radius.
    """
    if scene.growth is None and scene.initial.stage == "birth":
        return birth_radius(scene)
    return math.sqrt(birth_radius(scene) * scene.cells.division_radius)


def drag(scene: Scene, radius: float) -> float:
    """Return the Stokes drag 6πηr of a cell in nN·s/µm."""
    return 6.0 * math.pi * scene.drag.viscosity * radius


def daughters_stiffness(scene: Scene) -> float:
    """Return dF/dh in nN/µm of two daughters that have just separated.

    They stand at ±r(1 - 2^(-1/3)) about the centre of their mother of radius r.
    """
    mother, daughter = scene.cells.division_radius, birth_radius(scene)
    overlap = 2.0 * daughter - 2.0 * (mother - daughter)
    return max(pair.stiffness(overlap) for _, pair in pairs(scene, daughter))


def pairs(scene: Scene, radius: float, time: float = 0.0) -> Iterator[tuple[str, Pair]]:
    """Yield the name and the pair of equal cells for every two types of a scene.

    The name is empty where all cells are alike, else for example ``"cohesive-loose"``.
    """
    names = list(scene.types)
    for i, j in combinations_with_replacement(range(max(len(names), 1)), 2):
        label = f"{names[i]}-{names[j]}" if names else ""
        yield label, pair_of(scene, i, j, radius, radius, time)


def pair_of(
    scene: Scene,
    i: int,
    j: int,
    radius_i: float,
    radius_j: float,
    time: float = 0.0,
    young: tuple[float, float] | None = None,
) -> Pair:
    """Return a pair.

    Parameters
    ----------
    scene
        What there is.
    i, j
        Index of the cells' types; without effect where the scene has no types.
    radius_i, radius_j
        Radii of the cells, µm.
    time
        Time in s at which receptors and ligands are taken.
    young
        Young's moduli in kPa, by default the means of the types.
    """
    law: Any = scene.contact
    kinds = list(scene.types.values())
    energies = celltypes.surface_energies(scene)
    if energies is not None:
        law = replace(law, surface_energy=float(energies[i, j]))
    if young is None:
        means = [
            kinds[k].young or scene.cells.young if kinds else scene.cells.young for k in (i, j)
        ]
        young = (means[0], means[1])
    bonds = 0.0
    if scene.adhesion is not None:
        (receptor_i, ligand_i), (receptor_j, ligand_j) = (kinds[k].bonds(time) for k in (i, j))
        bonds = 0.5 * (receptor_i * ligand_j + ligand_i * receptor_j) * scene.adhesion.strength
    poisson = scene.cells.poisson
    return Pair(
        law,
        float(effective_modulus(young[0], poisson, young[1], poisson)),
        float(effective_radius(radius_i, radius_j)),
        radius_i + radius_j,
        bonds,
    )
