"""Where diffusion is not that of tissue: medium between the cells, gels and membranes.

A node's coefficient is the harmonic mean over its volume of what lies in it, and the flow between
two nodes meets the resistance of half of each. So resistances across a layer add up as they should
wherever its faces lie, also where it is thinner than a node.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from multicell.cells import FloatArray
from multicell.nutrient.grid import BoxLayout, Layout, relative_diffusion

if TYPE_CHECKING:
    from multicell.nutrient.cartesian import Box
    from multicell.scene.nutrient import Nutrient, Region


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
