"""Fits of scenes: readings of runs, what is recovered, folders, bad input, the command."""

from __future__ import annotations

import importlib.util
import json
import math
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cheap_fits import MATRIX, calls_of, fitted, linear, stopping
from click.testing import CliRunner

import multicell as mc
from multicell.calibration.fitting.fit import plan_fit
from multicell.calibration.fitting.likelihood import _check, scatter_of
from multicell.calibration.fitting.pool import Pool
from multicell.calibration.fitting.problem import free_of
from multicell.calibration.fitting.search import Search
from multicell.calibration.fitting.simulator import SceneSimulator, reading
from multicell.calibration.fitting.verdict import intervals, undetermined
from multicell.cli.main import main
from multicell.errors import ClusterError, FitFailed
from multicell.measured.data import Datum, read_data

SMALL = mc.load_scene("growth").with_changes(
    {"duration": "20 h", "initial.count": 6, "coupling_step": "1 h"}
)
FREE = {"growth.cycle_time": "8:30 h"}


def datum(observable="diameter", time=None, value=1.0):
    return Datum(observable, value, 1.0, False, False, time, 0, "row 0")


HISTORY = {
    "time": np.array([0.0, 10.0, 20.0, 30.0]),
    "diameter": np.array([100.0, 200.0, 400.0, 500.0]),
    "necrotic_radius": np.array([0.0, 0.0, 50.0, 100.0]),
    "viable_rim": np.array([np.nan, np.nan, 150.0, 150.0]),
}


@pytest.mark.parametrize(
    ("asked", "expected"),
    [
        (datum(time=0.0), 100.0),
        (datum(time=15.0), 300.0),
        (datum(time=30.0), 500.0),
        (datum(time=30.0000000001), 500.0),
        (datum(), 500.0),
        (datum(time=31.0), math.nan),
        (datum("viable_rim", time=10.0), 100.0),
        (datum("viable_rim", time=15.0), 125.0),
        (datum("viable_rim", time=0.0), 50.0),
        (datum("viable_rim"), 150.0),
    ],
)
def test_runs_are_read_where_the_data_ask(asked, expected):
    assert reading(HISTORY, asked) == pytest.approx(expected, nan_ok=True)


def test_a_run_that_was_ended_by_outgrowing_its_data_has_its_last_values():
    assert reading(HISTORY, datum(time=50.0), outgrown=True) == 500.0


def simulated(data, changes=None, **free):
    scene = SMALL.with_changes(changes or {})
    measured = read_data(data, scene)
    ranges, _ = free_of(free or FREE, measured)
    return SceneSimulator.of(measured, ranges)


def test_a_reading_is_what_a_run_of_the_scene_has():
    data = {"time / h": [5, 20, None], "cells": [6, 9, 9], "divisions": [None, None, 3]}
    simulator = simulated(data)
    share = simulator.ranges[0].share(12 * 3600.0)
    found = simulator((share,), 0, 3).values
    changes = {"growth.cycle_time": "12 h", "seed": 3}
    result = mc.run(SMALL.with_changes(changes), threads=1)
    cells = np.interp([5 * 3600.0, 20 * 3600.0], result.history["time"], result.history["cells"])
    assert found == (*cells, cells[-1], float(result.summary()["divisions"]))


def test_a_run_that_outgrows_its_data_ends_early(monkeypatch):
    steps = []
    step = mc.Simulation.step
    monkeypatch.setattr(mc.Simulation, "step", lambda self: (steps.append(1), step(self))[1])
    simulator = simulated({"time / h": [1, 20], "cells": [2, 2], "cells sd": [1, 1]})
    values = simulator((0.0,), 0, 1).values
    assert len(steps) < 20
    assert values[-1] > 6.0


def test_a_run_that_fails_is_a_reading_with_its_reason():
    data = {"time / h": [5], "cells": [6]}
    simulator = simulated(data, **{"growth.cycle_variation": "0.1:0.5"})
    (scene,) = simulator.scenes
    wrong = replace(scene, values={**scene.values, "coupling_step": -1.0})
    found = replace(simulator, scenes=(wrong,))((0.5,), 0, 1)
    assert math.isnan(found.values[0])
    assert "coupling_step" in found.reason


