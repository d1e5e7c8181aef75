"""Neighbours: cells in bins, the list of pairs that are close, its repair, the order of cells.

:class:`NeighbourList` is the list that follows the cells of a coupling step, :func:`build` makes
one of cells as they are.
"""

from multicell.mechanics.neighbours.building import (
    TooManyPairsError,
    build,
    neighbour_pairs,
    too_many_pairs,
)
from multicell.mechanics.neighbours.neighbour_list import NeighbourList
from multicell.mechanics.neighbours.order import spatial_order
from multicell.mechanics.neighbours.pair_list import (
    CHUNK,
    IndexArray,
    OffsetArray,
    PairList,
    are_listed,
    listed,
)
from multicell.mechanics.neighbours.periodic import (
    build_periodic,
    overlapping_pairs,
)
from multicell.mechanics.neighbours.updating import BUILT, REPAIRED, TOO_CROWDED

__all__ = [
    "BUILT",
    "CHUNK",
    "REPAIRED",
    "TOO_CROWDED",
    "IndexArray",
    "NeighbourList",
    "OffsetArray",
    "PairList",
    "TooManyPairsError",
    "are_listed",
    "build",
    "build_periodic",
    "listed",
    "neighbour_pairs",
    "overlapping_pairs",
    "spatial_order",
    "too_many_pairs",
]
