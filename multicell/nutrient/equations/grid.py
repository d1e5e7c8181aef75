"""Grids of py-pde for the fields of cells, and the place of their nodes among the cells."""

from __future__ import annotations

import math
from collections.abc import Mapping
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np
from pde.grids.cartesian import CartesianGrid
from pde.grids.spherical import SphericalSymGrid

from multicell.errors import SceneError
from multicell.nutrient.cartesian import Box
from multicell.nutrient.grid import BoxLayout, Layout, ShellLayout
from multicell.results.pde_fields import box_grid, shell_grid

if TYPE_CHECKING:
    from pde.grids.base import GridBase


def layout_on(grid: GridBase) -> Layout:
    """Return where nodes of a grid of py-pde's lie for cells; a plane is one spacing high.

    - ``grid``: ``CartesianGrid`` in two or three dimensions, or ``SphericalSymGrid`` round the
      origin
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
    if not np.allclose(steps, steps[0], rtol=1e-9):
        raise SceneError("grid", f"has spacings that differ: {steps} um", hint)
    h = float(steps[0])
    low = [float(bounds[0]) for bounds in grid.axes_bounds]
    if grid.num_axes == 2:
        nx, ny = grid.shape
        x, y = grid.periodic
        return BoxLayout(Box((low[0], low[1], -0.5 * h), (nx, ny, 1), h, h, (x, y, False)))
    nx, ny, nz = grid.shape
    x, y, z = grid.periodic
    return BoxLayout(Box((low[0], low[1], low[2]), (nx, ny, nz), h, None, (x, y, z)))


def grid_on(layout: Layout) -> GridBase:
    """Return py-pde's grid with the nodes of a layout, in the coordinates of the cells."""
    if isinstance(layout, ShellLayout):
        return shell_grid(layout.spacing, layout.count)
    assert isinstance(layout, BoxLayout)
    box = layout.box
    flat = box.height is not None
    return box_grid(box.origin, box.shape, box.spacing, flat=flat, repeats=box.repeats)


def nodes_on(layout: Layout) -> tuple[int, ...]:
    """Return the shape that py-pde's grid of a layout has, without making it."""
    flat = isinstance(layout, BoxLayout) and layout.box.height is not None
    return layout.shape[:2] if flat else layout.shape


def conditions_on(layout: Layout, given: Any) -> dict[str, Any]:
    """Return a condition for every side of a box, or the one on the surface of a ball.

    - ``given``: a concentration, one condition in py-pde's terms, or a mapping of sides to
      conditions, with ``"x"`` for both sides of an axis and ``"*"`` for all others
    """
    if not isinstance(given, Mapping):
        given = {"value": given}
    if given.keys() & {"value", "derivative"}:
        given = {"*": given}
    if isinstance(layout, ShellLayout):
        return _side(given, "r+")
    assert isinstance(layout, BoxLayout)
    axes = "xyz" if layout.box.height is None else "xy"
    # where space repeats there is no side, and nothing flows over it that does not come back
    return {
        axis + end: {"derivative": 0.0} if repeats else _side(given, axis + end)
        for axis, repeats in zip(axes, layout.box.repeats, strict=False)
        for end in "-+"
    }


def _side(given: Mapping[str, Any], face: str) -> dict[str, float]:
    """Return the condition on a side: its value, or its derivative along the outward normal."""
    keys = [key for key in (face, face[0], "*") if key in given]
    if not keys:
        problem = f"say nothing of the side {face!r}"
        raise SceneError("conditions", problem, "'*' stands for all others")
    condition = given[keys[0]]
    if not isinstance(condition, Mapping) or set(condition) not in ({"value"}, {"derivative"}):
        hint = "Take a value or a derivative."
        raise SceneError("conditions", f"have {condition!r} on the side {face!r}", hint)
    ((kind, number),) = condition.items()
    if not isinstance(number, Real) or not math.isfinite(number):
        raise SceneError("conditions", f"have {number!r}, expected a finite number")
    return {kind: float(number)}
