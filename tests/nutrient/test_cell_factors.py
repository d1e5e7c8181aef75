"""Uptake and secretion by type and state, each by factors of its own."""

import numpy as np
import pytest
from running import refused

import multicell as mc
from multicell.cells import State
from multicell.nutrient.fields import FieldSystem
from multicell.scene.scene import Scene


def scene(nutrient, types=None, **changes):
    entries = {
        "duration": "30 min", "coupling_step": "10 min", "contact": {"law": "hertz"},
        "initial": {"count": 60, "stage": "asynchronous"}, "growth": {"cycle_time": "15 h"},
        "types": types or {}, "nutrients": {"a": {"uptake": 10.0, "secretion": 3.0, **nutrient}},
    }  # fmt: skip
    return Scene.from_dict(entries | changes)


def demand(described):
    """Return cells in all states, and what the fields take as their demand."""
    cells = mc.Simulation(described).cells.copy()
    cells.state = np.resize(np.array(State, dtype=cells.state.dtype), len(cells))
    return cells, *FieldSystem(described).demand("a", cells)


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
    cells, uptake, secretion = demand(scene({"quiescent_uptake": 0.3}, types))
    assert len(set(zip(cells.kind.tolist(), cells.state.tolist(), strict=True))) == 8
    active = np.array([1.0, 0.3, 0.0, 0.0])[cells.state]
    np.testing.assert_allclose(uptake, 10.0 * active * np.array([6.0, 0.5])[cells.kind], rtol=1e-14)
    given = 3.0 * active * np.array([5.0, 3.5])[cells.kind]
    np.testing.assert_allclose(secretion, given, rtol=1e-14)


def test_a_run_accounts_for_what_its_cells_give():
    nutrient = {"uptake": 0.0, "regime": "transient"}
    simulation = mc.Simulation(scene(nutrient, {"x": {"secretion_scale": 0.5}}))
    lived = 0.0
    while not simulation.finished:
        known, free = len(simulation.cells), simulation.next_id
        simulation.step()
        # two daughters give where their mother gave until they were born, an age ago
        born = simulation.cells.id >= free
        lived += 600.0 * known + 0.5 * simulation.cells.age[born].sum()
    given = 3.0 * 0.5 * lived
    ledger = simulation.ledger["a"]
    assert ledger.secreted == pytest.approx(given, rel=1e-12)
    assert ledger.relative_remainder <= 1e-8


@pytest.mark.parametrize(
    ("name", "factor", "words"), [("b", 1.0, "not a field"), ("a", -1.0, "at least 0")]
)
def test_refused_in_words(name, factor, words):
    with refused(f"types.x.uptake_of.{name}", words):
        scene({}, {"x": {"uptake_of": {name: factor}}})
