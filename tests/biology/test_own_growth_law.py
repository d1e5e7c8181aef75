"""Growth laws of the user's own: derived courses, the registry, the door and the command line."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy import integrate

import multicell as mc
from multicell.behaviours.growth_laws.laws import LAWS
from multicell.schema import number, specs
from multicell.simulation import Simulation
from multicell.testing import check_growth_law


@mc.growth_law(parameters={"exponent": number(default=0.75, above=0.0, below=1.0)})
def power(volume, p):
    return volume**p.exponent


@mc.growth_law(parameters={"largest": ""})
def same_as_logistic(volume, p):
    return volume * (1.0 - volume / p.largest)


@pytest.mark.parametrize("law", LAWS)
def test_our_growth_laws_keep_what_is_asked_of_others(law):
    check_growth_law(LAWS[law](**({"target": 1.3} if "target" in specs(LAWS[law]) else {})))


def test_a_derived_course_is_that_of_a_closed_form_and_of_scipy():
    """V' ~ V^a has V^(1-a) = 1 + (2^(1-a) - 1) s; the logistic law is written down once more."""
    share = np.linspace(0.0, 1.1, 12)
    a = 0.75
    exact = (1.0 + (2.0 ** (1.0 - a) - 1.0) * share) ** (1.0 / (1.0 - a))
    law = power(exponent=a)
    check_growth_law(law)
    np.testing.assert_allclose(law.volume_after(np.ones(12), share), exact, rtol=1e-13)
    np.testing.assert_allclose(law.share_at(exact), share, rtol=0.0, atol=1e-13)
    ours, again = LAWS["logistic"](target=1.2), same_as_logistic(largest=2.4)
    check_growth_law(again)
    birth, begin = 261.8, np.full(12, 300.0)
    np.testing.assert_allclose(
        again.volume_after(begin, share, birth), ours.volume_after(begin, share, birth), rtol=1e-11
    )
    np.testing.assert_allclose(again.rate(begin, birth), ours.rate(begin, birth), rtol=1e-13)
    course = integrate.solve_ivp(
        lambda s, v: again.rate(v), (0.0, 1.1), [1.0], t_eval=share, rtol=1e-11, atol=1e-11
    ).y[0]
    np.testing.assert_allclose(again.volume_after(np.ones(12), share), course, rtol=1e-9)


def test_a_run_by_an_own_law_has_cells_of_its_volumes(tmp_path):
    scene = mc.load_scene("growth").with_changes({
        "growth.law": power(exponent=0.5), "duration": "6 h", "growth.cycle_variation": 0,
        "initial.count": 3, "initial.stage": "birth",
    })  # fmt: skip
    assert scene.growth.law == power.scene_name()
    result = mc.run(scene, output=tmp_path / "out", report=False)
    share = 6.0 * 3600.0 / scene.growth.cycle_time
    exact = (1.0 + (2.0**0.5 - 1.0) * share) ** 2
    cells = result.frames[-1].cells
    birth = 0.5 * 4.0 / 3.0 * np.pi * scene.cells.division_radius**3
    np.testing.assert_allclose(cells.volume / birth, exact, rtol=1e-9)
    assert mc.load_scene(tmp_path / "out" / "scene.toml") == scene
    with pytest.raises(mc.SceneError, match=r"growth\.parameters\.exponent"):
        scene.with_changes({"growth.law": "linear"})


def test_an_own_law_doubles_the_population_in_a_cycle_in_phases_too():
    phases = {n: {"duration": f"{d} h"} for n, d in {"G1": 5, "S": 4, "G2": 2, "M": 1}.items()}
    scene = mc.Scene.from_dict({
        "duration": "1 d", "coupling_step": "10 min", "contact": {"law": "hertz"},
        "initial": {"count": 4, "spacing": 3.0, "stage": "birth"},
        "growth": {"law": power.scene_name(), "parameters": {"exponent": 0.9}, "phases": phases},
    })  # fmt: skip
    simulation = Simulation(scene, threads=1)
    while simulation.time < 13.0 * 3600.0:
        simulation.step()
    assert len(simulation.cells) == 8
    assert simulation.cells.volume.mean() == pytest.approx(
        261.8 * float(scene.growth.growth_law.volume_after(1.0, 1.0 / 12.0)), rel=1e-4
    )


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (lambda: mc.growth_law(parameters={})(lambda v: v), "must have the arguments volume, p"),
        (lambda: mc.growth_law(parameters={"rate": ""})(lambda volume, p: volume), "'rate'"),
    ],
)
def test_functions_that_are_no_laws_are_refused(made, words):
    with pytest.raises(TypeError, match=words):
        made()


def test_a_check_finds_what_is_wrong():
    def shrinking(volume, p):
        return 1.5 - volume

    with pytest.raises(mc.SceneError, match=r"growth\.parameters.*above zero up to 2"):
        mc.load_scene("growth").with_changes(
            {"growth.law": same_as_logistic.scene_name(), "growth.parameters": {"largest": 1.9}}
        )

    def slow(begin, share, p):
        return begin + 0.5 * share

    with pytest.raises(mc.SceneError, match=r"rate of growth 0 at 1.5 times .* above zero up to 2"):
        mc.growth_law(parameters={})(shrinking)()
    wrong = mc.growth_law(parameters={}, volume=slow)(lambda volume, p: 1.0 + 0.0 * volume)
    with pytest.raises(AssertionError, match=r"does not double the volume.*not the inverse"):
        check_growth_law(wrong())


def test_failures_of_an_own_law_name_its_line():
    def broken(volume, p):
        return volume.nothing

    with pytest.raises(mc.SceneError, match=r"test_own_growth_law\.py.*nothing"):
        mc.growth_law(parameters={})(broken)()


def test_a_scene_on_disk_runs_no_file_and_the_command_line_does(tmp_path):
    with pytest.raises(mc.SceneError, match="which is not loaded") as caught:
        mc.load_scene("growth").with_changes({"growth.law": "mine.py:other@0123456789ab"})
    assert "--law mine.py:other" in caught.value.hint
    (tmp_path / "mine.py").write_text(
        "import multicell as mc\n"
        "@mc.growth_law(parameters={'exponent': ''})\n"
        "def power(volume, p):\n"
        "    return volume**p.exponent\n"
    )
    done = subprocess.run(
        [
            sys.executable, "-m", "multicell", "run", "growth", "--law", "mine.py:power",
            "--set", "growth.parameters.exponent=0.5", "--set", "duration='1 h'", "--quiet",
            "--no-report", "-o", "out",
        ],
        capture_output=True, text=True, cwd=tmp_path, check=False,
        env={"PYTHONPATH": str(Path(mc.__file__).parents[1])},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert 'law = "mine.py:power@' in (tmp_path / "out" / "scene.toml").read_text()
