"""Jitted kernels over pairs: forces and stiffness on bare arrays in base units (µm, s, nN).

One file, because numba's disk cache does not notice a change in another module (of the laws it
does, see :mod:`multicell.contact.constants`). No fastmath: with it, freshly compiled and cached
code were seen to differ in the last bits.

Layout. ``rows`` holds for each cell ``x, y, z, radius, compliance`` (the last from
:func:`multicell.contact.law.compliance`), and ``receptor, ligand`` where cells have them, so that
a pair is gathered from two short runs of memory. Pairs come in chunks (see
:mod:`multicell.mechanics.neighbours`); a chunk works through its pairs in blocks of :data:`BLOCK`:
gather into small arrays, evaluate the law there (which the compiler turns into SIMD),
scatter. Gather and scatter take four pairs at a time (:class:`_Quads`). Every chunk writes to its
own cells only, so that the serial and the parallel drivers give the same bits.

``law`` are the constants of a pair law, see :mod:`multicell.contact.constants`. What costs work for
each pair and is absent from a scene is None (receptors, values of each pair's own): compiled code
is specialised on that, and holds nothing of it.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, final

import numpy as np
from llvmlite import ir
from numba import njit, prange, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from multicell.compiling import INLINED, INNER, KERNEL, UNCOUNTED, arithmetic
from multicell.compiling.threads import two_drivers
from multicell.mechanics.pairs import evaluate_pair
from multicell.mechanics.rows import COMPLIANCE, LIGAND, RADIUS, RECEPTOR, SHORTEST

BLOCK = 256  # pairs that are gathered before the law is evaluated on them


_RECEPTOR, _LIGAND, _RECEPTOR_RATE, _LIGAND_RATE = range(4)  # columns of the cells' bonds


class CellData(NamedTuple):
    """Data of the cells over a coupling step; times count from its beginning.

    ``reference`` are the positions that the list was built at, ``margin`` how far each cell may
    drift from there, µm. ``bonds`` is (n, 4) with receptor, ligand and their rates, ``push`` (n, 6)
    with an external force and its rate, nN and nN/s; both without rows where absent, so that
    compiled code is the same with and without.
    """

    chunk: int
    margin: NDArray[np.float64]
    reference: NDArray[np.float64]
    radius: NDArray[np.float64]
    radius_rate: NDArray[np.float64]
    bonds: NDArray[np.float64]
    push: NDArray[np.float64]


class PairData(NamedTuple):
    """The neighbour list, and what a law keeps for each pair (None where all are alike).

    ``adhesion`` is √(6πσ_ij), ``unit`` (2, m) the law's unit of overlap and its rate, µm and
    µm/s, ``onset`` the overlap in that unit from which there is contact (-3 or 0 for exact JKR).
    ``period``, (2, 3), are the lengths in µm after which space repeats along x, y, z, and their
    inverses, both zero where it does not; None where it nowhere does.
    """

    first: NDArray[np.int32]
    second: NDArray[np.int32]
    start: NDArray[np.int64]
    inner_end: NDArray[np.int64]
    outer_end: NDArray[np.int64]
    adhesion: NDArray[np.float64] | None
    unit: NDArray[np.float64] | None
    onset: NDArray[np.float64] | None
    period: NDArray[np.float64] | None = None


_DX, _DY, _DZ, _TOTAL, _PRODUCT, _SOFT, _BONDS, _FORCE, _SLOPE = range(9)
"""Rows of a block of pairs: geometry, rec_i lig_j + lig_i rec_j, F / d, and dF/dh + F / d.

One array and not several: its rows lie at known distances, so that the compiler sees that they do
not overlap, and it compiles in a third of the time.
"""


@njit(**INLINED)
def _at(values, place, otherwise):
    """Return a pair's own value, or what holds for all pairs."""
    if values is None:
        return otherwise
    return values[place]


@njit(**INLINED)
def _unit_at(unit, place, elapsed):
    """Return a pair's unit of overlap at a time, µm."""
    if unit is None:
        return 1.0
    return unit[0, place] + unit[1, place] * elapsed


@njit(**INLINED)
def nearest_image(period, dx, dy, dz):
    """Return the difference of two places to the nearest image of the second one, µm."""
    if period is None:
        return dx, dy, dz
    dx -= period[0, 0] * np.floor(dx * period[1, 0] + 0.5)
    dy -= period[0, 1] * np.floor(dy * period[1, 1] + 0.5)
    dz -= period[0, 2] * np.floor(dz * period[1, 2] + 0.5)
    return dx, dy, dz


