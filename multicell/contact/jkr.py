"""Elastic, sticky spheres by the approximate law of Johnson, Kendall and Roberts (eq. 3.6)."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, final

import numpy as np
from numpy.typing import ArrayLike

from multicell.contact.exact_jkr import contact_radius
from multicell.schema import parameters, quantity

if TYPE_CHECKING:
    from multicell.cells import FloatArray


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
