"""Distances against closed forms; the search against problems whose best point is known."""

from __future__ import annotations

import math

import numpy as np
import optuna
import pytest
from cheap_fits import (
    MATRIX,
    Growing,
    Linear,
    calls_of,
    exact,
    linear,
    measured,
    stopping,
    through,
)
from scipy import stats

from multicell.calibration.fitting.emulator import draws, emulator
from multicell.calibration.fitting.pool import Pool
from multicell.calibration.fitting.priors import Prior
from multicell.calibration.fitting.problem import (
    ABSENT_DEVIATIONS,
    FitProblem,
    groups_of,
    misfit,
)
from multicell.calibration.fitting.search import Search
from multicell.calibration.fitting.simulator import Reading
from multicell.errors import FitFailed
from multicell.measured.noise import Noise


def test_the_loss_is_the_normal_likelihood_of_the_data_in_closed_form():
    y, sigma = np.array([1.0, 2.0, 3.0]), np.array([0.1, 0.2, 0.3])
    runs = np.array([[1.1, 2.5, 2.9], [0.9, 2.1, 3.5], [1.3, 2.2, 3.4]])
    found = misfit(y, sigma, runs)
    spread = np.sqrt(sigma**2 + runs.var(axis=0, ddof=1) * (1 + 1 / 3))
    ours = [found.loss - misfit(y, sigma, runs + shift).loss for shift in (0.0, 0.2, -0.4)]
    logs = [stats.norm.logpdf(y, runs.mean(axis=0) + s, spread).sum() for s in (0.0, 0.2, -0.4)]
    np.testing.assert_allclose(ours, [-2.0 * (logs[0] - log) for log in logs], rtol=1e-12)
    assert found.chi_squared == pytest.approx((((runs.mean(axis=0) - y) / spread) ** 2).sum())
    assert found.per_datum == pytest.approx(found.chi_squared / 3)


def test_one_run_has_no_scatter_and_absent_readings_cost_more_than_any_other():
    y, sigma = np.array([1.0, 2.0]), np.array([0.5, 0.5])
    found = misfit(y, sigma, np.array([[1.5, math.nan]]))
    assert found.residuals.tolist() == [1.0, ABSENT_DEVIATIONS]
    assert found.loss == 1.0 + ABSENT_DEVIATIONS**2


def test_scatter_of_runs_alone_makes_no_parameters_better():
    """The variance that runs add must not hide that they are off: its logarithm counts."""
    y, sigma = np.zeros(3), np.ones(3)
    calm = misfit(y, sigma, np.array([[0.5] * 3, [0.5] * 3]))
    wild = misfit(y, sigma, np.array([[20.5] * 3, [-19.5] * 3]))
    assert wild.chi_squared < calm.chi_squared
    assert wild.loss > calm.loss


def test_a_core_that_has_not_begun_leaves_the_scatter_of_other_times_alone():
    """Two runs 0.3 um apart at a measured 0: the scatter of the data at 50 and 100 um was 2 mm."""
    values, sigma = np.array([0.0, 0.0, 50.0, 100.0]), 10.0
    data = measured(values, sigma).data
    runs = np.array([[0.3, 0.0, 47.0, 95.0], [0.0, 0.0, 53.0, 105.0]])
    found = misfit(values, np.full(4, sigma), runs, groups_of(data))
    pooled = np.mean(runs.var(axis=0, ddof=1))  # um^2, as much as 4 degrees of freedom
    expected = (runs.var(axis=0, ddof=1) + 4.0 * pooled) / 5.0
    np.testing.assert_allclose(found.scatter, expected, rtol=1e-12)


def test_what_grows_has_its_scatter_pooled_in_proportion():
    values, runs = np.array([10.0, 1000.0]), np.array([[9.0, 900.0], [11.0, 1100.0]])
    found = misfit(values, np.ones(2), runs, groups_of(measured(values, 1.0).data))
    np.testing.assert_allclose(found.scatter, [2.0, 20_000.0], rtol=1e-12)


def test_means_of_tissues_share_their_scatter_and_standard_errors_hold_it():
    y, sigma, runs = np.zeros(3), np.ones(3), np.array([[1.0] * 3, [5.0] * 3])
    found = misfit(y, sigma, runs, None, Noise.of_means(np.array([1.0, 4.0, np.inf])))
    variance = 8.0  # of the runs, which are two
    expected = 3.0 / np.sqrt(1.0 + variance * (np.array([1.0, 0.25, 0.0]) + 0.5))
    np.testing.assert_allclose(found.residuals, expected, rtol=1e-12)


