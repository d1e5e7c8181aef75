"""Networks of a user's own file: commands and workers load it where it is named, and only there."""

from __future__ import annotations

import json
import math
import os
import pickle
import subprocess
import sys

import pytest

import multicell as mc
from multicell.errors import SceneError
from multicell.plugins.named import load_object
from multicell.studies.runs import PlainScene

OWN = '''
import multicell as mc

@mc.network(states={"A": 1.0}, inputs=("source",), parameters={"k": 1e-3})
def decay(t, y, u, p, out):
    """Decay."""
    out[0] = -p[0] * y[0]
'''
CHANGES = {"duration": "30 min", "output.every": "10 min", "coupling_step": "10 min"}


@pytest.fixture
def placed(tmp_path):
    """A file with a network, and a scene that names it."""
    file = tmp_path / "mine.py"
    file.write_text(OWN, encoding="utf-8")
    own = load_object(f"{file}:decay", "network")
    entry = {"decay": {"network": own, "inputs": {"source": "time"}}}
    scene = mc.load_scene("growth").with_changes({**CHANGES, "networks": entry})
    (tmp_path / "scene.toml").write_text(scene.to_toml(), encoding="utf-8")
    return tmp_path


@pytest.mark.slow
def test_commands_take_the_file_of_a_network(placed, forks):
    def ended(*words, code=0):
        done = forks.multicell(*words, folder=str(placed))
        assert done["code"] == code, done["text"]
        return done["text"]

    assert "--law mine.py:decay" in ended("explain", "scene.toml", code=2)
    law = ("--law", "mine.py:decay")
    ended("run", "scene.toml", "-o", "out", "--no-report", *law)
    ended("resume", "out", "--set", "duration=1 h", "--no-report", *law)
    shown = ended("explain", "out/scene.toml", "--json", *law)
    assert "states A" in json.dumps(json.loads(shown))
    assert mc.load_result(placed / "out").frames[-1].time == 3600.0


def test_workers_of_a_study_load_the_file_of_a_network(placed):
    program = (
        "from multicell.studies.runs import PlainScene\n"
        "import pickle\n"
        "scene = pickle.load(open('plain', 'rb')).load()\n"
        "print(scene.networks['decay'].model.states)\n"
    )
    plain = PlainScene.of(mc.load_scene(placed / "scene.toml"))
    (placed / "plain").write_bytes(pickle.dumps(plain))
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, cwd=placed, check=False
    )
    assert done.stdout.strip() == "('A',)", done.stderr


def test_a_study_varies_parameters_of_a_network_that_the_scene_sets(placed):
    bare = mc.load_scene(placed / "scene.toml")
    key = "networks.decay.parameters.k"
    with pytest.raises(SceneError, match=r"no 'networks\.decay\.parameters'") as refused:
        mc.study(bare, {key: [1e-3, 2e-3]}, output=placed / "study")
    assert f"--set {key}=" in str(refused.value)
    scene = bare.with_changes({key: 1e-3})
    study = mc.study(scene, {key: [1e-3, 2e-3]}, output=placed / "study")
    study.run(cores=1)
    results = [mc.load_result(placed / "study" / "runs" / run.name) for run in study.runs]
    left = [result.frames[-1].inside["decay.A"][0] for result in results]
    # the cell grows by the same factor in both, which dilutes
    assert left[1] / left[0] == pytest.approx(math.exp(-1e-3 * 1800.0), rel=1e-3)


@pytest.mark.slow
def test_code_that_was_executed_as_text_is_compiled_anew(tmp_path):
    """It has no module in which a later process finds what it reads."""
    code = f"names = {{'__name__': 'gone'}}\nexec({OWN!r}, names)\nimport multicell as mc\n"
    code += "from multicell.networks.solver import NetworkSolver\nimport numpy as np\n"
    code += "solver = NetworkSolver(names['decay'])\n"
    code += "print(solver.rates(solver.begin(1), np.zeros((1, 1)), 0.0)[0, 0])\n"
    places = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    for _ in range(2):
        command = [sys.executable, "-c", code]
        done = subprocess.run(command, env=places, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert float(done.stdout) == -1e-3
    assert list(tmp_path.rglob("*.nbc"))
