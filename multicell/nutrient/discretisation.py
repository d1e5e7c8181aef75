"""What a field's grid costs in accuracy."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from multicell.nutrient.field import NutrientField
from multicell.nutrient.grid import ShellLayout

if TYPE_CHECKING:
    from multicell.cells import Cells, FloatArray
    from multicell.nutrient.parameters import FieldParameters


_LEAST_RATIO = 1.5
"""Ratio of two spacings below which their solutions say nothing on the error."""


def discretisation_error(
    field: NutrientField,
    parameters: FieldParameters,
    cells: Cells,
    capacity: FloatArray,
    production: FloatArray | None,
    time: float,
) -> float | None:
    """Estimate the error of a steady field at the cells that its spacing makes.

    The field is solved for the cells as they are with its own spacing h and about twice that,
    H. The scheme is of second order: the error is |c_h - c_H| / ((H/h)² - 1) (Richardson). The
    field itself is not changed. Cells are points that take up: in cubes smaller than they are the
    concentration where they sit falls without end as h falls, which is no error of the grid's
    and which the estimate knows of in part only.

    - ``field``: solved already; its last solution is the first guess

    Returns float or None: the largest error at any cell, mM; None without cells, for a transient
    field, and where the grid is too small to be made coarser.
    """
    if parameters.regime != "steady" or len(cells) == 0:
        return None
    geometry = "radial" if isinstance(field.layout, ShellLayout) else "box"
    # a field that chose cubes for itself may have a side of shells, which cubes do not
    sides = parameters.nutrient.sides
    there = {face: x for face, x in sides.items() if face != "r+" or geometry == "radial"}
    nutrient = replace(parameters.nutrient, geometry=geometry, sides=there)
    found = []
    for factor in (1.0, 2.0):
        spacing = factor * field.layout.spacing
        trial = NutrientField(field.name, replace(parameters, nutrient=nutrient, spacing=spacing))
        trial.well_mixed = field.well_mixed
        trial.restore(field.field())
        trial.solve(cells.position, capacity, production=production, radius=cells.radius, time=time)
        found.append((trial.layout.spacing, trial.sample(cells.position)))
    (fine, close), (coarse, far) = found
    ratio = coarse / fine
    if ratio < _LEAST_RATIO:
        return None
    return float(np.abs(close - far).max() / (ratio**2 - 1.0))
