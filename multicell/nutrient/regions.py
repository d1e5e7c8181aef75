"""What stands still in a field: where diffusion is not that of tissue, and what gives off.

Diffusion differs in medium between the cells, in gels and membranes. A node's coefficient is the
harmonic mean over its volume of what lies in it, and the flow between two nodes meets the
resistance of half of each. So resistances across a layer add up as they should wherever its faces
lie, also where it is thinner than a node.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from multicell.cells import FloatArray
from multicell.errors import NutrientFailed
from multicell.nutrient.grid import BoxLayout, Layout, relative_diffusion

if TYPE_CHECKING:
    from multicell.nutrient.cartesian import Box
    from multicell.scene.nutrient import Nutrient, Region, Source


def coefficients(
    layout: Layout, position: FloatArray, radius: FloatArray, nutrient: Nutrient
) -> FloatArray | None:
    """Return the coefficients of diffusion at the nodes over that of tissue; None for ones."""
    tissue, medium = nutrient.diffusion, nutrient.diffusion_medium
    varied = None
    if medium is not None and medium != tissue:
        varied = relative_diffusion(layout, position, radius, medium, tissue)
    if not nutrient.regions:
        return varied
    assert isinstance(layout, BoxLayout)
    return _with_regions(layout, varied, nutrient.regions, tissue)


def _with_regions(
    layout: BoxLayout, varied: FloatArray | None, regions: Mapping[str, Region], tissue: float
) -> FloatArray:
    """Return the coefficients with regions, of which the later ones lie in the earlier ones."""
    resistance = layout.filled(1.0) if varied is None else 1.0 / varied
    for region in regions.values():
        share = covered(layout.box, region)
        resistance = (1.0 - share) * resistance + share * (tissue / region.diffusion)
    return np.asarray(1.0 / resistance)


def covered(box: Box, region: Region) -> FloatArray:
    """Return the part of each node that lies in a region."""
    share = np.ones(box.shape)
    for k, ends in enumerate((region.x, region.y, region.z)):
        if ends is None:
            continue
        edges = box.origin[k] + box.spacing * np.arange(box.shape[k] + 1)
        inside = np.clip(edges, *ends)
        along = np.diff(inside) / box.spacing
        shape = [1, 1, 1]
        shape[k] = box.shape[k]
        share = share * along.reshape(shape)
    return share


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
