"""The cells' motion during one coupling step as integrators see it, and its cost."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import FloatArray

_LIST = 7  # evaluations that a neighbour list costs; one for a repair


_LEAST_GROWTH: Final = 1e-4  # of radii in a step, below which a series has all digits


class StateRejected(Exception):  # noqa: N818 - what happened to a trial state, not a fault
    """A trial state that has no meaning: not finite, or with too many cells in one place."""


@dataclass
class Work:
    """Counts of the cost of an integration; methods may add counts of their own."""

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
        """Number of passes over all cells: the cost of a step, in evaluations."""
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
    - ``diffusion``, (n,), optional: diffusion of free cells by Brownian motion, µm²/s. Forces do
      not hold it: :meth:`part` makes one of it that is constant over an internal step.
    - ``sticky``, (n,), optional: factor of each cell on surface energies, see
      :func:`multicell.mechanics.pair_values.pair_data`
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
    diffusion: FloatArray | None = None
    sticky: FloatArray | None = None

    @cached_property
    def mean_radius(self) -> float:
        """Mean radius at ``begin``, µm; there must be cells."""
        return float(self.radius.sum()) / len(self.radius)  # NumPy's mean takes three times as long

    @cached_property
    def largest_radius(self) -> float:
        """Radius of the largest cell at either end, µm."""
        return float(np.maximum(self.radius, self.end_radius).max(initial=0.0))

    @cached_property
    def fastest_growth(self) -> float:
        """Largest rate at which a radius changes, µm/s."""
        return float(np.abs(self.radius_rate).max(initial=0.0))

    @property
    def end_radius(self) -> FloatArray:
        """Radius at ``end``, (n,) µm."""
        return self.radius + self.radius_rate * (self.end - self.begin)

    def between(self, begin: float, end: float, touching: NDArray[Any] | None) -> Motion:
        """Return the motion between two times, s; beyond ``end`` all rates stay what they are.

        - ``touching``: as in :class:`Motion`, at the first of the two
        """
        passed = begin - self.begin
        push, bonds = self.push, self.bonds
        if push is not None:
            push = push.copy()
            push[:, :3] += passed * push[:, 3:]
        if bonds is not None:
            bonds = bonds.copy()
            bonds[:, :2] += passed * bonds[:, 2:]
        return replace(
            self,
            radius=self.radius + passed * self.radius_rate,
            begin=begin,
            end=end,
            push=push,
            bonds=bonds,
            touching=touching,
            newborn=self.newborn if passed == 0.0 else None,
        )

    def part(
        self, begin: float, end: float, drag: float, move: FloatArray, touching: NDArray[Any] | None
    ) -> Motion:
        """Return the motion between two times within it, with a force that moves free cells so.

        - ``drag``: 6πη, kPa·s
        - ``move``, (n, 3) µm: of free cells until ``end``, at a constant speed
        - ``touching``: as in :class:`Motion`, at ``begin``
        """
        motion = self.between(begin, end, touching)
        push = np.zeros((len(self.radius), 6)) if motion.push is None else motion.push
        speed = move / (end - begin)
        push[:, :3] += drag * motion.radius[:, None] * speed
        push[:, 3:] += drag * self.radius_rate[:, None] * speed
        return replace(motion, push=push, diffusion=None)

    def drift(self, drag: float) -> FloatArray:
        """Return how far cells move by external forces and prescribed motion alone, (n, 3) µm.

        The integral of F(t) / (6πη r(t)) with both running linearly in time.

        - ``drag``: 6πη, kPa·s
        """
        length, out = self.end - self.begin, np.zeros((len(self.radius), 3))
        if self.push is not None:
            growth = self.radius_rate * length / self.radius
            # ∫ 1 / (1 + g s) ds and ∫ s / (1 + g s) ds over 0 ... 1
            first, second = np.ones_like(growth), np.full_like(growth, 0.5)
            few = np.abs(growth) > _LEAST_GROWTH
            first[few] = np.log1p(growth[few]) / growth[few]
            second[few] = (1.0 - first[few]) / growth[few]
            # the next terms of the series are below rounding
            rest = growth[~few]
            first[~few] = 1.0 + rest * (-1.0 / 2.0 + rest * (1.0 / 3.0 - rest / 4.0))
            second[~few] = 1.0 / 2.0 + rest * (-1.0 / 3.0 + rest * (1.0 / 4.0 - rest / 5.0))
            out = first[:, None] * self.push[:, :3] + (length * second)[:, None] * self.push[:, 3:]
            out *= (length / (drag * self.radius))[:, None]
        if self.held is not None and self.velocity is not None:
            out = np.where(self.held[:, None], self.velocity * length, out)
        return np.asarray(out)
