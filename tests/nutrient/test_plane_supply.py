"""Cells in a plane: the medium over them, and how far a field reaches into tissue."""

import numpy as np
import pytest
from scipy.optimize import brentq

import multicell as mc
from multicell.cells import SPHERE, State
from multicell.population.extents import Extent
from multicell.report.explain.course import SHELLS, Profile
from multicell.report.explain.scene import explain
from multicell.scene.scales import layer_height
from multicell.scene.sizes import typical_radius

AIR = {"boundary": "0.2 mM", "uptake": "20 amol/s", "necrosis": "0.008 mM"}
PLANE = mc.load_scene("settle").with_changes({
    "dimensions": 2, "initial.count": 1500, "duration": "10 min", "coupling_step": "10 min",
})  # fmt: skip


def plane(**keys):
    return PLANE.with_changes({"nutrients": {"oxygen": {**AIR, **keys}}})


def levels(scene, radius, **others):
    """Return the concentrations in the shells of the forecast, in tissue of a radius, µm."""
    d, oxygen = scene.dimensions, scene.nutrients["oxygen"]
    profile = Profile(oxygen, d, oxygen.height or 1.0)
    each = radius / scene.initial.count ** (1.0 / d)
    found = {name: np.full(SHELLS, level) for name, level in others.items()}
    shells = np.linspace(0.0, radius, SHELLS + 1)
    return shells, profile.solve(shells, 0.0, 0.0, SPHERE * each**3, found)


def part_below(scene, radius, threshold):
    """Return the part of the tissue below a threshold, between shells by interpolation."""
    shells, found = levels(scene, radius)
    fine = radius * (np.arange(4000) + 0.5) / 4000
    low = np.interp(fine, 0.5 * (shells[1:] + shells[:-1]), found) < threshold
    volumes = fine ** (scene.dimensions - 1)
    return volumes[low].sum() / volumes.sum()


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


@pytest.mark.slow
def test_a_monolayer_under_two_millimetres_of_air_saturated_medium_lives():
    scene = plane(height="2 mm")
    simulation = mc.Simulation(scene)
    simulation.step()
    assert (simulation.cells.state != State.NECROTIC).all()
    assert simulation.concentrations["oxygen"].min() > 0.19


@pytest.mark.parametrize("perfusion", [0.05, 0.1, 0.2])
def test_supply_from_above_is_that_of_a_layer_of_still_medium(perfusion):
    """The flux D (c0 - c) / depth feeds what is below; far from the rim nothing else does."""
    scene = plane(perfusion=perfusion, necrosis=None).with_changes({"initial.count": 6000})
    oxygen, simulation = scene.nutrients["oxygen"], mc.Simulation(scene)
    high = layer_height(scene, "oxygen")
    radius = 0.5 * Extent(simulation.cells, 2).diameter()
    each = oxygen.largest_uptake(SPHERE * typical_radius(scene) ** 3)
    q = 6000 * each / (np.pi * radius**2 * high)
    c0, half = oxygen.boundary, oxygen.half_saturation
    stated = brentq(lambda c: perfusion * (c0 - c) - q * c / (half + c), 0.0, c0)
    found = simulation.concentrations["oxygen"].min()
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
    oxygen, radius = scene.nutrients["oxygen"], 50.0
    d, outside = oxygen.diffusion, oxygen.diffusion_medium or oxygen.diffusion
    q = count * oxygen.uptake / (4.0 / 3.0 * np.pi * radius**3)

    def level(r, core):
        return q * (r**2 + 2.0 * core**3 / r - 3.0 * core**2) / (6.0 * d)

    def lacking(core):
        lost = q * (radius**3 - core**3) / 3.0 * (1.0 / radius - 1.0 / (radius + layer)) / outside
        return boundary - lost - level(radius, core)

    core = brentq(lacking, 0.0, radius)
    reached = brentq(lambda r: level(r, core) - oxygen.necrosis, core, radius)
    stated = part_below(scene, radius, oxygen.necrosis)
    assert stated == pytest.approx((reached / radius) ** 3, abs=0.02)


def test_explain_notes_tissue_that_would_starve_at_once():
    starved = explain(plane(height="10 um").with_changes({"initial.count": 6000}))
    assert "would die at once" in " ".join(starved["notes"])
    assert "would die at once" not in " ".join(explain(plane(height="2 mm"))["notes"])


@pytest.mark.parametrize("perfusion", [0.0, 0.05])
@pytest.mark.parametrize("dimensions", [2, 3])
def test_uptake_in_the_forecast_depends_on_another_field(dimensions, perfusion):
    """With an effect of 1 uptake is as without the other field where that is plenty, else twice."""
    own = {**AIR, "perfusion": perfusion, "height": "0.1 mm"}
    alone = plane(**own).with_changes({"dimensions": dimensions})
    paired = alone.with_changes({
        "nutrients": {
            "glucose": {"boundary": "5 mM", "uptake": 0.0},
            "oxygen": {**own, "uptake_on": {"glucose": {"effect": 1.0, "half": "1e-6 mM"}}},
        },
    })  # fmt: skip
    _, plenty = levels(paired, 150.0, glucose=5.0)
    np.testing.assert_allclose(plenty, levels(alone, 150.0)[1], atol=1e-6)
    _, short = levels(paired, 150.0, glucose=0.0)
    doubled = alone.with_changes({"nutrients.oxygen.uptake": "40 amol/s"})
    np.testing.assert_allclose(short, levels(doubled, 150.0)[1], atol=1e-6)
