"""Functions called at an address, and the collector of garbage while numba compiles."""

import gc
import os
import subprocess
import sys

import numba.core.event as event
import numpy as np
import pytest
from numba import njit, types
from numba.extending import intrinsic

import multicell as mc
from multicell import compiling
from multicell.compiling import address_of, call_at, kind_of
from multicell.contact.jkr import JKR
from multicell.mechanics import forces


@njit
def _summed(values, weight):
    if weight < 0.0:
        raise ValueError("negative")
    total = 0.0
    for k in range(values.size):
        total += weight * values[k]
    return total, values[1:]


@intrinsic
def _summed_at(context, address, values, weight):
    return call_at(types.Tuple((types.float64, values)), address, values, weight)


@njit
def _twice(address, values, weight):
    total, rest = _summed_at(address, values, weight)
    again, _ = _summed_at(address, rest, weight)
    return total + again, rest


def test_a_call_at_an_address_is_the_call():
    values = np.arange(5.0)
    address = address_of(_summed, (0.0, values), values, 1.0)
    total, rest = _twice(address, values, 2.0)
    assert total == 2.0 * (0 + 1 + 2 + 3 + 4) + 2.0 * (1 + 2 + 3 + 4)
    assert np.shares_memory(rest, values)
    assert address_of(_summed, (0.0, values), values[1:], 3.0) == address
    assert len(_summed.overloads) == 1


def test_exceptions_come_through_a_call_at_an_address():
    values = np.arange(5.0)
    address = address_of(_summed, (0.0, values), values, 1.0)
    with pytest.raises(ValueError, match="negative"):
        _twice(address, values, -1.0)


def test_a_function_that_returns_something_else_has_no_address():
    values = np.arange(5.0)
    with pytest.raises(TypeError, match="returns Tuple"):
        address_of(_summed, 0.0, values, 1.0)


def frozen(values):
    values = values.copy()
    values.flags.writeable = False
    return values


@pytest.mark.parametrize(
    "other",
    [
        np.zeros(3, np.float32),
        np.zeros((3, 1)),
        np.zeros(6)[::2],
        frozen(np.zeros(3)),
        None,
        0.0,
        (np.zeros(3),),
        JKR().constants(),
    ],
    ids=["type", "dimensions", "layout", "frozen", "absent", "number", "tuple", "law"],
)
def test_what_numba_tells_apart_has_another_kind(other):
    assert kind_of(np.zeros(3)) != kind_of(other)
    assert kind_of((1, other)) != kind_of((1, np.zeros(3)))
    assert kind_of((1, other)) == kind_of((2, other))


@pytest.mark.parametrize("enabled", [True, False])
def test_the_collector_rests_while_numba_compiles_and_is_then_as_before(enabled):
    seen = []

    class Watch(event.Listener):
        def on_start(self, event):
            seen.append(gc.isenabled())

        def on_end(self, event):
            seen.append(compiling.COMPILATION.depth)

    @njit
    def inner(x):
        return x + 1

    @njit
    def outer(x):
        return inner(x) * 2

    before = gc.isenabled()
    (gc.enable if enabled else gc.disable)()
    try:
        with event.install_listener("numba:compile", Watch()):
            assert outer(3) == 8
        assert gc.isenabled() == enabled
    finally:
        (gc.enable if before else gc.disable)()
    assert len(seen) == 4
    assert seen[1] is False


def test_the_collector_runs_again_after_an_error():
    @njit
    def wrong(x):
        return x.nothing

    with pytest.raises(Exception, match="nothing"):
        wrong(1.0)
    assert gc.isenabled()
    assert compiling.COMPILATION.depth == 0


GONE = """
import os
from typing import NamedTuple
import multicell.compiling  # reads what earlier versions have left
from numba import njit

class {name}(NamedTuple):
    value: float

@njit(cache=True)
def doubled(x):
    return 2.0 * x.value

assert doubled({name}(1.5)) == 3.0
print(sum(doubled.stats.cache_hits.values()))
"""


@pytest.mark.slow
def test_code_on_disk_for_a_type_that_is_gone_is_compiled_anew(tmp_path):
    """An upgrade leaves files of numba that name types of the version before it."""
    hits, cache = [], str(tmp_path / "cache")
    environment = {**os.environ, "NUMBA_CACHE_DIR": cache, "PYTHONPATH": str(tmp_path)}
    for name in ("Earlier", "Present", "Present"):
        program = tmp_path / "kernels.py"
        program.write_text(GONE.format(name=name))
        os.utime(program, (1e9, 1e9))
        done = subprocess.run(
            [sys.executable, "-c", "import kernels"], cwd=tmp_path, capture_output=True, text=True,
            env=environment, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr[-1500:]
        hits.append(int(done.stdout))
    assert hits == [0, 0, 1]


FROM_DISK = """
import sys

import numpy as np
from numba import njit

from multicell.nutrient import stencil

{function}
half = stencil.flat_dot(np.ones(3), np.full(3, 0.5)), {call}
tables = "numba.np.arraymath" in sys.modules
rest = njit(lambda x: np.sort(x)[0] + stencil.flat_dot(x, x))(np.array([2.0, 1.0]))
print(*half, rest, tables)
"""
HASHES = """
@njit(cache=True)
def hashes(x):
    return hash("multicell") + x

hashes.py_func.__module__ = "multicell.compiling"
"""


@pytest.mark.slow
@pytest.mark.parametrize(("function", "call"), [("", 1.5), (HASHES, "hashes(2)")])
def test_code_from_disk_is_run_without_what_compiles(tmp_path, function, call):
    """Numba imports the half of itself for it; and what is compiled after it finds all there is."""
    program = tmp_path / "kernels.py"
    program.write_text(FROM_DISK.format(function=function, call=call))
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONHASHSEED": "3"}
    seen = []
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, str(program)], cwd=tmp_path, capture_output=True, text=True,
            env={**os.environ, **cache}, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr[-1500:]
        seen.append(done.stdout.split())
    assert seen[0][:3] == seen[1][:3]
    assert seen[1][0] == "1.5"
    assert seen[1][2] == "6.0"
    assert [words[3] for words in seen] == ["True", "False"]


def test_loops_and_python_share_the_forces():
    sim = mc.Simulation(mc.load_scene("doublet"))
    sim.step()
    sim.mechanics.force(sim.mechanics.motion.begin, sim.cells.position)
    place = [signature[3] for signature in forces.forces.signatures]
    assert place
    assert not any(array.mutable for array in place)


COMMAND = """
import atexit, gc, sys
atexit.register(lambda: print(gc.get_freeze_count() > 1000))
from multicell.__main__ import run
sys.argv = ["multicell", "--version"]
run()
"""


def test_a_command_looks_for_no_garbage_at_its_end():
    done = subprocess.run(
        [sys.executable, "-c", COMMAND], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1] == "True"
