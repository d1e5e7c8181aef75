"""The spring laws that users of CBMOS and Chaste know, for comparison with their papers.

They act between centres and know the radii only through the rest distance s = r_i + r_j, so
every function needs it as ``rest``. They see neither E nor ν: their ``stiffness`` is a parameter,
dF/dh at rest in nN/µm for all three laws. Attraction ends at the distance ``cutoff`` times s,
1.5 in both programs. With overlap h = s - distance, and H = (cutoff - 1) s:

=====================  ===================================================  ====================
law                    force for h > -H, else 0                             source
=====================  ===================================================  ====================
``Linear``             μ h                                                  CBMOS ``Linear``; in
                                                                            Chaste's meshes
``Cubic``              μ h (1 + h / H)²                                     CBMOS ``Cubic``
``GeneralisedLinear``  -μ s log(1 - h / s) for h >= 0, μ h e^{α h / s}      CBMOS ``Gls``;
                       for h < 0                                            Chaste's nodes
=====================  ===================================================  ====================

Sources: Mathias, Coulier, Bouchnita and Hellander, Bull. Math. Biol. 82 (2020) 132 and
``cbmos/force_functions.py``; Pathmanathan et al., Phys. Biol. 6 (2009) 036001 and Chaste's
``GeneralisedLinearSpringForce``. CBMOS writes the cubic law with a coefficient in force per
length cubed, which is ``stiffness`` / H² here (its 50 is a stiffness of 12.5 at s = 1).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, ClassVar, final

import numpy as np
from numpy.typing import ArrayLike

from multicell.contact.exact_jkr import contact_radius
from multicell.schema import number, parameters, quantity

if TYPE_CHECKING:
    from multicell.cells import FloatArray


class Spring(ABC):
    """What the spring laws share: they are zero beyond their cutoff and in equilibrium at rest."""

    code: ClassVar[int]
    stiffness_at_rest: float
    cutoff: float

    @property
    def adhesion(self) -> float:
        """Zero: no surface energy."""
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
        """Return the force in nN at an overlap (µm) and the rest distance ``rest`` (µm).

        Raises
        ------
        TypeError
            Without ``rest``.
        """
        h, s, range_ = self._geometry(overlap, modulus, radius, rest)
        return np.where(h > -range_, self._force(np.maximum(h, -range_), s, range_), 0.0)

    def stiffness(
        self,
        overlap: ArrayLike,
        modulus: ArrayLike,
        radius: ArrayLike,
        *,
        rest: ArrayLike | None = None,
        touching: ArrayLike = False,
    ) -> FloatArray:
        """Return dF/dh in nN/µm, zero beyond the cutoff; see :meth:`force`."""
        h, s, range_ = self._geometry(overlap, modulus, radius, rest)
        return np.where(h > -range_, self._slope(np.maximum(h, -range_), s, range_), 0.0)

    def energy(
        self,
        overlap: ArrayLike,
        modulus: ArrayLike,
        radius: ArrayLike,
        *,
        rest: ArrayLike | None = None,
        touching: ArrayLike = False,
    ) -> FloatArray:
        """Return ∫F dh from the cutoff in fJ: zero there and beyond; see :meth:`force`."""
        h, s, range_ = self._geometry(overlap, modulus, radius, rest)
        inside = np.maximum(h, -range_)
        return np.asarray(self._integral(inside, s, range_) - self._integral(-range_, s, range_))

    def contact_radius(
        self,
        overlap: ArrayLike,
        modulus: ArrayLike,
        radius: ArrayLike,
        *,
        rest: ArrayLike | None = None,
        touching: ArrayLike = False,
    ) -> FloatArray:
        """Return √(r_ij h) in µm, the Hertz picture: a spring itself has no contact."""
        return contact_radius(overlap, radius)

    def equilibrium_overlap(self, modulus: ArrayLike, radius: ArrayLike) -> FloatArray:
        """Return zero: the pair rests at s (µm)."""
        return np.zeros(np.broadcast_shapes(np.shape(modulus), np.shape(radius)))

    def reach(
        self, modulus: ArrayLike, radius: ArrayLike, *, rest: ArrayLike | None = None
    ) -> FloatArray:
        """Return H = (cutoff - 1) s in µm."""
        _, _, range_ = self._geometry(0.0, modulus, radius, rest)
        return range_

    def _geometry(
        self,
        overlap: ArrayLike,
        modulus: ArrayLike,
        radius: ArrayLike,
        rest: ArrayLike | None,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return h, s and H in one shape."""
        if rest is None:
            raise TypeError(f"{type(self).__name__} needs rest=..., the sum r_i + r_j in µm")
        h, s, _, _ = np.broadcast_arrays(overlap, rest, modulus, radius)
        h, s = h.astype(float), s.astype(float)
        return h, s, (self.cutoff - 1.0) * s

    @abstractmethod
    def _force(self, h: FloatArray, s: FloatArray, range_: FloatArray) -> FloatArray: ...

    @abstractmethod
    def _slope(self, h: FloatArray, s: FloatArray, range_: FloatArray) -> FloatArray: ...

    @abstractmethod
    def _integral(self, h: FloatArray, s: FloatArray, range_: FloatArray) -> FloatArray:
        """Return the integral of the force from 0 to h."""


