"""Default tolerances: one number for each method, and the pages that state it."""

import importlib.util
import re
from pathlib import Path

import numpy as np
import pytest

from multicell import load_scene
from multicell.comparison.reference import reference
from multicell.integrators.base import MethodInfo
from multicell.integrators.registry import METHODS, from_options
from multicell.scene.scene import Scene

DOCS = Path(__file__).parents[2] / "docs"
CONTROLLED = {name: info.atol for name, info in METHODS.items() if info.control == "tolerance"}


@pytest.mark.parametrize("name", CONTROLLED)
def test_a_scene_that_names_no_tolerance_gets_that_of_its_method(name):
    scene = Scene.from_dict({"duration": "1 h", "integrator": {"method": name}})
    assert scene.integrator.tolerance == from_options(scene.integrator).atol == CONTROLLED[name]
    assert "atol" not in scene.to_dict()["integrator"]
    given = scene.with_changes({"integrator.atol": "0.02 um"})
    assert given.integrator.tolerance == from_options(given.integrator).atol == 0.02
    # the method alone is changed: what is given stays, what is not follows the method
    assert given.with_changes({"integrator": "auto"}).integrator.tolerance == 0.02
    assert scene.with_changes({"integrator": "auto"}).integrator.tolerance == METHODS["auto"].atol


def test_a_method_of_the_users_own_gets_the_usual_tolerance():
    scene = Scene.from_dict({"duration": "1 h", "integrator": {"method": "mine.py:Midpoint()"}})
    assert scene.integrator.tolerance == MethodInfo.atol == 0.1


def test_the_page_of_parameters_states_the_defaults_of_the_code():
    page = (DOCS / "theory" / "parameters.md").read_text(encoding="utf-8")
    (row,) = re.findall(r"^\| `integrator\.atol` \| (.*?) \|", page, re.M)
    usual, _, finer = row.partition(";")
    assert usual == f"{MethodInfo.atol:g} µm"
    assert finer.split()[0] == "0.01"
    other = {name for name, atol in CONTROLLED.items() if atol != MethodInfo.atol}
    assert {CONTROLLED[name] for name in other} == {0.01}
    assert set(re.findall(r"`(.*?)`", finer)) == {n for n in other if not METHODS[n].outside}
    assert "SciPy's methods" in finer
    assert other > {name for name, info in METHODS.items() if info.outside}


def test_the_measured_table_is_at_the_defaults_of_the_code():
    page = (DOCS / "theory" / "integrators.md").read_text(encoding="utf-8")
    _, _, rest = page.partition("## Default tolerances")
    stated = re.findall(r"^\| `([\w-]+)` \| ([\d.]+) \|", rest.partition("\n## ")[0], re.M)
    assert {name: float(atol) for name, atol in stated} == CONTROLLED


@pytest.fixture(scope="module")
def shocked():
    scene = load_scene("division-shock").with_changes({"duration": "40 min"})
    return reference(scene, stepwise=4, threads=1)


@pytest.mark.parametrize("name", ["auto", "cvode", "rosenbrock", "rkc2", "dopri5"])
def test_at_its_default_a_method_keeps_the_worst_cell_within_its_word(shocked, name):
    """The page says: in the median step the worst cell is off by about a hundredth of a radius."""
    spec = importlib.util.spec_from_file_location("tolerances", DOCS / "programs" / "tolerances.py")
    program = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(program)
    options = Scene.from_dict({"duration": "1 h", "integrator": {"method": name}}).integrator
    worst = [step.max() for step in program.errors(shocked, options)]
    assert np.median(worst) < 0.02 * shocked.problem.mean_radius
