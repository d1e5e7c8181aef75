"""Pair laws of two elastic, sticky spheres, as frozen dataclasses with vectorised functions.

Conventions (equation numbers of the thesis that the model page cites): the overlap is
``h = r_i + r_j - distance`` (3.1) and a positive force pushes the cells apart. Hertz and
approximate JKR are zero for ``h <= 0``; :class:`~multicell.contact.exact_jkr.ExactJKR` and the
springs of :mod:`multicell.contact.springs` may act beyond. All functions broadcast over NumPy
arrays.

Every law is called in the same way, ``law.force(overlap, modulus, radius)``, with two further
keywords that only some laws look at: ``rest``, the sum r_i + r_j of the radii, which the spring
laws of :mod:`multicell.contact.springs` need, and ``touching``, whether the pair was in contact
before, which :class:`~multicell.contact.exact_jkr.ExactJKR` needs.

The jitted twins of these laws stand in :mod:`multicell.mechanics.forces`; they are chosen by the
integer ``code`` of a law and are tested against the functions here.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Protocol

import numpy as np
from numpy.typing import ArrayLike

if TYPE_CHECKING:
    from multicell.cells import FloatArray


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
