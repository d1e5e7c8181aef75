"""Numbers that describe a state: pressures, contacts between types, radial profiles.

All functions take a state and return plain numbers or arrays; none of them changes a state. Lengths
of the population alone are those of :mod:`multicell.population.extents`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import Cells, FloatArray, IntArray, State, contact_rows
from multicell.contact.law import compliance
from multicell.population.extents import centre, distances

if TYPE_CHECKING:
    from multicell.mechanics.compression import TissueCompression
    from multicell.mechanics.sphere import Sphere
    from multicell.mechanics.walls import Walls
    from multicell.results.frame import Field, Frame


def settle_gel(cells: Cells, walls: Walls | Sphere, compression: TissueCompression | None) -> float:
    """Deform a gel by the cells; return the pressure that compressed tissue adds to it, kPa.

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
