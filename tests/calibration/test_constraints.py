"""Constraints between two free parameters: priors, posteriors, profiles, searches and refusals."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from cheap_fits import MATRIX, calls_of, exact, fitted, linear
from scipy import stats

import multicell as mc
from multicell.calibration.fitting.constraints import Constraints
from multicell.calibration.fitting.pool import Pool
from multicell.calibration.fitting.priors import Density, Prior
from multicell.calibration.fitting.problem import free_of
from multicell.calibration.fitting.profile import _profile
from multicell.calibration.fitting.search import Search
from multicell.errors import SceneError
from multicell.measured.data import read_data
from multicell.studies.axes import Range

RANGES = tuple(Range(f"toy.p{k}", 0.0, 1.0, "", False, f"p{k}", False) for k in range(2))
ORDER = Constraints.of("p0 < p1", RANGES)


def test_two_ordered_parameters_have_the_prior_of_order_statistics():
    prior = Prior(2, RANGES, constraints=ORDER)
    drawn = prior.draw(np.random.default_rng(1), 20_000)
    assert (drawn[:, 0] < drawn[:, 1]).all()
    for k, (a, b) in enumerate([(1, 2), (2, 1)]):  # the smaller and the larger of two
        assert stats.kstest(drawn[:, k], stats.beta(a, b).cdf).pvalue > 0.01
        at = np.linspace(0.05, 0.95, 7)
        np.testing.assert_allclose(prior.marginal(k, at), stats.beta(a, b).pdf(at), rtol=0.03)
        low, high = stats.beta(a, b).ppf([0.025, 0.975])
        assert prior.part(k, 0.95) == pytest.approx(high - low, rel=0.02)
    found = prior.loss(np.array([[0.2, 0.3], [0.3, 0.2], [0.4, 1.1]]))
    np.testing.assert_array_equal(np.isfinite(found), [True, False, False])


def test_without_constraints_draws_are_as_before():
    plain, random = Prior(2, RANGES), np.random.default_rng(3)
    np.testing.assert_array_equal(plain.draw(np.random.default_rng(3), 50), random.random((50, 2)))


def test_ranges_of_different_ends_and_scales_compare_values():
    ranges = (
        Range("toy.a", 1.0, 100.0, "mM", True, "a", False),
        Range("toy.b", 5.0, 20.0, "mM", False, "b", False),
        Range("toy.c", 10.0, 1000.0, "mM", True, "c", False),
    )
    orders = Constraints.of(["b > a", "toy.a < c"], ranges)
    assert orders.texts() == ["toy.a < toy.b", "toy.a < toy.c"]
    random = np.random.default_rng(2).random((500, 3))
    values = np.array([[f.value(x) for f, x in zip(ranges, row, strict=True)] for row in random])
    wanted = (values[:, 0] < values[:, 1]) & (values[:, 0] < values[:, 2])
    np.testing.assert_array_equal(orders.hold(random), wanted)
    for fixed in range(3):
        mended = orders.mended(random, fixed)
        np.testing.assert_array_equal(mended[:, fixed], random[:, fixed])
        cut = orders.apart()[fixed]
        possible = (values[:, fixed] > cut.low) & (values[:, fixed] < cut.high)
        assert orders.hold(mended)[possible].mean() > 0.99
        np.testing.assert_array_equal(mended[wanted], random[wanted])
    assert orders.apart()[0].high < 20.0 < orders.apart()[2].high


def constrained(values, sigma=0.15):
    return replace(linear(MATRIX, values, sigma), known=Prior(2, RANGES, constraints=ORDER))


def test_a_posterior_is_the_normal_one_cut_at_the_constraint():
    """Data that prefer p0 = 0.55, p1 = 0.45: draws against those of the exact posterior."""
    problem = constrained([0.55, 0.45, 1.0, 0.1])
    found, calls = calls_of(lambda: fitted(problem))
    assert all(shares[0] < shares[1] for shares, _, _ in calls)  # no run beyond it
    mean, covariance = exact(problem)
    drawn = np.random.default_rng(1).multivariate_normal(mean, covariance, 400_000)
    drawn = drawn[(drawn[:, 0] < drawn[:, 1]) & (drawn > 0).all(axis=1) & (drawn < 1).all(axis=1)]
    sample = found.sample
    assert (sample[:, 0] < sample[:, 1]).all()
    np.testing.assert_allclose(sample.mean(axis=0), drawn.mean(axis=0), atol=0.01)
    np.testing.assert_allclose(sample.std(axis=0), drawn.std(axis=0), rtol=0.06)
    best = list(found.best.values.values())
    np.testing.assert_allclose(best, [0.5, 0.5], atol=0.01)  # the least place on the line


def test_a_profile_follows_the_constraint():
    """-2 ln L of x and y apart: beyond the best y the larger one follows the smaller one."""
    centre, width = np.array([0.4, 0.5]), np.array([0.1, 0.05])

    def loss(shares):
        return (((shares - centre) / width) ** 2).sum(axis=1)

    rng = np.random.default_rng(1)
    drawn = (centre + width * rng.standard_normal((4000, 2))).clip(0.0, 1.0)
    drawn = drawn[drawn[:, 0] < drawn[:, 1]]
    found = _profile(loss, RANGES, 0, drawn, 41, ORDER)
    beyond = np.maximum(found.values - 0.5, 0.0)
    parabola = ((found.values - 0.4) / 0.1) ** 2 + (beyond / 0.05) ** 2
    assert (np.abs(found.loss - parabola) < 0.02 * (1.0 + parabola)).all()
    high = found.interval()[1]
    root = 0.4 + 0.1 * math.sqrt(stats.chi2.ppf(0.95, 1))
    assert 0.5 < high < root - 0.02  # the constraint bounds it more closely


def test_a_search_continues_with_the_same_points(tmp_path):
    problem = constrained([0.3, 0.6, 0.9, -0.3])
    first = Search(problem, tmp_path / "a.log").run(Pool(), 26)
    Search(problem, tmp_path / "b.log").run(Pool(), 20)
    again = Search(problem, tmp_path / "b.log").run(Pool(), 26)
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.shares, other.shares)
        assert one.shares[0] < one.shares[1]


REST, DEATH = "nutrients.oxygen.quiescence", "nutrients.oxygen.necrosis"
OVERLAPPING = {REST: "0.005:0.05 mM", DEATH: "0.002:0.06 mM"}


def table():
    return read_data({"time / h": [24.0], "diameter / um": [100.0]}, mc.load_scene("spheroid"))


def test_ranges_that_overlap_are_searched_where_the_scene_exists():
    """A necrosis above quiescence is refused by scenes, so that it needs the constraint."""
    with pytest.raises(SceneError, match="must be below quiescence"):
        free_of(OVERLAPPING, table())
    ranges, prior = free_of(OVERLAPPING, table(), ["necrosis < quiescence"])
    assert [free.low for free in ranges] == [0.005, 0.002]  # searched as given
    assert prior.describe() == {"constraints": [f"{DEATH} < {REST}"]}
    scene = mc.load_scene("spheroid")
    for place in prior.draw(np.random.default_rng(0), 20):
        keys = zip(ranges, place, strict=True)
        scene.with_changes({free.key: free.value(float(x)) for free, x in keys})


@pytest.mark.parametrize(
    ("texts", "said"),
    [
        ("necrosis", "which is no order. Write 'necrosis < quiescence'"),
        ("necrosis <= quiescence", "which is no order"),
        ("necrosis < quiescense", r"name 'quiescense', which is not free\. Did you mean"),
        ("necrosis < necrosis", "compare necrosis with itself"),
        ("necrosis < cycle_time", r"compare necrosis \(mM\) with cycle_time \(s\)"),
        (["necrosis < quiescence", "necrosis > quiescence"], "leave less than 1 %"),
        ("quiescence < necrosis", "must be below quiescence"),
    ],
)
def test_what_is_no_constraint_is_refused(texts, said):
    free = OVERLAPPING | {"growth.cycle_time": "10:30 h"}
    with pytest.raises(SceneError, match=said):
        free_of(free, table(), texts)


def test_distributions_are_cut_too():
    densities = (Density("norm", (), 0.5, 0.1), None)
    prior = Prior(2, RANGES, densities, ORDER)
    drawn = prior.draw(np.random.default_rng(1), 20_000)
    # p(p0) times the chance 1 - p0 of a larger uniform number
    at = np.linspace(0.2, 0.8, 7)
    wanted = densities[0].frozen.pdf(at) * (1.0 - at) / 0.5
    np.testing.assert_allclose(prior.marginal(0, at), wanted, rtol=0.03)
    assert drawn[:, 0].mean() == pytest.approx(0.5 - 0.01 / 0.5, abs=0.003)
