"""The pressure of cells, of tissue and on walls: defined apart, and equal where they must be."""

import functools

import numpy as np
import pytest

import multicell as mc
from multicell.simulation import Simulation

pytestmark = pytest.mark.kernels

LAWS = {"hertz": {"law": "hertz"}, "jkr": {"law": "jkr", "surface_energy": 0.02}}


@functools.cache
def at_rest(count, sides, law="hertz"):
    """Return cells that have come to rest in a box, sides in µm."""
    entries = {
        "duration": "2 d", "coupling_step": "1 h", "seed": 2,
        "contact": LAWS[law], "drag": {"viscosity": 0.05},
        "domain": {axis: [0.0, side] for axis, side in zip("xyz", sides, strict=True)},
        "integrator": {"atol": 1e-4},
    }  # fmt: skip
    places = np.random.default_rng(2).uniform(0.0, sides, (count, 3))
    cells = dict(zip(("x_um", "y_um", "z_um"), places.T, strict=True))
    simulation = Simulation(mc.Scene.from_dict(entries), cells=cells, threads=1)
    for _ in range(8):
        simulation.step()
    return simulation


def force_on_walls(cells, sides, young=1.0, poisson=0.5):
    """Return Hertz's force over area on each of six flat half spaces, kPa, written down anew."""
    found = []
    for axis, side in enumerate(sides):
        area = np.prod(sides) / side
        for distance in (cells.position[:, axis], side - cells.position[:, axis]):
            plane = (1 - cells.poisson**2) / cells.young + (1 - poisson**2) / young
            h = np.maximum(cells.radius - distance, 0.0)
            found.append((4 / 3 / plane * np.sqrt(cells.radius) * h**1.5).sum() / area)
    return np.array(found)


@pytest.mark.parametrize(
    ("count", "sides", "law"),
    [
        (150, (40.0, 40.0, 40.0), "hertz"),
        (200, (30.0, 40.0, 60.0), "jkr"),
        (330, (40.0, 40.0, 40.0), "hertz"),
    ],
)
def test_the_virial_stress_at_rest_is_the_force_on_the_walls_over_their_area(count, sides, law):
    simulation = at_rest(count, sides, law)
    row, cells = simulation.history_row(), simulation.cells
    expected = force_on_walls(cells, sides)
    assert row["wall_pressure"] == pytest.approx(expected.mean(), rel=1e-12)
    # opposite walls carry the same force, and the mean of all is the virial stress
    np.testing.assert_allclose(expected[0::2], expected[1::2], rtol=1e-3)
    assert row["tissue_pressure"] == pytest.approx(expected.mean(), rel=1e-3)
    # what cells feel themselves is per volume of theirs
    own = np.average(cells.pressure, weights=cells.volume)
    assert own * row["volume_fraction"] == pytest.approx(expected.mean(), rel=1e-3)


def test_too_much_volume_in_a_box_is_noted_at_one():
    """In the closest packing touching spheres fill 0.74; 1.35 boxes do not fit into one."""
    simulation = at_rest(330, (40.0, 40.0, 40.0), "hertz")
    summary = simulation.summary()
    assert summary["volume_fraction"] == pytest.approx(simulation.cells.volume.sum() / 64e3)
    assert summary["units"]["wall_pressure"] == "kPa"
    (note,) = summary["notes"]
    assert "1.35 times the box" in note
    assert "notes" not in at_rest(150, (40.0, 40.0, 40.0), "hertz").summary()


def test_pressures_on_walls_are_observables_of_boxes_only():
    from multicell.measured.observables import in_history

    names = {"volume_fraction", "wall_pressure", "tissue_pressure"}
    assert names <= in_history(mc.load_scene("chemotaxis")).keys()
    assert not names & in_history(mc.load_scene("spheroid")).keys()
