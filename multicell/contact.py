"""Pair laws of two elastic, sticky spheres, as frozen dataclasses with vectorised functions.

Conventions (equation numbers of the thesis that the model page cites): the overlap is
``h = r_i + r_j - distance`` (3.1), a positive force pushes the cells apart, and every law is
zero for ``h <= 0``. All functions broadcast over NumPy arrays.

The jitted twins of these laws stand in :mod:`multicell.kernels`; they are chosen by the
integer ``code`` of a law and are tested against the functions here.
"""

from __future__ import annotations

from typing import ClassVar, Protocol, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from multicell.parameters import parameters, quantity

FloatArray = NDArray[np.float64]


def compliance(young: ArrayLike, poisson: ArrayLike) -> FloatArray:
    """Return ¾ (1 - ν²) / E in 1/kPa: the sum over a pair is 1 / E_ij (eq. 3.3)."""
    return np.asarray(0.75 * (1.0 - np.square(poisson)) / np.asarray(young, dtype=float))


def effective_modulus(
    young_i: ArrayLike, poisson_i: ArrayLike, young_j: ArrayLike, poisson_j: ArrayLike
) -> FloatArray:
    """Return E_ij in kPa (eq. 3.3), which is 4/3 of the modulus E* of textbooks."""
    return np.asarray(1.0 / (compliance(young_i, poisson_i) + compliance(young_j, poisson_j)))


def effective_radius(radius_i: ArrayLike, radius_j: ArrayLike) -> FloatArray:
    """Return r_ij = r_i r_j / (r_i + r_j) in µm (eq. 3.4)."""
    ri, rj = np.asarray(radius_i, dtype=float), np.asarray(radius_j, dtype=float)
    return np.asarray(ri * rj / (ri + rj))


def contact_radius(overlap: ArrayLike, radius: ArrayLike) -> FloatArray:
    """Return the contact radius √(r_ij h) in µm that Hertz and approximate JKR assume."""
    return np.asarray(np.sqrt(np.maximum(overlap, 0.0) * np.asarray(radius, dtype=float)))


class PairLaw(Protocol):
    """What every pair law offers; see :class:`JKR` for shapes and units."""

    code: ClassVar[int]

    @property
    def adhesion(self) -> float:
        """√(6πσ), the adhesion constant that the kernels take."""

    def force(self, overlap: ArrayLike, modulus: ArrayLike, radius: ArrayLike) -> FloatArray:
        """Return the pair force in nN."""

    def stiffness(self, overlap: ArrayLike, modulus: ArrayLike, radius: ArrayLike) -> FloatArray:
        """Return dF/dh in nN/µm."""

    def energy(self, overlap: ArrayLike, modulus: ArrayLike, radius: ArrayLike) -> FloatArray:
        """Return the pair energy in fJ."""

    def equilibrium_overlap(self, modulus: ArrayLike, radius: ArrayLike) -> FloatArray:
        """Return the overlap without force in µm."""


@final
@parameters
class Hertz:
    """Elastic spheres without adhesion: F = E_ij √r_ij h^{3/2} (eq. 3.2)."""

    code: ClassVar[int] = 0

    @property
    def adhesion(self) -> float:
        """Zero: nothing sticks."""
        return 0.0

    def force(self, overlap: ArrayLike, modulus: ArrayLike, radius: ArrayLike) -> FloatArray:
        """Return the force in nN at an overlap (µm), E_ij (kPa) and r_ij (µm)."""
        return _jkr_force(overlap, modulus, radius, 0.0)

    def stiffness(self, overlap: ArrayLike, modulus: ArrayLike, radius: ArrayLike) -> FloatArray:
        """Return dF/dh in nN/µm."""
        return _jkr_stiffness(overlap, modulus, radius, 0.0)

    def energy(self, overlap: ArrayLike, modulus: ArrayLike, radius: ArrayLike) -> FloatArray:
        """Return the energy ∫F dh in fJ, zero out of contact."""
        return _jkr_energy(overlap, modulus, radius, 0.0)

    def equilibrium_overlap(self, modulus: ArrayLike, radius: ArrayLike) -> FloatArray:
        """Return zero: spheres that only repel rest at first contact (µm)."""
        return np.zeros(np.broadcast_shapes(np.shape(modulus), np.shape(radius)))


