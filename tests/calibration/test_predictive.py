"""Predictive checks and comparison of models against closed forms, and models that are known."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from cheap_fits import MATRIX, Growing, exact, fitted, growing, linear
from scipy import stats

import multicell as mc
from multicell.calibration.fitting.predictive import Predictive

VALUES = [0.45, 0.6, 1.0, -0.2]


@pytest.mark.slow
def test_criteria_and_scores_of_a_linear_model_are_those_of_closed_forms():
    noise = 0.05 * np.random.default_rng(4).standard_normal(16)
    data = 4 * VALUES + noise
    problem = linear(4 * MATRIX, data, 0.05)
    single = linear([row[:1] for row in 4 * MATRIX], data, 0.05)
    table = mc.compare_fits({"both": fitted(problem), "one": fitted(single, points=20)})
    assert list(table.index) == ["both", "one"]
    for name, case in (("both", problem), ("one", single)):
        a, y = np.asarray(case.simulator.matrix), data
        mean, _ = exact(case)
        mean = mean.clip(0.0, 1.0)
        count, free = len(y), a.shape[1]
        largest = stats.norm.logpdf(y, a @ mean, 0.05).sum()
        row = table.loc[name]
        assert row.log_likelihood == pytest.approx(largest, abs=0.05)
        assert row.aic == pytest.approx(2 * free - 2 * largest, abs=0.1)
        more = 2 * free * (free + 1) / (count - free - 1)
        assert row.aicc == pytest.approx(row.aic + more)
        assert row.bic == pytest.approx(free * math.log(16) - 2 * largest, abs=0.1)
    # each datum left out: a normal number around what the others make of it
    a, y, scores = np.array(4 * MATRIX), data, []
    for k in range(16):
        rest, others = np.delete(a, k, axis=0), np.delete(y, k)
        left = np.linalg.inv(rest.T @ rest)
        spread = 0.05 * math.sqrt(1.0 + a[k] @ left @ a[k])
        scores.append(stats.norm.logpdf(y[k], a[k] @ left @ rest.T @ others, spread))
    assert table.loc["both"].score == pytest.approx(sum(scores), abs=0.15)
    assert table.loc["both"].score_error == pytest.approx(4.0 * np.std(scores, ddof=1), rel=0.1)
    assert table.loc["both"].behind == 0.0


def correlated(count=20_000):
    """Return draws of a linear model whose data scatter together, and the density of all data."""
    rng = np.random.default_rng(2)
    a, y = np.array(3 * MATRIX), np.array(3 * VALUES)
    covariance = 0.05**2 * (np.eye(12) + 2.0 * np.ones((12, 12)))
    wide = 100.0 * np.eye(2)  # a prior that leaves everything open
    precision = np.linalg.inv(covariance)
    after = np.linalg.inv(a.T @ precision @ a + np.linalg.inv(wide))
    theta = rng.multivariate_normal(after @ a.T @ precision @ y, after, count)
    found = Predictive(theta @ a.T - y, covariance, np.zeros(12))
    return found, y, a @ wide @ a.T + covariance


def test_scores_of_data_that_scatter_together_condition_on_the_others():
    found, y, whole = correlated()
    for k in range(12):
        rest = np.arange(12) != k
        part = np.linalg.solve(whole[np.ix_(rest, rest)], whole[rest, k])
        spread = math.sqrt(whole[k, k] - whole[k, rest] @ part)
        assert found.scores[k] == pytest.approx(
            stats.norm.logpdf(y[k], part @ y[rest], spread), abs=0.02
        )


def test_one_draw_far_out_does_not_decide_a_score():
    found, *_ = correlated(2000)
    away = found.residuals.copy()
    away[7, 3] += 7.0 / math.sqrt(found.precision[3, 3])  # a chance of e-24
    np.testing.assert_allclose(replace(found, residuals=away).scores, found.scores, atol=0.5)


def test_checks_are_the_probabilities_of_their_closed_forms():
    covariance = np.array([[1.0, 0.6], [0.6, 2.0]])
    off = np.array([1.2, -0.7])
    found = Predictive(np.tile(off, (40_000, 1)), covariance, np.zeros(2))
    chi, largest = found.check()
    assert chi == pytest.approx(stats.chi2.sf(off @ np.linalg.solve(covariance, off), 2))
    # both within the larger deviation, 1.2 of the first
    root = np.sqrt(np.diag(covariance))
    both = stats.multivariate_normal(cov=covariance / np.outer(root, root))
    assert largest == pytest.approx(1 - both.cdf([1.2, 1.2], lower_limit=[-1.2, -1.2]), abs=0.01)
    again = found.replicate()
    np.testing.assert_allclose(np.cov(again.T), covariance, atol=0.04)
    np.testing.assert_allclose(again.mean(axis=0), off, atol=0.02)


def test_data_of_the_model_pass_and_data_of_another_do_not():
    right = fitted(linear(MATRIX, VALUES, 0.05)).predictive_check()
    assert 0.05 < right.chi_squared < 0.95
    assert 0.05 < right.largest < 0.95
    assert right.outside == 0
    assert (right.table.low < right.table["median"]).all()
    wrong = fitted(linear(MATRIX, [0.45, 0.6, 1.4, -0.2], 0.05)).predictive_check()
    assert wrong.chi_squared < 0.01
    assert wrong.largest < 0.05
    assert wrong.table.p.min() < 0.05
    # errors that are stated ten times too large: replicated data are always further off
    loose = fitted(linear(MATRIX, [0.5, 0.5, 1.0, 0.0], 0.4)).predictive_check()
    assert loose.chi_squared > 0.7


def test_fits_that_cannot_be_compared_are_refused():
    one, other = fitted(linear(MATRIX, VALUES, 0.05)), fitted(linear(MATRIX, VALUES, 0.06))
    for fits, words in (
        ({"a": one, "b": other}, "has 'a' and 'b', which are to different data"),
        ([one, other], "Give {'name': fit"),
        ({"a": one}, "must have at least two"),
    ):
        with pytest.raises(mc.SceneError, match=words):
            mc.compare_fits(fits)
    none = fitted(linear(MATRIX, VALUES, 0.05), points=3)
    with pytest.raises(mc.errors.FitFailed, match="too few points"):
        mc.compare_fits({"a": one, "none": none})


@dataclass(frozen=True)
class Straight(Growing):
    """A diameter that grows by the same length each day, and the core of :class:`Growing`."""

    def mean(self, shares):
        """Return results of runs without scatter, um: six times of each observable."""
        rate, depth = shares
        size = 60.0 + 60.0 * np.arange(1.0, 7.0) * (0.05 + 0.25 * rate)
        return np.concatenate([size, np.maximum(size - 60.0 - 100.0 * depth, 0.0)])


@pytest.mark.harness
@pytest.mark.slow
def test_the_model_that_made_the_data_is_chosen(request):
    """Growth by a constant ratio or a constant length; tissues scatter over time, nine of ten."""
    count = request.config.getoption("--calibrations") or 2
    rng = np.random.default_rng(8)
    models = {"ratio": Growing("walk", 2.0, kink=True), "length": Straight("walk", 2.0, kink=True)}
    right = {"score": 0, "aic": 0, "bic": 0}
    for repeat in range(count):
        truth = list(models)[repeat % 2]
        shares = np.array([0.6, 0.3]) + 0.3 * rng.random(2)
        problem = growing(models[truth], shares, rng, sigma=3.0)
        fits = {name: fitted(replace(problem, simulator=m)) for name, m in models.items()}
        table = mc.compare_fits(fits)
        right["score"] += table.index[0] == truth
        for name in ("aic", "bic"):
            right[name] += table[name].idxmin() == truth
    print(right)
    assert min(right.values()) >= 0.9 * count
