"""Runs that are killed, and runs whose disk gets full: nothing that was saved is ever lost.

``pytest tests/results/test_kill_and_full_disk.py --kills 100 --full-disks 40`` does as
many as asked.
"""

import random
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from stored import assert_same_bits

import multicell as mc
from multicell.results.folder import LIVE, PASSING
from multicell.results.reader import Contents

# cells grow, divide, starve, die and are removed; many frames, with a field each
CHANGES = {
    "duration": "10 h",
    "initial.count": 60,
    "initial.stage": "uniform",
    "growth.cycle_time": "6 h",
    "nutrients.oxygen.boundary": "0.025 mM",
    "nutrients.oxygen.quiescence": "0.021 mM",
    "nutrients.oxygen.necrosis": "0.0205 mM",
    "death.lysis_time": "2 h",
    "output.every": "30 min",
}
NETWORK = """HIF1 = 0.1; count = 20; O2 = 0.05; eaten := 200*O2*HIF1;
HIF1' = 2e-4 - 2e-2*O2*HIF1; count' = 1e-3*HIF1*count;
at (count > 30): count = 20;
"""
OWN = {
    "networks.hif.inputs": '{O2 = "oxygen"}',
    "networks.hif.fluxes": '{oxygen = "secretion: eaten"}',
    "responses": '{kill = {behaviour = "apoptosis rate", signal = "hif.HIF1", half = 1, '
    'largest = "0.02 1/h"}}',
}
"""Changes of a run with networks, which change a field and let cells die."""


class Undisturbed(NamedTuple):
    """A run that nothing has disturbed, how long it took, s, its settings, whether with a page."""

    folder: Path
    seconds: float
    settings: list[str]
    page: bool

    def command(self, verb, folder, *more):
        more = [*more, "--quiet", "--threads", "1", *([] if self.page else ["--no-report"])]
        if verb == "run":
            return ["run", "spheroid", "-o", folder, *self.settings, *more]
        return ["resume", folder, *more]


def summary(folder):
    table = mc.load_result(folder).summary()
    return {
        name: entry
        for name, entry in table.items()
        if name not in ("wall", "threads", "peak_memory")
    }


@pytest.fixture(scope="module", params=["fields", "networks"])
def undisturbed(forks, tmp_path_factory, request):
    place = tmp_path_factory.mktemp("undisturbed")
    folder, changes = place / "out", CHANGES
    if request.param == "networks":
        pytest.importorskip("sbmlode")
        pytest.importorskip("antimony")
        (place / "hif.ant").write_text(NETWORK, encoding="utf-8")
        changes = {**CHANGES, **OWN, "networks.hif.file": f'"{place / "hif.ant"}"'}
    settings = [part for key, value in changes.items() for part in ("--set", f"{key}={value}")]
    # of runs with networks nothing stands on a page, which takes longer than they do
    made = Undisturbed(folder, 0.0, settings, page=request.param == "fields")
    done = forks.multicell(*made.command("run", folder), load=True)
    run = mc.load_result(folder)
    assert run.summary()["divisions"] > 5
    assert run.summary()["removals"] > 0
    assert len(run.frames) == 21
    assert (folder / "hif.network.ant").is_file() == (request.param == "networks")
    return made._replace(seconds=done["seconds"])


def assert_a_beginning(folder, whole):
    """Hold what a folder holds against the run that nothing disturbed; return how many frames."""
    try:
        run = mc.load_result(folder)
    except mc.OutputError as error:
        assert "there are no results" in str(error)  # noqa: PT017
        return 0
    here, there = Contents(folder), Contents(whole)
    count = len(run.frames)
    assert [place.digest for place in here.places] == [p.digest for p in there.places[:count]]
    for k, frame in enumerate(run.frames):
        assert frame.step == there.places[k].step_index
    for name, column in there.history().items():
        rows = here.history().get(name, np.empty(0))
        assert rows.tobytes() == column[: len(rows)].tobytes()
    if count:
        whole_run = mc.load_result(whole)
        born = whole_run.lineage["birth_time"] <= run.frames[-1].time
        np.testing.assert_array_equal(run.lineage["id"], whole_run.lineage["id"][born])
    return count


