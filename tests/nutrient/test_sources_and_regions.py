"""What stands still in a field: points and planes that give off a substance, gels and membranes."""

import itertools

import numpy as np
import pytest
from running import finished, refused
from scipy.special import erfc

import multicell as mc
from multicell.errors import StepFailed
from multicell.nutrient.cartesian import Box
from multicell.nutrient.field import NutrientField
from multicell.nutrient.grid import BoxLayout
from multicell.nutrient.parameters import FieldParameters
from multicell.nutrient.regions import covered, injected
from multicell.report.explain.scene import explain
from multicell.scene.nutrient import Nutrient, Region, Source
from multicell.scene.parts import Domain
from multicell.scene.scene import Scene

D = 500.0
WALL = {"type": "derivative", "derivative": 0.0}
POINT = {"x": 0.0, "y": 0.0, "z": 0.0, "strength": "3000 amol/s"}
NOBODY = {"position": np.empty((0, 3)), "capacity": np.empty(0)}


def field(half, spacing, regime="steady", dimensions=3, **changes):
    nutrient = Nutrient(diffusion=D, boundary=0.0, uptake=0.0, **changes)
    domain = Domain(**{axis: [-half, half] for axis in "xyz"[:dimensions]})
    return NutrientField("a", FieldParameters(nutrient, spacing, 10.0, regime, dimensions, domain))


def scene(nutrient, **changes):
    entries = {
        "duration": "1 h", "coupling_step": "10 min", "contact": {"law": "hertz"},
        "initial": {"count": 20, "stage": "uniform"}, "growth": {"cycle_time": "8 h"},
        "nutrients": {"a": {"boundary": 0.07, **nutrient}},
    }  # fmt: skip
    return Scene.from_dict(entries | changes)


# --- sources --------------------------------------------------------------------------------------


def around(distance):
    """Return points at a distance, in directions that favour no axis of the grid."""
    ways = np.array([[1.0, 2, 3], [-3, 1, 2], [2, -3, -1], [-1, -2, 3], [3, 3, 1]])
    return distance * ways / np.linalg.norm(ways, axis=1)[:, None]


def test_a_point_in_an_infinite_medium_with_decay():
    """c = S/(4πDr) exp(-r/L), L² = D/k; walls at eight lengths."""
    length = 30.0
    oxygen = field(240.0, 7.5, decay=D / length**2, sources={"pump": POINT})
    report = oxygen.solve(**NOBODY)
    for r in (25.0, 40.0, 60.0, 90.0):
        exact = 3000.0 / (4 * np.pi * D * r) * np.exp(-r / length)
        assert oxygen.sample(around(r)).mean() == pytest.approx(exact, rel=2e-2)
        np.testing.assert_allclose(oxygen.sample(around(r)), exact, rtol=8e-2)
    assert report.injected == pytest.approx(3000.0, rel=1e-12)
    assert report.decayed == pytest.approx(3000.0 + report.inflow, rel=1e-8)
    assert report.outflow < 0.003 * 3000.0


def test_the_error_of_a_point_is_of_second_order():
    length, errors = 30.0, []
    for spacing in (12.0, 6.0):
        oxygen = field(180.0, spacing, decay=D / length**2, sources={"pump": POINT})
        oxygen.solve(**NOBODY)
        exact = 3000.0 / (4 * np.pi * D * 48.0) * np.exp(-48.0 / length)
        errors.append(abs(oxygen.sample(around(48.0)).mean() - exact))
    assert errors[1] < 0.4 * errors[0]


def test_a_point_that_begins_to_give():
    """c = S/(4πDr) erfc(r/√(4Dt)) before it reaches the walls."""
    oxygen = field(100.0, 10.0, "transient", sources={"pump": POINT})
    nowhere, nobody = np.empty((0, 3)), np.empty(0)
    oxygen.group.fill(nowhere, radius=nobody, time=0.0)
    lost = 0.0
    for begin, end in ((0.0, 2.0), (2.0, 4.0)):
        demand = {"a": (nobody, None)}
        march = oxygen.group.advance(nowhere, demand, radius=nobody, begin=begin, end=end)["a"]
        for r in (30.0, 45.0):
            exact = 3000.0 / (4 * np.pi * D * r) * erfc(r / np.sqrt(4 * D * end))
            assert oxygen.sample(around(r)).mean() == pytest.approx(exact, rel=4e-2)
        lost -= march.inflow
    assert oxygen.stored() == pytest.approx(3000.0 * 4.0 - lost, rel=1e-8)


