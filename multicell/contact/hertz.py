"""Elastic spheres that do not stick (Hertz 1882; eq. 3.2)."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, final

import numpy as np
from numpy.typing import ArrayLike

from multicell.contact.exact_jkr import contact_radius
from multicell.contact.jkr import _jkr_energy, _jkr_force, _jkr_stiffness
from multicell.schema import parameters

if TYPE_CHECKING:
    from multicell.cells import FloatArray


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
