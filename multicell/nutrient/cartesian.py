"""Boxes of the nutrient grid, which lie round the cells at every moment."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import final

import numpy as np

from multicell.cells import FloatArray, IntArray
from multicell.compiling.threads import Team
from multicell.errors import NutrientFailed
from multicell.scene.domain import filling
from multicell.scene.scales import MAX_NODES
from multicell.vectors import corners, cubes, second_moments, weighted_mean

_FARTHEST = 1e9  # spacings from the origin; beyond, rounding would eat into the grid's spacing

_NEAR_NODES = 50_000
"""Nodes that are interpolated at once: what is between is then still in the nearer memory."""

_PART = 100_000
"""Least number of nodes for each thread that shares them."""

_NEARLY = 0.75  # an axis longer than this part of the longest gets as many nodes


@final
@dataclass(frozen=True)
class Box:
    """A cell-centred grid of cubes, or of squares in the plane z = 0.

    - ``origin``, (3,) float, µm: lower corner
    - ``shape``, (3,) int
    - ``spacing``, float, µm
    - ``height``, float or None, µm: in two dimensions, of the layer; ``shape`` then ends with 1
    - ``repeats``, (3,) bool: along which axes space repeats: the nodes at both ends are neighbours
    """

    origin: tuple[float, float, float]
    shape: tuple[int, int, int]
    spacing: float
    height: float | None = None
    repeats: tuple[bool, bool, bool] = (False, False, False)

    @property
    def upper(self) -> tuple[float, float, float]:
        """Upper corner, µm."""
        x, y, z = (o + n * self.spacing for o, n in zip(self.origin, self.shape, strict=True))
        return (x, y, z)

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return self.shape[0] * self.shape[1] * self.shape[2]

    @cached_property
    def volume(self) -> float:
        """Volume of a node, µm³."""
        return self.spacing**2 * (self.height or self.spacing)

    def axes(self) -> list[FloatArray]:
        """Return the coordinates of the nodes along each axis, (nx,), (ny,), (nz,) µm."""
        return [
            np.asarray(o + (np.arange(n) + 0.5) * self.spacing, dtype=np.float64)
            for o, n in zip(self.origin, self.shape, strict=True)
        ]


def extent(position: FloatArray, margin: float) -> tuple[FloatArray, FloatArray]:
    """Return the corners (3,), (3,) in µm of the box that holds all cells and the margin."""
    if len(position) == 0:
        position = np.zeros((1, 3))
    low, high = corners(position)
    low, high = low - margin, high + margin
    if not all(map(math.isfinite, (*low.tolist(), *high.tolist()))):
        raise NutrientFailed(
            "a cell's position is not a finite number, so no nutrient grid can be laid",
            "Look at the mechanics of the step before: a smaller coupling_step may help",
        )
    return low, high


def lay(low: FloatArray, high: FloatArray, spacing: float, height: float | None = None) -> Box:
    """Lay a box round the corners ``low`` and ``high`` (µm); a plane where there is a ``height``.

    The faces across the longest axis lie exactly there, and so do those across axes nearly as
    long: the layer of medium between cells and faces is as thick as the margin at every moment.
    (A box that grew in steps would make supply, and with it the states of the cells, jump.) So
    the spacing is adapted: it is at most ``spacing``, and the number of nodes along
    an axis has only small factors, where the sine transform is fast.
    """
    axes = 3 if height is None else 2
    # bare numbers: of three of them arrays are ten times as slow
    return _lay(tuple(zip(low[:axes].tolist(), high[:axes].tolist(), strict=True)), spacing, height)


@lru_cache(maxsize=16)  # fields with the same margin lie on the same box
def _lay(ends: tuple[tuple[float, float], ...], spacing: float, height: float | None) -> Box:
    """Lay it between the two ends of each axis."""
    size = [b - a for a, b in ends]
    _refuse_too_large([s / spacing for s in size], size, spacing)
    _refuse_too_far(ends, spacing)
    longest = max(size)
    most = _fast(longest / spacing)
    edge = longest / most
    counts = [most if s > _NEARLY * longest else _fast(s / edge) for s in size]
    _refuse_too_large(counts, size, spacing)
    origin = [0.5 * (a + b) - 0.5 * n * edge for (a, b), n in zip(ends, counts, strict=True)]
    return _box(origin, counts, edge, height)


def _box(
    origin: list[float],
    counts: list[int],
    spacing: float,
    height: float | None,
    repeats: tuple[bool, bool, bool] = (False, False, False),
) -> Box:
    """Return a box, with a flat third axis round z = 0 where there is a ``height``."""
    if height is not None:
        origin, counts = [*origin[:2], -0.5 * spacing], [*counts[:2], 1]
    a, b, c = origin
    x, y, z = counts
    return Box((a, b, c), (x, y, z), spacing, height, repeats)


def fill(
    low: FloatArray,
    high: FloatArray,
    spacing: float,
    height: float | None,
    repeats: tuple[bool, bool, bool] = (False, False, False),
) -> Box:
    """Fill a box that stands still with cubes, or in two dimensions with squares.

    - ``low``, ``high``, (3,), µm: its corners; where ``height`` is given the third axis is not
      looked at
    - ``spacing``, float, µm: largest edge of a cube; see :func:`multicell.scene.domain.filling`
    - ``repeats``: see :class:`Box`
    """
    axes = 3 if height is None else 2
    lengths = (high - low)[:axes]
    counts = filling(lengths.tolist(), spacing)
    if counts is None:
        raise NutrientFailed(
            f"no cubes of about {spacing:g} um fill the domain",
            "Take lengths that are multiples of one spacing",
        )
    _refuse_too_large(counts, lengths.tolist(), spacing)
    edge = float((lengths / counts).max())
    while not (lengths / edge <= counts).all():  # rounding must leave no point outside
        edge = float(np.nextafter(edge, np.inf))
    return _box([float(x) for x in low], list(counts), edge, height, repeats)


def covered_fractions(old: Box, new: Box) -> list[FloatArray]:
    """Return for each axis the part of every new interval that lies in every old one, (n, m)."""
    found = []
    for axis in range(3):
        a, b = (
            box.origin[axis] + np.arange(box.shape[axis] + 1) * box.spacing for box in (new, old)
        )
        low = np.maximum(a[:-1, None], b[None, :-1])
        high = np.minimum(a[1:, None], b[None, 1:])
        found.append(np.maximum(high - low, 0.0) / new.spacing)
    if new.height is not None:
        found[2] = np.ones((1, 1))
    return found


def moved(values: FloatArray, old: Box, new: Box, fill: float, threads: int = 1) -> FloatArray:
    """Return node values on ``new``, interpolated from ``old`` and ``fill`` outside it.

    - ``threads``: how many may share the planes of many nodes; it changes no result
    """
    out, inside, ends = np.full(new.shape, fill), [], []
    for k, nodes in enumerate(new.axes()):
        there = np.flatnonzero((nodes >= old.origin[k]) & (nodes <= old.upper[k]))
        u = (nodes[there] - old.origin[k]) / old.spacing - 0.5
        lower = np.floor(u).astype(np.int64)
        w = (u - lower).reshape([-1 if axis == k else 1 for axis in range(3)])
        if len(there) == 0:
            return out
        inside.append(slice(there[0], there[-1] + 1))
        ends.append((np.maximum(lower, 0), np.minimum(lower + 1, old.shape[k] - 1), w))
    own, (low, high, weight) = out[tuple(inside)], ends[0]
    size = max(1, _NEAR_NODES // math.prod(values.shape[1:]))

    def bring(begin: int, end: int) -> None:
        for first in range(begin, end, size):
            rows = slice(first, min(first + size, end))
            lowest = int(low[rows][0])
            part = values[lowest : int(high[rows][-1]) + 1]
            for k in (2, 1):
                part = _between(part, k, *ends[k])
            part = _between(part, 0, low[rows] - lowest, high[rows] - lowest, weight[rows])
            own[rows] = part

    with Team(max(1, min(threads, values.size // _PART))) as team:
        team.share(bring, len(low))
    return out


def _between(
    values: FloatArray, axis: int, low: IntArray, high: IntArray, weight: FloatArray
) -> FloatArray:
    """Return ``(1 - weight) low + weight high`` of the nodes along an axis."""
    found, other = values.take(low, axis=axis), values.take(high, axis=axis)
    found *= 1.0 - weight
    other *= weight
    found += other
    return found


def mesh(axes: list[FloatArray]) -> FloatArray:
    """Return all points with coordinates from three axes, (n, 3), the last running fastest."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _fast(needed: float) -> int:
    """Return a number of nodes, not below ``needed``, that suits the sine transform."""
    # rounding must not add a node to a length that is a whole number of spacings
    count = max(2, math.ceil(needed * (1.0 - 1e-12)))
    while not _smooth(count):
        count += 1
    return count


