"""The order of cells along a curve through space: close cells have close indices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from multicell.cells import FloatArray
from multicell.compiling.threads import Team
from multicell.mechanics.neighbours.pair_list import OffsetArray
from multicell.vectors import corners

_AXES = np.arange(3, dtype=np.uint64)
_PART = 20_000  # least number of cells for each thread that sorts some
_SAMPLE = 2000  # keys from which the shares of the threads follow


def spatial_order(position: FloatArray, width: float, threads: int = 1) -> OffsetArray:
    """Return the order of the cells along a Morton curve, (n,); ties keep their order.

    ``width``, µm, is the edge of the boxes that the curve visits; it is widened where more than 2²¹
    of them would be needed along an axis. ``threads`` may share the work.
    """
    if len(position) == 0:
        return np.empty(0, dtype=np.int64)
    low, high = corners(position)
    # halves, because the extent itself may overflow
    extent = 2.0 * float((0.5 * high - 0.5 * low).max())
    width = max(width, min(extent, np.finfo(float).max) / 2.0**20)
    key = np.empty(len(position), np.uint64)

    def mark(begin: int, end: int) -> None:
        box = ((0.5 * position[begin:end] - 0.5 * low) * (2.0 / width)).astype(np.uint64)
        x, y, z = (_spread(box) << _AXES).T
        key[begin:end] = x | y | z

    with Team(max(1, min(threads, len(key) // _PART))) as team:
        team.share(mark, len(key))
        return _stable_order(key, team)


def _stable_order(key: NDArray[np.uint64], team: Team) -> OffsetArray:
    """Return the order that sorts keys; equal ones keep theirs. Each thread sorts a range of keys.

    Where ranges end does not change the order.
    """
    parts = team.threads
    if parts == 1:
        return np.argsort(key, kind="stable")
    sample = np.sort(key[:: max(1, len(key) // _SAMPLE)])
    ends = [sample[len(sample) * part // parts] for part in range(1, parts)]
    found: list[OffsetArray] = [np.empty(0, np.int64)] * parts

    def sort(begin: int, end: int) -> None:
        for part in range(begin, end):
            inside = np.ones(len(key), np.bool_) if part == 0 else key >= ends[part - 1]
            if part + 1 < parts:
                inside &= key < ends[part]
            rows = np.flatnonzero(inside)
            found[part] = rows.take(np.argsort(key.take(rows), kind="stable"))

    team.share(sort, parts)
    return np.concatenate(found)


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
