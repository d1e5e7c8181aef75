"""No object of a coupling step waits for the garbage collector: circles hold arrays for long."""

import gc

import pytest
from strategies import ONE_OF_A_KIND

import multicell as mc

SCENES = ("spheroid", "emt6", "chemotaxis", "confined", "sorting-signal", "dosing", "monolayer")


@pytest.mark.sample(*(name for name in SCENES if name != "sorting-signal"))  # its loops are its own
@pytest.mark.parametrize("name", SCENES)
def test_steps_leave_no_circles(name):
    assert left_behind(mc.load_scene(name).with_changes({"initial.count": 30})) == set()


@pytest.mark.parametrize("method", ONE_OF_A_KIND)
def test_no_method_leaves_circles(method):
    changes = {
        "initial.count": 8, "initial.jitter": 0.05, "coupling_step": "1 min",
        "integrator": {"method": method},
    }  # fmt: skip
    assert left_behind(mc.load_scene("settle").with_changes(changes)) == set()


def test_a_run_with_files_leaves_no_circles(tmp_path):
    scene = mc.load_scene("growth").with_changes({"duration": "20 min"})
    mc.run(scene, output=tmp_path / "first", report=False)
    names = iter("abc")
    assert collected(lambda: mc.run(scene, output=tmp_path / next(names), report=False)) == set()


def left_behind(scene):
    """Return the types of the package's objects that only the collector finds after steps.

    A first run compiles what the steps need, which leaves frames of all callers in numba's circles.
    """
    collected(stepping(scene))
    return collected(stepping(scene))


def stepping(scene):
    """Return a function that takes a step of a run which has taken one."""
    run = mc.Simulation(scene)

    def act():
        run.step()
        run.history_row()

    act()
    return act


def collected(act):
    """Return the types of the package's objects that only the collector finds after three acts."""
    # what other tests have left, alive or not, takes a second to look through
    gc.freeze()
    gc.disable()
    try:
        gc.set_debug(gc.DEBUG_SAVEALL)
        for _ in range(3):
            act()
        gc.collect()
        left = {type(x).__name__ for x in gc.garbage if type(x).__module__.startswith("multicell")}
    finally:
        gc.set_debug(0)
        gc.garbage.clear()
        gc.enable()
    return left
