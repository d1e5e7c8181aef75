"""The EMT6/Ro scenes: against a solution along the radius by other code, and against the data."""

import numpy as np
import pytest
from docs_programs import DOCS, program

import multicell as mc

SUBJECT, SOURCE = "measured spheroids", "muellerklieser1986"
PACKING = 0.76


@pytest.fixture(scope="module")
def docs():
    """Return the modules of the documentation that solve along the radius, and that fit."""
    return program("emt6_ball"), program("emt6_fit")


def test_a_rim_fed_by_oxygen_alone_is_that_of_the_closed_form(docs, compare):
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
    what = "along the radius, oxygen alone behind a layer: viable rim"
    compare.value(what, expected, found.rim, 0.5, "µm")
    assert found.consumption == pytest.approx(q, rel=0.01)
    beyond = q * (outer**3 - found.core**3) / (3.0 * medium)
    depth = np.array([-2.0 * layer, -0.5 * layer, 0.0])
    r = np.minimum(outer - depth, outer + layer)
    expected = 0.15 - beyond * (1.0 / r - 1.0 / (outer + layer))
    np.testing.assert_allclose(found.pressure(depth) * ball.SOLUBILITY, expected, rtol=1e-3)


def test_lactate_kills_where_the_closed_form_has_its_threshold(docs, compare):
    """Glucose without end: lactate at the core is that of uniform production in a shell."""
    ball, _ = docs
    g, outer, layer = 0.02, 400.0, 50.0
    tissue = ball.Tissue(1e-9, g, 0.0, 1.0, layer, least=1e-6, lactate=900.0, rule="lactate",
                         half_glucose=1e-9, diffusion_glucose=1e5)  # fmt: skip
    a = ball.ball(tissue, 0.2, 30.0, outer).core
    within = g / 3.0 * (outer**2 - 3.0 * a**2 + 2.0 * a**3 / outer)
    share = tissue.diffusion_lactate / tissue.medium[2]
    beyond = 2.0 * g * (outer**3 - a**3) / 3.0 * (1.0 / outer - 1.0 / (outer + layer)) * share
    what = "along the radius, lactate where the core begins"
    compare.value(what, 900.0, within + beyond, 9.0, "mM")


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


def test_the_parameters_fit_rims_oxygen_and_consumption_together(docs, compare):
    ball, fitting = docs
    data = fitting.measured()
    rims, pressures, used = fitting.verdict(
        ball.Tissue.of(mc.load_scene("emt6"), PACKING), data
    )  # fmt: skip
    assert len(data.rims) == len(data.consumption) == 8
    assert len(pressures) == 2
    measured = "measurements"
    compare.deviation("along the radius, eight rims (rms)", measured, rims, 1.1, "sd")
    worst = max(pressures)
    compare.deviation(
        "along the radius, profiles of pO₂ (rms of the worse)", measured, worst, 5.0, "mmHg"
    )
    compare.deviation(
        "along the radius, consumption (the worst of eight)", measured, used, 0.2, "in ln"
    )


@pytest.mark.parametrize("condition", [(0.05, 0.8), (0.05, 16.5), (0.2, 5.5)])
def test_runs_are_as_along_the_radius(docs, compare, condition):
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
    where = f"`emt6-rim` at {condition[0]:.0%} oxygen, {condition[1]:g} mM glucose"
    what = f"{where}: rim, and along the radius by other code"
    compare.value(what, found.rim, summary["viable_rim"], 4.0, "µm")
    field = result.frames[-1].fields["oxygen"]
    values = field.values.ravel()
    depth = 370.0 - (np.arange(len(values)) + 0.5) * field.spacing
    # a ball of cells has no sharp edge: uptake falls off over the radius of the outermost ones
    near = (depth > scene.cells.division_radius) & (depth < 150.0)
    off = values[near] - ball.SOLUBILITY * found.pressure(depth[near])
    what = f"{where}: oxygen in the outer 150 µm, over that of the medium"
    largest = np.abs(off).max() / condition[0]
    compare.deviation(what, "along the radius by other code", largest, 0.02)


@pytest.mark.slow
def test_the_eight_rims_are_those_measured(compare):
    lines = (DOCS / "data" / "emt6-rims.csv").read_text(encoding="utf-8").splitlines()
    table = [line.split(",") for line in lines if line[0].isdigit()]
    oxygen, glucose, rim, deviation = np.array([[float(v) for v in row[:4]] for row in table]).T
    scene, off = mc.load_scene("emt6-rim"), []
    assert len(rim) == 8
    for o, g, seen, sd in zip(oxygen, glucose, rim, deviation, strict=True):
        changes = {"nutrients.oxygen.boundary": o, "nutrients.glucose.boundary": g}
        off.append((mc.run(scene.with_changes(changes)).summary()["viable_rim"] - seen) / sd)
    rms = np.sqrt(np.square(off).mean())
    compare.deviation("`emt6-rim`, eight rims (rms)", "measurements", rms, 1.1, "sd")
    worst = np.abs(off).max()
    compare.deviation("`emt6-rim`, the worst of eight rims", "measurements", worst, 2.1, "sd")
