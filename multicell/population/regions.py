"""Regions round the centre of a tissue: necrotic core, hypoxic part, inhibited part.

A region is found from the cells alone, one by one, without bins. Where the share of cells that
belong to it falls with the distance from the centre, its radius is where the isotonic regression of
that share passes the share at the border; that is where the excess of its cells over the others is
largest, and the excess also exists where the share does not fall.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cached_property
from typing import Final, final

import numpy as np

from multicell.cells import Cells, FloatArray, IntArray, Mask, Phase, State
from multicell.vectors import lengths, squares_about

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
_SHELLS: Final = 1024  # in which many cells are counted before any are sorted
_FEW: Final = 2000  # cells that are sorted at once
_SORTED: Final = 32  # more shells than asked for, in which cells are sorted
_SLACK: Final = 0.01  # of bounds in cells, more than rounding
_ABOVE: Final = 1e-6  # of a share: cells that cycle more often have no part in its border


@final
class Surroundings:
    """The cells of a tissue about a point: counted in shells, and sorted as far as a region needs.

    - ``columns``, (3, n) µm: coordinates of all cells
    - ``radius``, (n,) µm: of all cells
    - ``origin``, (3,) µm: the point
    - ``size``: radius of the whole tissue, µm
    - ``dimensions``: 3, or 2 where all cells lie in a plane
    - ``away``, (n,) µm²: squares of the distances, where they are known
    """

    def __init__(
        self,
        columns: FloatArray,
        radius: FloatArray,
        origin: FloatArray,
        size: float,
        dimensions: int,
        away: FloatArray | None = None,
    ) -> None:
        self.columns, self.radius, self.origin = columns, radius, origin
        self.size, self.dimensions = size, dimensions
        self.squares = squares_about(columns, origin) if away is None else away
        self._order, self._sorted = np.empty(0, dtype=np.int64), 0

    def about(self, origin: FloatArray) -> Surroundings:
        """Return the same cells about another point."""
        return Surroundings(self.columns, self.radius, origin, self.size, self.dimensions)

    @cached_property
    def _scale(self) -> float:
        """Shells over the square of the distance in µm²; 0, a single one, where cells are few."""
        farthest = float(self.squares.max())
        few = len(self.squares) < _FEW or not 0.0 < farthest < math.inf
        return 0.0 if few else (_SHELLS - 0.5) / farthest

    @cached_property
    def shell(self) -> IntArray:
        """Shell of each cell, (n,); the squares of their radii are evenly spaced."""
        if self._scale == 0.0:
            return np.zeros(len(self.squares), dtype=np.int64)
        return (self.squares * self._scale).astype(np.int64)

    @cached_property
    def edges(self) -> FloatArray:
        """Radii between the shells, µm, the first of them 0."""
        if self._scale == 0.0:
            return np.array([0.0, math.inf])
        return np.sqrt(np.arange(_SHELLS + 1.0) / self._scale)

    def counted(self, rows: IntArray | slice) -> IntArray:
        """Return how many cells of some rows lie within each of the edges."""
        found = np.bincount(self.shell[rows], minlength=len(self.edges) - 1)
        return np.append(0, found.cumsum())

    @cached_property
    def held(self) -> IntArray:
        """How many cells lie within each of the edges."""
        return self.counted(slice(None))

    def nearest(self, shells: int) -> IntArray:
        """Return the rows of the cells in the first shells by distance."""
        last = len(self.edges) - 1
        if shells > self._sorted:  # regions about one point often end near each other
            self._sorted = min(shells + _SORTED, last)
            if last == 1:
                self._order = np.argsort(self.squares)
            else:  # of cells as far away the same come first, however many are sorted
                rows = np.flatnonzero(self.shell < self._sorted)
                self._order = rows[np.argsort(self.squares[rows], kind="stable")]
        return self._order if shells >= last else self._order[: self.held[shells]]

    def outermost(self, many: int) -> IntArray:
        """Return the rows of so many cells that are farthest away."""
        nearer = len(self.squares) - many
        if self._scale == 0.0:
            return self.nearest(1)[nearer:]
        shell = int(np.searchsorted(self.held, nearer, side="right")) - 1
        (shared,), (beyond,) = (self.shell == shell).nonzero(), (self.shell > shell).nonzero()
        ordered = shared[np.argsort(self.squares[shared], kind="stable")]
        return np.append(ordered[nearer - self.held[shell] :], beyond)

    def expected(self, distance: FloatArray) -> FloatArray:
        """Return how many cells tissue of the mean density has within some distances in µm."""
        part = np.minimum(distance, self.size) / self.size
        return np.asarray(len(self.radius) * part**self.dimensions)

    @cached_property
    def may_be_hollow(self) -> bool:
        """Whether the nearest cells leave room for as many more as a region must have."""
        nearest = min(_NEAREST, len(self.squares))
        if nearest < FEWEST:  # no more are expected than there are
            return False
        near = np.sqrt(np.sort(np.partition(self.squares, nearest - 1)[:nearest]))
        return bool((self.expected(near) - 2.0 * np.arange(nearest) >= FEWEST).any())

    def closed(self, within: IntArray) -> bool:
        """Return whether all cells but the rows ``within`` lie in all directions."""
        grid = np.indices((3,) * self.dimensions).reshape(self.dimensions, -1).T - 1.0
        ways = np.zeros((len(grid), 3))
        ways[:, : self.dimensions] = grid
        ways = ways[(grid != 0.0).any(axis=1)]
        ways /= lengths(ways)[:, None]
        beyond = np.delete(np.arange(len(self.squares)), within)
        far = self.columns[:, beyond].T - self.origin
        limit = _APART * np.sqrt(self.squares[beyond])
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
    rows = np.flatnonzero(inside)
    if len(rows) == len(inside):
        return cells.size
    few = len(rows) < FEWEST
    if few and not cells.may_be_hollow:
        return 0.0
    excess, reach = _excess(cells, inside, rows, others)
    found = cells
    for turn in range(0 if few else _ROUNDS):
        near = rows if turn == 0 else rows[found.squares[rows] < (_AROUND * reach) ** 2]
        if not near.size:
            break
        # one after another, as NumPy adds up the rows of a table
        middle = np.array([column[near].cumsum()[-1] for column in cells.columns])
        moved = cells.about(middle / len(near))
        if float(lengths((moved.origin - found.origin)[None])[0]) < _SHIFT * reach:
            break
        there = _excess(moved, inside, rows, others)
        if there[0] > excess:
            (excess, reach), found = there, moved
        elif turn:
            break
    apart = float(lengths((cells.origin - found.origin)[None])[0])
    return min(reach, cells.size) if excess >= FEWEST and apart < reach else 0.0


def _excess(
    cells: Surroundings, inside: Mask, rows: IntArray, others: float
) -> tuple[float, float]:
    """Return by how many cells a region about a point outnumbers the others, and its radius, µm."""
    k, total, rest, order = _border(cells, inside, rows, others, hollow=True)
    if k == len(inside):
        return total - 2.0 * rest, cells.size
    between = np.sqrt(cells.squares[order[max(k - 1, 0) : k + 1]])
    nearer, next_one = float(between[0]) if k else 0.0, float(between[-1])
    reach = max(0.5 * (nearer + next_one), next_one - float(cells.radius[order[k]]))
    more, most = cells.expected(np.array([nearer, next_one])).tolist()
    if max(total - k, most - more) >= max(FEWEST, _DROP * k) and not cells.closed(order[:k]):
        k, total, rest, order = _border(cells, inside, rows, others, hollow=False)
        reach = 0.0
        if k:
            last = order[k - 1]
            reach = float(np.sqrt(cells.squares[last]) + cells.radius[last])
    return total - 2.0 * rest, reach


def _border(
    cells: Surroundings,
    inside: Mask,
    rows: IntArray,
    others: float,
    *,
    hollow: bool,
) -> tuple[int, float, float, IntArray]:
    """Return how many of the nearest cells lie in the region, the most with the largest score.

    The score rises where the share of others is less than the one allowed. What lies beyond a layer
    of others is not in the region, and its inner half must be of its sort: a shell is no region.

    - ``rows``: those of the mask ``inside``
    - ``hollow``: whether cells that are missing count

    Returns also how many cells there are or would be, how many are others, and the rows of the
    cells by distance, as far as they are sorted.
    """
    size, count = cells.size, len(inside)
    for shells, beyond in _sorted_first(cells, rows, others, hollow):
        order = cells.nearest(shells)
        edge = np.sqrt(cells.squares[order])  # where the next cell begins
        rest = np.append(0.0, np.cumsum(~inside[order], dtype=float))  # of the k nearest cells
        if len(order) == count:
            edge = np.append(edge, max(size, edge[-1]))
        rest = rest[: len(edge)]
        held = np.arange(float(len(edge)))
        total = np.maximum(held, cells.expected(edge)) if hollow else held
        score = others * (total - rest) - (1.0 - others) * rest
        top = np.maximum.accumulate(score)
        lost = (top - score > np.maximum(FEWEST, _DROP * top)) & (top >= 0.5 * FEWEST)
        end = int(np.argmax(lost)) or len(score)
        inner = score[np.searchsorted(edge[:end], 0.5 * edge[:end])]
        allowed = np.where(inner >= 0.0, score[:end], -np.inf)
        k = end - 1 - int(np.argmax(allowed[::-1]))
        if end < len(score) or score[k] > beyond:
            break
    return k, float(total[k]), float(rest[k]), order


def _sorted_first(
    cells: Surroundings, rows: IntArray, others: float, hollow: bool
) -> Iterator[tuple[int, float]]:
    """Yield in how many shells cells must be sorted for a border, and the highest score beyond.

    The scores within a shell lie between those of its edges' counts: few shells can hold the
    largest one, or lie before the layer of others that ends a region.
    """
    last = len(cells.edges) - 1
    if last > 1:
        held = cells.held
        rest = held - cells.counted(rows)
        total = np.maximum(held, cells.expected(cells.edges)) if hollow else held
        most = others * total[1:] - rest[:-1] + _SLACK
        least = others * total[:-1] - rest[:-1] - _SLACK
        whole = others * float(held[-1]) - float(rest[-1]) + _SLACK
        top = np.maximum.accumulate(least)
        lost = (top - np.maximum(FEWEST, _DROP * top) > most) & (top >= 0.5 * FEWEST)
        ends = np.flatnonzero(lost & (held[1:] > held[:-1]))[:1] + 1
        if not ends.size and whole < top[-1]:
            ends = np.flatnonzero(most >= top[-1])[-1:] + 1
        if ends.size and held[ends[0]]:
            yield int(ends[0]), max(whole, float(most[ends[0] :].max(initial=-np.inf)))
    yield last, -math.inf


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
    many = min(len(cells), max(_SURFACE, len(cells) // 10))
    surface = np.count_nonzero(cycles[about.outermost(many)]) / many
    if surface == 0.0:
        return 0.0  # the surface rests, and cells within it cycle
    level = threshold * surface
    order = about.nearest(_shells_below(about, cycles, (1.0 + _ABOVE) * level))
    cycling = cycles[order].astype(float)
    end = len(order)
    if end < len(cells):  # there the share passes a level, and what lies beyond changes none within
        number = np.append(0.0, cycling.cumsum())
        end = int(np.argmin(number - (1.0 + _ABOVE) * level * np.arange(end + 1.0)))
    share = isotonic_regression(cycling[:end]).x if end else np.zeros(0)
    count = int(np.searchsorted(share, level))
    if count == 0 or bdtr(cycling[:count].sum(), count, surface) > _CHANCE:
        return 0.0
    return float(np.sqrt(about.squares[order[count - 1 : count + 1]]).mean())


def _shells_below(about: Surroundings, cycles: Mask, level: float) -> int:
    """Return in how many shells cells lie up to where the share of cycling ones passes a level.

    There fewest cells cycle beyond that share of all. One more cell lies in them, if there is one.
    """
    last = len(about.edges) - 1
    if last > 1:
        held, number = about.held, about.counted(np.flatnonzero(cycles))
        least = (number - level * held).min() + _SLACK
        end = held[int(np.flatnonzero(number[:-1] - level * held[1:] <= least)[-1]) + 1]
        last = int(np.searchsorted(held, end, side="right"))
    return last
