"""Trilinear transfer between cells and the nodes of a cell-centred grid.

The node ``(i, j, k)`` lies at ``origin + (i + 1/2, j + 1/2, k + 1/2) * spacing``. A point takes
part in its eight nearest nodes with weights that sum to one; within half a spacing of a face the
missing nodes' share goes to their inner neighbours. These are the weights of py-pde's
``ScalarField.insert`` and ``ScalarField.interpolate``. Scatter and gather are transposes of each
other, run on one thread in the order of the cells, and so give the same bits every time.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from multicell.cells import FloatArray

Triple = tuple[float, float, float]


@njit(cache=True)
def _axis_weight(x: float, low: float, spacing: float, n: int) -> tuple[int, int, float]:
    """Return the lower node, the upper node and the weight of the upper one; -1 if outside."""
    u = (x - low) / spacing
    if not (u >= 0.0 and u <= n):  # also true for NaN
        return -1, -1, 0.0
    u -= 0.5
    lower = int(np.floor(u))
    weight = u - lower
    return max(lower, 0), min(lower + 1, n - 1), weight


@njit(cache=True)
def _scatter(position, amount, origin, spacing, out):
    nx, ny, nz = out.shape
    for c in range(position.shape[0]):
        i0, i1, wx = _axis_weight(position[c, 0], origin[0], spacing, nx)
        j0, j1, wy = _axis_weight(position[c, 1], origin[1], spacing, ny)
        k0, k1, wz = _axis_weight(position[c, 2], origin[2], spacing, nz)
        if i0 < 0 or j0 < 0 or k0 < 0:
            return c
        a = amount[c]
        out[i0, j0, k0] += a * (1.0 - wx) * (1.0 - wy) * (1.0 - wz)
        out[i0, j0, k1] += a * (1.0 - wx) * (1.0 - wy) * wz
        out[i0, j1, k0] += a * (1.0 - wx) * wy * (1.0 - wz)
        out[i0, j1, k1] += a * (1.0 - wx) * wy * wz
        out[i1, j0, k0] += a * wx * (1.0 - wy) * (1.0 - wz)
        out[i1, j0, k1] += a * wx * (1.0 - wy) * wz
        out[i1, j1, k0] += a * wx * wy * (1.0 - wz)
        out[i1, j1, k1] += a * wx * wy * wz
    return -1


@njit(cache=True)
def _gather(position, values, origin, spacing, out):
    nx, ny, nz = values.shape
    for c in range(position.shape[0]):
        i0, i1, wx = _axis_weight(position[c, 0], origin[0], spacing, nx)
        j0, j1, wy = _axis_weight(position[c, 1], origin[1], spacing, ny)
        k0, k1, wz = _axis_weight(position[c, 2], origin[2], spacing, nz)
        if i0 < 0 or j0 < 0 or k0 < 0:
            return c
        low = (1.0 - wy) * ((1.0 - wz) * values[i0, j0, k0] + wz * values[i0, j0, k1]) + wy * (
            (1.0 - wz) * values[i0, j1, k0] + wz * values[i0, j1, k1]
        )
        high = (1.0 - wy) * ((1.0 - wz) * values[i1, j0, k0] + wz * values[i1, j0, k1]) + wy * (
            (1.0 - wz) * values[i1, j1, k0] + wz * values[i1, j1, k1]
        )
        out[c] = (1.0 - wx) * low + wx * high
    return -1


def _points(position: FloatArray) -> FloatArray:
    points = np.ascontiguousarray(position, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"position has shape {points.shape}, expected (n, 3)")
    return points


def _refuse_outside(index: int, position: FloatArray) -> None:
    if index >= 0:
        raise ValueError(f"position {position[index]} (row {index}) lies outside the nutrient grid")


def scatter(
    position: FloatArray,
    amount: FloatArray,
    origin: Triple,
    spacing: float,
    shape: tuple[int, int, int],
) -> FloatArray:
    """Spread an amount of each cell over the nodes as a density.

    Parameters
    ----------
    position : (n, 3), µm
    amount : (n,)
        For example a largest uptake in amol/s.
    origin : µm
        Lower corner of the grid's box.
    spacing : float, µm
    shape : (nx, ny, nz)

    Returns
    -------
    (nx, ny, nz)
        Amount per µm³; its sum times ``spacing**3`` is the sum of ``amount``.

    Raises
    ------
    ValueError
        For arrays of other shapes, and for a position outside the box or not finite.
    """
    points = _points(position)
    amounts = np.ascontiguousarray(amount, dtype=np.float64)
    if amounts.shape != points.shape[:1]:
        raise ValueError(f"amount has shape {amounts.shape}, expected ({len(points)},)")
    out = np.zeros(shape)
    _refuse_outside(_scatter(points, amounts, origin, spacing, out), points)
    out /= spacing**3
    return out


def gather(position: FloatArray, values: FloatArray, origin: Triple, spacing: float) -> FloatArray:
    """Interpolate node values at the cells.

    Parameters
    ----------
    position : (n, 3), µm
    values : (nx, ny, nz)
    origin : µm
        Lower corner of the grid's box.
    spacing : float, µm

    Returns
    -------
    (n,)
        In the unit of ``values``; never outside the range of the eight nodes around a point.

    Raises
    ------
    ValueError
        For arrays of other shapes, and for a position outside the box or not finite.
    """
    points = _points(position)
    if values.ndim != 3:
        raise ValueError(f"values has shape {values.shape}, expected (nx, ny, nz)")
    out = np.empty(len(points))
    _refuse_outside(_gather(points, values, origin, spacing, out), points)
    return out
