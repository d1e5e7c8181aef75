"""Scenes: reading, checking, changing, writing."""

from __future__ import annotations

import os
import pickle
from pathlib import Path

import pytest

from multicell.contact.hertz import Hertz
from multicell.contact.jkr import JKR
from multicell.errors import SceneError
from multicell.scene.nutrient import Nutrient
from multicell.scene.parts import Growth
from multicell.scene.scene import Scene, load_scene, scene_names


def refusal(entries):
    """Return the error that a scene of these entries causes."""
    with pytest.raises(SceneError) as caught:
        Scene.from_dict({"duration": 3600, **entries})
    assert caught.value.exit_code == 2
    return caught.value


# --- built-in scenes ---------------------------------------------------------------------------


def test_built_in_scenes_have_titles():
    titles = {load_scene(name).title for name in scene_names()}
    assert len(titles) == len(scene_names()) > 20
    assert all(len(title) > 10 for title in titles)


# --- files -------------------------------------------------------------------------------------


def test_file_is_read(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text('duration = "2 h"\nintegrator = "euler"\n[drag]\nviscosity = "70 Pa s"\n')
    scene = load_scene(file)
    assert (scene.duration, scene.integrator.method, scene.drag.viscosity) == (7200, "euler", 0.07)
    assert load_scene(str(file)) == scene


def test_bare_name_of_a_file_is_read_and_a_built_in_name_wins(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("mine").write_text("duration = 1")
    Path("settle").write_text("duration = 2")
    assert load_scene("mine").duration == 1
    assert load_scene("settle").duration == 3600
    assert load_scene(Path("settle")).duration == 2


def test_missing_file(tmp_path):
    with pytest.raises(SceneError, match=r"absent.toml' does not exist.*growth, .*settle.*sphe"):
        load_scene(str(tmp_path / "absent.toml"))


@pytest.mark.parametrize("name", ["spherod", "Spheroid", "spheroids"])
def test_unknown_name_gets_its_near_miss(name):
    with pytest.raises(SceneError, match=f"no scene named '{name}'") as caught:
        load_scene(name)
    assert caught.value.hint.startswith("Did you mean 'spheroid'?")
    assert "settle" in caught.value.hint


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b'duration = "1 h"\n\n[drag\n', "line 3"),
        (b"seed = " + b"9" * 5000, "not valid TOML"),
        (b"seed = " + b"[" * 100000, "nested too deeply"),
        (b"title = '\xff'", "not UTF-8"),
        (b"", "duration: is missing"),
        (b"duration = 1\n[drag]\nviscosity = 0\n", "drag.viscosity: is 0 kPa s, must be above 0"),
    ],
)
def test_broken_file(tmp_path, content, words):
    file = tmp_path / "broken.toml"
    file.write_bytes(content)
    with pytest.raises(SceneError) as caught:
        load_scene(file)
    assert words in str(caught.value)


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root reads anything")
def test_unreadable_file(tmp_path):
    file = tmp_path / "secret.toml"
    file.write_text("duration = 1")
    file.chmod(0)
    with pytest.raises(SceneError, match="cannot be read: Permission denied"):
        load_scene(file)


# --- bad values --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("entries", "path", "words"),
    [
        ({"seed": 2**63}, "seed", "at most"),
        ({"cells": {"poisson": 0.75}}, "cells.poisson", "is 0.75, must be above -1 and at most"),
        ({"contact": {"law": "yukawa"}}, "contact.law", "must be one of 'hertz', 'jkr'"),
        (
            {"contact": {"law": "hertz", "surface_energy": 0.1}},
            "contact.surface_energy",
            "is not a known key here",
        ),
        ({"nutrients": {"2,3-DPG": {}}}, "nutrients", "letters, digits"),
        (
            {"nutrients": {"oxygen": {"necrosis": 0.02, "quiescence": 0.02}}},
            "nutrients.oxygen.necrosis",
            "thresholds in the wrong order",
        ),
        (
            {"nutrients": {"oxygen": {"spacing": "20.1 um"}}},
            "nutrients.oxygen.spacing",
            "must be at most 20 um (two diameters of a dividing cell): grid too coarse",
        ),
        (
            {"nutrients": {"o2": {"spacing": 9}}, "cells": {"division_radius": 2}},
            "nutrients.o2.spacing",
            "must be at most 8 um",
        ),
        ({"integrator": "rk99"}, "integrator.method", "is 'rk99', must be one of 'auto', 'cvode'"),
    ],
)
def test_bad_value(entries, path, words):
    error = refusal(entries)
    assert error.path == path
    assert words in error.problem


