"""Two cells with all that pulls and pushes them along the line of their centres."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from multicell.cells import FloatArray
from multicell.contact.law import PairLaw

_POINTS = 401  # overlaps in a bracket: each zoom narrows it 200 times
_ZOOMS = 8  # 200^8 is far beyond double precision
_ITERATIONS = 100  # as many bisections as narrow any interval to rounding; Newton takes eight
_ROUNDING = 4e-16  # two units in the last place


@final
@dataclass(frozen=True)
class Pair:
    """Two cells with all that pulls and pushes them along the line of their centres.

    - ``law``: contact law, with the surface energy of these two types
    - ``modulus``, ``radius``, ``rest``, float: E_ij in kPa, r_ij and r_i + r_j in µm
    - ``bonds``, float, kPa: adhesive force per contact area of receptors and ligands (eq. 3.7).
    """

    law: PairLaw
    modulus: float
    radius: float
    rest: float
    bonds: float = 0.0

    def force(self, overlap: ArrayLike) -> FloatArray:
        """Return the force in nN of a pair in contact at overlaps in µm."""
        force, _, _ = self.law.evaluate(
            overlap, self.modulus, self.radius, rest=self.rest, touching=True
        )
        return np.asarray(force - math.pi * self.radius * self.bonds * np.maximum(overlap, 0.0))

    def stiffness(self, overlap: float) -> float:
        """Return dF/dh in nN/µm of a pair in contact."""
        _, slope, _ = self.law.evaluate(
            overlap, self.modulus, self.radius, rest=self.rest, touching=True
        )
        return float(slope) - math.pi * self.radius * self.bonds * (overlap > 0.0)

    def reach(self) -> float:
        """Return how far beyond first contact the force can act, µm."""
        return float(self.law.reach(self.modulus, self.radius, rest=self.rest))

    def equilibrium_overlap(self) -> float:
        """Return the largest overlap without force in µm; bonds make it larger than the law's."""
        return float(rest_overlap(self.law, self.modulus, self.radius, self.rest, self.bonds))

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


def rest_overlap(
    law: PairLaw, modulus: ArrayLike, radius: ArrayLike, rest: ArrayLike, bonds: ArrayLike
) -> FloatArray:
    """Return the largest overlap without force of pairs in contact, µm; shapes broadcast.

    By Newton's method from above, kept in a bracket by bisection.

    - ``modulus``, ``radius``, ``rest``, ``bonds``: see :class:`Pair`
    """
    arrays = [np.asarray(part, dtype=float) for part in (modulus, radius, rest, bonds)]
    modulus, radius, rest, bonds = np.broadcast_arrays(*arrays)
    without = np.broadcast_to(law.equilibrium_overlap(modulus, radius), rest.shape)
    if not bonds.any():
        return np.array(without)

    def net(overlap: FloatArray) -> tuple[FloatArray, FloatArray]:
        force, slope, _ = law.evaluate(overlap, modulus, radius, rest=rest, touching=True)
        pull = math.pi * radius * bonds
        return force - pull * np.maximum(overlap, 0.0), slope - pull

    low, high = without, np.maximum(without, 1e-6 * rest)
    most = (1.0 - 1e-9) * rest  # the centres meet there, and no law is defined beyond
    while (more := (net(high)[0] < 0.0) & (high < most)).any():
        high = np.where(more, np.minimum(2.0 * high, most), high)
    x = high
    for _ in range(_ITERATIONS):
        force, slope = net(x)
        low, high = np.where(force < 0.0, x, low), np.where(force < 0.0, high, x)
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = x - force / slope
        inside = (newton >= low) & (newton <= high)
        before, x = x, np.where(inside, newton, 0.5 * (low + high))
        if (np.abs(x - before) <= _ROUNDING * rest).all():
            break
    return np.where(bonds > 0.0, x, without)
