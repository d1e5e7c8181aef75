"""How well the grids of all fields fit the cells as they are."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from multicell.errors import NutrientFailed
from multicell.nutrient.cartesian import departure
from multicell.nutrient.discretisation import discretisation_error
from multicell.nutrient.grid import ShellLayout, tissue_radius
from multicell.nutrient.tissue import drawn_in, drawn_to_ball

if TYPE_CHECKING:
    from multicell.cells import Cells
    from multicell.nutrient.fields import Feeding


def fitness(
    feeding: Feeding, cells: Cells, time: float
) -> tuple[dict[str, dict[str, Any]], list[str]]:
    """Return for each field what it lives on, and how well that fits the cells as they are.

    Returns fields : name -> dict: ``geometry`` (cubes, squares or shells), ``spacing`` (µm),
    ``discretisation_error`` at the cells (mM) where it is known, and for shells
    ``departure_from_a_ball``; notes: remarks on fields that do not fit.
    """
    fields: dict[str, dict[str, Any]] = {}
    notes: list[str] = []
    for name in feeding.order:
        field = feeding.fields[name]
        parameters = field.parameters
        shells = isinstance(field.layout, ShellLayout)
        kind = "shells" if shells else "squares" if parameters.dimensions == 2 else "cubes"
        fields[name] = {"geometry": kind, "spacing": field.layout.spacing}
        if field.well_mixed is not None:
            fields[name]["medium"] = field.well_mixed.concentration
        if parameters.nutrient.layer is not None and isinstance(field.layout, ShellLayout):
            _rate_layer(name, field.layout, parameters.nutrient.layer, cells, fields, notes)
        notes += feeding.grid_remarks(name)
        capacity, production = feeding.demand_now(name, cells)
        about = field, parameters, cells, capacity, production, time
        try:
            error = None if feeding.reacts(name) else discretisation_error(*about)
        except NutrientFailed as trouble:
            notes.append(f"The error that the grid of {name} makes is not known: {trouble}")
            error = None
        if error is not None:
            fields[name]["discretisation_error"] = error
        if not shells:
            continue
        departed = departure(cells.position, cells.radius)
        fields[name]["departure_from_a_ball"] = departed
        limit = parameters.nutrient.roundness_limit
        if departed > limit:
            notes.append(
                f"{name} lives on spherical shells, but the tissue departs from a ball by "
                f"{departed:.2g}, more than roundness_limit = {limit:g}: "
                "geometry = 'auto' would go over to a grid of cubes."
            )
    return fields, notes


def _rate_layer(
    name: str, shells: ShellLayout, wanted: float, cells: Cells,
    fields: dict[str, dict[str, Any]], notes: list[str],
) -> None:  # fmt: skip
    """Say how thick the layer round the tissue is, and whether a stray cell made it thicker."""
    if len(cells) == 0:
        return
    drawn = drawn_to_ball(drawn_in(cells.position, cells.radius), cells.radius)
    found = shells.radius - tissue_radius(drawn, cells.radius)
    fields[name]["layer"] = found
    if found > wanted * (1.0 + 1e-9):
        notes.append(
            f"The tissue reaches farther from its middle than the layer of {name}: shells "
            f"reach to its end, and the layer is {found:.3g} um instead of {wanted:.3g} um."
        )
