"""Place of a scene in the diagram of methods by explain, compared with measured decay rates."""

import numpy as np
import pytest

import multicell as mc
from multicell.mechanics.decay_rate import largest_decay_rate
from multicell.report.explain.scene import explain
from multicell.report.explain.stiffness import place_of, stiffness_numbers, stiffness_of
from multicell.simulation import Simulation


def measured(scene):
    """Return λΔt after each step of a run, and whether a cell divided in it."""
    simulation = Simulation(scene, threads=1)
    found, divided = [], []
    while not simulation.finished:
        before = len(simulation.cells)
        simulation.step()
        rate = largest_decay_rate(simulation.prepared(), simulation.time, simulation.cells.position)
        found.append(rate * scene.coupling_step)
        divided.append(len(simulation.cells) > before)
    return np.array(found), np.array(divided)


@pytest.mark.parametrize("viscosity", ["5 kPa s", "0.5 kPa s"])
def test_growing_tissue_is_as_stiff_as_foretold(viscosity):
    scene = mc.load_scene("growth").with_changes(
        {"drag.viscosity": viscosity, "initial.count": 60, "initial.stage": "uniform",
         "duration": "4 h"}
    )  # fmt: skip
    found, divided = measured(scene)
    rest, after = stiffness_of(scene)
    assert divided.sum() > 3
    assert np.median(found[divided]) == pytest.approx(after, rel=0.35)
    assert np.median(found) == pytest.approx(rest, rel=0.35)


def test_settled_tissue_is_as_stiff_as_foretold():
    scene = mc.load_scene("settle").with_changes({"duration": "30 min"})
    found, _ = measured(scene)
    assert found[-1] == pytest.approx(stiffness_of(scene)[0], rel=0.35)


def test_stiffness_goes_as_the_coupling_step_over_the_viscosity():
    scene = mc.load_scene("spheroid")
    rest, after = stiffness_of(scene)
    changed = scene.with_changes({"drag.viscosity": "0.5 kPa s", "coupling_step": "5 min"})
    assert stiffness_of(changed) == pytest.approx((5.0 * rest, 5.0 * after))


def test_numbers_say_what_there_is():
    one, two = stiffness_numbers(mc.load_scene("spheroid"))
    assert (one.value, two.name) == (0.0, "stiffness after a division")
    assert two.value == pytest.approx(19.7, rel=0.05)
    [still] = stiffness_numbers(mc.load_scene("settle"))
    assert still.value == pytest.approx(1.74, rel=0.05)


@pytest.mark.parametrize(
    ("name", "viscosity", "tile", "advice"),
    [
        ("spheroid", "5 kPa s", "typical tissue, 10,000 cells, λΔt of 10.", "ab2-adaptive"),
        ("spheroid", "0.5 kPa s", "typical tissue, 10,000 cells, λΔt of 100.", "ab2-adaptive"),
        ("spheroid", "5e-3 kPa s", "λΔt of 10,000.", "rkc2 is cheapest"),
        ("spheroid", "5e-4 kPa s", "λΔt of 100,000.", "are even"),
        ("spheroid", "5e-5 kPa s", "λΔt of 1,000,000.", "Implicit"),
        ("settle", "1e-3 kPa s", "quiet tissue, 100 cells, λΔt of 10,000.", "Implicit"),
    ],
)
def test_the_tile_and_what_follows_are_named(name, viscosity, tile, advice):
    scene = mc.load_scene(name).with_changes({"drag.viscosity": viscosity})
    note = place_of(scene, 8000.0 if name == "spheroid" else 200.0)
    assert tile in note
    assert advice in note


def test_every_built_in_scene_can_be_placed():
    for name in mc.scene_names():
        facts = explain(mc.load_scene(name))
        values = {n["name"]: n["value"] for n in facts["numbers"]}
        assert values["stiffness at the start"] >= 0.0
        assert all(np.isfinite(value) for key, value in values.items() if "stiffness" in key)
