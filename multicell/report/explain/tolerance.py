"""What is chosen for fields with a tolerance, for the cells at the start, and at what cost."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, Final

from multicell.biology.initial import initial_cells
from multicell.errors import NutrientFailed, SceneError
from multicell.nutrient.choosing.choice import CHANGED
from multicell.nutrient.fields import Feeding
from multicell.scene import domain as box
from multicell.scene.start import separate
from multicell.scene.start_checks import positions

if TYPE_CHECKING:
    from multicell.nutrient.choosing.choice import Choice, Fit
    from multicell.nutrient.choosing.grids import Grids
    from multicell.scene.scene import Scene


_MOST_CELLS: Final = 5000
_MOST_NODES: Final = 40_000
"""Cells, and nodes of all fields with the usual spacing, up to which explain tries grids."""


def _nodes(scene: Scene) -> float:
    """Return about how many nodes the fields of a scene have at the start, squares or cubes."""
    radius = scene.cells.division_radius
    across = (
        2.0
        * radius
        * max(scene.initial.spacing, 1.0)
        * scene.initial.count ** (1.0 if scene.initial.shape == "row" else 1.0 / scene.dimensions)
    )
    if scene.initial.cells is not None:
        places = positions(scene.initial.cells.given)
        across = max(across, float((places.max(axis=0) - places.min(axis=0)).max()))
    total = 0.0
    for nutrient in scene.nutrients.values():
        lengths = [across + 2.0 * max(nutrient.margin, nutrient.layer or 0.0)] * scene.dimensions
        if scene.box is not None:
            lengths = box.sides(scene.box)
        total += math.prod(length / (nutrient.spacing or radius) for length in lengths)
    return float(total / 2**scene.dimensions)


@lru_cache(maxsize=1)
def _start_grids(scene: Scene) -> Grids:
    """Return the choices at the start of a scene: its fields are solved for as in a run."""
    feeding, cells = Feeding(scene), separate(scene, initial_cells(scene))
    box.check_start(scene, cells)
    feeding.begin(cells, 0.0)
    return feeding.grids


def choice_words(scene: Scene, name: str) -> list[str]:
    """Return what a field is solved as and on, why, and what other grids would take.

    Where that takes long, or no grid reaches the tolerance, they say so.
    """
    tolerance, flat = scene.nutrients[name].tolerance, scene.dimensions == 2
    if scene.initial.count > _MOST_CELLS or _nodes(scene) > _MOST_NODES:
        words = f"regime and grid chosen by the tolerance of {tolerance:g} mM at the start of a run"
        return [f"{words}: to try that for cells and margin of this size takes longer than a look"]
    try:
        grids = _start_grids(scene)
    except (SceneError, NutrientFailed) as trouble:
        return [f"regime and grid by the tolerance of {tolerance:g} mM cannot be chosen: {trouble}"]
    chooser, choice = grids.choosers[name], grids.choices[name]
    others = [fit for fit in chooser.fits if fit.geometry != choice.geometry]
    return [
        _regime(scene, name, choice, chooser.lagged),
        f"{_grid(choice.geometry, choice.spacing, flat)}: an estimated error of "
        f"{choice.error:.2g} mM, within the tolerance of {tolerance:g} mM, "
        f"for {choice.nodes:,} nodes and {choice.iterations} iterations a solve",
        *(f"instead of {_other(fit, flat)}" for fit in others),
        f"looked at again when cells, medium or content have changed by {100 * CHANGED:g} %",
    ]


def _regime(scene: Scene, name: str, choice: Choice, lagged: float | None) -> str:
    word = "steady" if choice.steady else "transient"
    if lagged is None:
        free = scene.nutrients[name].regime == "auto"
        return f"{word} ({'nothing fixes its level' if free else 'as the scene says'})"
    return f"{word} ({lagged:.2g} mM off its steady state one coupling step after the start)"


def _grid(geometry: str, spacing: float, flat: bool) -> str:
    kind = "squares" if flat else {"radial": "spherical shells", "box": "cubes"}[geometry]
    return f"{kind} of {spacing:.3g} um"


def _other(fit: Fit, flat: bool) -> str:
    words = f"{_grid(fit.geometry, fit.spacing, flat)} with {fit.trial.nodes:,} nodes"
    return f"{words} and an estimated error of {fit.error:.2g} mM"
