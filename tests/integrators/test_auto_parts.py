"""The methods that ``auto`` may choose, with every part that a scene can have."""

from dataclasses import replace

import numpy as np
import pytest

import multicell as mc
from multicell.integrators.auto import CANDIDATES, MILD, Auto, candidates
from multicell.scene.scene import Scene
from multicell.simulation import Simulation

PARTS = {
    "nothing": {},
    "friction": {"friction": {"normal": 0.1, "tangential": 0.1}},
    "walls": {"domain": {"x": [-20, 20], "y": [-20, 20], "z": [-20, 20], "young": "1 kPa"}},
    "prescribed motion": {"motions": {"m": {"cells": [0, 1], "velocity": [0.001, 0, 0]}}},
    "friction and prescribed motion": {
        "friction": {"normal": 0.1}, "motions": {"m": {"cells": [0], "velocity": [0.001, 0, 0]}},
    },
    "motility": {"motility": {"force": "0.5 nN"}},
    "exact JKR": {"contact": {"law": "exact-jkr", "surface_energy": 0.1}},
    "adhesion molecules and a force": {
        "forces": {"f": {"cells": [2], "force": [0.1, 0, 0]}},
        "adhesion": {"strength": 0.002},
        "types": {"a": {"receptor": 1.0, "ligand": 1.0}},
    },
    "plane": {"dimensions": 2},
    "types that stick unlike": {
        "types": {
            "a": {"fraction": 0.5, "surface_energy": {"a": 0.2, "b": 0.1}},
            "b": {"fraction": 0.5, "surface_energy": {"a": 0.1, "b": 0.1}},
        },
    },
}  # fmt: skip


def scene_of(viscosity=0.5, **parts):
    """Return the scene in which the choice at a glance once took a method that cannot do it."""
    return Scene.from_dict({
        "duration": "1 h",
        "coupling_step": "10 min",
        "initial": {"count": 30, "stage": "uniform"},
        "contact": {"law": "jkr", "surface_energy": 0.1},
        "drag": {"viscosity": viscosity},
        "growth": {"cycle_time": "15 h"},
        **parts,
    })  # fmt: skip


def begun(part):
    simulation = Simulation(scene_of(**PARTS[part]), threads=1)
    return simulation.prepared(), simulation.cells.position


@pytest.mark.parametrize("part", sorted(PARTS))
@pytest.mark.parametrize("name", sorted(CANDIDATES))
def test_a_candidate_that_does_not_refuse_a_part_can_do_it(name, part):
    system, position = begun(part)
    assert (name in candidates(system)) == (
        CANDIDATES[name].info.refusal(len(system), friction=max(system.friction) > 0.0) is None
    )
    if name in candidates(system):
        outcome = Auto(atol=0.1).method(name).integrate(system, position)
        assert outcome.problem == ""
        assert np.isfinite(outcome.position).all()


@pytest.mark.parametrize("part", sorted(PARTS))
@pytest.mark.parametrize("atol", [0.1, 0.001])
def test_a_choice_knows_candidates_and_all_of_them(part, atol):
    system, position = begun(part)
    choice = Auto(atol=atol).choose(system, position)
    assert sorted(choice.order) == sorted(candidates(system))


@pytest.mark.parametrize("left_out", sorted(CANDIDATES))
@pytest.mark.parametrize(("viscosity", "count"), [(5.0, 30), (0.5, 300), (0.001, 30)])
def test_no_branch_of_auto_takes_a_method_that_refuses_the_scene(
    left_out, viscosity, count, monkeypatch
):
    """Whatever the reason, here the number of cells; mild, stiff and very stiff."""
    kind = CANDIDATES[left_out]
    monkeypatch.setattr(kind, "info", replace(kind.info, most_cells=1))
    simulation = Simulation(scene_of(viscosity, initial={"count": count}), threads=1)
    system = simulation.prepared()
    choice = Auto(atol=0.1).choose(system, simulation.cells.position)
    assert left_out not in choice.order
    outcome = Auto(atol=0.1).integrate(system, simulation.cells.position)
    assert outcome.done
    if left_out == MILD:
        assert system.work.steps_ab2_adaptive == 0


def test_growing_cells_with_friction_are_no_scene_that_the_default_refuses():
    scene = scene_of(friction={"normal": 0.1, "tangential": 0.1})
    assert scene.integrator.method == "auto"
    work = mc.run(scene).summary()["integrator"]
    assert work["steps_rosenbrock"] == 0
    assert work["steps"] > 0
