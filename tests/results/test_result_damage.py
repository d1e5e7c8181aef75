"""Result folders that are cut, flipped, edited and forged: read right, or refused with words.

``pytest tests/results/test_result_damage.py --damages 500`` damages as many as asked. Each case
runs in a process of its own: HDF5 is not Python, and can crash or hang.
"""

import math
import os
import random
import shutil
import signal
import subprocess
import sys
import tracemalloc
from contextlib import closing
from pathlib import Path

import forged
import h5py
import numpy as np
import pytest

import multicell as mc
from multicell.results.journal import Reader
from multicell.results.reader import Contents
from multicell.results.writer import Store
from multicell.simulation import Simulation

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
NETWORK = """HIF1 = 0.1; count = 20; O2 = 0.05;
HIF1' = 2e-4 - 2e-2*O2*HIF1; count' = 1e-3*HIF1*count;
at (count > 30): count = 20;
"""
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

    pytest.importorskip("sbmlode")
    pytest.importorskip("antimony")
    place = tmp_path_factory.mktemp("damage")
    (place / "hif.ant").write_text(NETWORK, encoding="utf-8")
    network = {"file": str(place / "hif.ant"), "inputs": {"O2": "oxygen"}}
    changes = {**CHANGES, "networks": {"hif": network}}
    made = {kind: place / kind.replace(" ", "-") for kind in KINDS}
    scene = mc.load_scene("spheroid").with_changes(changes)
    run = mc.run(scene, output=made["finished"], threads=1, report=False)
    assert (run.folder / "hif.network.ant").is_file()
    assert run.summary()["removals"] > 0
    assert run.summary()["divisions"] > 0
    assert len(run.frames[-1].contacts) > 0
    shutil.copytree(made["finished"], made["resumed and killed"])
    stopped("run", made["killed"], 13, json.dumps(changes))
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
    first = pytestconfig.getoption("first_seed")
    for case in range(first, first + pytestconfig.getoption("damages")):
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


@pytest.mark.harness
@pytest.mark.slow
def test_forged_folders_are_refused_in_words(folders, forks, tmp_path, pytestconfig):
    made, _ = folders
    wrong = []
    first = pytestconfig.getoption("first_seed")
    for case in range(first, first + pytestconfig.getoption("damages")):
        folder = tmp_path / "case" / "out"
        kind = ("killed", "resumed and killed", "finished")[case % 3]
        shutil.copytree(made[kind], folder)
        task = {"number": case, "folder": str(folder)}
        done = forks.ask(function="forged:check", limit=60.0, **{"with": task})
        if done["code"] != 0:
            wrong.append((case, kind, done["code"], done["text"][-1500:]))
        shutil.rmtree(tmp_path / "case")
    assert not wrong, "\n\n".join(f"case {k}, {kind}: {c}\n{text}" for k, kind, c, text in wrong)


@pytest.fixture(scope="module")
def journal(tmp_path_factory):
    """A folder with the journal of a run that was killed."""
    scene = mc.load_scene("spheroid").with_changes({**CHANGES, "initial.count": 20})
    simulation, folder = Simulation(scene, threads=1), tmp_path_factory.mktemp("journal") / "out"
    with closing(Store.create(folder, scene)) as store:
        for _ in range(3):
            store.append_history(simulation.history_row())
            store.append(simulation.frame(), simulation.lineage)
            simulation.step()
    return folder


def test_forged_headers_of_a_journal_are_refused_in_words(journal, tmp_path, capsys):
    count, refused = len(Reader(journal / "frames.journal").records), 0
    for case in range(250):
        folder = tmp_path / f"{case}"
        shutil.copytree(journal, folder)
        rng = random.Random(case)
        edit, words = forged.edit_of(rng)
        forged.rewrite(folder / "frames.journal", rng.randrange(count), edit)
        try:
            result = mc.load_result(folder)
            for k in range(len(result.frames)):
                repr(result.frames[k].cells)
            Contents(folder).whole()
        except mc.OutputError as error:
            refused += 1
            assert "damaged" in str(error)  # noqa: PT017
            assert error.damaged  # noqa: PT017
        except mc.MulticellError:
            refused += 1
        except Exception as error:
            error.add_note(f"case {case}: {words}")
            raise
        shutil.rmtree(folder)
    assert refused > 200


