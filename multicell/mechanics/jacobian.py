"""The Jacobian as a sparse matrix, and preconditioners made from the pairs.

Written with Γ_i = 6πη r_i and, for each pair, P = K = k n nᵀ - (F/d)(I - n nᵀ), the Jacobian of
the velocities has blocks J_ij = P_ij / Γ_i and J_ii = -Σ_j P_ij / Γ_i; walls add their
stiffness, one number for each axis, to the sum over j. An implicit method
solves (I - γJ) x = b, which is M x = Γ b with the symmetric

    M = Γ - γK:   M_ii = Γ_i + γ Σ_j P_ij,   M_ij = -γ P_ij.

Preconditioners take the stable part of each pair alone (max(k, 0) along n and max(-F/d, 0)
across), so that they are symmetric positive definite for every γ > 0, where M itself need not
be: pairs that are pressed together push each other sideways.

The chunks of :mod:`multicell.mechanics.neighbours` list inner pairs by growing first cell, smaller
cell first: that is the upper triangle of M row by row, and sweeps along it and back are a
symmetric Gauss-Seidel step without any assembly. Pairs between chunks enter the diagonal
blocks only, so that chunks are independent, and any number of threads gives the same bits.

The kernels are a family of their own: numba's disk cache does not notice changes in other
modules. No fastmath, see :mod:`multicell.mechanics.forces`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from multicell.mechanics import neighbours
from multicell.mechanics.forces import NEARLY_SINGULAR, invert_by_pivots

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.mechanics.neighbours import PairList
    from multicell.mechanics.system import Mechanics, Motion

OffsetArray = NDArray[np.int64]
_EPS = float(np.finfo(float).eps)
_FLAT = 1.0 / NEARLY_SINGULAR**2
"""Determinant over the product of the diagonal below which cofactors are rounding."""


@njit(cache=True)
def _collect_chunk(
    c, chunk, rows, first, second, start, inner_end, outer_end, normal, along, across,
    gamma, drag, walls, begin, near, link, blocks,
):  # fmt: skip
    """Write the diagonal blocks of one chunk of M, and its inner pairs that touch.

    ``walls`` is the stiffness of each cell's walls along the axes, or has no rows. ``near`` and
    ``link`` (n, w, s with P = w n nᵀ + s I, times γ) hold the pairs of cell i at
    ``begin[i, 0]:begin[i, 1]``.
    """
    low, high = c * chunk, min((c + 1) * chunk, rows.shape[0])
    for i in range(low, high):
        begin[i, 0] = begin[i, 1] = 0
        blocks[i, 0] = blocks[i, 1] = blocks[i, 2] = drag * rows[i, 3]
        blocks[i, 3] = blocks[i, 4] = blocks[i, 5] = 0.0
    if walls.shape[0] > 0:
        for i in range(low, high):
            for k in range(3):
                blocks[i, k] += gamma * walls[i, k]
    at = start[c]
    for p in range(start[c], outer_end[c]):
        s = gamma * max(-across[p], 0.0)
        w = gamma * max(along[p] - across[p], 0.0) - s
        if s == 0.0 and w == 0.0:
            continue
        nx, ny, nz = normal[p, 0], normal[p, 1], normal[p, 2]
        i, j = first[p], second[p]
        for side in range(2 if p < inner_end[c] else 1):
            k = i if side == 0 else j
            blocks[k, 0] += w * nx * nx + s
            blocks[k, 1] += w * ny * ny + s
            blocks[k, 2] += w * nz * nz + s
            blocks[k, 3] += w * nx * ny
            blocks[k, 4] += w * nx * nz
            blocks[k, 5] += w * ny * nz
        if p < inner_end[c]:
            if begin[i, 1] == 0:
                begin[i, 0] = at
            near[at] = j
            link[at, 0], link[at, 1], link[at, 2] = nx, ny, nz
            link[at, 3], link[at, 4] = w, s
            at += 1
            begin[i, 1] = at


@njit(cache=True)
def limit_softening(rows, first, second, start, outer_end, fraction, along, across):
    """Raise dF/dh of every pair to at least -``fraction`` E_ij r_ij; return the largest, nN/µm.

    The slope of JKR tends to -∞ at first contact. It is the slope of a corner that Newton's
    step leaves at once, and taken at its word it sends the iteration astray.
    """
    stiffest = 0.0
    for c in range(start.size):
        for p in range(start[c], outer_end[c]):
            stiffest = max(stiffest, along[p] - across[p])
            if along[p] < across[p]:
                i, j = first[p], second[p]
                radius = rows[i, 3] * rows[j, 3] / (rows[i, 3] + rows[j, 3])
                least = -fraction * radius / (rows[i, 4] + rows[j, 4])
                along[p] = max(along[p], across[p] + least)
    return stiffest


@njit(cache=True)
def _invert(blocks, i):
    """Replace a symmetric 3 x 3 block by its inverse; return its determinant."""
    a, b, c = blocks[i, 0], blocks[i, 1], blocks[i, 2]
    f, g, h = blocks[i, 3], blocks[i, 4], blocks[i, 5]
    xx, xy, xz = b * c - h * h, g * h - f * c, f * h - b * g
    determinant = a * xx + f * xy + g * xz
    if not determinant > _FLAT * a * b * c:
        invert_by_pivots(a, b, c, f, g, h, _EPS * max(a, b, c), blocks[i])
        return determinant
    scale = 1.0 / determinant
    blocks[i, 0] = xx * scale
    blocks[i, 1] = (a * c - g * g) * scale
    blocks[i, 2] = (a * b - f * f) * scale
    blocks[i, 3] = xy * scale
    blocks[i, 4] = xz * scale
    blocks[i, 5] = (f * g - a * h) * scale
    return determinant


@njit(cache=True)
def _subtract(blocks, i, j, link, e):
    """Subtract P B⁻¹ P from block j, with the inverted block i and P of the pair ``e``."""
    nx, ny, nz, w, s = link[e, 0], link[e, 1], link[e, 2], link[e, 3], link[e, 4]
    xx, yy, zz = blocks[i, 0], blocks[i, 1], blocks[i, 2]
    xy, xz, yz = blocks[i, 3], blocks[i, 4], blocks[i, 5]
    # with q = B⁻¹ n:  P B⁻¹ P = w² (n·q) n nᵀ + w s (n qᵀ + q nᵀ) + s² B⁻¹
    qx, qy, qz = (
        xx * nx + xy * ny + xz * nz,
        xy * nx + yy * ny + yz * nz,
        xz * nx + yz * ny + zz * nz,
    )
    a, b, c = w * w * (nx * qx + ny * qy + nz * qz), w * s, s * s
    blocks[j, 0] -= a * nx * nx + 2.0 * b * nx * qx + c * xx
    blocks[j, 1] -= a * ny * ny + 2.0 * b * ny * qy + c * yy
    blocks[j, 2] -= a * nz * nz + 2.0 * b * nz * qz + c * zz
    blocks[j, 3] -= a * nx * ny + b * (nx * qy + qx * ny) + c * xy
    blocks[j, 4] -= a * nx * nz + b * (nx * qz + qx * nz) + c * xz
    blocks[j, 5] -= a * ny * nz + b * (ny * qz + qy * nz) + c * yz


@njit(cache=True)
def _factor_chunk(c, chunk, incomplete, begin, near, link, blocks):
    """Invert the diagonal blocks; ``incomplete`` corrects them as a factorisation does."""
    low, high = c * chunk, min((c + 1) * chunk, blocks.shape[0])
    for i in range(low, high):
        _invert(blocks, i)
        if incomplete:
            for e in range(begin[i, 0], begin[i, 1]):
                _subtract(blocks, i, near[e], link, e)


@njit(cache=True)
def factor(
    chunk, rows, first, second, start, inner_end, outer_end, normal, along, across,
    gamma, drag, walls, incomplete, begin, near, link, blocks,
):  # fmt: skip
    """Prepare :func:`sweep` for a γ at the linearisation given by its pairs."""
    for c in range(start.size):
        _collect_chunk(
            c, chunk, rows, first, second, start, inner_end, outer_end, normal, along, across,
            gamma, drag, walls, begin, near, link, blocks,
        )  # fmt: skip
        _factor_chunk(c, chunk, incomplete, begin, near, link, blocks)


@njit(cache=True, parallel=True)
def factor_parallel(
    chunk, rows, first, second, start, inner_end, outer_end, normal, along, across,
    gamma, drag, walls, incomplete, begin, near, link, blocks,
):  # fmt: skip
    """Do the same as :func:`factor`, with the chunks shared among threads."""
    for c in prange(start.size):
        _collect_chunk(
            c, chunk, rows, first, second, start, inner_end, outer_end, normal, along, across,
            gamma, drag, walls, begin, near, link, blocks,
        )  # fmt: skip
        _factor_chunk(c, chunk, incomplete, begin, near, link, blocks)


@njit(cache=True)
def _sweep_chunk(c, chunk, rows, drag, begin, near, link, blocks, vector, out):
    """Solve (D + L) D⁻¹ (D + U) x = Γ b for the cells of one chunk."""
    low, high = c * chunk, min((c + 1) * chunk, rows.shape[0])
    for i in range(low, high):
        weight = drag * rows[i, 3]
        for k in range(3):
            out[i, k] = weight * vector[i, k]
    for i in range(low, high):
        x, y, z = out[i, 0], out[i, 1], out[i, 2]
        u = blocks[i, 0] * x + blocks[i, 3] * y + blocks[i, 4] * z
        v = blocks[i, 3] * x + blocks[i, 1] * y + blocks[i, 5] * z
        t = blocks[i, 4] * x + blocks[i, 5] * y + blocks[i, 2] * z
        out[i, 0], out[i, 1], out[i, 2] = u, v, t
        for e in range(begin[i, 0], begin[i, 1]):
            nx, ny, nz, s = link[e, 0], link[e, 1], link[e, 2], link[e, 4]
            a = link[e, 3] * (nx * u + ny * v + nz * t)
            j = np.uint32(near[e])
            out[j, 0] += a * nx + s * u
            out[j, 1] += a * ny + s * v
            out[j, 2] += a * nz + s * t
    for i in range(high - 1, low - 1, -1):
        x, y, z = 0.0, 0.0, 0.0
        for e in range(begin[i, 0], begin[i, 1]):
            nx, ny, nz, s = link[e, 0], link[e, 1], link[e, 2], link[e, 4]
            j = np.uint32(near[e])
            u, v, t = out[j, 0], out[j, 1], out[j, 2]
            a = link[e, 3] * (nx * u + ny * v + nz * t)
            x += a * nx + s * u
            y += a * ny + s * v
            z += a * nz + s * t
        out[i, 0] += blocks[i, 0] * x + blocks[i, 3] * y + blocks[i, 4] * z
        out[i, 1] += blocks[i, 3] * x + blocks[i, 1] * y + blocks[i, 5] * z
        out[i, 2] += blocks[i, 4] * x + blocks[i, 5] * y + blocks[i, 2] * z


@njit(cache=True)
def sweep(chunks, chunk, rows, drag, begin, near, link, blocks, vector, out):
    """Write an approximate solution of (I - γJ) x = ``vector``, both (n, 3)."""
    for c in range(chunks):
        _sweep_chunk(c, chunk, rows, drag, begin, near, link, blocks, vector, out)


@njit(cache=True, parallel=True)
def sweep_parallel(chunks, chunk, rows, drag, begin, near, link, blocks, vector, out):
    """Do the same as :func:`sweep`, with the chunks shared among threads."""
    for c in prange(chunks):
        _sweep_chunk(c, chunk, rows, drag, begin, near, link, blocks, vector, out)


@njit(cache=True)
def _count_blocks(first, second, start, inner_end, outer_end, column):
    """Write where the blocks of each column begin; the diagonal block is there for all."""
    column[:] = 1
    column[0] = 0
    for c in range(start.size):
        for p in range(start[c], outer_end[c]):
            column[second[p] + 1] += 1
            if p < inner_end[c]:
                column[first[p] + 1] += 1
    for j in range(column.size - 1):
        column[j + 1] += column[j]


@njit(cache=True)
def _list_blocks(first, second, start, inner_end, outer_end, column, row):
    """Write the sorted rows of the blocks of each column."""
    n = column.size - 1
    cursor = column[:-1].copy()
    for j in range(n):
        row[cursor[j]] = j
        cursor[j] += 1
    for c in range(start.size):
        for p in range(start[c], outer_end[c]):
            i, j = first[p], second[p]
            row[cursor[j]] = i
            cursor[j] += 1
            if p < inner_end[c]:
                row[cursor[i]] = j
                cursor[i] += 1
    for j in range(n):
        row[column[j] : column[j + 1]] = np.sort(row[column[j] : column[j + 1]])


@njit(cache=True)
def _expand(column, row, pointer, index):
    """Write the pattern of 3 x 3 blocks as that of single entries."""
    at = 0
    for j in range(column.size - 1):
        for b in range(3):
            pointer[3 * j + b] = at
            for e in range(column[j], column[j + 1]):
                for a in range(3):
                    index[at] = 3 * row[e] + a
                    at += 1
    pointer[3 * (column.size - 1)] = at


@njit(cache=True)
def _place(column, row, i, j):
    """Return where block (i, j) stands, or -1."""
    begin, end = column[j], column[j + 1]
    while begin < end:
        middle = (begin + end) // 2
        if row[middle] < i:
            begin = middle + 1
        else:
            end = middle
    if begin < column[j + 1] and row[begin] == i:
        return begin
    return -1


@njit(cache=True)
def _add_block(column, row, i, j, entries, scale, values):
    """Add ``scale`` times a symmetric block (xx, yy, zz, xy, xz, yz); return 1 if it is lost."""
    e = _place(column, row, i, j)
    if e < 0:
        return 1
    height = 3 * (column[j + 1] - column[j])
    at = 9 * column[j] + 3 * (e - column[j])
    values[at] += scale * entries[0]
    values[at + 1] += scale * entries[3]
    values[at + 2] += scale * entries[4]
    values[at + height] += scale * entries[3]
    values[at + height + 1] += scale * entries[1]
    values[at + height + 2] += scale * entries[5]
    values[at + 2 * height] += scale * entries[4]
    values[at + 2 * height + 1] += scale * entries[5]
    values[at + 2 * height + 2] += scale * entries[2]
    return 0


@njit(cache=True)
def assemble(
    rows, first, second, start, inner_end, outer_end, normal, along, across, drag,
    column, row, values,
):  # fmt: skip
    """Write the values of J in CSC order; return how many blocks have no place there."""
    values[:] = 0.0
    lost = 0
    entries = np.empty(6)
    for c in range(start.size):
        for p in range(start[c], outer_end[c]):
            k, t = along[p], -across[p]
            if k == 0.0 and t == 0.0:
                continue
            nx, ny, nz = normal[p, 0], normal[p, 1], normal[p, 2]
            entries[0], entries[1], entries[2] = k * nx * nx + t, k * ny * ny + t, k * nz * nz + t
            entries[3], entries[4], entries[5] = k * nx * ny, k * nx * nz, k * ny * nz
            i, j = first[p], second[p]
            for _ in range(2 if p < inner_end[c] else 1):
                scale = 1.0 / (drag * rows[i, 3])
                lost += _add_block(column, row, i, j, entries, scale, values)
                lost += _add_block(column, row, i, i, entries, -scale, values)
                i, j = j, i
    return lost


@final
@dataclass(frozen=True)
class Pattern:
    """Which entries of the Jacobian may differ from zero, for one neighbour list.

    Attributes
    ----------
    column : (n + 1,) int64
        Where the 3 x 3 blocks of each column of blocks begin in ``row``.
    row : (b,) int64
        Row of each block, growing within a column.
    pointer, index : (3 n + 1,), (9 b,) int32
        The same for single entries, as SciPy's CSC format has them.
    """

    column: OffsetArray
    row: OffsetArray
    pointer: NDArray[np.int32]
    index: NDArray[np.int32]

    @classmethod
    def of(cls, pairs: PairList) -> Pattern:
        """Return the pattern of a neighbour list."""
        lists = (pairs.first, pairs.second, pairs.start, pairs.inner_end, pairs.outer_end)
        column = np.empty(pairs.n + 1, dtype=np.int64)
        _count_blocks(*lists, column)
        row = np.empty(column[-1], dtype=np.int64)
        _list_blocks(*lists, column, row)
        pointer = np.empty(3 * pairs.n + 1, dtype=np.int32)
        index = np.empty(9 * len(row), dtype=np.int32)
        _expand(column, row, pointer, index)
        return cls(column, row, pointer, index)

    @classmethod
    def near(cls, position: FloatArray, motion: Motion, margin: float) -> Pattern:
        """Return the pattern with room for pairs whose surfaces are closer than a margin.

        Parameters
        ----------
        position
            (n, 3) µm.
        motion
            The largest radii of the coupling step count.
        margin
            In mean radii.
        """
        length = motion.end - motion.begin
        largest = np.maximum(motion.radius, motion.radius + motion.radius_rate * length)
        return cls.of(neighbours.build(position, largest, margin * float(largest.mean())))

    def fill(self, system: Mechanics, values: FloatArray) -> int:
        """Write J of the last linearisation, 1/s; return how many blocks have no place."""
        linear = system.linearisation
        pairs = linear.pairs
        lost = int(
            assemble(
                system.rows, pairs.first, pairs.second, pairs.start, pairs.inner_end,
                pairs.outer_end, linear.normal, linear.along, linear.across, system.drag,
                self.column, self.row, values,
            )
        )  # fmt: skip
        if linear.walls.size:
            mobility = 1.0 / (system.drag * system.rows[:, 3:4])
            values[self._diagonal()] -= (mobility * linear.walls).ravel()
        return lost

    def _diagonal(self) -> NDArray[Any]:
        """Return where the 3 n entries of the diagonal stand."""
        columns = np.repeat(np.arange(len(self.pointer) - 1), np.diff(self.pointer))
        return np.flatnonzero(self.index == columns)

    def matrix(self, values: FloatArray) -> Any:
        """Return a ``scipy.sparse.csc_matrix`` with these values."""
        from scipy.sparse import csc_matrix

        size = len(self.pointer) - 1
        return csc_matrix((values, self.index, self.pointer), shape=(size, size))


def limit(system: Mechanics, fraction: float) -> float:
    """Bound the softening of every pair in the last linearisation; return the largest slope.

    Where dF/dh is below -``fraction`` E_ij r_ij it is raised to that, until the next
    :meth:`Mechanics.linearise`. Only the way to the solution changes, not the solution. The
    slope that is returned is dF/dh of a pair or of a wall, nN/µm.
    """
    linear = system.linearisation
    pairs = linear.pairs
    stiffest = float(
        limit_softening(
            system.rows, pairs.first, pairs.second, pairs.start, pairs.outer_end, fraction,
            linear.along, linear.across,
        )
    )  # fmt: skip
    return max(stiffest, float(linear.walls.max(initial=0.0)))


def sparse_jacobian(system: Mechanics) -> Any:
    """Return J = ∂ẋ/∂x of the last linearisation, 1/s.

    Parameters
    ----------
    system
        After :meth:`Mechanics.linearise`, without friction between cells.

    Returns
    -------
    scipy.sparse.csc_matrix, (3 n, 3 n)
        Entry (3 i + a, 3 j + b) is the derivative of component a of cell i's velocity by
        component b of cell j's position. Pairs of the neighbour list that are out of contact
        stand in it as zeros.
    """
    pattern = Pattern.of(system.linearisation.pairs)
    values = np.empty(len(pattern.index))
    pattern.fill(system, values)
    return pattern.matrix(values)


@final
class Sweeps:
    """Symmetric Gauss-Seidel on M, or an incomplete factorisation of it, chunk by chunk.

    Parameters
    ----------
    incomplete
        Correct each diagonal block for the blocks eliminated before it (the D-ILU of the
        literature), instead of taking it as it is.
    """

    def __init__(self, incomplete: bool = False) -> None:
        self.incomplete = incomplete
        # a tissue may have no pairs at all: then nothing below asks for room
        self._near = np.empty(0, dtype=np.int32)
        self._link = np.empty((0, 5))
        self._begin = np.empty((0, 2), dtype=np.int64)

    def setup(self, system: Mechanics, gamma: float) -> None:
        """Prepare for (I - γJ) at the last linearisation."""
        system.work.preconditioner_setups += 1
        linear = system.linearisation
        pairs = linear.pairs
        if len(self._near) < len(pairs.first):
            self._near = np.empty(len(pairs.first), dtype=np.int32)
            self._link = np.empty((len(pairs.first), 5))
        if len(self._begin) != pairs.n:
            self._begin = np.empty((pairs.n, 2), dtype=np.int64)
            self._blocks = np.empty((pairs.n, 6))
        self._chunks = len(pairs.start)
        self._parallel = system.threads > 1 and self._chunks >= system.shared_chunks
        run = factor_parallel if self._parallel else factor
        run(
            system.chunk, system.rows, pairs.first, pairs.second, pairs.start, pairs.inner_end,
            pairs.outer_end, linear.normal, linear.along, linear.across, gamma, system.drag,
            linear.walls, self.incomplete, self._begin, self._near, self._link, self._blocks,
        )  # fmt: skip

    def solve(self, system: Mechanics, vector: FloatArray, out: FloatArray) -> None:
        """Write the approximate solution for ``vector``, both (n, 3)."""
        system.work.preconditioner_solves += 1
        run = sweep_parallel if self._parallel else sweep
        vector = vector.view()
        vector.flags.writeable = False
        run(
            self._chunks, system.chunk, system.rows, system.drag, self._begin, self._near,
            self._link, self._blocks, vector, out,
        )  # fmt: skip