@njit(**INLINED)
def _bonded(bond, count, overlap, radius):
    """Return force and stiffness of receptors, -π r_ij h ½ f_ad (rec_i lig_j + ...) (eq. 3.7).

    ``count`` is the sum of products in brackets. In terms of the contact radius √(r_ij h), which
    Hertz and JKR need as well.
    """
    if bond is None:
        return 0.0, 0.0
    q = math.sqrt(radius * max(overlap, 0.0))
    slope = (0.5 * math.pi * bond) * radius * count
    return (0.5 * math.pi * bond) * q * q * count, slope if overlap > 0.0 else 0.0


@njit(**UNCOUNTED)
def _pack_chunk(c, cells, position, elapsed, rows):
    """Fill the rows of one chunk at a time ``elapsed``; return 1 if a cell has drifted.

    Drifted means further than its ``margin`` from ``reference``, or not a number.
    """
    drifted = 0
    begin, end = c * cells.chunk, min((c + 1) * cells.chunk, rows.shape[0])
    for i in range(begin, end):
        x, y, z = position[i, 0], position[i, 1], position[i, 2]
        rows[i, 0] = x
        rows[i, 1] = y
        rows[i, 2] = z
        rows[i, RADIUS] = cells.radius[i] + cells.radius_rate[i] * elapsed
        x -= cells.reference[i, 0]
        y -= cells.reference[i, 1]
        z -= cells.reference[i, 2]
        drifted |= not (x * x + y * y + z * z <= cells.margin[i] * cells.margin[i])
    for i in range(begin, min(end, cells.bonds.shape[0])):
        bonds = cells.bonds[i]
        rows[i, RECEPTOR] = bonds[_RECEPTOR] + bonds[_RECEPTOR_RATE] * elapsed
        rows[i, LIGAND] = bonds[_LIGAND] + bonds[_LIGAND_RATE] * elapsed
    return drifted


@final
class _Quads:
    """Writes code that works on four pairs at a time, whose rows it transposes in registers.

    The compiler does not find that by itself. Without it a force takes half as long again; the
    numbers are the same to the last bit.

    - ``given``: the arguments of the code; of an array, where its numbers are
    """

    KIND = ir.VectorType(ir.DoubleType(), 4)

    def __init__(self, context: Any, builder: Any, signature: Any, values: Any) -> None:
        self.builder = builder
        for kind in signature.args:
            if isinstance(kind, types.Array) and kind.layout != "C":
                raise TypeError(f"{kind} does not hold its numbers row by row")
        self.given = [
            context.make_array(kind)(context, builder, value).data
            if isinstance(kind, types.Array)
            else value
            for kind, value in zip(signature.args, values, strict=True)
        ]

    def place(self, start: Any, further: int) -> Any:
        """Return a place some numbers further."""
        return self.builder.add(start, ir.IntType(64)(further))

    def number(self, array: Any, place: Any) -> Any:
        """Return a single number of an array."""
        return self.builder.load(self.builder.gep(array, [place]))

    def cells(self, array: Any, place: Any) -> list[Any]:
        """Return the cells of the four pairs from a place on."""
        numbers = [self.number(array, self.place(place, k)) for k in range(4)]
        return [self.builder.zext(number, ir.IntType(64)) for number in numbers]

    def _pointer(self, array: Any, place: Any) -> Any:
        return self.builder.bitcast(self.builder.gep(array, [place]), self.KIND.as_pointer())

    def load(self, array: Any, place: Any) -> Any:
        """Return four numbers of an array."""
        return self.builder.load(self._pointer(array, place), align=8)

    def store(self, value: Any, array: Any, place: Any) -> None:
        """Write four numbers to an array."""
        self.builder.store(value, self._pointer(array, place), align=8)

    def triple(self, array: Any, cell: Any) -> Any:
        """Return a row of an array of three columns and, once more, its last number."""
        at = self.builder.mul(cell, ir.IntType(64)(3))
        pair = ir.VectorType(ir.DoubleType(), 2)
        where = self.builder.bitcast(self.builder.gep(array, [at]), pair.as_pointer())
        last = self.number(array, self.place(at, 2))
        last = self.builder.insert_element(pair(ir.Undefined), last, ir.IntType(32)(0))
        return self._chosen(self.builder.load(where, align=8), last, 0, 1, 2, 2)

    def triples(self, array: Any, row: Any) -> list[Any]:
        """Return the columns of four rows of an array of three columns."""
        at = self.builder.mul(row, ir.IntType(64)(3))
        a, b, c = (self.load(array, self.place(at, k)) for k in (0, 4, 8))
        return [
            self._chosen(self._chosen(a, b, *one), c, *other)
            for one, other in (
                ((0, 3, 6, 6), (0, 1, 2, 5)), ((1, 4, 7, 7), (0, 1, 2, 6)),
                ((2, 5, 5, 5), (0, 1, 4, 7)),
            )
        ]  # fmt: skip

    def add(self, parts: list[Any], ends: Any, low: Any, inner: Any, out: Any) -> None:
        """Add the columns of what acts on the second cells, and take it from the first ones.

        Of inner pairs alone the second cells are in ``out``, rows of four from cell ``low`` on.
        """
        builder = self.builder
        rows = self.transposed([*parts, self.KIND([0.0] * 4)])
        for one, other, part in zip(*ends, rows, strict=True):
            at = builder.mul(builder.sub(one, low), ir.IntType(64)(4))
            self.store(builder.fsub(self.load(out, at), part), out, at)
            with builder.if_then(inner):
                at = builder.mul(builder.sub(other, low), ir.IntType(64)(4))
                self.store(builder.fadd(self.load(out, at), part), out, at)

    def _chosen(self, one: Any, other: Any, *places: int) -> Any:
        mask = ir.Constant(ir.VectorType(ir.IntType(32), len(places)), places)
        return self.builder.shuffle_vector(one, other, mask)

    def transposed(self, rows: list[Any]) -> list[Any]:
        """Return the columns of four rows."""
        halves = [
            [self._chosen(*rows[k : k + 2], *of) for k in (0, 2)]
            for of in ((0, 4, 2, 6), (1, 5, 3, 7))
        ]
        return [self._chosen(*half, *of) for of in ((0, 1, 4, 5), (2, 3, 6, 7)) for half in halves]


