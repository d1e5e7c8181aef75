"""Keys that have no effect in a scene: to vary them would be to run the same thing again.

The rules are of keys that studies usually vary; a study of any other key without effect runs, and
shows that nothing depends on it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final

from multicell.errors import SceneError
from multicell.integrators.registry import METHODS
from multicell.scene.responses import effects
from multicell.scene.scene import Scene

Rule = tuple[Callable[..., Any], str]
"""What holds where a key has no effect, and that in words. Both get the scene, and the names that
stand for the stars of the key."""


def no_effect(scene: Scene, key: str) -> str:
    """Return why a key has no effect in a scene, in words; nothing where it may have one.

    The reason follows from the other keys alone; whether a run ever gets to where a key matters is
    for the run to show.
    """
    for pattern, rules in _PATTERNS:
        match = pattern.fullmatch(key)
        if match is not None:
            holding = (words for holds, words in rules if holds(scene, *match.groups()))
            return next(holding, "").format(*match.groups(), method=scene.integrator.method)
    return ""


def refuse_ineffective(
    scenes: Iterable[tuple[Mapping[str, Any], Scene]], keys: Sequence[str]
) -> None:
    """Refuse keys that have no effect in a scene, or in some of several.

    - ``scenes``: what sets each of them apart (key -> value), and the scene
    - ``keys``: what is varied
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


def _controlled(scene: Scene) -> bool:
    """Return whether a known method chooses its steps."""
    info = METHODS.get(scene.integrator.method)
    return info is not None and info.control != "step"


def _lacks(scene: Scene, name: str) -> bool:
    """Return whether a known method does not have a setting."""
    info = METHODS.get(scene.integrator.method)
    return info is not None and name != "method" and name not in info.settings


def _responds(scene: Scene, behaviour: str) -> bool:
    """Return whether anything changes a behaviour."""
    return any(effect.behaviour == behaviour for effect in effects(scene))


def _never_starves(scene: Scene) -> bool:
    """Return whether no cell can become necrotic."""
    return not (_responds(scene, "necrosis rate") or _responds(scene, "damage rate"))


def _never_by_apoptosis(scene: Scene) -> bool:
    """Return whether no cell dies by apoptosis."""
    assert scene.death is not None
    constant = scene.death.apoptosis_rate > 0.0 or bool(scene.radiation)
    return not (constant or _responds(scene, "apoptosis rate"))


def _scheduled(scene: Scene, field: str) -> bool:
    """Return whether the medium of a field is given from the start on."""
    media, finite = scene.nutrients[field].media, scene.nutrients[field].finite_medium
    return bool(media) and media[0][0] <= 0.0 and finite is None  # type: ignore[index]


_CYCLE: Final[Rule] = (lambda s: s.growth.phases, "the phases of the cycle say how long it lasts")
_PHASES: Final[Rule] = (lambda s: not s.growth.phases, "the cycle has no phases")
_ALONE: Final[Rule] = (lambda s: s.initial.count == 1, "there is one cell at the start")
_STEADY: Final[Rule] = (lambda s, f: s.nutrients[f].regime == "steady", "the field is steady")
_NO_OXYGEN: Final[Rule] = (
    lambda s, name: not s.radiation[name].oxygen, "radiation.{0} names no field of oxygen"
)  # fmt: skip
_NECROSIS: Final[Rule] = (
    _never_starves, "neither a nutrient nor ATP has a threshold of necrosis"
)  # fmt: skip
_NO_DAMAGE: Final[Rule] = (
    lambda s: not _responds(s, "damage rate"),
    "death.damage_time is absent, and nothing responds with a damage rate",
)  # fmt: skip
_KEYS: Final[Mapping[str, Sequence[Rule]]] = {
    "growth.cycle_time": [_CYCLE],
    "growth.cycle_variation": [_CYCLE],
    "growth.division": [_PHASES],
    "growth.restriction": [_PHASES],
    "growth.phases.*.variation": [
        (lambda s, name: s.growth.phases[name].distribution == "fixed",
         "the phase has a fixed duration"),
    ],
    "integrator.step": [(_controlled, "the method {method!r} chooses its steps")],
    "integrator.*": [(_lacks, "the method {method!r} has no {0}")],
    "cells.young": [
        (lambda s: s.types and all(kind.young is not None for kind in s.types.values()),
         "every type of cell has a Young's modulus of its own"),
    ],
    "contact.surface_energy": [
        (lambda s: any(kind.surface_energy for kind in s.types.values()),
         "every pair of types has a surface energy of its own"),
    ],
    "radiation.*.oer": [_NO_OXYGEN],
    "radiation.*.half_oxygen": [_NO_OXYGEN],
    "initial.shape": [_ALONE],
    "initial.spacing": [_ALONE],
    "initial.jitter": [_ALONE],
    "death.necrosis_rate": [_NECROSIS],
    "death.damage_time": [_NECROSIS],
    "death.damage_repair_time": [_NO_DAMAGE],
    "death.damage_variation": [_NO_DAMAGE],
    "death.swelling": [_NECROSIS],
    "death.core": [_NECROSIS],
    "death.lysis_time": [
        _NECROSIS,
        (lambda s: s.death.core == "fluid", "what necrotic cells lose stays as fluid (death.core)"),
    ],
    "death.swelling_time": [
        _NECROSIS,
        (lambda s: s.death.swelling == 1.0, "dead cells do not swell (death.swelling = 1)"),
    ],
    "death.apoptosis_time": [
        (_never_by_apoptosis, "death.apoptosis_rate is 0, and no cell is irradiated"),
    ],
    "death.removal_fraction": [
        (lambda s: _never_by_apoptosis(s) and _never_starves(s), "no cell ever dies"),
    ],
    "death.inflow": [
        (lambda s: _never_by_apoptosis(s) and _never_starves(s), "no cell ever dies"),
    ],
    "nutrients.*.temperature": [
        (lambda s, field: True,
         "the concentrations of the scene are in mM already; it only converts pressures"),
    ],
    "nutrients.*.boundary": [
        (_scheduled, "'media' says what the medium is from the start on"),
    ],
    "nutrients.*.time_tolerance": [_STEADY],
    "nutrients.*.initial": [_STEADY],
    "nutrients.*.half_saturation": [
        (lambda s, field: not s.nutrients[field].takes_up, "the uptake of {0} is 0"),
    ],
}  # fmt: skip
_PATTERNS: Final = [
    (re.compile(r"([^.]+)".join(map(re.escape, key.split("*")))), rules)
    for key, rules in _KEYS.items()
]
