"""Springs between given pairs of cells, whatever their distance, besides the law of contacts.

With the distance d of two centres, the stiffness k and the length at rest L the tension is
T = k (d - L), the energy ½ k (d - L)², and with n from cell i to cell j the force on i is T n, on j
-T n. Linearised, a spring is K = k n nᵀ + (T/d)(I - n nᵀ), as a contact with dF/dh = k, F = -T.

The loops are over the springs, on one thread: the same bits for any number of threads.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from multicell.compiling import KERNEL
from multicell.mechanics.blocks import add_block

if TYPE_CHECKING:
    from multicell.cells import FloatArray

_TINY = 1e-300
"""Keeps coincident centres finite: their direction, and so their force, is zero."""


@njit(**KERNEL)
def _add_forces(rows, pairs, spring, drag, out):
    """Add the springs' forces, nN, or with ``drag`` what they add to velocities, µm/s."""
    for e in range(pairs.shape[0]):
        i, j = pairs[e, 0], pairs[e, 1]
        dx, dy, dz = rows[j, 0] - rows[i, 0], rows[j, 1] - rows[i, 1], rows[j, 2] - rows[i, 2]
        d = math.sqrt(dx * dx + dy * dy + dz * dz + _TINY)
        over = spring[e, 0] * (d - spring[e, 1]) / d
        a, b = over, over
        if drag > 0.0:
            a /= drag * rows[i, 3]
            b /= drag * rows[j, 3]
        out[i, 0] += a * dx
        out[i, 1] += a * dy
        out[i, 2] += a * dz
        out[j, 0] -= b * dx
        out[j, 1] -= b * dy
        out[j, 2] -= b * dz


@njit(**KERNEL)
def _linearise(rows, pairs, spring, out):
    """Write direction, k and T/d of each spring, (m, 5)."""
    for e in range(pairs.shape[0]):
        i, j = pairs[e, 0], pairs[e, 1]
        dx, dy, dz = rows[j, 0] - rows[i, 0], rows[j, 1] - rows[i, 1], rows[j, 2] - rows[i, 2]
        d = math.sqrt(dx * dx + dy * dy + dz * dz + _TINY)
        out[e, 0], out[e, 1], out[e, 2] = dx / d, dy / d, dz / d
        out[e, 3] = spring[e, 0]
        out[e, 4] = spring[e, 0] * (d - spring[e, 1]) / d


@njit(**KERNEL)
def _add_products(rows, pairs, link, drag, v, out):
    """Add the change of the springs' forces for a displacement ``v``, or of velocities."""
    for e in range(pairs.shape[0]):
        i, j = pairs[e, 0], pairs[e, 1]
        vx, vy, vz = v[j, 0] - v[i, 0], v[j, 1] - v[i, 1], v[j, 2] - v[i, 2]
        nx, ny, nz, t = link[e, 0], link[e, 1], link[e, 2], link[e, 4]
        stretch = (link[e, 3] - t) * (nx * vx + ny * vy + nz * vz)
        fx, fy, fz = stretch * nx + t * vx, stretch * ny + t * vy, stretch * nz + t * vz
        a, b = 1.0, 1.0
        if drag > 0.0:
            a /= drag * rows[i, 3]
            b /= drag * rows[j, 3]
        out[i, 0] += a * fx
        out[i, 1] += a * fy
        out[i, 2] += a * fz
        out[j, 0] -= b * fx
        out[j, 1] -= b * fy
        out[j, 2] -= b * fz


@njit(**KERNEL)
def _add_blocks(pairs, link, out):
    """Add the stable part of each spring's stiffness to the blocks of its cells, (n, 6) nN/µm."""
    for e in range(pairs.shape[0]):
        t = max(link[e, 4], 0.0)
        for side in range(2):
            add_block(
                out, pairs[e, side], link[e, 3] - t, t, link[e, 0], link[e, 1], link[e, 2]
            )  # fmt: skip