@final
@parameters
class Linear(Spring):
    """A linear spring, F = μ h, that ends with a jump at its cutoff.

    With ``cutoff = 1`` it only repels. Else the force jumps at the distance ``cutoff`` times s by
    μ H, as it does in CBMOS, and so it is not for integrators that need a continuous force.
    """

    code: ClassVar[int] = 3
    stiffness_at_rest: float = quantity(
        "nN/um", default=1.0, above=0.0, doc="Spring stiffness μ at rest"
    )
    cutoff: float = number(
        default=1.5,
        at_least=1.0,
        at_most=10.0,
        doc="Largest distance at which the law acts / rest distance",
    )

    def _force(self, h: FloatArray, s: FloatArray, range_: FloatArray) -> FloatArray:
        return self.stiffness_at_rest * h

    def _slope(self, h: FloatArray, s: FloatArray, range_: FloatArray) -> FloatArray:
        return np.full(h.shape, self.stiffness_at_rest)

    def _integral(self, h: FloatArray, s: FloatArray, range_: FloatArray) -> FloatArray:
        return 0.5 * self.stiffness_at_rest * h * h


@final
@parameters
class Cubic(Spring):
    """The cubic law of CBMOS, F = μ h (1 + h / H)²: force and slope end in zero at the cutoff."""

    code: ClassVar[int] = 4
    stiffness_at_rest: float = quantity(
        "nN/um", default=1.0, above=0.0, doc="Spring stiffness μ at rest"
    )
    cutoff: float = number(
        default=1.5,
        above=1.0,
        at_most=10.0,
        doc="Largest distance at which the law acts / rest distance",
    )

    def _force(self, h: FloatArray, s: FloatArray, range_: FloatArray) -> FloatArray:
        return self.stiffness_at_rest * h * np.square(1.0 + h / range_)

    def _slope(self, h: FloatArray, s: FloatArray, range_: FloatArray) -> FloatArray:
        x = h / range_
        return self.stiffness_at_rest * (1.0 + x) * (1.0 + 3.0 * x)

    def _integral(self, h: FloatArray, s: FloatArray, range_: FloatArray) -> FloatArray:
        x = h / range_
        return self.stiffness_at_rest * h * h * (0.5 + x * (2.0 / 3.0 + 0.25 * x))


@final
@parameters
class GeneralisedLinear(Spring):
    """Chaste's law for nodes: logarithmic repulsion, attraction that fades exponentially.

    The force grows without bound as the centres come together (h → s), slower than a power, and
    is infinite where they coincide. At the cutoff it jumps by μ H e^{-α H / s}.
    """

    code: ClassVar[int] = 5
    stiffness_at_rest: float = quantity(
        "nN/um", default=1.0, above=0.0, doc="Spring stiffness μ at rest"
    )
    cutoff: float = number(
        default=1.5,
        at_least=1.0,
        at_most=10.0,
        doc="Largest distance at which the law acts / rest distance",
    )
    decay: float = number(
        default=5.0, above=0.0, at_most=1e3, doc="α: how fast the attraction fades"
    )

    def _force(self, h: FloatArray, s: FloatArray, range_: FloatArray) -> FloatArray:
        with np.errstate(divide="ignore"):
            repulsion = -s * np.log1p(-np.maximum(h, 0.0) / s)
        attraction = np.minimum(h, 0.0)
        return self.stiffness_at_rest * (repulsion + attraction * self._fading(attraction, s))

    def _slope(self, h: FloatArray, s: FloatArray, range_: FloatArray) -> FloatArray:
        with np.errstate(divide="ignore"):
            repulsion = 1.0 / (1.0 - np.maximum(h, 0.0) / s)
        apart = np.minimum(h, 0.0)
        attraction = (1.0 + self.decay * apart / s) * self._fading(apart, s)
        return self.stiffness_at_rest * np.where(h < 0.0, attraction, repulsion)

    def _integral(self, h: FloatArray, s: FloatArray, range_: FloatArray) -> FloatArray:
        gap = 1.0 - np.maximum(h, 0.0) / s
        # x log x → 0 as the centres meet
        repulsion = s * s * (gap * np.log(np.where(gap > 0.0, gap, 1.0)) + 1.0 - gap)
        x = self.decay * np.minimum(h, 0.0) / s
        attraction = np.square(s / self.decay) * ((x - 1.0) * np.exp(x) + 1.0)
        return self.stiffness_at_rest * (repulsion + attraction)

    def _fading(self, h: FloatArray, s: FloatArray) -> FloatArray:
        return np.exp(self.decay * h / s)
