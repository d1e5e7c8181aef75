"""One meaning for each exit code, whatever the command; the table of the documentation."""

import errno
import os
import re
from pathlib import Path

import pytest
from click.testing import CliRunner
from full_disk import SHORT, WRITING, prepare

import multicell as mc
from multicell.cli.main import main
from multicell.errors import (
    ClusterError,
    DataError,
    ExitCode,
    FitFailed,
    OutputError,
    SceneError,
    exit_code_of,
)
from multicell.results import folder as folders

DOCS = Path(__file__).parents[2] / "docs" / "using.md"


def code(*arguments):
    answer = CliRunner().invoke(main, [str(a) for a in arguments])
    return answer.exit_code, answer.stderr.strip().splitlines()


def test_the_documentation_has_the_table_of_the_code():
    rows = re.findall(r"^\| (\d+) \| (.+) \|$", DOCS.read_text("utf-8"), re.MULTILINE)
    assert rows == [(str(int(code)), code.words) for code in ExitCode]


def test_done():
    assert code("scenes")[0] == ExitCode.DONE


@pytest.mark.slow
def test_failed(tmp_path):
    never = ["--set", "integrator=cvode", "--set", "integrator.max_steps=1"]
    assert code("run", "settle", "-o", tmp_path / "o", *never)[0] == ExitCode.FAILED
    own = tmp_path / "mine.py"
    own.write_text(
        "class Broken:\n    def integrate(self, system, position):\n        return 1.0 / 0.0\n"
    )
    given = ["run", "settle", "-o", tmp_path / "p", "--integrator", f"{own}:Broken"]
    ended, lines = code(*given)
    assert (ended, lines[-1][:28]) == (ExitCode.FAILED, "Error: your own code fails: "), lines


@pytest.mark.parametrize("arguments", [["run", "no-such-scene", "-o", "x"], ["run", "growth"],
                                       ["export", "nowhere", "-o", "x"], ["nonsense"]])  # fmt: skip
def test_refused(arguments):
    assert code(*arguments)[0] == ExitCode.REFUSED


def test_a_damaged_file_is_refused(tmp_path):
    assert code("run", "growth", "-o", tmp_path / "o", *SHORT, "--no-report")[0] == 0
    (tmp_path / "o" / "frames.h5").write_bytes(b"something else")
    assert code("export", tmp_path / "o", "-o", tmp_path / "t")[0] == ExitCode.REFUSED


def test_a_bug_and_an_interrupt(monkeypatch):
    def raising(error):
        def explain(*_, **__):
            raise error

        monkeypatch.setattr("multicell.report.explain.scene.explain", explain)
        return code("explain", "settle")[0]

    assert raising(KeyError("x")) == ExitCode.BUG
    assert raising(KeyboardInterrupt()) == ExitCode.INTERRUPTED
    assert raising(MemoryError()) == ExitCode.MACHINE
    assert raising(BrokenPipeError(errno.EPIPE, "Broken pipe")) == ExitCode.MACHINE


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """Return a run, a study and data for a fit."""
    place = tmp_path_factory.mktemp("done")
    prepare(place, code)
    return place


@pytest.mark.parametrize("name", [name for name in WRITING if name != "study run"])
def test_a_full_disk_ends_every_command_alike(name, done, tmp_path, monkeypatch):
    if "network" in name:
        pytest.importorskip("sbmlode")
        pytest.importorskip("antimony")
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def refused(*_, **__):
        raise full

    for what in ("new_file", "sync_file"):
        monkeypatch.setattr(folders, what, refused)
    monkeypatch.setattr("multicell.results.journal.new_file", refused)
    monkeypatch.setattr("multicell.report.exports.files.sync_file", refused)
    ended, lines = code(*WRITING[name](done, tmp_path / "out"))
    assert (ended, lines[-1][-23:]) == (ExitCode.MACHINE, "No space left on device"), lines
    assert sum(line.startswith("Error") for line in lines) == 1


def caused(error, cause):
    error.__cause__ = cause
    return error


def test_errors_have_the_code_of_their_cause():
    denied = PermissionError(errno.EACCES, "Permission denied")
    for error in (OutputError("x"), SceneError("", "x"), DataError("y", "x"), FitFailed("x")):
        assert exit_code_of(error) in (ExitCode.REFUSED, ExitCode.FAILED)
        assert exit_code_of(caused(error, denied)) == ExitCode.MACHINE
    assert exit_code_of(OutputError("x", in_use=True)) == ExitCode.MACHINE
    assert exit_code_of(caused(OutputError("x", damaged=True), OSError(5, "I/O"))) == 2
    assert exit_code_of(ClusterError("x", "y")) == ExitCode.REFUSED
    assert exit_code_of(ValueError("x")) == ExitCode.BUG
    assert mc.SceneError("", "x").exit_code == ExitCode.REFUSED
