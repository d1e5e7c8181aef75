"""Laws of growth in closed form, and what every law of growth offers.

A law is dV/dt = f g(V), with f in [0, 1] what nutrient and pressure leave of growth, and g so that
a cell of the birth volume V_b doubles it in its cycle time T where f = 1. f is fixed in a coupling
step, and only scales time: a step of length t is one of length f t with f = 1. So a law needs no
time but the *share* of a cycle without limits, s = f t / T. With V_d = 2 V_b the division volume
and K = ``target`` V_d the volume that relaxation goes to:

    linear       g = V_b / T                        V(t) = V + g t
    exponential  g = r V           r T = ln 2       V(t) = V e^{rt}
    relaxation   g = r (K - V)     r T = ln [(K - V_b) / (K - V_d)]
                                                    V(t) = K - (K - V) e^{-rt}

Relaxation reaches V_d only if K is above it.

References
----------
Relaxation is how volumes approach their targets in PhysiCell (A. Ghaffarizadeh et al., PLoS Comput.
Biol. 14 (2018) e1005991, https://doi.org/10.1371/journal.pcbi.1005991).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, ClassVar, Final, final

import numpy as np

from multicell.plugins.laws import Laws
from multicell.schema import number, parameters

if TYPE_CHECKING:
    from multicell.cells import FloatArray


class GrowthLaw(ABC):
    """A law of growth with its parameters; laws are frozen dataclasses.

    Volumes are in any unit, with ``birth`` the volume at birth in the same one: one number, or (n,)
    where types divide at volumes of their own.
    """

    constant: ClassVar[bool] = False
    """Whether the rate is the same at every volume: a step then is a product."""

    @abstractmethod
    def rate(self, volume: FloatArray, birth: float | FloatArray = 1.0) -> FloatArray:
        """Return g(V) T, the growth of volume in a cycle at the rate of a volume, (n,)."""

    @abstractmethod
    def volume_after(
        self, volume: FloatArray, share: FloatArray, birth: float | FloatArray = 1.0
    ) -> FloatArray:
        """Return the volumes after a share of a cycle without limits, (n,)."""

    @abstractmethod
    def share_at(self, ratio: FloatArray) -> FloatArray:
        """Return the share of a cycle from birth to a volume, (n,): inverse of ``volume_after``.

        ``ratio`` is the volume over that at birth, from 1 to 2.
        """


@final
@parameters
class LinearGrowth(GrowthLaw):
    """The same rate at every volume."""

    constant: ClassVar[bool] = True

    def rate(self, volume: FloatArray, birth: float | FloatArray = 1.0) -> FloatArray:
        """Return V_b."""
        return np.full(np.shape(volume), birth)

    def volume_after(
        self, volume: FloatArray, share: FloatArray, birth: float | FloatArray = 1.0
    ) -> FloatArray:
        """Return V + V_b s."""
        return np.asarray(volume + birth * share)

    def share_at(self, ratio: FloatArray) -> FloatArray:
        """Return V/V_b - 1."""
        return np.asarray(ratio - 1.0)


@final
@parameters
class ExponentialGrowth(GrowthLaw):
    """A rate that is proportional to the volume."""

    def rate(self, volume: FloatArray, birth: float | FloatArray = 1.0) -> FloatArray:
        """Return ln(2) V."""
        return np.asarray(math.log(2.0) * volume)

    def volume_after(
        self, volume: FloatArray, share: FloatArray, birth: float | FloatArray = 1.0
    ) -> FloatArray:
        """Return V 2^s."""
        return np.asarray(volume / np.exp(-math.log(2.0) * share))

    def share_at(self, ratio: FloatArray) -> FloatArray:
        """Return log2(V/V_b)."""
        return np.asarray(np.log(ratio) / math.log(2.0))


@final
@parameters
class RelaxationGrowth(GrowthLaw):
    """A rate that is proportional to what is missing to the volume K = ``target`` V_d."""

    target: float = number(
        above=1,
        at_most=1000,
        doc="volume that cells which do not divide go to / division volume",
        hint="A cell never reaches the division volume otherwise.",
    )

    @property
    def exponent(self) -> float:
        """The product r T."""
        largest = 2.0 * self.target
        return math.log((largest - 1.0) / (largest - 2.0))

    def rate(self, volume: FloatArray, birth: float | FloatArray = 1.0) -> FloatArray:
        """Return r T (K - V)."""
        return np.asarray(self.exponent * (2.0 * birth * self.target - volume))

    def volume_after(
        self, volume: FloatArray, share: FloatArray, birth: float | FloatArray = 1.0
    ) -> FloatArray:
        """Return K - (K - V) e^{-rt}."""
        largest = 2.0 * birth * self.target
        return np.asarray(largest - (largest - volume) * np.exp(-self.exponent * share))

    def share_at(self, ratio: FloatArray) -> FloatArray:
        """Return ln[(K - V_b)/(K - V)] / r T."""
        largest = 2.0 * self.target
        return np.asarray(np.log((largest - 1.0) / (largest - ratio)) / self.exponent)


GROWTH_LAWS: Final[Laws[GrowthLaw]] = Laws(
    {"linear": LinearGrowth, "exponential": ExponentialGrowth, "relaxation": RelaxationGrowth}
)
"""All laws by their names in a scene; :func:`multicell.growth_law` enters those of the user's."""
