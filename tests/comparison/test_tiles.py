"""The diagram of docs/programs/tiles.py: recorded steps, races, tiles over seeds, restarts."""

import argparse
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from formulas import dense_jacobian

from multicell.comparison.ladders import Method, find_method
from multicell.comparison.replay import replay

PROGRAMS = Path(__file__).parents[2] / "docs" / "programs"


@pytest.fixture(scope="module")
def scripts():
    """The modules of the scripts, which lie beside each other."""
    sys.path.insert(0, str(PROGRAMS))
    try:
        import defaults_tables
        import tile_problems
        import tile_race
        import tile_tables
        import tile_threads
        import tiles
    finally:
        sys.path.remove(str(PROGRAMS))
    return argparse.Namespace(
        tiles=tiles, problems=tile_problems, race=tile_race, tables=tile_tables,
        threads=tile_threads, defaults=defaults_tables,
    )  # fmt: skip


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """A folder of recorded steps that the tests share."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture
def given(scripts, tmp_path, cache):
    """Options for one small step of one method of each kind, in a folder of its own."""
    words = ["--cells", "50", "--stiffness", "100", "--seeds", "1", "--states", "typical",
             "--methods", "rkc2", "cvode", "--results", str(tmp_path),
             "--cache", str(cache)]  # fmt: skip
    return scripts.tiles.parser().parse_args(words)


@pytest.mark.parametrize(("state", "stiffness"), [("typical", 1e2), ("fresh", 1e4)])
def test_the_stiffness_of_a_step_is_near_the_one_that_is_asked_for(
    scripts, cache, state, stiffness
):
    """Against all eigenvalues of the Jacobian by differences."""
    tile = scripts.problems.Tile(state, 50, stiffness, 1)
    problem, facts = scripts.problems.recorded(tile, cache)
    system, motion = problem.system(), problem.steps[0].motion
    system.begin(motion)
    found = np.linalg.eigvals(dense_jacobian(system, problem.start)).real
    exact = -found.min() * (motion.end - motion.begin)
    assert facts["lambda_dt"] == pytest.approx(exact, rel=0.05)
    # the viscosity changes a few steps before, in which cells divide
    assert exact == pytest.approx(stiffness, rel=0.5)


def test_states_differ_in_how_many_cells_have_just_divided(scripts, cache):
    tiles = [scripts.problems.Tile(state, 50, 1e2, 1) for state in scripts.problems.STATES]
    divided = [scripts.problems.recorded(tile, cache)[1]["divided"] for tile in tiles]
    assert divided[0] == 0.0
    assert divided[0] <= divided[1] < divided[2]


def test_errors_of_a_reference_are_known_and_null_methods_miss_what_divisions_ask_for(
    scripts, cache
):
    step = scripts.problems.solved(scripts.problems.Tile("fresh", 50, 1e2, 1), cache)
    assert step.uncertainty < 0.2 * min(scripts.problems.GOALS)
    standing = step.errors(step.problem.start)
    assert standing[0] > 0.5
    assert step.errors(step.end) == (0.0, 0.0)


def test_what_is_done_is_not_computed_again(scripts, given, monkeypatch):
    scripts.tiles.compute(given)
    rows = scripts.tiles.kept(given.results, "tile-costs")
    found = {(row["method"], row["goal"]) for row in rows}
    goals = (*scripts.problems.GOALS, scripts.race.DEFAULT)
    assert {(name, goal) for name in ("rkc2", "cvode") for goal in goals} <= found
    for row in rows:
        if row["status"] == scripts.race.REACHED and row["goal"]:
            assert row["error"] <= row["goal"]
    raced = []
    monkeypatch.setattr(scripts.tiles, "race", lambda *_: raced.append(1))
    scripts.tiles.compute(given)
    assert not raced


def test_a_method_that_has_changed_is_renewed(scripts, given):
    scripts.tiles.compute(given)
    before = scripts.tiles.kept(given.results, "tile-costs")
    given.renew = ["cvode"]
    scripts.tiles.renew(given)
    after = scripts.tiles.kept(given.results, "tile-costs")
    # as text: NaN is no number that equals itself
    others = [[str(r) for r in rows if r["method"] != "cvode"] for rows in (before, after)]
    assert others[0] == others[1]
    assert len(after) == len(before) > len(others[0])
    assert after[-1]["method"] == "cvode"


@pytest.mark.parametrize("seed", [2, 4])
def test_auto_follows_what_moves_in_quiet_stiff_tissue(scripts, cache, seed):
    """A method of large steps may step over it: cvode was off by more than ten times the motion."""
    step = scripts.problems.solved(scripts.problems.Tile("quiet", 100, 1e6, seed), cache)
    radius = step.problem.mean_radius
    auto = find_method("auto", step.problem.scene, radius)
    end = replay(step.problem, auto.make(auto.info.atol / radius)).positions[0]
    assert max(step.errors(end)) < 0.15


def test_a_solve_is_stopped_when_its_time_is_over(scripts, cache):
    step = scripts.problems.solved(scripts.problems.Tile("typical", 50, 1e2, 1), cache)

    class Endless:
        def integrate(self, system, position):
            while True:
                pass

    endless = Method("endless", "tolerance", lambda _: Endless())
    end, cost, _ = scripts.race.solve(step, endless, 1.0, 0.05, foreseen=10.0)
    assert end is None
    assert 0.05 < cost < 0.2


def seed_rows(explicit, implicit, seed, status=("reached", "reached"), null=1.0):
    common = {"state": "typical", "cells": 100.0, "stiffness": 1e3, "seed": float(seed),
              "goal": 0.1, "error": 0.05}  # fmt: skip
    known = {"status": "reached", "cost": 1e-9, "implicit": 0.0}
    return [
        {**common, "method": "rkc2", "implicit": 0.0, "status": status[0], "cost": explicit},
        {**common, "method": "cvode", "implicit": 1.0, "status": status[1], "cost": implicit},
        {**common, **known, "method": "auto", "cost": 1.5 * min(explicit, implicit)},
        {**common, **known, "method": "stand-still", "error": null},
    ]


def a_point(scripts, costs, **options):
    """Return the tile of three seeds with these costs."""
    rows = [row for seed in (1, 2, 3) for row in seed_rows(*costs(seed), seed, **options)]
    keys = ("state", "cells", "stiffness", "seed")
    tiles = [
        {**dict(zip(keys, ("typical", 100.0, 1e3, float(seed)), strict=True)),
         "best_dilation": 1.0, "conditioning_0.1": 0.1}
        for seed in (1, 2, 3)
    ]  # fmt: skip
    (point,) = scripts.tables.points(tiles, rows, 0.1)
    return point


def test_a_tile_compares_the_two_kinds_and_says_what_is_a_bound(scripts):
    point = a_point(scripts, lambda seed: (1.0, 2.0 + 0.1 * seed))
    assert point.ratio == pytest.approx((2.1 * 2.2 * 2.3) ** (-1 / 3))
    assert (point.best, point.bound, point.sure, point.nullity) == ("rkc2", 0, True, False)
    assert point.auto == pytest.approx(1.5)
    point = a_point(scripts, lambda _: (5.0, 1.0), status=("too slow", "reached"))
    assert (point.best, point.bound) == ("cvode", 1)
    assert point.ratio == pytest.approx(5.0)
    assert point.lead == "≥ 5×"
    # costs that scatter more than they differ decide nothing
    assert not a_point(scripts, lambda seed: (1.0, 4.0 ** (seed - 1.9))).sure


def test_a_tile_that_a_null_method_solves_names_no_method(scripts):
    point = a_point(scripts, lambda _: (1.0, 2.0), null=0.09)
    assert point.nullity
    assert math.isclose(point.null, 0.09)


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


def known_cost(method, implicit, cells, cost, setting, **more):
    """Return a row of the costs of a tile."""
    row = {"state": "typical", "stiffness": 1e3, "seed": 1.0, "goal": 0.01, "status": "reached"}
    about = {"method": method, "implicit": implicit, "cells": cells, "cost": cost}
    return row | about | {"setting": setting} | more


def test_threads_take_the_best_of_each_kind_at_the_tolerance_that_reached_the_goal(scripts):
    rows = [
        known_cost("rkc2", 0, 1e4, 3.0, 0.01),
        known_cost("ab2-adaptive", 0, 1e4, 1.0, 0.03),
        known_cost("dopri5", 0, 1e3, 0.1, 0.3),
        known_cost("auto", 0, 1e4, 0.5, 0.1),
        known_cost("euler-adaptive", 0, 1e4, 0.2, 0.1, status="too slow"),
        known_cost("rkc2", 0, 1e5, 0.1, 0.3),
        *(known_cost("cvode", 1, 1e4, 2.0 + k, 0.1 / (1 + k), seed=k) for k in range(3)),
        known_cost("rosenbrock", 1, 1e4, 1.0, 0.1),  # of fewer seeds than the other
        known_cost("rosenbrock", 1, 1e4, 1.0, 1.0, goal=0.1),
    ]
    tile = scripts.problems.Tile("typical", 20_000, 1e3, 1)
    assert scripts.threads.chosen(rows, tile) == [("ab2-adaptive", 0.03), ("cvode", 0.05)]
    with pytest.raises(SystemExit, match="no implicit method is known"):
        scripts.threads.chosen([row for row in rows if not row["implicit"]], tile)


def test_the_winner_on_threads_is_the_kind_whose_first_thread_has_less_to_do(scripts):
    tile = {"state": "typical", "cells": 2e4, "stiffness": 1e3, "seed": 1.0}

    def row(implicit, threads, first):
        name = ("rkc2", "cvode")[implicit]
        about = {"implicit": implicit, "method": name, "threads": threads, "first_thread": first}
        return tile | about | {"cpu": 1.1 * first, "wall": 1.2 * first}

    rows = [row(0, 1, 3.0), row(0, 2, 1.5), row(1, 1, 2.0), row(1, 2, 1.6)]
    line = scripts.threads.threads_table(rows).splitlines()[-1]
    assert (
        line
        == "| 20,000 | typical | 10³ | `rkc2` 3.3 s; 2.00 | `cvode` 2.2 s; 1.25 | 1.5, 0.94 | yes |"
    )
    rows[1] = row(0, 2, 2.5)
    assert scripts.threads.threads_table(rows).endswith("| 1.5, 1.6 | no |")


def test_a_tile_is_solved_on_threads_once(scripts, given, monkeypatch, capsys):
    scripts.tiles.compute(given)
    given.threads = [1, 2]
    scripts.tiles.share(given)
    rows = scripts.tiles.kept(given.results, "tile-threads")
    assert [(row["method"], row["threads"]) for row in rows] == [
        ("rkc2", 1),
        ("rkc2", 2),
        ("cvode", 1),
        ("cvode", 2),
    ]
    assert all(0.0 < row["first_thread"] <= 1.01 * row["cpu"] for row in rows)
    monkeypatch.setattr(scripts.tiles, "race_threads", lambda *_: pytest.fail("solved again"))
    scripts.tiles.share(given)
    assert "| 50 | typical | 10² |" in capsys.readouterr().out
