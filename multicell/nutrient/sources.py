"""Points and planes that stand still and give off a substance at a constant rate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from multicell.cells import FloatArray
from multicell.errors import NutrientFailed
from multicell.nutrient.grid import BoxLayout

if TYPE_CHECKING:
    from multicell.nutrient.cartesian import Box
    from multicell.nutrient.grid import Layout
    from multicell.scene.nutrient import Source


def injected(layout: Layout, sources: Mapping[str, Source]) -> FloatArray:
    """Return what sources give to the nodes of a box, mM/s.

    A point is spread over the nodes around it with linear weights, as a cell is; a plane over the
    two layers of nodes beside it.
    """
    assert isinstance(layout, BoxLayout)
    total = layout.filled(0.0)
    for name, source in sources.items():
        _refuse_outside(layout.box, name, source)
        if source.strength is not None:
            place = np.array([[source.x or 0.0, source.y or 0.0, source.z or 0.0]])
            total += layout.scatter(place, np.array([source.strength]))
        else:
            total += _plane(layout.box, source)
    return total


def _plane(box: Box, source: Source) -> FloatArray:
    """Return what a plane gives to the nodes, mM/s, in a shape that fills the box."""
    ((axis, place),) = source.place.items()
    count, k = box.shape["xyz".index(axis)], "xyz".index(axis)
    u = (place - box.origin[k]) / box.spacing - 0.5
    lower = int(np.floor(u))
    weights = np.zeros(count)
    weights[max(lower, 0)] += 1.0 - (u - lower)
    weights[min(lower + 1, count - 1)] += u - lower
    shape = [1, 1, 1]
    shape[k] = count
    return np.asarray((source.flux or 0.0) / box.spacing * weights.reshape(shape))


def _refuse_outside(box: Box, name: str, source: Source) -> None:
    for axis, place in source.place.items():
        k = "xyz".index(axis)
        low, high = box.origin[k], box.upper[k]
        if not low <= place <= high:
            raise NutrientFailed(
                f"the source '{name}' lies at {axis} = {place:g} um, outside the field's grid, "
                f"which reaches from {low:.4g} to {high:.4g} um",
                "A grid that follows the cells may leave a source behind: give the scene a domain",
            )
