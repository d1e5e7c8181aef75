"""Values of a regular grid on another one: averages where it is coarser, else interpolated."""

from __future__ import annotations

import numpy as np

from multicell.cells import FloatArray
from multicell.nutrient.cartesian import Box


def resampled(
    values: FloatArray, ends: tuple[tuple[float, float], ...], box: Box, outside: float
) -> FloatArray:
    """Return values at the nodes of a box, of its shape.

    Between the centres of the values they are linear, and flat from the last ones to the ends;
    along axes that repeat between the same ends they are linear there too. A node gets the mean
    over itself along axes where the values are denser than nodes, else the value at its centre:
    linear functions stay what they are, and so do values at the nodes themselves. Where values are
    denser, their integral is that of the nodes.

    - ``values``, (a, b) or (a, b, c)
    - ``ends``, µm: lower and upper end of the values along each axis
    - ``outside``: what is beyond the ends
    """
    from scipy.sparse import csr_array

    inside = np.ones(())
    for k, ((low, high), n) in enumerate(zip(ends, values.shape, strict=True)):
        repeats = box.repeats[k] and np.allclose((low, high), (box.origin[k], box.upper[k]))
        nodes = np.arange(box.shape[k] + 1, dtype=np.float64)
        edges = np.asarray(box.origin[k] + nodes * box.spacing, dtype=np.float64)
        weights = _weights(edges, low, (high - low) / n, n, repeats=bool(repeats))
        moved = np.moveaxis(values, k, 0)
        # a sparse product adds in one order, whatever the threads
        product = csr_array(weights) @ moved.reshape(n, -1)
        values = np.moveaxis(product.reshape(-1, *moved.shape[1:]), 0, k)
        inside = np.multiply.outer(inside, weights.sum(axis=1))
    return np.asarray(values + np.maximum(1.0 - inside, 0.0) * outside).reshape(box.shape)


def _weights(edges: FloatArray, low: float, step: float, n: int, *, repeats: bool) -> FloatArray:
    """Return the part that each of n values has in each interval between edges, (m, n)."""
    at = (edges - low) / step + 0.5  # in which the values lie at 1, 2 ... n, with one more beside
    width = at[1] - at[0]
    places = np.arange(n + 2)
    if width > 1.0 + 1e-9:
        ends = np.clip(at, 0.5, n + 0.5)
        found = np.diff(_hat_integral(ends[:, None] - places), axis=0) / width
    else:
        centre = 0.5 * (at[1:] + at[:-1])
        found = np.maximum(0.0, 1.0 - np.abs(centre[:, None] - places))
        found[(centre < 0.5) | (centre > n + 0.5)] = 0.0
    found = np.maximum(found, 0.0)
    first, last = (n, 1) if repeats else (1, n)
    found[:, first] += found[:, 0]
    found[:, last] += found[:, n + 1]
    return np.asarray(found[:, 1:-1])


def _hat_integral(t: FloatArray) -> FloatArray:
    """Return the integral up to t of a hat of height 1 between -1 and 1."""
    t = np.clip(t, -1.0, 1.0)
    return np.asarray(np.where(t < 0.0, 0.5 * (1.0 + t) ** 2, 1.0 - 0.5 * (1.0 - t) ** 2))
