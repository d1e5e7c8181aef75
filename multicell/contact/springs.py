"""The spring laws that users of CBMOS and Chaste know, for comparison with their papers.

They act between centres and know the radii only through the rest distance s = r_i + r_j, so
every function needs it as ``rest``. They see neither E nor ν: their ``stiffness`` is a parameter,
dF/dh at rest in nN/µm for all three laws. Attraction ends at the distance ``cutoff`` times s,
1.5 in both programs. With overlap h = s - distance, and H = (cutoff - 1) s:

=====================  ===================================================  ====================
law                    force for h > -H, else 0                             source
=====================  ===================================================  ====================
``linear``             μ h                                                  CBMOS ``Linear``; in
                                                                            Chaste's meshes
``cubic``              μ h (1 + h / H)²                                     CBMOS ``Cubic``
``generalised-linear`` -μ s log(1 - h / s) for h >= 0, μ h e^{α h / s}      CBMOS ``Gls``;
                       for h < 0                                            Chaste's nodes
=====================  ===================================================  ====================

Sources: Mathias, Coulier, Bouchnita and Hellander, Bull. Math. Biol. 82 (2020) 132 and
``cbmos/force_functions.py``; Pathmanathan et al., Phys. Biol. 6 (2009) 036001 and Chaste's
``GeneralisedLinearSpringForce``. CBMOS writes the cubic law with a coefficient in force per
length cubed, which is ``stiffness`` / H² here (its 50 is a stiffness of 12.5 at s = 1).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, ClassVar, final

import numpy as np
from numpy.typing import ArrayLike

from multicell.contact.constants import TINY, constants_of
from multicell.contact.law import PairLaw
from multicell.contact.scaled import ScaledAttraction
from multicell.schema import number, parameters, quantity, specs

if TYPE_CHECKING:
    from multicell.cells import FloatArray


def linear(
    overlap: float, modulus: float, radius: float, p: Any, rest: float
) -> tuple[float, float, float]:
    """Return force, stiffness and energy of ``LinearSpring``."""
    end = (p.cutoff - 1.0) * rest
    if overlap <= -end:
        return 0.0, 0.0, 0.0
    mu = p.stiffness
    return mu * overlap, mu, 0.5 * mu * (overlap * overlap - end * end)


def cubic(
    overlap: float, modulus: float, radius: float, p: Any, rest: float
) -> tuple[float, float, float]:
    """Return force, stiffness and energy of ``CubicSpring``."""
    mu, end = p.stiffness, (p.cutoff - 1.0) * rest
    # zero beyond the cutoff, where the square would rise again
    h = max(overlap, -end)
    x = h / end
    energy = mu * (h * h * (0.5 + x * (2.0 / 3.0 + 0.25 * x)) - end * end / 12.0)
    slope = mu * (1.0 + x) * (1.0 + 3.0 * x)
    return mu * h * (1.0 + x) * (1.0 + x), slope, energy if overlap > -end else 0.0


def generalised_linear(
    overlap: float, modulus: float, radius: float, p: Any, rest: float
) -> tuple[float, float, float]:
    """Return force, stiffness and energy of ``GeneralisedLinearSpring``."""
    end = (p.cutoff - 1.0) * rest
    if overlap <= -end:
        return 0.0, 0.0, 0.0
    mu, scale = p.stiffness, p.stiffness * (rest / p.decay) * (rest / p.decay)
    far = -p.decay * end / rest
    energy = -scale * ((far - 1.0) * math.exp(far) + 1.0)
    if overlap < 0.0:
        x = p.decay * overlap / rest
        fading = math.exp(x)
        energy += scale * ((x - 1.0) * fading + 1.0)
        return mu * overlap * fading, mu * (1.0 + x) * fading, energy
    # x log x tends to 0 as the centres meet
    gap = max(1.0 - overlap / rest, TINY)
    rise = math.log(gap)
    energy += mu * rest * rest * (gap * rise + 1.0 - gap)
    return -mu * rest * rise, mu / gap, energy


def _at_rest(overlap: float, modulus: float, radius: float, p: Any, rest: float) -> float:
    """Return the overlap at rest: springs rest at s."""
    return 0.0


def _cutoff(**least: Any) -> Any:
    words = "Largest distance at which the law acts / rest distance"
    return number(default=1.5, at_most=10.0, doc=words, **least)


@parameters
class Spring(PairLaw):
    """Base of the spring laws: zero beyond their cutoff and in equilibrium at rest.

    ``force``, ``stiffness`` and ``energy`` need the keyword ``rest`` (µm).
    """

    stiffness_at_rest: float = quantity(
        "nN/um", default=1.0, above=0.0, doc="Spring stiffness μ at rest"
    )
    cutoff: float = _cutoff(at_least=1.0)

    def constants(self) -> Any:
        """Return the parameters as the law's function takes them."""
        return self._constants(*(getattr(self, name) for name in specs(self)))

    def describe(self, energy: str) -> str:
        """Return the law in words."""
        return (
            f"{type(self).__name__}: a spring of {self.stiffness_at_rest:g} nN/um whatever Young's "
            f"modulus, up to {self.cutoff:g} times the sum of the radii"
        )

    def scaled_by_pairs(self) -> ScaledAttraction | None:
        """Return a law whose attraction is in proportion to a factor of each pair of types."""
        return None if self.cutoff == 1.0 else ScaledAttraction(self, _at_rest)

    def list_radius(self, radius: FloatArray, modulus: float) -> FloatArray:
        """Return the radii times the cutoff, (n,) µm."""
        return np.asarray(self.cutoff * radius)

    def reach(
        self, modulus: ArrayLike, radius: ArrayLike, *, rest: ArrayLike | None = None
    ) -> FloatArray:
        """Return H = (cutoff - 1) s in µm; raises TypeError without ``rest``."""
        if rest is None:
            raise TypeError(f"{type(self).__name__} needs rest=..., the sum r_i + r_j in µm")
        length, _, _ = np.broadcast_arrays(np.asarray(rest, dtype=float), modulus, radius)
        return np.asarray((self.cutoff - 1.0) * length)


@final
@parameters
class LinearSpring(Spring):
    """A linear spring, F = μ h, that ends with a jump at its cutoff.

    With ``cutoff = 1`` it only repels. Else the force jumps at the distance ``cutoff`` times s by
    μ H, as it does in CBMOS, and so it is not for integrators that need a continuous force.
    """

    _constants: ClassVar[Any] = constants_of(linear, "stiffness", "cutoff")


@final
@parameters
class CubicSpring(Spring):
    """The cubic law of CBMOS, F = μ h (1 + h / H)²: force and slope end in zero at the cutoff."""

    cutoff: float = _cutoff(above=1.0)
    _constants: ClassVar[Any] = constants_of(cubic, "stiffness", "cutoff")


@final
@parameters
class GeneralisedLinearSpring(Spring):
    """Chaste's law for nodes: logarithmic repulsion, attraction that fades exponentially.

    The force grows without bound as the centres come together (h → s), slower than a power, and
    stays finite in double precision. At the cutoff it jumps by μ H e^{-α H / s}.
    """

    decay: float = number(
        default=5.0, above=0.0, at_most=1e3, doc="α: how fast the attraction fades"
    )
    _constants: ClassVar[Any] = constants_of(generalised_linear, "stiffness", "cutoff", "decay")
