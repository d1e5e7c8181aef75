"""Parallel kernels compiled by another process before a growing population needs them."""

import os
import pickle
import subprocess
import sys
from types import SimpleNamespace

import pytest

import multicell as mc
from multicell import rehearsal, runner
from multicell.nutrient.steady import MANY
from multicell.rehearsal import FIRST_CONTACT, MANY_NODES, OTHER_METHODS, Rehearsal

SIZE = 800
SCENE = mc.load_scene("growth")


class Process:
    """Notes what is done with it."""

    def __init__(self):
        self.calls = []

    def poll(self):
        return self.ended

    def wait(self, timeout=None):
        self.calls.append(("wait", timeout))
        if timeout is not None and self.slow:
            raise subprocess.TimeoutExpired("python", timeout)
        self.ended = 0

    def kill(self):
        self.calls.append("kill")

    slow = False
    ended = None


@pytest.fixture
def started(monkeypatch):
    """Return the processes that are started, which do nothing."""
    processes = []

    def start(scene, work, acts, urgent=False):
        processes.append(Process())
        processes[-1].work, processes[-1].acts, processes[-1].urgent = work, acts, urgent
        return processes[-1]

    monkeypatch.setattr(rehearsal, "_started", start)
    monkeypatch.setattr(rehearsal, "_worth_while", lambda: True)
    monkeypatch.setattr(rehearsal, "_on_disk", lambda *item: False)
    monkeypatch.setattr(rehearsal, "_listed", lambda function: [])
    monkeypatch.setattr(rehearsal, "wanted_drivers", lambda: [("drivers", "", ())])
    monkeypatch.setattr(rehearsal, "wanted_methods", lambda: [("methods", "", ())])
    return processes


def grown(cells, size=SIZE, nodes=0):
    return SimpleNamespace(cells=range(cells), shared_from=size, nodes=nodes)


