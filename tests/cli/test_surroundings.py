"""The working folder and odd variables decide nothing: commands work, or refuse in words."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import multicell as mc

SHORT = ["--set", "duration=4 h", "--set", "initial.count=8", "--threads", "1"]
HOSTILE = "import os\nopen(os.path.join(os.path.dirname(os.path.abspath(__file__)), 'RAN'), 'w')\n"
MODULES = ("typing", "json", "click", "numpy", "numba", "matplotlib", "multiprocessing", "signal",
           "sitecustomize", "usercustomize", "distributed", "yaml", "evil")  # fmt: skip


def python(folder, *arguments, **variables):
    """Run Python in a folder, where variables of None are not set."""
    package = {"PYTHONPATH": str(Path(mc.__file__).parents[1]), "PYTHONSAFEPATH": None}
    environment = {**os.environ, **package, **variables}
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        cwd=folder, env={name: text for name, text in environment.items() if text is not None},
        capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip


def multicell(folder, *arguments, **variables):
    return python(folder, "-m", "multicell", *arguments, **variables)


@pytest.fixture
def hostile(tmp_path):
    """A folder with files that Python, numba, matplotlib and others would take for theirs."""
    folder = tmp_path / "hostile"
    folder.mkdir()
    for name in MODULES:
        (folder / f"{name}.py").write_text(HOSTILE)
    (folder / ".numba_config.yaml").write_text(f"cache_dir: {folder}/cache\ndisable_jit: 1\n")
    (folder / "matplotlibrc").write_text("backend: module://evil\nlines.linewidth: 17\n")
    (folder / ".env").write_text("MPLBACKEND=module://evil\n")
    for name in ("dask.yaml", "distributed.yaml", "jobqueue.yaml"):
        (folder / name).write_text("distributed:\n  worker:\n    preload: [evil]\n")
    return folder


def test_settings_of_the_working_folder_are_not_read(hostile):
    code = (
        "import sys; sys.path.remove(''); import multicell, numba, matplotlib; "
        "numba.core.config.reload_config(); print(numba.config.CACHE_DIR == '', "
        "numba.config.DISABLE_JIT, matplotlib.rcParams['lines.linewidth'])"
    )
    done = python(hostile, "-c", code, NUMBA_CACHE_DIR=None)
    assert done.stdout.split() == ["True", "0", "1.5"], done.stderr


def test_what_the_user_names_is_read(tmp_path):
    (tmp_path / "mine").write_text("lines.linewidth: 17\n")
    code = "import multicell, numba, matplotlib; print(numba.config.CACHE_DIR, " \
        "matplotlib.rcParams['lines.linewidth'])"  # fmt: skip
    (tmp_path / "cache").mkdir(mode=0o700)
    named = {"MATPLOTLIBRC": str(tmp_path / "mine"), "NUMBA_CACHE_DIR": f"{tmp_path}/cache"}
    done = python("/", "-c", code, **named)
    assert done.stdout.split() == [f"{tmp_path}/cache", "17.0"], done.stderr


@pytest.mark.parametrize("name", [".numba_config.yaml", "matplotlibrc"])
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes here")
def test_settings_that_never_end_are_not_waited_for(name, tmp_path):
    os.mkfifo(tmp_path / name)
    code = "import multicell, numba, matplotlib; print('here')"
    assert python(tmp_path, "-c", code).stdout.strip() == "here"


@pytest.mark.slow
def test_a_hostile_folder_runs_nothing_and_changes_no_picture(hostile, tmp_path):
    clean = tmp_path / "clean"
    clean.mkdir()
    for folder in (clean, hostile):
        done = multicell(folder, "run", "growth", "-o", "o", *SHORT)
        assert done.returncode == 0, done.stderr
    assert not (hostile / "RAN").exists()
    assert not (hostile / "cache").exists()
    for picture in ("growth.png", "section.png"):
        assert (hostile / "o" / picture).read_bytes() == (clean / "o" / picture).read_bytes()


@pytest.mark.slow
def test_workers_in_a_hostile_folder_run_nothing_of_it(hostile):
    study = ["study", "new", "growth", "-o", "s", "--vary", "cells.young=1,2 kPa", *SHORT[:4]]
    assert multicell(hostile, *study).returncode == 0
    done = multicell(hostile, "study", "run", "s", "--cores", "2", "--no-report")
    assert done.returncode == 0, done.stderr
    assert not (hostile / "RAN").exists()


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="folders have no owners here")
def test_compiled_code_is_kept_where_nobody_else_can_put_some(tmp_path):
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o1777)
    places = {"NUMBA_CACHE_DIR": str(shared), "XDG_CACHE_HOME": str(tmp_path / "own")}
    # one cell, for which little is compiled
    one = ["--set", "duration=10 min", "--threads", "1", "--no-report"]
    done = multicell(tmp_path, "run", "growth", "-o", "o", *one, **places)
    assert done.returncode == 0, done.stderr
    assert list(shared.iterdir()) == []
    assert done.stderr.count("others can write to") == 1
    assert list((tmp_path / "own" / "multicell").iterdir())


def test_a_module_that_is_read_when_a_press_comes_leaves_no_words(tmp_path):
    """Files that an exception leaves open while numba's settings load llvmlite are no words."""
    code = (
        "import sys, multicell\n"
        "class Cut:\n"
        "    def find_spec(self, name, path, target=None):\n"
        "        if name.startswith('llvmlite'):\n"
        "            seen.append(name), open(sys.executable, 'rb')\n"
        "seen = []\n"
        "sys.meta_path.insert(0, Cut())\n"
        "import numba\n"
        "print('llvmlite.binding' in seen)"
    )
    done = python(tmp_path, "-c", code, PYTHONWARNINGS=None)
    assert (done.stdout, done.stderr) == ("True\n", "")


VARIABLES = {
    "home nowhere": {"HOME": "/nonexistent", "XDG_CACHE_HOME": None, "MPLCONFIGDIR": None},
    "temporary nowhere": {"TMPDIR": "/nonexistent"},
    "columns": {"COLUMNS": "abc", "LINES": "-1"},
    "language": {"LANG": "xx_YY.nonsense", "LC_ALL": "C", "PYTHONUTF8": "0"},
    "threads": {"NUMBA_NUM_THREADS": "abc", "OMP_NUM_THREADS": "-3"},
    "backend": {"MPLBACKEND": "module://evil"},
    "settings": {"MATPLOTLIBRC": "/dev/zero"},
}
PICTURED = ("home nowhere", "backend", "settings")


@pytest.mark.slow
@pytest.mark.parametrize("name", VARIABLES)
def test_odd_variables_end_in_results_or_words(name, hostile):
    pictures = () if name in PICTURED else ("--no-report",)
    done = multicell(hostile, "run", "growth", "-o", "o", *SHORT, *pictures, **VARIABLES[name])
    assert "bug of multicell" not in done.stderr
    assert "Traceback" not in done.stderr
    assert done.returncode in (0, 1, 2, 3)
    assert (done.returncode == 0) == (hostile / "o" / "summary.json").exists()
    assert not (hostile / "RAN").exists()
