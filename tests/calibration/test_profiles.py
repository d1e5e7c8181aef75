"""Profile likelihoods: closed forms, priors, ends of ranges, bad input."""

from __future__ import annotations

import math

import numpy as np
import pytest
from cheap_fits import MATRIX, exact, fitted, linear, through
from scipy import stats

import multicell as mc
from multicell.calibration.emulator import best_of, draws
from multicell.calibration.likelihood import likelihood, scatter_of
from multicell.calibration.priors import Density, Prior
from multicell.calibration.profiles import profiles

VALUES = [0.45, 0.6, 1.0, -0.2]


def of_runs(problem, prior=None):
    """Return the likelihood of exact runs of a linear problem, which do not scatter."""
    shares = np.random.default_rng(5).random((40, len(problem.ranges)))
    runs = np.array([problem.simulator(x, 0, 0).values for x in shares])
    model = through(shares, (runs - problem.observed) / problem.sigma, prior=prior)
    best = best_of(model.loss, model.prior, draws(model.loss, model.prior, seed=0, count=300))
    return likelihood(model, problem.noise, best, scatter_of(model.means(np.tile(best, (12, 1)))))


def test_the_profile_of_a_linear_model_is_the_parabola_of_its_closed_form():
    problem = linear(MATRIX, VALUES, 0.05)
    mean, covariance = exact(problem)
    deviation = np.sqrt(np.diag(covariance))
    for k, profile in enumerate(profiles(of_runs(problem), [0, 1])):
        expected = ((profile.shares[:, k] - mean[k]) / deviation[k]) ** 2
        np.testing.assert_allclose(profile.rises, expected, atol=0.01 * expected.max())
        reach = math.sqrt(stats.chi2.ppf(0.95, 1)) * deviation[k]
        np.testing.assert_allclose(
            profile.ends[:, k], mean[k] + np.array([-reach, reach]), atol=1e-3
        )
        assert profile.open == (False, False)
        # over the other parameter: the regression of one on the other
        slope = covariance[0, 1] / covariance[k, k]
        others = mean[1 - k] + slope * (profile.shares[:, k] - mean[k])
        np.testing.assert_allclose(profile.shares[:, 1 - k], others, atol=2e-3)


def test_a_prior_narrows_a_profile_as_in_closed_form():
    problem = linear([[1.0]], [0.4], 0.05)
    prior = Prior(1, problem.ranges, (Density("norm", (), 0.6, 0.05),))
    (profile,) = profiles(of_runs(problem, prior), [0])
    reach = stats.norm.ppf(0.975) * 0.05 / math.sqrt(2.0)
    np.testing.assert_allclose(profile.ends[:, 0], [0.5 - reach, 0.5 + reach], atol=1e-3)


def test_profiles_end_at_the_ends_of_ranges():
    problem = linear([[1.0, 0.0], [0.0, 1.0]], [0.5, 0.5], [0.02, 10.0])
    first, second = profiles(of_runs(problem), [0, 1])
    reach = 0.02 * stats.norm.ppf(0.975)
    assert first.ends[0, 0] == pytest.approx(0.5 - reach, abs=1e-3)
    assert second.open == (True, True)
    assert second.ends[:, 1].tolist() == [0.0, 1.0]


def test_a_profile_is_a_table_with_units_and_bad_input_is_refused():
    found = fitted(linear(MATRIX, VALUES, 0.05))
    table = found.profile("toy.p1")
    assert list(table.columns) == ["p0", "p1", "rise"]
    assert len(table) == 15
    assert table.attrs["open"] == [False, False]
    with pytest.raises(mc.SceneError, match=r"key: is 'toy\.p7', must be one of"):
        found.profile("toy.p7")
    with pytest.raises(mc.errors.FitFailed, match="too few points were tried"):
        fitted(linear(MATRIX, VALUES, 0.05), points=3).profile("p0")