@njit(**KERNEL)
def _energy_and_virials(rows, pairs, spring, virials):
    """Return the energy of all springs, fJ; add ½ (-T) d to both of their cells, nN µm."""
    total = 0.0
    for e in range(pairs.shape[0]):
        i, j = pairs[e, 0], pairs[e, 1]
        dx, dy, dz = rows[j, 0] - rows[i, 0], rows[j, 1] - rows[i, 1], rows[j, 2] - rows[i, 2]
        d = math.sqrt(dx * dx + dy * dy + dz * dz + _TINY)
        longer = d - spring[e, 1]
        total += 0.5 * spring[e, 0] * longer * longer
        virials[i] -= 0.5 * spring[e, 0] * longer * d
        virials[j] -= 0.5 * spring[e, 0] * longer * d
    return total


@final
@dataclass(frozen=True, eq=False)
class SpringGraph:
    """Springs of a coupling step.

    Cells come as ``rows`` (n, 4 or more): centre and radius; see :mod:`multicell.mechanics.forces`.

    Parameters
    ----------
    pairs : (m, 2) int64
        Cells that a spring joins.
    spring : (m, 2)
        Stiffness, nN/µm, and length at rest, µm.
    """

    pairs: NDArray[np.int64]
    spring: FloatArray

    def add_forces(self, rows: FloatArray, drag: float, out: FloatArray) -> None:
        """Add the forces to ``out``, (n, 3) nN, or with a ``drag`` 6πη the velocities, µm/s."""
        _add_forces(rows, self.pairs, self.spring, drag, out)

    def linearised(self, rows: FloatArray) -> FloatArray:
        """Return direction, k and T/d of each spring, (m, 5), nN/µm."""
        out = np.empty((len(self.pairs), 5))
        _linearise(rows, self.pairs, self.spring, out)
        return out

    def add_products(
        self, rows: FloatArray, link: FloatArray, drag: float, vector: FloatArray, out: FloatArray
    ) -> None:
        """Add K v with :meth:`linearised` to forces, or over the cells' drag to velocities.

        ``vector`` and ``out`` are (n, 3); without drag, ``drag`` is zero.
        """
        _add_products(rows, self.pairs, link, drag, vector, out)

    def add_blocks(self, link: FloatArray, out: FloatArray) -> None:
        """Add the springs' part of each cell's diagonal block, stable part, (n, 6) nN/µm."""
        _add_blocks(self.pairs, link, out)

    def diagonal(self, link: FloatArray, n: int) -> FloatArray:
        """Return the stable stiffness of each cell's springs along each axis, (n, 3) nN/µm."""
        blocks = np.zeros((n, 6))
        self.add_blocks(link, blocks)
        return np.ascontiguousarray(blocks[:, :3])

    def energy(self, rows: FloatArray) -> float:
        """Return the energy Σ ½ k (d - L)², fJ."""
        return float(_energy_and_virials(rows, self.pairs, self.spring, np.zeros(len(rows))))

    def add_virials(self, rows: FloatArray, virials: FloatArray) -> None:
        """Add half of -T d of each spring to both of its cells, (n,) nN µm."""
        _energy_and_virials(rows, self.pairs, self.spring, virials)

    def sides(self, link: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]:
        """Return the ends i, j of each spring, both ways, and (xx, yy, zz, xy, xz, yz) of K."""
        x, y, z = link[:, :3].T
        k, t = link[:, 3] - link[:, 4], link[:, 4]
        six = np.stack(
            [k * x * x + t, k * y * y + t, k * z * z + t, k * x * y, k * x * z, k * y * z], axis=1
        )
        i, j = self.pairs.T
        return np.concatenate([i, j]), np.concatenate([j, i]), np.concatenate([six, six])

    def stiffest(self, n: int) -> float:
        """Return the largest sum of the stiffness of one cell's springs, nN/µm."""
        total = np.bincount(self.pairs.ravel(), np.repeat(self.spring[:, 0], 2), n)
        return float(total.max(initial=0.0))
