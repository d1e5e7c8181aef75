"""The name of a run: the same for scenes that mean the same, another for all that decide more."""

import pickle
import random
import subprocess
import sys

import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from scene_strategies import plausible

import multicell as mc
from multicell import SceneError
from multicell.studies import runs
from multicell.studies.runs import run_digest

NAMED = {
    "types", "nutrients", "reactions", "chemotaxis", "motions",
}  # fmt: skip
LAW = """
import multicell as mc

# REMARK
@mc.pair_law(parameters={})
def square(overlap, modulus, radius, p):
    return modulus * overlap * overlap / (radius + 0.5)
"""
GROWTH_LAW = """
import multicell as mc

# REMARK
@mc.growth_law(parameters={})
def power(volume, p):
    return volume ** (0.0 + 0.5)
"""


def shuffled(entries, chance, path=""):
    """Return a scene's entries with keys in another order; that of named tables is kept."""
    names = list(entries)
    if path.rpartition(".")[2] not in NAMED:
        chance.shuffle(names)
    return {
        name: shuffled(entries[name], chance, f"{path}.{name}")
        if isinstance(entries[name], dict)
        else entries[name]
        for name in names
    }


@pytest.mark.slow
@given(plausible(extreme=0.0), st.integers(0, 2**32))
@settings(max_examples=30, deadline=None, suppress_health_check=list(HealthCheck))
def test_equal_scenes_have_one_digest(entries, seed):
    try:
        scene = mc.Scene.from_dict(entries)
    except SceneError:  # drawn parts fit together mostly, not always
        assume(False)
    again = mc.Scene.from_dict(shuffled(scene.to_dict(), random.Random(seed)))
    assert run_digest(again) == run_digest(scene)


@pytest.mark.parametrize(
    ("key", "one", "other"),
    [
        ("nutrients.oxygen.boundary", "0.07 mM", "70 uM"),
        ("duration", "2 d", 172800),
        ("integrator", "cvode", {"method": "cvode"}),
        ("title", "one", "another"),
    ],
)
def test_units_and_forms_do_not_matter(key, one, other):
    scene = mc.load_scene("spheroid")
    found = {run_digest(scene.with_changes({key: value})) for value in (one, other)}
    assert len(found) == 1


@pytest.mark.parametrize(
    "change",
    [
        {"seed": 8},
        {"duration": "3 d"},
        {"nutrients.oxygen.boundary": 0.0700000000000001},
        {"growth": None},
        {"output.every": "1 h"},
        {"integrator": "rkc2"},
    ],
)
def test_what_decides_results_changes_the_digest(change):
    scene = mc.load_scene("spheroid")
    assert run_digest(scene.with_changes(change)) != run_digest(scene)


def test_the_order_of_types_decides_which_cells_are_of_which(monkeypatch):
    scene = mc.load_scene("sorting")
    entries = scene.to_dict()
    entries["types"] = dict(reversed(entries["types"].items()))
    assert run_digest(mc.Scene.from_dict(entries)) != run_digest(scene)


def test_the_version_of_the_model_counts(monkeypatch):
    scene = mc.load_scene("growth")
    before = run_digest(scene)
    monkeypatch.setattr(runs, "MODEL_VERSION", runs.MODEL_VERSION + 1)
    assert run_digest(scene) != before


@pytest.mark.parametrize(
    ("text", "name", "key"),
    [(LAW, "square", "contact"), (GROWTH_LAW, "power", "growth.law")],
    ids=["contact", "growth"],
)
def test_an_own_law_counts_by_all_that_it_computes(text, name, key, tmp_path):
    found = []
    for folder, old, new in (("a", "", ""), ("b", "REMARK", "other"), ("c", "+ 0.5", "+ 0.6")):
        file = tmp_path / folder / "mine.py"
        file.parent.mkdir()
        file.write_text(text.replace(old, new) if old else text)
        law = mc.load_law(f"{file}:{name}")()
        found.append(mc.load_scene("growth").with_changes({key: law}))
    one, same, other = map(run_digest, found)
    assert one == same
    assert one != other
    assert runs.PlainScene.of(found[2]).laws == (f"{tmp_path / 'c' / 'mine.py'}:{name}",)
    assert runs.PlainScene.of(mc.load_scene("growth")).laws == ()


RESPONSE = """
import multicell as mc


@mc.response(parameters={"half": "mM"})
def half_way(signal, p):
    return signal / (p.half + signal)
"""
WORKER = """
import pickle, sys
with open(sys.argv[1], "rb") as file:
    scene = pickle.load(file).load()
print(type(scene).__name__, scene.responses["r"].law)
"""


def test_own_responses_travel_to_workers(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(RESPONSE)
    law = mc.load_law(f"{file}:half_way")
    response = {"behaviour": "growth rate", "signal": "oxygen", "law": law.scene_name(),
                "parameters": {"half": 0.01}}  # fmt: skip
    scene = mc.load_scene("spheroid").with_changes({"responses.r": response})
    plain = runs.PlainScene.of(scene)
    assert plain.laws == (f"{file}:half_way",)
    packed = tmp_path / "scene.pickle"
    packed.write_bytes(pickle.dumps(plain))
    done = subprocess.run(
        [sys.executable, "-c", WORKER, str(packed)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["Scene", law.scene_name()]
