"""Coupling steps whose lengths a run chooses: where they end, what they follow, what they leave."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import multicell as mc
from multicell.biology.plan import biology_plan
from multicell.biology.step_errors import StepErrors, step_errors
from multicell.cells import State
from multicell.errors import SceneError
from multicell.report.explain.scene import explain
from multicell.report.wording import diagnostics
from multicell.scene.steps import Lengths, StepPlan, longest_coupling_step, step_plan
from multicell.simulation import Simulation
from multicell.simulation.step_lengths import first_lengths, lengths_after
from multicell.simulation.timeline import Timeline

HOUR = 3600.0
LONGEST = 2400.0
LADDER = {LONGEST * part * 2.0**-k for k in range(6) for part in (1.0, 1.5)} - {1.5 * LONGEST}
PACE = np.log(2.0) / (15 * HOUR)
CALM = {
    "duration": "12 h", "coupling_step": "auto", "contact": {"law": "hertz"},
    "initial": {"count": 8, "spacing": 2.0, "jitter": 0.0}, "integrator": "rkc2",
    "cells": {"young_variation": 0}, "growth": {"cycle_time": "20 h", "cycle_variation": 0},
    "output": {"every": "12 h"},
}  # fmt: skip
FADING = {
    "boundary": "0.1 mM", "uptake": 0, "media": [["0 h", "0.1 mM"], ["12 h", "0 mM"]],
    "media_change": "linear", "growth_half_saturation": "0.05 mM", "regime": "steady",
    "spacing": "20 um",
}  # fmt: skip
STARVING = {
    "coupling_step": "auto", "initial.count": 250, "initial.stage": "asynchronous",
    "nutrients.oxygen.uptake": "400 amol/s", "duration": "8 h", "output.every": "2.3 h",
    "death.lysis_time": "6 h",
}  # fmt: skip


def painted(errors, hours=60.0, plan=None):
    """Return times and lengths of steps whose errors are a function of length and time."""
    plan = plan or StepPlan(LONGEST, hours * HOUR, tolerance=1e-3)
    lengths, found = first_lengths(plan), []
    timeline = Timeline(plan).choosing(lengths)
    while not timeline.is_over:
        begin, timeline = timeline.time, timeline.after_step()
        dt = timeline.time - begin
        lengths = lengths_after(lengths, timeline, begin, errors(dt, begin))
        timeline = timeline.choosing(lengths)
        found.append((begin, dt))
    return np.array(found), Lengths(*lengths)


def lasting(share):
    """Return errors of tissue that grows without limits, of which a part lasts at 10 min."""
    return lambda dt, _: StepErrors(share * PACE * dt * dt / 600.0, 0.0, PACE * dt, PACE)


def run(scene, steps=None):
    simulation = Simulation(scene, threads=1)
    while not simulation.finished and simulation.step_index != steps:
        simulation.step()
    return simulation


def times_of(simulation):
    """Return the ends of all steps of a run."""
    times = [0.0]
    while not simulation.finished:
        simulation.step()
        times.append(simulation.time)
    return times


def digest(simulation):
    state = simulation.state
    return [state.timeline, tuple(state.lengths), state.cells.position.tobytes(),
            state.cells.radius.tobytes(), state.cells.state.tobytes()]  # fmt: skip


# --- the choice ------------------------------------------------------------------------------


def test_steps_without_an_error_become_the_longest_and_stay_so():
    steps, last = painted(lambda dt, _: StepErrors(0.0, 0.0, 0.0, 0.0))
    assert steps[0, 1] == LONGEST / 16
    assert (steps[:, 1] <= 2.0 * np.append(steps[:1, 1], steps[:-1, 1])).all()
    assert (steps[steps[:, 0] >= LONGEST, 1] == LONGEST).all()
    assert (last.error, last.exceeded, last.shortest) == (0.0, 0.0, LONGEST / 16)


@pytest.mark.parametrize("share", [1e-3, 3e-3])
def test_errors_that_last_add_up_to_the_tolerance_at_most(share):
    """In tissue that grows, a step of 10 min adds so large a part of what has grown in it."""
    steps, last = painted(lasting(share), hours=200.0)
    assert 0.7e-3 < last.error <= 1.16e-3
    late = steps[steps[:, 0] > 100 * HOUR, 1]
    # no oscillation: one length, of which changes to another cut some pieces
    assert len(set(late)) == 1
    assert late[0] in LADDER
    assert late[0] == pytest.approx(600.0 * 1e-3 / share, rel=0.34)


def test_growth_that_is_made_good_is_of_second_order():
    """The lag of all cells is a quarter of a millionth of the volume at 1 min, and goes as dt²."""
    steps, last = painted(lambda dt, _: StepErrors(0.0, 2.5e-7 * (dt / 60.0) ** 2, 0.0, PACE))
    assert last.error == 0.0
    late = steps[steps[:, 0] > 5 * HOUR, 1]
    assert len(set(late)) == 1
    ideal = 60.0 * np.sqrt(0.5e-3 / 2.5e-7)
    assert ideal / 2.0 < late[0] <= 1.15 * ideal


def test_a_jump_of_the_error_shortens_the_next_step_but_one_at_once():
    jump = 30 * HOUR

    def errors(dt, begin):
        return lasting(1e-3 if begin > jump else 1e-9)(dt, begin)._replace(
            lag=0.5 if jump <= begin < jump + LONGEST else 0.0
        )

    steps, last = painted(errors)
    (after,) = np.flatnonzero(steps[:, 0] >= jump)[:1]
    assert steps[after, 1] == steps[after - 1, 1] == LONGEST
    assert last.exceeded == 1.0
    assert steps[after + 2, 1] <= LONGEST / 16
    assert steps[-1, 1] >= LONGEST / 8


def test_steps_are_short_after_something_has_changed():
    plan = StepPlan(LONGEST, 30 * HOUR, changes=(10.3 * HOUR,), tolerance=1e-3, every=7 * HOUR)
    steps, _ = painted(lambda dt, _: StepErrors(0.0, 0.0, 0.0, 0.0), plan=plan)
    ends = steps.sum(axis=1)
    assert np.isclose(ends[:, None], np.array([7, 10.3, 14, 21, 28, 30]) * HOUR).any(axis=0).all()
    (after,) = np.flatnonzero(np.isclose(steps[:, 0], 10.3 * HOUR))
    assert steps[after, 1] <= LONGEST / 16
    assert steps[-2, 1] == LONGEST


def test_each_step_ends_at_a_multiple_of_a_length():
    steps, _ = painted(lasting(2e-3), hours=90.0)
    for begin, dt in steps[:-1]:
        end = begin + dt
        assert min(abs(end / x - round(end / x)) for x in LADDER if x >= dt) < 1e-9


# --- the estimates ---------------------------------------------------------------------------


def spread(count=40, **state):
    """Return the plan and cells of tissue in which some have come to another state."""
    scene = mc.load_scene("spheroid").with_changes({"initial.count": count})
    cells = Simulation(scene, threads=1).cells
    return biology_plan(scene), cells.changed(**state) if state else cells


@pytest.mark.parametrize("count", [1, 40])
@pytest.mark.parametrize("flipped", [0, 1, None])
def test_cells_that_come_to_rest_count_for_half_a_step(count, flipped):
    """None, one, all."""
    plan, cells = spread(count)
    states = cells.state.copy()
    assert (states == State.PROLIFERATING).all()
    states[:flipped] = State.QUIESCENT
    after = cells.changed(state=states)
    found = step_errors(plan, cells, after, after.lag, None, 600.0, 0.0)
    # each grows by the volume at birth in its cycle time
    rate = 0.5 * plan.division_volume / cells.cycle_time / cells.volume.sum()
    turned = rate[states == State.QUIESCENT].sum()
    assert found.lasting == pytest.approx(0.5 * 600.0 * 0.5 * turned, rel=1e-12)
    assert found.growth == pytest.approx(600.0 * rate[states == State.PROLIFERATING].sum())
    assert found.pace == pytest.approx(rate.sum())
    assert found.lag == 0.0


def test_growth_to_make_good_lasts_where_it_changes_its_sign():
    plan, cells = spread()
    rate = plan.law.rate(cells.volume, plan.birth_volumes(cells.kind)) / cells.cycle_time
    rate /= cells.volume.sum()
    signs, every = np.where(np.arange(40) % 2, 1.0, -1.0), np.ones(40)
    for before in (0.0 * every, 10.0 * every, -10.0 * signs):
        for change in (30.0 * every, 30.0 * signs):
            after = cells.changed(lag=before + change)
            found = step_errors(plan, cells, after, before, None, 600.0, 0.0)
            assert found.lag == pytest.approx(2.0 * abs(float((rate * change).sum())))
            turned = 30.0 * rate[before * change < 0.0].sum()
            assert found.lasting == pytest.approx(1.5 * turned, abs=1e-15)


def test_without_cells_or_growth_there_is_nothing_to_estimate():
    plan, cells = spread()
    nobody = cells.take(np.zeros(0, np.int64))
    none = step_errors(plan, nobody, nobody, nobody.lag, None, 600.0, 0.0)
    assert none == StepErrors(0.0, 0.0, 0.0, 0.0)
    still = replace(plan, law=None, growth=None)
    found = step_errors(still, cells, cells, cells.lag, None, 600.0, 0.5)
    assert found == StepErrors(0.5 / 40, 0.0, 0.0, 0.0)


# --- runs ------------------------------------------------------------------------------------


def test_steps_end_where_something_is_scheduled_and_at_frames():
    scene = mc.Scene.from_dict({
        **CALM, "duration": "10.1 h", "output": {"every": "2.7 h"},
        "nutrients": {"steps": {"boundary": 0.1, "uptake": 0, "media": [["1.1 h", 0.05]]}},
        "radiation": {"course": {"dose": "1 Gy", "times": ["4.13 h"], "alpha": 0.1}},
        "death": {},
    })  # fmt: skip
    times = times_of(Simulation(scene, threads=1))
    wanted = np.array([1.1, 2.7, 4.13, 5.4, 8.1, 10.1]) * HOUR
    assert np.isclose(np.array(times)[:, None], wanted).any(axis=0).all()
    assert times[-1] == scene.duration
    result = mc.run(scene, threads=1)
    np.testing.assert_allclose(
        [x.time for x in result.frames], np.array([0, 2.7, 5.4, 8.1, 10.1]) * HOUR
    )
    np.testing.assert_allclose(result.history["coupling_step"][1:], np.diff(times), rtol=1e-12)
    assert max(np.diff(times)) == pytest.approx(LONGEST)


def test_frames_closer_than_the_shortest_step_end_none():
    scene = mc.Scene.from_dict({**CALM, "duration": "1 h", "output": {"every": "1 s"}})
    simulation = run(scene)
    assert simulation.step_index <= 7
    assert len(mc.run(scene, threads=1).frames) == simulation.step_index + 1


@pytest.mark.parametrize("tolerance", [3e-3, 1e-3, 3e-4])
def test_the_volume_is_within_the_tolerance_where_a_medium_fades(tolerance):
    """The reference is the closed form of growth by Monod's law in a medium that falls to zero."""
    scene = mc.Scene.from_dict({
        **CALM, "coupling_tolerance": tolerance, "nutrients": {"oxygen": FADING},
    })  # fmt: skip
    simulation = run(scene)
    fade, half = 0.1 / (12.0 * HOUR), 0.05
    grown = 12.0 * HOUR - half / fade * np.log((half + 0.1) / half)
    true = 8 * 0.5 * 4.0 / 3.0 * np.pi * 5.0**3 * (1.0 + grown / (20 * HOUR))
    error = abs(float(simulation.cells.volume.sum()) / true - 1.0)
    assert error < tolerance
    assert simulation.step_index < {3e-3: 30, 1e-3: 45, 3e-4: 72}[tolerance]


