"""Facts of each method."""

import math
import re
from functools import partial
from pathlib import Path

import pytest

import multicell
from multicell.integrators.base import MethodInfo, build_method, info_of
from multicell.integrators.registry import METHODS, find, from_options
from multicell.integrators.scipy import Scipy
from multicell.scene.parts import IntegratorOptions

PACKAGE = Path(multicell.__file__).parent


@pytest.mark.parametrize("name", METHODS)
def test_every_method_is_fully_described(name):
    info = METHODS[name]
    assert info.name == name
    assert 10 < len(info.words) < 100
    assert "\n" not in info.words
    assert info.control in ("step", "tolerance")
    assert re.fullmatch("#[0-9a-f]{6}", info.colour)
    assert info.order != 0
    if info.control == "step":
        assert info.stable > 0.0
        assert info.order is not None
    assert (info.most_cells is None) == (info.why_no_more == "")


@pytest.mark.parametrize("name", METHODS)
def test_options_of_the_scene_reach_the_method(name):
    options = {"step": 7.0, "rtol": 1e-5, "atol": 0.02, "max_steps": 77, "max_displacement": 0.3}
    made = from_options(IntegratorOptions(method=name, **options))
    assert info_of(made).name == name
    assert made.max_displacement == 0.3
    if METHODS[name].control == "step":
        assert made.step == 7.0
    else:
        assert (made.rtol, made.atol, made.max_steps) == (1e-5, 0.02, 77)


def test_variants_have_a_number():
    info = find("rkc2-5")
    assert info.control == "step"
    assert info.stable == pytest.approx(0.65 * 25, rel=0.05)
    made = build_method(info, step=3.0, max_displacement=0.2)
    assert (made.step, made.stages, made.max_displacement) == (3.0, 5, 0.2)
    for name in ("rkc2-1", "rkc2-201", "rkc2-x", "euler-5", "rkc2-", "5"):
        assert find(name) is None


def test_a_method_is_named_in_its_own_file_only():
    """Who adds one touches that file, and for a new file one line of the registry."""
    names = [name for name in METHODS if "-" in name or name in ("dopri5", "rkc2", "ab2", "rk4")]
    places = {}
    for path in PACKAGE.rglob("*.py"):
        text = path.read_text()
        for name in names:
            if re.search(rf"""["']{name}["']""", text):
                places.setdefault(name, []).append(str(path.relative_to(PACKAGE)))
    expected = dict.fromkeys(names, 1)
    # what references are solved by, what auto weighs and a hint recommends
    allowed = {"comparison/reference.py", "integrators/auto.py", "integrators/driver.py"}
    allowed |= {f"comparison/stability_limits/{name}.py" for name in ("search", "truth")}
    # networks inside cells have methods of their own
    allowed |= {"networks/methods.py", "scene/networks.py"}
    allowed |= {"comparison/stability_limits/networks.py"}
    assert {name: len(set(found) - allowed) for name, found in places.items()} == expected


def test_refusals_are_words():
    info = MethodInfo("small", friction=False, most_cells=10, why_no_more="it is small")
    assert info.refusal(10, friction=False) is None
    problem, hint = info.refusal(11, friction=False)
    assert problem == "is 'small', which holds at most 10 cells, not 11: it is small"
    assert "cvode" in hint
    assert "friction" in info.refusal(1, friction=True)[0]
    assert math.isnan(info.stable)


@pytest.mark.parametrize("name", METHODS)
def test_a_method_made_by_hand_is_that_of_a_scene(name):
    """Nobody has to know where a method came from: each option has one default."""
    made, step = from_options(IntegratorOptions(method=name)), {}
    if METHODS[name].control == "step":
        step = {"step": IntegratorOptions().step}
    kind = partial(Scipy, name=made.name) if isinstance(made, Scipy) else type(made)
    assert kind(**step) == made
