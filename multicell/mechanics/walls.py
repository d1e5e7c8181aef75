"""Elastic walls of a fixed domain: what a flat side does to a cell that presses against it.

A side is an elastic half space, a cell a sphere: with the distance d of the cell's centre from
the side the indentation is h = r_i - d, and the force on the cell, towards the inside,

    F = E_iw √r_i h^{3/2} for h > 0,     1/E_iw = ¾ [(1 - ν_i²)/E_i + (1 - ν_w²)/E_w]

(Hertz 1882; eqs 3.2 to 3.4 with 1/r_w = 0). There is neither adhesion nor friction. Its energy is
U = (2/5) E_iw √r_i h^{5/2}. The force acts along the axis only and depends on that coordinate
alone, so that its derivative is one number for each axis of each cell.

A side at infinity is no side. The loops are over the cells and not over pairs, and run on one
thread: the same bits for any number of threads.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, NamedTuple, final

import numpy as np
from numba import njit

from multicell.cells import FloatArray, IntArray
from multicell.compiling import KERNEL
from multicell.mechanics.rows import COMPLIANCE, RADIUS

if TYPE_CHECKING:
    from multicell.mechanics.compression import TissueCompression


@njit(**KERNEL)
def _add_forces(rows, low, high, soft, drag, out):
    """Add the forces of the sides, nN, or with ``drag`` what they add to velocities, µm/s."""
    for i in range(rows.shape[0]):
        radius = rows[i, RADIUS]
        strength = math.sqrt(radius) / (rows[i, COMPLIANCE] + soft)
        if drag > 0.0:
            strength /= drag * radius
        for a in range(3):
            h = radius - (rows[i, a] - low[a])
            if h > 0.0:
                out[i, a] += strength * h * math.sqrt(h)
            h = radius - (high[a] - rows[i, a])
            if h > 0.0:
                out[i, a] -= strength * h * math.sqrt(h)


@njit(**KERNEL)
def _stiffness(rows, low, high, soft, out):
    """Write minus the derivative of each component of the force by its coordinate, nN/µm."""
    for i in range(rows.shape[0]):
        radius = rows[i, RADIUS]
        strength = 1.5 * math.sqrt(radius) / (rows[i, COMPLIANCE] + soft)
        for a in range(3):
            near = max(radius - (rows[i, a] - low[a]), 0.0)
            far = max(radius - (high[a] - rows[i, a]), 0.0)
            out[i, a] = strength * (math.sqrt(near) + math.sqrt(far))


@njit(**KERNEL)
def _energies_and_virials(rows, low, high, soft, virials):
    """Return the energy of all indentations, fJ; add F d of each cell to ``virials``, nN µm."""
    total = 0.0
    for i in range(rows.shape[0]):
        radius = rows[i, RADIUS]
        strength = math.sqrt(radius) / (rows[i, COMPLIANCE] + soft)
        for a in range(3):
            for distance in (rows[i, a] - low[a], high[a] - rows[i, a]):
                h = radius - distance
                if h > 0.0:
                    force = strength * h * math.sqrt(h)
                    total += 0.4 * force * h
                    virials[i] += force * distance
    return total


@njit(**KERNEL)
def _subtract_products(rows, stiffness, drag, vector, out):
    """Subtract stiffness times ``vector``; over ``drag`` times the radius where there is drag."""
    for i in range(rows.shape[0]):
        scale = 1.0 / (drag * rows[i, RADIUS]) if drag > 0.0 else 1.0
        for a in range(3):
            out[i, a] -= scale * stiffness[i, a] * vector[i, a]


class Contacts(NamedTuple):
    """Contacts of cells with walls: one row for each.

    - ``cell``, (m,) int: who touches
    - ``normal``, (m, 3): unit vector from the cell to the wall
    - ``overlap``, ``distance``, (m,) µm: indentation, and of the centre from the wall
    - ``curvature``, (m,) 1/µm: by which the normal turns as the cell moves along the wall
    """

    cell: IntArray
    normal: FloatArray
    overlap: FloatArray
    distance: FloatArray
    curvature: FloatArray

    def add_blocks(self, along: FloatArray, across: FloatArray | float, out: FloatArray) -> None:
        """Add along n nᵀ + across (I - n nᵀ) of each contact to its cell's stiffness, nN/µm.

        ``out`` is (n, 3), xx, yy, zz, of walls across the axes, else (n, 6) with xy, xz, yz.
        """
        n, part = self.normal, along - across
        six = [
            part * n[:, i] * n[:, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
        ]
        for k in range(out.shape[1]):
            np.add.at(out[:, k], self.cell, six[k] + (across if k < 3 else 0.0))


@final
@dataclass(frozen=True, eq=False)
class Walls:
    """The sides of a box, as flat elastic half spaces.

    Cells come as ``rows`` (n, 5 or more): centre, radius and compliance; see
    :mod:`multicell.mechanics.forces`.

    - ``low``, ``high``, (3,), µm: where the sides are; -inf and inf where there is none
    - ``soft``, float, 1/kPa: compliance ¾ (1 - ν²)/E of the walls; see
      :func:`multicell.contact.law.compliance`
    """

    low: FloatArray
    high: FloatArray
    soft: float
    shear: ClassVar[None] = None  # there is no gel round them

    def add_forces(self, rows: FloatArray, drag: float, out: FloatArray) -> None:
        """Add the forces to ``out``, (n, 3) nN, or with a ``drag`` 6πη the velocities, µm/s."""
        _add_forces(rows, self.low, self.high, self.soft, drag, out)

    @property
    def volume(self) -> float:
        """Volume within the sides, µm³."""
        return float((self.high - self.low).prod())

    def contacts(self, rows: FloatArray) -> Contacts:
        """Return the contacts of cells, as :class:`Contacts` has them, side by side."""
        distance = np.stack([rows[:, :3] - self.low, self.high - rows[:, :3]])
        side, cell, axis = np.nonzero(distance < rows[:, 3, None])
        normal = np.zeros((len(cell), 3))
        normal[np.arange(len(cell)), axis] = np.where(side == 0, -1.0, 1.0)
        near = distance[side, cell, axis]
        return Contacts(cell, normal, rows[cell, RADIUS] - near, near, np.zeros(len(cell)))

    def pressures(
        self, position: FloatArray, radius: FloatArray, softness: FloatArray
    ) -> FloatArray:
        """Return the normal force of cells on each side over its area, (2, 3) kPa.

        Of the lower and the upper sides across x, y and z, which all have to be there.

        - ``position``, ``radius``, ``softness``, (n, 3), (n,) µm; (n,) 1/kPa: of the cells;
          :func:`multicell.contact.law.compliance` is their softness
        """
        distance = np.stack([position - self.low, self.high - position])
        pressed = np.maximum(radius[:, None] - distance, 0.0) ** 1.5
        force = ((np.sqrt(radius) / (softness + self.soft))[:, None] * pressed).sum(axis=1)
        lengths = self.high - self.low
        return np.asarray(force * lengths / lengths.prod())

    def settle(
        self, rows: FloatArray, compression: TissueCompression | None, taken: FloatArray | None
    ) -> None:
        """Do nothing: the sides do not yield."""

    def yielding(self, rows: FloatArray, add_pressures: object) -> None:
        """Return None: the sides do not yield."""

    def mean_pressure(self, contacts: Contacts, force: FloatArray) -> float:
        """Return the forces of contacts over the area of their sides, mean of all six, kPa."""
        lengths = self.high - self.low
        return float((force * (np.abs(contacts.normal) @ lengths)).sum() / (6.0 * lengths.prod()))

    def stiffness(self, rows: FloatArray) -> FloatArray:
        """Return -dF/dx of each cell along each axis, (n, 3) nN/µm, nowhere negative."""
        out = np.empty((len(rows), 3))
        _stiffness(rows, self.low, self.high, self.soft, out)
        return out

    def energy(self, rows: FloatArray) -> float:
        """Return the energy Σ (2/5) E_iw √r_i h^{5/2}, fJ."""
        return float(
            _energies_and_virials(rows, self.low, self.high, self.soft, np.zeros(len(rows)))
        )

    def add_virials(self, rows: FloatArray, virials: FloatArray) -> None:
        """Add F d, d the distance of the centre from the side, to ``virials``, (n,) nN µm.

        A neighbour brings ½ F d_ij, and a side is like a neighbour in the mirror, at 2 d.
        """
        _energies_and_virials(rows, self.low, self.high, self.soft, virials)

    def subtract_products(
        self,
        rows: FloatArray,
        stiffness: FloatArray,
        drag: float,
        vector: FloatArray,
        out: FloatArray,
    ) -> None:
        """Take K v with :meth:`stiffness` from forces, or over drag times radius from velocities.

        ``vector`` and ``out`` are (n, 3); without drag, ``drag`` is zero.
        """
        _subtract_products(rows, stiffness, drag, vector, out)
