"""Generated code: what it may hold, and that compiled code of it is never stale."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from multicell.networks.generated import check_code, functions_of

GOOD = "def rates(t, y, u, p, out):\n    y0 = y[0]\n    out[0] = (-np.exp(y0) / (2.0 ** y0))\n"


def test_arithmetic_on_arrays_is_let_pass():
    check_code(GOOD)
    out = np.empty(1)
    functions_of(GOOD)["rates"](0.0, np.array([1.0]), np.empty(0), np.empty(0), out)
    assert out[0] == pytest.approx(-np.e / 2)


def test_the_same_text_gives_the_same_functions():
    assert functions_of(GOOD)["rates"] is functions_of(str(GOOD))["rates"]
    assert functions_of(GOOD.replace("2.0", "3.0"))["rates"] is not functions_of(GOOD)["rates"]


@pytest.mark.parametrize(
    "line",
    [
        "import os",
        "v0 = __import__",
        "v0 = exec(y0)",
        "v0 = open(y0)",
        "v0 = np.load(y0)",
        "v0 = np.exp.__class__",
        "v0 = y.__class__",
        "v0 = 'text'",
        "v0 = None",
        "v0 = [y0 for y0 in y]",
        "v0 = (lambda: 1)()",
        "v0 = y[p]",
        "v0 = y[0:1]",
        "v0 = v0[0]",
        "np = 1.0",
        "np.exp = 1.0",
        "v0 = max(y0, key=abs)",
        "while y0: pass",
        "global v0",
        "v0: int = 1",
        "del v0",
        "raise v0",
        "with y0: pass",
        "v0 = f'{y0}'",
        "v0 = (v1 := y0)",
        "yield y0",
        "def v1(a0=exec): pass",
    ],
)
def test_anything_else_is_refused(line):
    with pytest.raises(ValueError, match="generated code has"):
        check_code(f"{GOOD}    {line}\n")


@pytest.mark.parametrize(
    "text",
    [
        "@abs\ndef rates(t): return t",
        "class A: pass",
        "def f_g(t): return t",
        "async def a(): pass",
    ],
)
def test_functions_are_bare_and_have_names_of_ours(text):
    with pytest.raises(ValueError, match="generated code has"):
        check_code(text)


RUN = """
import sys, numpy as np
from numba import njit
from multicell.networks.generated import functions_of
rates = njit(cache=True, error_model="numpy")(functions_of(sys.argv[1])["rates"])
out = np.empty(1)
rates(0.0, np.array([1.0]), np.empty(0), np.empty(0), out)
print(out[0], sum(rates.stats.cache_hits.values()), rates.py_func.__code__.co_filename)
"""


def run(text, folder):
    environment = {"NUMBA_CACHE_DIR": str(folder), "PATH": "", "PYTHONPATH": ":".join(sys.path)}
    command = [sys.executable, "-c", RUN, text]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    value, hits, path = done.stdout.split()
    return float(value), int(hits), Path(path)


@pytest.mark.slow
def test_compiled_code_is_found_again_for_the_same_text_and_no_other(tmp_path):
    tmp_path.chmod(0o700)
    other = GOOD.replace("2.0 **", "4.0 **")
    value, hits, path = run(GOOD, tmp_path)
    assert (value, hits) == (pytest.approx(-np.e / 2), 0)
    assert run(GOOD, tmp_path)[1] == 1
    assert run(other, tmp_path)[:2] == (pytest.approx(-np.e / 4), 0)
    # what lies in the folder under the name of a text is not what is run
    path.write_text(other)
    assert run(GOOD, tmp_path)[0] == pytest.approx(-np.e / 2)
    assert path.read_text() == GOOD
