"""Phases and divisions that begin when a signal passes a value."""

from __future__ import annotations

import math

import numpy as np
import pytest

import multicell as mc
from multicell import network
from multicell.errors import SceneError
from multicell.report.explain.scene import explain

RATE = 1.0 / 3600.0  # 1/s, of a clock that rises by 1 in an hour


@network(states={"A": 0.0}, parameters={"k": RATE}, amounts=("A",))
def clock(t, y, u, p, out):
    """A clock; as an amount it is halved at a division."""
    out[0] = p[0]


LINE = {
    "initial.count": 1, "initial.stage": "birth", "coupling_step": "7 min", "duration": "5 h",
    "contact.surface_energy": 0.0, "growth.restriction": False, "growth.cycle_time": None,
    "growth.phases": {
        "G1": {"duration": "1 h"}, "S": {"duration": "30 min"}, "G2": {"duration": "20 min"},
        "M": {"duration": "10 min"},
    },
    "networks": {"clock": {"network": clock}},
}  # fmt: skip


def _scene(changes):
    return mc.load_scene("growth").with_changes({**LINE, **changes})


def _run(changes, step=None):
    scene = _scene(changes if step is None else {**changes, "coupling_step": step})
    simulation = mc.Simulation(scene, threads=1)
    births, phases, known = {}, [], set()
    while not simulation.finished:
        simulation.step()
        cells = simulation.cells
        phases.append((simulation.time, cells.phase.copy(), cells.progress.copy()))
        for row in np.flatnonzero((cells.parent >= 0) & ~np.isin(cells.id, list(known))):
            births[int(cells.id[row])] = simulation.time - cells.age[row]
        known |= set(cells.id.tolist())
    return simulation, births, phases


@pytest.mark.parametrize("step", ["2 min", "7 min", "13 min"])
def test_a_phase_begins_where_a_value_passes(step):
    # G1 would last for an hour; the clock shows 0.4 after 24 minutes
    changes = {"growth.phases.S.after": "clock.A > 0.4"}
    _, births, phases = _run(changes, step)
    for time, phase, progress in phases:
        if 1441.0 < time < 1440.0 + 1800.0:
            assert phase[0] == 2
            assert progress[0] == pytest.approx(time - 1440.0, abs=1e-3)
    # the clock shows 0.4 + 1 at the division, 0.7 after it: the daughters' G1 is over at once
    first, later = births[1], sorted(births.values())[2]
    assert first == pytest.approx(1440.0 + 3600.0, abs=1e-3)
    assert later == pytest.approx(first + 3600.0, abs=1e-3 if step != "13 min" else 800.0)


@pytest.mark.parametrize("step", ["2 min", "7 min", "29 min"])
def test_a_cell_divides_where_a_value_passes_and_shares_it_then(step):
    # in M after 110 min, the clock shows 2.5 after 150; 1.25 in the daughters, 2.5 75 min later
    phases = {"G1": "20 min", "S": "10 min", "G2": "10 min", "M": "1 h"}
    changes = {f"growth.phases.{name}.duration": x for name, x in phases.items()}
    changes["growth.phases.G1.after"] = "clock.A > 2.5"
    simulation, births, _ = _run({**changes, "duration": "6 h"}, step)
    times = np.unique(np.round(sorted(births.values()), 2))
    np.testing.assert_allclose(times, 3600.0 * np.array([2.5, 3.75, 5.0]), atol=0.05)
    assert len(simulation.cells) == 8
    since = simulation.time - 5.0 * 3600.0
    np.testing.assert_allclose(simulation.cells.inside[:, 0], 1.25 + RATE * since, rtol=1e-6)
    np.testing.assert_allclose(simulation.cells.age, since, atol=0.05)


@network(states={"A": 1.0}, inputs={"drive": 0.0}, parameters={"k": 2e-4}, amounts=("A",))
def driven(t, y, u, p, out):
    """Decay, faster the older the cell is."""
    out[0] = -p[0] * (0.2 + u[0]) * y[0]


def test_the_time_of_a_passage_is_of_second_order_in_the_step():
    # the volume, on which A depends, is known at the ends of steps, and is no straight line
    wave = {"behaviour": "growth rate", "signal": "time", "half": "1 h"}
    part = {"network": driven, "inputs": {"drive": "volume"}, "scales": {"drive": 2e-3},
            "tolerance": 1e-10}  # fmt: skip
    changes = {
        "networks": {"decay": part}, "responses": {"wave": wave}, "duration": "2 h",
        "growth.phases.S": {"duration": "5 h", "grows": False, "after": "decay.A < 0.5"},
    }  # fmt: skip
    steps, found = [1200.0, 600.0, 300.0, 150.0, 18.75], []
    for step in steps:
        _, _, phases = _run(changes, step)
        time, _, progress = next(x for x in phases if x[1][0] == 2)
        found.append(time - progress[0])
    errors = np.abs(np.array(found[:-1]) - found[-1])
    slope = np.polyfit(np.log(steps[:-1]), np.log(errors), 1)[0]
    assert slope == pytest.approx(1.9, abs=0.15)
    assert errors[-1] < 2.0


@pytest.mark.parametrize("step", ["4 min", "11 min"])
@pytest.mark.parametrize(("condition", "want"), [
    ("time > 50 min", 3000.0),
    ("age > 3000", 3000.0),
    ("neighbours < 1", 0.0),
    ("neighbours > 0", math.inf),
])  # fmt: skip
def test_any_signal_starts_a_phase_at_its_time(condition, want, step):
    changes = {"growth.phases.S.after": condition, "growth.phases.S.duration": "5 h",
               "networks": {}, "duration": "2 h"}  # fmt: skip
    _, _, phases = _run(changes, step)
    if want == math.inf:
        assert all(phase[0] == 1 for _, phase, _ in phases)
        return
    time, _, progress = next(x for x in phases if x[1][0] == 2)
    assert time - progress[0] == pytest.approx(want, abs=1e-3)


