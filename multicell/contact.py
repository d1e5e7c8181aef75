"""Pair laws of two elastic, sticky spheres, as frozen dataclasses with vectorised functions.

Conventions (equation numbers of the thesis that the model page cites): the overlap is
``h = r_i + r_j - distance`` (3.1) and a positive force pushes the cells apart. Hertz and
approximate JKR are zero for ``h <= 0``; :class:`~multicell.laws.ExactJKR` and the springs of
:mod:`multicell.springs` may act beyond. All functions broadcast over NumPy arrays.

Every law is called in the same way, ``law.force(overlap, modulus, radius)``, with two further
keywords that only some laws look at: ``rest``, the sum r_i + r_j of the radii, which the spring
laws of :mod:`multicell.springs` need, and ``touching``, whether the pair was in contact before,
which :class:`~multicell.laws.ExactJKR` needs.

The jitted twins of these laws stand in :mod:`multicell.kernels`; they are chosen by the
integer ``code`` of a law and are tested against the functions here.
"""

from __future__ import annotations

from typing import ClassVar, Protocol, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from multicell.laws import ExactJKR, contact_radius
from multicell.parameters import parameters, quantity
from multicell.springs import Cubic, GeneralisedLinear, Linear

__all__ = [
    "JKR",
    "LAWS",
    "Cubic",
    "ExactJKR",
    "GeneralisedLinear",
    "Hertz",
    "Linear",
    "PairLaw",
    "compliance",
    "contact_radius",
    "effective_modulus",
    "effective_radius",
]

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


class PairLaw(Protocol):
    """What every pair law offers, for pairs of unlike radius, E and ν.

    Shapes broadcast. Overlaps and lengths are in µm, ``modulus`` is E_ij in kPa (eq. 3.3),
    ``radius`` r_ij in µm (eq. 3.4). ``rest`` is r_i + r_j in µm and ``touching`` says whether the
    pair was in contact before; a law that needs neither accepts and ignores both.
    """

    code: ClassVar[int]

    @property
    def adhesion(self) -> float:
        """√(6πσ), the adhesion constant that the kernels take."""

    def force(
        self,
        overlap: ArrayLike,
        modulus: ArrayLike,
        radius: ArrayLike,
        *,
        rest: ArrayLike | None = None,
        touching: ArrayLike = False,
    ) -> FloatArray:
        """Return the pair force in nN, positive where it pushes apart."""

    def stiffness(
        self,
        overlap: ArrayLike,
        modulus: ArrayLike,
        radius: ArrayLike,
        *,
        rest: ArrayLike | None = None,
        touching: ArrayLike = False,
    ) -> FloatArray:
        """Return dF/dh in nN/µm."""

    def energy(
        self,
        overlap: ArrayLike,
        modulus: ArrayLike,
        radius: ArrayLike,
        *,
        rest: ArrayLike | None = None,
        touching: ArrayLike = False,
    ) -> FloatArray:
        """Return the pair energy in fJ: its slope dU/dh is the force."""

    def contact_radius(
        self,
        overlap: ArrayLike,
        modulus: ArrayLike,
        radius: ArrayLike,
        *,
        rest: ArrayLike | None = None,
        touching: ArrayLike = False,
    ) -> FloatArray:
        """Return the radius of the contact disc in µm, zero out of contact."""

    def equilibrium_overlap(self, modulus: ArrayLike, radius: ArrayLike) -> FloatArray:
        """Return the overlap without force in µm."""

    def reach(
        self, modulus: ArrayLike, radius: ArrayLike, *, rest: ArrayLike | None = None
    ) -> FloatArray:
        """Return how far beyond first contact the law can act, µm, at least zero.

        It never falls with ``radius`` and ``rest`` and never rises with ``modulus``, so that the
        extremes of a population bound it for all pairs.
        """


