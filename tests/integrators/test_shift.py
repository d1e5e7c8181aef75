"""Effect of a small shift of all positions on the end of a coupling step, in runs."""

import math
from dataclasses import replace

import numpy as np
import pytest
from stored import assert_same_bits

import multicell as mc
from multicell.comparison.conditioning import shift_starts
from multicell.comparison.record import record
from multicell.integrators import shift
from multicell.integrators.auto import Auto
from multicell.integrators.shift import SHARE, SHIFT, Replays, replay_step, shifted_positions
from multicell.simulation import Simulation

pytestmark = pytest.mark.kernels

METHODS = ["auto", "cvode", "rkc2", "ab2"]


def scene_of(**changes):
    usual = {"duration": "14 h", "initial.count": 30, "initial.stage": "uniform"}
    return mc.load_scene("growth").with_changes(usual | {"output.every": "2 h"} | changes)


def often(monkeypatch):
    """Let every second coupling step or so be replayed."""
    monkeypatch.setattr(shift, "SHARE", 0.5)


def course(scene, replays=True):
    simulation = Simulation(scene, threads=1)
    if not replays:
        simulation.state = replace(simulation.state, replays=None)
    while not simulation.finished:
        simulation.step()
    return simulation


@pytest.mark.parametrize("method", METHODS)
def test_replays_change_no_bit_and_no_count_of_a_run(method, monkeypatch):
    """Also where contacts, receptors and what a method remembers would show it."""
    often(monkeypatch)
    scene = scene_of(duration="4 h", integrator={"method": method, "step": 10.0})
    found, plain = course(scene), course(scene, replays=False)
    assert found.replays.done > 5
    assert found.replays.largest > 0.0
    assert found.cells.position.tobytes() == plain.cells.position.tobytes()
    assert found.cells.pressure.tobytes() == plain.cells.pressure.tobytes()
    assert found.mechanics.work == plain.mechanics.work


@pytest.mark.parametrize(
    "parts",
    [
        {"contact": {"law": "exact-jkr", "surface_energy": 0.1}},
        {"motions": {"m": {"cells": [0, 1], "velocity": [0.001, 0, 0]}}},
        {"friction": {"normal": 0.1}},
        {"dimensions": 2},
    ],
    ids=lambda parts: next(iter(parts)),
)
def test_replays_change_nothing_with_parts_that_keep_something(parts, monkeypatch):
    often(monkeypatch)
    scene = scene_of(duration="2 h", **parts)
    found, plain = course(scene), course(scene, replays=False)
    assert found.replays.done > 2
    assert found.cells.position.tobytes() == plain.cells.position.tobytes()
    assert found.contacts.tobytes() == plain.contacts.tobytes()


def test_the_effect_is_that_of_two_integrations():
    """The end from the shifted start by hand, by a method at a tight tolerance."""
    simulation = Simulation(scene_of(), threads=1)
    simulation.step()
    system, start = simulation.prepared(), simulation.cells.position
    motion, method = system.motion, Auto(1e-9, 1e-6)
    end = method.integrate(system, start).position
    moved = shifted_positions(start, SHIFT, 7, 3, simulation.cells.id, 3)
    effect, cost = replay_step(method, system, start, end, moved)
    system.begin(motion)
    other = method.integrate(system, moved).position
    assert effect == np.linalg.norm(other - end, axis=1).max()
    assert cost > len(start)


def test_shifts_are_normal_numbers_by_identity_and_stay_in_a_plane():
    ids = np.arange(4000)[::-1].copy()
    place = np.zeros((4000, 3))
    noise = shifted_positions(place, 0.01, 5, 2, ids, 2)
    assert not noise[:, 2].any()
    assert abs(noise[:, :2].std() - 0.01) < 3e-4
    again = shifted_positions(place[:7], 0.01, 5, 2, ids[:7], 2)
    np.testing.assert_array_equal(again, noise[:7])
    assert not np.array_equal(shifted_positions(place, 0.01, 5, 3, ids, 2), noise)


def test_comparisons_shift_by_the_same_numbers():
    problem, _ = record(scene_of(duration="2 h"), Auto(), samples=3)
    moved = shift_starts(problem, 0.02)
    seed = problem.scene.seed
    for k, (before, after) in enumerate(zip(problem.starts, moved.starts, strict=True)):
        ids = np.arange(len(before))
        expected = shifted_positions(before, 0.02, seed, k, ids, 3)
        np.testing.assert_array_equal(after, expected)


def test_replays_take_a_fiftieth_of_the_counted_cost():
    replays = Replays()
    costs = np.random.default_rng(1).uniform(10.0, 1000.0, 5000)
    for cost in costs:
        replays = replays.after(cost, *((cost, 0.1) if replays.due else ()))
        # one step more, where it is dearer than the one before it
        assert replays.spent <= SHARE * replays.total + 1000.0
    assert replays.total == pytest.approx(costs.sum())
    assert replays.spent > 0.9 * SHARE * replays.total
    # one that does not reach the end costs and finds nothing
    failed = replays.after(90.0, 80.0, None)
    assert failed.spent == replays.spent + 80.0
    assert failed[:3] == replays[:3]


def test_history_and_summary_give_the_effect_and_a_resumed_run_the_same_bits(tmp_path):
    scene = scene_of()
    whole = mc.run(scene, output=tmp_path / "whole", report=False, threads=1)
    work = whole.summary()["integrator"]
    column = np.array(whole.history["shift_effect"])
    assert work["replays"] >= 1
    assert work["largest_shift_effect"] == np.nanmax(column) > 0.0
    assert np.isnan(column[0])
    assert np.isfinite(column[-1])
    assert whole.summary()["units"]["integrator.largest_shift_effect"] == "um"
    again = {"output": tmp_path / "again", "report": False, "threads": 2}
    resumed = mc.resume(tmp_path / "whole", 2, **again)
    assert resumed.summary()["integrator"] == work
    assert_same_bits(tmp_path / "whole", tmp_path / "again")


def test_a_run_without_replays_tells_none():
    result = mc.run(scene_of(duration="1 h"))
    assert "largest_shift_effect" not in result.summary()["integrator"]
    assert all(math.isnan(x) for x in result.history["shift_effect"])
