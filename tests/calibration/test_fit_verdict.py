"""The best of a fit is never worse than what ran, and a fit that does not fit states it first."""

import re

import numpy as np
import pytest
from cheap_fits import SCENE, Growing, fitted, growing, jumping, jumping_from, linear

from multicell.calibration.fitting.page import data_in_words
from multicell.calibration.fitting.plan import FitPlan, make_runs
from multicell.calibration.fitting.pool import Pool
from multicell.calibration.fitting.verdict import intervals

LEVELS = 0.8, 0.95


def least(found):
    return min(e.misfit.chi_squared for e in found.evaluations)


@pytest.mark.parametrize("seed", range(8))
def test_best_is_no_worse_than_the_best_run(seed):
    """Problems whose readings jump, so that an emulator misses what runs found."""
    assert_no_worse(fitted(jumping(seed), points=30))


@pytest.mark.harness
@pytest.mark.slow
def test_best_of_many_fits_is_no_worse_than_the_best_run(request):
    """As many further problems as the option --calibrations asks for.

    80 and 95 % intervals hold the truth as often, but for chance; the exact posterior's are printed
    beside them.
    """
    count = request.config.getoption("--calibrations")
    if count == 0:
        pytest.skip("asked for with --calibrations N")
    hits, exact = [], []
    for seed in range(8, 8 + count):
        problem, truth = jumping_from(seed)
        found = fitted(problem, points=30)
        assert_no_worse(found)
        sample = exact_draws(problem)
        for known, draws in ((hits, found.some_sample()), (exact, sample)):
            both = [intervals(problem.ranges, draws, level) for level in LEVELS]
            known.append([[x in i[f"p{k}"] for k, x in enumerate(truth)] for i in both])
    for words, known in (("80 and 95 % intervals", hits), ("those of the exact posterior", exact)):
        shares = np.mean(known, axis=(0, 2))
        print(f"{words} hold the truth:", shares.tolist(), np.mean(known, axis=0).tolist())
        # both parameters of a problem may miss together
        for level, share in zip(LEVELS, shares, strict=True):
            assert share >= level - 3.0 * np.sqrt(level * (1.0 - level) / count)


def exact_draws(problem):
    """Return places of a dense grid, as often as the exact likelihood has them."""
    middle = (np.arange(400) + 0.5) / 400
    places = np.stack(np.meshgrid(middle, middle, indexing="ij"), axis=-1).reshape(-1, 2)
    toy = problem.simulator
    along = places @ np.asarray(toy.ways).T
    readings = 5.0 * places.sum(axis=1)[:, None] + np.zeros(len(problem.sigma))
    steps = np.transpose(toy.heights), np.transpose(toy.places), along.T
    for heights, edges, way in zip(*steps, strict=True):
        readings += heights * (way[:, None] > edges)
    assert readings[7] == pytest.approx(toy(places[7], 0, 0).values)
    loss = (((readings - problem.observed) / problem.sigma) ** 2).sum(axis=1)
    chance = np.exp(-0.5 * (loss - loss.min()))
    return np.random.default_rng(0).choice(places, 4000, p=chance / chance.sum())


def assert_no_worse(found):
    assert found.best.chi_squared <= least(found) * (1.0 + 1e-9)
    if found.best.chi_squared > 40.0:
        assert found.notes[0] == found.misfit
        assert f"{found.best.chi_squared:.4g}" in found.misfit
    assert bool(found.misfit) is (found.chance < 1e-3)


def plan_of(problem, points, extra):
    return FitPlan(problem, SCENE, None, points, 0.1, 6, extra=extra)


@pytest.mark.slow
def test_what_contradicts_itself_leads_to_more_runs():
    tried = {}
    for extra in (0, 16):
        for seed in range(6):
            found = make_runs(plan_of(jumping(seed), 20, extra), None, Pool())
            tried[extra, seed] = len(found.evaluations)
            if found.contradictions:
                assert len(found.evaluations) == 20 + extra
                assert found.summary()["contradictions"] == found.contradictions
                assert all(words in found.notes for words in found.contradictions)
    assert all(tried[0, seed] == 20 for seed in range(6))
    assert any(tried[16, seed] > 20 for seed in range(6))


def test_a_smooth_problem_fits_without_contradiction():
    found = fitted(linear([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], [0.4, 0.6, 1.0], 0.05))
    assert found.misfit == ""
    assert found.contradictions == []
    assert found.summary()["fits"] is True


def test_a_fit_that_does_not_fit_says_which_data():
    found = fitted(linear([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], [0.4, 0.6, 9.0], 0.05))
    assert found.notes[0].startswith("The scene does not fit the data: χ² is ")
    worst = int(np.argmax(np.abs(found.best.residuals)))
    assert f"(row {worst})" in found.misfit
    assert sorted(re.findall(r"at (\S+ \w+) \(row", found.misfit)) == ["1 h", "2 h", "3 h"]
    assert [row["when"] for row in data_in_words(found)] == ["1 h", "2 h", "3 h"]
    assert found.summary()["fits"] is False
    (axes,) = found.plot.deviations().axes
    drawn = np.concatenate([line.get_ydata() for line in axes.lines if line.get_marker() == "o"])
    assert drawn == pytest.approx(found.best.residuals)


@pytest.mark.slow
def test_scatter_alone_does_not_choose_a_lucky_run():
    """Runs that scatter as much as the data: the emulator's best stands in most problems."""
    rng = np.random.default_rng(3)
    missed = [
        fitted(growing(Growing("independent", common=False), (0.5, 0.5), rng)).fresh.missed
        for _ in range(10)
    ]
    assert sum(missed) <= 1
