"""Largest decay rate of a state: an eigenvalue of the Jacobian.

The Jacobian is J = -Γ⁻¹K with a symmetric stiffness K and, without friction between cells, a
diagonal drag Γ. So Γ^{1/2} J Γ^{-1/2} is symmetric and has the same, real eigenvalues.

References
----------
R. B. Lehoucq, D. C. Sorensen, C. Yang, "ARPACK Users' Guide", SIAM (1998),
https://doi.org/10.1137/1.9780898719628
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from multicell.mechanics.rows import RADIUS
from multicell.random import Purpose, normal

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.mechanics.system import Mechanics

RECORDED: Final = 20  # products that give the largest decay rate to what a limit of a step needs

GLANCED: Final = 6  # products that bracket the spectrum to what a choice of a method needs

_ROUNDING: Final = 1e-12  # of an image, over the largest: what is left of it has no direction
_ANY: Final = 1e30  # a relative tolerance at which ARPACK stops after its first sweep


def largest_decay_rate(
    system: Mechanics, time: float, position: FloatArray, *, dimensions: int = 3
) -> float:
    """Return the largest decay rate λ at a state, 1/s: the largest eigenvalue of -J.

    By the Lanczos method, from below: one sweep of ARPACK without restarts, from a vector that is
    the same in every call; with friction between cells, where the drag is no diagonal matrix, by a
    sweep of Arnoldi's method. Small systems are solved as dense matrices. NaN if ARPACK does not
    give it.

    - ``system``: made ready for the coupling step; its last linearisation is replaced
    - ``dimensions``: 2 for cells that stay in a plane: motions out of it do not count
    """
    if not len(system):
        return 0.0
    system.linearise(time, position)
    size = dimensions * len(system)
    inner = symmetric_product(system, dimensions)
    friction = max(system.friction) > 0.0

    def product(vector: FloatArray) -> FloatArray:
        return -inner(vector)

    if size <= RECORDED:
        matrix = np.stack([product(unit) for unit in np.eye(size)], axis=1)
        found = np.linalg.eigvals(matrix) if friction else np.linalg.eigvalsh(matrix)
        return float(found.real.max())
    return _by_one_sweep(product, size, symmetric=not friction)


def _by_one_sweep(
    product: Callable[[FloatArray], FloatArray], size: int, *, symmetric: bool
) -> float:
    """Return the largest real eigenvalue of an operator after one sweep of ARPACK."""
    from scipy.sparse.linalg import ArpackError, LinearOperator, eigs, eigsh

    start = normal(0, Purpose.EIGENVECTOR, 0, np.arange(size))[:, 0]
    if not product(start).any():
        return 0.0  # cells that touch nothing
    operator: Any = LinearOperator((size, size), matvec=product, dtype=float)
    options: Any = {"v0": start, "ncv": RECORDED - 3, "tol": _ANY, "maxiter": 1}
    try:
        if not symmetric:
            values = eigs(operator, 1, which="LR", return_eigenvectors=False, **options)
            return float(values.real.max())
        _, vectors = eigsh(operator, 1, which="LA", **options)
    except ArpackError:
        return float("nan")
    vector = vectors[:, 0] / np.linalg.norm(vectors[:, 0])
    return float(vector @ product(vector))


def spectrum_ends(
    system: Mechanics, time: float, position: FloatArray
) -> tuple[float, float, float]:
    """Return the ends of the spectrum of J at a state, in :data:`GLANCED` products.

    By the Lanczos method, from a vector that is the same in every call, with all directions kept
    orthogonal. Cells at one height without walls move within their plane.

    - ``system``: made ready for the coupling step; its last linearisation is replaced

    Returns float, 1/s: the largest decay rate, from below; float, 1/s: its residual, by which it
    may be higher; float, 1/s: the largest rate of growth, from below, negative if nothing grows.
    """
    system.linearise(time, position)
    flat = system.walls is None and np.ptp(position[:, 2]) == 0.0
    dimensions = 2 if flat else 3
    product, size = symmetric_product(system, dimensions), dimensions * len(position)
    most = min(GLANCED, size)
    basis, inner = np.empty((most, size)), np.zeros((most, most))
    vector = np.random.default_rng(0).normal(size=size)
    left, used = float(np.sqrt((vector * vector).sum())), 0
    for k in range(most):
        basis[k] = vector / left
        vector, used = product(basis[k]), k + 1
        # sums by NumPy: those of a linear algebra library depend on its threads
        inner[k, :used] = (basis[:used] * vector).sum(axis=1)
        vector -= (inner[k, :used, None] * basis[:used]).sum(axis=0)
        left = float(np.sqrt((vector * vector).sum()))
        if left <= _ROUNDING * float(np.abs(inner).max()):
            break
    # the lower triangle is read
    values, shapes = np.linalg.eigh(inner[:used, :used])
    return -float(values[0]), left * abs(float(shapes[-1, 0])), float(values[-1])


def symmetric_product(system: Mechanics, dimensions: int) -> Callable[[FloatArray], FloatArray]:
    """Return v -> Γ^{1/2} J Γ^{-1/2} v, (d n,) 1/s, at the system's last linearisation."""
    # the constant 6πη of the drag cancels
    root = np.sqrt(system.rows[:, RADIUS])[:, None]
    shape = (len(system), dimensions)
    out = np.empty((len(system), 3))

    def product(vector: FloatArray) -> FloatArray:
        moved = np.zeros_like(out)
        moved[:, :dimensions] = vector.reshape(shape) / root
        system.jacobian_product(moved, out)
        return np.asarray((root * out)[:, :dimensions].ravel())

    return product
