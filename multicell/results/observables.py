"""Numbers that describe a population: size, necrotic core, viable rim, radial profiles.

All functions take a state and return plain numbers or arrays; none of them changes a state. Where
lengths are measured they need the dimensions of the scene: a ball and a disc have formulas of
their own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numpy.typing import NDArray

from multicell.behaviours.catalogue import needs_contacts
from multicell.cells import SPHERE, Cells, FloatArray, IntArray, State
from multicell.contact.law import compliance
from multicell.results.regions import Mask, Surroundings, inhibited_region, region_radius
from multicell.vectors import cubes, lengths, squares, weighted_mean

if TYPE_CHECKING:
    from multicell.mechanics.compression import TissueCompression
    from multicell.mechanics.sphere import Sphere
    from multicell.mechanics.walls import Walls
    from multicell.results.frame import Field, Frame
    from multicell.scene.scene import Scene


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
        self._squares, self.origin = np.empty(0), np.zeros(3)
        self._cells, self._state, self._radii = cells, cells.state, cells.radius
        if len(cells):
            if origin is None:
                origin = weighted_mean(cells.position, self._weights)
            share = dimensions / (dimensions + 2)
            self.origin = origin
            self._squares = squares(cells.position - origin) + share * cells.radius**2

    def radius(self, mask: Mask | None = None) -> float:
        """Return the :func:`uniform_radius` of all cells, or of those of a mask, µm; 0 of none."""
        if mask is None:
            return self._radius
        taken = self._squares[mask]
        if len(taken) == 0:
            return 0.0
        d = self._dimensions
        return math.sqrt((d + 2) / d * weighted_mean(taken, self._weights[mask]))

    @cached_property
    def _radius(self) -> float:
        return self.radius(np.ones(len(self._radii), dtype=bool))

    def diameter(self) -> float:
        """Return twice the radius of all cells, µm; 0 without cells."""
        return 2.0 * self.radius()

    def core(self, inside: Mask, others: float = 0.5) -> float:
        """Return the radius of the region round the centre in which most cells are of a mask, µm.

        0 without one; see :func:`multicell.results.regions.region_radius`, also for ``others``.
        """
        return region_radius(self._around, inside, others) if len(inside) else 0.0

    @cached_property
    def _around(self) -> Surroundings:
        args = (self._radii, self.origin, self.radius(), self._dimensions)
        return Surroundings(self._cells.position, *args)

    @cached_property
    def dead_core(self) -> float:
        """Radius of the core of dead cells and of what they left empty, µm; 0 without one."""
        return self.core(self._state > State.QUIESCENT)

    @cached_property
    def resting_core(self) -> float:
        """Radius of the region in which most cells are dead or quiescent, µm; 0 without one."""
        return self.core(self._state != State.PROLIFERATING)

    @cached_property
    def inhibited(self) -> float:
        """The :func:`inhibited_radius` of the cells, µm."""
        return self.inhibited_below(0.2)

    def inhibited_below(self, threshold: float) -> float:
        """Return the :func:`inhibited_radius` of the cells by a threshold, µm."""
        if not len(self._cells):
            return 0.0
        return max(inhibited_region(self._cells, self._around, threshold), self.dead_core)

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


def viable_volume(cells: Cells) -> float:
    """Return the volume of the ball of all cells less that of the necrotic core in µm³.

    NaN without living cells.
    """
    extent = Extent(cells, 3)
    volume = SPHERE * (extent.radius() ** 3 - extent.dead_core**3)
    return volume if volume > 0.0 and not cells.dead.all() else float("nan")


def inhibited_radius(cells: Cells, dimensions: int, threshold: float = 0.2) -> float:
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


def settle_gel(cells: Cells, walls: Walls | Sphere, compression: TissueCompression | None) -> float:
    """Let a gel give way to the cells; return what compressed tissue adds to its pressure, kPa.

    Sisters that have just parted count with their whole overlap.
    """
    softness = compliance(cells.young, cells.poisson)
    rows = np.column_stack([cells.position, cells.radius, softness])
    if compression is None:
        walls.settle(rows, None, None)
        return 0.0
    return compression.wall_pressure(rows, walls)


def wall_pressure(
    cells: Cells, walls: Walls | Sphere, compression: TissueCompression | None = None
) -> float:
    """Return the pressure on the walls in kPa, of a box the mean of the six sides."""
    softness = np.asarray(compliance(cells.young, cells.poisson))
    pressed = settle_gel(cells, walls, compression)
    return float(walls.pressures(cells.position, cells.radius, softness).mean()) + pressed


def tissue_pressure(cells: Cells, walls: Walls | Sphere) -> float:
    """Return the pressure of the tissue in a box in kPa: the sum of p_i V_i over its volume.

    With the pressures p_i of the cells that is the virial stress, a third of its trace. At rest it
    is the pressure on the walls.
    """
    return float(cells.pressure @ cells.volume) / walls.volume


def heterotypic_fraction(cells: Cells, contacts: IntArray) -> float:
    """Return the part of all contacts that join cells of different types, NaN without contacts.

    - ``cells``: all cells
    - ``contacts``, (m, 2): identities of the cells of each pair in contact
    """
    kind = cells.kind[contact_rows(cells, contacts)]
    return float((kind[:, 0] != kind[:, 1]).mean()) if len(kind) else float("nan")


def contact_rows(cells: Cells, contacts: IntArray) -> IntArray:
    """Return the rows of the cells of each pair, given by identities: (m, 2), absent ones left out.

    - ``cells``: all cells
    - ``contacts``, (m, 2): identities
    """
    rows = cells.rows_of(contacts).reshape(-1, 2)
    return rows[(rows >= 0).all(axis=1)]


@final
@dataclass(frozen=True, eq=False)
class RadialProfile:
    """Averages over spherical shells, in a plane over rings, about the centre of a population.

    Means are NaN in a shell without cells.
    """

    edges: FloatArray  # of the shells, (b + 1,) µm
    counts: IntArray  # cells whose centre lies in the shell, (b,)
    fractions: Mapping[str, FloatArray]  # part of these cells that are in a state, (b,)
    concentrations: Mapping[str, FloatArray]  # mean at these cells by field, (b,) mM
    pressure: FloatArray  # mean of these cells, (b,) kPa

    @property
    def middles(self) -> FloatArray:
        """Radius half-way through each shell: (b,), µm."""
        return np.asarray(0.5 * (self.edges[1:] + self.edges[:-1]))


def radial_profile(frame: Frame, dimensions: int, bins: int = 20) -> RadialProfile:
    """Return averages over ``bins`` shells (or rings) of equal thickness that hold all cells."""
    if bins < 1:
        raise ValueError(f"a profile needs at least 1 bin, got {bins}")
    cells = frame.cells
    radius = distances(cells, centre(cells, dimensions))
    edges = np.linspace(0.0, max(float(radius.max()), float(cells.radius.max())), bins + 1)
    return RadialProfile(
        edges=edges,
        counts=np.histogram(radius, edges)[0],
        fractions={s.name.lower(): means(radius, edges, cells.state == s) for s in State},
        concentrations={n: means(radius, edges, c) for n, c in frame.concentrations.items()},
        pressure=means(radius, edges, cells.pressure),
    )


def field_profile(field: Field, origin: FloatArray, edges: FloatArray) -> FloatArray:
    """Return the mean of a field over shells about ``origin``: (b,), in the field's unit.

    - ``field``: the field
    - ``origin``, (3,) µm: common centre of the shells
    - ``edges``, (b + 1,) µm: boundaries of the shells, increasing

    Returns (b,) float64: means over the grid points; NaN in a shell that holds none.
    """
    if field.kind == "radial":
        return means(field.axis(0) - field.origin[0], edges, field.values.ravel())
    axes = np.meshgrid(*(field.axis(k) - origin[k] for k in range(3)), indexing="ij", sparse=True)
    radius = np.sqrt(sum(axis**2 for axis in axes)).ravel()
    return means(radius, edges, field.values.ravel())


def field_at(field: Field, origin: FloatArray, distance: float) -> float:
    """Return the mean of a field over the shell at a distance from ``origin``, in the field's unit.

    Linear between the means over shells as thick as the grid's spacing. Beyond the grid it is the
    value at its edge, at a negative distance that on the other side of ``origin``.
    """
    middles, means = field.axis(0) - field.origin[0], field.values.ravel()
    if field.kind != "radial":
        ends = [np.abs(field.axis(k)[[0, -1]] - origin[k]).max() for k in range(3)]
        edges = np.arange(0.0, np.linalg.norm(ends) + field.spacing, field.spacing)
        found = field_profile(field, origin, edges)
        filled = np.isfinite(found)
        middles, means = 0.5 * (edges[1:] + edges[:-1])[filled], found[filled]
    return float(np.interp(abs(distance), middles, means))


def means(place: NDArray[Any], edges: FloatArray, values: NDArray[Any]) -> FloatArray:
    """Return the means of ``values`` by place between ``edges``; NaN where there are none."""
    count = np.histogram(place, edges)[0]
    total = np.histogram(place, edges, weights=values.astype(float))[0]
    found = np.full(len(count), np.nan)
    np.divide(total, count, out=found, where=count > 0)
    return found


def counts_contacts(scene: Scene) -> bool:
    """Return whether anything asks for the pairs in contact; to find them costs a little."""
    if scene.contact.remembers or len(scene.types) > 1 or scene.pull is not None:
        return True
    named = {name for part in scene.responses.values() for name in part.signals}
    named |= {name for part in scene.networks.values() for name in (part.inputs or {}).values()}
    named |= set() if scene.growth is None else scene.growth.signals
    return any(map(needs_contacts, named))


def touching(frame: Frame) -> NDArray[np.int64]:
    """Return the rows of the cells of each pair in contact: (m, 2).

    Where a run does not count its contacts, those whose spheres overlap.
    """
    pairs = contact_rows(frame.cells, frame.contacts)
    return pairs if len(pairs) else _overlapping(frame.cells)


def _overlapping(cells: Cells) -> NDArray[np.int64]:
    from scipy.spatial import cKDTree

    tree = cKDTree(cells.position)
    near = tree.query_pairs(2.0 * cells.radius.max(initial=0.0), output_type="ndarray")
    first, second = near.T
    apart = np.linalg.norm(cells.position[first] - cells.position[second], axis=1)
    near = near[apart < cells.radius[first] + cells.radius[second]].astype(np.int64)
    return np.asarray(near[np.lexsort((near[:, 1], near[:, 0]))])