@pytest.mark.parametrize("axis", "xyz")
@pytest.mark.parametrize("place", [-20.0, 13.0])
def test_a_plane_between_two_sides(axis, place):
    """c = F (p - a)(b - x) / (D (b - a)) beyond the plane at p, and likewise before it: exact."""
    sides = {"*": WALL, f"{axis}-": {}, f"{axis}+": {}}
    oxygen = field(60.0, 10.0, sides=sides, sources={"dish": {axis: place, "flux": 0.2}})
    report = oxygen.solve(**NOBODY)
    position = np.zeros((5, 3))
    x = np.array([-59.0, -40.0, 25.0, 45.0, 58.0])
    position[:, "xyz".index(axis)] = x
    low, high = np.minimum(x, place), np.maximum(x, place)
    exact = 0.2 / D * (low + 60.0) * (60.0 - high) / 120.0
    np.testing.assert_allclose(oxygen.sample(position), exact, rtol=1e-8)
    assert report.injected == pytest.approx(0.2 * 120.0**2, rel=1e-12)


def test_a_plane_gives_as_much_wherever_it_lies():
    layout = BoxLayout(Box((0.0, 0.0, 0.0), (4, 5, 6), 10.0))
    for z in (0.0, 2.0, 5.0, 33.3, 58.0, 60.0):
        found = np.sum(layout.volumes * injected(layout, {"dish": Source(z=z, flux=0.5)}))
        assert found == pytest.approx(0.5 * 40.0 * 50.0, rel=1e-12)


@pytest.mark.parametrize("finite", [None, {"volume": 1e8}])
@pytest.mark.parametrize("regime", ["steady", "transient"])
def test_moving_cells_round_a_source_account_for_all_that_it_gave(regime, finite):
    nutrient = {"sources": {"pump": POINT}, "regime": regime, "secretion": 2.0, "decay": 1e-3}
    if finite is not None:
        nutrient["finite_medium"] = finite
    simulation = finished(scene(nutrient))
    ledger = simulation.ledger["a"]
    assert ledger.injected == pytest.approx(3000.0 * 3600.0, rel=1e-12)
    assert ledger.relative_remainder <= 1e-8
    assert 0.0 < ledger.secreted < 2.0 * 3600.0 * len(simulation.cells) * 1.01
    assert simulation.summary()["ledger"]["a"]["injected"] == ledger.injected
    ledger.injected *= 0.999
    assert ledger.relative_remainder > 1e-5


def test_in_a_plane():
    flat = {key: value for key, value in POINT.items() if key != "z"}
    simulation = finished(scene({"sources": {"pump": flat}, "height": 10.0}, dimensions=2))
    assert simulation.ledger["a"].injected == pytest.approx(3000.0 * 3600.0)
    assert "given off by 1 source(s)" in str(explain(simulation.scene)["parts"])


# --- regions --------------------------------------------------------------------------------------


def between(axis, regions, dimensions=3):
    """Return a field between 0 and 1 mM at the sides across an axis, at ±60 µm."""
    sides = {"*": WALL, f"{axis}-": {"value": 0.0}, f"{axis}+": {"value": 1.0}}
    return field(60.0, 10.0, dimensions=dimensions, sides=sides, regions=regions)


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
    slab = between(axis, regions)
    report = slab.solve(**NOBODY)
    position = np.zeros((4, 3))
    x = np.array([-55.0, -48.0, 50.0, 57.0])
    position[:, "xyz".index(axis)] = x
    exact = through_layers(x, LAYERS[case])
    np.testing.assert_allclose(slab.sample(position), exact, rtol=1e-6, atol=1e-9)
    # one way in and one way out: as much leaves as comes
    flow = 120.0**2 * exact[0] / 5.0 * D
    assert report.outflow == pytest.approx(flow, rel=1e-5)
    assert abs(report.inflow) < 1e-8 * flow


def test_a_gel_in_a_plane():
    slab = between("y", {"gel": {"y": [-13.3, 21.7], "diffusion": 40.0}}, dimensions=2)
    slab.solve(**NOBODY)
    position = np.array([[3.0, -48.0, 0.0], [-20.0, 50.0, 0.0]])
    exact = through_layers(position[:, 1], LAYERS["a gel"])
    np.testing.assert_allclose(slab.sample(position), exact, rtol=1e-6)


