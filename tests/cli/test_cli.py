"""The command: what it prints, and the exit codes."""

import json
import math
import re
import time
from types import SimpleNamespace

import click
import numpy as np
import pytest
from click.testing import CliRunner
from synthetic import BARE, SCENE

from multicell import __version__
from multicell.cells import SPHERE
from multicell.cli import progress
from multicell.cli.main import main
from multicell.cli.options import parse_changes
from multicell.report.explain import compilation
from multicell.report.explain.scene import explain
from multicell.report.result import load_result
from multicell.scene.pairs import daughters_stiffness, drag
from multicell.scene.scene import load_scene, scene_names


def call(*arguments):
    return CliRunner().invoke(main, list(arguments))


def numbers(scene, **changes):
    described = scene.with_changes({k.replace("__", "."): v for k, v in changes.items()})
    return {entry["name"]: entry["value"] for entry in explain(described)["numbers"]}


def test_help_lists_the_commands_and_every_command_has_help():
    assert call("--version").output == f"multicell {__version__}\n"
    answer = call("--help")
    assert answer.exit_code == 0
    for command in main.list_commands(None):
        assert command in answer.output
        page = call(command, "--help")
        assert page.exit_code == 0
        if command != "play":  # which serves a page, and prints nothing but its address
            assert "--json" in page.output


def test_scenes_are_listed():
    answer = call("scenes")
    assert answer.exit_code == 0
    for name in scene_names():
        assert name in answer.output
    listed = json.loads(call("scenes", "--json").output)
    assert [row["name"] for row in listed] == scene_names()
    assert {row["name"]: row["duration"] for row in listed}["settle"] == 3600.0
    assert all(row["title"] for row in listed)


@pytest.mark.parametrize("name", ["spheroid", "sorting"])
def test_explain_prints_parts_numbers_and_json(name):
    answer = call("explain", name)
    assert answer.exit_code == 0
    assert "derived number" in answer.output
    facts = json.loads(call("explain", name, "--json").output)
    assert facts["scene"] == name
    scene = load_scene(name)
    used = {part["part"]: part["used"] for part in facts["parts"]}
    assert used["growth"] is (scene.growth is not None)
    assert used["death"] is (scene.death is not None)
    assert ("nutrients.oxygen" in used) is ("oxygen" in scene.nutrients)
    assert all(math.isfinite(entry["value"]) for entry in facts["numbers"])


