"""Which fields of a scene are solved for together, since they react with each other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from multicell.nutrient.reactions.kinetics import kinetics_of
from multicell.nutrient.reactions.reacting import Reacting
from multicell.scene.reaction_checks import check_own
from multicell.scene.reactions import groups

if TYPE_CHECKING:
    from multicell.nutrient.field import NutrientField
    from multicell.nutrient.parameters import FieldParameters
    from multicell.scene.scene import Scene


def joined(
    scene: Scene, parameters: Mapping[str, FieldParameters], reactions: Mapping[str, Any]
) -> dict[str, FieldParameters]:
    """Return the parameters of fields that reactions of the user's own join."""
    check_own(scene, reactions)
    found: dict[str, FieldParameters] = {}
    for names in groups(scene.nutrients, {**scene.reactions, **reactions}):
        given = [scene.nutrients[name].regime for name in names]
        regime = next((x for x in given if x != "auto"), "transient")
        found |= {name: replace(parameters[name], regime=regime) for name in names}
    return found


def together(
    fields: Mapping[str, NutrientField], reactions: Mapping[str, Any]
) -> dict[str, Reacting]:
    """Return for each field that takes part in reactions those that are solved for together."""
    found: dict[str, Reacting] = {}
    for names in groups(fields, reactions):
        own = {n: r for n, r in reactions.items() if r.fields[0] in names}
        group = Reacting({name: fields[name] for name in names}, kinetics_of(names, own))
        found |= dict.fromkeys(names, group)
    return found