def test_contacts_are_counted_where_a_condition_asks_for_them():
    changes = {"growth.phases.S.after": "neighbours > 0", "initial.count": 2,
               "initial.shape": "row", "initial.spacing": 0.9, "networks": {},
               "growth.phases.S.duration": "5 h", "duration": "1 h"}  # fmt: skip
    _, _, phases = _run(changes)
    assert (phases[-1][1] == 2).all()


def test_a_field_that_falls_starts_a_phase():
    # one cell takes up 100 amol/s of what 2e6 µm³ hold: 0.1 of 0.2 mM are gone after 2,000 s
    food = {"boundary": 0.2, "uptake": 100.0, "half_saturation": 1e-6, "spacing": 10.0,
            "diffusion": 2000.0, "finite_medium": {"volume": "2e6 um^3"}}  # fmt: skip
    found = []
    for step in ("3 min", "9 min"):
        changes = {"nutrients": {"food": food}, "growth.phases.S.after": "food < 0.1",
                   "growth.phases.S.duration": "5 h", "networks": {},
                   "duration": "1 h"}  # fmt: skip
        _, _, phases = _run(changes, step)
        time, _, progress = next(x for x in phases if x[1][0] == 2)
        found.append(time - progress[0])
    assert found[0] == pytest.approx(2000.0, rel=0.1)  # the cell finds a little less than there is
    assert found[1] == pytest.approx(found[0], rel=1e-3)


def test_a_phase_that_waits_lasts_as_long_as_its_condition_wants():
    _, births, phases = _run({"growth.phases.S.after": "clock.A > 40"})
    assert not births
    assert all(phase[0] == 1 for _, phase, _ in phases)


def test_a_run_with_conditions_resumes_with_the_same_bits(tmp_path):
    changes = {
        "growth.phases.G1.after": "clock.A > 1.6", "duration": "4 h", "output.every": "70 min",
        "networks.clock.parameters": {"k": {"mean": RATE, "variation": 0.2}}, "initial.count": 4,
        "networks.clock.divide": {"A": "share"},
    }  # fmt: skip
    whole = mc.run(_scene(changes), output=tmp_path / "whole", report=False)
    mc.run(_scene({**changes, "duration": "70 min"}), output=tmp_path / "part", report=False)
    resumed = mc.resume(tmp_path / "part", changes={"duration": "4 h"}, report=False)
    one, other = whole.frames[-1], resumed.frames[-1]
    assert len(one.cells) > 8
    for name, column in one.cells.columns():
        np.testing.assert_array_equal(column, getattr(other.cells, name), err_msg=name)


def test_two_daughters_share_what_their_mother_had_when_her_time_came():
    changes = {
        "growth.phases.G1.after": "clock.A > 2.6", "duration": "4 h", "initial.count": 6,
        "networks.clock.parameters": {"k": {"mean": RATE, "variation": 0.1}},
        "networks.clock.divide": {"A": "share"}, "coupling_step": "31 min",
    }  # fmt: skip
    simulation, _, _ = _run(changes)
    cells = simulation.cells
    part = simulation.plan.networks.parts["clock"]
    own = part.values(cells.id)[:, 0]
    born = cells.inside[:, 0] - own * cells.age
    for mother in np.unique(cells.parent[cells.parent >= 0]):
        pair = born[cells.parent == mother]
        assert len(pair) == 2
        assert pair.sum() == pytest.approx(2.6, rel=1e-6)
    assert np.unique(cells.parent).size >= 6


@pytest.mark.parametrize(("text", "words", "hint"), [
    ("clock.A", "must be 'SIGNAL > VALUE'", "cycle.MPF > 0.1"),
    ("clok.A > 1", "no signal here", "Did you mean 'clock.A'?"),
    ("presure > 1 kPa", "no signal here", "pressure"),
    ("pressure > 1 mM", "mM", ""),
    ("clock.A > much", "much", ""),
    ("phase S > 0.5", "which the cycle itself sets", ""),
    ("> 3", "must be 'SIGNAL > VALUE'", ""),
])  # fmt: skip
def test_what_is_no_condition_is_refused(text, words, hint):
    with pytest.raises(SceneError) as found:
        _scene({"growth.phases.S.after": text})
    assert found.value.path == "growth.phases.S.after"
    assert words in found.value.problem
    assert hint in (found.value.hint or "")


def test_a_condition_where_it_makes_no_sense_is_refused():
    with pytest.raises(SceneError, match=r"responses.entry"):
        _scene({
            "growth.phases.S.after": "clock.A > 1",
            "responses.entry": {"behaviour": "entry into S", "signal": "clock.A", "half": 1.0},
        })  # fmt: skip
    with pytest.raises(SceneError, match=r"growth.phases"):
        mc.load_scene("growth").with_changes({"growth.phases.S.after": "age > 3 h"})
    with pytest.raises(SceneError, match=r"have no network 'clock'"):
        _scene({
            "growth.phases.S.after": "clock.A > 1", "types": {"a": {}, "b": {}},
            "networks.clock.cells": "b",
        })  # fmt: skip
    with pytest.raises(SceneError, match="without bound"):
        _scene({"growth.phases.G1.after": "clock.A > 1", "growth.law": "exponential"})


def test_a_scene_names_its_condition_in_full():
    scene = _scene({"growth.phases.S.after": "age > 3 h"})
    again = mc.Scene.from_dict(scene.to_dict())
    assert again.growth.phases["S"].after == "age > 3 h"
    assert "S once age > 3 h" in str(explain(scene))
    assert math.isfinite(scene.growth.mean_cycle)