@intrinsic
def _gather_four(context: Any, rows, width, first, second, begin, block, p):
    """Do what :func:`_gather` does for four pairs; ``width`` is the length of a row."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        code = _Quads(context, builder, signature, values)
        rows, width, first, second, begin, block, p = code.given
        differences, sums, products = [], [], []
        for k, pair in enumerate(
            zip(code.cells(first, begin), code.cells(second, begin), strict=True)
        ):
            one, other = (builder.mul(cell, width) for cell in pair)
            a, b = code.load(rows, one), code.load(rows, other)
            differences.append(builder.fsub(b, a))
            sums.append(builder.fadd(a, b))
            products.append(builder.fmul(a, b))
            soft = [code.number(rows, code.place(at, 4)) for at in (one, other)]
            builder.store(
                builder.fadd(*soft), builder.gep(block, [code.place(p, _SOFT * BLOCK + k)])
            )
        columns = code.transposed(differences)[:3]
        columns += [code.transposed(found)[3] for found in (sums, products)]
        for row, column in enumerate(columns):
            code.store(column, block, code.place(p, row * BLOCK))
        return context.get_dummy_value()

    return types.void(rows, width, first, second, begin, block, p), generate


@intrinsic
def _scatter_four(context: Any, first, second, begin, low, inner, block, p, out):
    """Do what :func:`_scatter` does for four pairs."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        code = _Quads(context, builder, signature, values)
        first, second, begin, low, inner, block, p, out = code.given
        force = code.load(block, code.place(p, _FORCE * BLOCK))
        columns = [
            builder.fmul(force, code.load(block, code.place(p, row * BLOCK)))
            for row in (_DX, _DY, _DZ)
        ]
        code.add(columns, (code.cells(first, begin), code.cells(second, begin)), low, inner, out)
        return context.get_dummy_value()

    return types.void(first, second, begin, low, inner, block, p, out), generate


@njit(**INLINED)
def _gather(rows, pairs, bond, begin, count, block):
    """Collect the geometry of a block of pairs, and rec_i lig_j + lig_i rec_j if there are any."""
    for p in range(0, count - 3, 4):
        _gather_four(rows, rows.shape[1], pairs.first, pairs.second, begin + p, block, p)
    for p in range(count - count % 4, count):
        i, j = np.uint32(pairs.first[begin + p]), np.uint32(pairs.second[begin + p])
        block[_DX, p] = rows[j, 0] - rows[i, 0]
        block[_DY, p] = rows[j, 1] - rows[i, 1]
        block[_DZ, p] = rows[j, 2] - rows[i, 2]
        block[_TOTAL, p] = rows[i, RADIUS] + rows[j, RADIUS]
        block[_PRODUCT, p] = rows[i, RADIUS] * rows[j, RADIUS]
        block[_SOFT, p] = rows[i, COMPLIANCE] + rows[j, COMPLIANCE]
    _take_nearest(pairs.period, count, block)
    _gather_bonds(rows, pairs, bond, begin, count, block)


@njit(**INLINED)
def _take_nearest(period, count, block):
    """Let the differences of a block be those to the nearest images."""
    if period is None:
        return
    for axis in range(3):
        length, inverse = period[0, axis], period[1, axis]
        for p in range(count):
            block[_DX + axis, p] -= length * np.floor(block[_DX + axis, p] * inverse + 0.5)


