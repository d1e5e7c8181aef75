"""Generated code: what it may hold, and that compiled code of it is never stale."""

import subprocess
import sys

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
from multicell.networks.generated import functions_of
from multicell.networks.network import Network
from multicell.networks.solver import NetworkSolver
text = sys.argv[1]
rates = functions_of(text)["rates"]
network = Network("own", ("a",), (1.0,), (), (), (), (), (), rates, None, text)
solver = NetworkSolver(network)
print(solver.rates(solver.begin(1), np.zeros((1, 0)), 0.0)[0, 0])
"""


def run(text, folder):
    """Return a rate as another process computes it, and the compiled code on disk after it."""
    environment = {"NUMBA_CACHE_DIR": str(folder), "PATH": "", "PYTHONPATH": ":".join(sys.path)}
    command = [sys.executable, "-c", RUN, text]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return float(done.stdout), {path.name for path in folder.rglob("*.nbc")}


@pytest.mark.slow
def test_compiled_code_is_found_again_for_the_same_text_and_no_other(tmp_path):
    tmp_path.chmod(0o700)
    value, first = run(GOOD, tmp_path)
    assert value == pytest.approx(-np.e / 2)
    assert run(GOOD, tmp_path) == (value, first)
    value, second = run(GOOD.replace("2.0 **", "4.0 **"), tmp_path)
    assert value == pytest.approx(-np.e / 4)
    assert second > first
