"""Tissue that resists compression: a many-body energy of the volume that cells take from others.

Two spheres that overlap by h share a lens of the volume π r_ij h² (the leading term, as Hertz has
it), half of it for each. The loss of a cell, relative to its volume, is its *compression*

    s_i = (1/V_i) [Σ_j (π/2) r_ij h_ij² + Σ_w π r_i h_iw²],

where a wall counts as a neighbour in the mirror. The energy is U = Σ_i V_i f(s_i) with

    f'(s) = C g(s - s_0),     g(x) = 0 for x <= 0,  x²/2b for x < b,  x - b/2 beyond,

twice differentiable and zero below the threshold s_0. So a cell has the pressure p_i = f'(s_i), and

    F_ij = (p_i + p_j)/2 · 2π r_ij h_ij,     F_iw = p_i · 2π r_i h_iw:

the mean pressure of two cells times the area in which their spheres cut each other. In the
face-centred cubic lattice of equal cells at the volume fraction φ the compression is s = 9 y² with
y = 1 - (φ_cp/φ)^{1/3}. The threshold s_0 is that of φ = ``onset``, and C makes ``bulk_modulus`` the
bulk modulus φ dP/dφ of that lattice right above it; P = φ² f'(s) ds/dφ, ds/dφ = 6 y (1 - y)/φ.

The stiffness has a part like that of pairs, with dF/dh at fixed pressures, and -Gᵀ D G of rank n
from the change of the pressures, G_i = ∂(V_i s_i)/∂x and D_i = f''(s_i)/V_i: neighbours of
neighbours. It is applied in two passes, and never destabilises.

Chunks and the order of sums are those of :mod:`multicell.mechanics.forces`: the same bits for any
number of threads. Below the threshold nothing is added: forces keep their bits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple, final

import numpy as np
from numba import njit, prange

from multicell.cells import SPHERE, FloatArray
from multicell.compiling import INLINED, INNER, KERNEL
from multicell.compiling.threads import two_drivers
from multicell.mechanics import forces, neighbours
from multicell.mechanics.rows import RADIUS, SHORTEST
from multicell.vectors import cubes

if TYPE_CHECKING:
    from multicell.mechanics.sphere import Sphere
    from multicell.mechanics.system import Linearisation
    from multicell.mechanics.walls import Contacts, Walls

CLOSE_PACKED = math.pi / math.sqrt(18.0)
"""Volume fraction of the closest packing of spheres that touch."""

_BLEND = 0.02  # b: the threshold is rounded over this compression, 3 % of volume


@njit(**INLINED)
def _overlap(rows, pairs, p):
    """Return π r_ij, the overlap (0 without) and the vector of a pair, µm, and its length."""
    i, j = np.uint32(pairs.first[p]), np.uint32(pairs.second[p])
    dx, dy, dz = rows[j, 0] - rows[i, 0], rows[j, 1] - rows[i, 1], rows[j, 2] - rows[i, 2]
    dx, dy, dz = forces.nearest_image(pairs.period, dx, dy, dz)
    total, square = rows[i, RADIUS] + rows[j, RADIUS], dx * dx + dy * dy + dz * dz
    if square >= total * total:
        return 0.0, 0.0, dx, dy, dz, 1.0
    d = math.sqrt(square + SHORTEST)
    h = total - d
    return math.pi * rows[i, RADIUS] * rows[j, RADIUS] / total, max(h, 0.0), dx, dy, dz, d


@njit(**INNER)
def _lens_chunk(c, chunk, rows, pairs, out):
    for i in range(c * chunk, min((c + 1) * chunk, rows.shape[0])):
        out[i] = 0.0
    for p in range(pairs.start[c], pairs.outer_end[c]):
        scale, h, _, _, _, _ = _overlap(rows, pairs, p)
        if h > 0.0:
            half = 0.5 * scale * h * h
            out[pairs.first[p]] += half
            if p < pairs.inner_end[c]:
                out[pairs.second[p]] += half


def _lenses(chunk, rows, pairs, out):
    """Write half of the lenses that each cell shares with others, µm³."""
    for c in prange(pairs.start.size):
        _lens_chunk(c, chunk, rows, pairs, out)


@njit(**INLINED)
def _add(out, k, scale, x, y, z):
    out[k, 0] += scale * x
    out[k, 1] += scale * y
    out[k, 2] += scale * z


@njit(**INNER)
def _push_chunk(c, rows, pairs, pressure, mobility, out, virials):
    for p in range(pairs.start[c], pairs.outer_end[c]):
        i, j = np.uint32(pairs.first[p]), np.uint32(pairs.second[p])
        both = pressure[i] + pressure[j]
        if both == 0.0:
            continue
        scale, h, dx, dy, dz, d = _overlap(rows, pairs, p)
        over = both * scale * h / d
        virial = 0.5 * over * d * d
        _add(out, i, -over * mobility[i], dx, dy, dz)
        virials[i] += virial
        if p < pairs.inner_end[c]:
            _add(out, j, over * mobility[j], dx, dy, dz)
            virials[j] += virial


def _push(rows, pairs, pressure, mobility, out, virials):
    """Add the forces between cells times their mobilities; and ½ Σ F d to virials."""
    for c in prange(pairs.start.size):
        _push_chunk(c, rows, pairs, pressure, mobility, out, virials)


def _soften(rows, pairs, pressure, slope, along, across):
    """Write dv/dh of each pair, µm², v half its lens; add the stiffness at fixed pressures."""
    for c in prange(pairs.start.size):
        for p in range(pairs.start[c], pairs.outer_end[c]):
            scale, h, _, _, _, d = _overlap(rows, pairs, p)
            both = pressure[pairs.first[p]] + pressure[pairs.second[p]]
            slope[p] = scale * h
            if h > 0.0:
                across[p] += both * scale * h / d
                along[p] += both * scale * (1.0 + h / d)


@njit(**INNER)
def _change_chunk(c, chunk, pairs, normal, slope, v, change):
    for p in range(pairs.start[c], pairs.outer_end[c]):
        if slope[p] == 0.0:
            continue
        i, j = np.uint32(pairs.first[p]), np.uint32(pairs.second[p])
        stretch = 0.0
        for a in range(3):
            stretch += normal[p, a] * (v[i, a] - v[j, a])
        change[i] += slope[p] * stretch
        if p < pairs.inner_end[c]:
            change[j] += slope[p] * stretch


@njit(**INNER)
def _answer_chunk(c, pairs, normal, slope, change, mobility, out):
    for p in range(pairs.start[c], pairs.outer_end[c]):
        i, j = np.uint32(pairs.first[p]), np.uint32(pairs.second[p])
        force = (change[i] + change[j]) * slope[p]
        if force == 0.0:
            continue
        nx, ny, nz = normal[p, 0], normal[p, 1], normal[p, 2]
        _add(out, i, -force * mobility[i], nx, ny, nz)
        if p < pairs.inner_end[c]:
            _add(out, j, force * mobility[j], nx, ny, nz)


def _products(chunk, pairs, normal, slope, weight, mobility, v, change, out):
    """Add -Gᵀ D G v to ``out``; ``change``, of walls before, becomes the change of pressures."""
    for c in prange(pairs.start.size):
        _change_chunk(c, chunk, pairs, normal, slope, v, change)
    for i in prange(change.size):
        change[i] *= weight[i]
    for c in prange(pairs.start.size):
        _answer_chunk(c, pairs, normal, slope, change, mobility, out)


# each for one thread, and for all of them
_LENSES, _PUSH = two_drivers(_lenses), two_drivers(_push)
_SOFTEN, _PRODUCTS = two_drivers(_soften), two_drivers(_products)


class Coupling(NamedTuple):
    """Derivatives that the change of pressures needs at one state.

    - ``slope``, (m,) µm²: dv/dh of each place of the list, v half the lens of a pair
    - ``weight``, (n,) kPa/µm³: f''(s_i)/V_i
    - ``contacts``, ``area``: of cells with walls, and 2π r_i h_iw, µm²
    """

    slope: FloatArray
    weight: FloatArray
    contacts: Contacts | None
    area: FloatArray


class Pressed(NamedTuple):
    """The cells at one state: compression and pressure, (n,), kPa."""

    compression: FloatArray
    pressure: FloatArray
    contacts: Contacts | None


@final
@dataclass(frozen=True)
class TissueCompression:
    """Resistance of tissue to compression; see the module's text.

    Cells come as ``rows`` (n, 5 or more), pairs as :class:`multicell.mechanics.forces.PairData`.

    - ``bulk_modulus``, kPa: of the close-packed lattice right above the threshold
    - ``onset``: volume fraction of that lattice at the threshold, above :data:`CLOSE_PACKED`
    """

    bulk_modulus: float
    onset: float = 1.0

    @property
    def threshold(self) -> float:
        """Compression s_0 from which on a cell resists."""
        return 9.0 * float(1.0 - (CLOSE_PACKED / self.onset) ** (1.0 / 3.0)) ** 2

    @property
    def scale(self) -> float:
        """C, kPa: pressure over compression."""
        y = math.sqrt(self.threshold) / 3.0
        return self.bulk_modulus / (self.onset * (6.0 * y * (1.0 - y)) ** 2)

    def law(self, compression: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return f, f' and f'' of compressions of any shape, kPa."""
        x = np.maximum(compression - self.threshold, 0.0)
        low, b = np.minimum(x, _BLEND), _BLEND
        energy = low**3 / (6.0 * b) + 0.5 * (x - low) * x
        return (
            self.scale * energy,
            self.scale * (low**2 / (2.0 * b) + x - low),
            (self.scale * low / b),
        )

    def pressed(
        self,
        rows: FloatArray,
        pairs: Any,
        chunk: int,
        walls: Walls | Sphere | None,
        *,
        shared: bool = False,
    ) -> Pressed:
        """Return compression and pressure of all cells at a state; walls that yield do so."""
        taken = np.empty(len(rows))
        _LENSES[shared](chunk, rows, pairs, taken)
        contacts = None
        if walls is not None:
            walls.settle(rows, self, taken)
            contacts = walls.contacts(rows)
        if contacts is not None:
            caps = np.pi * rows[contacts.cell, RADIUS] * contacts.overlap**2
            np.add.at(taken, contacts.cell, caps)
        taken /= SPHERE * cubes(rows[:, RADIUS])
        return Pressed(taken, self.law(taken)[1], contacts)

    def add_forces(
        self,
        rows: FloatArray,
        pairs: Any,
        pressed: Pressed,
        drag: float,
        out: FloatArray,
        virials: FloatArray,
        *,
        shared: bool = False,
    ) -> None:
        """Add forces, nN, or with a ``drag`` 6πη velocities; and half virials, nN µm."""
        pressure = pressed.pressure
        if not pressure.any():
            return
        mobility = _mobility(rows, drag)
        _PUSH[shared](rows, pairs, pressure, mobility, out, virials)
        found = pressed.contacts
        if found is None:
            return
        force = pressure[found.cell] * areas(rows, found)
        np.add.at(virials, found.cell, force * found.distance)
        np.subtract.at(out, found.cell, (force * mobility[found.cell])[:, None] * found.normal)

    def wall_pressure(self, rows: FloatArray, walls: Walls | Sphere) -> float:
        """Return the pressure of the cells' pressures on walls, kPa.

        Walls that yield do so.
        """
        near = neighbours.build(rows[:, :3].copy(), rows[:, RADIUS].copy(), 0.0)
        ends = near.start, near.inner_end, near.outer_end
        pairs = forces.PairData(near.first, near.second, *ends, None, None, None)
        pressed = self.pressed(rows, pairs, near.chunk, walls)
        found = pressed.contacts
        assert found is not None
        return walls.mean_pressure(found, pressed.pressure[found.cell] * areas(rows, found))

    def energy(self, rows: FloatArray, pressed: Pressed) -> float:
        """Return Σ V_i f(s_i), fJ."""
        return float(SPHERE * (cubes(rows[:, RADIUS]) * self.law(pressed.compression)[0]).sum())

    def linearise(
        self,
        rows: FloatArray,
        pressed: Pressed,
        linear: Linearisation,
        *,
        shared: bool = False,
    ) -> Coupling:
        """Add the stiffness at fixed pressures to a linearisation; return what is left."""
        slope, found = np.zeros(len(linear.along)), pressed.contacts
        _SOFTEN[shared](rows, linear.data, pressed.pressure, slope, linear.along, linear.across)
        weight = self.law(pressed.compression)[2] / (SPHERE * cubes(rows[:, RADIUS]))
        area = np.empty(0)
        if found is not None:
            area = areas(rows, found)
            own = pressed.pressure[found.cell]
            found.add_blocks(
                own * 2.0 * np.pi * rows[found.cell, RADIUS],
                own * area * found.curvature,
                linear.walls,
            )
        return Coupling(slope, weight, found, area)

    def add_yielding(
        self,
        chunk: int,
        rows: FloatArray,
        linear: Linearisation,
        pressed: Pressed,
        out: FloatArray,
        *,
        shared: bool = False,
    ) -> None:
        """Add the derivative of the forces by the radius of a spherical wall, (n, 3) nN/µm."""
        found, still = pressed.contacts, np.zeros_like(out)
        assert found is not None
        fixed = pressed.pressure[found.cell] * 2.0 * np.pi * rows[found.cell, RADIUS]
        out[found.cell] += fixed[:, None] * found.normal
        self.add_products(chunk, rows, linear, 0.0, still, out, shared=shared, widened=1.0)

    def add_products(
        self,
        chunk: int,
        rows: FloatArray,
        linear: Linearisation,
        drag: float,
        vector: FloatArray,
        out: FloatArray,
        *,
        shared: bool = False,
        widened: float = 0.0,
    ) -> None:
        """Add what the change of pressures does along ``vector``, (n, 3), to forces or velocities.

        - ``widened``, µm: how far a spherical wall goes outwards meanwhile

        Where no cell is above the threshold there is nothing to do.
        """
        coupling = linear.coupling
        assert coupling is not None
        if not coupling.weight.any():
            return
        change, found, mobility = np.zeros(len(rows)), coupling.contacts, _mobility(rows, drag)
        if found is not None:
            deeper = (found.normal * vector[found.cell]).sum(axis=1) - widened
            np.add.at(change, found.cell, coupling.area * deeper)
        _PRODUCTS[shared](
            chunk,
            linear.data,
            linear.normal,
            coupling.slope,
            coupling.weight,
            mobility,
            vector,
            change,
            out,
        )
        if found is not None:
            force = change[found.cell] * coupling.area * mobility[found.cell]
            np.subtract.at(out, found.cell, force[:, None] * found.normal)


