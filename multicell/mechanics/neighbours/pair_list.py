"""All pairs of cells that are close, chunk by chunk.

The cells are cut, in the order of their indices, into chunks (:data:`CHUNK` cells). A chunk owns
its cells: pairs with both cells inside stand once in it ("inner"), pairs that reach out of it
("outer") stand in both chunks that they touch, each time with the owned cell first. So each chunk
can sum the forces on its own cells without looking at other chunks' sums, and the result has the
same bits whatever the number of threads.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

IndexArray = NDArray[np.int32]
OffsetArray = NDArray[np.int64]
ListArrays = tuple[IndexArray, IndexArray, OffsetArray, OffsetArray, OffsetArray]
"""``first``, ``second``, ``start``, ``inner_end`` and ``outer_end`` of a :class:`PairList`."""

CHUNK = 2048  # cells in a chunk. Larger ones share fewer pairs, smaller ones feed more threads.


@final
@dataclass(frozen=True)
class PairList:
    """All pairs of ``n`` cells that are closer than ``r_i + r_j + skin``.

    - ``first``, ``second``, (m,) int32: cells of a pair, which of the two comes first is left open
      but for outer pairs. Only the ranges named below hold pairs, the rest is spare room.
    - ``start``, ``inner_end``, ``outer_end``, (k,) int64: for chunk ``c``, inner pairs are
      ``start[c]:inner_end[c]`` and outer pairs ``inner_end[c]:outer_end[c]``
    - ``chunk``, int: cells in a chunk
    - ``n``, int: number of cells
    """

    first: IndexArray
    second: IndexArray
    start: OffsetArray
    inner_end: OffsetArray
    outer_end: OffsetArray
    chunk: int
    n: int

    def __len__(self) -> int:
        """Return the number of pairs, each counted once."""
        inner = int((self.inner_end - self.start).sum())
        return inner + int((self.outer_end - self.inner_end).sum()) // 2

    @property
    def arrays(self) -> ListArrays:
        """The arrays of the list, in the order in which kernels take and return them."""
        return self.first, self.second, self.start, self.inner_end, self.outer_end

    def pairs(self) -> IndexArray:
        """Return every pair once, (m, 2), smaller index first, in lexicographic order."""
        index = np.concatenate(
            [np.arange(a, b) for a, b in zip(self.start, self.outer_end, strict=True)]
            or [np.empty(0, dtype=np.int64)]
        ).astype(np.int64)
        both = np.sort(np.stack([self.first[index], self.second[index]], axis=1), axis=1)
        return np.unique(both, axis=0).reshape(-1, 2)


def listed(pairs: PairList) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the cells of all places of a list; spare room stands for cell 0 twice."""
    used = np.zeros(len(pairs.first), dtype=np.bool_)
    for start, end in zip(pairs.start, pairs.outer_end, strict=True):
        used[start:end] = True
    first = np.where(used, pairs.first, 0).astype(np.int64)
    return first, np.where(used, pairs.second, 0).astype(np.int64)


def are_listed(
    pairs: IndexArray | OffsetArray | None,
    first: NDArray[np.int64],
    second: NDArray[np.int64],
    n: int,
) -> NDArray[np.bool_]:
    """Return which pairs of the cells ``first`` and ``second`` are among ``pairs``, (m, 2)."""
    if pairs is None:
        return np.zeros(len(first), dtype=np.bool_)
    known = pairs[:, 0] * np.int64(n) + pairs[:, 1]
    return np.isin(np.minimum(first, second) * np.int64(n) + np.maximum(first, second), known)
