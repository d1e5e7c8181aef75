"""Which fields of a scene are solved for together, since they react with each other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from multicell.nutrient.group import FieldGroup
from multicell.nutrient.reactions.kinetics import kinetics_of
from multicell.scene.checks import check_own
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
    fields: Mapping[str, NutrientField], order: list[str], reactions: Mapping[str, Any]
) -> list[FieldGroup]:
    """Return the fields in the groups that are solved for together, in an order of the fields."""
    joined = groups(fields, reactions)
    found = []
    for name in order:
        names = next((group for group in joined if name in group), None)
        if names is None:
            found.append(fields[name].group)
        elif name == names[0]:
            own = {n: r for n, r in reactions.items() if r.fields[0] in names}
            members = {member: fields[member] for member in names}
            found.append(FieldGroup(members, kinetics_of(names, own)))
    return found
