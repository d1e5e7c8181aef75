"""Check whether reactions fit the fields of a scene."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from multicell.errors import SceneError
from multicell.scene.checks import FIELD, check_names
from multicell.scene.reactions import groups
from multicell.scene.scales import level_fixed, spacing
from multicell.schema import near_miss

if TYPE_CHECKING:
    from multicell.scene.reactions import Joining
    from multicell.scene.scene import Scene

_SHARED = (
    "margin",
    "roundness_limit",
    "layer",
    "height",
    "initial",
)
"""Keys of fields that are the same for all that react with each other, as grid and geometry are."""


def check_reactions(scene: Scene) -> None:
    """Raise ``SceneError`` for reactions that do not fit the fields of the scene."""
    for name, reaction in scene.reactions.items():
        for key in ("consumes", "produces", "activated_by", "inhibited_by"):
            check_names(getattr(reaction, key), scene.nutrients, f"reactions.{name}.{key}", FIELD)
    _check_groups(scene, scene.reactions)


def check_own(scene: Scene, reactions: Mapping[str, Any]) -> None:
    """Raise ``SceneError`` for reactions of the user's own that do not fit the scene's fields."""
    for name, reaction in reactions.items():
        path = f"reactions.{name}"
        if name in scene.reactions:
            raise SceneError(path, "is a reaction of the scene already", "Give it another name.")
        for field in reaction.fields:
            if field not in scene.nutrients:
                problem = f"depends on {field}, which is not {FIELD}"
                raise SceneError(path, problem, near_miss(field, scene.nutrients))
    _check_groups(scene, {**scene.reactions, **reactions})


def _check_groups(scene: Scene, reactions: Mapping[str, Joining]) -> None:
    """Check the fields that react with each other, group by group."""
    for group in groups(scene.nutrients, reactions):
        _check_grid(scene, group)
        _check_regime(scene, group)
        _check_dependences(scene, group)


def _check_grid(scene: Scene, group: list[str]) -> None:
    """Check that fields which react with each other live on one grid."""
    first = group[0]
    for name in group:
        nutrient = scene.nutrients[name]
        keys: dict[str, tuple[Any, Any]] = {
            key: (getattr(nutrient, key), getattr(scene.nutrients[first], key)) for key in _SHARED
        }
        keys["geometry"] = nutrient.layout, scene.nutrients[first].layout
        keys["spacing"] = spacing(scene, name), spacing(scene, first)
        for key, (own, other) in keys.items():
            if own != other:
                shown = [x if isinstance(x, str) or x is None else f"{x:g}" for x in (own, other)]
                problem = f"is {shown[0]}, but that of {first} is {shown[1]}, with which it reacts"
                hint = (
                    "Fields that react with each other share one grid: give them the same "
                    f"spacing, geometry and {', '.join(_SHARED)}."
                )
                raise SceneError(f"nutrients.{name}.{key}", problem, hint)


def _check_regime(scene: Scene, group: list[str]) -> None:
    """Check that fields which react with each other are all steady or all transient."""
    given = {scene.nutrients[name].regime: name for name in group}
    if "steady" not in given:
        return
    if "transient" in given:
        problem = f"is 'steady', but {given['transient']}, with which it reacts, is 'transient'"
        raise SceneError(f"nutrients.{given['steady']}.regime", problem, "Make both the same.")
    for name in group:
        if not level_fixed(scene.nutrients[name], scene.dimensions):
            problem = f"is 'steady', but nothing fixes the level of {name}, with which it reacts"
            hint = "Let them be 'transient', or give a side a value, a perfusion or a decay."
            raise SceneError(f"nutrients.{given['steady']}.regime", problem, hint)


def _check_dependences(scene: Scene, group: list[str]) -> None:
    """Check that fields which react do not depend on each other through the cells as well."""
    for name in group:
        for key in ("uptake_on", "secretion_from"):
            for other in getattr(scene.nutrients[name], key) or ():
                if other in group:
                    problem = f"is a field that {name} reacts with, directly or over others"
                    hint = "Both are solved for together, and neither is known before the other."
                    raise SceneError(f"nutrients.{name}.{key}.{other}", problem, hint)
