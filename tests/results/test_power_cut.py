"""The order of system calls by which files survive a loss of power: content, name, folder."""

import re
import shutil
import subprocess
import sys

import pytest

CALLS = "write,pwrite64,ftruncate,fsync,fdatasync,rename,renameat,renameat2,unlink"
STEPS = """
import multicell as mc
scene = mc.load_scene("settle").with_changes(
    {{"duration": "5 min", "initial.count": 8, "output.every": "1 min"}}
)
{act}
"""
RUN = 'mc.run(scene, output="out", report=False)'
ACTS = {
    "run": RUN,
    "slow": "from multicell.results import journal\njournal._SYNC_EVERY = 0.0\n" + RUN,
    "resume": RUN + '\nmc.resume("out", changes={"duration": "6 min"}, report=False)',
    "report": RUN.replace(", report=False", ""),
    "export": RUN + '\nfrom multicell.report.exports import export\nexport("out", "tables")',
}
CALL = re.compile(r"^(?:\d+ +)?(\w+)\((.*)\) += (\d+)")
PLACE = re.compile(r"^\d+<(.*?)>")


def calls(act, folder):
    """Return name and paths of the system calls that change files in a folder, in their order."""
    trace = folder.parent / "trace"
    subprocess.run(
        ["strace", "-f", "-y", "-qq", "-s", "4", "-e", f"trace={CALLS}", "-o", trace,
         sys.executable, "-c", STEPS.format(act=ACTS[act])],
        check=True, cwd=folder, capture_output=True,
    )  # fmt: skip
    found = []
    for line in trace.read_text().splitlines():
        call = CALL.match(line)
        if call is None:
            continue
        name, arguments, _ = call.groups()
        opened = PLACE.match(arguments)
        if name.startswith("rename"):
            paths = [str((folder / text).resolve()) for text in re.findall(r'"([^"]*)"', arguments)]
        elif opened is not None:
            paths = [opened[1]]
        else:
            paths = [str((folder / text).resolve()) for text in re.findall(r'"([^"]*)"', arguments)]
        if paths and paths[0].startswith(str(folder)):
            found.append(("rename" if name.startswith("rename") else name, *paths))
    return found


@pytest.mark.skipif(shutil.which("strace") is None, reason="there is no strace")
@pytest.mark.parametrize("act", ACTS)
def test_content_is_on_disk_before_a_name_and_the_folder_after_it(act, tmp_path):
    folder = (tmp_path / "place").resolve()
    folder.mkdir()
    made = calls(act, folder)
    renamed = [(k, call) for k, call in enumerate(made) if call[0] == "rename"]
    assert {call[2].rpartition("/")[2] for _, call in renamed} >= {"frames.h5", "summary.json"}
    for k, (_, part, path) in renamed:
        # of one that a name was given to before, this has been checked
        touched = [call[0] for call in made[:k] if part in (call[1], call[-1])]
        assert touched[-1] in ("fsync", "fdatasync", "rename"), part
        above = path.rpartition("/")[0]
        after = [call for call in made[k + 1 :] if call[1].rpartition("/")[0] != above]
        assert ("fsync", above) in after, path


@pytest.mark.skipif(shutil.which("strace") is None, reason="there is no strace")
@pytest.mark.parametrize("act", ["run", "slow"])
def test_a_frame_is_on_disk_before_one_that_comes_much_later(act, tmp_path):
    folder = (tmp_path / "place").resolve()
    folder.mkdir()
    journal = str(folder / "out" / "frames.journal")
    made = [call[0] for call in calls(act, folder) if call[1].startswith(journal)]
    # one opening and six frames, each in one piece with the history before it
    written = [k for k, name in enumerate(made) if name == "write"]
    assert len(written) >= 7
    synced = [made[k + 1 : k + 2] == ["fsync"] for k in written]
    assert synced[0]
    assert all(synced) == (act == "slow")
    assert made.index("rename") < written[1]
