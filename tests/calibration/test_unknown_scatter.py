"""Errors of data of unknown size: intervals of linear regression, factors of its residuals."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cheap_fits import check, exact, fitted, linear
from scipy import stats

from multicell.calibration.fitting.unknown_scatter import check_scatter, drawn_factors, with_scatter
from multicell.errors import DataError
from multicell.measured.noise import LEAST_FACTOR, Noise, likeliest

TIMES = np.linspace(-1.0, 1.0, 12)
LINE = np.stack([np.ones(12), TIMES], axis=1)


def line(stated, true=0.05, truth=(0.5, 0.4), seed=4, design=LINE, **more):
    """Return a straight line whose data scatter by ``true`` and state an error of ``stated``."""
    rng = np.random.default_rng(seed)
    values = design @ np.array(truth) + true * rng.standard_normal(len(design))
    return replace(linear(design, values, stated, **more), scatter="unknown")


def regression(problem, level):
    """Return estimates, their intervals, and the standard deviation of least squares."""
    a = np.asarray(problem.simulator.matrix)
    best, *_ = np.linalg.lstsq(a, problem.observed, rcond=None)
    freedom = len(a) - a.shape[1]
    s = math.sqrt(((problem.observed - a @ best) ** 2).sum() / freedom)
    reach = stats.t.ppf(0.5 + level / 2.0, freedom) * s * np.sqrt(np.diag(np.linalg.inv(a.T @ a)))
    return best, np.stack([best - reach, best + reach]), s, freedom


@pytest.mark.slow
@pytest.mark.parametrize("stated", [0.01, 0.5])
def test_intervals_are_those_of_linear_regression_whatever_is_stated(stated):
    problem = line(stated)
    found = fitted(problem)
    best, _, s, freedom = regression(problem, 0.95)
    np.testing.assert_allclose(list(found.best.values.values()), best, atol=2e-3)
    for level in (0.8, 0.95):
        ends = regression(problem, level)[1]
        for k, interval in enumerate(found.intervals(level).values()):
            width = ends[1, k] - ends[0, k]
            assert interval.low == pytest.approx(ends[0, k], abs=0.05 * width)
            assert interval.high == pytest.approx(ends[1, k], abs=0.05 * width)
    size = found.scatter["force_toy_x"]
    assert size.best == pytest.approx(s / stated, rel=0.02)
    low, high = (
        s / stated * math.sqrt(freedom / stats.chi2.ppf(q, freedom)) for q in (0.975, 0.025)
    )
    assert size.low == pytest.approx(low, rel=0.06)
    assert size.high == pytest.approx(high, rel=0.08)
    assert found.best.chi_squared == pytest.approx(freedom, rel=0.02)
    assert any("The errors of force_toy_x were fitted" in note for note in found.notes)
    assert np.median(found.posterior["scatter_force_toy_x"]) == pytest.approx(size.median, rel=1e-3)


@pytest.mark.slow
def test_a_profile_of_unknown_scatter_is_that_of_students_distribution():
    problem = line(0.01)
    profile = fitted(problem).profile("p1")
    best, _, s, freedom = regression(problem, 0.95)
    a = np.asarray(problem.simulator.matrix)
    error = s * math.sqrt(np.linalg.inv(a.T @ a)[1, 1])
    near = np.abs(profile.values - best[1]) < 3.0 * error
    assert near.sum() >= 5
    # of two directions together: -2 ln of (1 + t²/ν)^(-(ν + 2)/2)
    t = (profile.values[near] - best[1]) / error
    np.testing.assert_allclose(
        profile.loss[near], (freedom + 2) * np.log1p(t**2 / freedom), rtol=0.05, atol=0.1
    )


def test_the_likeliest_factor_is_the_root_of_the_mean_square_without_other_variances():
    rng = np.random.default_rng(1)
    squares, errors = rng.normal(size=(5, 9)) ** 2, rng.uniform(0.5, 2.0, 9)
    none = np.zeros((5, 9))
    expected = (squares / errors).mean(axis=1)
    np.testing.assert_allclose(likeliest(squares, errors, none), expected, rtol=1e-9)
    np.testing.assert_allclose(
        likeliest(squares, errors, none, lost=3.0), expected * 9.0 / 6.0, rtol=1e-9
    )
    # data that scatter less than runs do have the least factor, and wild ones the largest
    assert likeliest(squares, errors, none + 1e6)[0] == pytest.approx(LEAST_FACTOR**2)
    assert likeliest(squares * 1e12, errors, none)[0] == pytest.approx(LEAST_FACTOR**-2)


def test_known_scatter_of_runs_is_taken_off():
    """Of variance φ² + s² with s known the likeliest φ is that of SciPy's minimum."""
    from scipy.optimize import minimize_scalar

    rng = np.random.default_rng(2)
    other = rng.uniform(0.5, 3.0, 40)
    squares = (rng.normal(size=40) * np.sqrt(4.0 + other)) ** 2
    found = likeliest(squares[None], np.ones(40), other[None])[0]
    best = minimize_scalar(
        lambda v: (squares / (v + other) + np.log(v + other)).sum(), bounds=(0.01, 50.0),
        method="bounded", options={"xatol": 1e-8},
    ).x  # fmt: skip
    assert found == pytest.approx(best, rel=1e-5)


