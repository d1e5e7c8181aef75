"""Profile likelihood against closed forms, its coverage, and posteriors for other packages."""

from __future__ import annotations

import json
import math
import sys
from types import ModuleType

import numpy as np
import pytest
from cheap_fits import CASES, Growing, check, growing
from click.testing import CliRunner
from scipy import stats

import multicell as mc
from multicell.calibration.fitting.likelihood import fresh
from multicell.calibration.fitting.pool import Pool
from multicell.calibration.fitting.profile import _profile
from multicell.calibration.fitting.search import Search
from multicell.cli.main import main
from multicell.errors import SceneError
from multicell.studies.axes import Range

RANGES = tuple(Range(f"toy.p{k}", 0.0, 2.0, "", False, f"p{k}", False) for k in range(3))
PRECISION = np.array([[300.0, 120.0, 0.0], [120.0, 200.0, 40.0], [0.0, 40.0, 100.0]])
CENTRE = np.array([0.4, 0.55, 0.5])


def quadratic(shares):
    away = shares - CENTRE
    return 7.0 + np.einsum("ki,ij,kj->k", away, PRECISION, away)


def draws_of(loss, count=2000):
    covariance = np.linalg.inv(PRECISION)
    return np.random.default_rng(1).multivariate_normal(CENTRE, covariance, count).clip(0.0, 1.0)


@pytest.mark.parametrize("place", range(3))
def test_the_profile_of_a_normal_likelihood_is_a_parabola(place):
    """-2 ln L = (x - m)² / (P⁻¹)_kk: where the other parameters follow, and the interval."""
    found = _profile(quadratic, RANGES, place, draws_of(quadratic), 41)
    variance = np.linalg.inv(PRECISION)[place, place]
    shares = found.values / 2.0
    # where the others reach an end of their ranges they cannot follow
    free = (found.others > 1e-6).all(axis=1) & (found.others < 1.0 - 1e-6).all(axis=1)
    assert free.sum() > 20
    parabola = (shares - CENTRE[place]) ** 2 / variance
    np.testing.assert_allclose(found.loss[free], parabola[free], atol=1e-3)
    assert (found.loss >= parabola - 1e-6).all()
    assert found.best == pytest.approx(2.0 * CENTRE[place], abs=1e-3)
    for level in (0.8, 0.95):
        reach = math.sqrt(stats.chi2.ppf(level, 1) * variance)
        ends = [2.0 * (CENTRE[place] - reach), 2.0 * (CENTRE[place] + reach)]
        assert found.interval(level) == pytest.approx(ends, abs=2e-3)
    assert found.identified()


def test_a_parameter_that_data_do_not_bound_has_no_end():
    """Data of x - y alone say nothing of either; data of x ≥ a say half of it."""
    ridge = _profile(lambda s: 1e4 * (s[:, 0] - s[:, 1]) ** 2, RANGES[:2], 0,
                     np.random.default_rng(1).random((500, 2)), 21)  # fmt: skip
    assert ridge.interval() == (-math.inf, math.inf)
    assert not ridge.identified()
    assert ridge.loss.max() < 1e-3
    half = _profile(lambda s: 1e4 * np.minimum(s[:, 0] - 0.5, 0.0) ** 2, RANGES[:1], 0,
                    0.5 + 0.5 * np.random.default_rng(1).random((500, 1)), 41)  # fmt: skip
    low, high = half.interval()
    assert low == pytest.approx(2.0 * (0.5 - math.sqrt(stats.chi2.ppf(0.95, 1) / 1e4)), abs=0.02)
    assert high == math.inf


@pytest.mark.harness
@pytest.mark.parametrize("case", ["independent", "shared over time", "random walk"])
def test_intervals_of_profiles_cover_as_often_as_they_say(case, request):
    count = request.config.getoption("--calibrations")
    if count == 0:
        pytest.skip("asked for with --calibrations N")
    rng, hits = np.random.default_rng(3), []
    for _ in range(count):
        truth = 0.2 + 0.6 * rng.random(2)
        problem = growing(CASES[case], truth, rng)
        search = Search(problem, None)
        search.run(Pool(), 30)
        known = fresh(problem, search, Pool()).likelihood
        profiles = [_profile(known.loss, problem.ranges, k, known.draws(), 31) for k in range(2)]
        inside = [
            [low <= x <= high for x, (low, high) in
             zip(truth, (p.interval(level) for p in profiles), strict=True)]
            for level in (0.8, 0.95)
        ]  # fmt: skip
        hits.append(inside)
    check(hits)


