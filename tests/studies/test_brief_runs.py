"""Runs of a study that take less than a second write once, at their end; longer ones as all."""

import errno
import os

import pytest
from stored import assert_same_bits
from studied import run_of, statuses

import multicell as mc
from multicell.errors import OutputError
from multicell.results import folder as folders
from multicell.results import hdf5, writer
from multicell.results.journal import Journal
from multicell.results.observable import OWN_OBSERVABLES
from multicell.studies import engine
from multicell.studies.engine import run_study
from multicell.studies.runs import run_digest
from multicell.studies.status import run_folder

SCENE = mc.load_scene("growth").with_changes({"duration": "3 h", "output.every": "1 h"})


@pytest.fixture
def alone(tmp_path):
    """Return the folder of the same run outside a study."""
    mc.run(SCENE, output=tmp_path / "alone", report=False, threads=1)
    return tmp_path / "alone"


@pytest.mark.parametrize("second", [0.0, 1e9])
def test_the_folder_is_that_of_a_run_outside_a_study(second, alone, tmp_path, monkeypatch):
    monkeypatch.setattr(writer, "_HISTORY_EVERY", second)
    begun = []
    create = Journal.create
    monkeypatch.setattr(
        Journal, "create", classmethod(lambda _, *given: begun.append(given) or create(*given))
    )
    run = run_of(SCENE)
    [outcome] = run_study([run], tmp_path, cores=1)
    assert outcome.state == "done"
    assert len(begun) == (second == 0.0)
    place = run_folder(tmp_path, run.name)
    assert_same_bits(place, alone)
    assert sorted(os.listdir(place)) == ["frames.h5", "scene.toml", "summary.json"]
    assert [found.state for found in statuses([run], tmp_path)] == ["done"]


def test_a_kill_in_the_first_second_leaves_nothing_to_continue(alone, tmp_path, monkeypatch):
    class Killed(BaseException):
        pass

    def killed(store):
        # what a dead process leaves: its files, and a lock that nobody holds
        assert os.listdir(store.folder) == [folders.LOCK]
        raise Killed

    run = run_of(SCENE)
    with monkeypatch.context() as patch:
        patch.setattr(writer.Store, "settle", killed)
        with pytest.raises(Killed):
            run_study([run], tmp_path, cores=1)
    assert [found.state for found in statuses([run], tmp_path)] == ["waiting"]
    run_study([run], tmp_path, cores=1)
    assert_same_bits(run_folder(tmp_path, run.name), alone)


def test_frames_that_cannot_be_written_at_the_end_are_kept_in_a_journal(
    alone, tmp_path, monkeypatch
):
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def refused(*given, **how):
        raise OutputError("cannot write frames.h5") from full

    run = run_of(SCENE)
    with monkeypatch.context() as patch:
        patch.setattr(writer, "write_bytes", refused)
        patch.setattr(hdf5, "write_hdf5", refused)
        [outcome] = run_study([run], tmp_path, cores=1)
    assert (outcome.state, outcome.kind) == ("failed", "machine")
    place = run_folder(tmp_path, run.name)
    assert len(mc.load_result(place).frames) == 4
    [outcome] = run_study([run], tmp_path, cores=1)
    assert outcome.state == "done"
    assert_same_bits(place, alone)


@pytest.mark.parametrize("how", ["flipped", "cut"])
def test_a_file_that_does_not_read_back_counts_as_nothing(how, tmp_path, monkeypatch):
    sync, hurt = folders.sync_file, []

    def hurting(path):
        if path.name == "frames.h5.part":
            data = bytearray(path.read_bytes())
            data[data.index(b"[growth]")] ^= 4  # in a data set that is part of its header
            path.write_bytes(data if how == "flipped" else data[:-50])
            hurt.append(path)
        sync(path)

    monkeypatch.setattr(folders, "sync_file", hurting)
    run = run_of(SCENE)
    [outcome] = run_study([run], tmp_path, cores=1)
    assert outcome.state == "failed"
    assert len(hurt) >= 2  # from memory, and from the journal
    assert not (run_folder(tmp_path, run.name) / "frames.h5").exists()


def test_runs_of_one_point_have_the_names_and_scenes_of_their_seeds(tmp_path):
    study = mc.study(SCENE, vary={"drag.viscosity": [1.0, 2.0]}, seeds=3, output=tmp_path / "s")
    for run in study.runs:
        changes = {"drag.viscosity": run.scene.drag.viscosity, "seed": run.coordinates["seed"]}
        assert run.scene == SCENE.with_changes(changes)
        assert run.name == run_digest(run.scene)
    assert len({run.name for run in study.runs}) == 6
    assert [run.name for run in study.runs] == list(study.plan.names)


def test_names_of_folders_are_on_the_disk_at_the_end_of_a_study(tmp_path, monkeypatch):
    done, fsync = [], os.fsync

    def noted(descriptor):
        done.append(os.path.basename(os.readlink(f"/proc/self/fd/{descriptor}")))
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", noted)
    monkeypatch.setattr(writer, "_HISTORY_EVERY", 1e9)
    monkeypatch.setattr(engine, "_SYNC", 1e9)
    run = run_of(SCENE)
    run_study([run], tmp_path, cores=1)
    parts = ["scene.toml.part", "frames.h5.part", "summary.json.part"]
    assert done == [*parts, run.name, "runs"]


def test_names_are_on_the_disk_each_second_of_a_study(tmp_path, monkeypatch):
    done, sync_folder = [], engine.sync_folder
    runs = [run_of(SCENE.with_changes({"seed": seed})) for seed in (1, 2)]

    def noted(place):
        done.append(place.name)
        sync_folder(place)

    monkeypatch.setattr(engine, "sync_folder", noted)
    monkeypatch.setattr(writer, "_HISTORY_EVERY", 1e9)
    monkeypatch.setattr(engine, "_SYNC", 0.0)
    run_study(runs, tmp_path, cores=1, progress=lambda outcome: done.append("told"))
    assert done == [*(part for run in runs for part in (run.name, "runs", "told")), "runs"]


@pytest.mark.parametrize("cores", [1, 2])
def test_an_own_observable_that_is_not_loaded_is_refused_before_anything_runs(cores, tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(
        "import multicell as mc\n@mc.observable(name='of a study', unit='um')\n"
        "def absent(state):\n    return 1.0\n"
    )
    own = mc.load_observable(f"{path}:absent")
    run = run_of(SCENE.with_observables(own))
    del OWN_OBSERVABLES[own.function]
    with pytest.raises(mc.SceneError, match="absent"):
        run_study([run], tmp_path, cores=cores)
    assert os.listdir(tmp_path / "runs") == []
