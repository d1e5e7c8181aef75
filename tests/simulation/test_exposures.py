"""Exposures and rates do not depend on how a run is cut into coupling steps."""

import numpy as np
import pytest
from scipy import integrate

import multicell as mc
from multicell import Scene, Simulation
from multicell.biology.exposure import Exposure
from multicell.biology.plan import biology_plan
from multicell.biology.responding import rate_of_harm
from multicell.biology.states import deaths
from multicell.cells import State
from multicell.random import Purpose, thresholds
from multicell.report.explain.scene import explain
from multicell.scene.steps import StepPlan, step_plan

HOUR, MINUTE = 3600.0, 60.0
STEPS = (40.0, 20.0, 10.0)  # min
COUNT = 600
# a pulse that begins and ends at times that are multiples of no step
PULSE = [["0.713 h", "1 mM"], ["3.377 h", "0 mM"]]


def described(field, *, count=COUNT, step=10.0, **parts):
    """Return cells at rest, far apart, in a drug that none of them takes up."""
    return Scene.from_dict({
        "duration": "6 h", "coupling_step": f"{step} min", "seed": 3, "contact": {"law": "hertz"},
        "initial": {"count": count, "spacing": 3.0}, "output": {"every": "6 h"},
        "nutrients": {"drug": {"boundary": 0, "uptake": 0, "geometry": "radial", **field}},
        **parts,
    })  # fmt: skip


def harm(law, largest, behaviour="damage rate", **more):
    return [{"behaviour": behaviour, "signal": "drug", "law": law, "largest": largest, **more}]


RISING = {
    "regime": "steady", "media_change": "linear",
    "media": [["0.713 h", "0 mM"], ["2.05 h", "1 mM"], ["3.377 h", "0 mM"]],
}  # fmt: skip
# without flow over its sides a perfused field is the same everywhere: c' = p (medium - c)
PERFUSED = {
    "regime": "transient", "media": PULSE, "perfusion": "2 1/h", "time_tolerance": 1e-5,
    "sides": {"*": {"type": "derivative", "derivative": 0}},
}  # fmt: skip
FIELDS = {"steady": RISING, "transient": PERFUSED}


def concentration(kind, t):
    """Return the concentration at cells at a time in h, mM: by hand."""
    begin, end = 0.713, 3.377
    if kind == "steady":
        return np.interp(t, [begin, 2.05, end], [0.0, 1.0, 0.0])
    rises = 1.0 - np.exp(-2.0 * (np.clip(t, begin, end) - begin))
    return rises * np.exp(-2.0 * np.maximum(t - end, 0.0))


def exact(kind, rate):
    """Return the integral of a rate in 1/h of the concentration over the run, by SciPy."""
    knots = [0.713, 2.05, 3.377]
    return integrate.quad(
        lambda t: float(rate(concentration(kind, t))), 0.0, 6.0, points=knots, limit=400,
        epsabs=1e-9,
    )[0]  # fmt: skip


def finished(scene):
    simulation = Simulation(scene, threads=1)
    while not simulation.finished:
        simulation.step()
    return simulation


