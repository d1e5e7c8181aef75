"""The unstable modes of a state.

The unstable part of a displacement Δx is P Δx = Γ^-½ Σ w (w · Γ^½ Δx), with the eigenvectors w of
Γ^½ J Γ^-½ that belong to positive eigenvalues μ. Along the true course it grows like e^{μt}, until
a cell has left the neighbourhood in which the motion is linear. Explicit methods follow late: their
growth in a step h is 1 + hμ + ... > 1. Backward Euler multiplies by 1 / (1 - hμ), whose size is
below 1 for hμ > 2, and BDF behaves alike: the cells stay where the true ones leave.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from multicell.cells import FloatArray
from multicell.comparison.stability_limits.decay import Product, scaled_decay
from multicell.mechanics.growth_rate import largest_growth_rate
from multicell.mechanics.system import Mechanics

_MAX_MODES = 40  # modes of a large system
_MAX_DENSE_CELLS = 400  # cells from which only these are computed


@final
@dataclass(frozen=True, eq=False)
class Unstable:
    """The unstable modes of a state.

    - ``rate``, float, 1/s: largest eigenvalue μ of the Jacobian; NaN where it is not given
      (friction between cells)
    - ``rates``, (k,) float64, 1/s: positive eigenvalues, of systems of more than 400 cells the
      forty largest
    - ``modes``, (k, 3 n) float64: their eigenvectors of Γ^½ J Γ^-½, orthonormal
    - ``weight``, (3 n,) float64: Γ^½ but for a factor
    """

    rate: float
    rates: FloatArray
    modes: FloatArray
    weight: FloatArray

    def unstable_part(self, displacement: FloatArray, least: float) -> FloatArray:
        """Return the size of each cell's displacement along unstable modes, (n,) µm.

        - ``displacement``: (n, 3) µm
        - ``least``: rate in 1/s from which modes count
        """
        modes = self.modes[self.rates > least]
        part = modes.T @ (modes @ (self.weight * displacement.ravel())) / self.weight
        return np.asarray(np.linalg.norm(part.reshape(-1, 3), axis=1))


def unstable_modes(system: Mechanics, position: FloatArray, flat: bool, least: float) -> Unstable:
    """Return the unstable modes at the beginning of a step.

    - ``system``: made ready for a step
    - ``position``: positions, (n, 3) µm, at the step's beginning
    - ``flat``: whether motion out of the plane z = 0 is left out
    - ``least``: growth rate in 1/s below which a mode does not count
    """
    found = largest_growth_rate(system, system.motion.begin, position, dimensions=2 if flat else 3)
    product, weight = scaled_decay(system, position, flat)
    if not found.rate > least:
        return Unstable(found.rate, np.empty(0), np.empty((0, position.size)), weight)
    if len(position) <= _MAX_DENSE_CELLS:
        matrix = np.stack([product(column) for column in np.eye(position.size)], axis=1)
        values, vectors = np.linalg.eigh(-0.5 * (matrix + matrix.T))
    else:
        values, vectors = _by_lanczos(product, position.size)
    kept = values > least
    return Unstable(found.rate, values[kept], np.ascontiguousarray(vectors[:, kept].T), weight)


def _by_lanczos(product: Product, size: int) -> tuple[FloatArray, FloatArray]:
    from scipy.sparse.linalg import LinearOperator, eigsh

    operator = LinearOperator((size, size), matvec=lambda v: -product(v), dtype=float)
    # a fixed start: the same state gives the same modes
    start = np.random.default_rng(0).normal(size=size)
    values, vectors = eigsh(operator, k=_MAX_MODES, which="LA", v0=start, tol=1e-6)
    return values, vectors
