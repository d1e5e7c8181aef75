"""The order of system calls by which files survive a loss of power: content, name, folder."""

import re
import shutil
import subprocess
import sys

import pytest

CALLS = "write,pwrite64,ftruncate,fsync,fdatasync,rename,renameat,renameat2,unlink"
STEPS = """
import multicell as mc
from multicell.results import journal
journal._SYNC_EVERY = 0.0  # frames that come later than a second after each other
scene = mc.load_scene("settle").with_changes(
    {"duration": "5 min", "initial.count": 8, "output.every": "1 min"}
)
mc.run(scene, output="out")
mc.resume("out", changes={"duration": "6 min"}, report=False)
mc.export("out", "tables")
"""
CALL = re.compile(r"^(?:\d+ +)?(\w+)\((.*)\) += (\d+)")
PLACE = re.compile(r"^\d+<(.*?)>")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Return a folder, and name and paths of the calls that change files in it, in their order."""
    folder = tmp_path_factory.mktemp("power").resolve() / "place"
    folder.mkdir()
    trace = folder.parent / "trace"
    subprocess.run(
        ["strace", "-f", "-y", "-qq", "-s", "4", "-e", f"trace={CALLS}", "-o", trace,
         sys.executable, "-c", STEPS],
        check=True, cwd=folder, capture_output=True,
    )  # fmt: skip
    found = []
    for line in trace.read_text().splitlines():
        call = CALL.match(line)
        if call is None:
            continue
        name, arguments, _ = call.groups()
        opened = None if name.startswith("rename") else PLACE.match(arguments)
        paths = [str((folder / text).resolve()) for text in re.findall(r'"([^"]*)"', arguments)]
        paths = paths if opened is None else [opened[1]]
        if paths and paths[0].startswith(str(folder)):
            found.append(("rename" if name.startswith("rename") else name, *paths))
    return folder, found


@pytest.mark.skipif(shutil.which("strace") is None, reason="there is no strace")
@pytest.mark.slow
def test_content_is_on_disk_before_a_name_and_the_folder_after_it(made):
    _, made = made
    renamed = [(k, call) for k, call in enumerate(made) if call[0] == "rename"]
    names = {call[2].rpartition("/")[2] for _, call in renamed}
    assert names >= {"frames.h5", "scene.toml", "summary.json", "report.html", "cells.csv"}
    for k, (_, part, path) in renamed:
        # of one that a name was given to before, this has been checked
        touched = [call[0] for call in made[:k] if part in (call[1], call[-1])]
        assert touched[-1] in ("fsync", "fdatasync", "rename"), part
        above = path.rpartition("/")[0]
        after = [call for call in made[k + 1 :] if call[1].rpartition("/")[0] != above]
        assert ("fsync", above) in after, path


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("strace") is None, reason="there is no strace")
def test_a_frame_is_on_disk_before_one_that_comes_much_later(made):
    folder, made = made
    journal = str(folder / "out" / "frames.journal")
    made = [call[0] for call in made if call[1].startswith(journal)]
    made = made[: made.index("unlink")]  # of the first run
    # one opening and six frames, each in one piece with the history before it
    written = [k for k, name in enumerate(made) if name == "write"]
    assert len(written) >= 7
    synced = [made[k + 1 : k + 2] == ["fsync"] for k in written]
    assert all(synced)
    assert made.index("rename") < written[1]
