"""Every command on a disk that gets full: one line, one exit code, and the same command continues.

``pytest tests/cli/test_full_disks.py --full-disks 60`` tries as many disks.
"""

import json
import random
import re
import shutil
import sys

import pytest
from full_disk import IN_PLACE, WRITING, prepare

import multicell as mc
from multicell.errors import ExitCode

FULL = "No space left on device"
BIG = 64 * 1024  # kB: more than any of them writes


@pytest.fixture(scope="module")
def done(forks, tmp_path_factory):
    """Return a run, a study and data for a fit, and let the processes load what commands need."""
    place = tmp_path_factory.mktemp("done")

    def multicell(*words):
        ended = forks.multicell(*words, load=True)
        return ended["code"], ended["text"]

    prepare(place, multicell)
    return place


def written(folder, before=()):
    return sum(p.stat().st_size for p in folder.rglob("*") if p.is_file() and p not in before)


@pytest.mark.harness
@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="small disks are mounted on Linux")
@pytest.mark.parametrize("name", WRITING)
def test_a_full_disk_ends_a_command_in_a_line_and_it_continues(
    name, done, forks, small_disk, pytestconfig
):
    mount, unmount = small_disk
    names = list(WRITING)
    most = pytestconfig.getoption("full_disks")
    size = 0.0  # kB that it writes
    cases = [k for k in range(max(most, len(names))) if names[k % len(names)] == name]
    for case in [None, *cases]:
        try:
            disk = mount(BIG)
            at = done
            if name in IN_PLACE:
                at = disk
                shutil.copytree(done / IN_PLACE[name], disk / IN_PLACE[name])
            held = written(disk) / 1024.0
            if case is not None:
                disk = mount(int(1.1 * held + random.Random(case).uniform(0.02, 1.0) * size) + 8)
            words = WRITING[name](at, disk / "out")
            ended = forks.multicell(*words, load=case is None)
            if case is None:
                size = written(disk) / 1024.0 - held
                continue
            said = [line for line in ended["text"].splitlines() if line.startswith("Error")]
            assert ended["code"] in (ExitCode.DONE, ExitCode.MACHINE), (case, ended)
            assert "Traceback" not in ended["text"]
            assert "HDF5" not in ended["text"]
            if ended["code"]:
                full = [line for line in ended["text"].splitlines() if FULL in line]
                assert full, ended["text"]
                if name != "study run":  # which names each run that failed
                    assert said == full
                    assert len(said) == 1
                mount(BIG)
                again = forks.multicell(*words)
                if again["code"] != ExitCode.DONE:  # only its report was lacking
                    assert again["code"] == ExitCode.REFUSED
                    assert re.search("ends with the frame|not empty", again["text"])
        finally:
            unmount()


@pytest.mark.harness
@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="small disks are mounted on Linux")
def test_a_full_disk_under_a_page_with_sliders_is_said_on_it(done, forks, small_disk, pytestconfig):
    mount, unmount = small_disk
    scene = mc.load_scene("growth").with_changes({"duration": "2 h", "output.every": "10 min"})
    (done / "played.toml").write_text(scene.to_toml())
    task = {"way": "play", "source": str(done / "played.toml")}
    stopped = 0
    for case in range(pytestconfig.getoption("full_disks")):
        try:
            disk = mount(random.Random(case).choice([4, 8, 12, 30, 80, 150, BIG]))
            ended = forks.ask(
                function="full_disk:attempt", limit=300.0, **{"with": {**task, "folder": str(disk)}}
            )
            assert ended["code"] == 0, (case, ended)
            said = list(filter(None, json.loads(ended["text"].splitlines()[-1])["said"]))
            assert all(FULL in words for words in said), (case, ended)
            stopped += bool(said)
        finally:
            unmount()
    assert stopped
