"""Cells in a plane: the medium over them, and how far a field reaches into tissue."""

import numpy as np
import pytest
from scipy.optimize import brentq

import multicell as mc
from multicell.biology.initial import initial_cells
from multicell.cells import State
from multicell.report.explain.cost import grid_sizes
from multicell.report.explain.reach import reach_numbers, start_radius
from multicell.report.explain.scene import explain

AIR = {"boundary": "0.2 mM", "uptake": "20 amol/s", "necrosis": "0.008 mM"}
PLANE = mc.load_scene("settle").with_changes({
    "dimensions": 2, "initial.count": 1500, "duration": "10 min", "coupling_step": "10 min",
})  # fmt: skip


def plane(**keys):
    return PLANE.with_changes({"nutrients": {"oxygen": {**AIR, **keys}}})


def numbers(scene):
    return {number.name: number.value for number in reach_numbers(scene, "oxygen")}


# --- what a plane needs --------------------------------------------------------------------------


def test_a_plane_with_uptake_asks_for_the_medium_over_it():
    with pytest.raises(mc.SceneError, match=r"nutrients.oxygen.height: is missing") as refusal:
        plane()
    assert "height = '2 mm'" in str(refusal.value)
    assert "perfusion = '0.1 1/s'" in str(refusal.value)


@pytest.mark.parametrize(
    "keys", [{"height": "2 mm"}, {"perfusion": "0.1 1/s"}, {"uptake": 0.0, "necrosis": None}]
)
def test_medium_over_it_supply_from_above_or_no_uptake_will_do(keys):
    assert plane(**keys).nutrients["oxygen"].height == (2000.0 if "height" in keys else None)


def test_a_monolayer_under_two_millimetres_of_air_saturated_medium_lives():
    scene = plane(height="2 mm")
    simulation = mc.Simulation(scene)
    simulation.step()
    assert (simulation.cells.state != State.NECROTIC).all()
    assert simulation.concentrations["oxygen"].min() > 0.19
    assert numbers(scene)["oxygen: below necrosis"] == 0.0


@pytest.mark.parametrize("perfusion", [0.05, 0.1, 0.2])
def test_supply_from_above_is_that_of_a_layer_of_still_medium(perfusion):
    """The flux D (c0 - c) / depth feeds what is below; far from the rim nothing else does."""
    scene = plane(perfusion=perfusion, necrosis=None).with_changes({"initial.count": 6000})
    stated = numbers(scene)["oxygen: supply by perfusion"]
    found = mc.Simulation(scene).concentrations["oxygen"].min()
    assert found == pytest.approx(stated, abs=0.02 * 0.2)


# --- how far a field reaches ---------------------------------------------------------------------


@pytest.mark.parametrize("boundary", [0.03, 0.045])
def test_what_a_field_does_not_reach_is_that_of_the_closed_form(boundary):
    """A ball whose cells take up at one rate q wherever there is anything, behind a layer.

    Round a core of radius a, c(r) = q (r² + 2 a³/r - 3 a²) / (6 D): c and its slope vanish there.
    """
    layer, count = 60.0, 3000
    scene = mc.load_scene("settle").with_changes({
        "initial.count": count,
        "nutrients": {"oxygen": {**AIR, "boundary": boundary, "half_saturation": 1e-6,
                                 "geometry": "radial", "layer": layer}},
    })  # fmt: skip
    oxygen, radius = scene.nutrients["oxygen"], start_radius(scene, "oxygen")
    d, outside = oxygen.diffusion, oxygen.diffusion_medium or oxygen.diffusion
    q = count * oxygen.uptake / (4.0 / 3.0 * np.pi * radius**3)

    def level(r, core):
        return q * (r**2 + 2.0 * core**3 / r - 3.0 * core**2) / (6.0 * d)

    def lacking(core):
        lost = q * (radius**3 - core**3) / 3.0 * (1.0 / radius - 1.0 / (radius + layer)) / outside
        return boundary - lost - level(radius, core)

    core = brentq(lacking, 0.0, radius)
    reached = brentq(lambda r: level(r, core) - oxygen.necrosis, core, radius)
    stated = numbers(scene)["oxygen: below necrosis"]
    assert stated == pytest.approx((reached / radius) ** 3, abs=0.02)


@pytest.mark.parametrize("count", [400, 6000])
def test_what_explain_states_is_what_cells_of_a_ball_find(count):
    """With hardly any saturation the part below a threshold is that of the run's first field."""
    scene = mc.load_scene("settle").with_changes({
        "initial.count": count,
        "nutrients": {"oxygen": {**AIR, "boundary": "0.05 mM", "half_saturation": 1e-6}},
    })  # fmt: skip
    stated = numbers(scene)["oxygen: below necrosis"]
    everybody = initial_cells(scene)  # states that are given: all take up at the full rate
    found = np.mean(mc.Simulation(scene, cells=everybody).concentrations["oxygen"] < 0.008)
    assert stated == pytest.approx(found, abs=0.04)


def test_explain_notes_tissue_that_would_starve_at_once():
    starved = explain(plane(height="10 um").with_changes({"initial.count": 6000}))
    assert "would die at once" in " ".join(starved["notes"])
    assert "would die at once" not in " ".join(explain(plane(height="2 mm"))["notes"])


@pytest.mark.parametrize("perfusion", [0.0, 0.05])
@pytest.mark.parametrize("dimensions", [2, 3])
def test_reach_is_stated_where_uptake_depends_on_another_field(dimensions, perfusion):
    """With plenty of the other field, uptake that needs it is as large as without the need."""
    own = {**AIR, "perfusion": perfusion, "height": "0.1 mm"}
    alone = plane(**own).with_changes({"dimensions": dimensions})
    paired = alone.with_changes({
        "nutrients": {
            "glucose": {"boundary": "5 mM", "uptake": 0.0},
            "oxygen": {**own, "uptake_on": {"glucose": {"effect": 1.0, "half": "1e-6 mM"}}},
        },
    })  # fmt: skip
    single = alone.with_changes({"nutrients.oxygen.uptake": "40 amol/s"})
    stated = numbers(paired)["oxygen: below necrosis"]
    assert stated == pytest.approx(numbers(single)["oxygen: below necrosis"], abs=1e-4)
    assert 0.0 <= stated <= 1.0


# --- the grid that explain announces -------------------------------------------------------------


@pytest.mark.parametrize("keys", [{}, {"geometry": "radial"}])
def test_the_grid_that_is_announced_for_the_start_is_the_runs(keys):
    scene = mc.load_scene("settle").with_changes({
        "initial.count": 3000, "nutrients": {"oxygen": {**AIR, **keys}},
    })  # fmt: skip
    values = mc.Simulation(scene).fields["oxygen"].values
    assert grid_sizes(scene, "oxygen") == (values.size, values.size)


def test_the_grid_at_the_expected_end_is_that_of_the_tissue_then():
    """The spheroid of the package ends on 27,000 nodes, beyond the starving radius."""
    first, last = grid_sizes(mc.load_scene("spheroid"), "oxygen")
    assert first == 1000.0
    assert 27_000 / 1.5 < last < 27_000 * 1.5
