"""Elastic, sticky spheres by the approximate law of Johnson, Kendall and Roberts (eq. 3.6)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, ClassVar, final

import numpy as np
from numpy.typing import ArrayLike

from multicell.cells import HALF
from multicell.contact.constants import TINY, constants_of
from multicell.contact.law import PairLaw
from multicell.errors import SceneError
from multicell.schema import parameters, quantity

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.scene.scene import Scene


def jkr(
    overlap: float, modulus: float, radius: float, p: Any, adhesion: float
) -> tuple[float, float, float]:
    """Return force, stiffness and energy.

    With the contact radius q = √(r_ij h) the force is E_ij h q - √(6πσ) q √(E_ij q): two square
    roots and no power. Each power rule brings its exponent over h.
    """
    h = max(overlap, 0.0)
    q = math.sqrt(radius * h)
    elastic = modulus * h * q
    sticky = adhesion * q * math.sqrt(modulus * q)
    stiffness = (1.5 * elastic - 0.75 * sticky) / (h + TINY)
    return elastic - sticky, stiffness, 0.4 * elastic * h - (4.0 / 7.0) * sticky * h


def linear_onset(
    overlap: float, modulus: float, radius: float, p: Any, adhesion: float
) -> tuple[float, float, float]:
    """Return force, stiffness and energy with adhesion that sets in linearly below h_s.

    There h^{3/4} is replaced by h_s^{3/4} (5 s - s²) / 4 with s = h / h_s.
    """
    h, hs = max(overlap, 0.0), p.smoothing
    elastic = modulus * h * math.sqrt(radius * h)
    s = min(h * (1.0 / hs), 1.0)
    beyond = max(h, hs)
    q = math.sqrt(radius * beyond)
    full = adhesion * q * math.sqrt(modulus * q)
    slope = 0.75 * full / beyond if s == 1.0 else full * (5.0 - 2.0 * s) * 0.25 / hs
    stiffness = 1.5 * elastic / (h + TINY) - slope if h > 0.0 else 0.0
    onset = math.sqrt(radius * hs)
    bound = adhesion * onset * math.sqrt(modulus * onset) * hs
    below = bound * s * s * (5.0 / 8.0 - s / 12.0)
    sticky = (4.0 / 7.0) * full * h - bound * (5.0 / 168.0) if s == 1.0 else below
    return elastic - full * (s * (5.0 - s) * 0.25), stiffness, 0.4 * elastic * h - sticky


_Constants = constants_of(jkr)
_SmoothConstants = constants_of(linear_onset, "smoothing")


@final
@parameters
class JKR(PairLaw):
    """Approximate Johnson–Kendall–Roberts contact (equation 3.6).

    F = E_ij √r_ij h^{3/2} - √(6πσ E_ij r_ij^{3/2} h^{3/2}). The stiffness tends to -∞ as
    h → 0⁺: the force is continuous but not Lipschitz where a contact forms or breaks.

    With a ``smoothing`` length h_s > 0 the law is another model, "linear onset": below h_s the
    factor h^{3/4} of the adhesive part is h_s^{3/4} (5 s - s²) / 4 with s = h / h_s. It meets
    h^{3/4} in value and slope at h_s, and its slope stays finite at h = 0, so that the stiffness
    is at least -(5/4) b h_s^{-1/4}. Equilibrium does not change while h_s <= h₀, nor the deepest
    attraction while h_s <= h₀ / 2^{4/3}. With 0 the law is eq. 3.6, bit for bit.
    """

    surface_energy: float = quantity(
        "nN/um", default=0.1, at_least=0.0, doc="Surface energy σ of a contact"
    )
    smoothing: float = quantity(
        "um",
        default=0.0,
        at_least=0.0,
        doc="Overlap below which adhesion sets in linearly; 0 is eq. 3.6",
    )

    without_adhesion: ClassVar[str] = "A surface energy of zero makes JKR the same as Hertz."

    def check_scene(self, scene: Scene) -> None:
        """Raise ``SceneError`` where the smoothing is longer than the least radius of a cell."""
        scales = (kind.division_radius_scale for kind in scene.types.values())
        smallest = HALF * scene.cells.division_radius * min(scales, default=1.0)
        if self.smoothing > smallest:
            problem = f"is {self.smoothing:g} um, must be at most the birth radius {smallest:g} um"
            raise SceneError("contact.smoothing", problem, "0 turns it off.")

    def constants(self) -> Any:
        """Return nothing, or the smoothing length (µm): the adhesion is the pair's own."""
        return _SmoothConstants(self.smoothing) if self.smoothing > 0.0 else _Constants()

    def describe(self, energy: str) -> str:
        """Return the law in words."""
        smooth = f", smoothed below {self.smoothing:g} um" if self.smoothing > 0.0 else ""
        return f"JKR: elastic and sticky, surface energy {energy}{smooth}"

    def equilibrium_overlap(self, modulus: ArrayLike, radius: ArrayLike) -> FloatArray:
        """Return the overlap in µm where the force is zero.

        It is h₀ = (6πσ √r_ij / E_ij)^{2/3} up to a smoothing of that length. Beyond, with
        k = (h_s / h₀)^{3/4} and x = √(h / h_s), it is the root of k x = (5 - x²) / 4.
        """
        ratio = self.adhesion**2 * np.sqrt(radius) / np.asarray(modulus, dtype=float)
        rest = np.asarray(np.cbrt(ratio) ** 2)
        if self.smoothing == 0.0:
            return rest
        k = (self.smoothing / np.where(rest > 0.0, rest, np.inf)) ** 0.75
        inside = self.smoothing * (2.5 / (k + np.sqrt(k * k + 1.25))) ** 2
        return np.where((rest > 0.0) & (rest < self.smoothing), inside, rest)
