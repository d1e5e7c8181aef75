"""The problems of Mathias et al. (2022): closed forms, and published points."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from docs_programs import DOCS, program
from scipy.integrate import quad

import multicell as mc

SUBJECT, SOURCE = "published comparisons of methods", "mathias2022"
STEPS = 0.001 * 1.25 ** np.arange(0, 31, 3)


@pytest.fixture(scope="module")
def modules():
    """The modules of docs/ that the command consists of."""
    return {name: program(name) for name in ("papers", "mathias2022_problems")}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "expected"), [("euler", 1), ("backward-euler", 1), ("heun", 2), ("rk4", 4)]
)
def test_two_daughters_part_as_the_integral_of_their_force_states(
    modules, compare, method, expected
):
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
    order = papers.order(steps, errors)
    compare.value(f"two daughters part by `{method}`: order", expected, order, 0.15)


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
def test_published_errors_are_found_again(modules, compare, problem, method, column):
    published = pd.read_csv(DOCS / "chart-data" / "mathias2022-published.csv")
    rows = published[(published["problem"] == problem) & (published["law"] == "cubic")]
    method_of = {"euler": "forward Euler", "theirs": "their backward Euler, written anew"}[method]
    ratios = [
        _error(modules, problem, "cubic", STEPS[row], method) / rows[f"{column}_error"].iloc[row]
        for row in (5, 6, 7)
    ]
    off = np.abs(np.array(ratios) - 1.0).max()
    what = f"{problem}, {method_of}: errors at steps of 0.028, 0.056 and 0.108 h, relative"
    compare.deviation(what, "published errors", off, 0.02)


def test_backward_euler_of_cbmos_stands_still_where_gmres_looks_at_its_tolerance_first(modules):
    errors = [_error(modules, "adhering", "cubic", h, "theirs", first=False) for h in STEPS[[5, 3]]]
    assert min(errors) > 0.5  # 1.15 instead of 1, and 0 instead of 0.075: nothing has moved
    assert _error(modules, "adhering", "cubic", STEPS[5], "backward-euler") < 3e-3


@pytest.mark.slow
def test_newton_without_a_line_search_loses_the_solution_that_a_minimisation_finds(modules):
    exactly = {"vectors": 76, "tolerance": 1e-8}
    assert _error(modules, "divided", "cubic", STEPS[7], "theirs", **exactly) > 1.0
    assert _error(modules, "divided", "cubic", STEPS[7], "backward-euler") < 0.05