def test_explain_takes_changes_and_files(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('title = "[bold]mine[/bold]"\nduration = "2 h"\n')
    answer = call("explain", str(path), "--set", "coupling_step=5 min")
    assert answer.exit_code == 0
    assert "[bold]mine[/bold]" in answer.output
    facts = json.loads(call("explain", str(path), "--set", "duration=8 d", "--json").output)
    assert facts["numbers"][0]["value"] == 8 * 86400.0


def test_derived_numbers_against_closed_forms():
    known = numbers(SCENE)
    radius = 5.0 / 2 ** (1 / 6)
    assert known["typical radius"] == pytest.approx(radius)
    assert known["drag"] == pytest.approx(6 * np.pi * 5.0 * radius)
    assert known["cycle time"] == 54000.0
    demand = 20.0 / (SPHERE * radius**3)
    assert known["oxygen: largest uptake"] == pytest.approx(demand)
    # at the starving radius the zeroth-order profile is zero in the centre
    starving = known["oxygen: starving radius"]
    assert 0.07 - demand * starving**2 / (6 * 2000.0) == pytest.approx(0.0, abs=1e-15)
    # a wall fed from one side has no flux and no oxygen at the diffusion length
    depth = known["oxygen: diffusion length"]
    assert 0.07 - demand * depth**2 / (2 * 2000.0) == pytest.approx(0.0, abs=1e-15)


def test_contact_numbers_of_the_reference_pair():
    """Two cells of radius 10 µm with E = 1, ν = 0.5, σ = 0.1 rest at 17.178 µm, pull 2.3562 nN."""
    known = numbers(BARE, cells__division_radius=10.0 * 2 ** (1 / 3))
    # nothing grows: the cells stay as they are born
    assert known["typical radius"] == pytest.approx(10.0)
    assert known["equilibrium distance"] == pytest.approx(17.178, abs=5e-4)
    assert known["pull-off force"] == pytest.approx(2.3562, abs=5e-5)


def test_relaxation_time_is_that_of_the_linearised_pair():
    known = numbers(BARE)
    radius, gap = known["typical radius"], 1e-4
    modulus = 1.0 / (2 * 0.75 * (1 - 0.25) / 1.0)
    rest = 2 * radius - known["equilibrium distance"]
    force = [BARE.contact.force(rest + x, modulus, radius / 2) for x in (-gap, gap)]
    stiffness = (force[1] - force[0]) / (2 * gap)
    assert known["relaxation time"] == pytest.approx(known["drag"] / (2 * stiffness), rel=1e-6)


def test_doublet_is_explained_with_its_critical_load():
    facts = explain(load_scene("doublet"))
    used = {part["part"]: part for part in facts["parts"]}
    assert used["pull"]["used"] is True
    known = {entry["name"]: entry["value"] for entry in facts["numbers"]}
    radius = 12.6 / 2 ** (1 / 3)
    load = 1.5 * np.pi * 0.1 * radius / 2
    assert known["critical load"] == pytest.approx(load, rel=1e-9)
    assert known["equilibrium distance"] == pytest.approx(17.18, abs=5e-3)


def test_sorting_is_explained_by_pairs_of_types():
    facts = explain(load_scene("sorting"))
    used = {part["part"]: part for part in facts["parts"]}
    assert used["types"]["what"] == "50 % cohesive, 50 % loose"
    assert "by type" in used["contact"]["what"]
    assert used["motility"]["used"] is True
    known = {entry["name"]: entry["value"] for entry in facts["numbers"]}
    radius, stiff = known["typical radius"], 5.0 * (8 / 9)
    for pair, energy in (("cohesive-cohesive", 0.2), ("cohesive-loose", 0.1), ("loose-loose", 0.1)):
        load = 1.5 * np.pi * energy * radius / 2
        assert known[f"pull-off force, {pair}"] == pytest.approx(load, rel=1e-9)
        overlap = (6 * np.pi * energy * np.sqrt(radius / 2) / stiff) ** (2 / 3)
        assert known[f"equilibrium distance, {pair}"] == pytest.approx(2 * radius - overlap)
    speed = 0.8 / (6 * np.pi * 0.5 * radius)
    assert known["run length of motility"] == pytest.approx(600.0 * speed)
    assert known["diffusion by motility"] == pytest.approx(speed**2 * 600.0 / 6)


def test_friction_slows_two_cells_down():
    known = numbers(BARE, friction__normal=0.2, friction__tangential=0.05)
    radius = known["typical radius"]
    overlap = 2 * radius - known["equilibrium distance"]
    area = np.pi * radius / 2 * overlap
    # Γ + 2 γ A in place of Γ
    bare = numbers(BARE)["relaxation time"]
    assert known["relaxation time"] == pytest.approx(bare * (1 + 0.4 * area / known["drag"]))


@pytest.mark.parametrize("law", ["hertz", "exact-jkr", "linear", "cubic", "generalised-linear"])
def test_each_contact_law_is_explained(law):
    known = numbers(BARE, contact__law=law)
    assert all(math.isfinite(value) for value in known.values())
    radius = known["typical radius"]
    overlap = 2 * radius - known["equilibrium distance"]
    if law == "exact-jkr":  # a third of the overlap of the approximate law
        approximate = 2 * radius - numbers(BARE)["equilibrium distance"]
        assert overlap == pytest.approx(approximate / 3, rel=1e-9)
    else:
        assert overlap == pytest.approx(0.0, abs=1e-12)


def test_explicit_step_limit_is_where_euler_on_two_daughters_turns_unstable():
    """Euler on the linearised separation: x' = -2k/Γ x is unstable beyond Γ/k."""
    limit = numbers(BARE)["explicit step limit"]
    rate = 2.0 * daughters_stiffness(BARE) / drag(BARE, 5.0 / 2 ** (1 / 3))
    growth = [abs(1.0 - rate * step) for step in (0.99 * limit, 1.01 * limit)]
    assert growth[0] < 1.0 < growth[1]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"death.lysis_time": "48 h"}, "necrotic"),
        ({"contact.surface_energy": 0.0}, "Hertz"),
        ({"integrator.method": "euler", "integrator.step": 200.0}, "stability"),
        ({"growth.cycle_time": "15 h", "coupling_step": "2 h"}, "coupling step"),
        ({"nutrients.oxygen": {"boundary": 0.01, "quiescence": 0.02}}, "quiescent"),
        ({"nutrients.oxygen": {}}, "no effect on the cells"),
        (
            {"nutrients.oxygen": {"diffusion": 1.0, "regime": "steady", "quiescence": 0.01}},
            "solved as steady",
        ),
        ({"motility.force": "3 nN"}, "stronger than the weakest contact"),
    ],
)
def test_explain_notes_what_does_not_fit(changes, words):
    assert explain(BARE)["notes"] == []
    (note,) = explain(BARE.with_changes(changes))["notes"]
    assert words in note


