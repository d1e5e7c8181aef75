"""The problems of Osborne (2024): closed forms of a chain by stability functions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from docs_programs import program
from scipy.linalg import expm

SUBJECT, SOURCE = "published comparisons of methods", "osborne2024"


@pytest.fixture(scope="module")
def modules():
    """The modules of docs/ that the command consists of."""
    return {name: program(name) for name in ("papers", "osborne2024_problems")}


@pytest.mark.parametrize("name", ["FE", "MP", "RK4", "BE"])
def test_the_chain_has_the_error_of_its_stability_function(modules, compare, name):
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
    ratio = away / problems.chain_errors(name, np.array([step]))[0]
    what = f"chain of springs by `{problems.OURS[name]}`: error over that of the stability function"
    compare.value(what, 1.0, ratio, 1e-3)
    assert values.min() == pytest.approx(-30.0 * (1.0 + math.cos(math.pi / 11.0)))


@pytest.mark.parametrize(("part", "grows"), [(0.98, False), (1.02, True)])
def test_forward_euler_is_stable_up_to_two_over_lambda(modules, compare, part, grows):
    papers, problems = modules["papers"], modules["osborne2024_problems"]
    place, values, vectors = problems.chain()
    step, start = part * 2.0 / -values.min(), np.zeros((11, 3))
    start[:, 0] = place / 0.9 + 1e-6 * vectors[:, 0]
    end = papers.solve(problems.CHAIN, start, [0.0, 200 * step], "euler", step).path[-1]
    size = np.abs(vectors[:, 0] @ (end[:, 0] - place / 0.9))
    ratio = size / 1e-6 / abs(1.0 - 2.0 * part) ** 200
    what = (
        f"stiffest mode after 200 steps of {part:g} times 2/λ, `euler`: size over the closed form"
    )
    compare.value(what, 1.0, ratio, 1e-3)
    assert (size > 1e-6) == grows


@pytest.mark.slow
def test_steps_by_a_threshold_converge(modules, compare):
    papers, problems = modules["papers"], modules["osborne2024_problems"]
    start = np.random.default_rng(1).normal(0.0, 0.4, (12, 3))
    exact = papers.solve(problems.SPRINGS, start, [0.0, 0.5], "dopri5", 1e-12).path[-1]
    away, costs = [], []
    for move in (4e-3, 2e-3, 1e-3):
        end, cost = problems.threshold(1, 1.0 / 16.0, move)(start, 0.0, 0.5)
        away.append(np.linalg.norm(end - exact, axis=1).max())
        costs.append(cost)
    order = papers.order([4e-3, 2e-3, 1e-3], away)
    compare.value("RK4 with a threshold on moves: order in the threshold", 1.0, order, 0.3)
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