@lru_cache(maxsize=4096)
def _smooth(count: int) -> bool:
    """Return whether a number has no prime factor above 11."""
    for factor in (2, 3, 5, 7, 11):
        while count % factor == 0:
            count //= factor
    return count == 1


def _refuse_too_large(nodes: Sequence[float], size: Sequence[float], spacing: float) -> None:
    total = math.prod(nodes)
    if total <= MAX_NODES:
        return
    lengths = " x ".join(f"{length:.4g}" for length in size)
    raise NutrientFailed(
        f"cells and margin spread over {lengths} um, so the nutrient grid would need "
        f"{total:.3g} nodes at a spacing of {spacing:g} um, more than the {MAX_NODES} allowed",
        "Use a larger spacing of the nutrient, or find out why cells are so far apart",
    )


def _refuse_too_far(ends: Iterable[tuple[float, float]], spacing: float) -> None:
    farthest = max(max(-low, high) for low, high in ends)
    if farthest > _FARTHEST * spacing:
        raise NutrientFailed(
            f"a cell is {farthest:.3g} um away from the origin, where a grid with a spacing of "
            f"{spacing:g} um is lost in rounding",
            "Start the cells near the origin, or find out why they are so far away",
        )


MIN_ROUND_CELLS = 20
"""Cells up to which a cluster is never taken as round: its field costs nothing anyway."""

