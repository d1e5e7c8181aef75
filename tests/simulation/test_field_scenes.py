"""Scenes in which fields drive the cells that make or bind them: their point holds."""

import numpy as np
import pytest

import multicell as mc


def last_part(column, part=0.25):
    return float(column[int((1.0 - part) * len(column)) :].mean())


# --- sorting by what cells make themselves -----------------------------------------------------

SMALL = {"initial.count": 100, "duration": "8 h", "coupling_step": "10 min"}


def with_controls(seed):
    """Return runs of a small population, with and without what makes it sort."""
    scene = mc.load_scene("sorting-signal").with_changes({**SMALL, "seed": seed})
    silent = scene.with_changes({"nutrients.factor.secretion": 0})
    deaf = scene.with_changes({"responses.sticking.points": [[0.0, 0.0], [1.0, 0.0]]})
    return {name: mc.run(s) for name, s in (("on", scene), ("silent", silent), ("deaf", deaf))}


@pytest.fixture(scope="module")
def signalled():
    return with_controls(3)


@pytest.mark.slow
def test_makers_of_a_factor_sort_and_without_secretion_nothing_does(signalled):
    """In the mean over three populations: how far a single one comes is left to chance."""
    populations = [signalled, with_controls(4), with_controls(5)]
    told = {
        name: [runs[name].history["heterotypic_fraction"] for runs in populations]
        for name in signalled
    }
    mixed = {name: np.mean([last_part(part) for part in parts]) for name, parts in told.items()}
    begun = np.mean([part[0] for part in told["on"]])
    assert mixed["on"] < 0.8 * begun
    for control in ("silent", "deaf"):
        assert mixed[control] > mixed["on"] + 0.1
        assert mixed[control] > 0.85 * begun


@pytest.mark.slow
def test_receptors_are_what_the_factor_around_a_maker_makes_them(signalled):
    run = signalled["on"]
    cells, found = run.frames[-2].cells, run.frames[-2].concentrations["factor"]
    maker = cells.kind == 0
    assert found[maker].mean() > 1.2 * found[~maker].mean()
    factor = np.interp(found[maker], *np.array(run.scene.responses["sticking"].points).T)
    # they follow within a coupling step
    assert np.corrcoef(factor, cells.receptor[maker])[0, 1] > 0.95
    assert not cells.receptor[~maker].any()
    assert not signalled["silent"].frames[-1].cells.receptor.any()
    summary = run.summary()
    assert summary["ledger"]["factor"]["relative_remainder"] < 1e-8
    assert summary["ledger"]["factor"]["secreted"] > 0.0


# --- a drug, dose by dose ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def dosed():
    changes = {"initial.count": 120, "duration": "3.5 d", "coupling_step": "20 min",
               "nutrients.drug.media": [["24 h", "3.2e-3 mM"], ["60 h", "3.7e-3 mM"]]}  # fmt: skip
    scene = mc.load_scene("dosing").with_changes(changes)
    none = scene.with_changes({"nutrients.drug.media": None})
    return {name: mc.run(s) for name, s in (("doses", scene), ("none", none))}


@pytest.mark.slow
def test_each_dose_kills_some_and_the_rest_grows_again(dosed):
    history = dosed["doses"].history
    time, living = history["time"] / 3600.0, history["proliferating"]

    def alive(hour):
        return float(np.interp(hour, time, living))

    for dose in (24.0, 60.0):
        before, after = alive(dose - 1.0), alive(dose + 1.0)
        assert 0.15 * before < after < 0.85 * before, (dose, before, after)
    assert alive(59.0) > 1.5 * alive(33.0)
    assert alive(83.0) > 1.3 * alive(66.0)
    assert dosed["none"].history["proliferating"][-1] > 1.5 * living[-1]
    assert not dosed["none"].history["necrotic"].any()


@pytest.mark.slow
def test_the_rim_dies_and_the_drug_is_accounted_for(dosed):
    run = dosed["doses"]
    frame = next(f for f in run.frames if f.time > 24.0 * 3600.0)
    cells = frame.cells
    away = np.linalg.norm(cells.position - cells.position.mean(axis=0), axis=1)
    dead = cells.state == mc.State.NECROTIC
    assert dead.any()
    assert away[dead].mean() > 1.1 * away[~dead].mean()
    ledger = run.frames[-1].progress.ledger["drug"]
    assert ledger["changes"] == 2
    summary = run.summary()["ledger"]["drug"]
    assert summary["relative_remainder"] < 1e-8
    assert summary["uptake"] > 0.01 * summary["medium_fresh"]
    assert summary["medium_decayed"] > 0.0
