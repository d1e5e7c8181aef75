"""Laws whose attraction is in proportion to a factor of each pair of types.

The factor takes the place of the adhesion √(6πσ) that the kernels know of each pair, so that the
law is one like any other. Overlaps up to rest attract, those beyond repel: with the force F, the
energy U and the overlap h₀ at rest of the law that is scaled, the factor f gives

- f F and f U where F <= 0,
- F and U - (1 - f) U(h₀) where F > 0, which is continuous, and f U(h₀) at rest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numpy.typing import ArrayLike

from multicell.contact.constants import SHARED, constants_of, function_of
from multicell.contact.law import PairLaw

if TYPE_CHECKING:
    from multicell.cells import FloatArray

_POINTS = 401  # overlaps at which a law is tried

RestOverlap = Callable[..., float]
"""The overlap at rest, µm, as ``rest_overlap(overlap, modulus, radius, p, rest)``, for an
``overlap`` at which the law repels."""


@final
@dataclass(frozen=True)
class ScaledAttraction(PairLaw):
    """A law without a surface energy whose attraction is multiplied by a factor.

    - ``law``: what is scaled; it attracts up to one overlap and repels beyond
    - ``rest_overlap``: its overlap at rest, see :data:`RestOverlap`
    - ``factor``: of a pair that no table has another one for
    """

    law: PairLaw
    rest_overlap: RestOverlap = field(repr=False)  # whose words would hold an address
    factor: float = 1.0

    @property
    def is_sticky(self) -> bool:
        """Whether it has a surface energy: no."""
        return False

    @property
    def adhesion(self) -> float:
        """The factor."""
        return self.factor

    def adhesion_of(self, surface_energy: ArrayLike) -> FloatArray:
        """Return factors as they are."""
        return np.asarray(surface_energy, dtype=float)

    def for_pair(self, entry: float) -> ScaledAttraction:
        """Return the law with another factor."""
        return replace(self, factor=entry)

    def constants(self) -> Any:
        """Return the constants of the law that is scaled, under a type of their own."""
        own = self.law.constants()
        return _constants(own.__class__, self.rest_overlap)(*own)

    def describe(self, energy: str) -> str:
        """Return the law in words."""
        return f"{self.law.describe(energy)}; attraction times {self.factor:g}"

    def equilibrium_overlap(self, modulus: ArrayLike, radius: ArrayLike) -> FloatArray:
        """Return the overlap without force in µm, which no factor changes."""
        return self.law.equilibrium_overlap(modulus, radius)

    def problem(self, modulus: float, radius: float, rest: float) -> str:
        """Return in words why the attraction of a pair has no factor; empty if it has.

        - ``modulus``, ``radius``, ``rest``: E_ij in kPa, r_ij and r_i + r_j in µm
        """
        begin = -float(self.reach(modulus, radius, rest=rest))
        overlap = np.linspace(begin, rest, _POINTS)[1:-1]
        force = self.law.force(overlap, modulus, radius, rest=rest)
        attracts = np.flatnonzero(force < 0.0)
        if not len(attracts):
            return "attracts nowhere"
        below = np.flatnonzero(force[: attracts[-1]] > 0.0)
        if len(below):
            return f"repels at an overlap of {overlap[below[0]]:.3g} um, and attracts beyond"
        return ""

    def reach(
        self, modulus: ArrayLike, radius: ArrayLike, *, rest: ArrayLike | None = None
    ) -> FloatArray:
        """Return how far beyond first contact the law acts, µm."""
        return self.law.reach(modulus, radius, rest=rest)

    def list_radius(self, radius: FloatArray, modulus: float) -> FloatArray:
        """Return half of the distance within which each cell matters to others, (n,) µm."""
        return self.law.list_radius(radius, modulus)


@lru_cache(maxsize=64)
def _constants(kind: Any, rest_overlap: RestOverlap) -> Any:
    """Return the type of the constants of a scaled law: those of the law that is scaled."""
    found = function_of(kind)
    further = found.further
    return constants_of(
        _whole(_as_spring(found.whole, further), rest_overlap),
        *kind._fields[: -len(SHARED)],
        without_energy=_without_energy(_as_spring(found.without_energy, further)),
        force_alone=_without_energy(_as_spring(found.force_alone, further)),
    )


def _as_spring(function: Callable[..., Any], further: tuple[str, ...]) -> Callable[..., Any]:
    """Return the function of a law without a surface energy as one of a rest distance."""
    if further == ("rest",):
        return function
    if further == ("rest", "adhesion"):
        return lambda overlap, modulus, radius, p, rest: function(
            overlap, modulus, radius, p, rest, 0.0
        )
    raise TypeError(f"a law with the arguments {further} cannot be scaled")


def _without_energy(function: Callable[..., Any]) -> Callable[..., Any]:
    def law(overlap, modulus, radius, p, rest, adhesion):  # type: ignore[no-untyped-def]
        force, slope, _ = function(overlap, modulus, radius, p, rest)
        factor = adhesion if force < 0.0 else 1.0
        return factor * force, factor * slope, 0.0

    return law


def _whole(function: Callable[..., Any], rest_overlap: RestOverlap) -> Callable[..., Any]:
    def law(overlap, modulus, radius, p, rest, adhesion):  # type: ignore[no-untyped-def]
        force, slope, energy = function(overlap, modulus, radius, p, rest)
        factor = adhesion if force < 0.0 else 1.0
        if force > 0.0:
            at_rest = rest_overlap(overlap, modulus, radius, p, rest)
            energy -= (1.0 - adhesion) * function(at_rest, modulus, radius, p, rest)[2]
        else:
            energy *= adhesion
        return factor * force, factor * slope, energy

    return law
