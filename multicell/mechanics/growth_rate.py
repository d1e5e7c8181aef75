"""How fast the most unstable small disturbance of a state grows: an eigenvalue of the Jacobian.

The Jacobian is J = -Γ⁻¹K with a symmetric stiffness K and, without friction between cells, a
diagonal drag Γ. So Γ^{1/2} J Γ^{-1/2} is symmetric and has the same, real eigenvalues. A positive
one, μ, means that neighbouring trajectories part like e^{μt}; an implicit step h with hμ > 1 damps
what should grow. Cells that have just divided are in such states: compressed contacts buckle
(the prestress -F/d), and adhesion pulls harder the further two cells overlap when they first meet.

References
----------
R. B. Lehoucq, D. C. Sorensen, C. Yang, "ARPACK Users' Guide", SIAM (1998),
https://doi.org/10.1137/1.9780898719628
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from multicell.random import Purpose, normal

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.mechanics.system import Mechanics

PRODUCTS: Final = 40  # products J·v that are spent unless another number is asked for

RECORDED: Final = 20  # products that give the largest decay rate to what a limit of a step needs

_FEWEST = 5  # two vectors, and three products beside those of the sweep
_ANY: Final = 1e30  # a relative tolerance at which ARPACK stops after its first sweep


@final
@dataclass(frozen=True)
class GrowthRate:
    """The largest eigenvalue of the Jacobian.

    - ``rate``, float, 1/s: μ; NaN if it is not given. The true one is not below it, but for
      rounding. Without walls it is not negative, since translations change nothing.
    - ``error``, float, 1/s: estimate of its error: norm of the residual of the approximate
      eigenvector, within which of its Rayleigh quotient there is an eigenvalue
    - ``products``, int: products J·v that were spent
    - ``problem``, str: why it is not given, in words; empty if it is
    """

    rate: float
    error: float
    products: int
    problem: str = ""


def largest_growth_rate(
    system: Mechanics,
    time: float,
    position: FloatArray,
    *,
    products: int = PRODUCTS,
    dimensions: int = 3,
) -> GrowthRate:
    """Return the largest eigenvalue of the Jacobian at a state, by the Lanczos method.

    One sweep of ARPACK without restarts, from a vector that is the same in every call. Small
    systems are solved as dense matrices.

    - ``system``: made ready for the coupling step; its last linearisation is replaced
    - ``products``: largest number of products J·v, 5 or more. After division 20 give μ to many
      digits; that it is zero they only tell within some hundredths of the largest decay rate.
    - ``dimensions``: 2 for cells that stay in a plane: motions out of it do not count
    """
    if products < _FEWEST:
        raise ValueError(f"products is {products}, must be {_FEWEST} or more")
    if dimensions not in (2, 3):
        raise ValueError(f"dimensions is {dimensions}, must be 2 or 3")
    if max(system.friction) > 0.0:
        return _not_given("with friction between cells the drag is no diagonal matrix")
    if not len(system):
        return GrowthRate(0.0, 0.0, 0)
    system.linearise(time, position)
    size = dimensions * len(system)
    product = symmetric_product(system, dimensions)
    if size <= products:
        matrix = np.stack([product(unit) for unit in np.eye(size)], axis=1)
        values = np.linalg.eigvalsh(0.5 * (matrix + matrix.T))
        rounding = float(np.finfo(float).eps * np.abs(values).max() * size)
        return GrowthRate(float(values[-1]), rounding, size)
    found = _by_lanczos(product, size, products)
    if system.walls is None and found.rate < 0.0:
        # the eigenvalue of a translation is known without any product
        return replace(found, rate=0.0)
    return found


def largest_decay_rate(
    system: Mechanics,
    time: float,
    position: FloatArray,
    *,
    products: int = RECORDED,
    dimensions: int = 3,
) -> float:
    """Return the largest decay rate λ at a state, 1/s: the largest eigenvalue of -J.

    Found as by :func:`largest_growth_rate`, and from below; with friction between cells, where the
    drag is no diagonal matrix, by a sweep of Arnoldi's method. Parameters and errors are those of
    :func:`largest_growth_rate`. NaN if ARPACK does not give it.
    """
    if not len(system):
        return 0.0
    system.linearise(time, position)
    size = dimensions * len(system)
    inner = symmetric_product(system, dimensions)
    friction = max(system.friction) > 0.0

    def product(vector: FloatArray) -> FloatArray:
        return -inner(vector)

    if size <= products:
        matrix = np.stack([product(unit) for unit in np.eye(size)], axis=1)
        found = np.linalg.eigvals(matrix) if friction else np.linalg.eigvalsh(matrix)
        return float(found.real.max())
    return (_by_arnoldi if friction else _by_lanczos)(product, size, products).rate


def _by_lanczos(
    product: Callable[[FloatArray], FloatArray], size: int, products: int
) -> GrowthRate:
    """Return the largest eigenvalue of a symmetric operator after one sweep of ARPACK."""
    from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh

    spent = 0

    def counted(vector: FloatArray) -> FloatArray:
        nonlocal spent
        spent += 1
        return product(vector)

    start = normal(0, Purpose.EIGENVECTOR, 0, np.arange(size))[:, 0]
    if not counted(start).any():
        return GrowthRate(0.0, 0.0, spent)  # cells that touch nothing
    operator: Any = LinearOperator((size, size), matvec=counted, dtype=float)
    try:
        _, vectors = eigsh(operator, 1, which="LA", v0=start, ncv=products - 3, tol=_ANY, maxiter=1)
    except ArpackError as error:
        return _not_given(str(error), spent)
    vector = vectors[:, 0] / np.linalg.norm(vectors[:, 0])
    image = counted(vector)
    rate = float(vector @ image)
    return GrowthRate(rate, float(np.linalg.norm(image - rate * vector)), spent)


def _by_arnoldi(
    product: Callable[[FloatArray], FloatArray], size: int, products: int
) -> GrowthRate:
    """Return the largest real eigenvalue of an operator after one sweep of ARPACK."""
    from scipy.sparse.linalg import ArpackError, LinearOperator, eigs

    start = normal(0, Purpose.EIGENVECTOR, 0, np.arange(size))[:, 0]
    if not product(start).any():
        return GrowthRate(0.0, 0.0, 1)
    operator: Any = LinearOperator((size, size), matvec=product, dtype=float)
    try:
        values = eigs(
            operator, 1, which="LR", v0=start, ncv=products - 3, tol=_ANY, maxiter=1,
            return_eigenvectors=False,
        )  # fmt: skip
    except ArpackError as error:
        return _not_given(str(error), products)
    return GrowthRate(float(values.real.max()), float("nan"), products)


def symmetric_product(system: Mechanics, dimensions: int) -> Callable[[FloatArray], FloatArray]:
    """Return v -> Γ^{1/2} J Γ^{-1/2} v, (d n,) 1/s, at the system's last linearisation."""
    # the constant 6πη of the drag cancels
    root = np.sqrt(system.rows[:, 3])[:, None]
    shape = (len(system), dimensions)
    out = np.empty((len(system), 3))

    def product(vector: FloatArray) -> FloatArray:
        moved = np.zeros_like(out)
        moved[:, :dimensions] = vector.reshape(shape) / root
        system.jacobian_product(moved, out)
        return np.asarray((root * out)[:, :dimensions].ravel())

    return product


def _not_given(problem: str, products: int = 0) -> GrowthRate:
    return GrowthRate(float("nan"), float("nan"), products, problem)
