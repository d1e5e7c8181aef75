"""What every law of growth offers.

A law is dV/dt = f g(V), with f in [0, 1] what nutrient and pressure leave of growth, and g so that
a cell of the birth volume V_b doubles it in its cycle time T where f = 1. f is fixed in a coupling
step, and only scales time: a step of length t is one of length f t with f = 1. So a law needs no
time but the *share* of a cycle without limits, f t / T.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, ClassVar

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
