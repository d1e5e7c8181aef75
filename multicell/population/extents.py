"""Lengths of a population: centre, radius, necrotic core, viable rim.

A ball and a disc have formulas of their own, so that functions need the dimensions of the scene.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Final, final

import numpy as np

from multicell.cells import SPHERE, Cells, FloatArray, Mask, State
from multicell.population.regions import Surroundings, inhibited_region, region_radius
from multicell.vectors import cubes, lengths, squares_about, weighted_mean

_GROWING, _RESTING = int(State.PROLIFERATING), int(State.QUIESCENT)  # numbers compare faster

INHIBITED: Final = 0.2  # of the cycling part at the rim: the criterion of Browning et al. (2021)


def sizes(cells: Cells, dimensions: int) -> FloatArray:
    """Return the size of each cell, (n,): volume in µm³, in a plane its area in µm²."""
    return cells.volume if dimensions == 3 else np.asarray(np.pi * cells.radius**2)


def centre(cells: Cells, dimensions: int) -> FloatArray:
    """Return the centroid of all cells, weighted by :func:`sizes`: (3,), µm."""
    if len(cells) == 0:
        raise ValueError("a population of no cells has no centre")
    return np.asarray(weighted_mean(cells.position, sizes(cells, dimensions)))


def distances(cells: Cells, origin: FloatArray) -> FloatArray:
    """Return the distance of every cell's centre from ``origin``: (n,), µm."""
    return lengths(cells.position - origin)


@final
class Extent:
    """How far a population reaches: computed once for all lengths that a row of a history has.

    - ``cells``: the population
    - ``dimensions``: of the scene: 3, or 2 where all cells lie in a plane
    - ``origin``, (3,) µm: point from which distances are taken, by default the centre of all cells
    """

    def __init__(self, cells: Cells, dimensions: int, origin: FloatArray | None = None) -> None:
        self._dimensions = dimensions
        self._weights = sizes(cells, dimensions)
        self._squares, self._away, self.origin = np.empty(0), np.empty(0), np.zeros(3)
        self._cells, self._state, self._radii = cells, cells.state, cells.radius
        if len(cells):
            if origin is None:
                origin = weighted_mean(cells.position, self._weights)
            share = dimensions / (dimensions + 2)
            self.origin = origin
            self._columns = np.ascontiguousarray(cells.position.T)
            self._away = squares_about(self._columns, origin)
            self._squares = self._away + share * cells.radius**2

    def radius(self, mask: Mask | None = None) -> float:
        """Return the :func:`uniform_radius` of all cells, or of those of a mask, µm; 0 of none."""
        if mask is None:
            return self._radius
        return self._radius_of(self._squares[mask], self._weights[mask])

    @cached_property
    def _radius(self) -> float:
        return self._radius_of(self._squares, self._weights)

    def _radius_of(self, squares: FloatArray, weights: FloatArray) -> float:
        if len(squares) == 0:
            return 0.0
        d = self._dimensions
        return math.sqrt((d + 2) / d * weighted_mean(squares, weights))

    def diameter(self) -> float:
        """Return twice the radius of all cells, µm; 0 without cells."""
        return 2.0 * self.radius()

    def core(self, inside: Mask, others: float = 0.5) -> float:
        """Return the radius of the region round the centre in which most cells are of a mask, µm.

        0 without one; see :func:`multicell.population.regions.region_radius`, also for ``others``.
        """
        return region_radius(self._around, inside, others) if len(inside) else 0.0

    @cached_property
    def _around(self) -> Surroundings:
        args = (self._radii, self.origin, self.radius(), self._dimensions)
        return Surroundings(self._columns, *args, self._away)

    @cached_property
    def dead_core(self) -> float:
        """Radius of the core of dead cells and of what they left empty, µm; 0 without one."""
        return self.core(self._state > _RESTING)

    @cached_property
    def resting_core(self) -> float:
        """Radius of the region in which most cells are dead or quiescent, µm; 0 without one."""
        return self.core(self._state != _GROWING)

    @cached_property
    def inhibited(self) -> float:
        """The :func:`inhibited_radius` of the cells, µm."""
        return self.inhibited_below(INHIBITED)

    def inhibited_below(self, threshold: float) -> float:
        """Return the :func:`inhibited_radius` of the cells by a threshold, µm."""
        if not len(self._cells):
            return 0.0
        return max(inhibited_region(self._cells, self._around, threshold), self.dead_core)

    def viable_volume(self) -> float:
        """Return the volume of the ball of all cells less that of the necrotic core in µm³.

        NaN without living cells.
        """
        volume = SPHERE * (self.radius() ** 3 - self.dead_core**3)
        return volume if volume > 0.0 and not self._cells.dead.all() else math.nan

    def rim(self, core: float) -> float:
        """Return the thickness of the layer outside a core, µm; NaN without a core."""
        return self.radius() - core if core > 0.0 else float("nan")

    def packing_ratio(self) -> float:
        """Return the sum of the cells' volumes over the volume of the ball round them, NaN if none.

        In a plane it is areas over the area of the disc. Spheres that do not overlap stay at or
        below 1, since no body has a smaller radius of gyration than the ball of its volume;
        :func:`multicell.scene.packing.densest` says how much overlap is too much.
        """
        if len(self._radii) == 0:
            return float("nan")
        ratio = self._radii / self.radius()
        return float((cubes(ratio) if self._dimensions == 3 else ratio * ratio).sum())


