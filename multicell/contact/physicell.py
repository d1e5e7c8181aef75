"""The adhesion and repulsion of PhysiCell, for comparison with the models of those who use it.

PhysiCell has no forces: a cell's velocity is the sum of what its neighbours add to it, and neither
drag nor elasticity occurs. With distance d, s = r_i + r_j and the range S = f s it adds

    v = r (1 - d/s)²  for d < s,  less  a (1 - d/S)²  for d < S

along the line of centres (r, a: strengths of repulsion and adhesion, µm/min). Here it is a force
that moves two cells of one size just so under Stokes drag: 6πηr_i v with r_i = s/2. In the overlap
h = s - d,

    F = E_ij l h²/s  for h > 0,  less  σ_ij s (1 - (s - h)/S)²  for h > -(S - s)

so that 3πη r = E_ij l and 3πη a = σ_ij. That the repulsion goes with E_ij gives each type of cells
its own, and σ_ij each pair of types its own adhesion; both are nN/µm.

Sources: Macklin, Edgerton, Thompson and Cristini, J. Theor. Biol. 301 (2012) 122; Ghaffarizadeh,
Heiland, Friedman, Mumenthaler and Macklin, PLoS Comput. Biol. 14 (2018) e1005991.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, final

import numpy as np
from numpy.typing import ArrayLike

from multicell.contact.constants import constants_of
from multicell.contact.law import PairLaw
from multicell.schema import number, parameters, quantity

if TYPE_CHECKING:
    from multicell.cells import FloatArray


_SIX_PI = 18.84955592153876  # 6π of √(6πσ), the adhesion of a pair


def adhesion_repulsion(
    overlap: float, modulus: float, radius: float, p: Any, rest: float, adhesion: float
) -> tuple[float, float, float]:
    """Return force, stiffness and energy of :class:`PhysiCell`."""
    push = modulus * p.length / rest
    h = max(overlap, 0.0)
    reach = p.cutoff * rest
    pull = adhesion * adhesion * rest / (_SIX_PI * reach * reach)
    x = max(overlap + (reach - rest), 0.0)
    force = push * h * h - pull * x * x
    return force, 2.0 * (push * h - pull * x), (push * h * h * h - pull * x * x * x) / 3.0


@final
@parameters
class PhysiCell(PairLaw):
    """PhysiCell's adhesion and repulsion as a force under Stokes drag.

    ``force``, ``stiffness`` and ``energy`` need the keyword ``rest`` (µm). Force and slope are
    continuous everywhere, at the end of the range too.
    """

    length: float = quantity(
        "um", default=1.0, above=0.0, doc="l: E_ij l is the strength of repulsion"
    )
    surface_energy: float = quantity(
        "nN/um", default=0.314, at_least=0.0, doc="strength of adhesion, which is no energy here"
    )
    cutoff: float = number(
        default=1.25, at_least=1.0, at_most=10.0, doc="largest distance of adhesion / rest distance"
    )
    _constants: ClassVar[Any] = constants_of(adhesion_repulsion, "length", "cutoff")

    def describe(self, energy: str) -> str:
        """Return the law in words."""
        return (
            f"PhysiCell: repulsion of E_ij times {self.length:g} um, adhesion of {energy} up to "
            f"{self.cutoff:g} times the sum of the radii"
        )

    def reach(
        self, modulus: ArrayLike, radius: ArrayLike, *, rest: ArrayLike | None = None
    ) -> FloatArray:
        """Return S - s in µm, with s = 4 r_ij (two cells alike) where ``rest`` is not given."""
        total = 4.0 * np.asarray(radius, dtype=float) if rest is None else rest
        length, _, _ = np.broadcast_arrays(np.asarray(total, dtype=float), modulus, radius)
        return np.asarray((self.cutoff - 1.0) * length)

    def equilibrium_overlap(self, modulus: ArrayLike, radius: ArrayLike) -> FloatArray:
        """Return the overlap at rest of two cells alike, µm.

        1 - h/s = (1 - q) / (1 - q/f) with q² adhesion over repulsion; cells whose adhesion is the
        stronger have none and are drawn into one another, h = s.
        """
        total = 4.0 * np.asarray(radius, dtype=float)
        strength = np.asarray(modulus, dtype=float) * self.length
        q = np.minimum(np.sqrt(self.surface_energy / strength), 1.0)
        share = np.where(q < 1.0, (1.0 - q) / (1.0 - np.minimum(q, 0.999999) / self.cutoff), 0.0)
        return np.asarray(total * (1.0 - share))
