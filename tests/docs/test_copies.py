"""Commands of pages as copies of one process: they answer, end and fail as processes do."""

import importlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from page_commands import PACKAGE, ROOT
from signals import listening

pytest.importorskip("myst_nb", reason="pages are built with multicell[docs]")
sys.path.insert(0, str(ROOT / "docs" / "extensions"))
copies = importlib.import_module("copies")
requirements = importlib.import_module("requirements")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not copies.able(), reason="processes cannot be copied here"),
]
COPY = [sys.executable, "-I", "-S", copies.__file__, "command"]
REAL = [sys.executable, "-m", "multicell"]


@pytest.fixture(scope="module")
def variables(tmp_path_factory):
    """Variables of processes that ask for copies, where some packages can be refused."""
    folder = tmp_path_factory.mktemp("c")
    with pytest.MonkeyPatch.context() as patch:
        for name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
            patch.setenv(name, "1")
        patch.setenv("PYTHONPATH", str(PACKAGE))
        for name, text in requirements.variables(folder, set()).items():
            patch.setenv(name, text)
        patch.setenv(copies.ADDRESS, "")
        server = copies.start(folder, requirements.refused(["multicell", "myst-nb"]))
        found = {**os.environ}
    assert server.stdout.readline() == b"loaded\n"
    yield found
    server.communicate()
    assert server.returncode == 0


def answer(process, words, folder, variables):
    done = subprocess.run(
        [*process, *words], capture_output=True, text=True, cwd=folder, env=variables, check=False,
        input="",
    )  # fmt: skip
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (["explain", "doublet", "--set", "duration=1 h"], 0),
        (["run", "spheriod", "-o", "out"], 2),
        (["export", "out", "-o", "tables", "--tables", "cells"], 0),
    ],
)
def test_copies_answer_as_processes_do(words, code, variables, tmp_path_factory):
    folders = [tmp_path_factory.mktemp("answers", numbered=True) for _ in (COPY, REAL)]
    said = []
    for process, folder in zip((COPY, REAL), folders, strict=True):
        if words[0] == "export":
            first = ["run", "doublet", "-o", "out", "--set", "duration=1 s", "--quiet"]
            assert answer(process, [*first, "--no-report"], folder, variables) == (0, "", "")
        said.append(answer(process, words, folder, variables))
    assert said[0] == said[1]
    assert said[0][0] == code
    files = [{str(p.relative_to(f)) for p in f.rglob("*")} for f in folders]
    assert files[0] == files[1]
    for name in files[0]:
        if name.endswith(".csv"):
            assert (folders[0] / name).read_bytes() == (folders[1] / name).read_bytes()


def test_copies_find_the_packages_of_their_environment_only(variables, tmp_path):
    run = ["run", "doublet", "-o", "out", "--set", "duration=1 s", "--quiet", "--no-report"]
    assert answer(COPY, run, tmp_path, variables)[0] == 0
    export = ["export", "out", "-o", "tables", "--format", "parquet"]
    refused = {**variables, requirements.REFUSED: "pandas,pyarrow"}
    code, _, error = answer(COPY, export, tmp_path, refused)
    assert (code, "pyarrow" in error) == (2, True), error
    assert answer(COPY, export, tmp_path, variables)[0] == 0
    # what is loaded cannot be refused, and is not let through either
    code, _, error = answer(COPY, ["scenes"], tmp_path, {**variables, requirements.REFUSED: "h5py"})
    assert (code, "not of this page's environment" in error) == (1, True), error


def of_who_asks(folder, variables):
    """Return a process whose copy runs for long, when the run has begun, and the copy's number."""
    long = ["run", "growth", "-o", "out", "--set", "duration=60 d", "--set", "initial.count=200"]
    process = subprocess.Popen(
        [*COPY, *long, "--set", "output.every=1 h", "--quiet"], cwd=folder, env=variables,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=listening,
    )  # fmt: skip
    deadline = time.monotonic() + 120.0
    while not list((folder / "out").glob("frames.journal")):
        assert time.monotonic() < deadline
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.02)
    found = [p for p in Path("/proc").glob("[0-9]*/cwd") if _leads_to(p, folder)]
    (copy,) = {int(p.parent.name) for p in found} - {process.pid}
    return process, copy


def _leads_to(link, folder):
    try:
        return link.resolve(strict=True) == folder.resolve()
    except OSError:  # ended, or another user's
        return False


def test_an_interrupt_reaches_the_copy(variables, tmp_path):
    process, _ = of_who_asks(tmp_path, variables)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=120)
    assert process.returncode == 130, error
    assert "nterrupted" in error
    assert "Traceback" not in error


def test_who_is_killed_takes_the_copy_along(variables, tmp_path):
    process, copy = of_who_asks(tmp_path, variables)
    process.kill()
    process.wait()
    deadline = time.monotonic() + 60.0
    while Path(f"/proc/{copy}").exists():
        assert time.monotonic() < deadline
        time.sleep(0.02)
    assert answer(COPY, ["scenes"], tmp_path, variables)[0] == 0


@pytest.mark.parametrize("part", [0, 4, 8, 20, None])
def test_who_is_killed_while_it_asks_ends_no_server(part, variables, tmp_path):
    text = json.dumps({"kind": "command", "arguments": ["scenes"], "folder": str(tmp_path),
                       "deaf": False, "variables": variables}).encode()  # fmt: skip
    whole = copies.SIZE.pack(len(text)) + text
    with socket.socket(socket.AF_UNIX) as server:
        server.connect(variables[copies.ADDRESS])
        with open(os.devnull, "r+b") as nowhere:
            if said := whole[:part]:
                socket.send_fds(server, [said], 3 * [nowhere.fileno()])
    assert answer(COPY, ["scenes"], tmp_path, variables)[0] == 0


def test_a_copy_that_is_killed_is_seen_by_who_asks(variables, tmp_path):
    process, copy = of_who_asks(tmp_path, variables)
    os.kill(copy, signal.SIGKILL)
    process.communicate(timeout=60)
    assert process.returncode == -signal.SIGKILL
