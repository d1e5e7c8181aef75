"""Parallel kernels that come from the disk cache, compiled in any order by earlier processes."""

import os
import subprocess
import sys

import pytest

CELLS = """
import numpy as np
from multicell.contact.hertz import Hertz
from multicell.mechanics import neighbours
from multicell.mechanics.neighbours import building
from multicell.mechanics.system import Mechanics
place, radius = np.random.default_rng(0).normal(size=(300, 3)) * 30, np.full(300, 5.0)
Mechanics(Hertz(), 5.0, threads=2)
"""
INNER = CELLS + "neighbours.build(place, radius, 0.5, 2, 64)"
OUTER = CELLS + (
    "none = np.empty(0, np.int32)\n"
    "print(building.rebuild_parallel(place, radius, 0.5, 64, none, none)[0])"
)


@pytest.mark.slow
def test_what_was_compiled_beside_cached_kernels_runs_in_later_processes(tmp_path):
    """Numba does not start its threads for such a function by itself, which ends in a crash."""
    apart = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    for program, expected in ((INNER, ""), (OUTER, "False\n"), (OUTER, "False\n")):
        done = subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, env=apart, check=False
        )
        assert (done.returncode, done.stdout) == (0, expected), done.stderr[-500:]


@pytest.mark.parametrize("own", [None, "active"])
def test_idle_threads_wait_asleep_unless_the_environment_says_otherwise(tmp_path, own):
    keep = {name: value for name, value in os.environ.items() if name != "OMP_WAIT_POLICY"}
    given = {} if own is None else {"OMP_WAIT_POLICY": own}
    code = "import os; from multicell.compiling.threads import launch; launch(); "
    done = subprocess.run(
        [sys.executable, "-c", code + "print(os.environ['OMP_WAIT_POLICY'])"],
        env=keep | given,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == [own or "passive"]
