"""A spherical wall about the origin: rigid in place, or the cavity of an elastic gel that yields.

A cell of radius r_i at the distance ρ from the origin presses with h = ρ + r_i - R against the
wall as against a flat side of a box (:mod:`multicell.mechanics.walls`; r_i is small against R).

The gel is an infinite incompressible neo-Hookean medium of shear modulus G with a cavity of radius
R_0 that is free of stress. Widened by λ = R/R_0 >= 1 it presses with

    p(λ) = G (5/2 - 2/λ - 1/(2 λ⁴)),     U(R) = 4π R_0³ G (5/6 λ³ - λ² + 1/(2λ) - 1/3)

(Gent & Lindley 1959), p = 4 G (R/R_0 - 1) for small expansions and at most 5/2 G: beyond that
pressure a cavity grows without end. The gel is always at rest: R is where it balances the cells,
N(R) = 4π R² p(R/R_0), found to rounding at every evaluation, N the sum of the forces on the wall,
which falls with R. So the energy of cells and gel is U(x, R(x)), least over R; forces are its
gradient at fixed R, and the stiffness is that at fixed R less c cᵀ/b with c = ∂F/∂R and
b = ∂²U/∂R².
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, final

import numpy as np

from multicell.mechanics.rows import COMPLIANCE, RADIUS, SHORTEST
from multicell.mechanics.walls import Contacts
from multicell.vectors import lengths

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.mechanics.compression import TissueCompression

_ITERATIONS = 200  # bisection alone needs 60


@final
class Sphere:
    """A spherical wall; cells come as ``rows`` (n, 5 or more), as to :class:`Walls`.

    - ``rest``, µm: radius R_0, and R of a wall that does not yield
    - ``soft``, 1/kPa: compliance ¾ (1 - ν²)/E of its surface
    - ``shear``, kPa, optional: shear modulus G of the gel round it; None: it does not yield
    - ``radius``, µm: R at the last state that it was settled at
    """

    def __init__(self, rest: float, soft: float, shear: float | None = None) -> None:
        self.rest, self.soft, self.shear = rest, soft, shear
        self.radius = rest
        self._bend = math.inf

    @property
    def volume(self) -> float:
        """Volume within the wall, µm³."""
        return 4.0 / 3.0 * math.pi * self.radius**3

    def settle(
        self, rows: FloatArray, compression: TissueCompression | None, taken: FloatArray | None
    ) -> None:
        """Find R for cells at a state; ``taken`` is half of their lenses, µm³."""
        if self.shear is None:
            return
        reach = lengths(rows[:, :3]) + rows[:, RADIUS]
        near = reach > self.rest
        reach, radius, soft = reach[near], rows[near, RADIUS], rows[near, COMPLIANCE]
        lenses = None if taken is None else taken[near]
        low, high = self.rest, max(float(reach.max(initial=self.rest)), self.rest)
        guess = min(max(self.radius, low), high)
        for _ in range(_ITERATIONS):
            excess, bend = self._excess(guess, reach, radius, soft, compression, lenses)
            if excess > 0.0:
                low = guess
            else:
                high = guess
            better = guess + excess / bend
            if not low <= better <= high:
                better = 0.5 * (low + high)
            # once more at the solution, for the bend
            if abs(better - guess) <= 2e-16 * guess:
                break
            guess = better
        self.radius, self._bend = guess, bend

    def _excess(
        self,
        wall: float,
        reach: FloatArray,
        radius: FloatArray,
        soft: FloatArray,
        compression: TissueCompression | None,
        lenses: FloatArray | None,
    ) -> tuple[float, float]:
        """Return N - 4π R² p of a radius R, nN, and minus its derivative, b."""
        h = np.maximum(reach - wall, 0.0)
        strength = np.sqrt(radius) / (soft + self.soft)
        push, bend = strength * h**1.5, 1.5 * strength * np.sqrt(h)
        if compression is not None and lenses is not None:
            area, volume = 2.0 * np.pi * radius * h, 4.0 / 3.0 * np.pi * radius**3
            _, pressure, slope = compression.law((lenses + np.pi * radius * h**2) / volume)
            push += pressure * area
            bend += slope * area**2 / volume + pressure * 2.0 * np.pi * radius * (h > 0.0)
        stretch, scale = wall / self.rest, 4.0 * math.pi * self.rest * (self.shear or 0.0)
        gel = scale * self.rest * (2.5 * stretch**2 - 2.0 * stretch - 0.5 / stretch**2)
        yielding = scale * (5.0 * stretch - 2.0 + 1.0 / stretch**3)
        return float(push.sum()) - gel, float(bend.sum()) + yielding

    def contacts(self, rows: FloatArray) -> Contacts:
        """Return the contacts of cells at the last radius."""
        distance = lengths(rows[:, :3])
        cell = np.flatnonzero(distance + rows[:, RADIUS] > self.radius)
        inverse = 1.0 / (distance[cell] + SHORTEST)
        gap = self.radius - distance[cell]
        return Contacts(
            cell, rows[cell, :3] * inverse[:, None], rows[cell, RADIUS] - gap, gap, inverse
        )

    def _pressed(self, rows: FloatArray) -> tuple[Contacts, FloatArray, FloatArray]:
        """Return contacts with their forces, nN, and dF/dh, nN/µm."""
        found = self.contacts(rows)
        strength = np.sqrt(rows[found.cell, RADIUS]) / (rows[found.cell, COMPLIANCE] + self.soft)
        root = np.sqrt(found.overlap)
        return found, strength * found.overlap * root, 1.5 * strength * root

    def add_forces(self, rows: FloatArray, drag: float, out: FloatArray) -> None:
        """Add the forces to ``out``, (n, 3) nN, or with a ``drag`` 6πη the velocities, µm/s."""
        found, force, _ = self._pressed(rows)
        if drag > 0.0:
            force = force / (drag * rows[found.cell, RADIUS])
        out[found.cell] -= force[:, None] * found.normal

    def stiffness(self, rows: FloatArray) -> FloatArray:
        """Return -dF/dx of each cell at fixed R: xx, yy, zz, xy, xz, yz, (n, 6) nN/µm."""
        out = np.zeros((len(rows), 6))
        found, force, slope = self._pressed(rows)
        found.add_blocks(slope, force * found.curvature, out)
        return out

    def yielding(
        self, rows: FloatArray, add_pressures: Callable[[FloatArray], None] | None
    ) -> FloatArray | None:
        """Return c/√b of a gel, (n, 3); ``add_pressures`` adds that of compressed tissue."""
        if self.shear is None:
            return None
        out = np.zeros((len(rows), 3))
        found, _, slope = self._pressed(rows)
        out[found.cell] += slope[:, None] * found.normal
        if add_pressures is not None:
            add_pressures(out)
        return out / math.sqrt(self._bend)

    def energy(self, rows: FloatArray) -> float:
        """Return the energy of indentations and gel, fJ."""
        found, force, _ = self._pressed(rows)
        total = float((0.4 * force * found.overlap).sum())
        if self.shear is not None:
            x = self.radius / self.rest
            whole = 5.0 / 6.0 * x**3 - x**2 + 0.5 / x - 1.0 / 3.0
            total += 4.0 * math.pi * self.rest**3 * self.shear * whole
        return total

    def add_virials(self, rows: FloatArray, virials: FloatArray) -> None:
        """Add F d, d the distance of the centre from the wall, to ``virials``, (n,) nN µm."""
        found, force, _ = self._pressed(rows)
        virials[found.cell] += force * found.distance

    def subtract_products(
        self,
        rows: FloatArray,
        stiffness: FloatArray,
        drag: float,
        vector: FloatArray,
        out: FloatArray,
    ) -> None:
        """Take K v with :meth:`stiffness` from forces; over drag times radius from velocities."""
        xx, yy, zz, xy, xz, yz = stiffness.T
        x, y, z = vector.T
        image = np.stack(
            [xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z], axis=1
        )
        out -= image / (drag * rows[:, 3, None]) if drag > 0.0 else image

    def pressures(
        self, position: FloatArray, radius: FloatArray, softness: FloatArray
    ) -> FloatArray:
        """Return the pressure of the cells on the wall, force over area, (1,) kPa."""
        rows = np.column_stack([position, radius, softness])
        found, force, _ = self._pressed(rows)
        return np.array([self.mean_pressure(found, force)])

    def mean_pressure(self, contacts: Contacts, force: FloatArray) -> float:
        """Return the forces of contacts over the area of the wall, kPa."""
        return float(force.sum() / (4.0 * math.pi * self.radius**2))
