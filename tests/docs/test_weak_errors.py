"""Weak errors of observables over seeds: intervals, the log, and the table."""

import argparse
import math

import numpy as np
import pytest
from docs_programs import program
from scipy.stats import ttest_rel

import multicell as mc

weak = program("weak_errors")


def samples(n, ratio, shift=0.0, alike=0.8, seed=0):
    """Return paired normal samples with means 10 + shift and 10."""
    rng = np.random.default_rng(seed)
    exact = rng.normal(size=n)
    other = alike * exact + math.sqrt(1.0 - alike**2) * rng.normal(size=n)
    return 10.0 + shift + ratio * other, 10.0 + exact


def test_the_interval_of_a_mean_is_that_of_a_paired_test():
    found, exact = samples(40, 1.0, 0.3)
    error = weak.weak_error(found, exact)
    low, high = ttest_rel(found, exact).confidence_interval(0.95)
    assert [error.mean - error.half, error.mean + error.half] == pytest.approx(
        [low / exact.mean(), high / exact.mean()]
    )
    assert error.most == pytest.approx(abs(error.mean) + error.half)
    assert error.scatter == pytest.approx(exact.std(ddof=1) / exact.mean())


@pytest.mark.parametrize(("alike", "ratio"), [(0.0, 1.0), (0.8, 1.5), (0.99, 0.7)])
def test_the_interval_of_a_ratio_covers_it_in_95_of_100(alike, ratio):
    errors = [weak.weak_error(*samples(20, ratio, 0.0, alike, k)) for k in range(1500)]
    inside = np.mean([e.low <= ratio <= e.high for e in errors])
    assert inside == pytest.approx(0.95, abs=0.02)
    assert all(e.low < e.spread < e.high for e in errors)


def test_equal_samples_have_no_error():
    exact = samples(10, 1.0)[1]
    error = weak.weak_error(exact, exact)
    assert (error.mean, error.half) == (0.0, 0.0)
    assert [error.low, error.spread, error.high] == pytest.approx([1.0, 1.0, 1.0])


def test_contacts_of_a_row_of_cells():
    row = np.array([[9.0 * k, 0.0, 0.0] for k in range(4)] + [[100.0, 0.0, 0.0]])
    assert weak.contacts(row, np.full(5, 5.0)) == pytest.approx(2.0 * 3 / 5)
    unlike = np.array([5.0, 3.0, 5.0, 5.0, 5.0])  # the second one touches neither neighbour
    assert weak.contacts(row, unlike) == pytest.approx(2.0 * 1 / 5)


def test_observables_are_those_of_the_state():
    scene = mc.load_scene("settle").with_changes({"initial.count": 20})
    simulation = mc.Simulation(scene, threads=1)
    simulation.step()
    found = weak.observables(simulation)
    assert "viable rim" not in found
    assert found["cells"] == 20.0
    volume = 4.0 / 3.0 * math.pi * (simulation.cells.radius**3).sum()
    assert 0.5 < found["radius"] / np.cbrt(volume / (4.0 / 3.0 * math.pi)) < 2.0
    assert found["pressure, rms"] ** 2 == pytest.approx((simulation.cells.pressure**2).mean())
    assert set(found) | {"viable rim"} == set(weak.OBSERVABLES)


def given(folder, seeds, share="1/1"):
    scenes = ["growth, 5 kPa·s"]
    return argparse.Namespace(results=folder, seeds=seeds, scenes=scenes, share=share)


def test_a_log_that_was_cut_continues_with_the_run_it_lacks(tmp_path, monkeypatch):
    asked = []

    def run(scene, candidate, seed):
        asked.append((candidate, seed))
        value = 100.0 + seed + 0.5 * candidate.atol
        values = {name: value for name in weak.OBSERVABLES if name != "viable rim"}
        return {"scene": scene, "candidate": [*candidate], "seed": seed, "values": values,
                "cpu_s": 0.1}  # fmt: skip

    monkeypatch.setattr(weak, "run", run)
    weak.compute(given(tmp_path, 4))
    every = len(weak.CANDIDATES) + 1
    assert len(asked) == 4 * every == len(set(asked))
    path = tmp_path / "weak-errors.1-of-1.log"
    whole = path.read_bytes()
    path.write_bytes(whole[:-20])
    weak.compute(given(tmp_path, 4))
    assert asked[4 * every :] == asked[4 * every - 1 : 4 * every]
    assert path.read_bytes() == whole
    weak.compute(given(tmp_path, 5, "2/2"))  # the fifth seed falls to the first share
    assert len(asked) == 4 * every + 1
    found = weak.errors(weak.stored(tmp_path)[0])
    error = found["growth, 5 kPa·s", weak.Candidate(1.0), "cells"]
    assert error.mean == pytest.approx(
        0.5 * (1.0 - 0.001) / np.mean([100, 101, 102, 103]), rel=1e-3
    )
    lines = {line.split(" | ")[0]: line for line in weak.choices(found).splitlines()}
    assert lines["| cells"].endswith("| 1 µm |")
    assert "viable rim" in lines["| viable rim"]
    assert lines["| viable rim"].endswith("| not resolved |")


def test_a_scene_runs_as_its_candidate_has_it(monkeypatch):
    short = {"initial.count": 5, "duration": "20 min", "output.every": "20 min"}
    monkeypatch.setitem(weak.SCENES, "growth, 5 kPa·s", ("growth", short))
    made = []
    simulation = mc.Simulation

    def watched(scene, **options):
        made.append(scene)
        return simulation(scene, **options)

    monkeypatch.setattr(weak.mc, "Simulation", watched)
    entry = weak.run("growth, 5 kPa·s", weak.Candidate(0.3, 2.0), 7)
    scene = made[0]
    assert (scene.seed, scene.integrator.atol, scene.coupling_step) == (1007, 0.3, 1200.0)
    assert entry["values"]["cells"] == 5.0
    assert entry["candidate"] == [0.3, 2.0]
