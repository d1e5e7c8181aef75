"""Every command on a disk that gets full: one line, one exit code, and the same command continues.

``pytest tests/cli/test_full_disks.py --full-disks 60`` tries as many disks.
"""

import json
import random
import re
import shutil
import sys

import pytest
from full_disk import IN_PLACE, SHORT, WRITING
from network_models import WITH_NETWORK, WRITTEN
from physicell_project import writer

import multicell as mc
from multicell.errors import ExitCode

BIG = 64 * 1024  # kB: more than any of them writes


@pytest.fixture(scope="module")
def done(forks, tmp_path_factory):
    """Return a run, a study and data for a fit, and let the processes load what commands need."""
    place = tmp_path_factory.mktemp("done")
    vary = ["--vary=cells.young=1,2 kPa"]
    for words in (
        ["run", "growth", "-o", place / "run", *SHORT, "--no-report"],
        ["study", "new", "growth", "-o", place / "study", *SHORT, *vary],
        ["study", "run", place / "study", "--cores", 1, "--no-report"],
        ["study", "new", "growth", "-o", place / "planned", *SHORT, *vary],
    ):
        ended = forks.multicell(*words)
        assert ended["code"] == 0, ended["text"]
    (place / "data.csv").write_text("time / h,diameter / um\n0.5,15\n1,15\n1.5,16\n2,16\n")
    ended = forks.multicell(*WRITING["fit"](place, place / "fit"))
    assert ended["code"] == 0, ended["text"]
    (place / "own.ant").write_text(WRITTEN)
    (place / "network.toml").write_text(WITH_NETWORK)
    writer(place)()
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
            ended = forks.multicell(*words)
            if case is None:
                assert ended["code"] == 0, ended["text"]
                size = written(disk) / 1024.0 - held
                continue
            said = [line for line in ended["text"].splitlines() if line.startswith("Error")]
            assert ended["code"] in (ExitCode.DONE, ExitCode.MACHINE), (case, ended)
            assert "Traceback" not in ended["text"]
            assert "HDF5" not in ended["text"]
            if ended["code"]:
                # a study names each run that failed
                runs = name == "study run" and "No space left on device" in ended["text"]
                assert len(said) == 1 or (runs and not said), ended["text"]
                assert runs or "No space left on device" in said[0]
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
            assert all("No space left on device" in words for words in said), (case, ended)
            stopped += bool(said)
        finally:
            unmount()
    assert stopped