def finish(forks, folder, undisturbed):
    """Go on in a folder until its run is complete, and compare it with the undisturbed one."""
    whole = undisturbed.folder
    count = assert_a_beginning(folder, whole)
    verb = ["resume", folder] if count else ["run", folder, "--overwrite"]
    done = forks.multicell(*undisturbed.command(*verb))
    if done["code"] == 2:
        assert "ends with the frame" in done["text"], done["text"]  # only its report was missing
    else:
        assert done["code"] == 0, done["text"]
        assert (folder / "report.html").is_file() == undisturbed.page
        assert not list(folder.glob("*.part"))
    assert_same_bits(folder, whole)
    assert summary(folder) == summary(whole)
    if done["code"] == 2 and undisturbed.page:
        mc.load_result(folder).report()  # as the command ``view`` does
    assert not {entry.name for entry in folder.iterdir()} & {*PASSING, *LIVE}


@pytest.mark.harness
@pytest.mark.slow
def test_killed_runs_go_on_to_the_same_bits(forks, undisturbed, tmp_path, pytestconfig):
    whole = undisturbed.folder
    for case in range(pytestconfig.getoption("kills")):
        rng = random.Random(case)
        folder = tmp_path / f"run{case}"
        how = _moment(rng, folder, undisturbed)
        killed = forks.multicell(*undisturbed.command("run", folder), **how)
        assert killed["code"] in (0, -9), (case, killed)
        for again in range(rng.choice([0, 0, 1, 2])):
            if assert_a_beginning(folder, whole) and killed["code"] == -9:
                how = _moment(rng, folder, undisturbed)
                killed = forks.multicell(*undisturbed.command("resume", folder), **how)
                assert killed["code"] in (0, 2, -9), (case, again, killed)
        try:
            finish(forks, folder, undisturbed)
        except BaseException as error:
            error.add_note(f"kill {case}")
            raise


def _moment(rng, folder, undisturbed):
    """Return a moment to kill: any, or one at which a file is about to be replaced."""
    pictures = ("growth.png.part", "live.png.part", "live.png") if undisturbed.page else ()
    part = rng.choice([None, None, "frames.h5.part", "frames.journal", "summary.json", *pictures])
    if part is None:
        return {"kill_after": rng.uniform(0.0, 1.1 * undisturbed.seconds)}
    return {"kill_when": str(folder / part), "delay": rng.choice([0.0, rng.uniform(0.0, 0.02)])}


@pytest.mark.harness
@pytest.mark.slow
def test_a_full_disk_ends_a_run_with_one_error_and_loses_nothing(
    forks, undisturbed, small_disk, pytestconfig
):
    whole = undisturbed.folder
    mount, unmount = small_disk
    size = sum(entry.stat().st_size for entry in whole.iterdir()) / 1024.0
    stopped = 0
    for case in range(pytestconfig.getoption("full_disks")):
        rng = random.Random(1000 + case)
        try:
            folder = mount(_size(rng, case, size)) / "out"
            done = forks.multicell(*undisturbed.command("run", folder))
            stopped += _stopped_with_words(done, folder, whole)
            if rng.random() < 0.5 and done["code"] == 3 and Contents(folder).places:
                mount(int(rng.uniform(0.5, 2.0) * size) + 200)
                done = forks.multicell(*undisturbed.command("resume", folder))
                _stopped_with_words(done, folder, whole)
            mount(int(20 * size))
            if done["code"] != 0:
                finish(forks, folder, undisturbed)
        except BaseException as error:
            error.add_note(f"full disk {case}")
            raise
        finally:
            unmount()
    print(
        f"\n{stopped} runs found their disk full, on {pytestconfig.getoption('full_disks')} disks"
    )
    if pytestconfig.getoption("full_disks"):
        assert stopped


def _size(rng, case, size):
    """Return a size of the disk in kB at which it gets full in the run, or at its end."""
    return int(rng.uniform(0.02, 0.9) * size) if case % 2 else int(rng.uniform(0.6, 2.0) * size)


def _stopped_with_words(done, folder, whole):
    """Check how a run ended whose disk may have been full; return whether it was."""
    if done["code"] == 0:
        return False
    lines = done["text"].strip().splitlines()
    assert len(lines) == 1, done["text"]
    assert lines[0].startswith("Error: "), done["text"]
    complete = "ends with the frame" in lines[0]
    if not complete:
        assert "No space left" in lines[0], done["text"]
    count = assert_a_beginning(folder, whole) if folder.is_dir() else 0
    # before the first step the folder could not be used; a run that was complete needs nothing
    if count and not complete:
        assert done["code"] == 3
    return True
