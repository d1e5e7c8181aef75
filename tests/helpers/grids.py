"""Diffusion on grids of py-pde's, with conditions said in any of its ways."""

from dataclasses import replace

from multicell.nutrient.diffusion import Diffusion
from multicell.nutrient.equations.grid import conditions_on, layout_on
from multicell.nutrient.operators import linearised


def diffusion(grid, coefficient, sides, *, height=None, varied=None):
    layout = layout_on(grid)
    box = layout.box if height is None else replace(layout.box, height=height)
    return Diffusion(box, coefficient, conditions_on(layout, sides), varied=varied)


def divergence(operator, c):
    """Return D L c in mM/s, boundary values included."""
    return operator.brought() - linearised(operator, c, 0.0 * c)
