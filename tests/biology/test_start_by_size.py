"""Cells of a start table have their place in the cycle by their size, under every law of growth."""

import numpy as np
import pytest

from multicell.behaviours.growth_laws.registry import LAWS
from multicell.cells import SPHERE
from multicell.scene.scene import Scene
from multicell.scene.sizes import birth_volume
from multicell.simulation import Simulation

SATURATING = ("relaxation", "logistic", "gompertz")
PHASES = {n: {"duration": f"{d} h"} for n, d in {"G1": 5, "S": 4, "G2": 2, "M": 1}.items()}


def law_of(law):
    return {"law": law, **({"target": 1.2} if law in SATURATING else {})}


def scene_of(law, **growth):
    times = {} if growth else {"cycle_time": "12 h", "cycle_variation": 0.0}
    return Scene.from_dict({
        "duration": "1 d",
        "coupling_step": "10 min",
        "contact": {"law": "hertz"},
        "growth": {**times, **law_of(law), **growth},
    })  # fmt: skip


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("phases", [{}, {"phases": PHASES}])
def test_cells_that_are_described_by_their_radii_go_on_like_those_described_by_their_ages(
    law, phases
):
    scene = scene_of(law, **phases)
    share = np.array([0.0, 0.2, 0.5, 0.8])
    place = np.array([[0.0, 0, 0], [40, 0, 0], [80, 0, 0], [120, 0, 0]])
    columns = {f"position_{a}_um": place[:, k] for k, a in enumerate("xyz")}
    by_age = Simulation(scene, cells={**columns, "age_h": 12.0 * share}).cells
    by_radius = Simulation(scene, cells={**columns, "radius_um": by_age.radius}).cells
    if not phases:
        birth = birth_volume(scene)
        exact = scene.growth.growth_law.volume_after(np.full(4, birth), share, birth)
        assert SPHERE * by_age.radius**3 == pytest.approx(exact, rel=1e-12)
    assert by_radius.age == pytest.approx(by_age.age, rel=1e-9, abs=1e-6)
    assert by_radius.radius == pytest.approx(by_age.radius, rel=1e-12)
    assert by_radius.phase.tolist() == by_age.phase.tolist()
