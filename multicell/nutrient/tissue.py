"""The cells that carry the unstirred layer of medium: the tissue, without cells that left it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, final

import numpy as np

from multicell.vectors import FloatArray, corners, cubes, lengths, weighted_mean

_GAP = 1.5
"""Width of a gap, in diameters of the largest cell, up to which the tissue continues beyond it."""

_FEW = 16.0  # cells that are tissue, however many there are in all
_PART = 0.1
"""Up to so many cells beyond a gap, and up to this part of all, are strays; twice as many are not.
So few are no wider than a few cells, and deplete their surroundings by little."""


@final
class Tissue:
    """Cells that grids are laid round. What several fields ask of them is found once.

    - ``position``, (n, 3) µm, and ``radius``, (n,) µm; 1 µm where it does not matter

    - ``extent``, (n,) µm: radii with which cells take up and give off; 0, points, without a radius
    """

    def __init__(self, position: FloatArray, radius: FloatArray | None = None) -> None:
        self.position = np.asarray(position, dtype=np.float64)
        if self.position.ndim != 2 or self.position.shape[1] != 3:
            raise ValueError(f"position has shape {self.position.shape}, expected (n, 3)")
        count = len(position)
        self.radius = np.asarray(np.ones(count) if radius is None else radius, dtype=np.float64)
        self.extent = np.zeros(count) if radius is None else self.radius
        self._given = position, radius
        self._found: dict[Any, Any] = {}

    def is_of(self, position: FloatArray, radius: FloatArray) -> bool:
        """Return whether it was made of these very arrays, to which nobody writes."""
        return self._given[0] is position and self._given[1] is radius

    def once(self, find: Callable[..., Any], *given: Any) -> Any:
        """Cache a function of values and of arrays that nobody writes to."""
        key = find, *(id(x) if isinstance(x, np.ndarray) else x for x in given)
        if key not in self._found:
            self._found[key] = find(*given), given  # arrays that live keep their identities
        return self._found[key][0]


def reaching(position: FloatArray, reached: FloatArray, radius: FloatArray) -> FloatArray:
    """Return the radii in µm with which cells exchange: none for strays, at the grid's surface."""
    if reached is position:
        return radius
    return np.where((reached != position).any(axis=1), 0.0, radius)


def drawn_in(position: FloatArray, radius: FloatArray) -> FloatArray:
    """Return the positions with strays moved to the sides of the box that holds the tissue.

    They say where a grid lies. Strays are few cells beyond a gap along an axis, seen from the
    outermost cells of the tissue. The result is continuous in all positions: a cell that leaves
    pulls the border along up to a gap of 1.5 diameters, and the border then returns until the gap
    is twice as wide. Without strays it is the same array.
    """
    few = _few(len(position))
    if few < 1.0:
        return position
    gap = _GAP * 2.0 * float(radius.max())
    if _is_dense(position, few, gap):
        return position
    ends = _ends(position, few)
    # no gap that wide is by what is not finite
    if (ends[1:] - ends[:-1]).max() <= gap:
        return position
    if not np.isfinite(position).all():
        return position
    reached = np.array([_outermost(x, gap, few) for x in ends.T])
    high, low = reached[:3], -reached[3:]
    inside = (position >= low) & (position <= high)
    return position if inside.all() else np.clip(position, low, high)


def drawn_to_ball(position: FloatArray, radius: FloatArray) -> FloatArray:
    """Do the same along the radius of a ball of tissue, seen from its centre of mass."""
    few = _few(len(position))
    if few < 1.0 or not np.isfinite(position).all():
        return position
    middle = weighted_mean(position, cubes(radius))
    away = position - middle
    distance = lengths(away)
    surface = _outermost(_ends(distance[:, None], few)[:, 0], _GAP * 2.0 * float(radius.max()), few)
    if distance.max() <= surface:
        return position
    return np.asarray(middle + away * (surface / np.maximum(distance, surface))[:, None])


def _few(count: int) -> float:
    """Return up to how many of so many cells beyond a gap are strays."""
    return min(_PART * count, _FEW)


def _is_dense(position: FloatArray, few: float, gap: float) -> bool:
    """Return whether a sample shows that no gap is wider among the outermost of :func:`_ends`.

    Between cells of the sample others only part gaps, and as many of it lie no farther out.
    """
    count = int(2.0 * few) + 1
    stride = math.isqrt(len(position) // (6 * count))
    if stride < 2:
        return False
    (low, high), sample = corners(position), np.ascontiguousarray(position[::stride].T)
    sample.sort(axis=1)
    ends = np.column_stack([low, sample[:, :count]]), np.column_stack([sample[:, -count:], high])
    return all(bool(np.diff(end).max() <= gap) for end in ends)


def _ends(position: FloatArray, few: float) -> FloatArray:
    """Return the highest coordinates along each axis, and minus the lowest, rising: (m, 2 k)."""
    count = min(int(2.0 * few) + 1, len(position))
    stride = math.isqrt(len(position) // (6 * count))  # of a sample: what is sorted is then least
    along = np.ascontiguousarray(position.T)
    if stride > 1:  # all that lie as far out as so many of a sample are as many or more
        sample = along[:, ::stride]
        ends = count - 1, sample.shape[1] - count
        low, high = np.partition(sample, ends, axis=1)[:, ends].T[:, :, None]
        outer = ((along <= low) | (along >= high)).any(axis=0)
        along = along.take(np.flatnonzero(outer), axis=1)
    ordered = np.sort(along, axis=1).T
    return np.concatenate([ordered[-count:], -ordered[count - 1 :: -1]], axis=1)


def _outermost(last: FloatArray, gap: float, few: float) -> float:
    """Return how far tissue reaches along a coordinate of its outermost cells, sorted, (m,) µm."""
    reached, count = float(last[0]), len(last)
    for place, beyond in zip(last[1:].tolist(), range(count - 1, 0, -1), strict=True):
        wide = place - reached
        if wide <= gap:
            reached = place
            continue
        # a group of twice as many cells as strays may be is tissue, whatever the gap
        share = min(max(beyond / few - 1.0, 0.0), 1.0)
        reached += max(2.0 * gap - wide, share * wide, 0.0)
    return reached
