"""Check whether reactions fit the fields of a scene, and whether they keep them bounded."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from multicell.errors import SceneError
from multicell.scene import domain as box
from multicell.scene.reactions import groups
from multicell.scene.scales import (
    level_fixed,
    slowest,
    spacing,
    tissue_radius,
    touches_medium,
)
from multicell.schema import near_miss

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.scene.reactions import Reaction
    from multicell.scene.scene import Scene

_SHARED = ("margin", "roundness_limit", "layer", "height", "initial", "solver")
"""Keys of fields that are the same for all that react with each other, as grid and geometry are."""


def check_reactions(scene: Scene) -> None:
    """Raise ``SceneError`` for reactions that do not fit the fields of the scene."""
    for name, reaction in scene.reactions.items():
        _check_fields(scene, f"reactions.{name}", reaction)
    for group in groups(scene.nutrients, scene.reactions):
        _check_grid(scene, group)
        _check_regime(scene, group)
        _check_dependences(scene, group)
    if scene.reactions:
        refuse_growth(scene)


def check_own(scene: Scene, reactions: Mapping[str, Any]) -> None:
    """Raise ``SceneError`` for reactions of the user's own that do not fit the scene's fields."""
    for name, reaction in reactions.items():
        path = f"reactions.{name}"
        if name in scene.reactions:
            raise SceneError(path, "is a reaction of the scene already", "Give it another name.")
        for field in reaction.fields:
            if field not in scene.nutrients:
                problem = f"depends on {field}, which is not a field of this scene"
                raise SceneError(path, problem, near_miss(field, scene.nutrients))
    for group in groups(scene.nutrients, {**scene.reactions, **reactions}):
        _check_grid(scene, group)
        _check_regime(scene, group)
        _check_dependences(scene, group)


def _check_fields(scene: Scene, path: str, reaction: Reaction) -> None:
    for key in ("consumes", "produces", "activated_by", "inhibited_by"):
        for field in getattr(reaction, key) or ():
            if field not in scene.nutrients:
                problem = "is not a field of this scene"
                raise SceneError(
                    f"{path}.{key}.{field}", problem, near_miss(field, scene.nutrients)
                )


def _check_grid(scene: Scene, group: list[str]) -> None:
    """Check that fields which react with each other live on one grid."""
    first = group[0]
    for name in group:
        nutrient = scene.nutrients[name]
        if (nutrient.tolerance is None) != (scene.nutrients[first].tolerance is None):
            with_one, without = (name, first) if nutrient.tolerance is not None else (first, name)
            problem = f"is missing, but {with_one}, with which it reacts, has one"
            hint = (
                "Fields that react with each other share one grid: give each a tolerance, or none."
            )
            raise SceneError(f"nutrients.{without}.tolerance", problem, hint)
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


def refuse_growth(scene: Scene) -> None:
    """Raise ``SceneError`` for mass-action reactions that let a field grow without bound.

    Where weights w > 0 exist with which no reaction makes more than it uses, the sum of w c does
    not rise by them, and all is bounded; rates of kind 'hill' are bounded themselves. Without such
    weights the growth rate is the largest real part of the eigenvalues of the reactions' derivative
    at the highest concentrations of the media, less decay, perfusion, and what diffusion to the
    sides takes from the slowest mode: above zero, the scene is refused.
    """
    names = list(scene.nutrients)
    known = {name: r for name, r in scene.reactions.items() if r.kind != "hill" and r.order > 0}
    change = np.array([[r.changes.get(name, 0.0) for name in names] for r in known.values()])
    if not known or _bounded(change):
        return
    level = np.array([scene.nutrients[name].highest for name in names])
    derivative = _derivative(list(known.values()), names, change, level)
    losses = np.array([_loss(scene, name) for name in names])
    values, vectors = np.linalg.eig(derivative - np.diag(losses))
    worst = int(np.argmax(values.real))
    growth = float(values[worst].real)
    if not growth > 0.0:
        return
    making = np.where(change.max(axis=0) > 0.0, np.abs(vectors[:, worst]), 0.0)
    field = int(np.argmax(making))
    made = [name for name, row in zip(known, change, strict=True) if row[field] > 0.0]
    problem = (
        f"makes {names[field]} grow without bound: {growth:.3g} 1/s faster than decay, perfusion "
        f"and diffusion take it away (by a factor e in {1.0 / growth:.3g} s)"
    )
    hint = f"Lower its rate, give {names[field]} a decay, or use a rate of kind 'hill'."
    raise SceneError(f"reactions.{made[0]}", problem, hint)


def _bounded(change: FloatArray) -> bool:
    """Return whether some positive weights let no reaction, a row each, make more than it uses."""
    if (change.sum(axis=1) <= 0.0).all():
        return True
    from scipy.optimize import linprog

    count = change.shape[1]
    found = linprog(np.ones(count), A_ub=change, b_ub=np.zeros(len(change)), bounds=(1.0, None))
    return bool(found.status == 0)


def _derivative(
    reactions: list[Reaction], names: list[str], change: FloatArray, level: FloatArray
) -> FloatArray:
    """Return the derivative of mass-action rates at concentrations (mM), (n, n) 1/s."""
    found = np.zeros((len(names), len(names)))
    for reaction, made in zip(reactions, change, strict=True):
        powers = {names.index(name): n for name, n in (reaction.consumes or {}).items()}
        for j, n in powers.items():
            others = math.prod(level[k] ** m for k, m in powers.items() if k != j)
            found[:, j] += made * reaction.rate * others * n * level[j] ** (n - 1.0)
    return found


def _loss(scene: Scene, name: str) -> float:
    """Return what decay, perfusion and diffusion to the sides take of a field, 1/s."""
    nutrient = scene.nutrients[name]
    linear = nutrient.decay + nutrient.perfusion
    if not touches_medium(nutrient, scene.dimensions):
        return linear
    if scene.domain is not None:
        return linear + nutrient.diffusion / slowest(nutrient, box.sides(scene.domain)) ** 2
    beyond = nutrient.margin if nutrient.layer is None else nutrient.layer
    half = tissue_radius(scene) + beyond
    walls = [side for side in nutrient.sides.values() if side.type == "derivative"]
    if walls or nutrient.layout != "box":
        return linear + nutrient.diffusion * (0.5 * math.pi / half) ** 2
    return linear + scene.dimensions * nutrient.diffusion * (0.5 * math.pi / half) ** 2
