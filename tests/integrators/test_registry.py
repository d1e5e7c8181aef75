"""What is known of each method, and how little an added one has to touch."""

import math
import re
import subprocess
import sys
from pathlib import Path

import pytest

import multicell
from multicell.integrators.base import MethodInfo, build, info_of
from multicell.integrators.registry import METHODS, find, from_options
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
    assert info.order in (None, 1, 2, 4, 5, 8)
    if info.control == "step":
        assert info.stable > 0.0
        assert info.order is not None
    assert (info.most_cells is None) == (info.why_no_more == "")


def test_looks_are_told_apart():
    looks = [(info.colour, info.marker) for info in METHODS.values()]
    assert len(set(looks)) == len(looks) == len({colour for colour, _ in looks})


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
    made = build(info, step=3.0, max_displacement=0.2)
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
    allowed |= {"comparison/stability_limits/search.py"}
    assert {name: len(set(found) - allowed) for name, found in places.items()} == expected


def test_an_added_method_is_offered_everywhere(tmp_path):
    """A second copy of the package with one more file and one more line knows it throughout."""
    program = """
import sys
import multicell.integrators as room
from types import ModuleType
from dataclasses import dataclass
from typing import ClassVar
from multicell.integrators.base import EqualSteps, MethodInfo
from multicell.integrators import registry
import multicell.integrators.registry as module

source = open(module.__file__).read()
source = source.replace("    adams_bashforth,\\n", "    added,\\n    adams_bashforth,\\n")
added = ModuleType("multicell.integrators.added")

@dataclass(frozen=True)
class Added(EqualSteps):
    info: ClassVar = MethodInfo("added", "a method that was added", order=3, colour="#123456")
    def integrate(self, system, position): raise NotImplementedError

added.METHODS = (Added,)
sys.modules["multicell.integrators.added"] = room.added = added
exec(compile(source, module.__file__, "exec"), module.__dict__)

import multicell as mc
from multicell.comparison.ladders import capable_methods, find_method
from multicell.report.explain.scene import explain
scene = mc.load_scene("settle").with_changes({"integrator": "added"})
assert scene.integrator.method == "added"
assert "a method that was added" in str(explain(scene))
assert "added" in capable_methods(scene)
assert find_method("added", scene, 5.0).control == "step"
assert registry.find("added").colour == "#123456"
assert type(registry.from_options(scene.integrator)) is Added
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]


def test_refusals_are_words():
    info = MethodInfo("small", friction=False, most_cells=10, why_no_more="it is small")
    assert info.refusal(10, friction=False) is None
    problem, hint = info.refusal(11, friction=False)
    assert problem == "is 'small', which holds at most 10 cells, not 11: it is small"
    assert "cvode" in hint
    assert "friction" in info.refusal(1, friction=True)[0]
    assert math.isnan(info.stable)
