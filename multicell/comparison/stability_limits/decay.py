"""The mode of the linearised motion that decays fastest."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from multicell.cells import FloatArray
from multicell.errors import SceneError
from multicell.mechanics.system import Mechanics

Product = Callable[[FloatArray], FloatArray]


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
    value, mode = (_by_all if len(position) < dense else _by_lanczos)(
        product, position.size, symmetric
    )
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


def _by_all(product: Product, size: int, symmetric: bool) -> tuple[float, FloatArray]:
    matrix = np.stack([product(column) for column in np.eye(size)], axis=1)
    if symmetric:
        values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
        return float(values[-1]), vectors[:, -1]
    general, modes = np.linalg.eig(matrix)
    last = int(general.real.argmax())
    return float(general[last].real), np.asarray(modes[:, last].real)


def _by_lanczos(product: Product, size: int, symmetric: bool) -> tuple[float, FloatArray]:
    from scipy.sparse.linalg import LinearOperator, eigs, eigsh

    operator = LinearOperator((size, size), matvec=product, dtype=float)
    # a fixed start: the same state gives the same rate
    start = np.random.default_rng(0).normal(size=size)
    if symmetric:
        values, vectors = eigsh(operator, k=1, which="LA", v0=start, tol=1e-8)
    else:
        values, vectors = eigs(operator, k=1, which="LR", v0=start, tol=1e-4)
    return float(values[0].real), np.asarray(vectors[:, 0].real)