def _mobility(rows: FloatArray, drag: float) -> FloatArray:
    """Return 1/(6πη r) of each cell for velocities, or ones for forces, where ``drag`` is zero."""
    return np.asarray(1.0 / (drag * rows[:, RADIUS])) if drag > 0.0 else np.ones(len(rows))


def areas(rows: FloatArray, contacts: Contacts) -> FloatArray:
    """Return 2π r h of contacts with walls, µm²."""
    return np.asarray(2.0 * np.pi * rows[contacts.cell, RADIUS] * contacts.overlap)


def stiffened(linear: Linearisation) -> Linearisation:
    """Return a linearisation whose pairs and walls bound the change of pressures as well.

    With (Σ_j v'_j δh_j)² <= Σ_j v'_j Σ_j v'_j δh_j² they are given so much that their quadratic
    form is nowhere below that of Gᵀ D G.
    """
    coupling = linear.coupling
    if coupling is None or not coupling.weight.any():
        return linear
    along, walls, found = linear.along.copy(), linear.walls.copy(), coupling.contacts
    sums = np.zeros(len(coupling.weight))
    if found is not None:
        np.add.at(sums, found.cell, coupling.area)
    _add_slopes(linear.data, coupling.slope, sums)
    share = coupling.weight * sums
    _stiffen(linear.data, coupling.slope, share, along)
    if found is not None:
        found.add_blocks(share[found.cell] * coupling.area, 0.0, walls)
    return replace(linear, along=along, walls=walls)


@njit(**KERNEL)
def _add_slopes(pairs, slope, sums):
    """Add the slopes of each cell's pairs."""
    for c in range(pairs.start.size):
        for p in range(pairs.start[c], pairs.outer_end[c]):
            sums[pairs.first[p]] += slope[p]
            if p < pairs.inner_end[c]:
                sums[pairs.second[p]] += slope[p]


@njit(**KERNEL)
def _stiffen(pairs, slope, share, along):
    """Add the shares of both cells times the slope to each pair."""
    for c in range(pairs.start.size):
        for p in range(pairs.start[c], pairs.outer_end[c]):
            along[p] += (share[pairs.first[p]] + share[pairs.second[p]]) * slope[p]
