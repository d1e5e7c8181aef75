"""Coupling steps are of second order in growth, and what is left of their error is known."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate

import multicell as mc
from multicell.biology.growth import corrected_factor, lag_after
from multicell.biology.plan import biology_plan
from multicell.cells import State
from multicell.simulation import Simulation

STEPS = (2400.0, 1200.0, 600.0)
BIRTH = 0.5 * 4.0 / 3.0 * np.pi * 5.0**3
BASE = {
    "duration": "12 h",
    "initial": {"count": 8, "spacing": 2.0, "jitter": 0.0},
    "contact": {"law": "hertz"},
    "cells": {"young_variation": 0},
    "growth": {"cycle_time": "20 h", "cycle_variation": 0},
    "integrator": "rkc2",
    "output": {"every": "4 h"},
}
FADING = {
    "boundary": "0.1 mM", "uptake": 0, "media": [["0 h", "0.1 mM"], ["12 h", "0 mM"]],
    "media_change": "linear", "growth_half_saturation": "0.05 mM", "regime": "steady",
    "spacing": "20 um",
}  # fmt: skip
CLOSED = {
    "boundary": "1 mM", "uptake": "1.5 amol/s", "half_saturation": "0.1 mM",
    "growth_half_saturation": "0.3 mM", "regime": "transient", "initial": "medium",
    "sides": {"*": {"type": "derivative", "derivative": 0}}, "time_tolerance": 1e-5,
    "spacing": "20 um", "diffusion": "200000 um^2/s",
}  # fmt: skip
BOX = {"x": [-40, 40], "y": [-40, 40], "z": [-40, 40]}
STAGES = {**BASE["initial"], "stage": "uniform"}
SCENES = {
    "the medium fades": {**BASE, "nutrients": {"oxygen": FADING}},
    "cells use up what there is": {**BASE, "domain": BOX, "nutrients": {"glucose": CLOSED}},
    "more and more cells use it up": {
        **BASE, "domain": BOX, "nutrients": {"glucose": CLOSED}, "duration": "12 h",
        "growth": {"cycle_time": "8 h", "cycle_variation": 0}, "initial": STAGES,
    },
}  # fmt: skip


def true_volume(name):
    """Return the volume at the end: a logarithm where a medium fades, else by SciPy.

    Without limits of diffusion all cells find the same, and their clocks run alike: of one with
    the share s of its cycle behind it there are 2^⌊s⌋, each of the volume 1 + s - ⌊s⌋.
    """
    if name == "the medium fades":
        start, half, hours = 0.1, 0.05, 12.0
        fade = start / (hours * 3600.0)
        grown = hours * 3600.0 - half / fade * np.log((half + start) / half)
        return 8 * BIRTH * (1.0 + grown / (20 * 3600.0))
    cells = Simulation(mc.Scene.from_dict(SCENES[name]), threads=1).cells
    start, cycle = cells.volume / BIRTH - 1.0, cells.cycle_time[0]

    def slope(_, y):
        many = 2.0 ** np.floor(start + y[0] + 1e-12)
        content, grows = y[1] / 80.0**3, y[1] / (y[1] + 0.3 * 80.0**3)
        return [grows / cycle, -1.5 * many.sum() * content / (content + 0.1)]

    end = mc.Scene.from_dict(SCENES[name]).duration
    course = integrate.solve_ivp(
        slope, (0.0, end), [0.0, 80.0**3], rtol=1e-10, atol=1e-10, max_step=60.0
    )
    share = start + course.y[0, -1]
    return float((2.0 ** np.floor(share) * (1.0 + share % 1.0)).sum()) * BIRTH


@functools.cache
def run(name, step):
    return mc.run(mc.Scene.from_dict({**SCENES[name], "coupling_step": step}), threads=1)


def volume(result):
    return float(result.frames[-1].cells.volume.sum())


@pytest.mark.parametrize("name", SCENES)
def test_growth_is_of_second_order_in_the_coupling_step(name):
    true = true_volume(name)
    errors = [abs(volume(run(name, step)) / true - 1.0) for step in STEPS]
    order = np.polyfit(np.log(STEPS), np.log(errors), 1)[0]
    assert order > 1.8
    # at ten minutes; Euler's method is off by 0.09 to 0.2 %
    assert errors[-1] < 2e-4
    assert errors[0] > 1e-4


@pytest.mark.parametrize("name", list(SCENES)[:2])
def test_the_estimate_is_the_error_that_is_left(name):
    true = true_volume(name)
    for step in STEPS[:2]:
        result = run(name, step)
        estimate = result.summary()["splitting"]
        assert estimate["volume_error"] == pytest.approx(volume(result) - true, rel=0.15)
        told = result.history["splitting_volume_error"]
        assert told[0] == 0.0
        assert told[-1] == estimate["relative_volume_error"]
        assert estimate["worst_cell_error"] >= estimate["relative_volume_error"] > 0.0


@pytest.mark.parametrize("name", list(SCENES)[1:])
def test_what_is_taken_up_is_accounted_for(name):
    ledger = run(name, 1200.0).summary()["ledger"]
    assert ledger["relative_remainder"] < 1e-8
    assert ledger["glucose"]["uptake"] > 0.5 * 80.0**3


@pytest.mark.parametrize("phases", [False, True])
def test_cells_that_divide_freely_have_no_error(phases):
    """Daughters have grown since the division was due, whatever the step."""
    lengths = {"G1": {"duration": "8 h"}, "S": {"duration": "6 h"}, "G2": {"duration": "3 h"},
               "M": {"duration": "1 h", "grows": False}}  # fmt: skip
    free = {**BASE, "duration": "40 h", "initial": STAGES}
    free |= {"growth": {"phases": lengths}} if phases else {}
    coarse, fine = (
        mc.run(mc.Scene.from_dict({**free, "coupling_step": step}), threads=1)
        for step in (2400.0, 300.0)
    )
    assert len(coarse.frames[-1].cells) > 2 * len(coarse.frames[0].cells)
    assert volume(coarse) == pytest.approx(volume(fine), rel=1e-9)
    assert coarse.summary()["splitting"]["volume_error"] == 0.0


def test_a_medium_that_jumps_is_right_at_the_end_of_a_step_and_in_its_middle():
    field = {**FADING, "media": [["6 h", "0.02 mM"]], "media_change": "steps"}
    scene = mc.Scene.from_dict({**BASE, "nutrients": {"oxygen": field}, "coupling_step": 2400.0})
    grown = 6.0 / 20.0 * (0.1 / 0.15 + 0.02 / 0.07)
    result = mc.run(scene, threads=1)
    assert volume(result) == pytest.approx(8 * BIRTH * (1.0 + grown), rel=1e-12)
    # but for the last bits of a mean over a ball
    assert abs(result.summary()["splitting"]["volume_error"]) < 1e-12 * volume(result)
    # where it jumps between two of these ends a step ends
    scene = scene.with_changes({"nutrients.oxygen.media": [["340 min", "0.02 mM"]]})
    result = mc.run(scene, threads=1)
    earlier = 8 * BIRTH * (1.0 + grown - 1.0 / 60.0 * (0.1 / 0.15 - 0.02 / 0.07))
    assert volume(result) == pytest.approx(earlier, rel=1e-12)
    assert abs(result.summary()["splitting"]["volume_error"]) < 1e-12 * volume(result)


def some_cells(count=6):
    scene = mc.Scene.from_dict({**BASE, "initial": {**STAGES, "count": count}})
    return biology_plan(scene), Simulation(scene, threads=1).cells


def test_daughters_have_the_lag_of_their_mother_and_who_changes_state_none():
    plan, began = some_cells()
    before = np.full(6, 0.8)
    cells = began.take(np.array([0, 0, 1, 2, 3, 4, 5]))
    cells.parent[:2], cells.id[:2] = cells.id[0], [100, 101]
    cells.lag[:] = 2.0
    cells.state[[2, 3]] = State.QUIESCENT, State.NECROTIC
    shuffled = np.random.default_rng(1).permutation(7)
    now = np.full(7, 0.6)
    lag = lag_after(plan, began, before, cells, now, 600.0)
    # 600 s · (0.6 - 0.8) / 2 = -60 s
    np.testing.assert_allclose(lag, [-58.0, -58.0, 2.0, 0.0, -58.0, -58.0, -58.0])
    other = lag_after(plan, began, before, cells.take(shuffled), now, 600.0)
    np.testing.assert_array_equal(other, lag[shuffled])
    began.state[4] = State.QUIESCENT
    assert lag_after(plan, began, before, cells, now, 600.0)[5] == 2.0


def test_growth_stays_between_none_and_twice_that_of_its_surroundings():
    plan, cells = some_cells()
    factor = np.array([0.5, 0.5, 0.5, 0.01, 0.0, 0.5])
    lag = np.array([0.0, 120.0, -1e4, -60.0, 60.0, 60.0])
    state = cells.state.copy()
    state[5] = State.QUIESCENT
    found = corrected_factor(plan, replace(cells, lag=lag, state=state), factor, 600.0)
    np.testing.assert_allclose(found, [0.5, 0.6, 0.0, 0.0, 0.0, 0.5], rtol=1e-14)


@pytest.mark.parametrize("stiffness", [0.1, 0.5, 1.0, 1.4])
def test_growth_that_limits_itself_does_not_oscillate(stiffness):
    """A cell whose growth changes its factor by ``stiffness`` in a step, about a steady one."""
    plan, cells = some_cells(1)
    level, dt, course = 0.9, 600.0, []
    for _ in range(60):
        factor = np.array([level])
        grown = corrected_factor(plan, cells, factor, dt)
        after = replace(cells, lag=cells.lag - dt * (grown - factor))
        level -= stiffness * (float(grown[0]) - 0.5)  # half of unlimited growth is lost again
        after.lag = lag_after(plan, cells, factor, after, np.array([level]), dt)
        cells = after
        course.append(level)
    away = np.abs(np.array(course) - 0.5)
    assert away[-1] < 0.005 * 0.4
    if stiffness <= 0.5:
        assert (np.diff(away[away > 1e-9]) < 0.0).all()


def test_cells_in_a_box_press_on_each_other_without_oscillation():
    sides = {axis: [-12, 12] for axis in "xyz"}
    scene = mc.Scene.from_dict({
        **BASE, "domain": sides, "duration": "60 h", "coupling_step": "20 min",
        "growth": {"cycle_time": "12 h", "cycle_variation": 0, "critical_pressure": "0.05 kPa"},
        "initial": {"count": 8, "spacing": 1.0, "stage": "uniform"}, "output": {"every": "60 h"},
    })  # fmt: skip
    simulation, volumes, pressure = Simulation(scene, threads=1), [], []
    while not simulation.finished:
        simulation.step()
        volumes.append(float(simulation.cells.volume.sum()))
        pressure.append(float(simulation.cells.pressure.mean()))
    assert (np.diff(volumes) >= -1e-9).all()
    late = np.diff(pressure)[-30:]
    assert np.abs(late).max() < 0.02 * pressure[-1]
    assert pressure[-1] > 0.04


def test_scenes_without_growth_have_no_estimate():
    scene = mc.load_scene("settle").with_changes({"duration": "2 min", "initial.count": 5})
    result = mc.run(scene, threads=1)
    assert "splitting" not in result.summary()
    assert not [name for name in result.history if name.startswith("splitting")]
    assert not result.frames[-1].cells.lag.any()
