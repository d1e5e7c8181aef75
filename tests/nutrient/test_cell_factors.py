"""Uptake and secretion by type, phase and state, each by factors of its own."""

import numpy as np
import pytest

import multicell as mc
from multicell.cells import Phase, State
from multicell.errors import SceneError
from multicell.nutrient.fields import Feeding
from multicell.scene.scene import Scene

PHASES = {name: {"duration": "4 h"} for name in ("G1", "S", "G2", "M")}


def scene(nutrient, types=None, **changes):
    entries = {
        "duration": "30 min", "coupling_step": "10 min", "contact": {"law": "hertz"},
        "initial": {"count": 60, "stage": "asynchronous"}, "growth": {"phases": PHASES},
        "types": types or {}, "nutrients": {"a": {"uptake": 10.0, "secretion": 3.0, **nutrient}},
    }  # fmt: skip
    return Scene.from_dict(entries | changes)


def demand(described):
    """Return cells in all states and phases, and what the fields take as their demand."""
    cells = mc.Simulation(described).cells.copy()
    cells.state = np.resize(np.array(State, dtype=cells.state.dtype), len(cells))
    cells.phase = np.resize(np.repeat(np.array(Phase, dtype=cells.phase.dtype), 7), len(cells))
    return cells, *Feeding(described).demand_now("a", cells)


def test_without_factors_secretion_goes_with_uptake():
    described = scene({"quiescent_uptake": 0.3}, {"x": {}, "y": {"uptake_scale": 2.0}})
    cells, uptake, secretion = demand(described)
    expected = np.array([1.0, 0.3, 0.0, 0.0])[cells.state] * np.array([1.0, 2.0])[cells.kind]
    np.testing.assert_array_equal(uptake, 10.0 * expected)
    np.testing.assert_array_equal(secretion, 3.0 * expected)


def test_each_factor_has_its_effect_on_one_of_the_two():
    types = {
        "x": {"uptake_scale": 2.0, "secretion_scale": 5.0, "uptake_of": {"a": 3.0}},
        "y": {"uptake_scale": 0.5, "secretion_of": {"a": 7.0}},
    }
    nutrient = {
        "quiescent_uptake": 0.3,
        "secretion_by_state": {"quiescent": 4.0, "necrotic": 6.0},
        "uptake_by_phase": {"S": 1.5}, "secretion_by_phase": {"M": 0.0, "G1": 2.0},
    }  # fmt: skip
    cells, uptake, secretion = demand(scene(nutrient, types))
    assert len(set(cells.kind)) == 2
    assert len(set(zip(cells.state.tolist(), cells.phase.tolist(), strict=True))) > 8
    for i in range(len(cells)):
        kind, state, phase = cells.kind[i], State(cells.state[i]), Phase(cells.phase[i])
        taken = {"PROLIFERATING": 1.0, "QUIESCENT": 0.3}.get(state.name, 0.0)
        given = {"PROLIFERATING": 1.0, "QUIESCENT": 4.0, "NECROTIC": 6.0}.get(state.name, 0.0)
        taken *= (6.0, 0.5)[kind] * {"S": 1.5}.get(phase.name, 1.0)
        given *= (5.0, 3.5)[kind] * {"M": 0.0, "G1": 2.0}.get(phase.name, 1.0)
        assert uptake[i] == pytest.approx(10.0 * taken, rel=1e-14)
        assert secretion[i] == pytest.approx(3.0 * given, rel=1e-14)


def test_a_run_accounts_for_what_its_cells_give():
    nutrient = {"uptake": 0.0, "secretion_by_phase": {"S": 4.0}, "regime": "transient"}
    simulation = mc.Simulation(scene(nutrient, {"x": {"secretion_scale": 0.5}}))
    given = 0.0
    while not simulation.finished:
        simulation.step()
        cells = simulation.cells
        # a field sees the cells before they decide anew: without thresholds none changes
        given += 600.0 * 3.0 * 0.5 * np.where(cells.phase == Phase.S, 4.0, 1.0).sum()
    ledger = simulation.ledger["a"]
    assert ledger.secreted == pytest.approx(given, rel=1e-12)
    assert ledger.relative_remainder <= 1e-8


REFUSED = {
    "no field": ({}, {"x": {"uptake_of": {"b": 1.0}}}, "types.x.uptake_of.b", "not a field"),
    "no phase": ({"uptake_by_phase": {"G9": 1.0}}, {}, "nutrients.a.uptake_by_phase.G9", "phase"),
    "no state": ({"secretion_by_state": {"asleep": 1.0}}, {},
                 "nutrients.a.secretion_by_state.asleep", "not a state"),
    "nothing to scale": ({"secretion": 0.0, "secretion_by_state": {"necrotic": 1.0}}, {},
                         "nutrients.a.secretion_by_state", "secretion is zero"),
    "less than none": ({"uptake_by_phase": {"S": -1.0}}, {}, "nutrients.a.uptake_by_phase.S",
                       "at least 0"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_refused_in_words(case):
    nutrient, types, path, words = REFUSED[case]
    with pytest.raises(SceneError) as caught:
        scene(nutrient, types)
    assert caught.value.path == path
    assert words in str(caught.value)


def test_factors_by_phase_need_phases():
    with pytest.raises(SceneError, match="no phases") as caught:
        scene({"uptake_by_phase": {"S": 2.0}}, growth={"cycle_time": "15 h"})
    assert caught.value.path == "nutrients.a.uptake_by_phase"
