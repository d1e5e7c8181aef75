"""Tension of the tissue's surface, which presses on its rim and closes the holes in it.

The continuum surface force (J. U. Brackbill, D. B. Kothe & C. Zemach, J. Comput. Phys. 100, 1992,
335). The part of space that cells fill, over that in the tissue, is a density c: 1 in tissue and 0
in medium and in holes. It is smoothed over about a cell; then

    f = γ κ ∇c,    κ = -∇·(∇c / |∇c|)

is a force per volume whose integral across the surface is Laplace's pressure, γ times the sum of
both principal curvatures. Cells stand on one side of the surface only, and carry all of it.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Final

import numpy as np

from multicell.cells import Cells, FloatArray, IntArray
from multicell.errors import StepFailed
from multicell.vectors import corners, cubes, lengths, weighted_mean

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan

_SMOOTHING: Final = 2.0
"""Standard deviation of the smoothing, in spacings of the grid: a cell's diameter."""
_FADED: Final = 0.1
"""Part of the steepest slope of c below which there is no surface."""
_INNER: Final = 0.9
"""Part of the cells that have less tissue round them than is taken for c = 1."""
_MARGIN: Final = 4
"""Diameters of medium round the tissue that the grid holds."""
_MOST_NODES: Final = 10**8
"""Of the grid, which then takes some 10 GB: a ball of 10⁷ cells has a third of it."""
_FURTHEST: Final = 3.0
"""Diameters that a cell may move while the force is held: beyond, it has crossed the surface.

Cells of a ball that settles under its tension move by 1.3 in the first step.
"""


def check_surface_held(cells: Cells, position: FloatArray, time: float) -> None:
    """Raise StepFailed where a force that is held for a step has moved a cell too far.

    - ``cells``: at ``time`` in s, when the step begins
    - ``position``, (n, 3) µm: at its end
    """
    ratio = lengths(position - cells.position) / (2.0 * cells.radius)
    if (furthest := float(ratio.max(initial=0.0))) > _FURTHEST:
        cell = int(np.argmax(ratio))
        problem = (
            f"it has moved {furthest:.3g} diameters in a coupling step, in which the force of the "
            "tissue's surface is held"
        )
        hint = "Take a shorter coupling_step, or a lower surface.tension."
        raise StepFailed(time, problem, hint, int(cells.id[cell]))


def surface_force(plan: BiologyPlan, cells: Cells, time: float = 0.0) -> FloatArray | None:
    """Return the force of the surface on each cell, (n, 3) nN, or None; they add up to zero.

    Raises StepFailed, with ``time`` in s, where cells are too far apart for its grid.
    """
    if plan.surface_tension == 0.0 or len(cells) < 2:
        return None
    from scipy.ndimage import gaussian_filter, map_coordinates

    volume = cells.volume
    diameter = 2.0 * np.cbrt(weighted_mean(cubes(cells.radius), volume))
    spacing = diameter / _SMOOTHING
    low = corners(cells.position)[0] - _MARGIN * diameter
    at = (cells.position - low) / spacing
    shape = np.ceil(at.max(axis=0)).astype(int) + int(_MARGIN * _SMOOTHING)
    if (nodes := float(np.prod(shape, dtype=float))) > _MOST_NODES:
        wide = " x ".join(f"{x:.0f}" for x in (shape * spacing).tolist())
        problem = f"the surface of cells over {wide} um needs a grid of {nodes:.3g} nodes"
        hint = (
            f"At most {_MOST_NODES:,} are allowed: bring the cells together, or leave out surface."
        )
        raise StepFailed(time, problem, hint)
    density = gaussian_filter(_spread(at, volume, shape), _SMOOTHING, mode="constant")
    density /= spacing**3
    # of cells at the surface and in holes less than half is tissue
    filled = float(np.quantile(map_coordinates(density, at.T, order=1), _INNER))
    slope = np.stack(np.gradient(density / filled, spacing))
    steepness = np.sqrt((slope**2).sum(axis=0))
    faded = _FADED * steepness.max()
    normal = slope / np.maximum(steepness, faded)
    curvature = -sum(np.gradient(normal[k], spacing, axis=k) for k in range(3))
    # single cells roughen the surface: a mean over it, where it is steep
    weight = steepness**2
    curvature = gaussian_filter(curvature * weight, 0.5 * _SMOOTHING)
    curvature /= np.maximum(gaussian_filter(weight, 0.5 * _SMOOTHING), faded**2)
    force = plan.surface_tension * np.where(steepness > faded, curvature, 0.0) * slope
    found = np.stack([map_coordinates(part, at.T, order=1) for part in force], axis=1)
    # half of the smoothed surface lies where there are no cells
    found *= (2.0 * volume / filled)[:, None]
    return np.asarray(found - volume[:, None] * (found.sum(axis=0) / volume.sum()))


def _spread(at: FloatArray, amount: FloatArray, shape: IntArray) -> FloatArray:
    """Return amounts at places (n, 3), in spacings, shared among the eight nodes round each."""
    lower = np.floor(at).astype(np.int64)
    upper = at - lower
    total = np.zeros(int(shape.prod()))
    for corner in product((0, 1), repeat=3):
        part = np.where(corner, upper, 1.0 - upper).prod(axis=1)
        node = np.ravel_multi_index(tuple((lower + corner).T), tuple(shape))
        total += np.bincount(node, amount * part, total.size)
    return total.reshape(shape)
