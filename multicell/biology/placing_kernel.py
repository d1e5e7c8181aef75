"""The compiled loop that puts cells where there is room, one after another.

A place is drawn by the random numbers of :func:`multicell.random.uniform` for the cell's identity
and the attempt: as many as :data:`NUMBERS` says for the shape.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit

from multicell.compiling import INNER, KERNEL
from multicell.philox import blocks

SHAPES: Final = ("box", "ball", "shell")
"""Shapes of a region by their numbers."""
NUMBERS: Final = (3, 3, 5)
"""Random numbers of a place; in a shell three of a direction, a radius, and whether it counts."""
_SHELL = SHAPES.index("shell")
_BALL = SHAPES.index("ball")


@njit(**KERNEL)
def put(
    seed, purpose, ids, begin, end, most, kind, axes, centre, sides, inner, outer, apart, place,
    low, width, shape, first, following,
):  # fmt: skip
    """Put the rows ``begin`` ... ``end - 1`` each at the first place drawn for it that is free.

    Parameters
    ----------
    seed, purpose : uint64
        Keys of the random numbers.
    ids : (n,) int64
    begin, end : int
    most : int
        Attempts for one cell.
    kind : int
        Place of the region's shape among :data:`SHAPES`.
    axes : (d,) int64
        Along which the region extends.
    centre : (3,) float64, µm
    sides : (d,) float64, µm
        Of the box round the region, by ``axes``.
    inner, outer : float, µm
        Radii of a ball or shell.
    apart : (n,) float64, µm
        Distance that a cell keeps to each other one, less that of the other.
    place : (n, 3) float64, µm
        Places of all rows before ``begin``; those that are put are written.
    low : (3,) float64, µm
        Corner of the bins.
    width : float, µm
        Of a bin, at least the sum of the two largest ``apart``.
    shape : (3,) int64
        Number of bins along each axis.
    first : (bins,), following : (n,) int64
        Row in each bin that came last, and the one in the same bin before a row; -1 for none.

    Returns
    -------
    int
        The first row for which no place was free, or ``end``.
    """
    near = np.empty((3, 2), dtype=np.int64)
    point = np.empty(3)
    counter = np.zeros((4, 2 if kind == _SHELL else 1), dtype=np.uint64)
    words = np.empty_like(counter)
    for block in range(counter.shape[1]):
        counter[0, block] = block
    for row in range(begin, end):
        found = False
        counter[2, :] = ids[row]
        for attempt in range(most):
            counter[3, :] = attempt
            blocks(counter, seed, purpose, words)
            if not _drawn(words, kind, axes, centre, sides, inner, outer, point):
                continue
            own = 0
            for axis in range(3):
                at = int((point[axis] - low[axis]) / width)
                at = min(max(at, 0), shape[axis] - 1)
                own = own * shape[axis] + at
                near[axis, 0] = max(at - 1, 0)
                near[axis, 1] = min(at + 1, shape[axis] - 1)
            found = _free(point, row, apart, place, near, shape, first, following)
            if found:
                place[row] = point
                following[row] = first[own]
                first[own] = row
                break
        if not found:
            return row
    return end


@njit(**INNER)
def _number(words, k):
    """Return the k-th uniform number in [0, 1) of blocks of random words."""
    return np.float64(words[k % 4, k // 4] >> np.uint64(11)) * 2.0**-53


@njit(**INNER)
def _drawn(words, kind, axes, centre, sides, inner, outer, point):
    """Write the place that random words stand for to ``point``; return whether it counts.

    Those that count are uniform over the region. In a box all do, in a ball (disc) those of the box
    round it that lie inside. In a shell a direction counts if its draw lies in the unit ball, and a
    radius r with the probability (r / outer)^(d-1).
    """
    point[:] = centre
    span = len(axes)
    square = 0.0
    for k in range(span):
        way = 2.0 * _number(words, k) - 1.0
        square += way * way
        point[axes[k]] += 0.5 * sides[k] * way
    if kind == _BALL:
        return square <= 1.0
    if kind == _SHELL:
        far = inner + _number(words, 3) * (outer - inner)
        share = far / outer
        if (
            square > 1.0
            or square < 1e-6
            or _number(words, 4) >= (share if span == 2 else share * share)
        ):
            return False
        length = np.sqrt(square)
        for k in range(span):
            way = 2.0 * _number(words, k) - 1.0
            point[axes[k]] = centre[axes[k]] + far * (way / length)
    return True


@njit(**INNER)
def _free(point, row, apart, place, near, shape, first, following):
    """Return whether a point keeps the distance of a row to all rows in the bins round it."""
    for i in range(near[0, 0], near[0, 1] + 1):
        for j in range(near[1, 0], near[1, 1] + 1):
            for k in range(near[2, 0], near[2, 1] + 1):
                other = first[(i * shape[1] + j) * shape[2] + k]
                while other >= 0:
                    dx, dy, dz = (
                        place[other, 0] - point[0],
                        place[other, 1] - point[1],
                        place[other, 2] - point[2],
                    )
                    least = apart[row] + apart[other]
                    if dx * dx + dy * dy + dz * dz < least * least:
                        return False
                    other = following[other]
    return True
