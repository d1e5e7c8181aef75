"""Diffusion on grids of py-pde's, with conditions said in any of its ways."""

from dataclasses import replace

from multicell.nutrient.diffusion import Diffusion
from multicell.nutrient.equations.grid import conditions_on, layout_on


def diffusion(grid, coefficient, sides, *, height=None, varied=None):
    layout = layout_on(grid)
    box = layout.box if height is None else replace(layout.box, height=height)
    return Diffusion(box, coefficient, conditions_on(layout, sides), varied=varied)