@final
@parameters
class Hertz:
    """Elastic spheres without adhesion: F = E_ij √r_ij h^{3/2} (eq. 3.2)."""

    code: ClassVar[int] = 0

    @property
    def adhesion(self) -> float:
        """Zero: nothing sticks."""
        return 0.0

    def force(
        self,
        overlap: ArrayLike,
        modulus: ArrayLike,
        radius: ArrayLike,
        *,
        rest: ArrayLike | None = None,
        touching: ArrayLike = False,
    ) -> FloatArray:
        """Return the force in nN at an overlap (µm), E_ij (kPa) and r_ij (µm)."""
        return _jkr_force(overlap, modulus, radius, 0.0, 0.0)

    def stiffness(
        self,
        overlap: ArrayLike,
        modulus: ArrayLike,
        radius: ArrayLike,
        *,
        rest: ArrayLike | None = None,
        touching: ArrayLike = False,
    ) -> FloatArray:
        """Return dF/dh in nN/µm."""
        return _jkr_stiffness(overlap, modulus, radius, 0.0, 0.0)

    def energy(
        self,
        overlap: ArrayLike,
        modulus: ArrayLike,
        radius: ArrayLike,
        *,
        rest: ArrayLike | None = None,
        touching: ArrayLike = False,
    ) -> FloatArray:
        """Return the energy ∫F dh in fJ, zero out of contact."""
        return _jkr_energy(overlap, modulus, radius, 0.0, 0.0)

    def equilibrium_overlap(self, modulus: ArrayLike, radius: ArrayLike) -> FloatArray:
        """Return zero: spheres that only repel rest at first contact (µm)."""
        return np.zeros(np.broadcast_shapes(np.shape(modulus), np.shape(radius)))

    def contact_radius(
        self,
        overlap: ArrayLike,
        modulus: ArrayLike,
        radius: ArrayLike,
        *,
        rest: ArrayLike | None = None,
        touching: ArrayLike = False,
    ) -> FloatArray:
        """Return the contact radius √(r_ij h) in µm of the Hertz picture."""
        return contact_radius(overlap, radius)

    def reach(
        self, modulus: ArrayLike, radius: ArrayLike, *, rest: ArrayLike | None = None
    ) -> FloatArray:
        """Return zero: nothing acts out of contact (µm)."""
        return np.zeros(np.broadcast_shapes(np.shape(modulus), np.shape(radius)))


@final
@parameters
class JKR:
    """Approximate Johnson–Kendall–Roberts contact (eq. 3.6).

    F = E_ij √r_ij h^{3/2} - √(6πσ E_ij r_ij^{3/2} h^{3/2}). The stiffness tends to -∞ as
    h → 0⁺: the force is continuous but not Lipschitz where a contact forms or breaks.

    With a ``smoothing`` length h_s > 0 the law is another model, "linear onset": below h_s the
    factor h^{3/4} of the adhesive part is h_s^{3/4} (5 s - s²) / 4 with s = h / h_s. It meets
    h^{3/4} in value and slope at h_s, and its slope stays finite at h = 0, so that the stiffness
    is at least -(5/4) b h_s^{-1/4}. Equilibrium does not change while h_s <= h₀, nor the deepest
    attraction while h_s <= h₀ / 2^{4/3}. With 0 the law is eq. 3.6, bit for bit.
    """

    code: ClassVar[int] = 1
    surface_energy: float = quantity(
        "nN/um", default=0.1, at_least=0.0, doc="Surface energy σ of a contact"
    )
    smoothing: float = quantity(
        "um",
        default=0.0,
        at_least=0.0,
        doc="Overlap below which adhesion sets in linearly; 0 is eq. 3.6",
    )

    @property
    def adhesion(self) -> float:
        """√(6πσ) in (nN/µm)^½."""
        return float(np.sqrt(6.0 * np.pi * self.surface_energy))

    def force(
        self,
        overlap: ArrayLike,
        modulus: ArrayLike,
        radius: ArrayLike,
        *,
        rest: ArrayLike | None = None,
        touching: ArrayLike = False,
    ) -> FloatArray:
        """Return the force in nN at an overlap (µm), E_ij (kPa) and r_ij (µm)."""
        return _jkr_force(overlap, modulus, radius, self.adhesion, self.smoothing)

    def stiffness(
        self,
        overlap: ArrayLike,
        modulus: ArrayLike,
        radius: ArrayLike,
        *,
        rest: ArrayLike | None = None,
        touching: ArrayLike = False,
    ) -> FloatArray:
        """Return dF/dh in nN/µm, zero for h <= 0.

        Without smoothing it is unbounded below as h → 0⁺.
        """
        return _jkr_stiffness(overlap, modulus, radius, self.adhesion, self.smoothing)

    def energy(
        self,
        overlap: ArrayLike,
        modulus: ArrayLike,
        radius: ArrayLike,
        *,
        rest: ArrayLike | None = None,
        touching: ArrayLike = False,
    ) -> FloatArray:
        """Return U = (2/5) a h^{5/2} - (4/7) b h^{7/4} in fJ, zero out of contact.

        Above a smoothing h_s the energy is higher by b h_s^{7/4} 5 / 168.
        """
        return _jkr_energy(overlap, modulus, radius, self.adhesion, self.smoothing)

    def equilibrium_overlap(self, modulus: ArrayLike, radius: ArrayLike) -> FloatArray:
        """Return the overlap in µm where the force is zero.

        It is h₀ = (6πσ √r_ij / E_ij)^{2/3} up to a smoothing of that length. Beyond, with
        k = (h_s / h₀)^{3/4} and x = √(h / h_s), it is the root of k x = (5 - x²) / 4.
        """
        ratio = self.adhesion**2 * np.sqrt(radius) / np.asarray(modulus, dtype=float)
        rest = np.asarray(np.cbrt(ratio) ** 2)
        if self.smoothing == 0.0:
            return rest
        k = (self.smoothing / np.where(rest > 0.0, rest, np.inf)) ** 0.75
        inside = self.smoothing * (2.5 / (k + np.sqrt(k * k + 1.25))) ** 2
        return np.where((rest > 0.0) & (rest < self.smoothing), inside, rest)

    def contact_radius(
        self,
        overlap: ArrayLike,
        modulus: ArrayLike,
        radius: ArrayLike,
        *,
        rest: ArrayLike | None = None,
        touching: ArrayLike = False,
    ) -> FloatArray:
        """Return the contact radius √(r_ij h) in µm of the Hertz picture."""
        return contact_radius(overlap, radius)

    def reach(
        self, modulus: ArrayLike, radius: ArrayLike, *, rest: ArrayLike | None = None
    ) -> FloatArray:
        """Return zero: nothing acts out of contact (µm)."""
        return np.zeros(np.broadcast_shapes(np.shape(modulus), np.shape(radius)))


