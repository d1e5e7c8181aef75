"""A coupling step that fails, wherever it does, leaves the state of its beginning."""

from copy import deepcopy
from dataclasses import asdict
from functools import cache

import numpy as np
import pytest

import multicell as mc
import multicell.biology.step as biology
import multicell.simulation.coupling_step as coupling_step
from multicell.errors import NutrientFailed, StepFailed
from multicell.mechanics.system import Mechanics
from multicell.nutrient.field import NutrientField
from multicell.nutrient.group import FieldGroup

SCENE = mc.Scene.from_dict(
    {
        "duration": "1 d",
        "coupling_step": "30 min",
        "initial": {"count": 40, "stage": "uniform"},
        "growth": {"cycle_time": "8 h"},
        "death": {"lysis_time": "1 h", "apoptosis_rate": "1e-5 1/s"},
        "types": {
            "a": {"surface_energy": {"a": 0.02, "b": 0.01}},
            "b": {"surface_energy": {"a": 0.01, "b": 0.02}},
        },
        "nutrients": {
            "oxygen": {
                "boundary": 0.05,
                "quiescence": 0.02,
                "necrosis": 0.001,
                "growth_half_saturation": 0.02,
            },
            "glucose": {
                "boundary": 1.0,
                "regime": "transient",
                "finite_medium": {"volume": 1e8},
                "uptake_on": {"oxygen": {"effect": 1, "half": 0.01}},
            },
        },
    }
)


def state(simulation):
    """Return all that a simulation is, as plain values that can be compared."""
    frame = simulation.frame()
    found = {name: column.tolist() for name, column in frame.cells.columns()}
    found |= {f"c_{name}": values.tolist() for name, values in frame.concentrations.items()}
    for name, field in frame.fields.items():
        found[f"field_{name}"] = (field.origin.tolist(), field.spacing, field.values.tolist())
    found["lineage"] = {log: dict(columns) for log, columns in simulation.lineage.logs.items()}
    found["lineage"] = {
        log: {name: list(column) for name, column in columns.items()}
        for log, columns in found["lineage"].items()
    }
    return found | {
        "contacts": frame.contacts.tolist(),
        "progress": asdict(frame.progress),
        "time": simulation.time,
    }


@cache
def recorded(steps):
    simulation = mc.Simulation(SCENE, threads=1)
    for _ in range(steps):
        simulation.step()
    return simulation.frame(), simulation.lineage, state(simulation)


def after(steps):
    frame, lineage, _ = recorded(steps)
    return mc.Simulation(SCENE, threads=1, frame=frame, lineage=deepcopy(lineage))


def fails(error, after_calls=0):
    """Return a function that raises at a later call, after it has done its work."""

    def wrap(function):
        calls = []

        def failing(*args, **options):
            result = function(*args, **options)
            calls.append(result)
            if len(calls) > after_calls:
                raise error
            return result

        return failing

    return wrap


WHERE = {
    "growth": (biology, "volumes_after"),
    "motion": (Mechanics, "pressure"),
    "division": (biology, "births"),
    "removal": (biology, "lysed"),
    "first field": (FieldGroup, "solve"),
    "second field": (FieldGroup, "advance"),
    "sampling": (NutrientField, "read"),
    "states": (biology, "update_states"),
    "estimate": (coupling_step, "lag_after"),
}
ERRORS = [NutrientFailed("it cannot be solved", "Try again"), MemoryError(), KeyboardInterrupt()]


@pytest.mark.parametrize("where", WHERE)
@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
def test_the_beginning_is_left(where, error, monkeypatch):
    simulation = after(4)
    before = state(simulation)
    assert before == recorded(4)[2]
    owner, name = WHERE[where]
    with monkeypatch.context() as patch:
        patch.setattr(owner, name, fails(error)(getattr(owner, name)))
        expected = StepFailed if isinstance(error, NutrientFailed) else type(error)
        with pytest.raises(expected):
            simulation.step()
    assert state(simulation) == before
    simulation.step()
    assert state(simulation) == recorded(5)[2]


def test_the_scene_divides_and_dies_in_the_step_that_fails():
    """Else the tests above would hold for a step in which nothing happens."""
    before, then = after(4), after(5)
    assert then.divisions > before.divisions
    assert then.lineage.counts()["deaths"] > 0
    assert sorted(then.cells.id.tolist()) != sorted(before.cells.id.tolist())
    assert then.ledger["glucose"].held < before.ledger["glucose"].held
    assert min(before.cells.lag) < 0.0


@pytest.mark.slow
def test_a_field_that_fails_ends_a_run_with_all_that_came_before(tmp_path, monkeypatch):
    whole = mc.run(SCENE.with_changes({"duration": "4 h"}), report=False)
    advance = fails(NutrientFailed("it cannot be solved", "Try again"), 4)(FieldGroup.advance)
    with monkeypatch.context() as patch:
        patch.setattr(FieldGroup, "advance", advance)
        with pytest.raises(StepFailed, match="it cannot be solved"):
            mc.run(SCENE.with_changes({"duration": "4 h"}), output=tmp_path / "out", report=False)
    left = mc.load_result(tmp_path / "out")
    assert left.summary()["interrupted"] is True
    assert left.frames[-1].time == 4 * 1800.0
    resumed = mc.resume(tmp_path / "out", report=False)
    np.testing.assert_array_equal(
        resumed.frames[-1].cells.position, whole.frames[-1].cells.position
    )


def test_a_field_that_cannot_begin_is_a_step_that_failed(monkeypatch):
    solve = fails(NutrientFailed("it cannot be solved", "Try again"))(FieldGroup.solve)
    monkeypatch.setattr(FieldGroup, "solve", solve)
    with pytest.raises(StepFailed, match="t = 0 s"):
        mc.Simulation(SCENE)
