"""The problems of Mathias et al. (2022) and Osborne (2024): closed forms, and published points."""

from __future__ import annotations

import importlib
import math
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import quad
from scipy.linalg import expm

import multicell as mc

DOCS = Path(__file__).parents[2] / "docs"
STEPS = 0.001 * 1.25 ** np.arange(0, 31, 3)


@pytest.fixture(scope="module")
def modules() -> dict[str, ModuleType]:
    """The modules of docs/ that the two commands consist of."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(DOCS))
        names = ("papers", "mathias2022_problems", "osborne2024_problems")
        return {name: importlib.import_module(name) for name in names}


@pytest.mark.parametrize(
    ("method", "expected"), [("euler", 1), ("backward-euler", 1), ("heun", 2), ("rk4", 4)]
)
def test_two_daughters_part_as_the_integral_of_their_force_states(modules, method, expected):
    papers, problems = modules["papers"], modules["mathias2022_problems"]
    start, _, _ = problems.problems()["daughters"]
    law, end = problems.LAWS["cubic"], 0.8
    # each of the two moves by 5.7 (1 - d) (1.5 - d)²
    time, _ = quad(lambda d: 1.0 / (2.0 * 5.7 * (1.0 - d) * (1.5 - d) ** 2), 0.3, end, epsabs=1e-14)
    steps = time / np.array([64, 128, 256])
    errors = []
    for step in steps:
        place = papers.solve(law, start, [0.0, time], method, step).path[-1]
        errors.append(abs(place[1, 0] - place[0, 0] - end))
    assert papers.order(steps, errors) == pytest.approx(expected, abs=0.15)


def test_the_quadratic_law_keeps_what_runs_rely_on(modules):
    law = modules["mathias2022_problems"].LAWS["quadratic"]
    mc.testing.check_pair_law(law)
    assert law.force(0.0, 1.0, 0.25, rest=1.0) == pytest.approx(0.0, abs=1e-12)


def _error(modules, problem, law, step, method, **options):
    papers, problems = modules["papers"], modules["mathias2022_problems"]
    start, end, dim = problems.problems()[problem]
    at, times = np.linspace(0.0, end, 301)[:-1], np.arange(0.0, end, step)
    exact = papers.solve(problems.LAWS[law], start, at, "dopri5", 1e-10).path
    if method == "theirs":
        path, _ = problems.inexact_euler(problems.LAWS[law], start, times, dim, **options)
    else:
        path = papers.solve(problems.LAWS[law], start, times, method, step).path
    return problems.trajectory_error(times, path, at, exact, dim)


@pytest.mark.parametrize(("method", "column"), [("euler", "euler"), ("theirs", "backward")])
@pytest.mark.parametrize("problem", ["daughters", "adhering", "divided"])
def test_published_errors_are_found_again(modules, problem, method, column):
    published = pd.read_csv(DOCS / "chart-data" / "mathias2022-published.csv")
    rows = published[(published["problem"] == problem) & (published["law"] == "cubic")]
    for row in (5, 6, 7):
        found = _error(modules, problem, "cubic", STEPS[row], method)
        assert found == pytest.approx(rows[f"{column}_error"].iloc[row], rel=0.02)


def test_backward_euler_of_cbmos_stands_still_where_gmres_looks_at_its_tolerance_first(modules):
    errors = [_error(modules, "adhering", "cubic", h, "theirs", first=False) for h in STEPS[[5, 3]]]
    assert min(errors) > 0.5  # 1.15 instead of 1, and 0 instead of 0.075: nothing has moved
    assert _error(modules, "adhering", "cubic", STEPS[5], "backward-euler") < 3e-3


def test_newton_without_a_line_search_loses_the_solution_that_a_minimisation_finds(modules):
    exactly = {"vectors": 76, "tolerance": 1e-8}
    assert _error(modules, "divided", "cubic", STEPS[7], "theirs", **exactly) > 1.0
    assert _error(modules, "divided", "cubic", STEPS[7], "backward-euler") < 0.05


@pytest.mark.parametrize("name", ["FE", "MP", "RK4", "BE"])
def test_the_chain_has_the_error_of_its_stability_function(modules, name):
    papers, problems = modules["papers"], modules["osborne2024_problems"]
    place, values, _ = problems.chain()
    step, start = 1.0 / 64.0, np.zeros((11, 3))
    start[:, 0] = place
    times = np.arange(0.0, problems.CHAIN_END + 0.5 * step, step)
    path = papers.solve(problems.CHAIN, start, times, problems.OURS[name], step).path[..., 0]
    # independent of eigenvectors: the exact solution by powers of one matrix exponential
    laplacian = np.diff(np.eye(11), axis=0)
    advance, exact = expm(-15.0 * step * laplacian.T @ laplacian), [place - place / 0.9]
    for _ in times[1:]:
        exact.append(advance @ exact[-1])
    away = np.abs(path - place / 0.9 - np.array(exact)).max()
    assert away == pytest.approx(problems.chain_errors(name, np.array([step]))[0], rel=1e-3)
    assert values.min() == pytest.approx(-30.0 * (1.0 + math.cos(math.pi / 11.0)))


@pytest.mark.parametrize(("part", "grows"), [(0.98, False), (1.02, True)])
def test_forward_euler_is_stable_up_to_two_over_lambda(modules, part, grows):
    papers, problems = modules["papers"], modules["osborne2024_problems"]
    place, values, vectors = problems.chain()
    step, start = part * 2.0 / -values.min(), np.zeros((11, 3))
    start[:, 0] = place / 0.9 + 1e-6 * vectors[:, 0]
    end = papers.solve(problems.CHAIN, start, [0.0, 200 * step], "euler", step).path[-1]
    size = np.abs(vectors[:, 0] @ (end[:, 0] - place / 0.9))
    assert size / 1e-6 == pytest.approx(abs(1.0 - 2.0 * part) ** 200, rel=1e-3)
    assert (size > 1e-6) == grows


def test_steps_by_a_threshold_converge(modules):
    papers, problems = modules["papers"], modules["osborne2024_problems"]
    start = np.random.default_rng(1).normal(0.0, 0.4, (12, 3))
    exact = papers.solve(problems.SPRINGS, start, [0.0, 0.5], "dopri5", 1e-12).path[-1]
    away, costs = [], []
    for move in (4e-3, 2e-3, 1e-3):
        end, cost = problems.threshold(1, 1.0 / 16.0, move)(start, 0.0, 0.5)
        away.append(np.linalg.norm(end - exact, axis=1).max())
        costs.append(cost)
    assert papers.order([4e-3, 2e-3, 1e-3], away) == pytest.approx(1.0, abs=0.3)
    assert costs == sorted(costs)


def test_births_fall_on_common_steps_and_cycles_keep_their_bounds(modules):
    problems = modules["osborne2024_problems"]
    events = problems.births(0, 2)
    times = np.array([time for time, _, _ in events])
    assert np.array_equal(times * 16.0, np.round(times * 16.0))
    born = [-math.inf] * 4
    for time, mother, way in events:
        if math.isfinite(born[mother]):
            assert 7.0 <= time - born[mother] <= 17.0 + 1.0 / 16.0
        born[mother] = time
        born.append(time)
        assert np.linalg.norm(way) == pytest.approx(1.0)
        assert way[2] == 0.0


def test_the_cost_of_an_error_is_interpolated_in_logarithms(modules):
    reached = modules["papers"].reached
    assert reached([1e-1, 1e-3], [10.0, 1000.0], 1e-2) == pytest.approx(100.0)
    assert reached([1e-3, 1e-4], [10.0, 20.0], 1e-2) == 10.0
    assert math.isnan(reached([1e-1, 1e-2], [10.0, 20.0], 1e-3))
