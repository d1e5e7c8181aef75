"""The methods that ``auto`` may choose, with every part that a scene can have."""

from dataclasses import replace

import numpy as np
import pytest

from multicell.integrators.auto import CANDIDATES, MILD, Auto, candidates
from multicell.scene.scene import Scene
from multicell.simulation import Simulation

PARTS = {
    "nothing": {},
    "friction": {"friction": {"normal": 0.1, "tangential": 0.1}},
    "prescribed motion": {"motions": {"m": {"cells": [0, 1], "velocity": [0.001, 0, 0]}}},
    "friction and prescribed motion": {
        "friction": {"normal": 0.1}, "motions": {"m": {"cells": [0], "velocity": [0.001, 0, 0]}},
    },
    "exact JKR in a plane": {
        "contact": {"law": "exact-jkr", "surface_energy": 0.1},
        "dimensions": 2,
    },
    # what makes kernels of its own stands together, so that each candidate is compiled once
    "walls, motility, a force, molecules and types that stick unlike": {
        "domain": {"x": [-20, 20], "y": [-20, 20], "z": [-20, 20], "young": "1 kPa"},
        "motility": {"force": "0.5 nN"},
        "pull": {"force": 0.01},
        "adhesion": {"strength": 0.002},
        "types": {
            "a": {"fraction": 0.5, "surface_energy": {"a": 0.2, "b": 0.1}, "receptor": 1.0},
            "b": {"fraction": 0.5, "surface_energy": {"a": 0.1, "b": 0.1}, "ligand": 1.0},
        },
    },
}  # fmt: skip
QUICK = ("nothing", "friction")


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


@pytest.mark.parametrize(
    "part",
    [pytest.param(part, marks=() if part in QUICK else pytest.mark.slow) for part in PARTS],
)
def test_every_candidate_can_do_a_part_or_refuses_it(part):
    simulation = Simulation(scene_of(**PARTS[part]), threads=1)
    system, position = simulation.prepared(), simulation.cells.position
    able = candidates(system)
    for atol in (0.1, 0.001):
        assert sorted(Auto(atol=atol).choose(system, position).order) == sorted(able)
    auto = Auto(atol=0.1)
    for method in (auto, *(auto.method(name) for name in able)):
        system.begin(system.motion)
        outcome = method.integrate(system, position)
        assert outcome.problem == ""
        assert np.isfinite(outcome.position).all()
    assert ("rosenbrock" in able) == ("friction" not in part)


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
