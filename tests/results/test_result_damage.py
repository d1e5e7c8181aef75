"""Result folders that are cut, flipped, edited and forged: read right, or refused with words.

``pytest tests/results/test_result_damage.py --damages 500`` damages as many as asked. Each case
runs in a process of its own: HDF5 is not Python, and can crash or hang.
"""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import multicell as mc

CHANGES = {
    "duration": "3 h",
    "initial.count": 40,
    "initial.stage": "uniform",
    "growth.cycle_time": "4 h",
    "types": {"a": {}, "b": {}},
    "nutrients.oxygen.boundary": "0.025 mM",
    "nutrients.oxygen.quiescence": "0.0225 mM",
    "nutrients.oxygen.necrosis": "0.0223 mM",
    "death.lysis_time": "1 h",
    "output.every": "20 min",
}
KINDS = ("finished", "killed", "resumed and killed")

STOPS = """
import json, os, signal, sys
import multicell as mc

def stop(simulation):
    if simulation.step_index == int(sys.argv[3]):
        os.kill(os.getpid(), signal.SIGKILL)

if sys.argv[1] == "run":
    scene = mc.load_scene("spheroid").with_changes(json.loads(sys.argv[4]))
    mc.run(scene, output=sys.argv[2], threads=1, progress=stop)
else:
    mc.resume(sys.argv[2], 3, threads=1, progress=stop, report=False)
"""


def stopped(*arguments):
    package = str(Path(mc.__file__).parents[1])
    done = subprocess.run(
        [sys.executable, "-c", STOPS, *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": package},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == -signal.SIGKILL, done.stderr


@pytest.fixture(scope="session")
def folders(tmp_path_factory):
    """Folders of the same run: finished, killed, and killed after it was resumed."""
    import json

    place = tmp_path_factory.mktemp("damage")
    made = {kind: place / kind.replace(" ", "-") for kind in KINDS}
    scene = mc.load_scene("spheroid").with_changes(CHANGES)
    run = mc.run(scene, output=made["finished"], threads=1, report=False)
    assert run.summary()["removals"] > 0
    assert run.summary()["divisions"] > 0
    assert len(run.frames[-1].contacts) > 0
    shutil.copytree(made["finished"], made["resumed and killed"])
    stopped("run", made["killed"], 13, json.dumps(CHANGES))
    stopped("resume", made["resumed and killed"], 14)
    whole = place / "whole"
    shutil.copytree(made["finished"], whole)
    mc.export(whole, whole / "tables")
    for kind in KINDS[1:]:
        assert (made[kind] / "frames.journal").is_file()
    assert (made["resumed and killed"] / "frames.h5").is_file()
    return made, whole


@pytest.mark.harness
@pytest.mark.slow
def test_damaged_folders_are_read_right_or_refused(folders, forks, tmp_path, pytestconfig):
    made, whole = folders
    wrong, refused = [], 0
    for case in range(pytestconfig.getoption("damages")):
        folder = tmp_path / "case" / "out"
        shutil.copytree(made[KINDS[case % len(KINDS)]], folder)
        task = {"number": case, "folder": str(folder), "whole": str(whole)}
        done = forks.ask(function="damage:check", limit=60.0, **{"with": task})
        refused += "refused" in done["text"]
        if done["code"] != 0:
            wrong.append((case, KINDS[case % len(KINDS)], done["code"], done["text"][-1500:]))
        shutil.rmtree(tmp_path / "case")
    assert not wrong, "\n\n".join(
        f"case {k}, {kind}: {code}\n{text}" for k, kind, code, text in wrong
    )
    assert refused > 0.3 * pytestconfig.getoption("damages")
