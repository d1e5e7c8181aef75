"""Studies beside their runs: ``pytest -m benchmark tests/benchmarks/test_study_speed.py -s``.

Targets on two cores with nothing else to do: 60 runs of some seconds take at most 1.1 times half of
their own CPU time; a run costs a study at most 50 ms beside itself; and a study of 60 runs that is
done is known to be so, by a new process, within 2 s.
"""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from studied import SHORT, runs_of, short_runs

import multicell as mc
from multicell.studies.engine import carry_out

pytestmark = pytest.mark.benchmark

LONGER = {
    "initial.count": 500,
    "initial.stage": "uniform",
    "growth.cycle_time": "12 h",
    "duration": "2 d",
    "output.every": "6 h",
}
COUNT = 60


def spent():
    """Return the CPU time of this process and of all that it has started and that has ended, s."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def carried_out(runs, folder):
    """Return wall time, CPU time of all processes, and that of the runs themselves, s."""
    begin, cpu = time.perf_counter(), spent()
    outcomes = carry_out(runs, folder, cores=2)
    assert {outcome.state for outcome in outcomes} == {"done"}
    own = sum(outcome.cpu for outcome in outcomes)
    return time.perf_counter() - begin, spent() - cpu, own


def test_sixty_runs_on_two_cores(tmp_path):
    runs = runs_of(COUNT, changes=LONGER)
    carried_out(runs[:1], tmp_path / "warm")  # kernels are on disk
    wall, cpu, own = carried_out(runs, tmp_path / "study")
    print(
        f"\n{COUNT} runs, {own / COUNT:.2f} s each: {wall:.1f} s, {wall / (own / 2.0):.3f} times "
        f"half of their CPU time ({own:.1f} s); all processes took {cpu / own:.3f} times as much"
    )
    assert cpu < 1.1 * own
    assert wall < 1.1 * own / 2.0


def test_overhead_of_a_run(tmp_path):
    """What more runs cost beside themselves; starting workers is the same for all numbers."""
    few, many = 10, 70
    carried_out(short_runs(1), tmp_path / "warm")
    beside = {}
    for count in (few, many):
        _, cpu, own = carried_out(short_runs(count), tmp_path / str(count))
        beside[count] = cpu - own
    each = (beside[many] - beside[few]) / (many - few)
    print(f"\nbeside a run: {1e3 * each:.1f} ms; workers: {beside[few] - few * each:.2f} s")
    assert each < 0.05


def test_a_finished_study_is_known_to_be_done(tmp_path):
    study, package = tmp_path / "study", str(Path(mc.__file__).parents[1])
    command = [sys.executable, "-m", "multicell", "study"]
    environment = {**os.environ, "PYTHONPATH": package}
    changes = [part for key in SHORT for part in ("--set", f"{key}={SHORT[key]}")]
    new = [*command, "new", "growth", "-o", study, "--seeds", str(COUNT), *changes]
    subprocess.run(new, check=True, env=environment)
    subprocess.run([*command, "run", study, "--quiet"], check=True, env=environment)
    walls = []
    for _ in range(5):
        begin = time.perf_counter()
        subprocess.run([*command, "run", study, "--quiet"], check=True, env=environment)
        walls.append(time.perf_counter() - begin)
    print(f"\n{COUNT} runs that are done: {sorted(walls)[2]:.2f} s")
    assert sorted(walls)[2] < 2.0
