"""Results that may not be read are intact as far as anybody knows: nothing is done to them."""

import errno
import json
import os
import shutil

import pytest
from studied import short_runs, statuses
from unprivileged import content, give_away, only_root, open_folder

import multicell as mc
from multicell.errors import OutputError, SceneError, is_machine_failure
from multicell.results import hdf5
from multicell.studies import engine
from multicell.studies.engine import run_study
from multicell.studies.status import NOTE, RunStatus


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """Return a study of three runs, which each test copies."""
    scene = short_runs(1)[0].scene
    made = mc.study(scene, seeds=3, output=tmp_path_factory.mktemp("made") / "study")
    made.run(cores=1)
    return made


@pytest.mark.slow
@only_root
@pytest.mark.harness
@pytest.mark.parametrize(
    ("file", "retry"),
    [
        *((file, True) for file in ("frames.h5", "summary.json", "scene.toml", ".")),
        *((file, False) for file in ("frames.h5", ".")),
    ],
)
def test_what_another_user_may_not_read_is_never_removed(file, retry, study, forks, tmp_path):
    first, second, _ = study.plan.names
    with open_folder() as place:
        folder, copy = place / "study", tmp_path / "copy"
        shutil.copytree(study.folder, folder)
        give_away(folder)
        hidden = folder / "runs" / first / file
        hidden.chmod(0o700 if hidden.is_dir() else 0o600)
        cut = folder / "runs" / second / "summary.json"
        cut.write_text("{")
        os.chmod(cut, 0o666)
        before = content(folder / "runs" / first)
        shutil.copytree(folder, copy)
        task = {"folder": str(folder), "copy": str(copy), "retry": retry}
        done = forks.ask(function="unprivileged:carry_out", **{"with": task})
        assert done["code"] == 0, done["text"]
        found = json.loads(done["text"].splitlines()[-1])
        assert found["states"] == [["failed", "unreadable"], ["failed", "damage"], ["done", ""]]
        (state, reason), other, last = found["outcomes"]
        assert (state, reason[:15]) == ("failed", "cannot be read:")
        assert "Permission denied" in reason
        assert (other[0], last[0]) == ("done" if retry else "failed", "done")
        assert content(folder / "runs" / first) == before
        named = [p.name for p in (folder / "runs").iterdir() if ".damaged-" in p.name]
        assert named == ([f"{second}.damaged-1"] if retry else [])


TROUBLES = {
    "locked": BlockingIOError(errno.EAGAIN, "unable to lock file"),
    "too many open files": OSError(errno.EMFILE, "Too many open files"),
    "gone": FileNotFoundError(errno.ENOENT, "No such file"),
    "stale": OSError(errno.ESTALE, "Stale file handle"),
    "broken disk": OSError(errno.EIO, "Input/output error"),
    "no memory": MemoryError(),
}


@pytest.mark.parametrize("trouble", TROUBLES)
def test_a_failure_of_the_machine_is_no_damage(trouble, tmp_path, monkeypatch):
    runs = short_runs(2)
    run_study(runs, tmp_path, cores=1)
    before = content(tmp_path)

    def fails(*_, **__):
        raise TROUBLES[trouble]

    monkeypatch.setattr("multicell.studies.status._KNOWN", {})
    monkeypatch.setattr(hdf5.h5py, "File", fails)
    assert [s.kind for s in statuses(runs, tmp_path)] == ["unreadable"] * 2
    for _ in range(2):
        outcomes = run_study(runs, tmp_path, cores=1, retry=True)
        assert [outcome.state for outcome in outcomes] == ["failed"] * 2
    monkeypatch.undo()
    assert content(tmp_path) == before
    assert [s.state for s in statuses(runs, tmp_path)] == ["done"] * 2


def test_a_run_whose_files_become_unreadable_meanwhile_is_left(tmp_path, monkeypatch):
    (run,) = short_runs(1)
    run_study([run], tmp_path, cores=1)
    place = tmp_path / "runs" / run.name
    (place / "frames.h5").write_bytes(b"nothing of HDF5")
    damaged = content(place)
    usual, seen = engine.run_status, []

    def known(name, folder, *, ours=False, whole=False):
        seen.append(ours)
        found = usual(name, folder, ours=ours, whole=whole)
        if not ours:
            return found
        return RunStatus(name, "failed", "cannot be read: locked", kind="unreadable")

    monkeypatch.setattr(engine, "run_status", known)
    (outcome,) = run_study([run], tmp_path, cores=1, retry=True)
    assert (outcome.state, outcome.reason) == ("failed", "cannot be read: locked")
    assert any(seen)
    assert {n: c for n, c in content(place).items() if n != NOTE} == damaged


def test_the_cause_of_an_error_says_whether_the_machine_was_it():
    def raised(cause, kind=OutputError):
        error = kind("", "words") if kind is SceneError else kind("words")
        error.__cause__ = cause
        return error

    machine = PermissionError(errno.EACCES, "Permission denied")
    assert is_machine_failure(raised(machine))
    assert is_machine_failure(raised(raised(machine), SceneError))
    assert not is_machine_failure(raised(IsADirectoryError(errno.EISDIR, "Is a directory")))
    assert not is_machine_failure(raised(OSError("truncated file")))
    assert not is_machine_failure(raised(KeyError("frames")))
    assert not is_machine_failure(None)
