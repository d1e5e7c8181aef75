"""The phase diagram's parts: stiffness as asked, ratios and crossings with intervals, restart."""

import argparse
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from formulas import dense_jacobian

DOCS = Path(__file__).parents[2] / "docs"
PLACES = np.array([1e2, 1e3, 1e4, 1e5, 1e6])


@pytest.fixture(scope="module")
def scripts():
    """The modules of the script, which lie beside it."""
    sys.path.insert(0, str(DOCS))
    try:
        import defaults_tables
        import phase_diagram
        import phase_problems
        import phase_race
        import phase_ratios
        import phase_tables
    finally:
        sys.path.remove(str(DOCS))
    return argparse.Namespace(
        diagram=phase_diagram, problems=phase_problems, race=phase_race, tables=phase_tables,
        defaults=defaults_tables, ratios=phase_ratios,
    )  # fmt: skip


@pytest.fixture
def given(scripts, tmp_path, monkeypatch):
    """Options for one small step of one method of each kind, in a folder of its own."""
    monkeypatch.setenv("MULTICELL_CACHE", str(tmp_path / "cache"))
    words = ["--cells", "50", "--stiffness", "100", "--seeds", "1", "--states", "growing",
             "--methods", "rkc2", "cvode", "--results", str(tmp_path)]  # fmt: skip
    return scripts.diagram.parser().parse_args(words)


@pytest.mark.parametrize("state", ["rest", "growing", "divided"])
@pytest.mark.parametrize("stiffness", [1e2, 1e5])
def test_the_stiffness_of_a_step_is_the_one_that_is_asked_for(scripts, tmp_path, state, stiffness):
    """Against all eigenvalues of the Jacobian by differences."""
    step = scripts.problems.problem(state, 50, stiffness, 1, tmp_path)
    system, motion = step.system(), step.steps[0].motion
    system.begin(motion)
    found = np.linalg.eigvals(dense_jacobian(system, step.start)).real
    assert -found.min() * (motion.end - motion.begin) == pytest.approx(stiffness, rel=0.05)


def test_states_differ_in_what_they_should(scripts, tmp_path):
    rest, growing, divided = (
        scripts.problems.problem(state, 50, 1e3, 1, tmp_path) for state in scripts.problems.STATES
    )
    assert not rest.steps[0].motion.radius_rate.any()
    assert (growing.steps[0].motion.radius_rate > 0.0).all()
    assert (len(growing.start), len(divided.start)) == (50, 51)
    np.testing.assert_allclose((divided.radius**3).sum(), (growing.radius**3).sum(), rtol=1e-12)
    # at rest before growth: nothing moves by a tenth of a radius in ten minutes at 5 kPa s
    system = growing.system()
    system.begin(growing.steps[0].motion)
    speed = np.empty_like(growing.start)
    system.velocity(0.0, growing.start, speed)
    at_five = speed * growing.scene.drag.viscosity / 5.0
    assert np.abs(at_five).max() * 600.0 < 0.01


def test_what_is_done_is_not_computed_again(scripts, given, monkeypatch, capsys):
    scripts.diagram.compute(given)
    rows = scripts.diagram.kept(given.results)
    assert {(row["method"], row["accuracy"]) for row in rows} == {
        (name, a) for name in ("rkc2", "cvode") for a in scripts.problems.ACCURACIES
    }
    for row in rows:
        assert row["status"] == scripts.race.REACHED
        assert row[row["judged_by"]] <= row["accuracy"]
        assert row["cost_s"] > 0.0
    raced = []
    race = scripts.race.race

    def noted(step, methods, *rest):
        raced.append([method.name for method in methods])
        return race(step, methods, *rest)

    monkeypatch.setattr(scripts.diagram, "race", noted)
    scripts.diagram.compute(given)
    assert not raced
    given.methods = ["rkc2", "dopri5"]
    scripts.diagram.compute(given)
    assert raced == [["dopri5"]]
    assert {row["method"] for row in scripts.diagram.kept(given.results)} == {
        "rkc2", "cvode", "dopri5",
    }  # fmt: skip


def test_shares_cover_the_grid_once_and_merge_into_one_table(scripts, given):
    given.states, given.cells, given.seeds = scripts.problems.STATES, [50, 100], 3
    whole = scripts.diagram.grid(given)
    parts = []
    for share in ((1, 2), (2, 2)):
        given.share = share
        parts += scripts.diagram.grid(given)
    assert sorted(parts) == sorted(whole)
    given.cells, given.seeds, given.states = [50], 1, ["growing", "divided"]
    for share in ((1, 2), (2, 2)):
        given.share = share
        scripts.diagram.compute(given)
    rows = scripts.diagram.merge(given.results)
    assert {row["state"] for row in rows} == {"growing", "divided"}
    assert [path.name for path in given.results.glob("phase*.csv")] == ["phase-diagram.csv"]
    assert len(scripts.diagram.kept(given.results)) == len(rows)