# --- changes -----------------------------------------------------------------------------------


def test_changes_make_a_new_scene():
    scene = load_scene("spheroid")
    other = scene.with_changes({"nutrients.oxygen.boundary": "0.05 mM", "duration": "8 d"})
    assert (other.nutrients["oxygen"].boundary, other.duration) == (0.05, 8 * 86400)
    assert scene == load_scene("spheroid")
    assert other.with_changes({}) == other


def test_optional_tables_come_and_go():
    scene = Scene(duration=1).with_changes({"growth.cycle_time": "20 h", "death": {}})
    assert scene.growth == Growth(cycle_time=72000)
    assert scene.death is not None
    bare = scene.with_changes({"growth": None, "death": None})
    assert bare == Scene(duration=1)
    needed = {"nutrients.oxygen.boundary": 0.1, "nutrients.oxygen.quiescence": 0.01}
    with_oxygen = bare.with_changes(needed)
    assert dict(with_oxygen.nutrients) == {"oxygen": Nutrient(boundary=0.1, quiescence=0.01)}
    assert with_oxygen.with_changes({"nutrients.oxygen": None}) == bare
    assert with_oxygen.with_changes({"nutrients": None}) == bare


def test_a_part_can_be_given_as_an_object():
    assert Scene(duration=1).with_changes({"contact": Hertz()}).contact == Hertz()


def test_bare_integrator_keeps_the_other_options():
    scene = Scene(duration=1, integrator={"step": 2, "rtol": 1e-4})
    changed = scene.with_changes({"integrator": "euler"}).integrator
    assert (changed.method, changed.step, changed.rtol) == ("euler", 2.0, 1e-4)
    assert Scene(duration=1, integrator="euler").integrator.method == "euler"


def test_new_law_drops_what_it_does_not_have():
    scene = Scene(duration=1, contact={"surface_energy": 0.3})
    assert scene.with_changes({"contact.law": "hertz"}).contact == Hertz()
    assert scene.with_changes({"contact.law": "jkr"}).contact == JKR(surface_energy=0.3)
    with pytest.raises(SceneError, match="surface_energy: is not a known key"):
        scene.with_changes({"contact.law": "hertz", "contact.surface_energy": 0.1})


def test_changes_leave_their_input_alone():
    oxygen = {"oxygen": {}}
    changes = {"nutrients": oxygen, "nutrients.oxygen.boundary": 0.2}
    assert Scene(duration=1).with_changes(changes).nutrients["oxygen"].boundary == 0.2
    assert oxygen == {"oxygen": {}}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"growht": None}, "Did you mean 'growth'?"),
        ({"death.lysis_time": None}, "cannot be removed: the scene has no 'death'"),
        ({"duration.x": 1}, "'duration' is a value, not a table"),
        ({"duration": None}, "duration: is missing"),
        ({"": 1}, "not a dotted key"),
        ({"cells..young": 1}, "not a dotted key"),
        ({3: 1}, "not a dotted key"),
    ],
)
def test_bad_change(changes, words):
    with pytest.raises(SceneError) as caught:
        Scene(duration=1).with_changes(changes)
    assert words in str(caught.value)


# --- writing -----------------------------------------------------------------------------------


def test_toml_names_units_seed_and_extra_facts():
    text = load_scene("spheroid").to_toml({"numpy": "2.4.6", "note": "two\nlines = 1 \u2028 µ"})
    head = text[: text.index("title =")]
    assert "# units: um, s, nN, amol" in head
    assert "# seed: 1\n" in head
    assert "# numpy: 2.4.6\n" in head
    assert all(line.startswith("#") for line in head.splitlines())


def test_scene_survives_pickle_and_hash():
    scene = load_scene("spheroid")
    assert pickle.loads(pickle.dumps(scene)) == scene
    assert hash(scene) == hash(load_scene("spheroid"))
