"""The Jacobian as a sparse matrix, and what an implicit method bounds in it.

Written with Γ_i = 6πη r_i and, for each pair, P = K = k n nᵀ - (F/d)(I - n nᵀ), the Jacobian of
the velocities has blocks J_ij = P_ij / Γ_i and J_ii = -Σ_j P_ij / Γ_i; walls add their
stiffness, one number for each axis, to the sum over j.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from multicell.compiling import KERNEL
from multicell.mechanics import neighbours
from multicell.mechanics.rows import COMPLIANCE, RADIUS

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.mechanics.neighbours import PairList
    from multicell.mechanics.system import Linearisation, Mechanics

_SQUARE = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])
"""Where the entries of a symmetric block stand among (xx, yy, zz, xy, xz, yz)."""


@njit(**KERNEL)
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
                radius = rows[i, RADIUS] * rows[j, RADIUS] / (rows[i, RADIUS] + rows[j, RADIUS])
                least = -fraction * radius / (rows[i, COMPLIANCE] + rows[j, COMPLIANCE])
                along[p] = max(along[p], across[p] + least)
    return stiffest


def limited(system: Mechanics, fraction: float) -> tuple[Linearisation, float]:
    """Return the last linearisation with bounded softening, and the largest slope.

    Where dF/dh of a pair is below -``fraction`` E_ij r_ij it is raised to that. Only the way to a
    solution changes by that, not the solution. The slope is dF/dh of a pair or of a wall, nN/µm.
    What :meth:`Mechanics.jacobian_product` uses by itself stays as it is.
    """
    linear = system.linearisation
    pairs = linear.pairs
    linear = replace(linear, along=linear.along.copy())
    stiffest = float(
        limit_softening(
            system.rows,
            pairs.first,
            pairs.second,
            pairs.start,
            pairs.outer_end,
            fraction,
            linear.along,
            linear.across,
        )
    )
    return linear, max(stiffest, float(linear.walls.max(initial=0.0)))


def sparse_jacobian(system: Mechanics, linear: Linearisation | None = None) -> Any:
    """Return J = ∂ẋ/∂x, 1/s, at the last linearisation or at one.

    - ``system``: after :meth:`Mechanics.linearise`, without friction between cells

    Returns scipy.sparse.csc_matrix, (3 n, 3 n): entry (3 i + a, 3 j + b) is the derivative of
    component a of cell i's velocity by component b of cell j's position. Pairs of the neighbour
    list that are out of contact stand in it as zeros.
    """
    from scipy.sparse import csc_matrix

    linear = system.linearisation if linear is None else linear
    place, inner = _places(linear.pairs)
    along, across = linear.along[place], -linear.across[place]
    n = len(system.rows)
    nx, ny, nz = linear.normal[place].T
    six = np.empty((len(place), 6))
    six[:, 0], six[:, 1], six[:, 2] = (along * x * x + across for x in (nx, ny, nz))
    six[:, 3], six[:, 4], six[:, 5] = along * nx * ny, along * nx * nz, along * ny * nz
    # both sides of a pair within a chunk, one side of a pair between two
    first, second = linear.pairs.first[place], linear.pairs.second[place]
    sides = np.stack([np.ones(len(place), np.bool_), inner], axis=1).ravel()
    i = np.stack([first, second], axis=1).ravel()[sides].astype(np.int64)
    j = np.stack([second, first], axis=1).ravel()[sides].astype(np.int64)
    mobility = 1.0 / (system.drag * system.rows[:, RADIUS])
    six = mobility[i, None] * np.repeat(six, 2, axis=0)[sides]
    own = -np.stack([np.bincount(i, six[:, k], n) for k in range(6)], axis=1).astype(float)
    if linear.walls.size:
        own[:, : linear.walls.shape[1]] -= mobility[:, None] * linear.walls
    cells, axes = np.arange(n), np.arange(3)
    square = np.concatenate([six, own])[:, _SQUARE]
    i, j = np.concatenate([i, cells]), np.concatenate([j, cells])
    row = np.broadcast_to(3 * i[:, None, None] + axes[:, None], square.shape).ravel()
    column = np.broadcast_to(3 * j[:, None, None] + axes, square.shape).ravel()
    values = square.ravel()
    if linear.coupling is not None:
        change = _coupled(linear, mobility)
        row, column = np.concatenate([row, change.row]), np.concatenate([column, change.col])
        values = np.concatenate([values, change.data])
    if system.prescribed is not None:
        # held cells are no unknowns: neither rows nor columns
        held = np.repeat(system.prescribed.held, 3)
        values[held[row] | held[column]] = 0.0
    return csc_matrix((values, (row, column)), shape=(3 * n, 3 * n))


def _coupled(linear: Linearisation, mobility: FloatArray) -> Any:
    """Return -Γ⁻¹ Gᵀ D G of compressed tissue, a matrix of single entries."""
    from scipy.sparse import csr_matrix, diags

    coupling, n = linear.coupling, len(mobility)
    assert coupling is not None
    place, inner = _places(linear.pairs)
    first, second = linear.pairs.first[place], linear.pairs.second[place]
    part = coupling.slope[place, None] * linear.normal[place]
    # of the first cells, of the second ones in pairs within a chunk, and of walls
    row: list[Any] = [first, first, second[inner], second[inner]]
    column: list[Any] = [first, second, first[inner], second[inner]]
    value = [part, -part, part[inner], -part[inner]]
    if coupling.contacts is not None:
        row, column = [*row, coupling.contacts.cell], [*column, coupling.contacts.cell]
        value.append(coupling.area[:, None] * coupling.contacts.normal)
    rows = np.repeat(np.concatenate(row), 3)
    columns = (3 * np.concatenate(column).astype(np.int64)[:, None] + np.arange(3)).ravel()
    gradient = csr_matrix((np.concatenate(value).ravel(), (rows, columns)), shape=(n, 3 * n))
    change = diags(np.repeat(-mobility, 3)) @ gradient.T @ diags(coupling.weight) @ gradient
    return change.tocoo()


def sparsity(position: FloatArray, system: Mechanics, margin: float) -> Any:
    """Return which entries of J may differ from zero: ones, ``scipy.sparse.csc_matrix``.

    There is room for pairs whose surfaces are closer than ``margin`` times the mean of the largest
    radii in the coupling step of ``system``. Compression couples neighbours of neighbours as well.
    """
    from scipy.sparse import csc_matrix, kron

    largest = np.maximum(system.motion.radius, system.motion.end_radius)
    skin = margin * float(largest.mean())
    if system.period is None:
        near = neighbours.build(position, largest, skin)
    else:
        near = neighbours.build_periodic(position, largest + 0.5 * skin, system.period)
    place, _ = _places(near)
    first, second, own = near.first[place], near.second[place], np.arange(near.n)
    row, column = np.concatenate([first, second, own]), np.concatenate([second, first, own])
    # pairs between chunks are listed twice
    shape = (near.n, near.n)
    blocks = csc_matrix((np.ones(len(row), np.bool_), (row, column)), shape=shape)
    if system.compression is not None:
        blocks = blocks @ blocks
    whole = kron(blocks, np.ones((3, 3)), format="csc")
    whole.sort_indices()
    return whole


def _places(pairs: PairList) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the places of a list that are used, and which of them are within a chunk."""
    ends = zip(pairs.start, pairs.inner_end, pairs.outer_end, strict=True)
    parts = [(np.arange(start, end), inner) for start, inner, end in ends]
    if not parts:
        return np.empty(0, np.int64), np.empty(0, np.bool_)
    inner = np.concatenate([place < end for place, end in parts])
    return np.concatenate([place for place, _ in parts]), inner