@final
class NoExtent:
    """Lengths of a population that fills space without end: there is no centre, and no number."""

    dead_core = resting_core = inhibited = math.nan

    def radius(self, mask: Mask | None = None) -> float:
        """Return NaN."""
        return math.nan

    diameter = packing_ratio = radius

    def viable_volume(self) -> float:
        """Return NaN."""
        return math.nan

    def core(self, inside: Mask, others: float = 0.5) -> float:
        """Return NaN."""
        return math.nan

    def rim(self, core: float) -> float:
        """Return NaN."""
        return math.nan


def uniform_radius(
    cells: Cells, origin: FloatArray, dimensions: int, mask: Mask | None = None
) -> float:
    """Return the radius of the uniform ball (or disc) with the cells' radius of gyration.

    In d dimensions the mean square distance from the centre of a uniform ball of radius R is
    q R² with q = d / (d + 2): 3/5 in space, 1/2 in a plane. So
    R² = Σ s_i (|x_i - origin|² + q r_i²) / (q Σ s_i), with the volumes s_i of the cells in space
    and their areas in a plane. The second term is the cell's own extent, which makes the formula
    exact for a single cell too. Cells that stick out count little and gaps between cells do not
    count at all.

    - ``cells``: the population
    - ``origin``, (3,) µm: point from which distances are taken
    - ``dimensions``: of the scene: 3, or 2 where all cells lie in a plane
    - ``mask``, (n,) bool: cells to take; all of them when absent

    Returns float: radius in µm; 0 if no cell is taken.
    """
    return Extent(cells, dimensions, origin).radius(mask)


def inhibited_radius(cells: Cells, dimensions: int, threshold: float = INHIBITED) -> float:
    """Return the radius within which proliferation is inhibited, in µm; 0 if it is nowhere.

    Inside, the share of the cells that are alive, not quiescent, and in S, G2 or M (green with
    FUCCI) is below a fifth (``threshold``) of that in the outermost tenth: the criterion of
    Browning et al. (2021, doi:10.7554/eLife.73020) for confocal sections. It is at least the
    radius of the necrotic core, and that of all cells where none of them cycles.
    """
    return Extent(cells, dimensions).inhibited_below(threshold)


def necrotic_radius(cells: Cells, dimensions: int, alive: float = 0.5) -> float:
    """Return the radius of the necrotic core in µm; 0 if there is none.

    It is the region round the centre in which most cells are dead or have been removed.

    - ``cells``: the population
    - ``dimensions``: of the scene: 3, or 2 where all cells lie in a plane
    - ``alive``: largest share of living cells at its border: 0.5 where half of them live, as the
      border of a stained section is drawn; 0 for the region that has no living cell at all
    """
    return Extent(cells, dimensions).core(cells.dead, alive)
