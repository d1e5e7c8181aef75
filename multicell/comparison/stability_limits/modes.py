"""Modes of the linearised motion at the start: the one that decays fastest, and the unstable ones.

The unstable part of a displacement Δx is P Δx = Γ^-½ Σ w (w · Γ^½ Δx), with the eigenvectors w of
Γ^½ J Γ^-½ that belong to positive eigenvalues μ. Along the true course it grows like e^{μt}, until
a cell has left the neighbourhood in which the motion is linear. Explicit methods follow late: their
growth in a step h is 1 + hμ + ... > 1. Backward Euler multiplies by 1 / (1 - hμ), whose size is
below 1 for hμ > 2, and BDF behaves alike: the cells stay where the true ones leave.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from multicell.cells import FloatArray
from multicell.errors import SceneError
from multicell.mechanics.growth_rate import largest_growth_rate
from multicell.mechanics.system import Mechanics

Product = Callable[[FloatArray], FloatArray]

_MAX_MODES = 40  # modes of a large system
_MAX_DENSE_CELLS = 400  # cells from which only these are computed


def largest_decay(
    system: Mechanics, position: FloatArray, flat: bool = False, dense: int = 150
) -> tuple[float, FloatArray]:
    """Return the largest decay rate of the linearised motion, 1/s, and its mode, (n, 3).

    Without friction between cells Γ^½ J Γ^-½ is symmetric, with the drag coefficients Γ. Below
    ``dense`` cells all its eigenvalues are computed, above the extreme one by Lanczos' method from
    products J v. With friction products are known to 1e-4, and so is the rate.

    - ``system``: mechanics that have been made ready for a step
    - ``position``: positions, (n, 3) µm, at the step's beginning
    - ``flat``: whether motion out of the plane z = 0 is left out
    - ``dense``: number of cells from which only the extreme eigenvalue is computed

    Raises SceneError if nothing decays: no cells touch.
    """
    product, weight = scaled_decay(system, position, flat)
    symmetric = max(system.friction) == 0.0
    if len(position) >= dense:
        values, modes = _arpack(product, position.size, symmetric, tol=1e-8 if symmetric else 1e-4)
    elif symmetric:
        matrix = _matrix(product, position.size)
        values, modes = np.linalg.eigh(0.5 * (matrix + matrix.T))
    else:
        values, modes = np.linalg.eig(_matrix(product, position.size))
    last = int(values.real.argmax())
    value, mode = float(values[last].real), np.asarray(modes[:, last].real)
    if not value > 0.0:
        raise SceneError("", "no cells touch: there is no motion whose stability can be lost")
    free = np.array([True, True, not flat])
    return value, np.where(free, (mode / weight).reshape(-1, 3), 0.0)


def scaled_decay(system: Mechanics, position: FloatArray, flat: bool) -> tuple[Product, FloatArray]:
    """Return v -> -Γ^½ J Γ^-½ v at the beginning of a step, and Γ^½ but for a factor, both (3 n,).

    Motion out of the plane is left out of the image if ``flat``.
    """
    system.linearise(system.motion.begin, position)
    weight = np.repeat(np.sqrt(system.motion.radius), 3)
    free = np.tile([True, True, not flat], len(position))

    def product(vector: FloatArray) -> FloatArray:
        image = np.empty_like(position)
        moved = np.where(free, np.ravel(vector) / weight, 0.0)
        system.jacobian_product(moved.reshape(-1, 3), image)
        return np.asarray(np.where(free, -weight * image.ravel(), 0.0))

    return product, weight


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
        matrix = _matrix(product, position.size)
        values, vectors = np.linalg.eigh(-0.5 * (matrix + matrix.T))
    else:
        values, vectors = _arpack(lambda v: -product(v), position.size, k=_MAX_MODES, tol=1e-6)
    kept = values > least
    return Unstable(found.rate, values[kept], np.ascontiguousarray(vectors[:, kept].T), weight)


def _matrix(product: Product, size: int) -> FloatArray:
    return np.stack([product(column) for column in np.eye(size)], axis=1)


def _arpack(
    product: Product, size: int, symmetric: bool = True, *, k: int = 1, tol: float
) -> tuple[Any, Any]:
    """Return the largest eigenvalues and their vectors, from products."""
    from scipy.sparse.linalg import LinearOperator, eigs, eigsh

    operator = LinearOperator((size, size), matvec=product, dtype=float)
    # a fixed start: the same state gives the same modes
    start = np.random.default_rng(0).normal(size=size)
    find, which = (eigsh, "LA") if symmetric else (eigs, "LR")
    values, vectors = find(operator, k=k, which=which, v0=start, tol=tol)
    return values, vectors