LAWS = {
    "hill": ({"law": "hill", "half": "0.4 mM", "power": 3}, lambda c: c**3 / (c**3 + 0.4**3)),
    "linear": (
        {"law": "linear", "begin": "0.1 mM", "end": "0.6 mM"},
        lambda c: np.clip((c - 0.1) / 0.5, 0.0, 1.0),
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("kind", FIELDS)
def test_damage_is_of_second_order(kind, law):
    keys, rate = LAWS[law]
    true = 0.1 * exact(kind, rate)
    found = []
    for step in STEPS:
        responses = harm(keys["law"], "0.1 1/h", **{k: x for k, x in keys.items() if k != "law"})
        scene = described(FIELDS[kind], count=3, step=step, responses=responses)
        damage = finished(scene).cells.damage
        assert np.ptp(damage) < 1e-9
        found.append(abs(damage[0] / true - 1.0))
    assert found[-1] < 2e-3
    if found[-1] > 2e-5:  # else nothing but rounding and the field's own tolerance is left
        assert np.polyfit(np.log(STEPS), np.log(found), 1)[0] > 1.7


@pytest.mark.parametrize("kind", FIELDS)
@pytest.mark.parametrize("step", STEPS)
def test_a_threshold_acts_for_as_long_as_the_signal_is_beyond_it(kind, step):
    """On the transient field between the moments of its own solver."""
    scene = described(
        FIELDS[kind], count=2, step=step, death={"damage_time": "5 h"},
        **{"nutrients": {"drug": {"boundary": 0, "uptake": 0, "geometry": "radial",
                                  **FIELDS[kind], "necrosis_above": "0.45 mM"}}},
    )  # fmt: skip
    true = exact(kind, lambda c: c > 0.45) / 5.0
    assert finished(scene).cells.damage == pytest.approx(
        true, rel=1e-6 if kind == "steady" else 2e-3
    )


@pytest.mark.parametrize("behaviour", ["necrosis rate", "apoptosis rate"])
@pytest.mark.parametrize("kind", FIELDS)
@pytest.mark.slow
def test_the_same_cells_die_at_each_length_of_step(kind, behaviour):
    """Survivors are exp(-integral of the hazard), and each cell has one draw for all lengths."""
    rate = LAWS["hill"][1]
    expected = np.exp(-0.3 * exact(kind, rate))
    responses = harm("hill", "0.3 1/h", behaviour, half="0.4 mM", power=3)
    alive = []
    for step in (*STEPS, 5.0):
        scene = described(FIELDS[kind], step=step, responses=responses, death={})
        cells = finished(scene).cells
        alive.append(~cells.dead[np.argsort(cells.id)])
        sigma = np.sqrt(expected * (1.0 - expected) / COUNT)
        assert abs(alive[-1].mean() - expected) < 4.0 * sigma
    differ = [int((x != alive[-1]).sum()) for x in alive[:-1]]
    assert differ[2] <= 1
    assert differ[1] <= 2
    assert differ[0] <= 10


def test_a_step_ends_where_something_changes_and_nowhere_twice():
    plan = StepPlan(600.0, 3000.0, changes=(250.0, 1200.0 + 1e-8, 1799.9999999, 2000.0, 2990.0))
    time, ends = 0.0, []
    while time < 3000.0:
        ends.append(time := plan.end_after(time))
    assert ends == [250.0, 600.0, 1200.0 + 1e-8, 1800.0, 2000.0, 2400.0, 2990.0, 3000.0]
    assert [plan.steps_after(t) for t in (0.0, *ends)] == list(range(8, -1, -1))
    assert plan.added == (250.0, 2000.0, 2990.0)
    # a run's end that is no multiple, and one that another run goes beyond
    assert StepPlan(600.0, 1000.0).end_after(600.0) == 1000.0
    assert StepPlan(600.0, 1000.0).next_end(600.0) == 1200.0
    # thirds that rounding takes apart are one end
    third = 0.1 + 0.2
    plan = StepPlan(0.1, 1.0, changes=(third, 0.3))
    assert plan.steps_after(0.0) == 10
    assert plan.end_after(0.2) == third


def test_all_that_is_scheduled_ends_a_step():
    scene = Scene.from_dict({
        "duration": "10 h", "coupling_step": "1 h", "initial": {"count": 2}, "growth": {},
        "death": {}, "adhesion": {},
        "types": {"a": {"receptor": [["0 h", 0.0], ["0.1 h", 1.0]], "ligand": 1.0}},
        "nutrients": {
            "steps": {"boundary": 0.1, "uptake": 0, "media": [["1.1 h", 0.05]]},
            "linear": {"boundary": 0.1, "uptake": 0, "media": [["2.1 h", 0.05], ["3.1 h", 0.02]],
                       "media_change": "linear"},
        },
        "radiation": {"course": {"dose": "1 Gy", "times": ["4.1 h", "5 h"], "alpha": 0.1}},
        "motions": {"held": {"cells": [0], "begin": "6.1 h", "end": "7.1 h"}},
        "responses": [{"behaviour": "apoptosis rate", "signal": "time", "law": "threshold",
                       "half": "8.1 h", "largest": "0.1 1/h"}],
    })  # fmt: skip
    plan, tenths = step_plan(scene), [0.1, 1.1, 2.1, 3.1, 4.1, 6.1, 7.1, 8.1]
    np.testing.assert_allclose(np.array(plan.added) / HOUR, tenths)
    steps = next(x for x in explain(scene)["numbers"] if x["name"] == "coupling steps")
    assert steps["value"] == 18
    assert "8 of them" in steps["meaning"]
    ends = [0.0]
    simulation = Simulation(scene, threads=1)
    while not simulation.finished:
        simulation.step()
        ends.append(simulation.time / HOUR)
    np.testing.assert_allclose(ends, sorted([*range(11), *tenths]), rtol=1e-12)
    assert simulation.step_index == simulation.steps == 18


@pytest.mark.slow
def test_runs_with_steps_of_several_lengths_are_resumed_and_prolonged_to_the_bit(tmp_path):
    responses = harm("hill", "0.5 1/h", "apoptosis rate", half="0.4 mM")
    scene = described(
        PERFUSED, count=20, step=30.0, responses=responses, death={"damage_time": "3 h"},
        growth={"cycle_time": "4 h"}, duration="5 h", output={"every": "50 min"},
    )  # fmt: skip
    scene = scene.with_changes({"nutrients.drug.necrosis_above": "0.3 mM"})
    whole = mc.run(scene, output=tmp_path / "whole", report=False, threads=1)
    assert {"apoptosis_hazard", "damage"} <= dict(whole.frames[-1].cells.columns()).keys()
    mc.run(scene.with_changes({"duration": "3 h"}), output=tmp_path / "short", report=False,
           threads=1)  # fmt: skip
    longer = {"duration": "5 h"}
    others = [mc.resume(tmp_path / "short", report=False, threads=1, changes=longer)]
    for k in (1, 3):
        others.append(mc.resume(tmp_path / "whole", k, output=tmp_path / f"{k}", report=False))
    for other in others:
        here, there = whole.frames[-1], other.frames[-1]
        assert (here.time, here.step) == (there.time, there.step)
        for name, column in here.cells.columns():
            np.testing.assert_array_equal(column, getattr(there.cells, name))


def test_cells_that_switch_to_and_fro_are_a_markov_chain_at_any_step():
    """With constant rates the chain has the same switches at each length of step."""
    there, back, count = 0.9, 0.4, 3000
    responses = [
        {"behaviour": "change to b", "cells": "a", "law": "constant", "largest": f"{there} 1/h"},
        {"behaviour": "change to a", "cells": "b", "law": "constant", "largest": f"{back} 1/h"},
    ]
    kinds = []
    for step in (120.0, 7.0):
        scene = Scene.from_dict({
            "duration": "4 h", "coupling_step": f"{step} min", "contact": {"law": "hertz"},
            "initial": {"count": count, "spacing": 3.0}, "output": {"every": "4 h"},
            "types": {"a": {"fraction": 1}, "b": {"fraction": 0}}, "responses": responses,
        })  # fmt: skip
        cells = finished(scene).cells
        kinds.append(cells.kind[np.argsort(cells.id)])
    np.testing.assert_array_equal(*kinds)
    total = there + back
    expected = there / total * (1.0 - np.exp(-4.0 * total))
    sigma = np.sqrt(expected * (1.0 - expected) / count)
    assert abs(kinds[0].mean() - expected) < 4.0 * sigma
    assert cells.type_changes.max() > 3


@pytest.mark.slow
def test_a_short_pulse_kills_at_each_length_of_step():
    """A pulse of 4.8 min that kills after 3 min of it."""
    media = [["3.03 h", "3.5e-3 mM"], ["3.11 h", "0 mM"]]
    scene = mc.load_scene("dosing").with_changes({
        "initial.count": 30, "duration": "4 h", "death.damage_time": "3 min", "seed": 11,
        "nutrients.drug.regime": "transient", "nutrients.drug.media": media,
        "nutrients.drug.uptake": 0,
    })  # fmt: skip
    for step in (15, 10, 2.5):
        cells = finished(scene.with_changes({"coupling_step": f"{step} min"})).cells
        assert (cells.state == State.NECROTIC).all()


SHIELDED = {
    "initial.count": 100,
    "duration": "1.2 h",
    "death.damage_time": "15 min",
    "nutrients.drug.regime": "transient",
    "nutrients.drug.media": [["0.53 h", "3.5e-3 mM"], ["0.8633 h", "0 mM"]],
}
"""A pulse of 20 min that kills after 15 min of it, and that living cells keep from those within."""


def killed(step, **changes):
    """Return the dead of a shielded pulse, and by how many the run says that these may be off."""
    scene = mc.load_scene("dosing").with_changes({**SHIELDED, "coupling_step": step, **changes})
    simulation = finished(scene)
    return int(simulation.cells.dead.sum()), abs(simulation.exposures["error"])


@pytest.mark.slow
def test_a_pulse_that_cells_shield_each_other_from_kills_at_each_length_of_step():
    """Cells of one size; read at the ends of steps, 15 and 10 min let half of them live."""
    dead = [killed(f"{step} min", growth=None)[0] for step in (15, 10, 2.5, 1)]
    assert dead[-1] > 70
    np.testing.assert_allclose(dead, dead[-1], rtol=0.05)


@pytest.mark.parametrize("seed", [0, 2])
@pytest.mark.slow
def test_deaths_that_expose_others_in_the_same_step_are_not_missed(seed):
    """With growth: what is left is where divisions at the ends of steps put cells, and reported."""
    fine = killed("1 min", seed=seed)[0]
    for step in ("10 min", "5 min"):  # with one correction a sixth to a quarter is missing
        dead, reported = killed(step, seed=seed)
        assert abs(dead - fine) < 0.08 * fine
        assert abs(dead - fine) < 3.0 * reported + 1.0
        assert reported < 8.0


@pytest.mark.slow
def test_a_dose_that_comes_and_goes_within_a_step_kills_at_once():
    """The field is above the threshold only between the ends of a step."""
    scene = described(
        {**PERFUSED, "perfusion": "60 1/h", "media": [["1.3 h", "1 mM"], ["1.35 h", "0 mM"]],
         "necrosis_above": "0.9 mM"}, count=4, step=60.0, death={},
    )  # fmt: skip
    simulation = Simulation(scene, threads=1)
    most = 0.0
    while simulation.time < 1.9 * HOUR:
        simulation.step()
        most = max(most, float(simulation.concentrations["drug"].max()))
    assert 0.9 < most < 1.0
    assert simulation.cells.dead.all()


def test_thresholds_are_exponential_and_belong_to_the_cell():
    from scipy import stats

    ids = np.arange(20_000)
    found = thresholds(3, Purpose.NECROSIS, 0, ids)
    assert stats.kstest(found, "expon").pvalue > 1e-3
    events = np.arange(20_000) % 3
    mixed = thresholds(3, Purpose.NECROSIS, events, ids)
    for event in range(3):
        of = events == event
        np.testing.assert_array_equal(mixed[of], thresholds(3, Purpose.NECROSIS, event, ids[of]))


def test_a_scene_without_rates_integrates_nothing(monkeypatch):
    def never(*_, **__):
        raise AssertionError

    monkeypatch.setattr(Exposure, "integral", never)
    scene = mc.load_scene("spheroid").with_changes({"initial.count": 20, "duration": "1 h"})
    simulation = finished(scene)
    assert simulation.step_index == step_plan(scene).steps_after(0.0)
    assert simulation.cells.necrosis_hazard is simulation.cells.change_hazard is None


DYING = {
    "necrosis_rate": ({"necrosis": "0.3 mM"}, {"necrosis_rate": "0.3 1/h"}),
    "lives": ({}, {"apoptosis_rate": "0.05 1/h"}),
    "at once": ({"necrosis": "0.3 mM"}, {}),
}


@pytest.mark.slow
@pytest.mark.parametrize("death", DYING)
def test_growth_is_of_second_order_where_cells_die(death):
    """The dead shrink, and leave the others what they do not take up, since their own time."""
    limits, dying = DYING[death]
    glucose = {
        "boundary": "1 mM", "uptake": "0.25 amol/s", "half_saturation": "0.1 mM",
        "growth_half_saturation": "0.3 mM", "regime": "transient", "time_tolerance": 1e-4,
        "sides": {"*": {"type": "derivative", "derivative": 0}}, "spacing": "20 um",
        "diffusion": "200000 um^2/s", **limits,
    }  # fmt: skip
    volumes = []
    for step in (40.0, 20.0, 10.0, 1.25):
        scene = Scene.from_dict({
            "duration": "20 h", "coupling_step": f"{step} min", "contact": {"law": "hertz"},
            "domain": {axis: [-40, 40] for axis in "xyz"}, "cells": {"young_variation": 0},
            "growth": {"cycle_time": "60 h"}, "initial": {"count": 50, "spacing": 1.2},
            "integrator": "rkc2", "output": {"every": "20 h"}, "nutrients": {"glucose": glucose},
            "death": {"lysis_time": "12 h", **dying},
        })  # fmt: skip
        simulation = finished(scene)
        assert simulation.cells.dead.sum() > 20
        assert simulation.ledger["glucose"].relative_remainder < 1e-8
        volumes.append(simulation.cells.volume.sum())
    errors = np.abs(np.array(volumes[:3]) / volumes[3] - 1.0)
    assert errors[2] < 1e-4  # read at the ends of steps only, 0.6 %
    assert np.polyfit(np.log([40.0, 20.0, 10.0]), np.log(errors), 1)[0] > 1.7


@pytest.mark.slow
@pytest.mark.parametrize("law", ["jkr", "exact-jkr"])
def test_the_time_of_a_separation_does_not_depend_on_the_step(law):
    found = [
        finished(mc.load_scene("doublet").with_changes(
            {"coupling_step": step, "contact.law": law}
        )).separation
        for step in ("10 s", "5 min")
    ]  # fmt: skip
    assert found[1]["time"] == pytest.approx(found[0]["time"], abs=0.5)
    assert found[1]["force"] == pytest.approx(1.5 * np.pi * 0.1 * 5.0, rel=0.01)


def test_what_kills_by_rate_and_at_once_is_noted_apart():
    scene = described(
        {"boundary": "1 mM", "regime": "steady"}, count=5, death={"necrosis_rate": "1 1/h"}
    )
    plan = biology_plan(scene)
    assert plan.acting == ()  # nothing leads to a death by that rate
    scene = scene.with_changes({"nutrients.drug.necrosis_above": "0.5 mM"})
    plan, simulation = biology_plan(scene), Simulation(scene, threads=1)
    assert plan.acting == ("necrosis rate",)
    cells, found = simulation.cells, simulation.concentrations
    dying = deaths(plan, cells, found, Exposure(cells, found, 100.0 * HOUR))
    assert np.isfinite(dying.necrosis).all()
    # of the 100 of the whole time each cell has had its own until it died
    own = thresholds(3, Purpose.NECROSIS, 0, cells.id)
    np.testing.assert_allclose(dying.columns["necrosis_hazard"], own, rtol=1e-9)
    assert cells.necrosis_hazard is None
    np.testing.assert_allclose(rate_of_harm(plan, "necrosis rate", found, cells) * HOUR, 1.0)


def test_daughters_mutate_by_what_is_found_at_their_birth():
    """In a medium that changes all the while, by the same draws at each length of step."""
    field = {"boundary": 0, "regime": "steady", "media_change": "linear",
             "media": [["0 h", "0 mM"], ["24 h", "1 mM"]]}  # fmt: skip
    law = {"signal": "drug", "law": "linear", "begin": "0 mM", "end": "1 mM", "largest": 0.8}
    kinds = []
    for step in (120.0, 10.0):
        scene = described(
            field, count=60, step=step, duration="24 h", growth={"cycle_time": "9 h"},
            initial={"count": 60, "spacing": 3.0, "stage": "uniform"},
            types={"wild": {}, "mutant": {"fraction": 0}}, output={"every": "24 h"},
            responses=[{"behaviour": "mutation to mutant", "cells": "wild", **law}],
        )  # fmt: skip
        simulation = finished(scene)
        table, cells = simulation.lineage.table(), simulation.cells
        place = np.searchsorted(table["id"], cells.id)
        np.testing.assert_array_equal(table["kind"][place], cells.kind)
        born = table["parent"] >= 0
        kinds.append(table["kind"][born])
    assert 0.2 < kinds[1].mean() < 0.8
    assert (kinds[0] != kinds[1]).mean() < 0.01  # by what their mothers found: one in 25
