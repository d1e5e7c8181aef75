"""Uptake in proportion to a cell's volume: against closed forms, and where it meets other keys."""

import numpy as np
import pytest
from running import refused

import multicell as mc
from multicell.cells import SPHERE
from multicell.errors import SceneError
from multicell.nutrient.fields import FieldSystem
from multicell.report.explain.course import course
from multicell.results.observables import diameter
from multicell.scene.scales import scales
from multicell.scene.scene import Scene


def scene(nutrient, **changes):
    entries = {
        "duration": "30 min", "contact": {"law": "hertz"},
        "initial": {"count": 60, "stage": "asynchronous"}, "growth": {},
        "nutrients": {"a": {"geometry": "radial", **nutrient}},
    }  # fmt: skip
    return Scene.from_dict(entries | changes)


def test_a_cell_takes_up_in_proportion_to_its_volume():
    described = scene({"uptake_per_volume": "0.02 amol/s/um^3"})
    cells = mc.Simulation(described).cells
    assert np.ptp(cells.volume) > 0.5 * cells.volume.min()
    capacity, production = FieldSystem(described).demand("a", cells)
    assert production is None
    np.testing.assert_allclose(capacity, 0.02 * SPHERE * cells.radius**3, rtol=1e-14)


@pytest.mark.parametrize("radius", [5.0, 10.0])
def test_a_ball_has_the_field_of_the_closed_form_whatever_its_cells_size(radius):
    """Uptake Q in all, saturated, in a ball of radius R behind a layer that ends at L.

    At its surface c = c0 - Q/(4 π D) (1/R - 1/L), on average within Q/(20 π D R) less.
    """
    diffusion, most = 1000.0, 0.05
    described = scene(
        {
            "uptake_per_volume": most, "half_saturation": "1e-9 mM", "diffusion": diffusion,
            "boundary": "0.2 mM", "layer": "40 um", "spacing": "2 um",
        },
        initial={"count": round(8000 * (5.0 / radius) ** 3)}, growth=None,
        cells={"division_radius": radius},
    )  # fmt: skip
    simulation = mc.Simulation(described)
    cells = simulation.cells
    ball = 0.5 * diameter(cells, 3)
    taken = most * float(cells.volume.sum())
    surface = 0.2 - taken / (4.0 * np.pi * diffusion) * (1.0 / ball - 1.0 / (ball + 40.0))
    field = simulation.frame().fields["a"]
    there = np.interp(ball, field.axis(0) - field.origin[0], field.values.ravel())
    assert there == pytest.approx(surface, abs=2e-3 * (0.2 - surface))
    inside = surface - float(simulation.concentrations["a"].mean())
    assert inside == pytest.approx(taken / (20.0 * np.pi * diffusion * ball), rel=0.06)
    assert simulation.ledger["a"].relative_remainder < 1e-8


def test_demand_and_forecast_are_those_of_the_same_uptake_of_typical_cells():
    by_volume = scene({"uptake_per_volume": 0.02, "necrosis": "0.01 mM"}, duration="4 d")
    assert scales(by_volume, "a").demand == pytest.approx(0.02, rel=1e-12)
    assert np.isfinite(course(by_volume).cells).all()


def test_one_of_the_two_uptakes_only():
    with refused("nutrients.a.uptake_per_volume", "given both"):
        scene({"uptake": 20.0, "uptake_per_volume": 0.02})
    with pytest.raises(SceneError, match="change of concentration"):
        scene({"uptake_per_volume": "20 amol/s"})
    changed = scene({}).with_changes(
        {"nutrients.a.uptake": None, "nutrients.a.uptake_per_volume": "72 mM/h"}
    )
    assert changed.nutrients["a"].uptake_per_volume == pytest.approx(0.02)
    assert changed.nutrients["a"].uptake is None


def test_no_uptake_by_volume_is_no_uptake():
    none = {"uptake_per_volume": 0.0, "uptake_on": {"b": {"effect": 1, "half": 1}}}
    with pytest.raises(SceneError, match="uptake is zero"):
        Scene.from_dict({"duration": "1 h", "nutrients": {"b": {}, "a": none}})
