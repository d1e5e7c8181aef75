"""Scenes printed, copied to edit, and runs that say how to go on."""

import json

import pytest
from click.testing import CliRunner

import multicell as mc
from multicell.cli.main import main


def call(*arguments):
    return CliRunner().invoke(main, [str(a) for a in arguments])


@pytest.mark.parametrize("name", mc.scene_names())
def test_printed_and_copied_scenes_are_the_scene(name, tmp_path):
    scene = mc.load_scene(name)
    for full in ([], ["--full"]):
        shown = call("scenes", name, "--show", *full)
        assert shown.exit_code == 0
        path = tmp_path / f"shown{len(full)}.toml"
        path.write_text(shown.output, encoding="utf-8")
        assert mc.load_scene(path) == scene
        copied = call("init", name, "-o", tmp_path / f"copy{len(full)}.toml", *full)
        assert copied.exit_code == 0
        assert mc.load_scene(tmp_path / f"copy{len(full)}.toml") == scene
    assert json.loads(call("scenes", name, "--json").output)["duration"] == scene.duration


def test_a_full_scene_names_units_of_what_was_left_out():
    assert "viscosity = 5.0  # kPa s" in call("scenes", "spheroid", "--full").output


def test_what_cannot_be_printed_or_copied(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    nameless = call("scenes", "--show")
    assert nameless.exit_code == 2
    assert "need the NAME" in nameless.output
    assert call("init", "growth").exit_code == 0
    again = call("init", "growth")
    assert again.exit_code == 2
    assert "'growth.toml' exists already" in again.output
    assert call("init", "growth", "--overwrite").exit_code == 0
    assert "Did you mean 'growth'" in call("init", "growht").output


def test_a_run_takes_a_seed_and_says_how_to_go_on(tmp_path):
    short = ["--set", "duration=10 min", "--set", "initial.count=5", "--no-report"]
    out = tmp_path / "out folder"
    done = call("run", "settle", "-o", out, "--seed", 12, *short)
    assert done.exit_code == 0, done.output
    assert mc.load_result(out).scene.seed == 12
    # lines break where the path ends
    assert f"resume'{out}'--setduration=".replace(" ", "") in "".join(done.output.split())
    assert call("run", "settle", "-o", tmp_path / "b", "--seed", -1, *short).exit_code == 2