def test_the_volume_is_within_the_tolerance_where_growth_presses():
    """Divisions and pressure leave an error of first order, which a lag does not see."""
    scene = mc.load_scene("spheroid").with_changes({
        "initial.count": 60, "initial.stage": "asynchronous", "duration": "15 h",
        "nutrients.oxygen.uptake": 0, "growth.critical_pressure": "0.03 kPa",
        "output.every": "15 h",
    })  # fmt: skip
    volume = {}
    for step, tolerance in (("1.25 min", None), ("40 min", None), ("auto", 3e-3)):
        changes = {"coupling_step": step, "coupling_tolerance": tolerance}
        simulation = run(scene.with_changes(changes))
        volume[step] = float(simulation.cells.volume.sum())
    assert volume["40 min"] / volume["1.25 min"] - 1.0 > 3e-3
    assert abs(volume["auto"] / volume["1.25 min"] - 1.0) < 3e-3
    assert 0.5 < 3e-3 / Lengths(*simulation.state.lengths).error < 10.0


def test_threads_and_resumes_change_no_bit():
    scene = mc.load_scene("spheroid").with_changes(STARVING)
    whole = Simulation(scene, threads=1)
    frames = [whole.frame()]
    while not whole.finished:
        whole.step()
        frames.append(whole.frame())
    assert len({x.time - y.time for y, x in pairwise(frames)}) > 3
    states = whole.cells.state
    assert (states == State.QUIESCENT).any()
    assert whole.cells.dead.any()
    two = Simulation(scene, threads=2)
    while not two.finished:
        two.step()
    assert digest(two) == digest(whole)
    for frame in frames[1 :: len(frames) // 4]:
        again = Simulation(scene, threads=1, frame=frame)
        while not again.finished:
            again.step()
        assert digest(again) == digest(whole)


def test_a_run_that_is_prolonged_is_the_longer_one(tmp_path):
    scene = mc.load_scene("spheroid").with_changes({**STARVING, "duration": "4.6 h"})
    mc.run(scene, output=tmp_path / "part", threads=1, report=False)
    longer = mc.resume(tmp_path / "part", changes={"duration": "6.9 h"}, threads=1, report=False)
    whole = mc.run(scene.with_changes({"duration": "6.9 h"}), threads=1)
    assert longer.frames[-1].progress.lengths == pytest.approx(whole.frames[-1].progress.lengths, 0)
    np.testing.assert_array_equal(longer.frames[-1].cells.position, whole.frames[-1].cells.position)


def test_a_run_says_which_lengths_it_chose():
    result = mc.run(mc.load_scene("spheroid").with_changes(STARVING), threads=1)
    summary, lengths = result.summary(), result.history["coupling_step"][1:]
    steps = summary["coupling_steps"]
    assert (steps["shortest"], steps["longest"]) == (lengths.min(), lengths.max())
    assert steps["longest"] <= LONGEST
    error = summary["splitting"]["first_order_error"]
    assert error == result.history["splitting_first_order_error"][-1] > 0.0
    words = dict(diagnostics(summary))["coupling steps"]
    assert f"{lengths.min() / 60:.3g} to {lengths.max() / 60:.3g} min" in words
    assert summary["units"]["coupling_steps.longest"] == "s"


def test_a_fixed_length_says_nothing_of_it():
    simulation = run(mc.load_scene("spheroid"), steps=2)
    assert simulation.state.lengths == ()
    assert "coupling_step" not in simulation.history_row()
    assert "coupling_steps" not in simulation.summary()
    assert simulation.time == 1200.0


# --- scenes ----------------------------------------------------------------------------------


def test_the_word_stands_for_two_keys():
    scene = mc.load_scene("spheroid").with_changes(coupling_step="auto")
    assert (scene.coupling_step, scene.coupling_tolerance) == (LONGEST, 1e-3)
    assert mc.Scene.from_dict(scene.to_dict()) == scene
    assert "coupling_tolerance = 0.001" in scene.to_toml()
    finer = scene.with_changes(coupling_tolerance=3e-4)
    assert (finer.coupling_step, finer.coupling_tolerance) == (LONGEST, 3e-4)
    assert finer.with_changes(duration="2 d").coupling_tolerance == 3e-4
    assert finer.with_changes(coupling_step="auto").coupling_tolerance == 3e-4
    assert finer.with_changes(coupling_step="30 min").coupling_tolerance is None
    # one length for all again
    assert finer.with_changes(coupling_step="5 min").coupling_tolerance is None
    both = scene.with_changes({"coupling_tolerance": 0.01, "coupling_step": "5 min"})
    assert (both.coupling_step, both.coupling_tolerance) == (300.0, 0.01)


@pytest.mark.parametrize(("key", "value", "words"), [
    ("coupling_step", "autp", "Did you mean 'auto'"),
    ("coupling_step", "soon", "must be a time or 'auto'"),
    ("coupling_step", 0, "above 0"),
    ("coupling_tolerance", 0.5, "at most 0.1"),
    ("coupling_tolerance", "auto", "number"),
    ("coupling_tolerence", 1e-3, "coupling_tolerance"),
])  # fmt: skip
def test_what_is_refused_is_said_in_words(key, value, words):
    with pytest.raises(SceneError) as refused:
        mc.load_scene("spheroid").with_changes({key: value})
    assert words in str(refused.value)


@pytest.mark.parametrize(("changes", "minutes"), [
    ({}, 40),
    ({"growth.cycle_time": "6 h"}, 10),
    ({"cells.reaction_time": "1 h"}, 20),
    ({"death.lysis_time": "1 h"}, 10),
    ({"motility": {"force": "1 nN"}}, 10),
    ({"coupling_step": "7 min", "coupling_tolerance": 1e-3}, 7),
])  # fmt: skip
def test_no_step_is_longer_than_what_a_scene_has_allows(changes, minutes):
    scene = mc.load_scene("spheroid").with_changes({"coupling_step": "auto"})
    scene = scene.with_changes(changes)
    assert longest_coupling_step(scene) == pytest.approx(60.0 * minutes)
    assert step_plan(scene).coupling_step == longest_coupling_step(scene)
    assert longest_coupling_step(scene) in {scene.coupling_step / 2**k for k in range(9)}


def test_neighbours_that_cells_count_allow_ten_minutes():
    counted = {
        "behaviour": "rest",
        "signal": "neighbours",
        "law": "threshold",
        "half": 8,
        "largest": 1,
    }
    scene = mc.load_scene("growth").with_changes({"coupling_step": "auto", "responses": [counted]})
    assert longest_coupling_step(scene) == 600.0


def test_explain_says_that_lengths_are_chosen():
    scene = mc.load_scene("spheroid").with_changes({"coupling_step": "auto"})
    steps = next(x for x in explain(scene)["numbers"] if x["name"] == "coupling steps")
    assert "chosen for an error of 0.1 % of the volume, up to 2400 s long" in steps["meaning"]
    assert scene.duration / LONGEST <= steps["value"] <= scene.duration / (LONGEST / 32)


def test_coarse_cells_choose_the_same_lengths():
    scene = mc.load_scene("wm983b").with_changes({"coupling_step": "auto"})
    coarse = mc.coarsen(scene, 2)
    assert (coarse.coupling_step, coarse.coupling_tolerance) == (LONGEST, 1e-3)