def test_a_solve_is_stopped_when_its_time_is_over(scripts, tmp_path):
    step = scripts.problems.solved("growing", 50, 1e2, 1, tmp_path)
    problem = step.problem

    class Endless:
        def integrate(self, system, position):
            while True:
                pass

    from multicell.comparison.ladders import Method

    endless = Method("endless", "tolerance", lambda _: Endless())
    end, cost = scripts.race.solve(problem, endless, 1.0, 0.05, foreseen=10.0)
    assert end is None
    assert 0.05 < cost < 0.06


def test_the_crossing_of_a_power_law_is_found(scripts):
    """(z / z0)^0.4 is a straight line in both logarithms: interpolation is exact."""
    crossing = scripts.ratios.crossing
    for known in (3e2, 4.2e4, 9e5):
        assert crossing(PLACES, (PLACES / known) ** 0.4) == pytest.approx(known, rel=1e-12)
    assert crossing(PLACES, np.full(5, 2.0)) == 0.0
    assert crossing(PLACES, np.full(5, 0.5)) == math.inf
    assert math.isnan(crossing(PLACES, np.full(5, np.nan)))
    # what is not known is bridged
    ratio = (PLACES / 4.2e4) ** 0.4
    ratio[2] = np.nan
    assert crossing(PLACES, ratio) == pytest.approx(4.2e4, rel=1e-12)


def test_intervals_of_crossings_cover_the_true_one(scripts):
    """Scatter of the costs in every seed; 40 draws of eight seeds, most cover the truth."""
    rng = np.random.default_rng(3)
    truth = 2e4
    covered = 0
    for _ in range(40):
        ratios = (PLACES / truth) ** 0.4 * np.exp(0.5 * rng.normal(size=(8, 1)))
        found = scripts.ratios.mean_crossing(PLACES, ratios)
        assert found.low <= found.value <= found.high
        covered += found.low <= truth <= found.high
    assert covered >= 32


def test_ratios_are_averaged_in_logarithms(scripts):
    found = scripts.ratios.mean_ratio(np.array([0.5, 2.0, 8.0]))
    assert found.value == pytest.approx(2.0)
    assert 0.5 <= found.low < 2.0 < found.high <= 8.0
    assert scripts.ratios.mean_ratio(np.array([3.0])).high == math.inf
    with pytest.raises(ValueError, match="positive"):
        scripts.ratios.mean_ratio(np.array([1.0, 0.0]))


def seed_rows(explicit, implicit, seed, status=("reached", "reached")):
    common = {"state": "rest", "cells": 100.0, "stiffness": 1e3, "seed": float(seed),
              "accuracy": 0.01, "judged_by": "worst"}  # fmt: skip
    return [
        {**common, "method": "rkc2", "implicit": 0.0, "status": status[0], "cost_s": explicit},
        {**common, "method": "cvode", "implicit": 1.0, "status": status[1], "cost_s": implicit},
        {**common, "method": "auto", "implicit": 0.0, "status": "reached", "cost_s": 1e-9},
    ]


def test_a_tile_compares_the_two_kinds_and_says_what_is_a_bound(scripts):
    rows = [row for seed in (1, 2, 3) for row in seed_rows(1.0, 2.0 + 0.1 * seed, seed)]
    (point,) = scripts.tables.points(rows, 0.01)
    assert point.ratio.value == pytest.approx((2.1 * 2.2 * 2.3) ** (-1 / 3))
    assert (point.verdict, point.best, point.bound) == ("explicit", "rkc2", 0)
    rows = [r for seed in (1, 2, 3) for r in seed_rows(5.0, 1.0, seed, ("too slow", "reached"))]
    (point,) = scripts.tables.points(rows, 0.01)
    assert (point.verdict, point.best, point.bound) == ("implicit", "cvode", 1)
    assert point.ratio.value == pytest.approx(5.0)


def test_the_default_is_the_cheapest_that_changes_nothing_beyond_its_error(scripts):
    rng = np.random.default_rng(0)
    exact = rng.normal(100.0, 5.0, 8)
    made = {("auto", 0.001): (9.0, exact), ("auto", 0.1): (3.0, exact + 0.05 * rng.normal(size=8)),
            ("auto", 1.0): (1.0, exact + 4.0 + 0.1 * rng.normal(size=8))}  # fmt: skip
    rows = [
        {"case": "a", "method": method, "atol_um": atol, "seed": k, "observable": "radius",
         "value": float(value), "cpu_s": cost}
        for (method, atol), (cost, values) in made.items()
        for k, value in enumerate(values)
    ]  # fmt: skip
    (loose,) = scripts.defaults.changes(rows, ("auto", 1.0), ("auto", 0.001))
    assert loose.beyond
    assert loose.mean == pytest.approx(4.0 / exact.std(ddof=1), rel=0.05)
    (tight,) = scripts.defaults.changes(rows, ("auto", 0.1), ("auto", 0.001))
    assert tight.within
    assert scripts.defaults.default(rows, ("auto", 0.001)) == ("auto", 0.1)