ROUND = 0.1
"""Departure from a ball up to which shells are enough."""

_BACK = 0.7
"""Part of the limit below which a field in a box goes back to shells."""


def departure(position: FloatArray, radius: FloatArray) -> float:
    """Return the departure of a population from a ball: 0 for a ball, towards 1 for a thread.

    The tensor of gyration of the cells, weighted by volume and with the cells' own extent, has
    the principal radii a >= b >= c, those of the ellipsoid with the same tensor. The departure
    is (a - c) / a.
    """
    if len(position) == 0:
        return 0.0
    weight = cubes(radius)
    away = position - weighted_mean(position, weight)
    tensor = second_moments(away, weight) / weight.sum()
    own = 0.2 * float(weighted_mean(radius**2, weight))
    squares = np.linalg.eigvalsh(tensor) + own
    return float(1.0 - np.sqrt(squares[0] / squares[-1]))


def round_enough(position: FloatArray, radius: FloatArray, now_radial: bool) -> bool:
    """Return whether shells do for a population.

    It depends on the state and on the present geometry only: what is radial stays so up to the
    limit, and what is not goes back well below it, so that it does not change all the time.
    """
    if len(position) <= MIN_ROUND_CELLS:
        return False
    return departure(position, radius) <= (ROUND if now_radial else _BACK * ROUND)
