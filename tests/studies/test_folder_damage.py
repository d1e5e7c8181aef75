"""Folders of studies, fits and analyses that are damaged: read right, or refused in words.

``pytest tests/studies/test_folder_damage.py --damages 500`` damages as many of each kind. Each case
runs in a process of its own, with a bound on its time and memory.
"""

import json
import shutil
import sys

import folder_damage
import pytest
from studied import SHORT

import multicell as mc

KINDS = ("study", "fit", "opened", "sensitivity")
FREE = {"growth.cycle_time": "8:25 h"}
DATA = "time / h,diameter / um\n4,20\n8,24\n12,28\n16,32\n"


@pytest.fixture(scope="module")
def folders(forks, tmp_path_factory):
    """Return a finished folder of each kind, and what it holds."""
    place = tmp_path_factory.mktemp("damaged")
    scene = mc.load_scene("growth").with_changes({**SHORT, "initial.count": 6})
    (place / "scene.toml").write_text(scene.to_toml())
    (place / "data.csv").write_text(DATA)
    given = {"scene": str(place / "scene.toml"), "free": FREE}
    for kind in KINDS[1:]:
        (place / f"{kind}.arguments").write_text(json.dumps(given))
    study = mc.study(scene, {"cells.young": "1,2 kPa"}, seeds=2, output=place / "study")
    study.run(cores=1)
    folder_damage.fit(place / "fit")
    shutil.copytree(place / "fit", place / "opened")
    found = {kind: getattr(folder_damage, kind)(place / kind) for kind in KINDS}
    copy = tmp_path_factory.mktemp("copy") / "whole"
    shutil.copytree(place, copy)
    for kind in KINDS:
        forks.load(function="folder_damage:read", **{"with": {"folder": str(copy / kind)}})
    return place, json.loads(json.dumps(found))


@pytest.mark.harness
@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not limit address space")
@pytest.mark.parametrize("kind", KINDS)
def test_damaged_folders_are_read_right_or_refused(kind, folders, forks, tmp_path, pytestconfig):
    place, found = folders
    wrong = []
    for case in range(pytestconfig.getoption("damages")):
        shutil.copytree(place, tmp_path / "case")
        task = {"number": case, "kind": kind, "folder": str(tmp_path / "case" / kind),
                "whole": found[kind]}  # fmt: skip
        done = forks.ask(function="folder_damage:check", limit=60.0, **{"with": task})
        if done["code"] != 0:
            wrong.append((case, done["code"], done["text"][-1500:]))
        shutil.rmtree(tmp_path / "case")
    assert not wrong, "\n\n".join(f"case {k}: {code}\n{text}" for k, code, text in wrong)
