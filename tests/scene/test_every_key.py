"""Every key of every part changes a run that uses it, or its declaration says why not."""

from functools import lru_cache

import pytest
from key_trials import bases, declared, digest, keys_of, others

from multicell.errors import SceneError, StepFailed
from multicell.scene.scene import Scene
from multicell.studies.keys import no_effect

EXPLAINED = {
    "title": "one line about the scene",
    "nutrients.*.temperature": "become concentrations",
}
"""Keys that change no run, and where their declarations say so."""

ALONE = {"dimensions": "plane"}
"""Keys that other parts tie to their values, and the scene in which they are free."""

TOGETHER = {"growth.law": {"growth.parameters": None, "growth.phases.G2.target_scale": None}}
"""Keys that can change only with others, and how these change: those of one law go with it."""

OWN = (
    "initial.cells.",
    "networks.",
    "nutrients.*.initial_file.",
    "output.observables.",
    "responses.*.parameters",
)
"""Keys for files and code of users: test_start_table, test_inside, test_initial_files,
test_own_observable, test_responses."""

BASES = dict(bases())
ALWAYS = ("2D, hertz", "stop", "chosen steps", "plane", "drifting")
"""Scenes of which all keys are tried each time."""


@lru_cache(maxsize=1)
def own(base):
    return digest(Scene.from_dict(BASES[base]))


def holds(scene, key):
    """Return whether a scene states a key."""
    part = scene.to_dict()
    for name in key.split("."):
        part = part.get(name) if isinstance(part, dict) else None
    return part is not None


def changes(base, pattern, path, value, spec):
    """Return whether another value of a key changes the run of a scene."""
    scene = Scene.from_dict(BASES[base])
    for other in others(pattern, value, spec):
        try:
            further = {key: x for key, x in TOGETHER.get(pattern, {}).items() if holds(scene, key)}
            if digest(scene.with_changes({path: other, **further})) != own(base):
                return True
        except (SceneError, StepFailed):
            continue  # the scene cannot be with this value
    return False


def explained(base, pattern, path, spec):
    if pattern in EXPLAINED:
        return EXPLAINED[pattern] in spec.doc
    return no_effect(Scene.from_dict(BASES[base]), path) != ""


def idle(base, keys):
    """Return the keys of a scene that change nothing, and are not said to change nothing."""
    return [
        path
        for pattern, path, value, spec in keys
        if ALONE.get(pattern, base) == base
        and not explained(base, pattern, path, spec)
        and not changes(base, pattern, path, value, spec)
    ]


def test_every_declared_key_is_stated_by_a_scene():
    stated = {pattern for entries in BASES.values() for pattern, *_ in keys_of(entries)}
    missing = set(declared()) - stated - {*EXPLAINED}
    assert [key for key in sorted(missing) if not key.startswith(OWN)] == []


@pytest.mark.parametrize("base", [*ALWAYS[:-1], pytest.param(ALWAYS[-1], marks=pytest.mark.slow)])
def test_every_key_acts(base):
    assert idle(base, keys_of(BASES[base])) == []


@pytest.mark.slow
@pytest.mark.harness
@pytest.mark.parametrize("base", [name for name in BASES if name not in ALWAYS])
def test_keys_of_other_scenes_act(base, request):
    """As many as the option --keys asks for, others for each --first-seed."""
    count, first = (request.config.getoption(name) for name in ("--keys", "--first-seed"))
    if count == 0:
        pytest.skip("runs where --keys asks for it")
    keys = list(keys_of(BASES[base]))
    step = max(len(keys) // count, 1)
    assert idle(base, keys[first % step :: step]) == []


def test_a_key_without_effect_is_seen(monkeypatch):
    """Without the part that reads it a key changes nothing: nobody dies in this scene."""
    entries = {**BASES["stop"], "death": {"lysis_time": "2 h"}}
    monkeypatch.setitem(BASES, "idle", entries)
    keys = [key for key in keys_of(entries) if key[0] == "death.lysis_time"]
    assert idle("idle", keys) == ["death.lysis_time"]
