"""Keys that have no effect in a scene: to vary them would be to run the same thing again."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from multicell.errors import SceneError
from multicell.integrators.registry import METHODS

if TYPE_CHECKING:
    from multicell.scene.scene import Scene

Reason = Callable[["Scene", tuple[str, ...]], str]
"""Says why a key has no effect in a scene, or nothing where it has one; the tuple holds the names
that stand for the stars of the rule's key."""


def no_effect(scene: Scene, key: str) -> str:
    """Return why a key has no effect in a scene, in words; nothing where it may have one.

    What is told is what follows from the other keys alone; whether a run ever gets to where a key
    matters is for the run to show.
    """
    for pattern, reason in _RULES:
        match = pattern.fullmatch(key)
        if match is not None:
            return reason(scene, match.groups())
    return ""


def refuse_needless(scenes: Iterable[tuple[Mapping[str, Any], Scene]], keys: Sequence[str]) -> None:
    """Refuse keys that have no effect in a scene, or in some of several.

    Parameters
    ----------
    scenes
        What sets each of them apart (key -> value), and the scene.
    keys
        What is varied.

    Raises
    ------
    SceneError
        With the key, the reason, and where only some of the scenes are concerned in which.
    """
    found: dict[str, tuple[str, Mapping[str, Any]]] = {}
    effective = set()
    for changes, scene in scenes:
        for key in keys:
            reason = no_effect(scene, key)
            if reason:
                found.setdefault(key, (reason, changes))
            else:
                effective.add(key)
    for key, (reason, changes) in found.items():
        others = {name: value for name, value in changes.items() if name != key}
        if key not in effective or not others:
            raise SceneError(key, f"has no effect: {reason}", "Nothing would differ between runs.")
        where = ", ".join(f"{name} = {value!r}" for name, value in others.items())
        hint = "Vary it in a study of its own, or list the points that make sense."
        raise SceneError(key, f"has no effect where {where}: {reason}", hint)


def _phases(scene: Scene, names: tuple[str, ...]) -> str:
    assert scene.growth is not None
    return "the phases of the cycle say how long it lasts" if scene.growth.phases else ""


def _no_target(scene: Scene, names: tuple[str, ...]) -> str:
    assert scene.growth is not None
    return "" if scene.growth.target is not None else f"the law is {scene.growth.law!r}"


def _no_phases(scene: Scene, names: tuple[str, ...]) -> str:
    assert scene.growth is not None
    return "" if scene.growth.phases else "the cycle has no phases"


def _variation(scene: Scene, names: tuple[str, ...]) -> str:
    assert scene.growth is not None
    return "the phase has a fixed duration" if _fixed(scene, names) == "fixed" else ""


def _shift(scene: Scene, names: tuple[str, ...]) -> str:
    kind = _fixed(scene, names)
    return "" if kind == "shifted-gamma" else f"the duration of the phase is {kind!r}"


def _fixed(scene: Scene, names: tuple[str, ...]) -> str:
    assert scene.growth is not None
    return scene.growth.phases[names[0]].distribution


def _fixed_coupling(scene: Scene, names: tuple[str, ...]) -> str:
    return "" if scene.coupling_step == "auto" else "coupling_step is not 'auto'"


def _controlled(scene: Scene, names: tuple[str, ...]) -> str:
    """Say that a method chooses its steps."""
    info = METHODS.get(scene.integrator.method)
    if info is None or info.control == "step":
        return ""
    return f"the method {scene.integrator.method!r} chooses its steps"


def _no_setting(scene: Scene, names: tuple[str, ...]) -> str:
    """Say that a method does not have a setting."""
    info = METHODS.get(scene.integrator.method)
    if info is None or names[0] == "method" or names[0] in info.settings:
        return ""
    return f"the method {scene.integrator.method!r} has no {names[0]}"


def _own_young(scene: Scene, names: tuple[str, ...]) -> str:
    kinds = scene.types.values()
    own = kinds and all(kind.young is not None for kind in kinds)
    return "every type of cell has a Young's modulus of its own" if own else ""


def _own_energies(scene: Scene, names: tuple[str, ...]) -> str:
    own = any(kind.surface_energy for kind in scene.types.values())
    return "every pair of types has a surface energy of its own" if own else ""


def _told(scene: Scene, names: tuple[str, ...]) -> str:
    """Say that the table of the cells tells at which stage they are."""
    if scene.initial.cells is None:
        return ""
    told = scene.initial.cells.given.columns.keys()
    phases = scene.growth is not None and bool(scene.growth.phases)
    if phases and "phase" in told:
        return "the table gives the progress of each cell" if "progress" in told else ""
    known = [name for name in ("radius", "age") if name in told]
    return f"the table gives the {known[0]} of each cell" if known else ""


def _one_cell(scene: Scene, names: tuple[str, ...]) -> str:
    return "there is one cell at the start" if scene.initial.count == 1 else ""


def _one_type(scene: Scene, names: tuple[str, ...]) -> str:
    return "all cells are of this type" if len(scene.types) == 1 else ""


def _no_fields(scene: Scene, names: tuple[str, ...]) -> str:
    return "" if scene.nutrients else "the scene has no nutrients"


