"""Forces compiled by another process while a run has one cell."""

import os
import pickle
import subprocess
import sys

import numpy as np
import pytest
from running import copy_lists

import multicell as mc
from multicell.compiling import kind_of
from multicell.integrators.auto import MILD
from multicell.integrators.base import info_of
from multicell.precompile import begins_alone, first_method, take, take_step, two_cells
from multicell.simulation import Simulation

SPHEROID = mc.load_scene("spheroid")
CASES = {
    "a field": ("spheroid", {"initial.count": 3}),
    "nothing but growth": ("growth", {"initial.count": 3}),
    "receptors": ("sorting-cams", {"initial.count": 20}),
}


def arguments(system):
    """Return the types of what the forces are called with, which decide about compilation."""
    motion = system.motion
    return kind_of((motion.radius, motion.radius_rate, motion.young, motion.bonds, motion.push))


@pytest.mark.parametrize("case", CASES)
def test_two_cells_have_the_types_of_those_of_the_run(case):
    name, changes = CASES[case]
    scene = mc.load_scene(name).with_changes(changes)
    system, position = two_cells(scene)
    run = Simulation(scene, threads=1)
    prepared = run.prepared()
    assert arguments(system) == arguments(prepared)
    assert kind_of(system.law.constants()) == kind_of(prepared.law.constants())
    assert kind_of(position) == kind_of(run.cells.position)


def test_the_two_cells_touch_and_do_not_coincide():
    system, position = two_cells(mc.load_scene("growth"))
    assert system.contacts(0.0, position).tolist() == [[0, 1]]
    assert np.linalg.norm(position[1] - position[0]) > system.motion.radius.max()


@pytest.mark.parametrize(("name", "first"), [("auto", MILD), ("cvode", "cvode")])
def test_the_step_is_taken_by_the_method_of_the_run(name, first):
    scene = mc.load_scene("growth").with_changes({"integrator": name})
    assert info_of(first_method(scene)).name == first
    take_step(scene)


@pytest.mark.parametrize(
    "changes",
    [
        {"initial.count": 2},
        {"motility": {}},
        {"domain": {axis: [-50.0, 50.0] for axis in "xyz"}},
    ],
    ids=["two cells", "one that moves", "walls"],
)
def test_what_the_first_step_needs_is_not_left_to_another_process(changes):
    assert begins_alone(SPHEROID)
    assert not begins_alone(SPHEROID.with_changes(changes))


def test_a_process_without_a_usable_scene_ends_silently():
    command = [sys.executable, "-m", "multicell.precompile"]
    done = subprocess.run(
        command, input=pickle.dumps({"no": "scene"}), capture_output=True, check=False, timeout=60
    )
    assert done.returncode == 1
    assert done.stdout == b""


COMPILED = """
import numba.core.event as event
import multicell as mc
from multicell import precompile
from multicell.simulation import Simulation

class Names(event.Listener):
    def on_start(self, e):
        names.append(e.data["dispatcher"].py_func.__qualname__)
    def on_end(self, e):
        pass

names = []
event.register("numba:compile", Names())
scene = mc.load_scene("growth")
"""
"""What notes the names of the functions that numba compiles."""
AHEAD = """
assert not precompile.forces_are_cached()
precompile.take_step(scene)
assert "_forces" in names, names
"""
RUN = """
assert precompile.forces_are_cached()
simulation = Simulation(scene, threads=1)
while len(simulation.cells) < 3:
    simulation.step()
assert not {"_forces", "_rebuild"} & set(names), names
assert not {"pack", "_half_virials", "_evaluation", "adaptive_adams", "_assess"} & set(names), names
"""
SHARED = """
parts = {"lists": "_rebuild", "forces": "_forces", "loop": "adaptive_adams"}
parts |= {"evaluation": "_evaluation", "passes": "_foresee"}
took, take = [], precompile.take
def noted(folder, part):
    if take(folder, part):
        took.append(part)
        return True
precompile.take = noted
mc.run(scene.with_changes({"stop_cells": 3}), threads=2, progress=False)
assert took and [parts[part] for part in took] == [n for n in names if n in parts.values()], names
"""
PROCESS = """
from types import SimpleNamespace
assert precompile.Precompilation(scene, 1).process is None
alone = SimpleNamespace(state=SimpleNamespace(cells=range(1)))
two = SimpleNamespace(
    state=SimpleNamespace(cells=range(2)), wall={"compile": 0.0, "rest": 0.0}
)
ahead = precompile.Precompilation(scene, 2)
first = ahead.process
ahead.watch(alone)
assert first.poll() is None
ahead.close()
assert first.poll() is not None and ahead.process is None
ahead = precompile.Precompilation(scene, 2)
ahead.process.kill()
ahead.watch(two)
assert ahead.process is None
assert two.wall["compile"] > 0.0
precompile.forces_are_cached = lambda: False
def fail(*_, **__):
    raise OSError("no space left")
precompile.take_step = fail
ahead = precompile.Precompilation(scene, 2)
ahead.process.kill()
ahead.watch(two)
assert ahead.process is None
precompile.TemporaryDirectory = fail
assert precompile.Precompilation(scene, 2).process is None
"""


def check_apart(program, cache):
    """Run a program in a process with a cache of its own for what numba compiles."""
    done = subprocess.run(
        [sys.executable, "-c", COMPILED + program], capture_output=True, text=True, check=False,
        env={**os.environ, "NUMBA_CACHE_DIR": str(cache)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-1500:]


@pytest.mark.skipif(os.cpu_count() == 1, reason="no core is free for another process")
@pytest.mark.slow
def test_the_process_ends_with_the_run_or_with_the_first_division(tmp_path):
    copy_lists(tmp_path)
    check_apart(PROCESS, tmp_path)


def test_a_part_is_taken_once_and_none_after_the_run(tmp_path):
    assert [take(tmp_path, "lists") for _ in range(2)] == [True, False]
    assert not take(tmp_path / "gone", "lists")


@pytest.mark.slow
@pytest.mark.skipif(os.cpu_count() == 1, reason="no core is free for another process")
def test_run_and_process_share_the_parts_and_compile_none_twice(tmp_path):
    check_apart(SHARED, tmp_path)


@pytest.mark.slow
def test_a_run_finds_on_disk_what_the_process_has_compiled(tmp_path):
    check_apart(AHEAD, tmp_path)
    check_apart(RUN, tmp_path)
