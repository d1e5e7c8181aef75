"""Checks of the cells at the start, before anything is run."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from multicell.errors import NutrientFailed, SceneError
from multicell.scene.scales import MAX_NODES, largest_spacing
from multicell.scene.sizes import division_radii
from multicell.scene.start_table import positions

if TYPE_CHECKING:
    from multicell.cells import Cells
    from multicell.nutrient.grid import Layout
    from multicell.scene.scene import Scene

_MOST: Final = 200_000  # cells: to place them takes half a second


def check_population(scene: Scene) -> None:
    """Raise ``SceneError`` where a run would end at its first moment.

    Motions that name no cell, a domain too small for its cells, a grid of too many nodes, a finite
    medium smaller than its grid, first concentrations that are none, releases at the start that
    have no place. The cells are placed only where one of these is in doubt, and not
    where they are so many that this takes seconds: then the run finds out.
    """
    if scene.initial.count > _MOST or not _in_doubt(scene):
        return
    from multicell.biology.driven import named_at_start
    from multicell.biology.initial import initial_cells
    from multicell.biology.plan import biology_plan
    from multicell.nutrient.balance import volume_beyond_grid
    from multicell.nutrient.tissue import Tissue
    from multicell.scene.domain import check_start
    from multicell.simulation.machinery import fields_of

    cells, plan = initial_cells(scene), biology_plan(scene)
    check_start(scene, cells)
    named_at_start(plan, cells)
    tissue = Tissue(cells.position, cells.radius)
    for name, field in fields_of(scene, None, 1, plan).fields.items():
        key = "spacing"
        try:
            layout = field.lay(tissue)[0]
            key = "finite_medium.volume"
            if scene.nutrients[name].finite_medium is not None:
                volume_beyond_grid(name, scene.nutrients[name], layout.whole)
            key = "initial_formula"
            field.first_values(layout, 0.0)
        except NutrientFailed as failure:
            path = f"nutrients.{name}.{key}"
            raise SceneError(path, failure.problem, f"{failure.hint}.") from None
        _check_releases(scene, name, layout, cells)


def _check_releases(scene: Scene, name: str, layout: Layout, cells: Cells) -> None:
    """Raise ``SceneError`` for a release at the start that has no place there."""
    for key, release in scene.nutrients[name].release.items():
        path = f"nutrients.{name}.release.{key}"
        if release.time > 0.0:
            continue
        if release.type and not (cells.kind == list(scene.types).index(release.type)).any():
            problem = f"is {release.type!r}, of which there is no cell at the start"
            raise SceneError(f"{path}.type", problem, "Give it a fraction, or release it later.")
        if release.place is None:
            continue
        try:
            layout.scatter(np.array([release.place]), np.ones(1), np.array([release.radius]))
        except ValueError:
            problem = f"is {list(release.place)} um, outside the grid at the start"
            raise SceneError(f"{path}.place", problem, "Widen margin, or give a domain.") from None


def _in_doubt(scene: Scene) -> bool:
    """Return whether the cells must be placed to know that all is well."""
    open_fields = {} if scene.box is not None else scene.nutrients
    finite = any(field.finite_medium is not None for field in open_fields.values())
    walls = scene.domain is not None and scene.domain.stiffness is None
    begun = any(
        field.initial_formula or any(release.time <= 0.0 for release in field.release.values())
        for field in scene.nutrients.values()
    )
    if scene.motions or walls or finite or begun:
        return True
    if not open_fields:
        return False
    axes, n, start = scene.dimensions, scene.initial.count, scene.initial
    if start.cells is not None:
        places = positions(start.cells.given)
        reach = 2.0 * float(np.abs(places).max())
    else:  # what a packing reaches at most, and six standard deviations of a shift on both sides
        across = n if start.shape == "row" else 2.0 * (n ** (1.0 / axes) + 2.0)
        reach = 2.0 * division_radii(scene)[1] * (across * start.spacing + 12.0 * start.jitter)
    widest = {name: reach + 2.0 * max(f.margin, f.layer or 0.0) for name, f in open_fields.items()}
    nodes = (width / largest_spacing(scene, name) for name, width in widest.items())
    return any(along**axes > 0.1 * MAX_NODES for along in nodes)
