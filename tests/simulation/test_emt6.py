"""The EMT6/Ro scenes: against a solution along the radius by other code, and against the data."""

import sys
from pathlib import Path

import numpy as np
import pytest

import multicell as mc

PROGRAMS = Path(__file__).resolve().parents[2] / "docs" / "programs"
PACKING = 0.76


@pytest.fixture(scope="module")
def docs():
    """Return the modules of the documentation that solve along the radius, and that fit."""
    sys.path.insert(0, str(PROGRAMS))
    try:
        import emt6_ball
        import emt6_fit
    finally:
        sys.path.remove(str(PROGRAMS))
    return emt6_ball, emt6_fit


def test_a_rim_fed_by_oxygen_alone_is_that_of_the_closed_form(docs):
    """Uptake of zeroth order: c(R) - c(a) = q/(6 D) (R² - 3 a² + 2 a³/R), and a layer outside."""
    ball, _ = docs
    q, outer, layer = 0.02, 300.0, 60.0
    tissue = ball.Tissue(q, 1e-9, 0.0, 1.0, layer, least=2.5 * q, half_oxygen=1e-7)
    d, medium = tissue.diffusion, tissue.medium[0]

    def left(a):
        within = q / (6.0 * d) * (outer**2 - 3.0 * a**2 + 2.0 * a**3 / outer)
        beyond = q * (outer**3 - a**3) / (3.0 * medium) * (1.0 / outer - 1.0 / (outer + layer))
        return 0.15 - within - beyond

    from scipy.optimize import brentq

    expected = outer - brentq(left, 1.0, outer - 1.0)
    found = ball.ball(tissue, 0.15, 5.0, outer)
    assert found.rim == pytest.approx(expected, abs=0.5)
    assert found.consumption == pytest.approx(q, rel=0.01)
    beyond = q * (outer**3 - found.core**3) / (3.0 * medium)
    depth = np.array([-2.0 * layer, -0.5 * layer, 0.0])
    r = np.minimum(outer - depth, outer + layer)
    expected = 0.15 - beyond * (1.0 / r - 1.0 / (outer + layer))
    np.testing.assert_allclose(found.pressure(depth) * ball.SOLUBILITY, expected, rtol=1e-3)


def test_lactate_kills_where_the_closed_form_has_its_threshold(docs):
    """Glucose without end: lactate at the core is that of uniform production in a shell."""
    ball, _ = docs
    g, outer, layer = 0.02, 400.0, 50.0
    tissue = ball.Tissue(1e-9, g, 0.0, 1.0, layer, least=1e-6, lactate=900.0, rule="lactate",
                         half_glucose=1e-9, diffusion_glucose=1e5)  # fmt: skip
    a = ball.ball(tissue, 0.2, 30.0, outer).core
    within = g / 3.0 * (outer**2 - 3.0 * a**2 + 2.0 * a**3 / outer)
    share = tissue.diffusion_lactate / tissue.medium[2]
    beyond = 2.0 * g * (outer**3 - a**3) / 3.0 * (1.0 / outer - 1.0 / (outer + layer)) * share
    assert within + beyond == pytest.approx(900.0, rel=0.01)


@pytest.mark.parametrize("rule", ["time", "damage"])
def test_cells_that_die_late_live_deeper(docs, rule):
    """With no time to lose both rules are that of ATP; drift times the time is what they add."""
    ball, _ = docs
    tissues = [ball.Tissue(least=0.06, rule=rule, harm=harm) for harm in (1e-4, 2.0, 4.0)]
    rims = [ball.ball(tissue, 0.2, 1.8).rim for tissue in tissues]
    atp = ball.ball(ball.Tissue(least=0.06), 0.2, 1.8).rim
    assert rims[0] == pytest.approx(atp, abs=3.0)
    assert rims[0] + 1.0 < rims[1] < rims[2]


def test_both_scenes_are_one_model():
    growing, resting = (mc.load_scene(name).to_dict() for name in ("emt6", "emt6-rim"))
    assert growing["nutrients"] == resting["nutrients"]
    del growing["energy"]["growth_half_saturation"]
    assert growing["energy"] == resting["energy"]


def test_the_parameters_fit_rims_oxygen_and_consumption_together(docs):
    ball, fitting = docs
    data = fitting.measured()
    rims, pressures, used = fitting.verdict(
        ball.Tissue.of(mc.load_scene("emt6"), PACKING), data
    )  # fmt: skip
    assert len(data.rims) == len(data.consumption) == 8
    assert rims < 1.1
    assert len(pressures) == 2
    assert max(pressures) < 5.0
    assert used < 0.2


@pytest.mark.parametrize("condition", [(0.05, 0.8), (0.05, 16.5), (0.2, 5.5)])
def test_runs_are_as_along_the_radius(docs, condition):
    ball, _ = docs
    scene = mc.load_scene("emt6-rim").with_changes(
        {
            "nutrients.oxygen.boundary": condition[0],
            "nutrients.glucose.boundary": condition[1],
        }
    )
    result = mc.run(scene)
    summary = result.summary()
    assert summary["diameter"] == pytest.approx(740.0, abs=2.0)
    tissue = ball.Tissue.of(scene, summary["packing_ratio"])
    found = ball.ball(tissue, *condition)
    assert summary["viable_rim"] == pytest.approx(found.rim, abs=4.0)
    field = result.frames[-1].fields["oxygen"]
    values = field.values.ravel()
    depth = 370.0 - (np.arange(len(values)) + 0.5) * field.spacing
    # a ball of cells has no sharp edge: uptake falls off over the radius of the outermost ones
    near = (depth > scene.cells.division_radius) & (depth < 150.0)
    off = values[near] - ball.SOLUBILITY * found.pressure(depth[near])
    assert np.abs(off).max() < 0.02 * condition[0]


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
    cells, diameters = fitting.growth_errors(tissue, data)
    assert np.sqrt(np.mean(np.square(cells))) < 0.33
    assert np.sqrt(np.mean(np.square(diameters))) < 0.09
