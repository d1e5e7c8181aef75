"""Coverage of intervals of fits: truths drawn, data made from them, fitted again.

``--calibrations N`` repeats each case N times; what is checked then is that 80 and 95 % intervals
of each parameter cover the truth as often, within three binomial standard errors.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from cheap_fits import CASES, check, growing, through

import multicell as mc
from multicell.calibration.fitting.likelihood import fresh, likelihood, scatter_of
from multicell.calibration.fitting.pool import Pool
from multicell.calibration.fitting.problem import FitProblem, free_of
from multicell.calibration.fitting.search import Search
from multicell.calibration.fitting.simulator import SceneSimulator
from multicell.calibration.fitting.verdict import intervals
from multicell.calibration.sensitivity.indices import sample, sensitivity_indices
from multicell.measured.data import read_data
from multicell.measured.noise import Noise

QUICK = 5
ALWAYS = ("kink",)
"""What every run of the tests repeats; scatter that is shared has its closed form below."""


def sampled(problem):
    """Return draws of a fit, as places in the ranges."""
    search = Search(problem, None)
    search.run(Pool(), 30)
    return fresh(problem, search, Pool()).likelihood.draws()


def covered(problem, sample, truth):
    """Return whether 80 and 95 % intervals hold the truth, (2, parameters)."""
    found = [intervals(problem.ranges, sample, level) for level in (0.8, 0.95)]
    return [[x in f[r.name] for r, x in zip(problem.ranges, truth, strict=True)] for f in found]


@pytest.mark.slow
@pytest.mark.harness
@pytest.mark.parametrize("case", CASES)
def test_intervals_cover_as_often_as_they_say(case, request):
    count = request.config.getoption("--calibrations")
    if count == 0 and case not in ALWAYS:
        pytest.skip("asked for with --calibrations N")
    rng = np.random.default_rng(1)
    hits = []
    for _ in range(count or QUICK):
        truth = 0.2 + 0.6 * rng.random(2)
        problem = growing(CASES[case], truth, rng)
        hits.append(covered(problem, sampled(problem), truth))
    check(hits)


@pytest.mark.harness
def test_intervals_of_the_real_engine_cover_as_often_as_they_say(request):
    """Six cells that grow for 40 h: cycle time and radius from five sizes of one culture."""
    count = request.config.getoption("--calibrations")
    if count == 0:
        pytest.skip("asked for with --calibrations N")
    scene = mc.load_scene("growth").with_changes(
        {"duration": "40 h", "initial.count": 6, "initial.stage": "asynchronous",
         "coupling_step": "2 h"}
    )  # fmt: skip
    times, sigma = [8, 16, 24, 32, 40], 1.0
    free = {"growth.cycle_time": "10:30 h", "cells.division_radius": "4:10 um"}
    rng, hits = np.random.default_rng(2), []
    for repeat in range(count):
        shape = {"time / h": times, "diameter / um": [30.0] * 5, "diameter sd / um": [sigma] * 5}
        measured = read_data(shape, scene)
        ranges, _ = free_of(free, measured)
        shares = 0.2 + 0.6 * rng.random(2)
        tissue = SceneSimulator.of(measured, ranges)(shares.tolist(), 0, 10**6 + repeat)
        values = np.array(tissue.values) + sigma * rng.standard_normal(5)
        measured = read_data({**shape, "diameter / um": np.maximum(values, 0.0).tolist()}, scene)
        simulator, first = SceneSimulator.of(measured, ranges), 1 + 10**4 * repeat
        problem = FitProblem(measured, ranges, simulator, (first, first + 1))
        truth = [free.value(x) for free, x in zip(ranges, shares, strict=True)]
        hits.append(covered(problem, sampled(problem), truth))
    check(hits)


def test_fresh_runs_give_the_variance_of_scatter_that_is_shared():
    """One rate from six times that scatter together: in closed form, s² + σ²/6 and s²/R of it."""
    rng = np.random.default_rng(4)
    shares, sigma, scatter = np.linspace(0.0, 1.0, 9)[:, None], 1.0, 3.0
    means = np.repeat(40.0 * (shares - 0.5), 6, axis=1) / sigma
    model = through(shares, means)
    runs = scatter * np.repeat(rng.standard_normal((400, 1)), 6, axis=1)
    found = likelihood(model, Noise.of_means(np.ones(6)), np.array([0.5]), scatter_of(runs))
    expected = math.sqrt(scatter**2 * (1.0 + 1.0 / 400) + sigma**2 / 6.0) / 40.0
    assert found.draws().std() == pytest.approx(expected, rel=0.1)
    # three tissues scatter less, and a standard error of the mean holds their scatter
    for tissues, part in ((3.0, 1.0 / 3.0), (math.inf, 0.0)):
        noise = Noise.of_means(np.full(6, tissues))
        found = likelihood(model, noise, np.array([0.5]), scatter_of(runs))
        expected = math.sqrt(scatter**2 * (part + 1.0 / 400) + sigma**2 / 6.0) / 40.0
        assert found.draws().std() == pytest.approx(expected, rel=0.1)


def test_few_fresh_runs_give_the_tails_of_student():
    """Four runs of one datum that scatters far more than its σ: three degrees of freedom."""
    from scipy import stats

    shares = np.linspace(0.0, 1.0, 9)[:, None]
    means = 2000.0 * (shares - 0.5)
    model = through(shares, means)
    runs = np.array([[-30.0], [-10.0], [10.0], [30.0]])
    found = likelihood(model, Noise.of_means(np.ones(1)), np.array([0.5]), scatter_of(runs))
    draws = (found.draws()[:, 0] - 0.5) * 2000.0
    scale = math.sqrt(runs.var(ddof=1) * 1.25)
    for level in (0.8, 0.95):
        reach = scale * stats.t.ppf(0.5 + 0.5 * level, 3)
        assert (np.abs(draws) < reach).mean() == pytest.approx(level, abs=0.03)


@pytest.mark.parametrize("size", [6, 10])
def test_intervals_of_morris_cover_the_mean_effects(size):
    """x² + y z on a grid of four levels: effects and their means in closed form."""
    names = ["x", "y", "z"]
    whole = sample(names, 200 * size)
    values = (whole[:, 0] ** 2 + whole[:, 1] * whole[:, 2])[:, None]
    # of x, which steps from 0 to 2/3 or from 1/3 to 1; of y and z, whose partner has four levels
    truth = np.array([0.5 * (2.0 / 3.0 + 4.0 / 3.0), 0.5, 0.5])
    hits, wide = [], 4 * size
    for k in range(len(whole) // wide):
        part = slice(k * wide, (k + 1) * wide)
        found = sensitivity_indices(names, whole[part], values[part]).columns
        hits.append(np.abs(found["mu_star"] - truth) <= found["mu_star_conf"] + 1e-12)
    shares = np.mean(hits, axis=0)
    assert shares.min() > 0.95 - 3.0 * math.sqrt(0.95 * 0.05 / len(hits)) - 0.01