def _no_necrosis(scene: Scene, names: tuple[str, ...]) -> str:
    starve = any(
        field.necrosis is not None or field.necrosis_above is not None
        for field in scene.nutrients.values()
    )
    starve |= scene.energy is not None and scene.energy.necrosis is not None
    return "" if starve else "neither a nutrient nor ATP has a threshold of necrosis"


def _no_swelling(scene: Scene, names: tuple[str, ...]) -> str:
    assert scene.death is not None
    return _no_necrosis(scene, names) or (
        "dead cells do not swell (death.swelling = 1)" if scene.death.swelling == 1.0 else ""
    )


def _no_apoptosis(scene: Scene, names: tuple[str, ...]) -> str:
    assert scene.death is not None
    return "death.apoptosis_rate is 0" if scene.death.apoptosis_rate == 0.0 else ""


def _no_death(scene: Scene, names: tuple[str, ...]) -> str:
    return _no_apoptosis(scene, names) and _no_necrosis(scene, names) and "no cell ever dies"


def _temperature(scene: Scene, names: tuple[str, ...]) -> str:
    return "the concentrations of the scene are in mM already; it only converts pressures"


def _media_from_start(scene: Scene, names: tuple[str, ...]) -> str:
    field = scene.nutrients[names[0]]
    if not field.media or field.media[0][0] > 0.0 or field.finite_medium is not None:
        return ""
    return "'media' says what the medium is from the start on"


def _no_media(scene: Scene, names: tuple[str, ...]) -> str:
    return "" if scene.nutrients[names[0]].media else "the medium has no schedule 'media'"


def _steady(scene: Scene, names: tuple[str, ...]) -> str:
    return "the field is steady" if scene.nutrients[names[0]].regime == "steady" else ""


def _no_uptake(scene: Scene, names: tuple[str, ...]) -> str:
    field = scene.nutrients[names[0]]
    return "" if field.takes_up else f"the uptake of {names[0]} is 0"


def _no_dependence(scene: Scene, names: tuple[str, ...]) -> str:
    effect = scene.nutrients[names[0]].uptake_on[names[1]].effect
    return "the effect is 0" if effect == 0.0 else ""


def _layout(scene: Scene, names: tuple[str, ...]) -> str:
    layout = scene.nutrients[names[0]].layout
    return "" if layout == "auto" else f"the geometry of the field is {layout!r}"


def _margin(scene: Scene, names: tuple[str, ...]) -> str:
    if scene.domain is not None:
        return "fields fill the domain"
    return "" if scene.nutrients[names[0]].layer is None else "'layer' says how far the grid goes"


def _solid(scene: Scene, names: tuple[str, ...]) -> str:
    return "" if scene.dimensions == 2 else "the scene has 3 dimensions"


def _landscape(*meant: str) -> Reason:
    def reason(scene: Scene, names: tuple[str, ...]) -> str:
        assert scene.haptotaxis is not None
        found = scene.haptotaxis.landscape
        return "" if found in meant else f"the landscape is {found!r}"

    return reason


def _pattern(key: str) -> re.Pattern[str]:
    return re.compile(r"([^.]+)".join(map(re.escape, key.split("*"))))


_KEYS: Final[Mapping[str, Reason]] = {
    "growth.cycle_time": _phases,
    "growth.cycle_variation": _phases,
    "growth.division": _no_phases,
    "growth.target": _no_target,
    "growth.restriction": _no_phases,
    "growth.phases.*.variation": _variation,
    "growth.phases.*.shift": _shift,
    "coupling_tolerance": _fixed_coupling,
    "integrator.step": _controlled,
    "integrator.*": _no_setting,
    "cells.young": _own_young,
    "contact.surface_energy": _own_energies,
    "initial.stage": _told,
    "initial.spacing": _one_cell,
    "initial.jitter": _one_cell,
    "types.*.fraction": _one_type,
    "types.*.uptake_scale": _no_fields,
    "types.*.secretion_scale": _no_fields,
    "death.necrosis_rate": _no_necrosis,
    "death.swelling": _no_necrosis,
    "death.lysis_time": _no_necrosis,
    "death.swelling_time": _no_swelling,
    "death.apoptosis_time": _no_apoptosis,
    "death.removal_fraction": _no_death,
    "nutrients.*.temperature": _temperature,
    "nutrients.*.boundary": _media_from_start,
    "nutrients.*.media_change": _no_media,
    "nutrients.*.finite_medium.replaced": _no_media,
    "nutrients.*.time_tolerance": _steady,
    "nutrients.*.initial": _steady,
    "nutrients.*.half_saturation": _no_uptake,
    "nutrients.*.uptake_on.*.half": _no_dependence,
    "nutrients.*.roundness_limit": _layout,
    "nutrients.*.margin": _margin,
    "nutrients.*.height": _solid,
    "haptotaxis.axis": _landscape("gradient", "stripes"),
    "haptotaxis.length": _landscape("stripes", "spot"),
}

_RULES: Final = [(_pattern(key), reason) for key, reason in _KEYS.items()]