@pytest.mark.parametrize("name", ["frames", "offsets", "scene", "lineage/births", "history",
                                  "cells/position", "fields/oxygen/coded"])  # fmt: skip
def test_what_is_larger_than_it_can_be_is_refused_before_it_is_read(name, journal, tmp_path):
    folder = tmp_path / "out"
    shutil.copytree(journal, folder)
    mc.resume(folder, report=False, threads=1, changes={"duration": "30 min"})
    with h5py.File(folder / "frames.h5", "r+") as file:
        forged.stretch(file, name, 1 << 25)
    tracemalloc.start()
    try:
        with pytest.raises(mc.OutputError, match="larger than it can be") as found:
            mc.load_result(folder)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert found.value.damaged
    assert peak < 1 << 24


def test_numbers_that_are_packed_into_no_bits_are_refused(journal, tmp_path):
    folder = tmp_path / "out"
    shutil.copytree(journal, folder)
    mc.resume(folder, report=False, threads=1, changes={"duration": "30 min"})
    with h5py.File(folder / "frames.h5", "r+") as file:
        values = file["cells/parent"][()]
        del file["cells/parent"]
        file.create_dataset("cells/parent", data=values, maxshape=(None,), scaleoffset=0)
    with pytest.raises(mc.OutputError, match="larger than it can be"):
        mc.load_result(folder)


@pytest.mark.parametrize("change", ["name twice", "time in a row"])
def test_arrays_of_a_frame_that_hide_each_other_are_damage(change, journal, tmp_path):
    folder = tmp_path / "out"
    shutil.copytree(journal, folder)
    records = Reader(folder / "frames.journal").records
    last = max(k for k, record in enumerate(records) if record.header["kind"] == "frame")

    def edit(header, body):
        arrays = header["arrays"]
        if change == "name twice":
            arrays[-1][0] = arrays[0][0]
        else:
            arrays[0][2] = [1]
        return header, body

    forged.rewrite(folder / "frames.journal", last, edit)
    assert "none of a run" in Reader(folder / "frames.journal").damage
    with pytest.raises(mc.OutputError, match="frames 0 to 1 can be read") as refused:
        mc.load_result(folder)
    assert refused.value.damaged


@pytest.mark.parametrize("bad", [-2, 77])
@pytest.mark.parametrize("name", ["id", "kind", "phase", "state", "births/kind", "births/parent"])
def test_numbers_that_stand_for_nothing_are_damage(name, bad, journal, tmp_path):
    """Of cells, states, phases and types, which others read as indices; the scene has two types."""
    folder, path = tmp_path / "out", name if "/" in name else f"cells/{name}"
    shutil.copytree(journal, folder)
    records = Reader(folder / "frames.journal").records
    paths = [[array[0] for array in record.header.get("arrays", ())] for record in records]

    def edit(header, body):
        sizes = [int(kind[2:]) * math.prod(shape) for _, kind, shape in header["arrays"]]
        k = [array[0] for array in header["arrays"]].index(path)
        begin = sum(sizes[:k])
        values = np.frombuffer(body[begin : begin + sizes[k]], header["arrays"][k][1]).copy()
        values[-1] = bad - (1 << 62) if (name, bad) == ("id", 77) else bad
        return header, body[:begin] + values.tobytes() + body[begin + sizes[k] :]

    forged.rewrite(
        folder / "frames.journal", next(k for k, x in enumerate(paths) if path in x), edit
    )
    for read in (
        lambda: mc.load_result(folder).frames[0],
        lambda: mc.export(folder, tmp_path / "tables"),
        lambda: mc.load_result(folder).report(),
        lambda: mc.resume(folder, 0, output=tmp_path / "again", report=False, threads=1),
    ):
        with pytest.raises(mc.OutputError, match=r"stand for nothing|no older cell") as refused:
            read()
        assert refused.value.damaged
