"""Speed of whole runs and start-up: ``pytest -m benchmark tests/benchmarks``.

Targets on the development machine (2 cores): the built-in spheroid to 5 000 cells in under
120 s including compilation, ``import multicell`` under 1 s, and under 3 s from the start of a
second run to its first step. Each figure is that of a fresh process.
"""

import json
import os
import subprocess
import sys
import time

import pytest

pytestmark = pytest.mark.benchmark


def process(*arguments, **environment):
    begin = time.perf_counter()
    done = subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | environment,
    )
    return time.perf_counter() - begin, done.stdout


def test_import(benchmark):
    def run():
        return process("-c", "import multicell")

    benchmark.pedantic(run, rounds=7, warmup_rounds=1)
    bare = min(process("-c", "pass")[0] for _ in range(5))
    print(f"\nimport multicell: {benchmark.stats.stats.median - bare:.2f} s beyond python itself")
    assert bare > 0


def test_second_run_reaches_its_first_step(benchmark, tmp_path):
    """One coupling step of the spheroid in a fresh process, with numba's disk cache filled."""
    arguments = ["-m", "multicell", "run", "spheroid", "--set", "duration=10 min", "--no-report"]
    process(*arguments, "-o", str(tmp_path / "first"))

    def run():
        return process(*arguments, "-o", str(tmp_path / "again"), "--overwrite")

    benchmark.pedantic(run, rounds=5)
    print(f"\nfresh process, one step: {benchmark.stats.stats.median:.2f} s")
    assert (tmp_path / "again" / "summary.json").exists()


def test_spheroid_to_5000_cells_with_compilation(benchmark, tmp_path):
    command = ["-m", "multicell", "run", "spheroid", "--set", "stop_cells=5000", "--json"]

    def run():
        # an empty cache folder: all kernels are compiled
        return process(
            *command, "-o", str(tmp_path / "out"), NUMBA_CACHE_DIR=str(tmp_path / "cache")
        )

    seconds, printed = benchmark.pedantic(run, rounds=1)
    summary = json.loads(printed)
    assert summary["cells"] >= 5000
    print(f"\nspheroid to {summary['cells']} cells: {seconds:.1f} s with compilation")
