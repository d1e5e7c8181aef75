"""Concentrations at cells that follow from the field around them: no file need hold these.

The interpolation is that of :mod:`multicell.nutrient`, operation by operation, in sums,
differences, products, quotients and roots of float64, which IEEE 754 defines to the bit on every
machine. Who writes compares, and keeps what comes out otherwise: of cells between the last nodes
and a face.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import FloatArray, IntArray

_AT_ONCE: Final = 1 << 16  # cells: of all that stands between, some twenty numbers each


def interpolated(
    position: FloatArray,
    values: FloatArray,
    origin: FloatArray,
    spacing: float,
    *,
    radial: bool,
    flat: bool,
) -> FloatArray:
    """Return a field at positions, linearly between nodes; NaN outside of it.

    Parameters
    ----------
    position : (n, 3), µm
    values : (nx, ny, nz)
    origin : (3,), µm
        As in :class:`~multicell.results.frame.Field`.
    spacing : µm
    radial, flat
        Whether the nodes are shells, or squares in a plane.
    """
    found = np.empty(len(position))
    with np.errstate(all="ignore"):
        for begin in range(0, len(position), _AT_ONCE):
            part = position[begin : begin + _AT_ONCE]
            if radial:
                result = _on_shells(part, values.reshape(-1), origin, spacing)
            else:
                level = part * np.array([1.0, 1.0, 0.0 if flat else 1.0])
                result = _in_box(level, values, origin, spacing)
            found[begin : begin + _AT_ONCE] = result
    return found


def _on_shells(
    position: FloatArray, values: FloatArray, origin: FloatArray, spacing: float
) -> FloatArray:
    x, y, z = (position - origin).T
    u = np.sqrt(x * x + y * y + z * z) / spacing - 0.5
    inside = u <= len(values) - 0.5
    lower = np.floor(np.where(inside, u, 0.0)).astype(np.int64)
    weight = u - lower
    below = values[np.maximum(lower, 0)]
    above = values[np.minimum(lower + 1, len(values) - 1)]
    return np.where(inside, (1.0 - weight) * below + weight * above, np.nan)


def _in_box(
    position: FloatArray, values: FloatArray, origin: FloatArray, spacing: float
) -> FloatArray:
    inside = np.ones(len(position), dtype=bool)
    nodes: list[tuple[IntArray, IntArray, FloatArray]] = []
    for axis, count in enumerate(values.shape):
        u = (position[:, axis] - origin[axis]) / spacing
        there = (u >= 0.0) & (u <= count)
        u = np.where(there, u, 0.0) - 0.5
        lower = np.floor(u).astype(np.int64)
        nodes.append((np.maximum(lower, 0), np.minimum(lower + 1, count - 1), u - lower))
        inside &= there
    (i0, i1, wx), (j0, j1, wy), (k0, k1, wz) = nodes

    def between(i: NDArray[np.int64]) -> FloatArray:
        near = (1.0 - wz) * values[i, j0, k0] + wz * values[i, j0, k1]
        far = (1.0 - wz) * values[i, j1, k0] + wz * values[i, j1, k1]
        return np.asarray((1.0 - wy) * near + wy * far)

    return np.where(inside, (1.0 - wx) * between(i0) + wx * between(i1), np.nan)