LAWS: dict[str, type[PairLaw]] = {
    "hertz": Hertz,
    "jkr": JKR,
    "exact-jkr": ExactJKR,
    "linear": Linear,
    "cubic": Cubic,
    "generalised-linear": GeneralisedLinear,
}
"""Pair laws by the name that a scene gives."""


def _constants(
    overlap: ArrayLike, modulus: ArrayLike, radius: ArrayLike, adhesion: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return h clamped to contact, a = E_ij √r_ij and b = √(6πσ E_ij r_ij^{3/2})."""
    modulus, radius = np.asarray(modulus, dtype=float), np.asarray(radius, dtype=float)
    elastic = modulus * np.sqrt(radius)
    return np.maximum(overlap, 0.0), elastic, adhesion * np.sqrt(elastic * radius)


def _jkr_force(
    overlap: ArrayLike, modulus: ArrayLike, radius: ArrayLike, adhesion: float, smoothing: float
) -> FloatArray:
    h, a, b = _constants(overlap, modulus, radius, adhesion)
    onset = h**0.75
    if smoothing > 0.0:
        s = h / smoothing
        onset = np.where(s < 1.0, smoothing**0.75 * s * (1.25 - 0.25 * s), onset)
    return np.asarray(a * h**1.5 - b * onset)


def _jkr_stiffness(
    overlap: ArrayLike, modulus: ArrayLike, radius: ArrayLike, adhesion: float, smoothing: float
) -> FloatArray:
    h, a, b = _constants(overlap, modulus, radius, adhesion)
    touching = np.where(h > 0.0, h, 1.0)
    slope = 0.75 * b * touching**-0.25
    if smoothing > 0.0:
        s = h / smoothing
        slope = np.where(s < 1.0, b * smoothing**-0.25 * (1.25 - 0.5 * s), slope)
    return np.where(h > 0.0, 1.5 * a * np.sqrt(touching) - slope, 0.0)


def _jkr_energy(
    overlap: ArrayLike, modulus: ArrayLike, radius: ArrayLike, adhesion: float, smoothing: float
) -> FloatArray:
    h, a, b = _constants(overlap, modulus, radius, adhesion)
    sticky = (4.0 / 7.0) * b * h**1.75
    if smoothing > 0.0:
        s, scale = h / smoothing, b * smoothing**1.75
        inside = scale * s * s * (5.0 / 8.0 - s / 12.0)
        sticky = np.where(s < 1.0, inside, sticky - scale * (5.0 / 168.0))
    return np.asarray(0.4 * a * h**2.5 - sticky)
