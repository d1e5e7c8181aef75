"""Pairs that feel only the overlap beyond an offset, so that sisters part smoothly.

Right after a division two daughters overlap deeply. In the law of a pair with the offset s(t) the
overlap h = r_i + r_j - d is replaced by h - s(t): with s = h - h₀ (h₀ the law's overlap at rest)
the pair is at rest where it is, and as s runs to zero the rest distance r_i + r_j - h₀ - s grows
to that of any other pair. At a given time the force is minus the gradient of the energy
Σ U(h - s), as without an offset; while s falls, the energy may rise by Σ F (-ds/dt): the work that
the division does.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import FloatArray, IntArray
from multicell.mechanics import forces

PairValues = tuple[FloatArray | None, FloatArray | None, FloatArray | None]
"""What a law keeps for each of some pairs; see :class:`~multicell.mechanics.forces.PairData`."""

_NO_INDEX = np.empty(0, dtype=np.int64)


@final
class Offsets:
    """What :class:`~multicell.mechanics.system.Mechanics` keeps of pairs with an offset in a step.

    - ``data``: the pairs as the kernels take them, or None where pairs have no offsets. In a scene
      where they may have, kernels are not compiled once more for the steps in which none has.
    """

    def __init__(self, data: forces.OffsetData | None) -> None:
        self.data = data
        self._pairs: forces.PairData | None = None
        self._places: tuple[IntArray, IntArray] = (_NO_INDEX, _NO_INDEX)

    @classmethod
    def of(
        cls,
        n: int,
        pairs: NDArray[Any] | None,
        offset: FloatArray | None,
        values: Callable[[IntArray, IntArray], PairValues],
    ) -> Offsets:
        """Return the pairs with an offset of a coupling step among ``n`` cells.

        - ``values``: returns for the two cells of each pair what the law keeps for it
        """
        if pairs is None and offset is None:
            return cls(None)
        if pairs is None or offset is None:
            raise ValueError("offset_pairs and offset go together, only one is given")
        check(n, pairs, offset)
        own = np.concatenate([pairs[:, 0], pairs[:, 1]]).astype(np.int64)
        other = np.concatenate([pairs[:, 1], pairs[:, 0]]).astype(np.int64)
        order = np.lexsort((other, own))
        own, other = own[order], other[order]
        value, rate = np.concatenate([offset, offset])[order].astype(float).T.copy()
        begin = np.searchsorted(own, np.arange(n + 1))
        return cls(forces.OffsetData(begin, other, value, rate, *values(own, other)))

    def places(self, pairs: forces.PairData) -> tuple[IntArray, IntArray]:
        """Return the places of the pairs with an offset in a neighbour list, and their entries."""
        if self._pairs is not pairs:
            self._places = forces.offset_places(pairs, self.data)
            self._pairs = pairs
        return self._places

    def listed(self, pairs: forces.PairData, elapsed: float) -> FloatArray | None:
        """Return the offset of each place of a neighbour list, µm; None without any."""
        if self.data is None:
            return None
        places, entries = self.places(pairs)
        amounts = np.zeros(len(pairs.first))
        amounts[places] = np.maximum(
            self.data.value[entries] + self.data.rate[entries] * elapsed, 0.0
        )
        return amounts


def check(n: int, pairs: NDArray[Any], offset: FloatArray) -> None:
    """Raise ValueError if pairs with an offset have no meaning; see :meth:`Offsets.of`."""
    if pairs.ndim != 2 or pairs.shape[1] != 2 or offset.shape != pairs.shape:
        raise ValueError(
            f"offset_pairs has shape {pairs.shape} and offset {offset.shape}, must both be (m, 2)"
        )
    low, high = pairs.T
    wrong = ~((low >= 0) & (low < high) & (high < n))
    if wrong.any():
        raise ValueError(
            f"{pairs[wrong][0].tolist()} in offset_pairs: must be two of {n} cells, "
            "smaller index first"
        )
    if len(np.unique(pairs, axis=0)) < len(pairs):
        raise ValueError("a pair stands twice in offset_pairs")
    wrong = ~(np.isfinite(offset).all(axis=1) & (offset[:, 0] >= 0.0))
    if wrong.any():
        k = int(wrong.argmax())
        raise ValueError(
            f"offset of {pairs[k].tolist()} is {offset[k, 0]:g} µm with rate {offset[k, 1]:g} "
            "µm/s: must be finite, and not below 0 at the beginning"
        )
