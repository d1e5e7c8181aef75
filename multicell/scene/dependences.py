"""Dependences of a scene's parts: order of its fields, gradients, contacts that are counted."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from multicell.behaviours.catalogue import needs_contacts
from multicell.errors import SceneError
from multicell.scene.reactions import group_of

if TYPE_CHECKING:
    from multicell.scene.nutrient import Nutrient
    from multicell.scene.responses import Response
    from multicell.scene.scene import Scene


def followed(scene: Scene) -> tuple[str, ...]:
    """Return the fields whose gradients cells follow, in the order of the scene."""
    biased = "" if scene.motility is None else scene.motility.towards
    return tuple(name for name in scene.nutrients if name in scene.chemotaxis or name == biased)


def solving_order(
    nutrients: Mapping[str, Nutrient],
    reactions: Mapping[str, Any] | None = None,
    responses: Mapping[str, Response] | None = None,
) -> list[str]:
    """Return the names of the fields so that each comes after those that it depends on.

    Fields that react with each other come one after another, and so do those whose uptakes depend
    on each other.
    """
    from graphlib import CycleError, TopologicalSorter

    needs = _needs(nutrients, responses)
    known = circles(nutrients, reactions, responses)
    if reactions:
        for name in needs:
            group = [x for x in group_of(name, reactions) if x in needs]
            known[name] = group or known[name]
    first = {name: group[0] for name, group in known.items()}
    graph: dict[str, list[str]] = {head: [] for head in first.values()}
    for name, others in needs.items():
        outside = [x for x in others if x == name or first[x] != first[name]]
        graph[first[name]] += [first[x] for x in outside]
    try:
        return [name for head in TopologicalSorter(graph).static_order() for name in known[head]]
    except CycleError as error:
        circle = list(reversed(error.args[1]))
        problem = f"depends on itself: {' needs '.join(circle)}"
        hint = "Only uptakes may depend on each other; leave out the weakest dependence."
        raise SceneError(f"nutrients.{circle[0]}", problem, hint) from None


def circles(
    nutrients: Mapping[str, Nutrient],
    reactions: Mapping[str, Any] | None = None,
    responses: Mapping[str, Response] | None = None,
) -> dict[str, list[str]]:
    """Return for each field those with which its uptake depends on each other, itself included.

    Fields that react, or are secreted from each other, are in no circle that can be solved for.
    """
    needs = _needs(nutrients, responses)
    reached = {name: set(others) for name, others in needs.items()}
    for middle in needs:
        for found in reached.values():
            found |= reached[middle] if middle in found else set()
    joined = {x for reaction in (reactions or {}).values() for x in reaction.fields}
    known = {}
    for name in needs:
        circle = [x for x in needs if x == name or (x in reached[name] and name in reached[x])]
        inside = {x for y in circle for x in nutrients[y].secretion_from or ()} & set(circle)
        known[name] = [name] if inside or joined & set(circle) else circle
    return known


def _needs(
    nutrients: Mapping[str, Nutrient], responses: Mapping[str, Response] | None
) -> dict[str, list[str]]:
    needs = {
        name: [*nutrient.uptake_on, *(nutrient.secretion_from or ())]
        for name, nutrient in nutrients.items()
    }
    for part in (responses or {}).values():
        what, _, name = part.behaviour.partition(" of ")
        if what in ("uptake", "secretion") and name in needs:
            needs[name] += [signal for signal in part.signals if signal in nutrients]
    return needs


def counts_contacts(scene: Scene) -> bool:
    """Return whether anything asks for the pairs in contact; to find them costs a little."""
    several = len(scene.types) > 1 and scene.contact.acts
    if scene.contact.remembers or several or scene.pull is not None:
        return True
    named = {name for part in scene.responses.values() for name in part.signals}
    named |= {name for part in scene.networks.values() for name in (part.inputs or {}).values()}
    named |= set() if scene.growth is None else scene.growth.signals
    return any(map(needs_contacts, named))
