"""Exact JKR, with its hysteresis, beside the approximate law of the thesis.

The conventions are those of :mod:`multicell.contact.law`: overlap h = r_i + r_j - distance, force
positive where it pushes apart, and one way to call all laws.

Exact JKR in one curve. Johnson, Kendall and Roberts (Proc. R. Soc. A 324, 1971, 301) give force
and overlap over the contact radius a_c, with E* = ¾ E_ij and the work of adhesion w::

    F = 4 E* a_c³ / (3 r) - √(8π w E* a_c³),    h = a_c² / r - √(2π w a_c / E*)

With the overlap in units of k = (π² w² r / (64 E*²))^{1/3}, the force in units of P = π w r / 6
and a_c = √(k r) u² all pairs share one curve without parameters::

    h / k = u⁴ - 4 u,    F / P = u⁶ - 6 u³

u = 1 is the turning point (h = -3 k, F = -5 P): there the contact breaks when the distance is
prescribed. u³ = 3 is the deepest attraction (F = -9 P, pull-off under a load), u³ = 4 first
contact (h = 0, F = -8 P) and u³ = 6 rest (F = 0, h = 2 · 6^{1/3} k). u >= 1 is the branch that
is stable at prescribed distance. :func:`beyond_turning` solves the quartic on it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, ClassVar, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from multicell.contact.constants import TINY, constants_of
from multicell.contact.law import PairLaw
from multicell.schema import parameters, quantity

if TYPE_CHECKING:
    from multicell.cells import FloatArray


_LEAST_ENERGY = 1e-60
"""Stands for a surface energy of zero, nN/µm: the curve has no scale without adhesion."""
_RESOLVED = 1e-8
"""Smallest u - 1 that a slope is taken at: an overlap rounded to 16 digits resolves no more."""


def beyond_turning(excess: float) -> float:
    """Return v = u - 1 >= 0 on the stable branch of exact JKR, to rounding.

    It solves u⁴ - 4 u = excess - 3, which is v² (v² + 4 v + 6) = excess and so has no double
    root to lose digits at. A rational start (within 1.7 % everywhere) and two Halley steps, each
    of which cubes the error: no branch and no count that depends on the data.

    - ``excess``: overlap beyond the turning point in units of k, h / k + 3 >= 0
    """
    q = math.sqrt(excess)
    r = math.sqrt(q)
    v = q * (r + 1.101) / (q + 2.101 * r + 2.696888)
    for _ in range(2):
        g = v * v * (6.0 + v * (4.0 + v)) - excess
        slope = v * (12.0 + v * (12.0 + 4.0 * v))
        bend = 12.0 + v * (24.0 + 12.0 * v)
        # the tiny number lets v = 0 stay where it is
        v -= 2.0 * g * slope / (2.0 * slope * slope - g * bend + TINY)
    return v


def exact_jkr(
    overlap: float,
    modulus: float,
    radius: float,
    p: Any,
    adhesion: float,
    unit: float,
    onset: float,
) -> tuple[float, float, float]:
    """Return force, stiffness and energy on the stable branch, without a branch on the data.

    The unit of force P = π w r / 6 stands in the adhesion √(6πw). The stiffness tends to -∞
    towards the turning point and is cut off where rounding of the overlap hides how near that is.
    """
    x = overlap / unit
    v = beyond_turning(max(x + 3.0, 0.0))
    u = 1.0 + v
    cube = u * u * u
    scale = adhesion * adhesion * radius / 36.0
    w = max(v, _RESOLVED)
    rise = w * (3.0 + w * (3.0 + w))  # u³ - 1
    force = scale * cube * (cube - 6.0)
    stiffness = 1.5 * scale / unit * (1.0 + w) * (1.0 + w) * (rise - 2.0) / rise
    energy = unit * scale * u * cube * (cube * (0.4 * cube - 4.0) + 6.0)
    touches = x >= onset
    return force if touches else 0.0, stiffness if touches else 0.0, energy if touches else 0.0


_beyond_turning = np.frompyfunc(beyond_turning, 1, 1)


def exact_units(
    modulus: ArrayLike, radius: ArrayLike, surface_energy: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Return the units of overlap k in µm and of force P in nN for exact JKR.

    A surface energy of zero is replaced by one that is too small to be felt, so that the law
    ends in Hertz's without a case of its own.
    """
    work = np.maximum(surface_energy, _LEAST_ENERGY)
    radius = np.asarray(radius, dtype=float)
    ratio = np.pi * work / (6.0 * np.asarray(modulus, dtype=float))  # = π w / (8 E*)
    return np.cbrt(ratio * ratio * radius), np.asarray(np.pi * work * radius / 6.0)


