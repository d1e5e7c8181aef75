"""Predictions of explain for whole runs, against runs, closed forms and SciPy."""

import math

import numpy as np
import pytest
from rich_medium import MUCH_OXYGEN
from scipy.integrate import solve_bvp

import multicell as mc
from multicell.report.explain.cost import predict
from multicell.report.explain.course import Profile, expected_course
from multicell.report.explain.scene import explain

DAY = 86400.0
MANY = {"initial.stage": "asynchronous", **MUCH_OXYGEN, "duration": "20 min"}

MEASURED = {
    # scene, changes, cells at the end, MB of the process at its largest, MB of frames.h5
    "one cell for twelve days": ("spheroid", {}, 7859, 248, 4.1),
    "starved on the way": ("treatment", {}, 2418, 242, 1.7),
    "nothing limits": ("growth", {}, 169, 191, 0.11),
    "steps that the run chooses": ("grow-2000", {}, 2007, 198, 0.45),
    "held back by pressure, flat": ("monolayer", {}, 1963, 204, 0.78),
    "doses in a finite medium": ("dosing", {}, 1056, 201, 0.61),
    "two fields, phases, an early end": ("emt6", {}, 20060, 233, 5.7),
    "a domain, no growth": ("chemotaxis", {}, 120, 231, None),
    "a hundred thousand": ("spheroid", {**MANY, "initial.count": 10**5}, 101_678, 326, 8.9),
    "a million": ("spheroid", {**MANY, "initial.count": 10**6}, 1_015_739, 1101, 90.4),
}
"""Runs with a folder and one thread, everything compiled; Linux, Python 3.11."""


@pytest.mark.parametrize("case", MEASURED)
def test_cells_memory_and_files_are_foretold_within_a_factor_of_two(case):
    name, changes, cells, memory, file = MEASURED[case]
    found = predict(mc.load_scene(name).with_changes(changes))
    assert found.course.cells[-1] == pytest.approx(cells, rel=1.0)
    assert found.course.cells[-1] > 0.5 * cells
    assert 0.5 < found.memory / (1e6 * memory) < 2.0
    if file is not None:  # a field that does not change takes next to nothing
        assert 0.5 < found.file / (1e6 * file) < 2.0


def test_growth_that_nothing_limits_is_exponential():
    scene = mc.load_scene("growth")
    scene = scene.with_changes({"initial.stage": "asynchronous"})
    found = expected_course(scene.with_changes({"growth.cycle_variation": 0.0}))
    np.testing.assert_allclose(found.cells, 2.0 ** (found.times / (15 * 3600.0)), rtol=1e-9)
    # cycles that vary by v add (1 + v² ln2 / 2) to the rate to leading order
    rate = np.log(expected_course(scene).cells[-1]) / np.log(found.cells[-1])
    assert rate == pytest.approx(1.0 + 0.01 * 0.5 * math.log(2.0), abs=2e-4)


def test_cells_that_begin_newborn_are_fewer_by_what_they_lack():
    """Their number is a staircase 2^floor(t/T), whose mean over a cycle is 2^(t/T) / (2 ln 2)."""
    scene = mc.load_scene("growth").with_changes(
        {"growth.cycle_variation": 0.0, "initial": {"count": 5}, "duration": "10 d"}
    )
    found, cycle = expected_course(scene), 15 * 3600.0
    whole = found.times >= found.times[-1] - 8.0 * cycle
    stairs = 5.0 * 2.0 ** np.floor(np.linspace(0.0, 8.0, 80_000, endpoint=False))
    smooth = 5.0 * 2.0 ** np.linspace(0.0, 8.0, 80_000)
    expected = (stairs / smooth).mean()
    ratio = found.cells / (5.0 * 2.0 ** (found.times / cycle))
    np.testing.assert_allclose(ratio[whole], expected, rtol=1e-4)
    assert found.cells[0] == 5.0
    assert (np.diff(found.cells) >= 0.0).all()
    aged = expected_course(scene.with_changes({"initial.stage": "asynchronous"}))
    assert found.cells[-1] == pytest.approx(aged.cells[-1] / (2.0 * math.log(2.0)))
    # a newborn cell has so much of the volume of a mean one, too
    assert found.radius[0] == pytest.approx(aged.radius[0] * (0.5 / math.log(2.0)) ** (1 / 3))


def test_tissue_that_starves_at_once_leaves_nobody():
    """Parts of all shells may add up to more than one by rounding."""
    scene = mc.load_scene("settle").with_changes({
        "initial.stage": "birth", "death": {"lysis_time": "1 s"},
        "nutrients": {"oxygen": {"boundary": "0.05 mM", "necrosis": "0.1 mM"}},
    })  # fmt: skip
    for count in range(1, 40):
        found = expected_course(scene.with_changes({"initial.count": count}))
        assert found.cells.dtype == found.radius.dtype == np.float64
        assert found.cells[-1] == pytest.approx(0.0, abs=1e-9), count
        assert 0.0 <= found.radius[-1] < 1e-3


def test_a_run_that_stops_early_is_foretold_to():
    scene = mc.load_scene("emt6")
    found = expected_course(scene)
    assert found.times[-1] < scene.duration
    assert found.cells[-1] >= scene.stop_cells > found.cells[-2]
    words = {number["name"]: number["meaning"] for number in explain(scene)["numbers"]}
    assert "where the run stops" in words["expected cells"]


def test_fields_of_the_forecast_are_those_of_a_boundary_value_solver():
    field = mc.load_scene("spheroid").nutrients["oxygen"]
    inner, outer, volume = 20.0, 120.0, 400.0
    shells = np.linspace(inner, outer, 41)
    found = Profile(field, 3).solve(shells, 0.0, 1.0, volume)
    q, k, d = field.uptake / volume, field.half_saturation, field.diffusion
    resistance = field.margin / (outer * (outer + field.margin))

    def equations(r, y):
        return np.vstack([y[1], -2.0 * y[1] / r + q / d * y[0] / (k + y[0])])

    def ends(a, b):
        return np.array([a[1], outer**2 * b[1] * resistance - (field.boundary - b[0])])

    r = np.linspace(inner, outer, 200)
    true = solve_bvp(equations, ends, r, np.full((2, 200), 0.01), tol=1e-8, max_nodes=20_000)
    assert true.success
    middles = 0.5 * (shells[1:] + shells[:-1])
    np.testing.assert_allclose(found, true.sol(middles)[0], atol=0.02 * field.boundary)


def test_time_grows_with_cells_steps_and_stiffness():
    scene = mc.load_scene("spheroid").with_changes({"growth": None, "death": None})

    def seconds(**changes):
        changes = {name.replace("__", "."): value for name, value in changes.items()}
        return predict(scene.with_changes(changes)).seconds

    many = seconds(initial__count=100_000)
    assert many > 20.0 * seconds(initial__count=1000)
    assert seconds(initial__count=100_000, duration="24 d") == pytest.approx(2.0 * many, rel=0.02)
    assert seconds(initial__count=100_000, drag__viscosity="1 kPa s") > 2.0 * many
    assert math.isfinite(seconds(initial__count=10**8))


def test_all_that_starve_are_gone_in_the_end():
    changes = {"nutrients.oxygen.boundary": 0.001, "initial.count": 500, "duration": "30 d"}
    found = expected_course(mc.load_scene("spheroid").with_changes(changes))
    assert found.cells[1] == pytest.approx(500.0, rel=0.01)  # they die and lie there
    assert found.cells[-1] < 0.01
