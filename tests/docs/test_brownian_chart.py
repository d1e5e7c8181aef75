"""Weak errors of Brownian motion: samples on one path, orders by regression, and the log."""

import argparse
import math

import numpy as np
import pytest
from docs_programs import program
from scipy.stats import ttest_1samp

import multicell as mc

chart = program("brownian_chart")


def entries(order, n=400, seeds=3, level=0.1):
    """Return entries of a log for a method of an order, and for its reference."""
    random, found = np.random.default_rng(0), {}
    for seed in range(seeds):
        exact = 1.0 + 0.3 * random.normal(size=n)
        found.setdefault(("pairs", chart.REFERENCE), {})[seed] = {"samples": {"a": exact.tolist()}}
        for k in range(chart.HALVINGS):
            ours = exact + level * 2.0 ** (-order * k) * random.normal(1.0, 0.5, n)
            found.setdefault(("pairs", chart.Try("rk4", 2**k)), {})[seed] = {
                "samples": {"a": ours.tolist()}, "evaluations": 4.0 * 2**k, "passes": 9.0 * 2**k,
                "cpu_us": 1.0 + k,
            }  # fmt: skip
    return found


@pytest.mark.parametrize("exact", [1, 2])
def test_orders_are_found_by_regression(exact):
    slope, low, high, number = chart.order(entries(exact), "pairs", "rk4", "a")
    assert (number, slope) == (chart.HALVINGS, pytest.approx(exact, abs=0.05))
    assert low < slope < high < low + 0.2


def test_errors_that_are_not_resolved_have_no_order():
    assert chart.order(entries(1, level=1e-5), "pairs", "rk4", "a") is not None
    noise = entries(1)
    for (_, one), by_seed in noise.items():
        for entry in by_seed.values() if one != chart.REFERENCE else ():
            shift = np.mean(entry["samples"]["a"]) - 1.0
            entry["samples"]["a"] = (np.array(entry["samples"]["a"]) - shift).tolist()
    level = {seed: e["samples"]["a"] for seed, e in noise["pairs", chart.REFERENCE].items()}
    for values in level.values():
        values[:] = (np.array(values) - np.mean(values) + 1.0).tolist()
    assert chart.order(noise, "pairs", "rk4", "a") is None


def test_intervals_are_those_of_a_paired_test():
    found = chart.data(entries(1)).iloc[0]
    ours, exact = chart.paired(entries(1), "pairs", chart.Try("rk4", 1), "a")
    assert found["samples"] == len(ours) == 1200
    low, high = ttest_1samp((ours - exact) / exact.mean(), 0.0).confidence_interval(0.95)
    assert [found["error"] - found["half"], found["error"] + found["half"]] == pytest.approx(
        [low, high]
    )
    assert (found["evaluations"], found["passes"]) == (4.0, 9.0)


def test_a_try_that_failed_in_one_run_has_no_error():
    """Those runs that do not fail are the ones without large moves."""
    given = entries(1)
    given["pairs", chart.Try("rk4", 1)][1] = {"failed": "a step would move the cell too far"}
    assert list(chart.data(given)["parts"]) == [2, 4, 8]


def test_closed_forms():
    spring, pairs = chart.spring(), chart.pairs()
    kappa = 1.0 / spring.relaxation
    assert spring.exact == pytest.approx(spring.scene.motility.diffusion / kappa)
    energy = pairs.scene.motility.diffusion * chart.DRAG
    # of a stiff spring half of kT for its one direction, and a little for the others
    assert pairs.exact == pytest.approx(energy / chart.STIFFNESS, rel=0.03)
    assert pairs.exact != pytest.approx(energy / chart.STIFFNESS, rel=1e-3)


@pytest.mark.kernels
def test_euler_on_springs_has_the_variance_of_its_recursion(monkeypatch):
    """D / κ / (1 - κh / 2), and shorter steps follow the same path."""
    monkeypatch.setattr(chart, "MEASURED", 30)
    problem = chart.spring()
    entry = chart.run(problem, chart.Try("euler", 1), 0)
    values = np.array(entry["samples"]["variance"])
    exact = problem.exact / (1.0 - 0.4)
    error = values.std(ddof=1) / math.sqrt(len(values))
    assert values.mean() == pytest.approx(exact, abs=3.5 * error)
    assert error < 0.03 * exact
    # one evaluation in each internal step, which is 0.8 relaxation times long
    assert entry["evaluations"] == pytest.approx(1.0 / 0.8, rel=1e-6)
    finer = chart.run(problem, chart.Try("heun", 4), 0)
    assert np.corrcoef(values, finer["samples"]["variance"])[0, 1] > 0.5


def test_a_scene_is_solved_with_the_steps_of_its_try():
    problem = chart.tissue()
    one = chart.described(problem, chart.Try("rk4", 4), 5)
    assert one.seed == 105
    assert one.motility.diffusion_step == pytest.approx(problem.longest / 4, rel=0.01)
    assert problem.longest / 4 < one.integrator.step < 1.02 * problem.longest / 4
    other = chart.described(problem, chart.Try("cvode", 4), 5)
    assert other.integrator.step == mc.Scene.from_dict({"duration": "1 h"}).integrator.step


def test_a_scene_of_the_users_own(tmp_path):
    with pytest.raises(SystemExit, match=r"motility\.diffusion is missing"):
        chart.own("growth")
    scene = mc.load_scene("settle").with_changes({"motility.diffusion": 0.001})
    (tmp_path / "own.toml").write_text(scene.to_toml())
    problem = chart.own(str(tmp_path / "own.toml"))
    assert problem.scene == scene
    assert 0.0 < problem.longest <= scene.coupling_step


def test_a_log_that_was_cut_continues_with_the_run_it_lacks(tmp_path, monkeypatch):
    asked = []

    def run(problem, one, seed):
        asked.append((one, seed))
        values = [1.0 + 0.1 * seed + 0.5 / one.parts, 1.1 + 0.2 * seed + 0.5 / one.parts]
        return {"samples": {"a": values}, "evaluations": 1.0, "passes": 8.0, "cpu_us": 1.0}

    monkeypatch.setattr(chart, "run", run)
    given = argparse.Namespace(results=tmp_path, seeds=2, problems=["pairs"])
    chart.compute(given)
    every = len(chart.TRIES) + 1
    assert len(asked) == 2 * every == len(set(asked))
    path = tmp_path / "brownian.log"
    whole = path.read_bytes()
    path.write_bytes(whole[:-20])
    chart.compute(given)
    assert asked[2 * every :] == asked[2 * every - 1 : 2 * every]
    assert path.read_bytes() == whole
    table = chart.data(chart.stored(tmp_path))
    assert len(table) == len(chart.TRIES)
    assert (table["error"] > 0.0).all()
    picture = chart.drawn(table)
    assert len(picture.axes) == 2
    assert [text.get_text() for text in picture.legends[0].texts] == list(chart.SHOWN)


def test_the_page_has_what_its_data_have():
    """Errors of the table are those of the committed data."""
    import pandas as pd

    data = pd.read_csv(chart.DATA)
    block = chart.PAGE.read_text("utf-8").partition(f"<!-- {chart.NAME}: made by")[2]
    for method in chart.SHOWN:
        (line,) = [line for line in block.splitlines() if line.startswith(f"| `{method}` |")]
        at = data[(data["method"] == method) & (data["parts"] == 2)].groupby("problem").first()
        for cell, problem in zip(line.split(" | ")[1:4], chart.TITLES, strict=True):
            assert f"{100 * at.loc[problem, 'error']:+.2g} ±" in cell
