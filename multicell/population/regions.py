"""Regions round the centre of a tissue: necrotic core, hypoxic part, inhibited part.

A region is found from the cells alone, one by one, without bins. Where the share of cells that
belong to it falls with the distance from the centre, its radius is where the isotonic regression of
that share passes the share at the border; that is where the excess of its cells over the others is
largest, and the excess also exists where the share does not fall.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import Cells, FloatArray, Mask, Phase, State
from multicell.vectors import lengths, squares

FEWEST: Final = 8.0
"""Cells by which a region must outnumber the others in it. Where four of five cells are others, so
large an excess at a given centre comes by chance once in 65,000 times, 4^8."""

_DROP: Final = 0.1  # of the excess, lost to others further out: a region of its own begins
_ROUNDS: Final = 12  # of moving a region's centre
_SHIFT: Final = 0.05  # of a region's radius: nearer centres differ by 0.1 % in it
_AROUND: Final = 1.2  # radii of a region within which its cells move its centre
_NEAREST: Final = 32  # cells of the centre that are asked for an empty region round it
_APART: Final = math.cos(math.radians(30.0))  # of directions in which an empty region has cells
_SURFACE: Final = 10  # cells of the surface, at least
_CHANCE: Final = 1e-4  # of finding so few cycling cells at the centre of uniform tissue


@final
class Surroundings:
    """The cells of a tissue about a point, ordered by their distance once somebody asks.

    - ``position``, (n, 3) µm: of all cells
    - ``radius``, (n,) µm: of all cells
    - ``origin``, (3,) µm: the point
    - ``size``: radius of the whole tissue, µm
    - ``dimensions``: 3, or 2 where all cells lie in a plane
    - ``away``, (n,) µm²: squares of the distances, where they are known
    """

    def __init__(
        self,
        position: FloatArray,
        radius: FloatArray,
        origin: FloatArray,
        size: float,
        dimensions: int,
        away: FloatArray | None = None,
    ) -> None:
        self.position, self.radius, self.origin = position, radius, origin
        self.size, self.dimensions = size, dimensions
        self.squares = squares(position - origin) if away is None else away

    def about(self, origin: FloatArray) -> Surroundings:
        """Return the same cells about another point."""
        return Surroundings(self.position, self.radius, origin, self.size, self.dimensions)

    @cached_property
    def order(self) -> NDArray[np.intp]:
        """Rows of the cells by distance."""
        return np.argsort(self.squares)

    @cached_property
    def apart(self) -> FloatArray:
        """Distances in this order, (n,) µm."""
        return np.sqrt(self.squares[self.order])

    def expected(self, distance: FloatArray) -> FloatArray:
        """Return how many cells tissue of the mean density has within some distances in µm."""
        part = np.minimum(distance, self.size) / self.size
        return np.asarray(len(self.position) * part**self.dimensions)

    @cached_property
    def may_be_hollow(self) -> bool:
        """Whether the nearest cells leave room for as many more as a region must have."""
        nearest = min(_NEAREST, len(self.squares))
        if nearest < FEWEST:  # no more are expected than there are
            return False
        near = np.sqrt(np.sort(np.partition(self.squares, nearest - 1)[:nearest]))
        return bool((self.expected(near) - 2.0 * np.arange(nearest) >= FEWEST).any())

    def closed(self, beyond: int) -> bool:
        """Return whether all but the nearest cells lie in all directions, unlike two pieces."""
        grid = np.indices((3,) * self.dimensions).reshape(self.dimensions, -1).T - 1.0
        ways = np.zeros((len(grid), 3))
        ways[:, : self.dimensions] = grid
        ways = ways[(grid != 0.0).any(axis=1)]
        ways /= lengths(ways)[:, None]
        far, limit = self.position[self.order[beyond:]] - self.origin, _APART * self.apart[beyond:]
        return all(bool((far @ way > limit).any()) for way in ways)


def region_radius(cells: Surroundings, inside: Mask, others: float = 0.5) -> float:
    """Return the radius of the region round the centre in which most cells are of one sort, µm.

    Cells that are missing count as of that sort: with the mean density of the tissue, an empty
    region has so many cells. It must be closed, with cells in all directions. A region has its own
    centre, which need not be that of the tissue but must have the tissue's inside. Where the
    tissue's centre is of the other sort, or fewer than eight cells are in excess, there is none.

    Parameters
    ----------
    cells
        All cells, about the centre of the tissue.
    inside
        Which of them are of the sort, (n,) bool.
    others
        Largest share of cells of the other sort at the border of the region: 0.5 for half, as
        sections are segmented; 0 for a region that has none at all.

    Returns
    -------
    float
        In µm; 0 where there is no region, the tissue's where all cells belong to it.
    """
    if inside.all():
        return cells.size
    few = int(inside.sum()) < FEWEST
    if few and not cells.may_be_hollow:
        return 0.0
    excess, reach = _excess(cells, inside, others)
    found = cells
    for turn in range(0 if few else _ROUNDS):
        near = inside if turn == 0 else inside & (found.squares < (_AROUND * reach) ** 2)
        if not near.any():
            break
        moved = cells.about(cells.position[near].mean(axis=0))
        if float(lengths((moved.origin - found.origin)[None])[0]) < _SHIFT * reach:
            break
        there = _excess(moved, inside, others)
        if there[0] > excess:
            (excess, reach), found = there, moved
        elif turn:
            break
    apart = float(lengths((cells.origin - found.origin)[None])[0])
    return min(reach, cells.size) if excess >= FEWEST and apart < reach else 0.0


def _excess(cells: Surroundings, inside: Mask, others: float) -> tuple[float, float]:
    """Return by how many cells a region about a point outnumbers the others, and its radius, µm."""
    count, apart = len(inside), cells.apart
    rest = np.append(0.0, np.cumsum(~inside[cells.order], dtype=float))  # of the k nearest cells
    held = np.arange(count + 1.0)
    edge = np.append(apart, max(cells.size, apart[-1]))  # where the next cell begins
    total = np.maximum(held, cells.expected(edge))
    # rises where the share of others is less than the one allowed
    k = _border(others * (total - rest) - (1.0 - others) * rest, edge)
    if k == count:
        return float(total[k] - 2.0 * rest[k]), cells.size
    nearer, next_one = float(apart[k - 1]) if k else 0.0, float(apart[k])
    reach = max(0.5 * (nearer + next_one), next_one - float(cells.radius[cells.order[k]]))
    between = cells.expected(np.array([nearer, next_one]))
    missing = max(total[k] - k, between[1] - between[0])
    if missing >= max(FEWEST, _DROP * k) and not cells.closed(k):
        k = _border(others * (held - rest) - (1.0 - others) * rest, edge)
        total, reach = held, float(apart[k - 1] + cells.radius[cells.order[k - 1]]) if k else 0.0
    return float(total[k] - 2.0 * rest[k]), reach


def _border(score: FloatArray, edge: FloatArray) -> int:
    """Return how many of the nearest cells lie in the region, the most with the largest score.

    What lies beyond a layer of others is not in it, and its inner half must be of its sort: a
    shell is no region.
    """
    top = np.maximum.accumulate(score)
    lost = (top - score > np.maximum(FEWEST, _DROP * top)) & (top >= 0.5 * FEWEST)
    end = int(np.argmax(lost)) or len(score)
    inner = score[np.searchsorted(edge[:end], 0.5 * edge[:end])]
    allowed = np.where(inner >= 0.0, score[:end], -np.inf)
    return end - 1 - int(np.argmax(allowed[::-1]))


def inhibited_region(cells: Cells, about: Surroundings, threshold: float) -> float:
    """Return the radius within which proliferation is inhibited, µm; 0 if it is nowhere.

    Inside, the share of the cells that are alive, not quiescent, and in S, G2 or M (green with
    FUCCI) is below a part (``threshold``) of that in the outermost tenth. The share as a function
    of the distance from the centre is the isotonic regression of single cells, which needs no bins.
    A tissue without one cycling cell is inhibited as a whole; a few cells at the centre that may be
    without by chance are no region.

    - ``cells``: the population
    - ``about``: its cells about its centre
    """
    from scipy.optimize import isotonic_regression
    from scipy.special import bdtr

    resting = cells.dead | (cells.state == State.QUIESCENT)
    cycles = ~resting & (cells.phase > Phase.G1)
    if not cycles.any():
        return about.size
    cycling = cycles[about.order].astype(float)
    surface = float(cycling[-max(_SURFACE, len(cells) // 10) :].mean())
    if surface == 0.0:
        return 0.0  # the surface rests, and cells within it cycle
    share = isotonic_regression(cycling).x
    count = int(np.searchsorted(share, threshold * surface))
    if count == 0 or bdtr(cycling[:count].sum(), count, surface) > _CHANCE:
        return 0.0
    return float(about.apart[count - 1 : count + 1].mean())