def test_what_is_covered_is_the_volume_of_the_region():
    box = Box((0.0, 0.0, 0.0), (6, 7, 8), 10.0)
    gel = Region(diffusion=1.0, x=(-5.0, 23.0), y=(11.0, 12.0), z=(34.0, 71.0))
    share = covered(box, gel)
    assert (share >= 0.0).all()
    assert (share <= 1.0).all()
    assert share.sum() * 1000.0 == pytest.approx(23.0 * 1.0 * 37.0, rel=1e-12)
    assert covered(box, Region(diffusion=1.0)).sum() == 6 * 7 * 8
    assert covered(box, Region(diffusion=1.0, x=(70.0, 80.0))).sum() == 0.0


FORTY = {"initial": {"count": 40, "stage": "uniform"}}
GEL = {"gel": {"x": ["8 um", "100 um"], "diffusion": "50 um^2/s"}}


@pytest.mark.parametrize(
    ("regime", "medium"), [("steady", {}), ("transient", {"diffusion_medium": "3000 um^2/s"})]
)
def test_cells_behind_a_gel_starve_and_nothing_is_lost(regime, medium):
    behind, open_to = (
        mc.Simulation(
            scene({"regime": regime, "regions": regions, "spacing": 10.0, **medium}, **FORTY)
        )
        for regions in (GEL, {})
    )
    for simulation in (behind, open_to):
        finished(simulation)
        assert simulation.ledger["a"].relative_remainder <= 1e-8
    poor = behind.fields["a"].values.min()
    assert 0.0 < poor < 0.9 * open_to.fields["a"].values.min()


# --- what is refused ------------------------------------------------------------------------------

BOX = {axis: [-60.0, 60.0] for axis in "xyz"}
REFUSED = {
    "sources.pump": {
        "neither": ({"x": 0.0}, {}, "strength", "neither"),
        "both": ({"x": 0.0, "strength": 1.0, "flux": 1.0}, {}, "strength", "both"),
        "two places": ({"x": 0.0, "y": 0.0, "flux": 1.0}, {}, "flux", "one of x, y, z"),
        "no domain": ({"x": 0.0, "flux": 1.0}, {}, "flux", "needs a domain"),
        "no place": ({"x": 0.0, "y": 0.0, "strength": 1.0}, {}, "z", "missing"),
        "outside": ({**POINT, "y": "70 um"}, {"domain": BOX}, "y", "outside the domain"),
        "a plane outside": ({"z": -61.0, "flux": 1.0}, {"domain": BOX}, "z", "outside the domain"),
        "depth in a plane": (POINT, {"dimensions": 2}, "z", "2 dimensions"),
        "less than nothing": ({**POINT, "strength": -1.0}, {}, "strength", "at least 0"),
    },
    "regions.gel": {
        "outside": ({"y": [70, 80], "diffusion": 1.0}, {"domain": BOX}, "y", "outside the domain"),
        "depth in a plane": ({"z": [0.0, 8.0], "diffusion": 1.0}, {"dimensions": 2}, "z", "2 dim"),
        "upside down": ({"x": [8.0, 0.0], "diffusion": 1.0}, {}, "x", "lower end first"),
        "nothing": ({"x": [0.0, 8.0]}, {}, "diffusion", "missing"),
        "too unlike": ({"x": [0.0, 8.0], "diffusion": 1e-6}, {}, "diffusion", "within a factor"),
    },
}


@pytest.mark.parametrize(("place", "case"), [(p, case) for p in REFUSED for case in REFUSED[p]])
def test_refused_in_words(place, case):
    entries, changes, key, words = REFUSED[place][case]
    what, name = place.split(".")
    with refused(f"nutrients.a.{place}.{key}", words):
        scene({what: {name: entries}}, **changes)


@pytest.mark.parametrize("what", [{"sources": {"pump": POINT}}, {"regions": GEL}])
def test_shells_have_no_place_for_them(what):
    with refused(f"nutrients.a.{next(iter(what))}", "shells"):
        scene({"geometry": "radial", **what})


def test_a_grid_that_leaves_a_source_behind_is_named():
    with pytest.raises(StepFailed, match="the source 'pump' lies at y = 900 um, outside"):
        mc.Simulation(scene({"sources": {"pump": {**POINT, "y": 900.0}}}))
