"""The posterior sampled with runs: closed forms, coverage, stopped and gone on."""

from __future__ import annotations

import json
from concurrent.futures import Executor, Future
from queue import LifoQueue
from threading import Thread

import numpy as np
import pytest
from cheap_fits import calls_of, exact, linear, stopping
from scipy import stats

from multicell.calibration.pool import Pool
from multicell.calibration.posterior import posterior
from multicell.errors import FitFailed, OutputError

MATRIX = [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]


def moments(draws):
    mean = draws.weights @ draws.shares
    away = draws.shares - mean
    return mean, (draws.weights[:, None] * away).T @ away


def test_the_sample_has_the_posterior_of_a_normal_mean_in_closed_form():
    """Mean and deviation of the posterior of one normal mean, from four measurements."""
    problem = linear([[1.0]] * 4, [0.45, 0.52, 0.5, 0.57], 0.1)
    draws = posterior(problem, Pool(), seed=1, population=150)
    mean, variance = moments(draws)
    assert draws.temperature == 1.0
    assert mean[0] == pytest.approx(0.51, abs=0.015)
    assert np.sqrt(variance[0, 0]) == pytest.approx(0.05, rel=0.2)


def test_scatter_of_runs_adds_to_the_deviations_of_the_data():
    """Runs with noise of their own: the variance of each datum is σ² + s²."""
    problem = linear([[1.0]] * 2, [0.45, 0.55], 0.06, noise=0.08)
    mean, variance = moments(posterior(problem, Pool(), seed=2, population=150))
    expected, covariance = exact(problem)
    assert covariance[0, 0] == pytest.approx(0.01 / 2)
    assert mean[0] == pytest.approx(expected[0], abs=0.015)
    assert np.sqrt(variance[0, 0]) == pytest.approx(np.sqrt(0.01 / 2), rel=0.2)


def test_correlations_are_those_of_the_closed_form():
    problem = linear([[1.0, 1.0], [1.0, 0.6]], [1.0, 0.8], 0.03)
    mean, covariance = moments(posterior(problem, Pool(), seed=3, population=150))
    expected, truth = exact(problem)
    np.testing.assert_allclose(mean, expected, atol=0.03)
    correlation = covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1])
    assert correlation == pytest.approx(truth[0, 1] / np.sqrt(truth[0, 0] * truth[1, 1]), abs=0.03)


@pytest.mark.slow
def test_ranks_of_the_truth_are_uniform(request):
    """Simulation-based calibration (Talts et al. 2018): the posterior covers what it says.

    Parameters are drawn from the prior and data from them; the rank of each parameter in its
    posterior must be uniform. Both the ranks' distribution (Kolmogorov-Smirnov) and the number of
    truths in the central half (binomial) are tested, with a chance of a false alarm of 1 in 500
    each; the seeds are fixed. ``--calibrations N`` draws N truths.
    """
    rng = np.random.default_rng(11)
    ranks, count = [], request.config.getoption("--calibrations") or 12
    for repeat in range(count):
        truth = rng.random(2)
        sigma, noise = 0.12, 0.05
        tissue = np.asarray(MATRIX) @ truth + noise * rng.standard_normal(3)
        data = tissue + sigma * rng.standard_normal(3)
        problem = linear(MATRIX, data, sigma, noise=noise)
        draws = posterior(problem, Pool(), seed=repeat, population=40)
        below = draws.shares < truth
        ranks.append(draws.weights @ below)
    for rank in np.array(ranks).T:
        assert stats.kstest(rank, "uniform").pvalue > 0.002
        inside = int(((rank > 0.25) & (rank < 0.75)).sum())
        assert stats.binomtest(inside, count, 0.5).pvalue > 0.002


class Backwards(Executor):
    """A worker that makes the call first that was submitted last."""

    def __init__(self):
        self._calls = LifoQueue()
        Thread(target=self._work, daemon=True).start()

    def submit(self, function, /, *arguments):
        future = Future()
        self._calls.put((future, function, arguments))
        return future

    def _work(self):
        while True:
            future, function, arguments = self._calls.get()
            if future.set_running_or_notify_cancel():
                future.set_result(function(*arguments))


def test_the_sample_does_not_depend_on_who_works_in_which_order():
    def problem():
        return linear(MATRIX, [0.4, 0.6, 1.0], 0.2, noise=0.1)

    one = posterior(problem(), Pool(), seed=7, population=30)
    other = posterior(problem(), Pool(Backwards(), lambda: 5), seed=7, population=30)
    third = posterior(problem(), Pool(Backwards(), lambda: 3), seed=7, population=30)
    for draws in (other, third):
        assert draws.shares.tolist() == one.shares.tolist()
        assert draws.weights.tolist() == one.weights.tolist()
        assert draws.drawn == one.drawn


@pytest.mark.parametrize("calls", [10, 45, 150])
def test_a_posterior_that_is_stopped_goes_on_with_what_is_there(calls, tmp_path):
    def run(pool, folder=None):
        problem = linear(MATRIX, [0.4, 0.6, 1.0], 0.2, noise=0.1)
        return calls_of(lambda: posterior(problem, pool, seed=7, population=30, folder=folder))

    expected, whole = run(Pool())
    _, first = run(stopping(calls), tmp_path)
    with (tmp_path / "posterior.journal").open("a") as file:
        file.write('{"generation": 1, "ha')
    draws, second = run(Pool(), tmp_path)
    assert len(first) == calls
    assert draws.temperature == 1.0
    assert draws.shares.tolist() == expected.shares.tolist()
    assert len(first) + len(second) == len(whole)
    again, third = run(Pool(), tmp_path)
    assert third == []
    assert again.shares.tolist() == draws.shares.tolist()


def test_a_budget_ends_a_posterior_that_then_says_how_far_it_came(tmp_path):
    problem = linear(MATRIX, [0.4, 0.6, 1.0], 0.05)
    draws, calls = calls_of(
        lambda: posterior(problem, Pool(), seed=7, population=30, most=250, folder=tmp_path)
    )
    assert draws.temperature > 1.0
    assert len(calls) == 250
    with pytest.raises(FitFailed, match="first generation of 30 draws was not complete after 40"):
        posterior(problem, Pool(), seed=7, population=30, most=40)


def test_damaged_files_are_named(tmp_path):
    problem = linear(MATRIX, [0.4, 0.6, 1.0], 0.2)
    (tmp_path / "posterior.journal").write_text(json.dumps({"generation": 0}) + "\n")
    with pytest.raises(OutputError, match=r"posterior\.journal' is damaged"):
        posterior(problem, Pool(), population=20, folder=tmp_path)
    (tmp_path / "posterior.db").write_bytes(b"no database at all" * 100)
    with pytest.raises(OutputError, match=r"posterior\.db' cannot be used"):
        posterior(problem, Pool(), population=20, folder=tmp_path)
