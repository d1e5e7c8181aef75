"""Sums that nothing may change: volumes and centres of mass in divisions, and ledgers of fields."""

from dataclasses import replace

import numpy as np
import pytest

import multicell as mc
from multicell.biology.division import divide
from multicell.biology.plan import biology_plan

SUBJECT, SOURCE = "conservation", "sums"


def test_divisions_keep_volume_and_centres_of_mass(compare):
    scene = mc.load_scene("growth").with_changes({"initial.count": 500})
    young = mc.Simulation(scene).cells
    mothers = replace(young, radius=np.full(500, scene.cells.division_radius * 1.001))
    born, _ = divide(biology_plan(scene), mothers, 1000)
    assert len(born) == 1000
    off = abs(born.volume.sum() / mothers.volume.sum() - 1)
    compare.deviation("500 divisions: volume, relative", "conserved", off, 1e-12)
    pairs = born.position[np.lexsort((born.id, born.parent))].reshape(500, 2, 3).mean(axis=1)
    off = abs(pairs - mothers.position[np.argsort(mothers.id)]).max()
    compare.deviation("500 divisions: centre of mass of each", "conserved", off, 1e-12, "µm")


@pytest.mark.parametrize("regime", ["steady", "transient"])
def test_the_ledger_of_a_growing_spheroid_closes(regime, compare):
    ball = mc.load_scene("spheroid").with_changes({"initial.count": 300, "duration": "6 h"})
    summary = mc.run(ball.with_changes({"nutrients.oxygen.regime": regime})).summary()
    off = abs(summary["ledger"]["relative_remainder"])
    what = f"oxygen of 300 growing cells, {regime}: ledger, relative"
    compare.deviation(what, "what came in", off, 1e-8)