@final
@parameters
class JKR:
    """Approximate Johnson–Kendall–Roberts contact (eq. 3.6).

    F = E_ij √r_ij h^{3/2} - √(6πσ E_ij r_ij^{3/2} h^{3/2}). The stiffness tends to -∞ as
    h → 0⁺: the force is continuous but not Lipschitz where a contact forms or breaks.
    """

    code: ClassVar[int] = 1
    surface_energy: float = quantity(
        "nN/um", default=0.1, at_least=0.0, doc="Surface energy σ of a contact"
    )

    @property
    def adhesion(self) -> float:
        """√(6πσ) in (nN/µm)^½."""
        return float(np.sqrt(6.0 * np.pi * self.surface_energy))

    def force(self, overlap: ArrayLike, modulus: ArrayLike, radius: ArrayLike) -> FloatArray:
        """Return the force in nN at an overlap (µm), E_ij (kPa) and r_ij (µm)."""
        return _jkr_force(overlap, modulus, radius, self.adhesion)

    def stiffness(self, overlap: ArrayLike, modulus: ArrayLike, radius: ArrayLike) -> FloatArray:
        """Return dF/dh in nN/µm; unbounded below as h → 0⁺, zero for h <= 0."""
        return _jkr_stiffness(overlap, modulus, radius, self.adhesion)

    def energy(self, overlap: ArrayLike, modulus: ArrayLike, radius: ArrayLike) -> FloatArray:
        """Return U = (2/5) a h^{5/2} - (4/7) b h^{7/4} in fJ, zero out of contact."""
        return _jkr_energy(overlap, modulus, radius, self.adhesion)

    def equilibrium_overlap(self, modulus: ArrayLike, radius: ArrayLike) -> FloatArray:
        """Return h₀ = (6πσ √r_ij / E_ij)^{2/3} in µm, where the force is zero."""
        ratio = self.adhesion**2 * np.sqrt(radius) / np.asarray(modulus, dtype=float)
        return np.asarray(np.cbrt(ratio) ** 2)


LAWS: dict[str, type[Hertz] | type[JKR]] = {"hertz": Hertz, "jkr": JKR}
"""Pair laws by the name that a scene gives."""


def _constants(
    overlap: ArrayLike, modulus: ArrayLike, radius: ArrayLike, adhesion: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return h clamped to contact, a = E_ij √r_ij and b = √(6πσ E_ij r_ij^{3/2})."""
    modulus, radius = np.asarray(modulus, dtype=float), np.asarray(radius, dtype=float)
    elastic = modulus * np.sqrt(radius)
    return np.maximum(overlap, 0.0), elastic, adhesion * np.sqrt(elastic * radius)


def _jkr_force(
    overlap: ArrayLike, modulus: ArrayLike, radius: ArrayLike, adhesion: float
) -> FloatArray:
    h, a, b = _constants(overlap, modulus, radius, adhesion)
    return np.asarray(a * h**1.5 - b * h**0.75)


def _jkr_stiffness(
    overlap: ArrayLike, modulus: ArrayLike, radius: ArrayLike, adhesion: float
) -> FloatArray:
    h, a, b = _constants(overlap, modulus, radius, adhesion)
    touching = np.where(h > 0.0, h, 1.0)
    return np.where(h > 0.0, 1.5 * a * np.sqrt(touching) - 0.75 * b * touching**-0.25, 0.0)


def _jkr_energy(
    overlap: ArrayLike, modulus: ArrayLike, radius: ArrayLike, adhesion: float
) -> FloatArray:
    h, a, b = _constants(overlap, modulus, radius, adhesion)
    return np.asarray(0.4 * a * h**2.5 - (4.0 / 7.0) * b * h**1.75)
