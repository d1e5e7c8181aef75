"""The Jacobian as a sparse matrix, and what an implicit method bounds in it.

Written with Γ_i = 6πη r_i and, for each pair, P = K = k n nᵀ - (F/d)(I - n nᵀ), the Jacobian of
the velocities has blocks J_ij = P_ij / Γ_i and J_ii = -Σ_j P_ij / Γ_i; walls add their
stiffness, one number for each axis, to the sum over j.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from multicell.compiling import KERNEL
from multicell.mechanics import neighbours

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
                radius = rows[i, 3] * rows[j, 3] / (rows[i, 3] + rows[j, 3])
                least = -fraction * radius / (rows[i, 4] + rows[j, 4])
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
            system.rows, pairs.first, pairs.second, pairs.start, pairs.outer_end, fraction,
            linear.along, linear.across,
        )
    )  # fmt: skip
    return linear, max(stiffest, float(linear.walls.max(initial=0.0)))


@final
@dataclass(frozen=True)
class Pattern:
    """Which entries of the Jacobian may differ from zero, for one neighbour list.

    - ``column``, (n + 1,) int64: where the 3 x 3 blocks of each column of blocks begin in ``row``
    - ``row``, (b,) int64: row of each block, growing within a column
    - ``pointer``, ``index``, (3 n + 1,), (9 b,) int32: the same for single entries, as SciPy's CSC
      format has them
    """

    column: NDArray[np.int64]
    row: NDArray[np.int64]
    pointer: NDArray[np.int32]
    index: NDArray[np.int32]

    @classmethod
    def of(cls, pairs: PairList, *, indirect: bool = False) -> Pattern:
        """Return the pattern of a neighbour list, with all diagonal blocks.

        ``indirect`` says whether neighbours of neighbours are coupled, as by compression.
        """
        from scipy.sparse import csc_matrix, kron

        place, _ = _places(pairs)
        first, second, own = pairs.first[place], pairs.second[place], np.arange(pairs.n)
        row, column = np.concatenate([first, second, own]), np.concatenate([second, first, own])
        # pairs between chunks are listed twice
        shape = (pairs.n, pairs.n)
        blocks = csc_matrix((np.ones(len(row), np.bool_), (row, column)), shape=shape)
        if indirect:
            blocks = blocks @ blocks
            blocks.sort_indices()
        whole = kron(blocks, np.ones((3, 3), np.int8), format="csc")
        whole.sort_indices()
        return cls(
            blocks.indptr.astype(np.int64), blocks.indices.astype(np.int64),
            whole.indptr.astype(np.int32), whole.indices.astype(np.int32),
        )  # fmt: skip

    @classmethod
    def near(cls, position: FloatArray, system: Mechanics, margin: float) -> Pattern:
        """Return the pattern with room for pairs whose surfaces are closer than a margin.

        - ``system``: the largest radii of its coupling step count
        """
        motion = system.motion
        length = motion.end - motion.begin
        largest = np.maximum(motion.radius, motion.radius + motion.radius_rate * length)
        near = neighbours.build(position, largest, margin * float(largest.mean()))
        return cls.of(near, indirect=system.compression is not None)

    def fill(self, system: Mechanics, values: FloatArray, linear: Linearisation) -> int:
        """Write J at a linearisation, 1/s; return how many blocks have no place.

        - ``values``: (9 b,), the entries in the order of ``index``
        """
        place, inner = _places(linear.pairs)
        along, across = linear.along[place], -linear.across[place]
        touching = (along != 0.0) | (across != 0.0)
        place, inner, along, across = (x[touching] for x in (place, inner, along, across))
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
        mobility = 1.0 / (system.drag * system.rows[:, 3])
        six = mobility[i, None] * np.repeat(six, 2, axis=0)[sides]
        own = -np.stack([np.bincount(i, six[:, k], n) for k in range(6)], axis=1).astype(float)
        if linear.walls.size:
            own[:, : linear.walls.shape[1]] -= mobility[:, None] * linear.walls
        values[:] = 0.0
        lost = self._put(i, j, six, values)
        self._put(np.arange(n), np.arange(n), own, values)
        if linear.coupling is not None:
            lost += self._add_coupling(linear, mobility, values)
        if system.prescribed is not None:
            # held cells are no unknowns: neither rows nor columns
            held = np.repeat(system.prescribed.held, 3)
            column = np.repeat(np.arange(len(held)), np.diff(self.pointer))
            values[held[self.index] | held[column]] = 0.0
        return lost

    def _add_coupling(self, linear: Linearisation, mobility: FloatArray, values: FloatArray) -> int:
        """Add -Γ⁻¹ Gᵀ D G of compressed tissue; return how many entries have no place."""
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
        change = change.tocoo()
        key = np.repeat(np.arange(3 * n), np.diff(self.pointer)) * 3 * n + self.index
        wanted = change.col.astype(np.int64) * 3 * n + change.row
        at = np.minimum(np.searchsorted(key, wanted), len(key) - 1)
        known = key[at] == wanted
        values[at[known]] += change.data[known]
        return int((change.data[~known] != 0.0).sum())

    def _put(
        self, i: NDArray[np.int64], j: NDArray[np.int64], six: FloatArray, values: FloatArray
    ) -> int:
        """Write symmetric blocks (i, j); return how many have no place."""
        n = len(self.column) - 1
        key = np.repeat(np.arange(n), np.diff(self.column)) * n + self.row
        wanted = j * n + i
        place = np.minimum(np.searchsorted(key, wanted), len(key) - 1)
        known = key[place] == wanted
        place, j, six = place[known], j[known], six[known]
        height = 3 * np.diff(self.column)[j]
        corner = 9 * self.column[j] + 3 * (place - self.column[j])
        step = np.arange(3)
        at = corner[:, None, None] + step[:, None] + height[:, None, None] * step
        values[at] = six[:, _SQUARE]
        return int(len(known) - known.sum())

    def matrix(self, values: FloatArray) -> Any:
        """Return a ``scipy.sparse.csc_matrix`` with these values."""
        from scipy.sparse import csc_matrix

        size = len(self.pointer) - 1
        return csc_matrix((values, self.index, self.pointer), shape=(size, size))


def sparse_jacobian(system: Mechanics) -> Any:
    """Return J = ∂ẋ/∂x of the last linearisation, 1/s.

    - ``system``: after :meth:`Mechanics.linearise`, without friction between cells

    Returns scipy.sparse.csc_matrix, (3 n, 3 n): entry (3 i + a, 3 j + b) is the derivative of
    component a of cell i's velocity by component b of cell j's position. Pairs of the neighbour
    list that are out of contact stand in it as zeros.
    """
    linear = system.linearisation
    pattern = Pattern.of(linear.pairs, indirect=linear.coupling is not None)
    values = np.empty(len(pattern.index))
    pattern.fill(system, values, linear)
    return pattern.matrix(values)


def _places(pairs: PairList) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the places of a list that are used, and which of them are within a chunk."""
    ends = zip(pairs.start, pairs.inner_end, pairs.outer_end, strict=True)
    parts = [(np.arange(start, end), inner) for start, inner, end in ends]
    if not parts:
        return np.empty(0, np.int64), np.empty(0, np.bool_)
    inner = np.concatenate([place < end for place, end in parts])
    return np.concatenate([place for place, _ in parts]), inner
