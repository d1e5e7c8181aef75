"""An approximate inverse of I - γJ by symmetric Gauss-Seidel, for backward Euler.

Written as in :mod:`multicell.mechanics.jacobian`, (I - γJ) x = b is M x = Γ b with the symmetric

    M = Γ - γK:   M_ii = Γ_i + γ Σ_j P_ij,   M_ij = -γ P_ij.

The preconditioner takes the stable part of each pair alone (max(k, 0) along n and max(-F/d, 0)
across), so that it is symmetric positive definite for every γ > 0, where M itself need not
be: pairs that are pressed together push each other sideways.

The chunks of :mod:`multicell.mechanics.neighbours` list inner pairs by growing first cell, smaller
cell first: that is the upper triangle of M row by row, and sweeps along it and back are a
symmetric Gauss-Seidel step without any assembly. Pairs between chunks enter the diagonal
blocks only, so that chunks are independent, and any number of threads gives the same bits.

No fastmath, see :mod:`multicell.mechanics.forces`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, final

import numpy as np
from numba import njit, prange

from multicell.compiling import INNER, arithmetic
from multicell.compiling.threads import two_drivers
from multicell.mechanics.blocks import (
    NEARLY_SINGULAR,
    XX,
    XY,
    XZ,
    YY,
    YZ,
    ZZ,
    add_block,
    invert_by_pivots,
)
from multicell.mechanics.rows import RADIUS

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.mechanics.system import Linearisation, Mechanics

_EPS = float(np.finfo(float).eps)
_FLAT = 1.0 / NEARLY_SINGULAR**2
"""Determinant over the product of the diagonal below which cofactors are rounding."""


@njit(**INNER)
def _link(p, gamma, along, across):
    """Return w and s of a pair with P = w n nᵀ + s I, both zero where it does not touch."""
    s = gamma * max(-across[p], 0.0)
    return gamma * max(along[p] - across[p], 0.0) - s, s


@njit(**INNER)
def _collect_chunk(
    c,
    chunk,
    rows,
    first,
    second,
    start,
    inner_end,
    outer_end,
    normal,
    along,
    across,
    gamma,
    drag,
    walls,
    begin,
    near,
    link,
    blocks,
):
    """Write the diagonal blocks of one chunk of M, and its inner pairs that touch.

    ``walls`` is the stiffness of each cell's walls along the axes, or has no rows.
    ``near`` and ``link`` (n, w, s with P = w n nᵀ + s I, times γ) hold the pairs of cell i at
    ``begin[i, 0]:begin[i, 1]``.
    """
    low, high = c * chunk, min((c + 1) * chunk, rows.shape[0])
    for i in range(low, high):
        begin[i, 0] = begin[i, 1] = 0
        blocks[i, XX] = blocks[i, YY] = blocks[i, ZZ] = drag * rows[i, RADIUS]
        blocks[i, XY] = blocks[i, XZ] = blocks[i, YZ] = 0.0
    if walls.shape[0] > 0:
        for i in range(low, high):
            for k in range(walls.shape[1]):
                blocks[i, k] += gamma * walls[i, k]
    for p in range(start[c], outer_end[c]):
        w, s = _link(p, gamma, along, across)
        if s == 0.0 and w == 0.0:
            continue
        i, j = first[p], second[p]
        for side in range(2 if p < inner_end[c] else 1):
            k = i if side == 0 else j
            add_block(blocks, k, w, s, normal[p, 0], normal[p, 1], normal[p, 2])
        if p < inner_end[c]:
            begin[min(i, j), 1] += 1
    # a list names the cells of a pair in any order, the sweeps need the one that comes first
    at = start[c]
    for i in range(low, high):
        begin[i, 0], at = at, at + begin[i, 1]
        begin[i, 1] = begin[i, 0]
    for p in range(start[c], inner_end[c]):
        w, s = _link(p, gamma, along, across)
        if s == 0.0 and w == 0.0:
            continue
        i, at = min(first[p], second[p]), begin[min(first[p], second[p]), 1]
        near[at] = max(first[p], second[p])
        link[at, 0], link[at, 1], link[at, 2] = normal[p, 0], normal[p, 1], normal[p, 2]
        link[at, 3], link[at, 4] = w, s
        begin[i, 1] = at + 1


@arithmetic
def _invert(blocks, i):
    """Replace a symmetric 3 x 3 block by its inverse."""
    a, b, c = blocks[i, XX], blocks[i, YY], blocks[i, ZZ]
    f, g, h = blocks[i, XY], blocks[i, XZ], blocks[i, YZ]
    xx, xy, xz = b * c - h * h, g * h - f * c, f * h - b * g
    determinant = a * xx + f * xy + g * xz
    if not determinant > _FLAT * a * b * c:
        invert_by_pivots(a, b, c, f, g, h, _EPS * max(a, b, c), blocks[i])
        return
    scale = 1.0 / determinant
    blocks[i, XX] = xx * scale
    blocks[i, YY] = (a * c - g * g) * scale
    blocks[i, ZZ] = (a * b - f * f) * scale
    blocks[i, XY] = xy * scale
    blocks[i, XZ] = xz * scale
    blocks[i, YZ] = (f * g - a * h) * scale


def _factor(
    chunk,
    rows,
    first,
    second,
    start,
    inner_end,
    outer_end,
    normal,
    along,
    across,
    gamma,
    drag,
    walls,
    begin,
    near,
    link,
    blocks,
):
    """Prepare the sweeps for a γ at the linearisation given by its pairs."""
    for c in prange(start.size):
        _collect_chunk(
            c,
            chunk,
            rows,
            first,
            second,
            start,
            inner_end,
            outer_end,
            normal,
            along,
            across,
            gamma,
            drag,
            walls,
            begin,
            near,
            link,
            blocks,
        )
        for i in range(c * chunk, min((c + 1) * chunk, blocks.shape[0])):
            _invert(blocks, i)


@njit(**INNER)
def _sweep_chunk(c, chunk, rows, drag, begin, near, link, blocks, vector, out):
    """Solve (D + L) D⁻¹ (D + U) x = Γ b for the cells of one chunk."""
    low, high = c * chunk, min((c + 1) * chunk, rows.shape[0])
    for i in range(low, high):
        weight = drag * rows[i, RADIUS]
        for k in range(3):
            out[i, k] = weight * vector[i, k]
    for i in range(low, high):
        x, y, z = out[i, 0], out[i, 1], out[i, 2]
        u = blocks[i, XX] * x + blocks[i, XY] * y + blocks[i, XZ] * z
        v = blocks[i, XY] * x + blocks[i, YY] * y + blocks[i, YZ] * z
        t = blocks[i, XZ] * x + blocks[i, YZ] * y + blocks[i, ZZ] * z
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
        out[i, 0] += blocks[i, XX] * x + blocks[i, XY] * y + blocks[i, XZ] * z
        out[i, 1] += blocks[i, XY] * x + blocks[i, YY] * y + blocks[i, YZ] * z
        out[i, 2] += blocks[i, XZ] * x + blocks[i, YZ] * y + blocks[i, ZZ] * z


def _sweep(chunks, chunk, rows, drag, begin, near, link, blocks, vector, out):
    """Write an approximate solution of (I - γJ) x = ``vector``, both (n, 3)."""
    for c in prange(chunks):
        _sweep_chunk(c, chunk, rows, drag, begin, near, link, blocks, vector, out)


_DRIVERS = tuple(zip(two_drivers(_factor), two_drivers(_sweep), strict=True))
"""Factorisation and sweeps for one thread, and for all of them."""


@final
class Sweeps:
    """Symmetric Gauss-Seidel on M, chunk by chunk."""

    def __init__(self, system: Mechanics) -> None:
        self.system = system
        # a tissue may have no pairs at all: then nothing below asks for room
        self._near = np.empty(0, dtype=np.int32)
        self._link = np.empty((0, 5))
        self._begin = np.empty((0, 2), dtype=np.int64)

    def setup_preconditioner(self, gamma: float, linear: Linearisation) -> None:
        """Prepare for (I - γJ) at a linearisation."""
        system = self.system
        system.work.preconditioner_setups += 1
        linear = linear.stiffened()
        pairs = linear.pairs
        if len(self._near) < len(pairs.first):
            self._near = np.empty(len(pairs.first), dtype=np.int32)
            self._link = np.empty((len(pairs.first), 5))
        if len(self._begin) != pairs.n:
            self._begin = np.empty((pairs.n, 2), dtype=np.int64)
            self._blocks = np.empty((pairs.n, 6))
        self._chunks = len(pairs.start)
        factor, self._run = _DRIVERS[system.shared(self._chunks)]
        factor(
            system.chunk,
            system.weighed_rows,
            pairs.first,
            pairs.second,
            pairs.start,
            pairs.inner_end,
            pairs.outer_end,
            linear.normal,
            linear.along,
            linear.across,
            gamma,
            system.drag,
            linear.walls,
            self._begin,
            self._near,
            self._link,
            self._blocks,
        )

    def precondition(self, vector: FloatArray, out: FloatArray) -> None:
        """Write the approximate solution for ``vector``, both (n, 3)."""
        system = self.system
        system.work.preconditioner_solves += 1
        given = system.prescribed
        free = vector.view() if given is None else given.released(vector)
        free.flags.writeable = False
        self._run(
            self._chunks,
            system.chunk,
            system.weighed_rows,
            system.drag,
            self._begin,
            self._near,
            self._link,
            self._blocks,
            free,
            out,
        )
        if given is not None:
            out[given.held] = vector[given.held]
