"""Co-culture spheroids of Murphy et al. 2022: radii by ratio, to which nothing was fitted.

Means over 8 spheroids of half melanoma cells, half fibroblasts (their ``Fig006data.csv``,
doi:10.1101/2022.12.21.521515); the scene's melanoma cells were fitted to another study's.
Their motility was lowered with these radii in view, since at 4 nN cells left the spheroid.
"""

from __future__ import annotations

import numpy as np
import pytest

import multicell as mc

SUBJECT, SOURCE = "measured spheroids", "murphy2022coculture"
MEASURED = {3: 175.5, 6: 211.5, 9: 253.8}  # um, by day


@pytest.fixture(scope="module")
def run():
    scene = mc.load_scene("coculture").with_changes({"duration": "9 d"})
    return mc.run(mc.coarsen(scene, 2.5), threads=1)


@pytest.mark.slow
def test_radii_of_half_fibroblasts_are_those_measured_within_a_tenth(run, compare):
    found = np.interp(
        [86400 * day for day in MEASURED], run.history["time"], run.history["diameter"] / 2
    )
    for (day, radius), ours in zip(MEASURED.items(), found, strict=True):
        what = f"radius of a spheroid of half melanoma cells, half fibroblasts, day {day}"
        compare.value(what, radius, ours, 0.1 * radius, "um")


def test_fibroblasts_gather_inside_and_die(run):
    first, last = (run.frames[k].cells for k in (0, -1))
    away = np.linalg.norm(last.position - last.position.mean(axis=0), axis=1)
    living = last.state < mc.State.NECROTIC
    melanoma, fibroblast = (away[living & (last.kind == k)].mean() for k in (0, 1))
    assert fibroblast < 0.93 * melanoma
    before, after = ((c.kind == 1) & (c.state < mc.State.NECROTIC) for c in (first, last))
    # none is born, and the constant rate leaves exp(-0.002 * 216) of them
    assert after.sum() / before.sum() == pytest.approx(np.exp(-0.432), abs=0.12)
