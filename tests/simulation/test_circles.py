"""No object of a coupling step waits for the garbage collector: circles hold arrays for long."""

import gc

import pytest

import multicell as mc

SCENES = ("spheroid", "emt6", "chemotaxis", "confined", "sorting-signal", "dosing", "monolayer")


@pytest.mark.parametrize("name", SCENES)
def test_steps_leave_no_circles(name):
    run = mc.Simulation(mc.load_scene(name).with_changes({"initial.count": 30}))
    run.step()
    run.history_row()
    gc.collect()
    gc.disable()
    try:
        gc.set_debug(gc.DEBUG_SAVEALL)
        for _ in range(3):
            run.step()
            run.history_row()
        gc.collect()
        left = {type(x).__name__ for x in gc.garbage if type(x).__module__.startswith("multicell")}
    finally:
        gc.set_debug(0)
        gc.garbage.clear()
        gc.enable()
    assert left == set()