def test_one_process_starts_well_before_the_size_and_is_waited_for_there(started):
    watching = Rehearsal(SCENE)
    watching.watch(grown(SIZE // 8 - 1))
    assert not started
    for cells in (SIZE // 8, SIZE // 4, SIZE - 1):
        watching.watch(grown(cells))
    (process,) = started
    assert process.calls == []
    watching.watch(grown(SIZE))
    assert process.calls == [("wait", rehearsal._LONGEST_WAIT)]
    watching.watch(grown(SIZE - 1))
    watching.close()
    assert len(started) == 1
    assert process.calls[1:] == ["kill", ("wait", None)]


def test_a_long_run_has_another_method_compiled_after_what_was_asked_for_before(
    started, monkeypatch
):
    now = [0.0]
    monkeypatch.setattr(rehearsal.clock, "perf_counter", lambda: now[0])
    assert SCENE.integrator.method == "auto"
    watching = Rehearsal(SCENE)
    watching.watch(grown(SIZE // 2))
    now[0] = 2.0 * rehearsal._LONG
    watching.watch(grown(SIZE // 2))
    assert [process.work for process in started] == [[("drivers", "", ())]]
    watching.watch(grown(SIZE))
    assert [process.acts for process in started] == [[], [OTHER_METHODS]]
    for _ in range(3):
        watching.watch(grown(2 * SIZE))
    assert started[1].calls == []
    watching.close()
    assert started[1].calls == ["kill", ("wait", None)]


def test_what_may_be_needed_gives_way_to_what_will_be(started, monkeypatch):
    monkeypatch.setattr(rehearsal, "_LONG", -1.0)
    watching = Rehearsal(SCENE)
    watching.watch(grown(2))
    watching.watch(grown(SIZE // 8))
    methods, drivers = started
    assert (methods.acts, methods.calls) == ([OTHER_METHODS], ["kill", ("wait", None)])
    assert drivers.work == [("drivers", "", ())]
    drivers.ended = 0
    watching.watch(grown(SIZE // 4))
    assert started[2].acts == [OTHER_METHODS]
    watching.watch(grown(SIZE))
    assert started[2].calls == []


def test_a_method_that_is_named_is_the_only_one(started, monkeypatch):
    monkeypatch.setattr(rehearsal, "_LONG", 0.0)
    watching = Rehearsal(SCENE.with_changes({"integrator": "euler"}))
    watching.watch(grown(1))
    assert not started


def test_what_two_cells_need_is_compiled_while_there_is_one(started):
    scene = mc.load_scene("spheroid")
    watching = Rehearsal(scene)
    watching.begin(scene)
    (process,) = started
    assert (process.work, process.acts, process.urgent) == ([], [FIRST_CONTACT], True)
    watching.watch(grown(1))
    assert process.calls == []
    watching.watch(grown(2))
    watching.watch(grown(3))
    assert process.calls == [("wait", rehearsal._LONGEST_WAIT)]


@pytest.mark.parametrize(
    "changes",
    [{"initial.count": 2}, {"motility": {}}, {"domain": {axis: [-50.0, 50.0] for axis in "xyz"}}],
    ids=["two cells", "one that moves", "walls"],
)
def test_what_the_first_step_needs_is_not_left_to_another_process(started, changes):
    scene = mc.load_scene("spheroid").with_changes(changes)
    Rehearsal(scene).begin(scene)
    assert not started


def test_one_thread_asks_for_no_other_core(started):
    scene = mc.load_scene("spheroid")
    Rehearsal(scene, 1).begin(scene)
    assert not started


def test_the_solver_for_many_nodes_is_compiled_well_before_there_are_as_many(started):
    scene = mc.load_scene("spheroid")
    watching = Rehearsal(scene)
    watching.watch(grown(SIZE // 100, nodes=MANY // 8 - 1))
    assert not started
    watching.watch(grown(SIZE // 100, nodes=MANY // 8))
    watching.watch(grown(SIZE // 100, nodes=MANY))
    assert [process.acts for process in started] == [[MANY_NODES]]


def test_a_scene_without_fields_needs_no_solver_of_theirs(started):
    Rehearsal(SCENE).watch(grown(1, nodes=MANY // 8))
    assert not started


def test_what_is_on_disk_is_not_compiled_again(started, monkeypatch):
    monkeypatch.setattr(rehearsal, "_on_disk", lambda *item: True)
    Rehearsal(SCENE).watch(grown(SIZE - 1))
    assert not started


def test_a_process_that_takes_too_long_is_not_waited_for_for_ever(started, monkeypatch):
    monkeypatch.setattr(Process, "slow", True)
    watching = Rehearsal(SCENE)
    watching.watch(grown(SIZE - 1))
    watching.watch(grown(SIZE))
    assert started[0].calls == [("wait", rehearsal._LONGEST_WAIT)]


@pytest.mark.parametrize(("cells", "size"), [(SIZE, SIZE), (10 * SIZE, None)])
def test_nothing_starts_where_it_is_too_late_or_there_is_one_thread(started, cells, size):
    watching = Rehearsal(SCENE)
    watching.watch(grown(cells, size))
    watching.watch(grown(SIZE - 1))
    assert not started


def test_nothing_starts_where_there_is_no_core_for_it(started, monkeypatch):
    monkeypatch.setattr(rehearsal, "_worth_while", lambda: False)
    watching = Rehearsal(SCENE)
    watching.watch(grown(SIZE - 1))
    assert not started


def test_a_run_does_without_where_no_process_can_be_started(monkeypatch):
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    assert rehearsal._started(SCENE.to_dict(), [], []) is None


def test_a_process_that_cannot_do_what_it_is_asked_ends_silently():
    wanted = [("multicell.nowhere", "nothing", ())], []
    code = pickle.dumps((False, SCENE.to_dict())) + pickle.dumps(wanted)
    command = [sys.executable, "-m", "multicell.rehearsal"]
    done = subprocess.run(command, input=code, capture_output=True, check=False, timeout=60)
    assert done.returncode == 1
    assert done.stdout == b""


@pytest.mark.parametrize("fails", [False, True])
def test_it_ends_with_the_run(started, monkeypatch, fails):
    monkeypatch.setattr(mc.Simulation, "shared_from", property(lambda self: SIZE))
    monkeypatch.setattr(runner, "Rehearsal", lambda scene, threads: Rehearsal(scene))
    scene = mc.load_scene("settle").with_changes({"initial.count": SIZE // 4, "duration": "2 min"})

    def progress(simulation):
        if fails:
            raise RuntimeError("stop")

    if fails:
        with pytest.raises(RuntimeError, match="stop"):
            mc.run(scene, progress=progress, threads=1)
    else:
        mc.run(scene, progress=progress, threads=1)
    assert started[0].calls == ["kill", ("wait", None)]


PROGRAM = """
import numba.core.event as event
import multicell as mc
from multicell.integrators import registry
from multicell.rehearsal import Rehearsal
from multicell.simulation import Simulation

class Noted(event.Listener):
    def on_start(self, e):
        names.append(e.data["dispatcher"].py_func.__qualname__)
    def on_end(self, e):
        pass

names = []
event.register("numba:compile", Noted())
scene = mc.load_scene("growth").with_changes({"initial.count": 30, "initial.stage": "uniform"})
simulation = Simulation(scene, threads=2)
simulation.mechanics.chunk, simulation.mechanics.shared_chunks = 8, 5
rehearsal = Rehearsal(scene)
rehearsal._over = False
simulation.step()
rehearsal.watch(simulation)
assert rehearsal._process.wait(300) == 0
while len(simulation.cells) < simulation.shared_from:
    simulation.step()
    rehearsal.watch(simulation)
assert not any("parallel" in name for name in names), names
names.clear()
simulation.step()
print([name for name in names if "parallel" in name])
rehearsal._begin = -1e9
rehearsal.watch(simulation)
assert rehearsal._process.wait(300) == 0
names.clear()
simulation.scene = simulation.scene.with_changes({"integrator": "rkc2"})
simulation.mover.integrator = registry.make(simulation.scene.integrator)
simulation.step()
rehearsal.close()
print(names)
"""


@pytest.mark.slow
def test_a_run_finds_on_disk_what_another_process_has_compiled_for_it(tmp_path):
    apart = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "NUMBA_NUM_THREADS": "2"}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, env=apart, check=False
    )
    assert done.returncode == 0, done.stderr[-1500:]
    assert done.stdout.split() == ["[]", "[]"]
