"""Elastic spheres that do not stick (Hertz 1882; eq. 3.2)."""

from __future__ import annotations

import math
from typing import Any, ClassVar, final

from multicell.contact.constants import TINY, constants_of
from multicell.contact.law import PairLaw
from multicell.schema import parameters


def hertz(overlap: float, modulus: float, radius: float, p: Any) -> tuple[float, float, float]:
    """Return force, stiffness and energy; h^{3/2} comes from one square root and no power."""
    h = max(overlap, 0.0)
    force = modulus * h * math.sqrt(radius * h)
    return force, 1.5 * force / (h + TINY), 0.4 * force * h


@final
@parameters
class Hertz(PairLaw):
    """Elastic spheres without adhesion: F = E_ij √r_ij h^{3/2} (equation 3.2)."""

    _constants: ClassVar[Any] = constants_of(hertz)

    def describe(self, energy: str) -> str:
        """Return the law in words."""
        return "Hertz: elastic, nothing sticks"
