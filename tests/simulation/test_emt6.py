"""The EMT6/Ro scenes: against a solution along the radius by other code, and against the data."""

import sys
from pathlib import Path

import numpy as np
import pytest

import multicell as mc

DOCS = Path(__file__).resolve().parents[2] / "docs"
PACKING = 0.76


@pytest.fixture(scope="module")
def docs():
    """Return the modules of the documentation that solve along the radius, and that fit."""
    sys.path.insert(0, str(DOCS))
    try:
        import emt6_ball
        import emt6_fit
    finally:
        sys.path.remove(str(DOCS))
    return emt6_ball, emt6_fit


def test_a_rim_fed_by_oxygen_alone_is_that_of_the_closed_form(docs):
    """Uptake of zeroth order: c(R) - c(a) = q/(6 D) (R² - 3 a² + 2 a³/R), and a layer outside."""
    ball, _ = docs
    q, outer, layer = 0.02, 300.0, 60.0
    tissue = ball.Tissue(q, 1e-9, 0.0, 1.0, layer, 2.5 * q, half_oxygen=1e-7)
    d, medium = tissue.diffusion[0], tissue.medium[0]

    def left(a):
        within = q / (6.0 * d) * (outer**2 - 3.0 * a**2 + 2.0 * a**3 / outer)
        beyond = q * (outer**3 - a**3) / (3.0 * medium) * (1.0 / outer - 1.0 / (outer + layer))
        return 0.15 - within - beyond

    from scipy.optimize import brentq

    expected = outer - brentq(left, 1.0, outer - 1.0)
    assert ball.rim(tissue, 0.15, 5.0, outer) == pytest.approx(expected, abs=0.5)


def test_both_scenes_are_one_model():
    growing, resting = (mc.load_scene(name).to_dict() for name in ("emt6", "emt6-rim"))
    assert growing["nutrients"] == resting["nutrients"]
    del growing["energy"]["growth_half_saturation"]
    assert growing["energy"] == resting["energy"]


def test_rims_of_the_parameters_stay_as_near_to_the_measured_ones(docs):
    ball, fitting = docs
    data = fitting.measured()
    off = fitting.deviations(ball.Tissue.of(mc.load_scene("emt6"), PACKING), data)
    assert len(off) == 8
    assert np.sqrt(np.mean(np.square(off))) < 1.2
    assert np.abs(off).max() < 2.2


@pytest.mark.parametrize("condition", [(0.05, 0.8), (0.05, 16.5), (0.2, 5.5)])
def test_rims_of_runs_are_those_along_the_radius(docs, condition):
    ball, _ = docs
    scene = mc.load_scene("emt6-rim").with_changes(
        {
            "nutrients.oxygen.boundary": condition[0],
            "nutrients.glucose.boundary": condition[1],
        }
    )
    summary = mc.run(scene).summary()
    assert summary["diameter"] == pytest.approx(740.0, abs=2.0)
    tissue = ball.Tissue.of(scene, summary["packing_ratio"])
    assert summary["viable_rim"] == pytest.approx(ball.rim(tissue, *condition), abs=4.0)


def test_a_day_of_growth_is_that_along_the_radius(docs):
    ball, _ = docs
    history = mc.run(mc.load_scene("emt6").with_changes({"duration": "24 h"})).history
    tissue = ball.Tissue.of(mc.load_scene("emt6"), float(history["packing_ratio"][-1]))
    times, cells, diameters, _ = ball.course(tissue, 24.0)
    assert times[-1] == 24.0
    grown = history["cells"][-1] / history["cells"][0]
    assert grown == pytest.approx(cells[-1] / cells[0], rel=0.06)
    assert history["diameter"][-1] == pytest.approx(diameters[-1], rel=0.04)
    assert history["necrotic"][-1] == 0.0


def test_growth_follows_the_data_as_near_as_it_did(docs):
    """Along the radius, to the last measurement."""
    ball, fitting = docs
    data = fitting.measured()
    tissue = ball.Tissue.of(mc.load_scene("emt6"), PACKING)
    cells, diameters = fitting.growth_errors(tissue, data, np.inf)
    assert np.sqrt(np.mean(np.square(cells))) < 0.3
    assert np.sqrt(np.mean(np.square(diameters))) < 0.15
