"""Which grids of py-pde's fields of cells live on, and where their nodes lie for the cells."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from pde.grids.cartesian import CartesianGrid
from pde.grids.spherical import SphericalSymGrid

from multicell.errors import SceneError
from multicell.nutrient.cartesian import Box
from multicell.nutrient.grid import BoxLayout, Layout, ShellLayout

if TYPE_CHECKING:
    from pde.grids.base import GridBase


def layout_on(grid: GridBase, *, height: float | None = None) -> Layout:
    """Return where nodes of a grid of py-pde's lie for cells.

    Parameters
    ----------
    grid
        ``CartesianGrid`` in two or three dimensions, or ``SphericalSymGrid`` round the origin.
    height : float, µm, optional
        Of the layer that a plane stands for; absent: one spacing.

    Raises
    ------
    SceneError
        For other grids, periodic ones, a hollow ball, and spacings that differ between axes.
    """
    hint = "Cubes, squares and balls of shells are what fields of cells live on."
    steps = grid.discretization
    if isinstance(grid, SphericalSymGrid):
        if grid.axes_bounds[0][0] != 0.0:
            raise SceneError("grid", "is a hollow ball, must reach to its centre", hint)
        return ShellLayout(np.zeros(3), float(steps[0]), grid.shape[0])
    if not isinstance(grid, CartesianGrid) or grid.num_axes not in (2, 3):
        problem = f"is {type(grid).__name__} with {grid.num_axes} axes"
        raise SceneError("grid", f"{problem}, which cells have no place in", hint)
    if any(grid.periodic):
        raise SceneError("grid", "is periodic, must have sides with conditions", hint)
    if not np.allclose(steps, steps[0], rtol=1e-9):
        raise SceneError("grid", f"has spacings that differ: {steps} um", hint)
    h = float(steps[0])
    low = [float(bounds[0]) for bounds in grid.axes_bounds]
    if grid.num_axes == 2:
        nx, ny = grid.shape
        return BoxLayout(Box((low[0], low[1], -0.5 * h), (nx, ny, 1), h, height or h))
    nx, ny, nz = grid.shape
    return BoxLayout(Box((low[0], low[1], low[2]), (nx, ny, nz), h))
