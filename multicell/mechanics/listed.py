"""Which pairs stand in a neighbour list."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from multicell.mechanics.neighbours import PairList


def listed(pairs: PairList) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the cells of all places of a list; spare room stands for cell 0 twice."""
    used = np.zeros(len(pairs.first), dtype=np.bool_)
    for start, end in zip(pairs.start, pairs.outer_end, strict=True):
        used[start:end] = True
    first = np.where(used, pairs.first, 0).astype(np.int64)
    return first, np.where(used, pairs.second, 0).astype(np.int64)


def are_listed(
    pairs: NDArray[Any] | None, first: NDArray[np.int64], second: NDArray[np.int64], n: int
) -> NDArray[np.bool_]:
    """Tell which pairs of the cells ``first`` and ``second`` are among ``pairs``, (m, 2)."""
    if pairs is None:
        return np.zeros(len(first), dtype=np.bool_)
    known = pairs[:, 0] * np.int64(n) + pairs[:, 1]
    return np.isin(np.minimum(first, second) * np.int64(n) + np.maximum(first, second), known)