def test_explain_tells_of_phases_death_and_taxis():
    parts = {p["part"]: p["what"] for p in explain(load_scene("emt6"))["parts"]}
    assert "G1 11.5 h, S 7 h, G2 3 h, M 1 h" in parts["growth"]
    assert "5 per oxygen + 2 per glucose" in parts["energy"]
    parts = {p["part"]: p["what"] for p in explain(load_scene("chemotaxis"))["parts"]}
    # 0.4 nN over 6 pi 0.5 kPa s times the birth radius, in an hour
    speed = 3600 * 0.4 / (6 * np.pi * 0.5 * 5.0 / 2 ** (1 / 3))
    assert f"{speed:.3g} um/h" in parts["chemotaxis.attractant"]


@pytest.mark.parametrize("scene", scene_names())
def test_built_in_scenes_need_no_note(scene):
    notes = explain(load_scene(scene))["notes"]
    # a core, a layer of still medium in which oxygen settles more slowly than a step lasts, and
    # medium that begins at the sides of a box
    steady = "but is solved as steady"
    known = {
        "emt6-rim": "would die at once", "wm983b": steady, "coculture": steady,
        "spheroid": "it has no corners",
    }  # fmt: skip
    assert [note for note in notes if known.get(scene, "!") not in note] == []


def test_values_of_set_are_toml_or_text():
    items = ("a=5", "b=0.5", "c=8 d", 'd="x"', "e=true", "f={ g = 1 }", "h = euler ", "i=", "j=1=2")
    assert parse_changes(items) == {
        "a": 5, "b": 0.5, "c": "8 d", "d": "x", "e": True, "f": {"g": 1}, "h": "euler", "i": None,
        "j": "1=2",
    }  # fmt: skip


def test_set_cannot_smuggle_in_a_second_key_or_a_date():
    assert parse_changes(["a=1\nb = 2", "c=1979-05-27"]) == {"a": "1\nb = 2", "c": "1979-05-27"}
    for item in ("=5", " =5", "a"):
        with pytest.raises(click.BadParameter, match="KEY=VALUE"):
            parse_changes([item])


def test_empty_value_removes_a_part():
    facts = json.loads(call("explain", "spheroid", "--set", "death=", "--json").output)
    assert {part["part"]: part["used"] for part in facts["parts"]}["death"] is False


def moment(time, cells=120, step=3):
    scene = SimpleNamespace(duration=36000.0)
    known = {"state": SimpleNamespace(cells=range(cells)), "finished": time >= scene.duration}
    return SimpleNamespace(time=time, scene=scene, step_index=step, wall={"compile": 0.0}, **known)