def test_processes_follow_runs_that_are_smooth():
    rng = np.random.default_rng(3)
    problem = linear(MATRIX, [0.4, 0.6, 1.0, -0.2], 0.05, bend=0.3)
    shares = rng.random((30, 2))
    runs = np.array([problem.simulator(x, 0, 0).values for x in shares])
    residuals = (runs - problem.observed) / problem.sigma
    found = through(shares, residuals)
    elsewhere = rng.random((50, 2))
    truth = np.array([problem.simulator(x, 0, 0).values for x in elsewhere])
    expected = (truth - problem.observed) / problem.sigma
    means, variances = found.predict(elsewhere)
    np.testing.assert_allclose(means, expected, atol=0.02)
    assert np.sqrt(variances).max() < 0.1
    np.testing.assert_allclose(found.loss(elsewhere), (expected**2).sum(axis=1), atol=0.5)


def test_processes_follow_the_kink_where_a_core_begins_and_know_their_error():
    """A core of radius max(0, size - rim): 0.09 sigma off where zeros were readings like others."""
    rng = np.random.default_rng(1)
    simulator, sigma = Growing("independent", noise=0.0, kink=True), 4.0
    truth = np.array([0.5, 0.4])
    shares = np.vstack([rng.random((16, 2)), truth + rng.normal(0.0, 0.12, (24, 2))]).clip(0, 1)
    data = simulator.mean(truth)
    residuals = (np.array([simulator.mean(x) for x in shares]) - data) / sigma
    names, lowest = ["diameter"] * 6 + ["necrotic_radius"] * 6, -data / sigma
    found = through(shares, residuals, observables=names, lowest=lowest)
    elsewhere = (truth + rng.normal(0.0, 0.1, (300, 2))).clip(0.0, 1.0)
    means, variances = found.predict(elsewhere)
    away = means - (np.array([simulator.mean(x) for x in elsewhere]) - data) / sigma
    error = np.sqrt((away**2).mean())
    assert error < 0.04
    assert 0.2 < error / np.sqrt(variances.mean()) < 2.0
    assert (means - lowest).min() >= 0.0


def test_zeros_that_contradict_their_neighbours_are_taken_for_scatter():
    """Every second reading is zero where the others rise evenly from 5 to 10."""
    shares = np.linspace(0.0, 1.0, 24)[:, None]
    values = np.where(np.arange(24) % 2, 0.0, 5.0 + 5.0 * shares[:, 0])[:, None]
    found = emulator(shares, values, np.zeros((24, 1)), np.ones(24), lowest=np.zeros(1))
    means, variances = found.predict(np.linspace(0.0, 1.0, 7)[:, None])
    assert np.isfinite(variances).all()
    # half of all readings are above zero: so is a signed quantity that scatters this much
    assert 0.0 < means.min() <= means.max() < 5.0
    assert variances.min() > 1.0


@pytest.mark.parametrize("seed", [0, 3, 7])
def test_wrong_zeros_anywhere_leave_an_emulator_within_what_was_read(seed):
    rng = np.random.default_rng(seed)
    shares = rng.random((30, 2))
    right = 3.0 + shares @ rng.uniform(0.0, 4.0, (2, 3))
    values = np.where(rng.random((30, 3)) < 0.05 * (seed + 1), 0.0, right)
    found = emulator(shares, values, np.zeros((30, 3)), np.ones(30), lowest=np.zeros(3))
    means, variances = found.predict(rng.random((50, 2)))
    assert np.isfinite(variances).all()
    assert 0.0 <= means.min() <= means.max() < 1.3 * right.max()


def test_too_few_points_make_no_emulator():
    shares = np.array([[0.1, 0.2], [0.3, 0.4], [0.5, 0.9], [0.2, 0.2]])
    none = emulator(shares, np.ones((4, 3)), np.zeros((4, 3)), np.ones(4))
    assert none is None
    five = np.vstack([shares, [[0.9, 0.1]]])
    some = emulator(five, np.ones((5, 3)), np.zeros((5, 3)), np.ones(5))
    np.testing.assert_allclose(some.means(five), 1.0, atol=1e-3)


@pytest.mark.parametrize("bend", [0.0, 0.5])
def test_the_search_finds_the_best_point_in_few_runs(bend):
    problem = linear(MATRIX, [0.45, 0.62, 1.01, -0.21], 0.05, bend=bend)
    known = Search(problem, None, seed=1).run(Pool(), 30)
    best = min(known, key=lambda e: e.misfit.loss)
    straight, _ = exact(problem)
    x = (np.sqrt(1.0 + 4.0 * bend * straight) - 1.0) / (2.0 * bend) if bend else straight
    np.testing.assert_allclose(best.shares, x, atol=0.01)
    assert len(known) == 30