@pytest.mark.slow
def test_factors_beside_scatter_of_the_same_size_are_not_too_small():
    """With equal chances of all logarithms 78 % of the factors were below these 90 % quantiles."""
    rng, problem = np.random.default_rng(1), SimpleNamespace(observables={"x": np.arange(30)})
    below, repeats = 0, 200
    for _ in range(repeats):
        residuals = rng.normal(size=30) * math.sqrt(2.0)  # half of it is known, of runs
        draws = drawn_factors(problem, np.tile(residuals, (300, 1)), np.ones((300, 30)))["x"]
        below += np.quantile(draws, 0.9) >= 1.0
    assert abs(below / repeats - 0.9) < 3.0 * math.sqrt(0.09 / repeats)


def test_each_observable_has_its_own_factor():
    noise = Noise(np.eye(8), np.eye(8), unknown=(np.arange(4), np.arange(4, 8)))
    residuals = np.array([[1.0, -1, 1, -1, 30, -30, 30, -30]])
    expected = 8.0 + 4.0 * math.log(1.0) + 4.0 * math.log(900.0)
    assert noise.loss(residuals, np.zeros(8))[0] == pytest.approx(expected, rel=1e-9)


def test_data_that_leave_no_freedom_are_refused():
    with pytest.raises(DataError, match=r"the 3 data of 'force_toy_x' leave 1 degrees of freedom"):
        check_scatter(line(0.1, design=LINE[::4]))
    check_scatter(line(0.1, design=LINE[::3]))


def test_what_runs_do_not_have_says_nothing_of_the_size():
    problem = line(0.1)
    residuals = np.full(12, 2.0)
    residuals[3] = np.nan
    found = with_scatter(problem, residuals, np.zeros(12))
    assert found.freedom == pytest.approx(11.0 - 2.0)
    np.testing.assert_allclose(found.sigma / problem.sigma, 2.0 * math.sqrt(11.0 / 9.0), rtol=1e-6)


@pytest.mark.harness
def test_intervals_cover_as_often_as_they_say(request):
    count = request.config.getoption("--calibrations")
    if count == 0:
        pytest.skip("asked for with --calibrations N")
    rng, hits, sizes = np.random.default_rng(8), [], []
    for repeat in range(count):
        truth = 0.3 + 0.4 * rng.random(2)
        # data scatter as runs do, by 0.03, and by a quarter of what is stated
        true = math.hypot(0.05, 0.03)
        found = fitted(line(0.2, true, truth=truth, seed=100 + repeat, noise=0.03, seeds=2))
        hits.append([[x in i for x, i in zip(truth, found.intervals(level).values(), strict=True)]
                     for level in (0.8, 0.95)])  # fmt: skip
        size = found.scatter["force_toy_x"]
        sizes.append(size.low <= 0.25 <= size.high)

    check(hits)
    print(np.mean(sizes))
    assert np.mean(sizes) >= 0.95 - 3.0 * math.sqrt(0.95 * 0.05 / count)


def test_stated_errors_are_as_before():
    problem = replace(line(0.05), scatter="stated")
    found = fitted(problem)
    mean, covariance = exact(problem)
    for k, interval in enumerate(found.intervals().values()):
        assert interval.low == pytest.approx(mean[k] - 1.96 * math.sqrt(covariance[k, k]), abs=3e-3)
    assert found.scatter == {}
    assert "scatter_force_toy_x" not in found.posterior
