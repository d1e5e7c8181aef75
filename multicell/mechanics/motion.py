"""The cells' motion during one coupling step as integrators see it, and its cost."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

from numpy.typing import NDArray

from multicell.cells import FloatArray

_LIST = 7  # evaluations that a neighbour list costs; one for a repair


class StateRejected(Exception):  # noqa: N818 - what happened to a trial state, not a fault
    """A trial state that has no meaning: not finite, or with too many cells in one place."""


@dataclass
class Work:
    """Counts of what an integration has cost; methods may add counts of their own."""

    evaluations: int = 0
    linearisations: int = 0
    jacobian_products: int = 0
    preconditioner_setups: int = 0
    preconditioner_solves: int = 0
    list_builds: int = 0
    list_repairs: int = 0
    steps: int = 0
    rejections: int = 0
    newton_iterations: int = 0
    linear_iterations: int = 0
    factorisations: int = 0
    friction_iterations: int = 0

    @property
    def effort(self) -> int:
        """Number of passes over all cells: what a step costs, in evaluations."""
        return (
            self.evaluations
            + self.linearisations
            + self.jacobian_products
            + self.preconditioner_setups
            + self.preconditioner_solves
            + self.friction_iterations
            + _LIST * self.list_builds
            + self.list_repairs
        )


@final
@dataclass
class Motion:
    """Motion of the cells during one coupling step, from ``begin`` to ``end``.

    - ``radius``, ``radius_rate``, (n,): radius at ``begin``, µm, and its constant rate, µm/s
    - ``young``, ``poisson``, (n,): elastic constants, kPa and dimensionless
    - ``begin``, ``end``, float: time, s
    - ``bonds``, (n, 4), optional: receptors and ligands at ``begin`` and their constant rates, 1/s
    - ``push``, (n, 6), optional: external force on each cell at ``begin``, nN, and its constant
      rate, nN/s
    - ``kind``, (n,) int, optional: type of each cell, an index into the matrix of surface energies
    - ``touching``, (m, 2) int, optional: pairs in contact at ``begin``, smaller index first; only
      exact JKR asks
    - ``held``, (n,) bool, optional: cells whose motion is prescribed. To integrators they stand
      still where they are at ``begin``; forces are those at their places in time, see
      :mod:`multicell.mechanics.prescribed`.
    - ``velocity``, (n, 3), optional: their prescribed velocity, µm/s, zero for all others; given
      where ``held`` is
    - ``newborn``, (n,) bool, optional: daughters of the step before. They part first of all, and
      the neighbour list has room for that.
    """

    radius: FloatArray
    radius_rate: FloatArray
    young: FloatArray
    poisson: FloatArray
    begin: float
    end: float
    bonds: FloatArray | None = None
    push: FloatArray | None = None
    kind: NDArray[Any] | None = None
    touching: NDArray[Any] | None = None
    held: NDArray[Any] | None = None
    velocity: FloatArray | None = None
    newborn: NDArray[Any] | None = None

    @property
    def end_radius(self) -> FloatArray:
        """Radius at ``end``, (n,) µm."""
        return self.radius + self.radius_rate * (self.end - self.begin)