def test_scatter_of_runs_widens_what_the_data_leave_open():
    """With many seeds the draws' variance is that of σ² + s²."""
    noisy = linear(MATRIX, [0.45, 0.62, 1.01, -0.21], 0.02, noise=0.04, seeds=60)
    search = Search(noisy, None, seed=1)
    search.run(Pool(), 30)
    found = search.emulator()
    drawn = draws(found.loss, Prior(2), seed=2, count=3_000)
    _, covariance = exact(noisy)
    np.testing.assert_allclose(drawn.std(axis=0), np.sqrt(np.diag(covariance)), rtol=0.2)


def test_all_points_have_the_same_random_numbers():
    problem = linear(MATRIX, [0.4, 0.6, 1.0, -0.2], 0.05, noise=0.1, seeds=3)
    _, calls = calls_of(lambda: Search(problem, None).run(Pool(), 12))
    seeds = {}
    for shares, _, seed in calls:
        seeds.setdefault(shares, []).append(seed)
    assert len(seeds) == 12
    assert all(sorted(used) == [0, 1, 2] for used in seeds.values())


@pytest.mark.parametrize("calls", [1, 33])
def test_a_search_that_is_stopped_goes_on_with_what_is_there(calls, tmp_path):
    problem = linear(MATRIX, [0.4, 0.6, 1.0, -0.2], 0.05, noise=0.1, seeds=2)
    path = tmp_path / "search.log"
    whole = Search(problem, None, seed=4).run(Pool(), 25)
    _, first = calls_of(lambda: Search(problem, path, seed=4).run(stopping(calls), 25))
    with path.open("a") as file:
        file.write('{"op_code": 6, "half')  # what a kill leaves of a line
    known, second = calls_of(lambda: Search(problem, path, seed=4).run(Pool(), 25))
    assert (len(first), len(second)) == (calls, 50 - calls)
    assert [e.shares.tolist() for e in known] == [e.shares.tolist() for e in whole]
    assert [e.misfit.loss for e in known] == [e.misfit.loss for e in whole]


@pytest.mark.parametrize("asked", [0, 4])
def test_half_a_batch_is_forgotten(asked, tmp_path, monkeypatch):
    """A search that is stopped while it asks for its next points."""
    problem = linear(MATRIX, [0.4, 0.6, 1.0, -0.2], 0.05, noise=0.1, seeds=2)
    path = tmp_path / "search.log"
    whole = Search(problem, None, seed=4).run(Pool(), 25)
    Search(problem, path, seed=4).run(Pool(), 15)
    left = [asked]
    ask = optuna.Study.ask

    def asking(*arguments):
        if left[0] == 0:
            raise KeyboardInterrupt
        left[0] -= 1
        return ask(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(optuna.Study, "ask", asking)
        with pytest.raises(KeyboardInterrupt):
            Search(problem, path, seed=4).run(Pool(), 25)
    known = Search(problem, path, seed=4).run(Pool(), 25)
    assert [e.shares.tolist() for e in known] == [e.shares.tolist() for e in whole]


class Failing:
    def __call__(self, shares, condition, seed):
        return Reading((math.nan,) * 4, "step failed (t = 7 s): too stiff")


def test_a_search_whose_runs_all_fail_says_why():
    good = linear(MATRIX, [0.4, 0.6, 1.0, -0.2], 0.05)
    problem = FitProblem(good.measured, good.ranges, Failing(), (0,))
    with pytest.raises(FitFailed, match=r"no run of the first 5 .* too stiff"):
        Search(problem, None).run(Pool(), 30)


class Patchy(Linear):
    def __call__(self, shares, condition, seed):
        if shares[0] > 0.7:
            return Reading((math.nan,) * 4, "burst")
        return super().__call__(shares, condition, seed)


def test_parameters_whose_runs_fail_are_avoided():
    good = linear(MATRIX, [0.69, 0.6, 1.29, 0.09], 0.05)
    problem = FitProblem(good.measured, good.ranges, Patchy(good.simulator.matrix), (0,))
    known = Search(problem, None).run(Pool(), 40)
    best = min(known, key=lambda e: e.misfit.loss)
    np.testing.assert_allclose(best.shares, [0.69, 0.6], atol=0.02)
    assert any(e.reasons for e in known)
