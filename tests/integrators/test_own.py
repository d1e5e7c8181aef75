"""A method of the user's own from a file outside the package: Python, command line, resume."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import multicell as mc
from multicell.cli.main import main
from multicell.integrators.registry import METHODS, from_options
from multicell.integrators.runge_kutta import Heun
from multicell.plugins.named import load_object

pytestmark = pytest.mark.kernels

EXAMPLE = Path(__file__).parents[2] / "examples" / "own_integrator.py"
SCENE = {"initial.count": 20, "duration": "20 min", "output.every": "5 min", "coupling_step": 60.0}


@pytest.fixture
def mine(tmp_path):
    """Return the example as a file in a folder of its own."""
    path = tmp_path / "mine.py"
    path.write_text(EXAMPLE.read_text())
    return path


def scene(**changes):
    return mc.load_scene("settle").with_changes(SCENE | changes)


def command(*words, code=0):
    done = CliRunner().invoke(main, words)
    assert done.exit_code == code, done.output
    return done


def ends(result):
    return result.frames[-1].cells.position


def test_object_class_and_name_give_the_same_run(mine):
    kind = load_object(f"{mine}:Midpoint", "integrator")
    named = mc.run(scene(**{"integrator.step": 4.0}), integrator=f"{mine}:Midpoint")
    made = mc.run(scene(**{"integrator.step": 4.0}), integrator=kind)
    given = mc.run(scene(), integrator=kind(step=4.0))
    for result in (made, given):
        assert ends(result).tobytes() == ends(named).tobytes()
        assert result.scene.integrator.method == f"{mine}:Midpoint"
        assert result.scene.integrator.step == 4.0
        assert result.summary()["integrator"]["method"] == f"{mine}:Midpoint"
    # an independent method of the same order stays near
    heun = mc.run(scene(), integrator=Heun(0.5))
    np.testing.assert_allclose(ends(given), ends(heun), atol=0.01)
    assert heun.scene.integrator.method == "heun"


def test_an_object_of_ours_with_other_settings_is_recorded_with_them():
    from multicell.integrators.cvode import Cvode

    usual = mc.run(scene(), integrator=Cvode(atol=1e-3))
    assert usual.scene.integrator.method == "cvode"
    assert usual.scene.integrator.atol == 1e-3
    other = mc.run(scene(), integrator=Cvode(atol=1e-3, light=False))
    assert other.scene.integrator.method.endswith("cvode.py:Cvode(light=False)")


def test_a_run_is_resumed_when_the_method_is_given_again(mine, tmp_path):
    kind = load_object(f"{mine}:Midpoint", "integrator")
    whole = mc.run(scene(), integrator=kind(step=4.0), output=tmp_path / "out", report=False)
    with pytest.raises(mc.SceneError) as caught:
        mc.resume(tmp_path / "out", 1, output=tmp_path / "again", report=False)
    assert f"is '{mine}:Midpoint', a method of the user's own" in str(caught.value)
    assert f"--integrator '{mine}:Midpoint'" in str(caught.value)
    again = mc.resume(
        tmp_path / "out", 1, output=tmp_path / "again", integrator=kind(step=4.0), report=False
    )
    assert ends(again).tobytes() == ends(whole).tobytes()
    ours = mc.resume(
        tmp_path / "out", 1, output=tmp_path / "ours", integrator="cvode", report=False
    )
    assert ours.scene.integrator.method == "cvode"
    # what is read is never executed, and needs no file
    mine.unlink()
    assert mc.load_result(tmp_path / "out").scene.integrator.method == f"{mine}:Midpoint"


@pytest.mark.slow
def test_the_command_line_runs_resumes_and_compares(mine, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    settings = [word for key, value in SCENE.items() for word in ("--set", f"{key}={value}")]
    own = ("--integrator", "mine.py:Midpoint", "--no-report", "--quiet")
    command("run", "settle", *settings, "-o", "out", *own)
    assert f"{mine}:Midpoint" in (tmp_path / "out" / "scene.toml").read_text()
    command("resume", "out", "--frame", "1", "-o", "again", *own)
    results = [mc.load_result(tmp_path / name) for name in ("out", "again")]
    assert ends(results[0]).tobytes() == ends(results[1]).tobytes()
    refused = command("resume", "out", "--frame", "1", "-o", "new", code=2)
    assert "hand it over" in refused.stderr.lower()
    done = command(
        "compare", "settle", *settings, "--methods", "cvode,mine.py:Midpoint", "-o", "chart",
        "--budget", "2", "--repeats", "1", "--json", "--quiet",
    )  # fmt: skip
    rows = json.loads(done.stdout)
    assert {row["method"] for row in rows} == {"cvode", "midpoint"}
    errors = [row["error_position"] for row in rows if row["method"] == "midpoint"]
    assert min(error for error in errors if error is not None) < 1e-3
    assert (tmp_path / "chart" / "workprecision.png").stat().st_size > 0


WRONG = {
    "nothing.py:Midpoint": "there is no file 'nothing.py'",
    "mine.py:Midpont": "has nothing called 'Midpont'. Did you mean 'Midpoint'",
    "mine.py:math": "'math' is no integrator: it has no method integrate(system, position)",
    "mine.py:": "must have the form 'file.py:Name'",
    "raises.py:Midpoint": "line 1, raises ZeroDivisionError",
    "wants.py:Wants": "'Wants' cannot be made: ",
    "euIer": "must be one of",
}


@pytest.mark.parametrize("method", WRONG)
def test_what_cannot_be_an_integrator_is_said_before_anything_is_written(
    method, mine, tmp_path, monkeypatch
):
    (tmp_path / "raises.py").write_text("1 / 0\n")
    (tmp_path / "wants.py").write_text(
        "class Wants:\n    def __init__(self, more): pass\n    def integrate(self, s, x): pass\n"
    )
    monkeypatch.chdir(tmp_path)
    with pytest.raises(mc.SceneError) as caught:
        mc.run(scene(), integrator=method, output=tmp_path / "out")
    assert WRONG[method] in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_a_scene_that_names_a_file_executes_nothing(tmp_path, monkeypatch):
    (tmp_path / "evil.py").write_text("open('executed', 'w')\nclass A: pass\n")
    monkeypatch.chdir(tmp_path)
    described = scene(integrator="evil.py:A")
    (tmp_path / "scene.toml").write_text(described.to_toml())
    again = mc.load_scene(tmp_path / "scene.toml")
    assert again.integrator.method == "evil.py:A"
    with pytest.raises(mc.SceneError, match="not loaded by itself"):
        mc.run(again)
    assert "evil.py:A" in command("explain", "scene.toml").stdout
    assert not (tmp_path / "executed").exists()


def test_methods_of_one_name_are_refused(mine):
    kind = load_object(f"{mine}:Midpoint", "integrator")
    with pytest.raises(mc.SceneError, match="two methods are called 'midpoint'"):
        mc.compare(scene(), [kind, kind(step=2.0)])


@pytest.mark.parametrize("method", ["scipy-lsoda", "rosenbrock"])
def test_methods_that_cannot_hold_a_scene_are_refused_with_it(method):
    """Friction makes J full: said when the scene is read, not in its first step."""
    from multicell.comparison.ladders import capable_methods

    rough = scene(friction={"normal": "0.1 nN s/um^3"})
    with pytest.raises(mc.SceneError, match="friction between cells") as caught:
        rough.with_changes({"integrator": method})
    assert caught.value.path == "integrator.method"
    assert method in capable_methods(scene())
    assert method not in capable_methods(rough)
    if METHODS[method].most_cells:
        with pytest.raises(mc.SceneError, match="holds at most"):
            scene(**{"integrator": method, "initial.count": 20_000})


def test_own_methods_say_what_they_cannot_hold(mine):
    kind = load_object(f"{mine}:Midpoint", "integrator")
    small = type("Small", (kind,), {"info": mc.MethodInfo("small", most_cells=3, why_no_more="so")})
    with pytest.raises(mc.SceneError, match="holds at most 3 cells, not 20: so"):
        mc.run(scene(), integrator=small(step=1.0))


def test_the_stability_of_an_own_method_is_that_of_its_theory(mine):
    found = mc.stability(scene(**{"initial.count": 12}), [f"{mine}:Midpoint"], threads=1)
    row = found.limit("midpoint")
    assert row["of_theory"] == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
def test_the_example_runs_as_it_stands(tmp_path):
    done = subprocess.run(
        [sys.executable, str(EXAMPLE)], capture_output=True, text=True, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert "Midpoint keeps what runs rely on." in done.stdout
    assert f"recorded as {EXAMPLE}:Midpoint" in done.stdout


@pytest.mark.parametrize("name", ["auto", "backward-euler", "cvode", "rk4", "rkc2", "scipy-bdf"])
def test_methods_of_ours_can_be_handed_over_as_an_object(name):
    """A class's own default of an unused setting, such as no step, is none of the scene's."""
    asked = scene(**{"initial.count": 3, "duration": "5 min", "integrator.method": name})
    method = from_options(asked.integrator)
    other = scene(**{"initial.count": 3, "duration": "5 min"})
    recorded = mc.run(other, integrator=method).scene.integrator
    # the object has the tolerance that the scene left to its method
    assert recorded.tolerance == asked.integrator.tolerance
    assert replace(recorded, atol=None) == asked.integrator
