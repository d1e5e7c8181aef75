"""The same bits on one machine: threads, caches, hash seeds, and frames to go on from."""

import json
import os
import subprocess
import sys
from pathlib import Path

import bits
import numpy as np
import pytest
from running import finished

from multicell.integrators.registry import METHODS

pytestmark = pytest.mark.kernels

SCRIPT = Path(bits.__file__)
COMMON = ("death", "fields", "friction", "phases", "receptors, types")
"""What short tests go on with; each of the others compiles kernels of its own."""


def digests(group, threads=1, **environment):
    """Run a group of cases in a process of its own; return its digests and what was shared."""
    done = subprocess.run(
        [sys.executable, str(SCRIPT), group],
        env={**os.environ, "NUMBA_NUM_THREADS": str(threads), **environment},
        capture_output=True, text=True, check=True, timeout=900,
    )  # fmt: skip
    found = json.loads(done.stdout)
    assert set(found["digests"]) == set(bits.GROUPS[group])
    return found["digests"], found["shared"]


@pytest.mark.slow
def test_any_number_of_threads_gives_the_same_bits():
    alone, shared = digests("all", 1)
    assert set(shared.values()) == {0}
    together, shared = digests("all", 3)
    assert all(shared.values()), "the threads had nothing to do"
    assert together == alone
    # a digest that sees nothing would be the same for all; 'auto' may choose ab2-adaptive, and
    # multirate Euler with all cells in one group is adaptive Euler
    assert len(set(alone.values())) >= len(alone) - 2


@pytest.mark.slow
def test_a_cold_cache_gives_the_same_bits_as_a_warm_one(tmp_path):
    """Compiled here and now, and read from the disk; for a hash seed of each kind."""
    cold, _ = digests("few", PYTHONHASHSEED="1", NUMBA_CACHE_DIR=str(tmp_path))
    assert any(tmp_path.rglob("*.nbi"))
    warm, _ = digests("few", PYTHONHASHSEED="random", NUMBA_CACHE_DIR=str(tmp_path))
    usual = {key: bits.last(*case, 1) for key, case in bits.GROUPS["few"].items()}
    assert cold == warm == usual


def resumed_everywhere(name, changes, kept):
    """Return the digest of a run's end, and of the ends after going on from some of its frames."""
    whole = bits.simulation(name, changes, 1)
    frames = [whole.frame()]
    while not whole.finished:
        whole.step()
        frames.append(whole.frame())
    assert len(frames) > kept
    ends = {}
    for k in np.linspace(0, len(frames) - 2, kept).astype(int):
        again = bits.simulation(name, changes, 1, frame=frames[k])
        finished(again)
        ends[int(k)] = bits.digest(again.frame())
    return bits.digest(frames[-1]), ends


@pytest.mark.parametrize("name", sorted(METHODS))
def test_every_method_goes_on_from_any_frame(name):
    scene, changes = bits.METHOD_CASES[name]
    changes = {**changes, "initial.count": 40, "duration": "4 min"}
    end, ends = resumed_everywhere(scene, changes, 3)
    assert ends == dict.fromkeys(ends, end)


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, marks=() if case in COMMON else pytest.mark.slow)
        for case in sorted(bits.PHYSICS)
    ],
)
def test_every_physics_goes_on_from_any_frame(case):
    name, changes = bits.PHYSICS[case]
    changes = {**changes, "initial.count": 60}
    if name == "settle":
        changes["duration"] = "4 min"
    end, ends = resumed_everywhere(name, changes, 3)
    assert ends == dict.fromkeys(ends, end)
