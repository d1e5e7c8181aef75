"""Networks inside the cells of a scene, in words."""

from __future__ import annotations

import math

from multicell.behaviours.catalogue import value_around
from multicell.report.explain.cost import network_cost
from multicell.scene.conditions import conditions
from multicell.scene.networks import flux_of
from multicell.scene.scene import Scene
from multicell.scene.steps import longest_coupling_step


def network_words(scene: Scene, name: str) -> str:
    """Return states, inputs, outputs and units of a network, its fastest rate and its cost."""
    part = scene.networks[name]
    model, whom = part.model, f"cells of type {part.cells}" if part.cells else "all cells"
    words = [f"in {whom}", f"states {_listed(model.states)}"]
    if part.inputs:
        words.append("inputs " + ", ".join(f"{x} = {y}" for x, y in part.inputs.items()))
    fixed = [x for x in model.inputs if x not in (part.inputs or {})]
    if fixed:
        words.append(f"inputs that stay as they are: {_listed(fixed)}")
    for field in part.fluxes or ():
        what, rate = flux_of(part, field)
        words.append(f"{what} of {field} at the rate {rate}")
    used = sorted(x for x in _read(scene) if value_around(x).startswith(f"{name}."))
    if used:
        words.append(f"read as {', '.join(used)}")
    elif not part.fluxes:
        words.append("nothing reads it")
    if model.events:
        words.append(f"events {_listed([event.name for event in model.events])}")
    if model.time_unit is None and part.time_unit is None:
        words.append("it states no unit of time: seconds are taken")
    bare = [x for x in part.inputs or () if not part.unit_of(x)]
    if bare:
        words.append(f"no unit of {_listed(bare)} is stated: base units of the scene are taken")
    words.append(_stiffness(scene, name))
    count, seconds = network_cost(scene, name)
    if not math.isnan(count):
        words.append(
            f"about {count:,.3g} evaluations a cell and coupling step, {1e6 * seconds:.2g} µs"
            + (" without events" if model.events else "")
        )
    control = f"tolerance {part.tolerance:g}" if part.step is None else f"steps of {part.step:g} s"
    return "; ".join([*words, f"solved by {part.method}, {control}"])


def _read(scene: Scene) -> set[str]:
    """Return the signals that responses, networks and the starts of phases read."""
    found = {x for response in scene.responses.values() for x in response.signals}
    found |= {x for part in scene.networks.values() for x in (part.inputs or {}).values()}
    return found | {condition.signal for condition in conditions(scene)}


def _listed(names: tuple[str, ...] | list[str], most: int = 12) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _stiffness(scene: Scene, name: str) -> str:
    """Return the shortest time scale at the start beside the coupling step, in words."""
    from multicell.networks.conformance import fastest_rate

    part = scene.networks[name]
    rate = fastest_rate(part.model) / part.seconds()
    if not rate > 0.0:
        return "nothing changes at the start"
    step = longest_coupling_step(scene)
    return f"fastest time scale at the start {1.0 / rate:.3g} s of {step:g} s a step"
