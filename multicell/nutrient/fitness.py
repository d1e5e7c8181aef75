"""Fit of all grids to the cells as they are, and its cost in accuracy."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from multicell.errors import NutrientFailed
from multicell.nutrient.cartesian import ROUND, departure
from multicell.nutrient.field import NutrientField
from multicell.nutrient.grid import ShellLayout, equivalent_ball_radius
from multicell.nutrient.tissue import drawn_in, drawn_to_ball
from multicell.scene import domain
from multicell.scene.scales import MAX_UNEVEN
from multicell.vectors import lengths, second_moments, weighted_mean

if TYPE_CHECKING:
    from multicell.cells import Cells, FloatArray
    from multicell.nutrient.fields import FieldSystem
    from multicell.nutrient.parameters import FieldParameters


def fitness(
    system: FieldSystem, cells: Cells, time: float
) -> tuple[dict[str, dict[str, Any]], list[str]]:
    """Return for each field what it lives on, and how well that fits the cells as they are.

    Returns fields : name -> dict: ``geometry`` (cubes, squares or shells), ``spacing`` (µm),
    ``discretisation_error`` at the cells (mM) where it is known, and for shells
    ``departure_from_a_ball``; notes: remarks on fields that do not fit.
    """
    fields: dict[str, dict[str, Any]] = {}
    notes: list[str] = []
    for name in system.order:
        field = system.fields[name]
        parameters = field.parameters
        shells = isinstance(field.layout, ShellLayout)
        kind = "shells" if shells else "squares" if parameters.dimensions == 2 else "cubes"
        fields[name] = {"geometry": kind, "spacing": field.layout.spacing}
        if field.well_mixed is not None:
            fields[name]["medium"] = field.well_mixed.concentration
        if parameters.nutrient.layer is not None and isinstance(field.layout, ShellLayout):
            _rate_layer(name, field.layout, parameters.nutrient.layer, cells, fields, notes)
        if parameters.domain is not None:
            finer = domain.finer(domain.sides(parameters.domain), parameters.spacing)
            notes += [f"The grid of {name} has a spacing of {finer}."] if finer else []
        notes += system.grid_remarks(name)
        capacity, production = system.demand(name, cells)
        about = field, parameters, cells, capacity, production, time
        try:
            error = None if system.reacts(name) else discretisation_error(*about)
        except NutrientFailed as trouble:
            notes.append(f"The error that the grid of {name} makes is not known: {trouble}")
            error = None
        if error is not None:
            fields[name]["discretisation_error"] = error
        if not shells:
            notes += _direction_notes(field, cells, field.level(time))
            continue
        departed = departure(cells.position, cells.radius)
        fields[name]["departure_from_a_ball"] = departed
        if departed > ROUND:
            notes.append(
                f"{name} lives on spherical shells, but the tissue departs from a ball by "
                f"{departed:.2g}, more than {ROUND:g}: "
                "geometry = 'auto' would go over to a grid of cubes."
            )
    return fields, notes


def _rate_layer(
    name: str,
    shells: ShellLayout,
    wanted: float,
    cells: Cells,
    fields: dict[str, dict[str, Any]],
    notes: list[str],
) -> None:
    """Say how thick the layer round the tissue is, and whether a stray cell made it thicker."""
    if len(cells) == 0:
        return
    drawn = drawn_to_ball(drawn_in(cells.position, cells.radius), cells.radius)
    found = shells.radius - equivalent_ball_radius(drawn, cells.radius)
    fields[name]["layer"] = found
    if found > wanted * (1.0 + 1e-9):
        notes.append(
            f"The tissue reaches farther from its middle than the layer of {name}: shells "
            f"reach to its end, and the layer is {found:.3g} um instead of {wanted:.3g} um."
        )


_AXIS, _DIAGONAL = 0.95, 0.5
"""Least largest component of a direction along an axis; least second one between axes."""

_MIN_CELLS = 10  # that are compared along axes, and between them


def _direction_notes(field: NutrientField, cells: Cells, level: float) -> list[str]:
    """Return a remark where round tissue finds more along the axes of its grid than between them.

    What is compared are means over the outermost cells, beyond their scatter.
    """
    axes, size = field.parameters.dimensions, len(cells)
    if field.parameters.domain is not None or size < 2 * _MIN_CELLS or not level > 0.0:
        return []
    away = cells.position - weighted_mean(cells.position, cells.volume)
    moments = second_moments(away, cells.volume)[:axes, :axes] / cells.volume.sum()
    roots = np.sqrt(np.linalg.eigvalsh(moments))
    if not roots[0] >= (1.0 - ROUND) * roots[-1] > 0.0:
        return []
    distance = lengths(away)
    surface = np.sqrt((axes + 2) / axes * np.trace(moments))
    outer = distance > surface - 2.0 * float(cells.radius.max())
    direction = np.sort(np.abs(away / np.maximum(distance, 1e-9)[:, None]), axis=1)
    found = field.sample(cells.position, cells.radius)
    along = found[outer & (direction[:, 2] > _AXIS)]
    between = found[outer & (direction[:, 1] > _DIAGONAL)]
    if min(len(along), len(between)) < _MIN_CELLS:
        return []
    scatter = np.sqrt(along.var() / len(along) + between.var() / len(between))
    uneven = abs(float(along.mean() - between.mean()))
    if uneven <= MAX_UNEVEN * level + 2.0 * scatter:
        return []
    remedy = f"with nutrients.{field.name}.margin_shape = 'tissue' the medium has no corners."
    if field.parameters.follows_tissue:
        remedy = "a smaller spacing makes less of it."
    elif not field.parameters.open_medium:
        remedy = "the medium begins at the sides of a box."
    return [
        f"{field.name} differs by {uneven / level:.1%} of the medium between the surface along the "
        f"axes of its grid and along the diagonals, though the tissue is round: {remedy}"
    ]


_SAFETY = 1.25
"""Factor of what is reported over Richardson's estimate (Roache 1994)."""

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

    The field is solved for the cells as they are with its own spacing h and about twice that, H.
    The scheme is of second order: the error is |c_h - c_H| / ((H/h)² - 1) (Richardson). On grids
    that do not resolve cells the contribution of a cell to its own concentration grows by less than
    that order, and its error counts where it is larger (:func:`_own_error`). A quarter more is
    reported (Roache 1994): where nodes lie for a cell makes up to that. The field itself is not
    changed.

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
        found.append((trial.layout.spacing, trial.sample(cells.position, cells.radius)))
    (fine, close), (coarse, far) = found
    ratio = coarse / fine
    if ratio < _LEAST_RATIO:
        return None
    error = float(np.abs(close - far).max() / (ratio**2 - 1.0))
    if geometry == "box":
        made = -field.uptake(cells.position, capacity, cells.radius)
        made += 0.0 if production is None else production
        error = max(error, _own_error(parameters, fine, cells.radius, np.abs(made)))
    return _SAFETY * error


def _own_error(
    parameters: FieldParameters, spacing: float, radius: FloatArray, made: FloatArray
) -> float:
    """Return the largest error of the cells' own concentrations, mM: ``made``, (n,) amol/s.

    Hat functions widen a ball along each axis by h²/6 of its second moment, so that it acts as one
    of the radius (r² + 5 h²/6)^(1/2), whose mean potential is 6/5 over that; a disc as one of the
    radius (r² + 2 h²/3)^(1/2).
    """
    diffusion, square = parameters.nutrient.diffusion, (spacing / radius) ** 2
    if parameters.dimensions == 2:
        lost = np.log1p(2.0 / 3.0 * square) / (4.0 * np.pi * diffusion * parameters.height)
    else:
        whole = 1.2 / (4.0 * np.pi * diffusion * radius)
        lost = whole * (1.0 - 1.0 / np.sqrt(1.0 + 5.0 / 6.0 * square))
    return float((made * lost).max())
