"""Laws of growth in closed form, and what every law of growth offers.

A law is dV/dt = f g(V), with f in [0, 1] what nutrient and pressure leave of growth, and g so that
a cell of the birth volume V_b doubles it in its cycle time T where f = 1. f is fixed in a coupling
step, and only scales time: a step of length t is one of length f t with f = 1. So a law needs no
time but the *share* of a cycle without limits, s = f t / T. With V_d = 2 V_b the division volume
and K = ``target`` V_d the volume that a saturating law goes to:

    linear       g = V_b / T                        V(t) = V + g t
    exponential  g = r V           r T = ln 2       V(t) = V e^{rt}
    relaxation   g = r (K - V)     r T = ln [(K - V_b) / (K - V_d)]
                                                    V(t) = K - (K - V) e^{-rt}
    logistic     g = r V (1 - V/K) r T = ln [(K/V_b - 1) / (K/V_d - 1)]
                                                    V(t) = K / [1 + (K/V - 1) e^{-rt}]
    gompertz     g = r V ln(K/V)   r T = ln [ln(K/V_b) / ln(K/V_d)]
                                                    V(t) = K (V/K)^{exp(-rt)}

A saturating law reaches V_d only if K is above it.

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

    Volumes are in any unit, with ``birth`` the volume at birth in the same one.
    """

    constant: ClassVar[bool] = False
    """Whether the rate is the same at every volume: a step then is a product."""

    @abstractmethod
    def rate(self, volume: FloatArray, birth: float = 1.0) -> FloatArray:
        """Return g(V) T, the growth of volume in a cycle at the rate of a volume, (n,)."""

    @abstractmethod
    def volume_after(self, volume: FloatArray, share: FloatArray, birth: float = 1.0) -> FloatArray:
        """Return the volumes after a share of a cycle without limits, (n,)."""

    @abstractmethod
    def share_at(self, ratio: FloatArray) -> FloatArray:
        """Return the share of a cycle from birth to a volume, (n,): inverse of ``volume_after``.

        ``ratio`` is the volume over that at birth, from 1 to 2.
        """


@final
@parameters
class Linear(GrowthLaw):
    """The same rate at every volume."""

    constant: ClassVar[bool] = True

    def rate(self, volume: FloatArray, birth: float = 1.0) -> FloatArray:
        """Return V_b."""
        return np.full(np.shape(volume), birth)

    def volume_after(self, volume: FloatArray, share: FloatArray, birth: float = 1.0) -> FloatArray:
        """Return V + V_b s."""
        return np.asarray(volume + birth * share)

    def share_at(self, ratio: FloatArray) -> FloatArray:
        """Return V/V_b - 1."""
        return np.asarray(ratio - 1.0)


@final
@parameters
class Exponential(GrowthLaw):
    """A rate that is proportional to the volume."""

    def rate(self, volume: FloatArray, birth: float = 1.0) -> FloatArray:
        """Return ln(2) V."""
        return np.asarray(math.log(2.0) * volume)

    def volume_after(self, volume: FloatArray, share: FloatArray, birth: float = 1.0) -> FloatArray:
        """Return V 2^s."""
        return np.asarray(volume / np.exp(-math.log(2.0) * share))

    def share_at(self, ratio: FloatArray) -> FloatArray:
        """Return log2(V/V_b)."""
        return np.asarray(np.log(ratio) / math.log(2.0))


@parameters
class Saturating(GrowthLaw):
    """A law by which a cell that does not divide goes to the volume K = ``target`` V_d."""

    target: float = number(
        above=1,
        at_most=1000,
        doc="volume that a law which saturates goes to / division volume",
        hint="A cell never reaches the division volume otherwise.",
    )

    def largest(self, birth: float = 1.0) -> float:
        """Return K in the unit of ``birth``."""
        return 2.0 * birth * self.target

    @property
    @abstractmethod
    def exponent(self) -> float:
        """The product r T."""

    def decay(self, share: FloatArray) -> FloatArray:
        """Return e^{-rt} after a share of a cycle, (n,)."""
        return np.asarray(np.exp(-self.exponent * share))


@final
@parameters
class Relaxation(Saturating):
    """A rate that is proportional to what is missing to the largest volume."""

    @property
    def exponent(self) -> float:
        """The product r T."""
        largest = self.largest()
        return math.log((largest - 1.0) / (largest - 2.0))

    def rate(self, volume: FloatArray, birth: float = 1.0) -> FloatArray:
        """Return r T (K - V)."""
        return np.asarray(self.exponent * (self.largest(birth) - volume))

    def volume_after(self, volume: FloatArray, share: FloatArray, birth: float = 1.0) -> FloatArray:
        """Return K - (K - V) e^{-rt}."""
        largest = self.largest(birth)
        return np.asarray(largest - (largest - volume) * self.decay(share))

    def share_at(self, ratio: FloatArray) -> FloatArray:
        """Return ln[(K - V_b)/(K - V)] / r T."""
        largest = self.largest()
        return np.asarray(np.log((largest - 1.0) / (largest - ratio)) / self.exponent)


@final
@parameters
class Logistic(Saturating):
    """Exponential growth that slows down in proportion to the volume."""

    @property
    def exponent(self) -> float:
        """The product r T."""
        largest = self.largest()
        return math.log((largest - 1.0) / (0.5 * largest - 1.0))

    def rate(self, volume: FloatArray, birth: float = 1.0) -> FloatArray:
        """Return r T V (1 - V/K)."""
        return np.asarray(self.exponent * volume * (1.0 - volume / self.largest(birth)))

    def volume_after(self, volume: FloatArray, share: FloatArray, birth: float = 1.0) -> FloatArray:
        """Return K / [1 + (K/V - 1) e^{-rt}]."""
        largest = self.largest(birth)
        return np.asarray(largest / (1.0 + (largest / volume - 1.0) * self.decay(share)))

    def share_at(self, ratio: FloatArray) -> FloatArray:
        """Return ln[(K/V_b - 1)/(K/V - 1)] / r T."""
        largest = self.largest()
        return np.asarray(np.log((largest - 1.0) / (largest / ratio - 1.0)) / self.exponent)


@final
@parameters
class Gompertz(Saturating):
    """Exponential growth that slows down with the logarithm of the volume."""

    @property
    def exponent(self) -> float:
        """The product r T."""
        largest = self.largest()
        return math.log(math.log(largest) / math.log(0.5 * largest))

    def rate(self, volume: FloatArray, birth: float = 1.0) -> FloatArray:
        """Return r T V ln(K/V)."""
        return np.asarray(self.exponent * volume * np.log(self.largest(birth) / volume))

    def volume_after(self, volume: FloatArray, share: FloatArray, birth: float = 1.0) -> FloatArray:
        """Return K (V/K)^{exp(-rt)}."""
        largest = self.largest(birth)
        return np.asarray(largest * (volume / largest) ** self.decay(share))

    def share_at(self, ratio: FloatArray) -> FloatArray:
        """Return ln[ln(K/V_b)/ln(K/V)] / r T."""
        largest = self.largest()
        return np.asarray(np.log(math.log(largest) / np.log(largest / ratio)) / self.exponent)


LAWS: Final[Laws[GrowthLaw]] = Laws({law.__name__.lower(): law for law in (
    Linear, Exponential, Relaxation, Logistic, Gompertz,
)})  # fmt: skip
"""All laws by their names in a scene; :func:`multicell.growth_law` enters those of the user's."""
