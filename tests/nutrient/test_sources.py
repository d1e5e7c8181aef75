"""Points and planes that give off a substance, against closed forms."""

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
from multicell.nutrient.sources import injected
from multicell.report.explain.scene import explain
from multicell.scene.nutrient import Nutrient, Source
from multicell.scene.parts import Domain
from multicell.scene.scene import Scene

D = 500.0
WALL = {"type": "derivative", "derivative": 0.0}
POINT = {"x": 0.0, "y": 0.0, "z": 0.0, "strength": "3000 amol/s"}


def field(half, spacing, regime="steady", **changes):
    nutrient = Nutrient(diffusion=D, boundary=0.0, uptake=0.0, **changes)
    domain = Domain(**{axis: [-half, half] for axis in "xyz"})
    return NutrientField("a", FieldParameters(nutrient, spacing, 10.0, regime, 3, domain))


def around(distance):
    """Return points at a distance, in directions that favour no axis of the grid."""
    ways = np.array([[1.0, 2, 3], [-3, 1, 2], [2, -3, -1], [-1, -2, 3], [3, 3, 1]])
    return distance * ways / np.linalg.norm(ways, axis=1)[:, None]


NOBODY = {"position": np.empty((0, 3)), "capacity": np.empty(0)}


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


def scene(nutrient, **changes):
    entries = {
        "duration": "1 h", "coupling_step": "10 min", "contact": {"law": "hertz"},
        "initial": {"count": 20, "stage": "uniform"}, "growth": {"cycle_time": "8 h"},
        "nutrients": {"a": {"boundary": 0.02, "sources": {"pump": POINT}, **nutrient}},
    }  # fmt: skip
    return Scene.from_dict(entries | changes)


@pytest.mark.parametrize("finite", [None, {"volume": 1e8}])
@pytest.mark.parametrize("regime", ["steady", "transient"])
def test_moving_cells_round_a_source_account_for_all_that_it_gave(regime, finite):
    nutrient = {"regime": regime, "secretion": 2.0, "decay": 1e-3}
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


BOX = {axis: [-60.0, 60.0] for axis in "xyz"}
REFUSED = {
    "neither": ({"x": 0.0}, {}, "strength", "neither"),
    "both": ({"x": 0.0, "strength": 1.0, "flux": 1.0}, {}, "strength", "both"),
    "a plane of two places": ({"x": 0.0, "y": 0.0, "flux": 1.0}, {}, "flux", "one of x, y, z"),
    "a plane without a domain": ({"x": 0.0, "flux": 1.0}, {}, "flux", "needs a domain"),
    "a point without a place": ({"x": 0.0, "y": 0.0, "strength": 1.0}, {}, "z", "missing"),
    "outside": ({**POINT, "y": "70 um"}, {"domain": BOX}, "y", "outside the domain"),
    "a plane outside": ({"z": -61.0, "flux": 1.0}, {"domain": BOX}, "z", "outside the domain"),
    "depth in a plane": (POINT, {"dimensions": 2}, "z", "2 dimensions"),
    "less than nothing": ({**POINT, "strength": -1.0}, {}, "strength", "at least 0"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused_in_words(case):
    source, changes, key, words = REFUSED[case]
    with refused(f"nutrients.a.sources.pump.{key}", words):
        scene({"sources": {"pump": source}}, **changes)


def test_shells_have_no_place_for_a_source():
    with refused("nutrients.a.sources", "shells"):
        scene({"geometry": "radial"})


def test_a_grid_that_leaves_a_source_behind_is_named():
    with pytest.raises(StepFailed, match="the source 'pump' lies at y = 900 um, outside"):
        mc.Simulation(scene({"sources": {"pump": {**POINT, "y": 900.0}}}))