@njit(**INLINED)
def _gather_bonds(rows, pairs, bond, begin, count, block):
    if bond is None:
        return
    for p in range(count):
        i, j = np.uint32(pairs.first[begin + p]), np.uint32(pairs.second[begin + p])
        block[_BONDS, p] = rows[i, RECEPTOR] * rows[j, LIGAND] + rows[i, LIGAND] * rows[j, RECEPTOR]


@njit(**INLINED)
def _keep(slope, block, p, value):
    """Store the slope of a pair where it is wanted."""
    if slope is not None:
        block[_SLOPE, p] = value


@njit(**INNER, forceinline=True)
def _evaluate(pairs, law, elapsed, begin, count, block, slope):
    """Write F / d and dF/dh + F / d of a block of pairs; what is not read is not computed."""
    for p in range(count):
        d = math.sqrt(block[_DX, p] ** 2 + block[_DY, p] ** 2 + block[_DZ, p] ** 2 + SHORTEST)
        # one division serves r_ij, E_ij and 1 / d
        w = 1.0 / (block[_TOTAL, p] * block[_SOFT, p] * d)
        h = block[_TOTAL, p] - d
        modulus = w * block[_TOTAL, p] * d
        radius = block[_PRODUCT, p] * (w * block[_SOFT, p] * d)
        force, stiffness, _ = evaluate_pair(
            law,
            h,
            modulus,
            radius,
            block[_TOTAL, p],
            _at(pairs.adhesion, begin + p, law.adhesion_constant),
            _unit_at(pairs.unit, begin + p, elapsed),
            _at(pairs.onset, begin + p, 0.0),
            slope,
            None,
        )
        pull, fall = _bonded(law.bond_strength, block[_BONDS, p], h, radius)
        over = (force - pull) * (w * block[_TOTAL, p] * block[_SOFT, p])
        block[_FORCE, p] = over
        _keep(slope, block, p, stiffness - fall + over)


@njit(**INLINED)
def _scatter(pairs, begin, count, low, inner, block, out):
    """Add the forces of a block to the first cell of each pair, of inner pairs to both.

    The chunk, whose cells begin at ``low``, owns the first cells of its pairs, and both cells of
    inner ones.
    """
    for p in range(0, count - 3, 4):
        _scatter_four(pairs.first, pairs.second, begin + p, low, inner, block, p, out)
    for p in range(count - count % 4, count):
        i = pairs.first[begin + p] - low
        fx = block[_FORCE, p] * block[_DX, p]
        fy = block[_FORCE, p] * block[_DY, p]
        fz = block[_FORCE, p] * block[_DZ, p]
        out[i, 0] -= fx
        out[i, 1] -= fy
        out[i, 2] -= fz
        if inner:
            j = pairs.second[begin + p] - low
            out[j, 0] += fx
            out[j, 1] += fy
            out[j, 2] += fz


@njit(**INNER)
def _force_chunk(c, cells, rows, pairs, law, elapsed, stokes, out):
    """Write what :func:`forces` does for the cells of one chunk.

    Law and block stand in one function after inlining: only so does the compiler see that the
    block's arrays do not overlap (5 ns per cell).
    """
    low, high = c * cells.chunk, min((c + 1) * cells.chunk, rows.shape[0])
    sums = np.empty((high - low, 4))  # of four numbers each, of which three count
    for i in range(low, high):
        # reading the rows in their order brings them near for the gather, which has none
        sums[i - low, 0] = 0.0 * abs(rows[i, 0])
        sums[i - low, 1] = 0.0
        sums[i - low, 2] = 0.0 * rows[i, COMPLIANCE]
        sums[i - low, 3] = 0.0
    block = np.empty((9, BLOCK))
    for side in range(2):
        first = pairs.start[c] if side == 0 else pairs.inner_end[c]
        end = pairs.inner_end[c] if side == 0 else pairs.outer_end[c]
        for begin in range(first, end, BLOCK):
            count = min(BLOCK, end - begin)
            _gather(rows, pairs, law.bond_strength, begin, count, block)
            _evaluate(pairs, law, elapsed, begin, count, block, None)
            _scatter(pairs, begin, count, low, side == 0, block, sums)
    for i in range(low, min(high, cells.push.shape[0])):
        for axis in range(3):
            sums[i - low, axis] += cells.push[i, axis] + cells.push[i, 3 + axis] * elapsed
    for i in range(low, high):
        # Stokes
        mobility = 1.0 / (law.medium_drag * rows[i, RADIUS]) if stokes else 1.0
        for axis in range(3):
            out[i, axis] = sums[i - low, axis] * mobility