@pytest.fixture(scope="module")
def fit():
    problem = growing(Growing("independent"), np.array([0.4, 0.6]), np.random.default_rng(5))
    scene = mc.load_scene("growth")
    search = Search(problem, None)
    tried = search.run(Pool(), 30)
    again = fresh(problem, search, Pool())
    from multicell.calibration.fitting.result import Fit

    return Fit(problem, scene, tried, None, {"sd": 0.1}, again, search.readings)


def test_a_fit_has_profiles_by_name_or_key(fit):
    found = fit.profile("p0", 15)
    np.testing.assert_array_equal(found.loss, fit.profile("toy.p0", 15).loss)
    low, high = found.interval()
    wide = fit.intervals()["p0"]
    assert abs(low - wide.low) < 0.3 * (wide.high - wide.low)
    assert abs(high - wide.high) < 0.3 * (wide.high - wide.low)
    with pytest.raises(SceneError, match="is no parameter of the fit"):
        fit.profile("p9x")
    assert len(fit.plot.profile().axes) == 2


@pytest.mark.slow
def test_the_command_prints_intervals_and_draws(fit, tmp_path, monkeypatch):
    monkeypatch.setattr("multicell.calibration.fitting.stored.load_fit", lambda folder: fit)
    picture = tmp_path / "p.png"
    done = CliRunner().invoke(main, ["profile", "fit", "-o", str(picture), "--json"])
    assert done.exit_code == 0, done.output
    rows = json.loads(done.output)
    assert [row["name"] for row in rows] == ["p0", "p1"]
    assert rows[0]["interval"] == pytest.approx(fit.profile("p0").interval())
    assert picture.stat().st_size > 10_000
    narrow = CliRunner().invoke(main, ["profile", "fit", "--level", "0.5"])
    assert "50 % interval" in narrow.output
    assert CliRunner().invoke(main, ["profile", "fit", "--level", "2"]).exit_code == 2


def test_posteriors_are_arrays_with_units_and_groups_of_arviz(fit):
    table = fit.to_xarray()
    np.testing.assert_array_equal(table["p1"].values[0], fit.posterior["p1"])
    assert table["p1"].attrs["range"] == [0.0, 1.0]
    arviz = pytest.importorskip("arviz")
    found = fit.to_arviz()
    posterior = found["posterior"]
    np.testing.assert_array_equal(np.asarray(posterior["p0"])[0], fit.posterior["p0"])
    np.testing.assert_array_equal(
        np.asarray(found["observed_data"]["data"]).ravel(),
        [datum.value for datum in fit.problem.measured.data],
    )
    assert np.asarray(found["posterior_predictive"]["data"]).shape[-1] == 12
    assert {"p0", "p1"} <= set(arviz.summary(found).index)


def one_dictionary(data, **more):
    """Take groups as ArviZ does from version 1 on."""
    return "one", data, more


def arguments(posterior=None, log_likelihood=None, posterior_predictive=None, observed_data=None):
    """Take groups as ArviZ did before version 1."""
    groups = {
        "posterior": posterior,
        "log_likelihood": log_likelihood,
        "posterior_predictive": posterior_predictive,
        "observed_data": observed_data,
    }
    return "arguments", groups, {}


@pytest.mark.parametrize("from_dict", [one_dictionary, arguments])
def test_both_ways_in_which_arviz_takes_groups_have_the_same(fit, from_dict, monkeypatch):
    stand_in = ModuleType("arviz")
    stand_in.from_dict = from_dict
    monkeypatch.setitem(sys.modules, "arviz", stand_in)
    monkeypatch.setattr("multicell.calibration.fitting.result.needs", lambda *names: None)
    kind, groups, more = fit.to_arviz()
    assert kind == {"one_dictionary": "one"}.get(from_dict.__name__, "arguments")
    assert more == {}
    draws = len(fit.posterior)
    assert groups["posterior"]["p0"].shape == (1, draws)
    np.testing.assert_array_equal(groups["posterior"]["p1"][0], fit.posterior["p1"])
    assert groups["log_likelihood"]["data"].shape == (1, draws)
    assert groups["posterior_predictive"]["data"].shape == (1, draws, 12)
    assert groups["observed_data"]["data"].shape == (12,)
