"""Growth of EMT6/Ro spheroids: against the measurements of Freyer and Sutherland (1986)."""

import numpy as np
import pytest
from docs_programs import program

import multicell as mc

SUBJECT, SOURCE = "measured spheroids", "freyer1986"
PACKING = 0.76


@pytest.fixture(scope="module")
def docs():
    """Return the modules of the documentation that solve along the radius, and that fit."""
    return program("emt6_ball"), program("emt6_fit")


@pytest.mark.slow
def test_a_day_of_growth_is_that_along_the_radius(docs, compare):
    ball, _ = docs
    history = mc.run(mc.load_scene("emt6").with_changes({"duration": "24 h"})).history
    tissue = ball.Tissue.of(mc.load_scene("emt6"), float(history["packing_ratio"][-1]))
    times, cells, diameters, _ = ball.course(tissue, 24.0)
    assert times[-1] == 24.0
    grown = history["cells"][-1] / history["cells"][0]
    ratio = grown / (cells[-1] / cells[0])
    compare.value("`emt6` after a day: cells, over those along the radius", 1.0, ratio, 0.06)
    ratio = history["diameter"][-1] / diameters[-1]
    compare.value("`emt6` after a day: diameter, over that along the radius", 1.0, ratio, 0.04)
    assert history["necrotic"][-1] == 0.0


def test_growth_follows_the_data_as_near_as_it_did(docs, compare):
    """Along the radius, to the last measurement."""
    ball, fitting = docs
    data = fitting.measured()
    tissue = ball.Tissue.of(mc.load_scene("emt6"), PACKING)
    cells, diameters = fitting.growth_errors(tissue, data)
    rms = np.sqrt(np.mean(np.square(cells)))
    compare.deviation("along the radius to 480 h, cells (rms)", "measurements", rms, 0.33, "in ln")
    rms = np.sqrt(np.mean(np.square(diameters)))
    compare.deviation(
        "along the radius to 480 h, diameters (rms)", "measurements", rms, 0.09, "in ln"
    )
