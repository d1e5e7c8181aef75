"""The unstirred layer round a ball of tissue, against closed forms."""

import numpy as np
import pytest
from running import refused

import multicell as mc
from multicell.nutrient.field import NutrientField
from multicell.nutrient.grid import ShellLayout, equivalent_ball_radius
from multicell.nutrient.parameters import FieldParameters
from multicell.population.extents import uniform_radius
from multicell.scene.nutrient import Nutrient

R, D = 150.0, 2000.0


def ball(n=40_000):
    """Return places that fill a ball evenly, each with its mirror image, and small radii."""
    k = np.arange(n // 2) + 0.5
    distance = R * np.cbrt(k / (n // 2))
    z, angle = 1.0 - 2.0 * np.mod(k * 0.7548776662, 1.0), 2 * np.pi * np.mod(k * 0.5698402910, 1.0)
    flat = np.sqrt(1.0 - z**2)
    half = distance[:, None] * np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=1)
    return np.vstack([half, -half]), np.full(n, 0.05)


def field(spacing=2.5, **changes):
    nutrient = Nutrient(diffusion=D, geometry="radial", **changes)
    return NutrientField("a", FieldParameters(nutrient, spacing, 10.0, "steady", dimensions=3))


def ring(distance):
    return np.array([[distance, 0.0, 0.0], [0.0, -distance, 0.0], [0.0, 0.0, distance]])


@pytest.mark.parametrize("layer", [3.0, 40.0, 250.0])
def test_zeroth_order_uptake_behind_a_layer(layer):
    """c_s = c_0 - Q/(4πD) (1/R - 1/(R + δ)), and within c = c_s - q (R² - r²)/(6D)."""
    position, radius = ball()
    q = 4e-3  # mM/s in all of the ball
    each = q * 4 / 3 * np.pi * R**3 / len(position)
    oxygen = field(layer=layer, boundary=10.0, half_saturation=1e-9)
    report = oxygen.solve(position, np.full(len(position), each), radius=radius)
    total = each * len(position)
    assert report.uptake == pytest.approx(total, rel=1e-6)
    outside = total / (4 * np.pi * D)
    surface = 10.0 - outside * (1 / R - 1 / (R + layer))
    for distance in (R + 0.5 * layer, R + layer):
        exact = 10.0 - outside * (1 / distance - 1 / (R + layer))
        np.testing.assert_allclose(oxygen.sample(ring(distance)), exact, rtol=2e-5)
    np.testing.assert_allclose(oxygen.sample(ring(R)), surface, atol=2e-4 * (10.0 - surface))
    for distance in (0.0, 60.0, 120.0):
        exact = surface - q * (R**2 - distance**2) / (6 * D)
        np.testing.assert_allclose(oxygen.sample(ring(distance)), exact, rtol=3e-4)


@pytest.mark.parametrize("layer", [0.5, 20.0, 333.3])
def test_the_surface_lies_exactly_the_layer_beyond_the_tissue(layer):
    position, radius = ball(2000)
    moved = position + np.array([10.0, -70.0, 3.0])
    shells = ShellLayout.round(moved, radius, 50.0, 7.0, layer)
    # the radius of a ball whose volume-weighted radius of gyration is that of the cells
    middle = moved.mean(axis=0)
    square = (np.square(moved - middle).sum(axis=1) + 0.6 * 0.05**2).mean()
    assert shells.radius == pytest.approx(np.sqrt(square / 0.6) + layer, rel=1e-12)
    assert shells.spacing <= 7.0
    assert np.sqrt(square / 0.6) == pytest.approx(R, rel=1e-3)
    alone = ShellLayout.round(np.ones((1, 3)), np.array([5.0]), 50.0, 7.0, layer)
    assert alone.radius == pytest.approx(5.0 + layer, rel=1e-12)
    assert ShellLayout.round(np.empty((0, 3)), np.empty(0), 50.0, 7.0, layer).radius == layer


def test_the_tissue_is_that_of_the_summary():
    simulation = mc.Simulation(mc.load_scene("spheroid").with_changes({"initial.count": 70}))
    cells = simulation.cells
    centre = np.average(cells.position, axis=0, weights=cells.radius**3)
    assert equivalent_ball_radius(cells.position, cells.radius) == pytest.approx(
        uniform_radius(cells, centre, 3), rel=1e-12
    )


def run(**changes):
    scene = mc.load_scene("spheroid").with_changes(
        {
            "initial.count": 60,
            "duration": "2 h",
            "nutrients.oxygen.geometry": "radial",
            "nutrients.oxygen.layer": "30 um",
            **changes,
        }
    )
    return mc.Simulation(scene)


def test_a_run_keeps_the_layer_and_its_summary_tells_it():
    simulation = run()
    while not simulation.finished:
        simulation.step()
        cells = simulation.cells
        shells = simulation.field_system.fields["oxygen"].layout
        thick = shells.radius - equivalent_ball_radius(cells.position, cells.radius)
        assert thick == pytest.approx(30.0, rel=1e-12)
    summary = simulation.summary()
    assert summary["fields"]["oxygen"]["layer"] == pytest.approx(30.0)
    assert "notes" not in summary
    assert summary["units"]["fields.oxygen.layer"] == "um"


def test_tissue_that_reaches_beyond_the_layer_is_still_on_the_shells_and_is_reported():
    simulation = run()
    simulation.cells.position[:] = 0.0
    simulation.cells.position[:, 0] = 9.0 * np.arange(len(simulation.cells))
    simulation.step()
    summary = simulation.summary()
    assert summary["fields"]["oxygen"]["layer"] > 40.0
    assert any("instead of 30 um" in note for note in summary["notes"])
    assert np.isfinite(simulation.concentrations["oxygen"]).all()


@pytest.mark.parametrize("geometry", ["box", "auto"])
def test_only_shells_have_a_layer(geometry):
    changes = {"nutrients.oxygen.layer": "30 um", "nutrients.oxygen.geometry": geometry}
    with refused("nutrients.oxygen.layer", "geometry = 'radial'"):
        mc.load_scene("spheroid").with_changes(changes)
