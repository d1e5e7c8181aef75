"""Fits that search coarsely and are corrected by fine runs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

import multicell as mc
from multicell.calibration.coarse_to_fine import BESIDE, PAIRS
from multicell.calibration.fit import plan_of
from multicell.calibration.likelihood import CHECKS
from multicell.calibration.simulator import Reading

SCENE = mc.load_scene("growth").with_changes(
    {"duration": "60 h", "initial.count": 64, "coupling_step": "1 h", "initial.stage": "uniform"}
)
FREE = {"growth.cycle_time": "10:30 h", "cells.division_radius": "4:8 um"}
TIMES = np.array([12.0, 24.0, 36.0, 48.0, 60.0])
TRUTH = (0.35, 0.55)
FINE, COARSE = [], []
"""Keys of the calls in this process."""


@dataclass(frozen=True)
class Toy:
    """Diameters and a core that grow with two parameters; coarse ones are off by a twentieth."""

    coarse: float = 1.0
    noise: float = 1.5

    @property
    def stated(self):
        return {} if self.coarse == 1.0 else {"coarse": self.coarse}

    def made_coarse(self, factor):
        return replace(self, coarse=factor)

    def mean(self, shares):
        size = 100.0 * np.exp((0.005 + 0.02 * shares[0]) * TIMES)
        core = np.maximum(size - 90.0 - 60.0 * shares[1], 0.0)
        found = np.stack([size, core], axis=1).ravel()  # row by row, as the data
        bias = 1.0 + 0.05 * (self.coarse > 1.0) * (1.0 + 0.2 * shares[0])
        return bias * found

    def __call__(self, shares, condition, seed):
        (FINE if self.coarse == 1.0 else COARSE).append((tuple(shares), condition, seed))
        mean = self.mean(shares)
        random = np.random.default_rng((seed, int(self.coarse), int(1e9 * shares[0])))
        scatter = self.noise * self.coarse * random.standard_normal(len(mean))
        return Reading(tuple(map(float, np.maximum(mean + (mean > 0.0) * scatter, 0.0))))


def data(seed):
    rng = np.random.default_rng(seed)
    values = np.maximum(Toy().mean(TRUTH) + 2.5 * rng.standard_normal(10), 0.0)
    return {
        "time / h": TIMES, "diameter / um": values[::2], "diameter sd / um": np.full(5, 2.0),
        "necrotic_radius / um": values[1::2], "necrotic_radius sd / um": np.full(5, 2.0),
    }  # fmt: skip


def asked(seed=0, **options):
    FINE.clear()
    COARSE.clear()
    return mc.fit(SCENE, data(seed), FREE, coarse=2, simulator=Toy(), cores=1, **options)


def truth():
    cycle, radius = plan_of(SCENE, data(0), FREE).problem.ranges
    return {"cycle_time": cycle.value(TRUTH[0]), "division_radius": radius.value(TRUTH[1])}


@pytest.fixture(scope="module")
def corrected(tmp_path_factory):
    """Return a fit, its folder, and the fine and the coarse runs that were made."""
    folder = tmp_path_factory.mktemp("fit")
    found = asked(output=folder, budget=110)
    return found, folder, list(FINE), list(COARSE)


def test_coarse_runs_are_corrected_by_fine_ones(corrected):
    found = corrected[0]
    for name, value in truth().items():
        interval = found.intervals(0.99)[name]
        assert interval.low < value < interval.high
    alone = mc.fit(SCENE, data(0), FREE, simulator=Toy(coarse=2), cores=1, budget=110)
    biased = alone.intervals(0.99)["cycle_time"]
    assert biased.high < truth()["cycle_time"]
    ratios = found.facts["coarse"]["ratios"][0]
    wanted = 1.0 / (1.05 + 0.01 * TRUTH[0])
    assert ratios[::2] == pytest.approx([wanted] * 5, rel=0.02)


def test_runs_are_counted(corrected):
    found, folder, fine, coarse = corrected
    account = found.facts["coarse"]
    assert account["runs"] == {"coarse": len(coarse), "fine": len(fine)}
    assert len(fine) == PAIRS + 12 + CHECKS
    assert len(set(fine)) == len(fine)
    assert len(set(coarse)) == len(coarse)
    assert sum(key[2] > max(found.problem.seeds) + 1000 for key in coarse) >= PAIRS * BESIDE
    assert account["fine_runs_alone"] == plan_of(SCENE, data(0), FREE, budget=110).runs
    assert account["saved"] == pytest.approx(
        1.0 - account["seconds"] / account["fine_seconds_alone"]
    )
    assert any("coarse runs" in note for note in found.notes)
    assert (folder / "fine" / "report.html").is_file()
    stored = mc.load_fit(folder / "fine")
    assert stored.best.values == found.best.values
    assert stored.facts["coarse"] == account
    # nothing is run twice
    again = asked(output=folder, budget=110)
    assert not FINE
    assert not COARSE
    assert again.best.values == found.best.values


@pytest.mark.harness
def test_intervals_cover_although_coarse_runs_are_off(request):
    count, inside = request.config.getoption("--calibrations"), 0
    if count == 0:
        pytest.skip("asked for with --calibrations N")
    for seed in range(1, count + 1):
        interval = asked(seed, budget=110).intervals(0.95)["cycle_time"]
        inside += interval.low < truth()["cycle_time"] < interval.high
    assert inside >= 0.8 * count


def test_runs_of_scenes_are_made_coarse():
    plan = plan_of(SCENE, {"time / h": [24.0], "cells": [150.0]}, FREE, coarse=2)
    simulator = plan.problem.simulator
    fine = [simulator((0.3, 0.5), 0, seed).values[0] for seed in range(2)]
    coarse = [simulator.made_coarse(2)((0.3, 0.5), 0, seed).values[0] for seed in range(6)]
    assert np.mean(coarse) == pytest.approx(np.mean(fine), rel=0.15)
    assert all(value % 8 == 0 for value in np.round(coarse, 6))


def test_expected_cost_is_that_of_coarse_runs():
    many, counts = (
        SCENE.with_changes({"initial.count": 20000}),
        {"time / h": [40.0], "cells": [4e4]},
    )
    (runs, seconds), (fewer, alone) = (
        plan_of(many, counts, FREE, coarse=factor).left(None) for factor in (3.0, 1.0)
    )
    assert runs > fewer
    assert seconds < 0.5 * alone


@pytest.mark.parametrize(
    ("changes", "path", "said"),
    [
        ({"budget": "1 h"}, "coarse", "budget in runs"),
        ({"simulator": lambda *_: None}, "coarse", "simulator of one's own"),
        ({"coarse": 0.5}, "factor", "from 1 to 10"),
        ({"coarse": 9}, "initial.count", "cannot stand for"),
    ],
)
def test_what_no_coarse_fit_can_do_is_refused(changes, path, said):
    with pytest.raises(mc.SceneError, match=said) as error:
        plan_of(SCENE, data(0), FREE, **{"coarse": 2, **changes})
    assert error.value.path == path