def test_status_tells_time_cells_step_and_speed():
    text = progress.progress_line(moment(7200.0, cells=1204), wall=4.0)
    assert text == ["2.00 of 10 h", "1,204 cells", "0.5 h simulated per s", "step 3"]
    text = progress.progress_line(moment(7200.0, cells=1204), wall=4.0, left=192.0)
    assert text[1] == "3.2 min left"


def test_log_has_a_line_for_every_tenth(capsys, monkeypatch):
    monkeypatch.setattr(compilation, "missing_parts", lambda scene: {})
    scene = load_scene("settle").with_changes({"duration": "10 h"})
    with progress.reporter(scene) as report:
        for step in range(1, 101):
            report(moment(360.0 * step, step=step))
    shown = capsys.readouterr()
    assert shown.out == ""
    lines = shown.err.splitlines()
    assert [line.split(" %")[0].strip() for line in lines] == [str(k) for k in range(10, 101, 10)]
    assert "120 cells" in lines[0]


@pytest.mark.parametrize("columns", [40, 80, 120])
def test_bar_in_a_terminal_shows_the_status(capsys, monkeypatch, columns):
    monkeypatch.setattr(compilation, "missing_parts", lambda scene: {})
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", str(columns))
    scene = SimpleNamespace(duration=36000.0, stop_cells=None, growth=None)
    with progress.reporter(scene) as report:
        time.sleep(0.3)
        report(moment(18000.0))
    shown = capsys.readouterr()
    assert shown.out == ""
    plain = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", shown.err)
    lines = [line.strip() for line in re.split(r"[\r\n]", plain)]
    assert max(map(len, lines)) <= columns
    assert any("loading · 0." in line for line in lines)
    assert not any("0 %" in line and "loading" in line for line in lines)
    last = [line for line in lines if line][-1]
    assert last.startswith("50 %")
    assert "5.00 of 10 h" in last
    assert ("step 3" in last) == (columns > 80)


def test_quiet_run_reports_nothing(capsys):
    with progress.reporter(load_scene("settle"), show=False) as report:
        assert report is None
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("name", ["emt6", "sorting-signal", "treatment"])
def test_printed_and_copied_scenes_are_the_scene(name, tmp_path):
    scene = load_scene(name)
    path = tmp_path / "scene.toml"
    for full in ([], ["--full"]):
        shown = call("scenes", name, *full)
        assert shown.exit_code == 0
        path.write_text(shown.output, encoding="utf-8")
        assert load_scene(path) == scene
    copied = call("init", name, "-o", str(tmp_path / "copy.toml"))
    assert copied.exit_code == 0
    assert load_scene(tmp_path / "copy.toml") == scene
    assert json.loads(call("scenes", name, "--json").output)["duration"] == scene.duration


def test_a_full_scene_names_units_of_what_was_left_out():
    assert "viscosity = 5.0  # kPa s" in call("scenes", "spheroid", "--full").output


def test_what_cannot_be_printed_or_copied(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    nameless = call("scenes", "--full")
    assert nameless.exit_code == 2
    assert "needs the NAME" in nameless.output
    assert call("init", "growth").exit_code == 0
    again = call("init", "growth")
    assert again.exit_code == 2
    assert "'growth.toml' exists already" in again.output
    assert call("init", "growth", "--overwrite").exit_code == 0
    assert "Did you mean 'growth'" in call("init", "growht").output


def test_a_run_takes_a_seed_and_says_how_to_go_on(tmp_path):
    short = ["--set", "duration=10 min", "--set", "initial.count=5", "--no-report"]
    out = tmp_path / "out folder"
    done = call("run", "settle", "-o", str(out), "--seed", "12", *short)
    assert done.exit_code == 0, done.output
    assert load_result(out).scene.seed == 12
    # lines break where the path ends
    assert f"resume'{out}'--setduration=".replace(" ", "") in "".join(done.output.split())
    assert call("run", "settle", "-o", str(tmp_path / "b"), "--seed", "-1", *short).exit_code == 2
