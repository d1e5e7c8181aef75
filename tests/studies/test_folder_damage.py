"""Folders of studies, fits and analyses that are damaged: read right, or refused in words.

``pytest tests/studies/test_folder_damage.py --damages 500`` damages as many of each kind, from
the case ``--first-seed`` on. Each case runs in a process of its own, with a bound on its time and
memory.
"""

import errno
import json
import os
import shutil
import sys

import folder_damage
import pytest
from network_models import WITH_NETWORK, WRITTEN
from studied import SHORT
from two_cells import PAIR

import multicell as mc
import multicell.report.html as html
from multicell.errors import OutputError

KINDS = ("study", "fit", "opened", "sensitivity", "doses", "comparison", "limits", "networked",
         "network")  # fmt: skip
FREE = {"growth.cycle_time": "8:25 h"}
DATA = "time / h,diameter / um\n4,20\n8,24\n12,28\n16,32\n"


DEATHS = {"death": {"apoptosis_rate": 0}, "initial.count": 6}
METHODS = ["euler", "heun"]


@pytest.fixture(scope="module")
def folders(forks, tmp_path_factory):
    """Return a finished folder of each kind, and what it holds."""
    place = tmp_path_factory.mktemp("damaged")
    scene = mc.load_scene("growth").with_changes({**SHORT, "initial.count": 6})
    (place / "scene.toml").write_text(scene.to_toml())
    (place / "data.csv").write_text(DATA)
    given = {kind: {"scene": str(place / "scene.toml"), "free": FREE} for kind in KINDS[1:4]}
    given |= _analyses(place)
    for kind, arguments in given.items():
        (place / f"{kind}.arguments").write_text(json.dumps(arguments))
    vary = {"cells.young": "1,2 kPa"}
    mc.study(scene, vary, seeds=2, output=place / "study").run(cores=1)
    (place / "own.ant").write_text(WRITTEN)
    file = place / "network.toml"
    file.write_text(WITH_NETWORK)
    mc.study(mc.load_scene(file), vary, output=place / "networked").run(cores=1)
    mc.run(file, output=place / "network", report=False, threads=1)
    (place / "own.ant").unlink()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(html, "write_page", _full)
        for kind in ("comparison", "limits"):
            with pytest.raises(OutputError):
                getattr(folder_damage, kind)(place / kind)
    for kind in ("fit", "sensitivity", "doses"):
        getattr(folder_damage, kind)(place / kind)
    shutil.copytree(place / "fit", place / "opened")
    copy = tmp_path_factory.mktemp("copy") / "whole"
    shutil.copytree(place, copy)
    found = {kind: getattr(folder_damage, kind)(copy / kind) for kind in KINDS}
    shutil.rmtree(copy)
    shutil.copytree(place, copy)
    for kind in KINDS:
        forks.load(function="folder_damage:read", **{"with": {"folder": str(copy / kind)}})
    return place, json.loads(json.dumps(found))


def _analyses(place):
    """Write the scenes of analyses, and return with what they are asked for."""
    scenes = {"doses": mc.load_scene("growth").with_changes({**SHORT, **DEATHS}),
              "comparison": PAIR.with_changes({"duration": "120 s"}),
              "limits": mc.load_scene("settle").with_changes({"initial.count": 8})}  # fmt: skip
    for name, scene in scenes.items():
        (place / f"{name}.toml").write_text(scene.to_toml())
    more = {
        "doses": {"dose": "death.apoptosis_rate", "doses": "0,0.005,0.02,0.05,0.2,0.6 1/h"},
        "comparison": {"methods": METHODS},
        "limits": {"methods": ["euler"]},
    }
    return {name: {"scene": str(place / f"{name}.toml"), **more[name]} for name in scenes}


def _full(*_, **__):
    raise OutputError("cannot write") from OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.harness
@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not limit address space")
@pytest.mark.parametrize("kind", KINDS)
def test_damaged_folders_are_read_right_or_refused(kind, folders, forks, tmp_path, pytestconfig):
    place, found = folders
    wrong, refused = [], 0
    first = pytestconfig.getoption("first_seed")
    for case in range(first, first + pytestconfig.getoption("damages")):
        (tmp_path / "case").mkdir()
        for path in place.iterdir():
            if path.is_file():
                shutil.copy(path, tmp_path / "case")
        shutil.copytree(place / kind, tmp_path / "case" / kind)
        task = {"number": case, "kind": kind, "folder": str(tmp_path / "case" / kind),
                "whole": found[kind]}  # fmt: skip
        done = forks.ask(function="folder_damage:check", limit=60.0, **{"with": task})
        refused += "refused" in done["text"]
        if done["code"] != 0:
            wrong.append((case, done["code"], done["text"][-1500:]))
        shutil.rmtree(tmp_path / "case")
    print(f"\n{kind}: {pytestconfig.getoption('damages')} damaged, {refused} refused")
    assert not wrong, "\n\n".join(f"case {k}: {code}\n{text}" for k, code, text in wrong)