@final
@parameters
class ExactJKR(PairLaw):
    """Johnson–Kendall–Roberts contact with the contact radius as unknown, and hysteresis.

    A contact forms where the spheres meet (h >= 0) and breaks at the turning point
    (h < -3 k, see the module's docstring), so a pair needs a memory: ``touching`` says whether it
    was in contact before. Held fixed during a step it only chooses the overlap at which the
    force sets in, -3 k or 0; :meth:`in_contact` gives its next value. In between the force
    follows the stable branch. It jumps to -(4/3) π w r at first contact and from -(5/6) π w r
    to zero at breaking. The work of adhesion w is the ``surface_energy``, so that the pull-off
    force -(3/2) π w r is that of :class:`~multicell.contact.jkr.JKR` with the same number.
    """

    surface_energy: float = quantity(
        "nN/um", default=0.1, at_least=0.0, doc="Work of adhesion w of a contact"
    )
    _constants: ClassVar[Any] = constants_of(exact_jkr)

    def adhesion_of(self, surface_energy: ArrayLike) -> FloatArray:
        """Return √(6πw) in (nN/µm)^½; see :func:`exact_units` for a surface energy of zero."""
        return super().adhesion_of(np.maximum(surface_energy, _LEAST_ENERGY))

    def describe(self, energy: str) -> str:
        """Return the law in words."""
        return (
            f"exact JKR: elastic and sticky, surface energy {energy}; contacts form at h = 0 and "
            "break at its turning point: one flag per pair remembers"
        )

    def pair_memory(
        self, adhesion: ArrayLike, modulus: ArrayLike, radius: ArrayLike, touching: ArrayLike
    ) -> tuple[FloatArray, FloatArray]:
        """Return k in µm, and the overlap in it from which there is contact: -3 or 0."""
        energy = np.square(adhesion) / (6.0 * np.pi)
        return exact_units(modulus, radius, energy)[0], np.where(touching, -3.0, 0.0)

    def in_contact(
        self, overlap: ArrayLike, modulus: ArrayLike, radius: ArrayLike, touching: ArrayLike
    ) -> NDArray[np.bool_]:
        """Return whether pairs are in contact now, given whether they were before."""
        breaking = np.where(touching, self.breaking_overlap(modulus, radius), 0.0)
        return np.asarray(np.asarray(overlap) >= breaking)

    def contact_radius(
        self,
        overlap: ArrayLike,
        modulus: ArrayLike,
        radius: ArrayLike,
        *,
        rest: ArrayLike | None = None,
        touching: ArrayLike = False,
    ) -> FloatArray:
        """Return the contact radius a_c = √(k r_ij) u² in µm, zero out of contact."""
        unit, _ = self._units(modulus, radius)
        excess = np.maximum(np.asarray(overlap, dtype=float) / unit + 3.0, 0.0)
        u = 1.0 + np.asarray(_beyond_turning(excess), dtype=float)
        contact = self.in_contact(overlap, modulus, radius, touching)
        return np.where(contact, np.sqrt(unit * np.asarray(radius)) * u**2, 0.0)

    def curve(
        self, contact: ArrayLike, modulus: ArrayLike, radius: ArrayLike
    ) -> tuple[FloatArray, FloatArray]:
        """Return overlap (µm) and force (nN) at a contact radius (µm), on either branch.

        These are the equations of Johnson et al. as they stand in the module's docstring.
        """
        star, radius = 0.75 * np.asarray(modulus, dtype=float), np.asarray(radius, dtype=float)
        a, w = np.asarray(contact, dtype=float), self.surface_energy
        overlap = a * a / radius - np.sqrt(2.0 * np.pi * w * a / star)
        force = 4.0 * star * a**3 / (3.0 * radius) - np.sqrt(8.0 * np.pi * w * star * a**3)
        return np.asarray(overlap), np.asarray(force)

    def equilibrium_overlap(self, modulus: ArrayLike, radius: ArrayLike) -> FloatArray:
        """Return the overlap without force, 2 · 6^{1/3} k in µm: a third of eq. 3.6's h₀."""
        return np.asarray(self._units(modulus, radius)[0] * (2.0 * 6.0 ** (1.0 / 3.0)))

    def breaking_overlap(self, modulus: ArrayLike, radius: ArrayLike) -> FloatArray:
        """Return the overlap -3 k in µm below which a contact breaks (prescribed distance)."""
        return np.asarray(-3.0 * self._units(modulus, radius)[0])

    def pull_off_overlap(self, modulus: ArrayLike, radius: ArrayLike) -> FloatArray:
        """Return the overlap -3^{1/3} k in µm of the deepest attraction."""
        return np.asarray(self._units(modulus, radius)[0] * -(3.0 ** (1.0 / 3.0)))

    def pull_off_force(self, radius: ArrayLike) -> FloatArray:
        """Return the deepest attraction -(3/2) π w r_ij in nN: a larger load separates a pair."""
        return np.asarray(-1.5 * np.pi * self.surface_energy * np.asarray(radius, dtype=float))

    def first_contact_force(self, radius: ArrayLike) -> FloatArray:
        """Return -(4/3) π w r_ij in nN, to which the force jumps when a contact forms."""
        return np.asarray(self.pull_off_force(radius) * (8.0 / 9.0))

    def breaking_force(self, radius: ArrayLike) -> FloatArray:
        """Return -(5/6) π w r_ij in nN, from which the force jumps to zero at fixed grips."""
        return np.asarray(self.pull_off_force(radius) * (5.0 / 9.0))

    def reach(
        self, modulus: ArrayLike, radius: ArrayLike, *, rest: ArrayLike | None = None
    ) -> FloatArray:
        """Return 3 k in µm: so far apart a contact may still hold."""
        return np.asarray(-self.breaking_overlap(modulus, radius))

    def _units(self, modulus: ArrayLike, radius: ArrayLike) -> tuple[FloatArray, FloatArray]:
        return exact_units(modulus, radius, self.surface_energy)
