"""Normal and log-normal priors: closed forms, what is run, bad input."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from cheap_fits import MATRIX, exact, linear
from scipy import integrate, stats

import multicell as mc
from multicell.calibration.fitting.constraints import values_at
from multicell.calibration.fitting.emulator import best_of, draws
from multicell.calibration.fitting.fit import plan_fit
from multicell.calibration.fitting.pool import Pool
from multicell.calibration.fitting.priors import Density, Prior
from multicell.calibration.fitting.problem import free_of
from multicell.calibration.fitting.search import Search
from multicell.calibration.fitting.simulator import SceneSimulator
from multicell.calibration.fitting.verdict import undetermined
from multicell.measured.data import read_data

SCENE = mc.load_scene("growth").with_changes(
    {"duration": "20 h", "initial.count": 6, "coupling_step": "1 h"}
)
DATA = {"time / h": [10, 20], "cells": [7, 9]}
CYCLE = "growth.cycle_time"


def priors(free):
    return free_of(free, read_data(DATA, SCENE))


@pytest.mark.parametrize(
    ("text", "expected", "log"),
    [
        ("norm(18 h, 2 h)", stats.norm(64800.0, 7200.0), False),
        ("lognorm(median=18 h, sigma=0.3)", stats.lognorm(0.3, scale=64800.0), True),
    ],
)
def test_a_distribution_is_scipys_with_units(text, expected, log):
    (free,), prior = priors({CYCLE: text})
    assert free.log is log
    low, high = expected.ppf([0.0005, 0.9995])
    assert (free.low, free.high) == pytest.approx((low, high), rel=1e-12)
    even = np.linspace(0.0, 1.0, 41)
    places = prior.places(even[:, None])[:, 0]
    np.testing.assert_allclose(
        expected.cdf(values_at(free, places)), 0.0005 + 0.999 * even, atol=1e-9
    )

    def density(place):
        return math.exp(-0.5 * prior.loss(np.array([[place]]))[0])

    assert integrate.quad(density, 0.0, 1.0)[0] == pytest.approx(1.0, rel=1e-6)
    below = integrate.quad(density, 0.0, float(places[10]))[0]
    assert below == pytest.approx(0.25, rel=1e-6)
    assert prior.part(0, 0.5) == pytest.approx(places[30] - places[10], rel=1e-9)


def test_a_distribution_is_cut_to_the_range_behind_in():
    (free,), prior = priors({CYCLE: "norm(18 h, 2 h) in 17:30 h"})
    assert (free.low, free.high) == (17 * 3600.0, 30 * 3600.0)
    cut = stats.truncnorm(-0.5, 6.0, 18.0, 2.0)
    found = values_at(free, prior.draw(np.random.default_rng(1), 4000)[:, 0]) / 3600.0
    assert stats.kstest(found, cut.cdf).pvalue > 0.01
    (free,), _ = priors({CYCLE: "lognorm(median=18 h, sigma=0.3) in 10:30 h"})
    assert free.log


def with_prior(problem, *densities):
    return replace(problem, known=Prior(len(problem.ranges), problem.ranges, densities))


PULL = Density("norm", (), 0.6, 0.04)


def shrunk(problem):
    """Return mean and covariance of the posterior of a linear problem with PULL on p0."""
    mean, covariance = exact(problem)
    precision = np.linalg.inv(covariance)
    more = np.diag([1.0 / PULL.scale**2, 0.0])
    after = np.linalg.inv(precision + more)
    return after @ (precision @ mean + more @ [PULL.loc, 0.0]), after


@pytest.mark.slow
def test_a_normal_prior_shrinks_the_posterior_as_in_closed_form():
    problem = linear(MATRIX, [0.45, 0.6, 1.0, -0.2], 0.05)
    mean, covariance = shrunk(problem)
    problem = with_prior(problem, PULL, None)
    search = Search(problem, None, seed=1)
    search.run(Pool(), 30)
    found = search.emulator()
    drawn = draws(found.loss, found.prior, seed=1, count=20_000)
    np.testing.assert_allclose(drawn.mean(axis=0), mean, atol=0.002)
    np.testing.assert_allclose(np.cov(drawn.T), covariance, atol=0.08 * covariance.max())
    np.testing.assert_allclose(best_of(found.loss, found.prior, drawn), mean, atol=0.002)


def test_what_the_data_leave_as_it_was_beforehand_is_said_to_be_open():
    problem = linear([[1.0, 0.0]] * 3, [0.5] * 3, 0.02)
    problem = with_prior(problem, None, PULL)
    drawn = problem.prior.draw(np.random.default_rng(0), 4000)
    drawn[:, 0] = 0.5 + 0.01 * np.random.default_rng(1).standard_normal(4000)
    (entry,) = undetermined(problem.ranges, drawn, problem.prior)
    assert (entry.names, entry.kind) == (("p1",), "open")
    assert "of its range, 16 % beforehand" in str(entry)
    assert undetermined(problem.ranges, drawn) == []


def test_another_prior_is_another_fit():
    plain = plan_fit(SCENE, DATA, {CYCLE: "10:30 h"}).describe()
    known = plan_fit(SCENE, DATA, {CYCLE: "norm(18 h, 2 h) in 10:30 h"}).describe()
    assert set(known) - set(plain) == {"densities"}
    assert {key: known[key] for key in plain} == plain


REFUSED = [
    ("norm(18 um, 2 h)", "is '18 um', must be a time"),
    ("norm(18 h)", "has 'norm(18 h)', must be norm or lognorm with two arguments"),
    (
        "norm(18 h, 2 h, 3 h)",
        "has 'norm(18 h, 2 h, 3 h)', must be norm or lognorm with two arguments",
    ),
    ("norm(18 h, -2 h)", "has 'norm(18 h, -2 h)', whose deviation or median is not above 0"),
    ("lognorm(median=0 h, sigma=0.3)", "whose deviation or median is not above 0"),
    (
        "gamma(9, scale=2 h)",
        "has 'gamma(9, scale=2 h)', must be norm or lognorm with two arguments",
    ),
    ("lognorm(median=18 h, sigma=0.3 h)", "has '0.3 h' in its distribution, must have no unit"),
    ("norm(18 h, 10 h)", "(a thousandth beyond). Cut the distribution"),
    ("norm(18 h, 2 h) in 100:200 h", "next to nothing in 360000 to 720000 s"),
    ("__import__('os')", "must be two numbers with a colon and a unit"),
]


@pytest.mark.parametrize(("wrong", "words"), REFUSED)
def test_distributions_that_are_none_are_refused(wrong, words, monkeypatch):
    monkeypatch.setattr(SceneSimulator, "__call__", None)
    with pytest.raises(mc.SceneError) as caught:
        mc.fit(SCENE, DATA, {CYCLE: wrong}, cores=1)
    assert caught.value.path == CYCLE
    assert words in str(caught.value)


def test_a_count_has_no_distribution():
    with pytest.raises(mc.SceneError, match=r"initial\.count: is no real number, so it cannot"):
        priors({"initial.count": "norm(6, 2)"})
