"""Cells sorted in space: along a curve, and into bins however far apart they are."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit
from numpy.typing import NDArray

from multicell.compiling import KERNEL

if TYPE_CHECKING:
    from multicell.cells import FloatArray

IndexArray = NDArray[np.int32]
OffsetArray = NDArray[np.int64]


def spatial_order(position: FloatArray, width: float) -> OffsetArray:
    """Return the order of the cells along a Morton curve.

    Parameters
    ----------
    position : (n, 3)
        Finite centres, µm.
    width
        Edge of the boxes that the curve visits, µm; widened where more than 2²¹ of them
        would be needed along an axis.

    Returns
    -------
    (n,) int64
        Cells that are close in space are close in this order; ties keep their order.
    """
    if len(position) == 0:
        return np.empty(0, dtype=np.int64)
    low = position.min(axis=0)
    # halves, because the extent itself may overflow
    extent = 2.0 * float((0.5 * position.max(axis=0) - 0.5 * low).max())
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


def sorted_sparsely(
    position: FloatArray, radius: FloatArray
) -> tuple[IndexArray, IndexArray, FloatArray, OffsetArray]:
    """Return order, place, cells and ranges of sparse :class:`multicell.mechanics.neighbours.Bins`.

    Coordinates are sorted: memory does not depend on the distances.
    """
    n = len(position)
    width = 2.0 * float(radius.max())
    x, y, z = (_intervals(np.ascontiguousarray(c), width) for c in position.T)
    # a row's key is below 9 n², so that it overflows for no n that fits into memory
    stride = n + 2
    row = z * stride + y
    occupied, rank = np.unique(row, return_inverse=True)
    key = rank * stride + x
    order = np.argsort(key, kind="stable")
    place, sorted_key = np.empty_like(order), key[order]
    place[order] = np.arange(n)
    ranges = np.zeros((n, 5, 2), dtype=np.int64)
    for neighbour in range(5):
        wanted = row + (neighbour + 4) // 3 * stride - stride + (neighbour + 4) % 3 - 1
        found = np.searchsorted(occupied, wanted)
        there = occupied[np.minimum(found, len(occupied) - 1)] == wanted
        line, column = found[there] * stride, x[there]
        ends = (line + np.maximum(column - 1, 0), line + np.minimum(column + 2, stride))
        ranges[there, neighbour] = np.searchsorted(sorted_key, ends).T
    ranges[:, 0, 0] = place + 1
    cells = np.column_stack([position, radius])[order]
    return order.astype(np.int32), place.astype(np.int32), cells, ranges


def _intervals(coordinate: FloatArray, width: float) -> OffsetArray:
    """Return the number of each cell's bin along one axis; close cells differ by at most one."""
    number = np.empty(len(coordinate), dtype=np.int64)
    _sweep(coordinate, np.argsort(coordinate, kind="stable"), width, number)
    return number


@njit(**KERNEL)  # type: ignore[untyped-decorator]
def _sweep(coordinate: FloatArray, order: OffsetArray, width: float, number: OffsetArray) -> None:
    start = coordinate[order[0]]
    found = 0
    for i in order:
        # compared as a sum of halves, which cannot overflow
        if 0.5 * coordinate[i] > 0.5 * start + 0.5 * width:
            start = coordinate[i]
            found += 1
        number[i] = found
