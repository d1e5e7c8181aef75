"""Gels and membranes: boxes with a diffusion coefficient of their own, against closed forms."""

import itertools

import numpy as np
import pytest
from running import finished, refused

import multicell as mc
from multicell.nutrient.cartesian import Box
from multicell.nutrient.field import NutrientField
from multicell.nutrient.parameters import FieldParameters
from multicell.nutrient.regions import covered
from multicell.scene.nutrient import Nutrient, Region
from multicell.scene.parts import Domain
from multicell.scene.scene import Scene

D = 500.0
WALL = {"type": "derivative", "derivative": 0.0}
NOBODY = {"position": np.empty((0, 3)), "capacity": np.empty(0)}


def between(axis, regions, dimensions=3):
    """Return a field between 0 and 1 mM at the sides across an axis, at ±60 µm."""
    sides = {"*": WALL, f"{axis}-": {"value": 0.0}, f"{axis}+": {"value": 1.0}}
    nutrient = Nutrient(diffusion=D, boundary=0.0, uptake=0.0, sides=sides, regions=regions)
    domain = Domain(**{key: [-60.0, 60.0] for key in "xyz"[:dimensions]})
    return NutrientField("a", FieldParameters(nutrient, 10.0, 10.0, "steady", dimensions, domain))


def through_layers(x, layers):
    """Return the exact concentration behind layers (from, to, D) in a slab from -60 to 60."""
    ends = np.linspace(-60.0, 60.0, 240_001)
    middle = 0.5 * (ends[1:] + ends[:-1])
    resistance = np.full(middle.size, 1.0 / D)
    for low, high, diffusion in layers:
        resistance[(low < middle) & (middle < high)] = 1.0 / diffusion
    total = np.append(0.0, np.cumsum(resistance * np.diff(ends)))
    return np.interp(x, ends, total) / total[-1]


LAYERS = {
    "a gel": [(-13.3, 21.7, 40.0)],
    "a membrane in one node": [(12.5, 13.5, 0.5)],
    "a membrane between two nodes": [(-0.4, 0.7, 0.5)],
    "faster": [(-37.0, -2.0, 20_000.0)],
    "two": [(-39.0, -31.0, 60.0), (3.0, 4.0, 1.0)],
    "one in another": [(-30.0, 30.0, 100.0), (-10.0, 5.0, 900.0)],
}


@pytest.mark.parametrize(("axis", "case"), list(zip(itertools.cycle("xyz"), LAYERS)))
def test_a_slab_of_layers(axis, case):
    """Resistances add up wherever the faces lie, and beyond the layers c is exact."""
    regions = {f"layer_{k}": {axis: x[:2], "diffusion": x[2]} for k, x in enumerate(LAYERS[case])}
    field = between(axis, regions)
    report = field.solve(**NOBODY)
    position = np.zeros((4, 3))
    x = np.array([-55.0, -48.0, 50.0, 57.0])
    position[:, "xyz".index(axis)] = x
    exact = through_layers(x, LAYERS[case])
    np.testing.assert_allclose(field.sample(position), exact, rtol=1e-6, atol=1e-9)
    # one way in and one way out: as much leaves as comes
    flow = 120.0**2 * exact[0] / 5.0 * D
    assert report.outflow == pytest.approx(flow, rel=1e-5)
    assert abs(report.inflow) < 1e-8 * flow


def test_a_gel_in_a_plane():
    field = between("y", {"gel": {"y": [-13.3, 21.7], "diffusion": 40.0}}, dimensions=2)
    field.solve(**NOBODY)
    position = np.array([[3.0, -48.0, 0.0], [-20.0, 50.0, 0.0]])
    exact = through_layers(position[:, 1], LAYERS["a gel"])
    np.testing.assert_allclose(field.sample(position), exact, rtol=1e-6)


def test_what_is_covered_is_the_volume_of_the_region():
    box = Box((0.0, 0.0, 0.0), (6, 7, 8), 10.0)
    gel = Region(diffusion=1.0, x=(-5.0, 23.0), y=(11.0, 12.0), z=(34.0, 71.0))
    share = covered(box, gel)
    assert (share >= 0.0).all()
    assert (share <= 1.0).all()
    assert share.sum() * 1000.0 == pytest.approx(23.0 * 1.0 * 37.0, rel=1e-12)
    assert covered(box, Region(diffusion=1.0)).sum() == 6 * 7 * 8
    assert covered(box, Region(diffusion=1.0, x=(70.0, 80.0))).sum() == 0.0


def scene(nutrient, **changes):
    entries = {
        "duration": "1 h", "coupling_step": "10 min", "contact": {"law": "hertz"},
        "initial": {"count": 40, "stage": "uniform"}, "growth": {"cycle_time": "8 h"},
        "nutrients": {"a": {"boundary": 0.07, "spacing": 10.0, **nutrient}},
    }  # fmt: skip
    return Scene.from_dict(entries | changes)


GEL = {"gel": {"x": ["8 um", "100 um"], "diffusion": "50 um^2/s"}}


@pytest.mark.parametrize(
    ("regime", "medium"), [("steady", {}), ("transient", {"diffusion_medium": "3000 um^2/s"})]
)
def test_cells_behind_a_gel_starve_and_nothing_is_lost(regime, medium):
    behind, open_to = (
        mc.Simulation(scene({"regime": regime, "regions": regions, **medium}))
        for regions in (GEL, {})
    )
    for simulation in (behind, open_to):
        finished(simulation)
        assert simulation.ledger["a"].relative_remainder <= 1e-8
    poor = behind.fields["a"].values.min()
    assert 0.0 < poor < 0.9 * open_to.fields["a"].values.min()


BOX = {axis: [-60.0, 60.0] for axis in "xyz"}
REFUSED = {
    "outside": ({"y": [70.0, 80.0], "diffusion": 1.0}, {"domain": BOX}, "y", "outside the domain"),
    "depth in a plane": ({"z": [0.0, 8.0], "diffusion": 1.0}, {"dimensions": 2}, "z", "2 dim"),
    "upside down": ({"x": [8.0, 0.0], "diffusion": 1.0}, {}, "x", "lower end first"),
    "nothing": ({"x": [0.0, 8.0]}, {}, "diffusion", "missing"),
    "too unlike": ({"x": [0.0, 8.0], "diffusion": 1e-6}, {}, "diffusion", "within a factor"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused_in_words(case):
    region, changes, key, words = REFUSED[case]
    with refused(f"nutrients.a.regions.gel.{key}", words):
        scene({"regions": {"gel": region}}, **changes)


def test_shells_have_no_place_for_a_region():
    with refused("nutrients.a.regions", "shells"):
        scene({"regions": GEL, "geometry": "radial"})
