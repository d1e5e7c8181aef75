"""Arithmetic on tables of three columns, such as positions.

NumPy's reductions along a short axis, and over a long axis of several columns at once, take five to
fifteen times as long as those of one column after the other.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def cubes(values: FloatArray) -> FloatArray:
    """Return the third powers; ``**`` calls a function for each that takes thirty times as long."""
    return values * values * values


def squares(vectors: FloatArray) -> FloatArray:
    """Return the squares of the lengths of vectors (n, 3): (n,)."""
    x, y, z = vectors.T
    return np.asarray(x * x + y * y + z * z)


def squares_about(columns: FloatArray, point: FloatArray) -> FloatArray:
    """Return the squares of distances from a point, (3,), of places by coordinate, (3, n): (n,)."""
    found = np.zeros(columns.shape[1])
    for column, place in zip(columns, point, strict=True):
        way = column - place
        way *= way
        found += way
    return found


def lengths(vectors: FloatArray) -> FloatArray:
    """Return the lengths of vectors (n, 3): (n,)."""
    return np.sqrt(squares(vectors))


def corners(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and the highest coordinates of points (n, 3), n > 0: two of (3,)."""
    columns = np.ascontiguousarray(points.T)
    return np.minimum.reduce(columns, axis=1), np.maximum.reduce(columns, axis=1)


def weighted_mean(values: FloatArray, weights: FloatArray) -> Any:
    """Return the mean of a column, (n,), or of each column of a table, (n, k), by weights, (n,)."""
    return np.multiply(values.T, weights, order="C").sum(axis=-1) / weights.sum()


def second_moments(vectors: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the sum of w v vᵀ over vectors v (n, 3) with weights w (n,): (3, 3)."""
    columns, found = np.ascontiguousarray(vectors.T), np.empty((3, 3))
    for row, one in enumerate(columns):
        for column, other in enumerate(columns[: row + 1]):
            found[row, column] = found[column, row] = (one * other * weights).sum()
    return found


def wrapped(position: FloatArray, period: FloatArray) -> FloatArray:
    """Return the images of places (n, 3) that lie between zero and the period, (3,) µm.

    A period of zero: space does not repeat along this axis.
    """
    inverse = np.divide(1.0, period, out=np.zeros(3), where=period > 0.0)
    inside = position - period * np.floor(position * inverse)
    # by rounding some lie at the other end, or below zero: a whole number of periods away
    outside = ((inside < 0.0) | (inside >= period)) & (period > 0.0)
    return np.where(outside, 0.0, inside)


def nearest_differences(
    first: FloatArray, second: FloatArray, period: FloatArray | None
) -> FloatArray:
    """Return the ways from places (n, 3) to the nearest images of others, µm."""
    way = second - first
    if period is None:
        return way
    inverse = np.divide(1.0, period, out=np.zeros(3), where=period > 0.0)
    return np.asarray(way - period * np.floor(way * inverse + 0.5))
