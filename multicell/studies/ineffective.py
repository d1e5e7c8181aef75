"""Keys that have no effect in a scene: to vary them would be to run the same thing again.

The rules are of keys that studies usually vary; a study of any other key without effect runs, and
shows that nothing depends on it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from multicell.errors import SceneError
from multicell.integrators.registry import METHODS

if TYPE_CHECKING:
    from multicell.scene.scene import Scene

Reason = Callable[..., str]
"""Says why a key has no effect in a scene, or nothing where it has one. It gets the scene, and the
names that stand for the stars of the rule's key."""


def no_effect(scene: Scene, key: str) -> str:
    """Return why a key has no effect in a scene, in words; nothing where it may have one.

    The reason follows from the other keys alone; whether a run ever gets to where a key matters is
    for the run to show.
    """
    for pattern, reason in _RULES:
        match = pattern.fullmatch(key)
        if match is not None:
            return reason(scene, *match.groups())
    return ""


def refuse_ineffective(
    scenes: Iterable[tuple[Mapping[str, Any], Scene]], keys: Sequence[str]
) -> None:
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


def _if(condition: Any, reason: str) -> str:
    """Return a reason where a condition holds, else nothing."""
    return reason if condition else ""


def _integrator_step(scene: Scene) -> str:
    """Say that a method chooses its steps."""
    info = METHODS.get(scene.integrator.method)
    chooses = info is not None and info.control != "step"
    return _if(chooses, f"the method {scene.integrator.method!r} chooses its steps")


def _integrator_setting(scene: Scene, name: str) -> str:
    """Say that a method does not have a setting."""
    info = METHODS.get(scene.integrator.method)
    absent = info is not None and name != "method" and name not in info.settings
    return _if(absent, f"the method {scene.integrator.method!r} has no {name}")


def _necrosis(scene: Scene) -> str:
    """Say that no cell starves."""
    starve = any(
        field.necrosis is not None or field.necrosis_above is not None
        for field in scene.nutrients.values()
    )
    starve |= scene.energy is not None and scene.energy.necrosis is not None
    return _if(not starve, "neither a nutrient nor ATP has a threshold of necrosis")


def _apoptosis(scene: Scene) -> str:
    assert scene.death is not None
    none = scene.death.apoptosis_rate == 0.0 and not scene.radiation
    return _if(none, "death.apoptosis_rate is 0, and no cell is irradiated")


def _swelling(scene: Scene) -> str:
    assert scene.death is not None
    none = scene.death.swelling == 1.0
    return _necrosis(scene) or _if(none, "dead cells do not swell (death.swelling = 1)")


def _boundary(scene: Scene, field: str) -> str:
    nutrient = scene.nutrients[field]
    scheduled = nutrient.media and nutrient.media[0][0] <= 0.0 and nutrient.finite_medium is None
    return _if(scheduled, "'media' says what the medium is from the start on")


def _cycle(s: Any) -> str:
    return _if(s.growth.phases, "the phases of the cycle say how long it lasts")


def _no_phases(s: Any) -> str:
    return _if(not s.growth.phases, "the cycle has no phases")


def _one_cell(s: Any) -> str:
    return _if(s.initial.count == 1, "there is one cell at the start")


def _steady(s: Any, field: str) -> str:
    return _if(s.nutrients[field].regime == "steady", "the field is steady")


def _no_oxygen(s: Any, name: str) -> str:
    return _if(not s.radiation[name].oxygen, f"radiation.{name} names no field of oxygen")


_KEYS: Final[Mapping[str, Reason]] = {
    "growth.cycle_time": _cycle,
    "growth.cycle_variation": _cycle,
    "growth.division": _no_phases,
    "growth.restriction": _no_phases,
    "growth.phases.*.variation": lambda s, name: _if(
        s.growth.phases[name].distribution == "fixed", "the phase has a fixed duration"
    ),
    "coupling_tolerance": lambda s: _if(s.coupling_step != "auto", "coupling_step is not 'auto'"),
    "integrator.step": _integrator_step,
    "integrator.*": _integrator_setting,
    "cells.young": lambda s: _if(
        s.types and all(kind.young is not None for kind in s.types.values()),
        "every type of cell has a Young's modulus of its own",
    ),
    "contact.surface_energy": lambda s: _if(
        any(kind.surface_energy for kind in s.types.values()),
        "every pair of types has a surface energy of its own",
    ),
    "radiation.*.oer": _no_oxygen,
    "radiation.*.half_oxygen": _no_oxygen,
    "initial.spacing": _one_cell,
    "initial.jitter": _one_cell,
    "death.necrosis_rate": _necrosis,
    "death.swelling": _necrosis,
    "death.lysis_time": _necrosis,
    "death.swelling_time": _swelling,
    "death.apoptosis_time": _apoptosis,
    "death.removal_fraction": lambda s: _apoptosis(s) and _necrosis(s) and "no cell ever dies",
    "nutrients.*.temperature": lambda s, field: (
        "the concentrations of the scene are in mM already; it only converts pressures"
    ),
    "nutrients.*.boundary": _boundary,
    "nutrients.*.time_tolerance": _steady,
    "nutrients.*.initial": _steady,
    "nutrients.*.half_saturation": lambda s, field: _if(
        not s.nutrients[field].takes_up, f"the uptake of {field} is 0"
    ),
}

_RULES: Final = [
    (re.compile(r"([^.]+)".join(map(re.escape, key.split("*")))), reason)
    for key, reason in _KEYS.items()
]
