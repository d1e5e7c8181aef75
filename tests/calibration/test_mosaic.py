"""Likelihood of data that jump: its weights and densities, and where it is taken."""

import numpy as np
import pytest
from cheap_fits import CASES, fitted, growing, jumping, linear, through
from scipy.stats import norm

from multicell.calibration.fitting.emulator import emulator
from multicell.calibration.fitting.likelihood import _is_worse
from multicell.calibration.fitting.mosaic import left_out, mosaic, mosaic_of
from multicell.calibration.fitting.pool import Pool
from multicell.calibration.fitting.search import Search

DATA = np.random.default_rng(5)
POINTS = DATA.random((12, 2))
JUMPS = np.where(POINTS[:, :1] > [0.3, 0.5, 0.7], 3.0, 0.0) + 0.05 * DATA.normal(size=(12, 3))


def test_density_far_from_runs_is_that_of_all_runs_and_at_a_run_its_own():
    found, _ = mosaic(POINTS, JUMPS, np.ones(3))
    own = norm.logpdf(JUMPS[0], scale=np.sqrt(1.0 + found.variances[0]))  # 1 + τ²
    wide = norm.logpdf(JUMPS.mean(axis=0), scale=np.sqrt(1.0 + JUMPS.var(axis=0)))
    assert found.likely[0] / found.likely[-1] == pytest.approx(np.exp(own - wide))
    near, far = found.loss(np.vstack([POINTS[0], [1e3, 1e3]]))
    assert far - near == pytest.approx(2.0 * (own - wide).sum(), abs=1e-2)


def test_data_far_from_all_runs_still_choose_the_nearest():
    """Densities that round to zero."""
    found, _ = mosaic(POINTS, JUMPS + 1e3, np.ones(3))
    losses = found.loss(POINTS)
    assert np.isfinite(losses).all()
    assert losses[np.argmin(JUMPS.sum(axis=1))] < losses[np.argmax(JUMPS.sum(axis=1))]


def test_a_lone_run_holds_for_an_exponential_distance():
    """Of a mosaic with random edges two places are in one tile with the probability exp(-r/l)."""
    far = np.vstack([[0.0, 0.0], [1e3, 0.0], [0.0, 1e3]])
    found, _ = mosaic(far, np.diag([0.0, 9.0, 9.0]), np.ones(3))
    place = np.array([[0.1, 0.2]])
    share = np.exp(-np.linalg.norm(place / found.lengths))
    wanted = share * found.likely[0] + (1.0 - share) * found.likely[-1]
    assert found.loss(place) == pytest.approx(-2.0 * np.log(wanted).sum(), rel=1e-5)


def test_leaving_out_is_what_processes_without_that_run_predict():
    known = through(POINTS, JUMPS)
    (column,) = known.processes[0].columns
    full = column.root @ column.root.T
    values = (known.residuals - column.centre) / column.width
    scores = left_out(known, np.full(3, 0.5))
    for k in range(len(POINTS)):
        rest = np.delete(np.arange(len(POINTS)), k)
        part = np.linalg.solve(full[np.ix_(rest, rest)], full[rest, k])
        spread = np.sqrt((full[k, k] - full[k, rest] @ part) * column.width**2 + 0.5)
        wanted = norm.logpdf((values[k] - part @ values[rest]) * column.width, scale=spread)
        assert scores[k] == pytest.approx(wanted, abs=1e-4)


def test_predictions_are_between_the_runs_of_both_sides():
    found, _ = mosaic(POINTS, JUMPS, np.full(3, 1e6))  # of data that say nothing
    means, variances = found.predict(POINTS.mean(axis=0)[None])
    assert (means > JUMPS.min()).all()
    assert (means < JUMPS.max()).all()
    assert (variances[0] < 1.2 * JUMPS.var(axis=0) + 1.0).all()


def test_a_prediction_at_a_run_is_that_run_however_far_from_its_datum():
    """It is of the model and knows the data by its runs alone."""
    far = 10.0 * JUMPS
    means, _ = mosaic(POINTS, far, np.ones(3))[0].predict(POINTS)
    np.testing.assert_allclose(means, far, atol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("name", list(CASES))
def test_smooth_data_and_data_that_scatter_have_no_mosaic(name):
    rng = np.random.default_rng(11)
    for _ in range(3):
        problem = growing(CASES[name], rng.random(2), rng)
        search = Search(problem, None, seed=1)
        search.run(Pool(), 30)
        known = search.emulator()
        assert mosaic_of(known, 1.0 + known.scatter) is None


@pytest.mark.slow
def test_data_that_jump_have_one():
    for seed in range(4):
        assert fitted(jumping(seed)).fresh.likelihood.mosaic is not None


def test_emulator_keeps_the_runs_that_it_goes_through():
    lost = np.vstack([JUMPS, np.full((1, 3), np.nan)])
    known = emulator(
        np.vstack([POINTS, [[0.5, 0.5]]]), lost, np.zeros_like(lost), (lost**2).sum(axis=1)
    )
    rows = [int(np.flatnonzero((p == POINTS).all(axis=1))[0]) for p in known.shares]
    assert sorted(rows) == list(range(12))
    assert (known.residuals == JUMPS[rows]).all()


@pytest.mark.parametrize(
    ("off", "worse", "counts"),
    [(0.0, False, False), (1e-15, False, False), (1e-5, True, False), (0.05, True, True)],
)
def test_worse_is_what_exceeds_rounding_and_counts_from_a_thousandth_of_a_deviation(
    off, worse, counts
):
    """Runs without scatter: a point is compared that is off by so many deviations."""
    problem = linear([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], [0.4, 0.6, 1.3], 0.05)
    search = Search(problem, None, seed=1)
    ran = min(search.run(Pool(), 20), key=lambda e: e.loss)
    sign = np.where(ran.misfit.residuals < 0.0, -1.0, 1.0)
    runs = (ran.misfit.means + sign * off * problem.sigma)[None]
    assert _is_worse(problem, ran.shares, runs, ran, search) == (worse, counts)


@pytest.mark.slow
def test_smooth_problems_without_scatter_do_not_contradict_themselves():
    rng = np.random.default_rng(2)
    matrix = [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, -1.0]]
    for _ in range(8):
        truth = np.asarray(matrix) @ rng.uniform(0.2, 0.8, 2) + 0.05 * rng.normal(size=4)
        found = fitted(linear(matrix, truth, 0.05, bend=0.3), points=20)
        assert found.contradictions == []
