"""Places of cells at random in a region, none nearer to another than it may be."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from multicell.biology.placing_kernel import SHAPES, put
from multicell.errors import SceneError
from multicell.random import Purpose
from multicell.scene.arrangement import Region, refuse_too_dense, region

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.scene.scene import Scene

_TOGETHER: Final = 16384
"""Cells that are put in one call."""
_MOST: Final = 1_000_000
"""Places that are tried for one cell."""
_BINS: Final = 8.0
"""Most bins of the grid over the number of cells."""


def random_places(scene: Scene, ids: NDArray[np.int64], radius: FloatArray) -> FloatArray:
    """Return places of cells in the scene's region, (n, 3) µm.

    Random sequential addition: the cells come one after the other, and each takes the first of the
    places drawn for it (by seed, identity and attempt) that is no nearer to an earlier cell than
    ``spacing`` times the sum of both radii. So a cell's place depends on those before it alone:
    further cells change nothing. Only what every machine computes to the same bit is used.

    Parameters
    ----------
    ids : (n,)
    radius : (n,), µm

    Raises
    ------
    SceneError
        If the cells do not find room.
    """
    where = region(scene)
    assert where is not None
    refuse_too_dense(scene, 2.0 * float(radius.mean()))
    grid = _Grid(where, len(ids), 2.0 * scene.initial.spacing * float(radius.max()))
    place, apart = np.empty((len(ids), 3)), scene.initial.spacing * radius
    for begin in range(0, len(ids), _TOGETHER):  # Ctrl-C is heard in between
        end = min(begin + _TOGETHER, len(ids))
        stop = grid.put(scene.seed, ids, apart, place, begin, end)
        if stop < end:
            problem = f"is {len(ids):,}: no room was found for a cell after {stop:,} others"
            hint = "Take fewer cells, a larger region or a smaller initial.spacing."
            raise SceneError("initial.count", problem, hint)
    return place


class _Grid:
    """Bins as wide as cells reach, each with a list of the cells in it."""

    def __init__(self, where: Region, count: int, reach: float) -> None:
        self.where = where
        half = np.array(where.half())
        span = len(where.axes)
        size = float(np.prod([2.0 * half[axis] for axis in where.axes]))
        self.width = max(reach, (size / (_BINS * count)) ** (1.0 / span))
        self.low = np.array(where.centre) - half
        self.shape = np.floor(2.0 * half / self.width).astype(np.int64) + 1
        self.first = np.full(int(self.shape.prod()), -1, dtype=np.int64)
        self.following = np.full(count, -1, dtype=np.int64)

    def put(
        self,
        seed: int,
        ids: NDArray[np.int64],
        apart: FloatArray,
        place: FloatArray,
        begin: int,
        end: int,
    ) -> int:
        """Put the rows from ``begin`` to ``end``; return the first that found no place, or end."""
        where = self.where
        inner, outer = (0.0, 0.0) if where.shape == "box" else where.lengths
        sides = where.lengths if where.shape == "box" else (2.0 * outer,) * len(where.axes)
        return int(
            put(
                np.uint64(seed), np.uint64(Purpose.ARRANGEMENT), ids, begin, end, _MOST,
                SHAPES.index(where.shape), np.array(where.axes), np.array(where.centre),
                np.array(sides), inner, outer, apart, place,
                self.low, self.width, self.shape, self.first, self.following,
            )
        )  # fmt: skip