def _pack(cells, position, elapsed, rows):
    """Fill ``rows`` for all cells; return whether any has drifted (see the chunk's)."""
    drifted = 0
    for c in prange(-(-rows.shape[0] // cells.chunk)):
        drifted += _pack_chunk(c, cells, position, elapsed, rows)
    return drifted > 0


pack, pack_parallel = two_drivers(_pack)


def _forces(cells, pairs, law, position, elapsed, stokes, rows, out):
    """Write the forces on all cells, nN, or with ``stokes`` their velocities, µm/s.

    Stop and return True if a cell has drifted: the list is not valid there.
    """
    drifted = 0
    for c in prange(-(-rows.shape[0] // cells.chunk)):
        drifted += _pack_chunk(c, cells, position, elapsed, rows)
    if drifted > 0:
        return True
    for c in prange(pairs.start.size):
        _force_chunk(c, cells, rows, pairs, law, elapsed, stokes, out)
    return False


forces, forces_parallel = two_drivers(_forces)


@njit(**INLINED)
def _vector(rows, i, j, period):
    """Return the vector from cell i to the nearest image of cell j and its length, µm."""
    dx, dy, dz = rows[j, 0] - rows[i, 0], rows[j, 1] - rows[i, 1], rows[j, 2] - rows[i, 2]
    dx, dy, dz = nearest_image(period, dx, dy, dz)
    return dx, dy, dz, math.sqrt(dx * dx + dy * dy + dz * dz + SHORTEST)


@njit(**INNER, forceinline=True)
def _energy_between(rows, i, j, pairs, p, law, elapsed):
    """Return the energy of two cells, whose pair stands at place ``p``."""
    d = _vector(rows, i, j, pairs.period)[3]
    total = rows[i, RADIUS] + rows[j, RADIUS]
    h, radius = total - d, rows[i, RADIUS] * rows[j, RADIUS] / total
    _, _, energy = evaluate_pair(
        law,
        h,
        1.0 / (rows[i, COMPLIANCE] + rows[j, COMPLIANCE]),
        radius,
        total,
        _at(pairs.adhesion, p, law.adhesion_constant),
        _unit_at(pairs.unit, p, elapsed),
        _at(pairs.onset, p, 0.0),
        True,
        True,
    )
    _, fall = _bonded(law.bond_strength, _bonds_of(law.bond_strength, rows, i, j), h, radius)
    return energy - 0.5 * fall * h * h


@njit(**INLINED)
def _bonds_of(bond, rows, i, j):
    if bond is None:
        return 0.0
    return rows[i, RECEPTOR] * rows[j, LIGAND] + rows[i, LIGAND] * rows[j, RECEPTOR]


@njit(**KERNEL)
def energy(rows, pairs, law, elapsed):
    """Return the contact energy, fJ; an outer pair stands in two chunks, half in each."""
    total = 0.0
    for c in range(pairs.start.size):
        for p in range(pairs.start[c], pairs.outer_end[c]):
            i, j = pairs.first[p], pairs.second[p]
            part = _energy_between(rows, i, j, pairs, p, law, elapsed)
            total += part if p < pairs.inner_end[c] else 0.5 * part
    return total


@njit(**INNER)
def _virial_chunk(c, rows, pairs, law, elapsed, out):
    """Add the virials of the pairs of one chunk to its cells."""
    block = np.empty((9, BLOCK))
    for begin in range(pairs.start[c], pairs.outer_end[c], BLOCK):
        count = min(BLOCK, pairs.outer_end[c] - begin)
        _gather(rows, pairs, law.bond_strength, begin, count, block)
        _evaluate(pairs, law, elapsed, begin, count, block, None)
        for p in range(count):
            square = block[_DX, p] ** 2 + block[_DY, p] ** 2 + block[_DZ, p] ** 2
            block[_FORCE, p] *= 0.5 * square
        for p in range(np.uint64(count)):
            i, j = np.uint32(pairs.first[begin + p]), np.uint32(pairs.second[begin + p])
            out[i] += block[_FORCE, p]
            if begin + p < pairs.inner_end[c]:
                out[j] += block[_FORCE, p]


def _half_virials(rows, pairs, law, elapsed, out):
    """Add ½ Σ_j F_ij d_ij to each cell, nN µm."""
    for c in prange(pairs.start.size):
        _virial_chunk(c, rows, pairs, law, elapsed, out)


half_virials, half_virials_parallel = two_drivers(_half_virials)


@njit(**KERNEL)
def mark_contacts(rows, pairs, elapsed, out):
    """Mark the pairs in contact: an overlap above zero, or above the onset.

    Of an outer pair, which stands in two chunks, only the one with the smaller first cell. A law
    with an onset (exact JKR) holds contacts from there on, the onset included.
    """
    out[:] = False
    for c in range(pairs.start.size):
        for p in range(pairs.start[c], pairs.outer_end[c]):
            i, j = pairs.first[p], pairs.second[p]
            if p >= pairs.inner_end[c] and j < i:
                continue
            h = rows[i, RADIUS] + rows[j, RADIUS] - _vector(rows, i, j, pairs.period)[3]
            out[p] = _touches(h, pairs.unit, pairs.onset, p, elapsed)


@njit(**INLINED)
def _touches(h, unit, onset, p, elapsed):
    if onset is None:
        return h > 0.0
    return h >= onset[p] * _unit_at(unit, p, elapsed)


_PARTS = 16  # of a step, in which the attraction of a contact that forms is added up


@njit(**INNER, forceinline=True)
def _attraction(rows, i, j, pairs, p, law, elapsed, overlap):
    """Return with how much force two cells attract each other at an overlap, nN, or zero."""
    total = rows[i, RADIUS] + rows[j, RADIUS]
    radius = rows[i, RADIUS] * rows[j, RADIUS] / total
    force, _, _ = evaluate_pair(
        law,
        overlap,
        1.0 / (rows[i, COMPLIANCE] + rows[j, COMPLIANCE]),
        radius,
        total,
        _at(pairs.adhesion, p, law.adhesion_constant),
        _unit_at(pairs.unit, p, elapsed),
        _at(pairs.onset, p, 0.0),
        None,
        None,
    )
    bonds = _bonds_of(law.bond_strength, rows, i, j)
    return max(_bonded(law.bond_strength, bonds, overlap, radius)[0] - force, 0.0)


@njit(**INLINED)
def _approach(place, speed, i, j, growth, period):
    """Return the distance of two centres, and at what speed the gap of their spheres narrows."""
    dx, dy, dz, d = _vector(place, i, j, period)
    along = dx * (speed[j, 0] - speed[i, 0]) + dy * (speed[j, 1] - speed[i, 1])
    along += dz * (speed[j, 2] - speed[i, 2])
    return d, growth - along / d


@njit(**UNCOUNTED)
def pairs_about_to_touch(pairs, rows, elapsed, room, places):
    """Note the places of pairs whose gap or overlap is below the sum of the two ``room``, µm.

    Returns how many there are. The write is unconditional and only the count depends on the test:
    no branch to mispredict.
    """
    count = 0
    for c in range(pairs.start.size):
        for p in range(pairs.start[c], pairs.outer_end[c]):
            square, reach = apart(rows, pairs, p, elapsed)
            horizon = room[np.uint32(pairs.first[p])] + room[np.uint32(pairs.second[p])]
            low = max(reach - horizon, 0.0)
            places[count] = p
            count += np.int64((square > low * low) & (square < (reach + horizon) ** 2))
    return count


@njit(**INLINED)
def apart(rows, pairs, p, elapsed):
    """Return the square of the distance of a pair, µm², and the distance at which it touches."""
    i, j = np.uint32(pairs.first[p]), np.uint32(pairs.second[p])
    dx, dy, dz = rows[j, 0] - rows[i, 0], rows[j, 1] - rows[i, 1], rows[j, 2] - rows[i, 2]
    dx, dy, dz = nearest_image(pairs.period, dx, dy, dz)
    reach = rows[i, RADIUS] + rows[j, RADIUS]
    reach -= _begin_of_contact(pairs.unit, pairs.onset, p, elapsed)
    return dx * dx + dy * dy + dz * dz, reach


@arithmetic
def forming_pairs(
    places, pairs, radius, rate, before, after, speed, end_speed, elapsed, dt, way, tolerance, found
):
    """Note those of ``places`` whose pairs come into contact within a step; return how many.

    Cells go from ``before`` to ``after`` in ``dt``, with the velocities ``speed`` and
    ``end_speed``; two of them come closer by at most ``way``. ``radius`` and ``rate`` are those of
    :class:`CellData`.
    """
    count = 0
    for p in places:
        i, j = np.uint32(pairs.first[p]), np.uint32(pairs.second[p])
        dx, dy = before[j, 0] - before[i, 0], before[j, 1] - before[i, 1]
        dz = before[j, 2] - before[i, 2]
        dx, dy, dz = nearest_image(pairs.period, dx, dy, dz)
        reach = radius[i] + radius[j]
        reach += (rate[i] + rate[j]) * elapsed
        reach -= _begin_of_contact(pairs.unit, pairs.onset, p, elapsed)
        square = dx * dx + dy * dy + dz * dz
        if square <= reach * reach or square >= (reach + way) * (reach + way):
            continue
        # most of them hardly move relative to each other
        dx -= after[j, 0] - after[i, 0]
        dy -= after[j, 1] - after[i, 1]
        dz -= after[j, 2] - after[i, 2]
        dx, dy, dz = nearest_image(pairs.period, dx, dy, dz)
        closer = 2.0 * math.sqrt(dx * dx + dy * dy + dz * dz) + tolerance
        closer += (rate[i] + rate[j]) * dt
        if math.sqrt(square) - reach > closer:
            continue
        _, _, _, _, nearest = _passage(
            pairs, p, radius, rate, before, after, speed, end_speed, elapsed, dt
        )
        found[count] = p
        count += np.int64(nearest < 0.0)
    return count


@arithmetic
def missed_contact(
    cells, pairs, law, rows, places, before, after, speed, end_speed, elapsed, dt, tolerance
):
    """Return the part of a step to be taken where it misses a contact that forms in it, else 1.

    ``places`` are those of :func:`forming_pairs`, as are the other arguments. Of a pair out of
    contact the overlap without its own force follows from them, and the force that sets in at
    contact draws the pair further. It is missed if it would do so by more than ``tolerance``, µm,
    beyond what the step shows. What is slow at first grows fast: the force of JKR rises like
    h^{3/4}, so that an error estimate sees nothing of a late or passing contact.
    """
    part = 1.0
    for p in places:
        taken = _part_taken(
            cells, pairs, p, law, rows, before, after, speed, end_speed, elapsed, dt, tolerance
        )
        part = min(part, taken)
    return part


@njit(**INLINED)
def _passage(pairs, p, radius, rate, before, after, speed, end_speed, elapsed, dt):
    """Return how two cells pass each other in a step.

    The gap before and the speed at which it narrows, both at the end, and the least gap on the way,
    µm and µm/s.
    """
    i, j = np.uint32(pairs.first[p]), np.uint32(pairs.second[p])
    growth = rate[i] + rate[j]
    begin = _begin_of_contact(pairs.unit, pairs.onset, p, elapsed)
    reach = radius[i] + radius[j] + growth * elapsed
    gap, narrowing = _approach(before, speed, i, j, growth, pairs.period)
    gap -= reach - begin
    end, end_narrowing = _approach(after, end_speed, i, j, growth, pairs.period)
    end -= reach + growth * dt - begin
    dip = 0.15 * dt * (max(narrowing, 0.0) + max(-end_narrowing, 0.0))
    nearest = min(min(gap, end) - dip, gap - dt * max(narrowing, end_narrowing))
    return gap, narrowing, end, end_narrowing, nearest


@njit(**INNER, forceinline=True)
def _part_taken(
    cells, pairs, p, law, rows, before, after, speed, end_speed, elapsed, dt, tolerance
):
    """Return the part of a step until the contact of one pair is missed, else 1."""
    i, j = np.uint32(pairs.first[p]), np.uint32(pairs.second[p])
    begin = _begin_of_contact(pairs.unit, pairs.onset, p, elapsed)
    gap, narrowing, end, end_narrowing, _ = _passage(
        pairs, p, cells.radius, cells.radius_rate, before, after, speed, end_speed, elapsed, dt
    )
    mobility = (1.0 / rows[i, RADIUS] + 1.0 / rows[j, RADIUS]) / law.medium_drag
    least = tolerance / _PARTS
    # a law that acts from afar has some of it before
    afar = _attraction(rows, i, j, pairs, p, law, elapsed, begin - least)
    drawn, free, enough = 0.0, 0.0, 1.0
    for k in range(_PARTS):
        s = (k + 0.5) / _PARTS
        a, b = 1.0 - s, s * (1.0 - s)
        free = dt * b * (a * narrowing - s * end_narrowing)
        free -= a * a * (1.0 + 2.0 * s) * gap + s * s * (3.0 - 2.0 * s) * end
        # the speed at the end of a contact is also that of its own force
        change = 0.0 if end < 0.0 else end_narrowing - narrowing
        free = max(free, dt * s * (narrowing + 0.5 * s * change) - gap)
        if free + drawn <= 0.0:
            continue
        overlap = begin + max(free + drawn, least)
        pull = _attraction(rows, i, j, pairs, p, law, elapsed, overlap) - afar
        drawn += dt / _PARTS * mobility * max(pull, 0.0)
        if drawn > 0.5 * tolerance and enough == 1.0:
            enough = s
    shown = 0.0 if end >= 0.0 else max(-end - max(dt * narrowing - gap, 0.0), 0.0)
    return enough if drawn - shown > tolerance else 1.0


@njit(**INLINED)
def _begin_of_contact(unit, onset, p, elapsed):
    """Return the overlap from which on a pair is in contact, µm."""
    if onset is None:
        return 0.0
    return onset[p] * _unit_at(unit, p, elapsed)


@njit(**INNER)
def _linearise_chunk(c, rows, pairs, law, elapsed, normal, along, across):
    """Store direction, dF/dh + F/d and F/d of the pairs of one chunk."""
    block = np.empty((9, BLOCK))
    for begin in range(pairs.start[c], pairs.outer_end[c], BLOCK):
        count = min(BLOCK, pairs.outer_end[c] - begin)
        _gather(rows, pairs, law.bond_strength, begin, count, block)
        _evaluate(pairs, law, elapsed, begin, count, block, True)
        for p in range(count):
            square = block[_DX, p] ** 2 + block[_DY, p] ** 2 + block[_DZ, p] ** 2
            inverse = 1.0 / math.sqrt(square + SHORTEST)
            normal[begin + p, 0] = block[_DX, p] * inverse
            normal[begin + p, 1] = block[_DY, p] * inverse
            normal[begin + p, 2] = block[_DZ, p] * inverse
            along[begin + p] = block[_SLOPE, p]
            across[begin + p] = block[_FORCE, p]


def _linearise(rows, pairs, law, elapsed, normal, along, across):
    """Store what :func:`products` needs for all pairs, from the state in ``rows``.

    The stiffness of a pair is K = k n nᵀ - (F/d)(I - n nᵀ) with k = dF/dh. For a pair out
    of contact everything stored but the direction is zero.
    """
    for c in prange(pairs.start.size):
        _linearise_chunk(c, rows, pairs, law, elapsed, normal, along, across)


linearise, linearise_parallel = two_drivers(_linearise)


@intrinsic
def _pull_four(context: Any, first, second, p, low, inner, normal, along, across, v, out):
    """Do what :func:`_product_chunk` does for four pairs."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        code = _Quads(context, builder, signature, values)
        first, second, p, low, inner, normal, along, across, v, out = code.given
        ends = code.cells(first, p), code.cells(second, p)
        apart = [
            builder.fsub(code.triple(v, one), code.triple(v, other))
            for one, other in zip(*ends, strict=True)
        ]
        apart, ways = code.transposed(apart)[:3], code.triples(normal, p)
        x, y, z = (builder.fmul(*pair) for pair in zip(ways, apart, strict=True))
        stretch = builder.fmul(code.load(along, p), builder.fadd(builder.fadd(x, y), z))
        turn = code.load(across, p)
        pulls = [
            builder.fsub(builder.fmul(stretch, way), builder.fmul(turn, part))
            for way, part in zip(ways, apart, strict=True)
        ]
        code.add(pulls, ends, low, inner, out)
        return context.get_dummy_value()

    arguments = (first, second, p, low, inner, normal, along, across, v, out)
    return types.void(*arguments), generate


@njit(**INNER)
def _product_chunk(c, chunk, rows, pairs, normal, along, across, drag, v, out):
    """Write (J v) for the cells of one chunk; forces instead of velocities if drag is zero."""
    low, high = c * chunk, min((c + 1) * chunk, rows.shape[0])
    sums = np.zeros((high - low, 4))  # of four numbers each, of which three count
    for side in range(2):
        begin = pairs.start[c] if side == 0 else pairs.inner_end[c]
        end = pairs.inner_end[c] if side == 0 else pairs.outer_end[c]
        for p in range(begin, end - 3, 4):
            _pull_four(pairs.first, pairs.second, p, low, side == 0, normal, along, across, v, sums)
        for p in range(end - (end - begin) % 4, end):
            i, j = np.uint32(pairs.first[p]), np.uint32(pairs.second[p])
            stretch = 0.0
            for axis in range(3):
                stretch += normal[p, axis] * (v[i, axis] - v[j, axis])
            for axis in range(3):
                pull = along[p] * stretch * normal[p, axis]
                pull -= across[p] * (v[i, axis] - v[j, axis])
                sums[i - low, axis] -= pull
                if side == 0:
                    sums[j - low, axis] += pull
    for i in range(low, high):
        mobility = 1.0 / (drag * rows[i, RADIUS]) if drag > 0.0 else 1.0
        for axis in range(3):
            out[i, axis] = sums[i - low, axis] * mobility


def _products(chunk, rows, pairs, normal, along, across, drag, v, out):
    """Write J v, the directional derivative of the velocities along ``v``, 1/s times ``v``."""
    for c in prange(pairs.start.size):
        _product_chunk(c, chunk, rows, pairs, normal, along, across, drag, v, out)


products, products_parallel = two_drivers(_products)
