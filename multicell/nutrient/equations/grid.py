"""Which grids of py-pde's fields of cells live on, and where their nodes lie for the cells."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from pde.grids.cartesian import CartesianGrid
from pde.grids.spherical import SphericalSymGrid

from multicell.errors import SceneError
from multicell.nutrient.cartesian import Box
from multicell.nutrient.grid import BoxLayout, Layout, ShellLayout
from multicell.results.pde_fields import ball_grid, box_grid

if TYPE_CHECKING:
    from pde.grids.base import GridBase

_KINDS = ({"value"}, {"derivative"}, {"type", "value", "const"})
"""Keys of the conditions that the solvers' kernels know."""


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
    if any(grid.periodic):
        raise SceneError("grid", "is periodic, must have sides with conditions", hint)
    if not np.allclose(steps, steps[0], rtol=1e-9):
        raise SceneError("grid", f"has spacings that differ: {steps} um", hint)
    h = float(steps[0])
    low = [float(bounds[0]) for bounds in grid.axes_bounds]
    if grid.num_axes == 2:
        nx, ny = grid.shape
        return BoxLayout(Box((low[0], low[1], -0.5 * h), (nx, ny, 1), h, h))
    nx, ny, nz = grid.shape
    return BoxLayout(Box((low[0], low[1], low[2]), (nx, ny, nz), h))


def grid_on(layout: Layout) -> GridBase:
    """Return py-pde's grid with the nodes of a layout, in the coordinates of the cells."""
    if isinstance(layout, ShellLayout):
        return ball_grid(layout.spacing, layout.count)
    assert isinstance(layout, BoxLayout)
    box = layout.box
    return box_grid(box.origin, box.shape, box.spacing, flat=box.height is not None)


def conditions_on(layout: Layout, given: Any) -> dict[str, Any]:
    """Return a condition for every side of a box, or the one on the surface of a ball.

    - ``given``: a concentration, one condition in py-pde's terms, or a mapping of sides to
      conditions, with ``"x"`` for both sides of an axis and ``"*"`` for all others; arrays of a
      side's nodes where it differs over a side of a box
    """
    if not isinstance(given, Mapping):
        given = {"value": given}
    if given.keys() & {"value", "derivative", "type"}:
        given = {"*": given}
    if isinstance(layout, ShellLayout):
        return _side(given, "r+", ())
    assert isinstance(layout, BoxLayout)
    x, y, z = layout.shape
    axes = {"x": (y, z), "y": (x, z), "z": (x, y)}
    if layout.box.height is not None:
        del axes["z"]
    return {
        axis + end: _side(given, axis + end, shape) for axis, shape in axes.items() for end in "-+"
    }


def _side(given: Mapping[str, Any], face: str, shape: tuple[int, ...]) -> dict[str, Any]:
    """Return the condition on a side with nodes of a shape."""
    keys = [key for key in (face, face[0], "*") if key in given]
    if not keys:
        problem = f"say nothing of the side {face!r}"
        raise SceneError("conditions", problem, "'*' stands for all others")
    condition = given[keys[0]]
    known = isinstance(condition, Mapping) and set(condition) in _KINDS
    if not known or condition.get("type", "mixed") != "mixed":
        hint = "Take a value, a derivative, or a mixed condition, of numbers or arrays of them."
        raise SceneError("conditions", f"have {condition!r} on the side {face!r}", hint)
    varies = {"const"} if "type" in condition else {"value", "derivative"}
    return {
        key: x if key == "type" else _numbers(x, shape if key in varies else ())
        for key, x in condition.items()
    }


def _numbers(given: Any, shape: tuple[int, ...]) -> Any:
    """Return a float, or an array of as many as a side has nodes."""
    if isinstance(given, float) and math.isfinite(given):
        return given
    try:
        value = np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        value = np.array(np.nan)
    if not np.isfinite(value).all() or (value.ndim and value.size != math.prod(shape)):
        expected = f"or {math.prod(shape)} of them" if shape else "the same all over the side"
        raise SceneError("conditions", f"have {given!r}, expected a finite number, {expected}")
    return value.reshape(shape) if value.ndim else float(value)
