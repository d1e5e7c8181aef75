"""The order of cells along a curve through space: close cells have close indices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from multicell.cells import FloatArray
from multicell.mechanics.neighbours.pair_list import OffsetArray
from multicell.vectors import corners


def spatial_order(position: FloatArray, width: float) -> OffsetArray:
    """Return the order of the cells along a Morton curve, (n,); ties keep their order.

    ``width``, µm, is the edge of the boxes that the curve visits; it is widened where more than 2²¹
    of them would be needed along an axis.
    """
    if len(position) == 0:
        return np.empty(0, dtype=np.int64)
    low, high = corners(position)
    # halves, because the extent itself may overflow
    extent = 2.0 * float((0.5 * high - 0.5 * low).max())
    width = max(width, min(extent, np.finfo(float).max) / 2.0**20)
    box = ((0.5 * position - 0.5 * low) * (2.0 / width)).astype(np.uint64)
    key = (
        _spread(box[:, 0]) | _spread(box[:, 1]) << np.uint64(1) | _spread(box[:, 2]) << np.uint64(2)
    )
    return np.argsort(key, kind="stable")


def _spread(value: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Put two zero bits between the 21 lowest bits (Morton code by magic masks)."""
    value = value & np.uint64(0x1FFFFF)
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        value = (value | (value << np.uint64(shift))) & np.uint64(mask)
    return value