@pytest.fixture(scope="module")
def example(tmp_path_factory):
    file = Path(__file__).parents[2] / "examples" / "fit_growth.py"
    spec = importlib.util.spec_from_file_location("example_fit_growth", file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    folder = tmp_path_factory.mktemp("example")
    return module, folder, module.main(folder, budget=60)


@pytest.mark.slow
def test_the_fit_recovers_what_made_the_data_within_its_intervals(example):
    module, _, found = example
    known = found.intervals()
    for free in found.problem.ranges:
        assert module.TRUTH[free.key] in known[free.name]
        assert known[free.name].part < 0.4
    assert 0.1 < found.best.per_datum < 2.5
    assert found.undetermined == []


@pytest.mark.slow
def test_the_folder_holds_all_and_the_same_fit_runs_nothing_again(example, monkeypatch):
    module, folder, found = example
    monkeypatch.setattr(SceneSimulator, "__call__", None)
    again = module.main(folder, budget=60)
    assert again.best.values == found.best.values
    assert again.summary()["residuals"] == found.summary()["residuals"]
    result = json.loads((folder / "result.json").read_text())
    assert result["parameters"]["growth.cycle_time"]["unit"] == "s"
    assert mc.load_scene(folder / "best.toml") == found.best.scene
    page = (folder / "report.html").read_text()
    for words in ("growth.cycle_time", "What the data do not determine", "diameter", "χ²"):
        assert words in page
    for name in ("data.png", "parameters.png"):
        assert (folder / name).read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    titles = (folder / "posterior.csv").read_text().splitlines()[0]
    assert titles == "cycle_time / s,division_radius / um,weight"


@pytest.mark.slow
def test_a_folder_of_another_fit_is_refused(example):
    module, folder, _ = example
    changed = module.setup().with_changes({"seed": 77})
    with pytest.raises(mc.OutputError, match="holds another fit: scene, seeds differ"):
        mc.fit(changed, module.DATA, module.FREE, output=folder, cores=1)


UNDETERMINED = {
    "a parameter without effect": (
        linear([[1.0, 0.0]] * 3, [0.5] * 3, 0.05),
        [("p1", "open", "p1 is not determined: its 95 % interval")],
    ),
    "a parameter that scatter hides": (
        linear([[1.0]], [0.5], 0.02, noise=0.6, seeds=2), [("p0", "open", "")],
    ),
    "a sum": (
        linear([[1.0, 1.0]] * 3, [1.0] * 3, 0.01),
        [("p0", "open", ""), ("p1", "open", ""), ("p0p1", "ridge", "make up for each other")],
    ),
    "data beyond a range": (
        linear([[1.0, 0.0], [0.0, 1.0]], [1.5, 0.5], 0.02), [("p0", "edge", "upper end")],
    ),
    "determined parameters": (linear(MATRIX, [0.4, 0.6, 1.0, -0.2], 0.02), []),
}  # fmt: skip


@pytest.mark.parametrize("case", UNDETERMINED)
def test_what_data_do_not_determine_is_said(case):
    problem, expected = UNDETERMINED[case]
    found = fitted(problem).undetermined
    assert [("".join(e.names), e.kind) for e in found] == [entry[:2] for entry in expected]
    assert all(words in str(e) for e, (*_, words) in zip(found, expected, strict=True))


def test_the_best_point_is_run_again_with_seeds_that_had_no_part_in_finding_it():
    problem = linear(MATRIX, [0.4, 0.6, 1.0, -0.2], 0.05, noise=0.05, seeds=2)
    found, calls = calls_of(lambda: fitted(problem, 20))
    by_point = {}
    for shares, _, seed in calls:
        by_point.setdefault(shares, set()).add(seed)
    best = tuple(found.best.values[key] for key in ("toy.p0", "toy.p1"))
    assert by_point[best] == set(range(2, 14))
    runs = np.array([problem.simulator(best, 0, seed).values for seed in range(2, 14)])
    np.testing.assert_allclose(found.best.readings, runs.mean(axis=0), rtol=1e-12)


def test_fresh_runs_that_were_stopped_go_on_with_what_is_there(tmp_path):
    problem = linear(MATRIX, [0.4, 0.6, 1.0, -0.2], 0.05, noise=0.05, seeds=2)
    points = [([0.4, 0.5], seed) for seed in range(10, 16)]
    path = tmp_path / "search.log"
    _, first = calls_of(lambda: Search(problem, path).extra(stopping(4), points))
    (runs, reasons), second = calls_of(lambda: Search(problem, path).extra(Pool(), points))
    assert (len(first), len(second), reasons) == (4, 2, [])
    expected = [problem.simulator(shares, 0, seed).values for shares, seed in points]
    np.testing.assert_array_equal(runs, expected)


def test_equal_runs_are_made_once():
    problem = linear([[1.0]], [0.5], 0.02, noise=0.1, seeds=2)
    points = [([0.4], 10), ([0.4], 11), ([0.4], 10)]
    (runs, _), calls = calls_of(lambda: Search(problem, None).extra(Pool(), points))
    assert [seed for *_, seed in calls] == [10, 11]
    assert runs[0] == runs[2] != runs[1]


def test_checks_widen_the_error_where_the_emulator_is_off_and_nowhere_else():
    scatter = scatter_of(np.random.default_rng(1).normal(0.0, 1.0, (12, 2)))
    away = np.array([[0.5, 9.0], [-1.0, -8.0], [0.8, 9.5], [0.1, 7.0], [-0.4, -9.0], [1.2, 8.0]])
    checks, error = _check(away, np.full((6, 2), 0.25), scatter)
    assert checks.off.tolist() == [False, True]
    explained = scatter.variance[1] * (1.0 + 1.0 / 12.0) + 0.25
    assert error.tolist() == [0.0, pytest.approx((away[:, 1] ** 2).mean() - explained)]


def test_intervals_are_those_of_the_draws():
    problem = linear([[1.0]], [0.5], 0.1)
    draws = np.linspace(0.0, 1.0, 1001)[:, None]
    found = intervals(problem.ranges, draws)["p0"]
    assert (found.low, found.median, found.high) == pytest.approx((0.025, 0.5, 0.975), abs=1e-3)
    assert undetermined(problem.ranges, draws)[0].kind == "open"


DATA = {"time / h": [10, 20], "cells": [7, 9]}
REFUSED = [
    ({"free": {}}, "free: names no parameter"),
    ({"seeds": 0}, "seeds: is 0, must be a whole number from 1 to"),
    ({"budget": 23}, "budget: is 23 runs: what 18 fresh runs leave tries 2 sets of parameters, 2"),
    ({"repeats": 3}, "repeats: is 3, must be a whole number from 4 to 1,000"),
    ({"specimens": "other"}, "specimens"),
    ({"data": {**DATA, "growth.cycle_time / h": [10, 12]}}, "is a condition of the data"),
]


@pytest.mark.parametrize(("wrong", "words"), REFUSED)
def test_bad_input_is_named_before_anything_runs(wrong, words, monkeypatch):
    monkeypatch.setattr(SceneSimulator, "__call__", None)
    arguments = {"scene": SMALL, "data": DATA, "free": FREE, **wrong}
    with pytest.raises(mc.SceneError) as caught:
        mc.fit(**arguments, cores=1)
    assert words in str(caught.value)


def test_a_scheduler_that_does_not_answer_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(SceneSimulator, "__call__", None)
    with pytest.raises(ClusterError, match=r"tcp://127\.0\.0\.1:9' does not answer"):
        mc.fit(SMALL, DATA, FREE, scheduler="tcp://127.0.0.1:9", output=tmp_path / "out")


def test_budgets_are_shared_out():
    assert plan_fit(SMALL, DATA, FREE, budget=41 + 12 + 6).points == 20
    assert plan_fit(SMALL, DATA, FREE, budget=41 + 8 + 6, repeats=8).points == 20
    assert plan_fit(SMALL, DATA, FREE).left(None)[1] > 0.0


def test_too_few_points_tell_a_best_one_and_no_intervals():
    found = fitted(linear(MATRIX, [0.4, 0.6, 1.0, -0.2], 0.02), points=3)
    assert found.undetermined == []
    assert "There are no intervals: too few points were tried." in found.notes
    with pytest.raises(FitFailed, match="too few points"):
        _ = found.posterior
    assert found.summary()["parameters"]["toy.p0"]["interval"] is None


@pytest.mark.slow
def test_the_command_fits_and_says_what_is_open(tmp_path):
    (tmp_path / "growth.csv").write_text("time / h, cells\n10, 7\n20, 9\n")
    arguments = [
        "fit", "growth", "--data", str(tmp_path / "growth.csv"), "--free",
        "growth.cycle_time=8:30 h", "--set", "duration=20 h", "--set", "initial.count=6", "--set",
        "coupling_step=1 h", "--budget", "34", "--repeats", "8", "--seeds", "1", "--cores",
        "1", "-o", str(tmp_path / "out"),
    ]  # fmt: skip
    shown = CliRunner().invoke(main, arguments, standalone_mode=False)
    assert shown.exception is None
    assert "growth.cycle_time" in shown.stdout
    assert "fresh runs: 6 of 6" in shown.stderr
    assert "34 runs left, expected to take" in shown.stderr
    finished = CliRunner().invoke(main, arguments, standalone_mode=False)
    assert finished.stderr == ""
    again = CliRunner().invoke(main, [*arguments, "--json"], standalone_mode=False)
    document = json.loads(again.stdout)
    assert document["data"] == 2
    assert "without a standard deviation" in document["notes"][0]
    assert document["chi_squared"] >= 0.0


@pytest.mark.slow
def test_a_command_that_is_killed_goes_on_to_the_same_bits(forks, tmp_path):
    """Killed (-9) twice while it runs: no run is made twice, and the result is the same."""
    (tmp_path / "growth.csv").write_text("time / h, cells\n10, 7\n20, 9\n")

    def command(folder):
        return [
            "fit", "growth", "--data", str(tmp_path / "growth.csv"), "--free",
            "growth.cycle_time=8:30 h", "--set", "duration=20 h", "--set", "initial.count=6",
            "--set", "coupling_step=1 h", "--budget", "42", "--seeds", "1", "--cores", "1",
            "--quiet", "-o", str(tmp_path / folder),
        ]  # fmt: skip

    forks.load(arguments=command("whole"))
    for calls in (2, 17):
        task = {"arguments": command("killed"), "calls": calls}
        done = forks.ask(function="cheap_fits:killed", **{"with": task})
        assert done["code"] == -signal.SIGKILL, done["text"]
    done = forks.multicell(*command("killed"))
    assert done["code"] == 0, done["text"]
    for name in ("best.toml", "posterior.csv", "residuals.csv"):
        assert (tmp_path / "killed" / name).read_text() == (tmp_path / "whole" / name).read_text()
    logs = [(tmp_path / name / "search.log").read_text() for name in ("killed", "whole")]
    assert [log.count('"reason"') for log in logs] == [42, 42]
