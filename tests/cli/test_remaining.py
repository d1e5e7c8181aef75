"""The time that is left follows the growth that is expected and the steps that were measured."""

import numpy as np
import pytest

import multicell as mc
from multicell.cli.remaining import Forecast
from multicell.cli.tables import time_text

DAY = 86400.0
STEP = 600.0
TIMES = np.arange(0.0, 8.0 * DAY + 1.0, STEP)
COURSES = {
    "exponential": 100.0 * 2.0 ** (TIMES / 54000.0),
    "a rim that grows": 50.0 * (1.0 + TIMES / DAY) ** 3,
    "constant": np.full_like(TIMES, 2000.0),
    "shrinking": 5000.0 * np.exp(-TIMES / (6.0 * DAY)),
}


def predicted(cells, share, *, expected=None, noise=0.0, stop=None):
    """Return what is predicted after a share of the steps, and what is true.

    A step costs 1 ms and 20 µs a cell; the forecast knows that up to a factor.
    """
    known = (cells if expected is None else expected)[::10]
    forecast = Forecast.of_steps(TIMES[::10], known, 50.0, 1.0, stop)
    count = len(cells) if stop is None else int(np.searchsorted(cells, stop)) + 1
    cost = (0.001 + 2e-5 * cells[:count]) * np.random.default_rng(1).gamma(
        1.0 / max(noise, 1e-9) ** 2, max(noise, 1e-9) ** 2, count
    )
    first, now = int(0.01 * count), int(share * count)
    left = forecast.left(TIMES[first], TIMES[now], cost[first + 1 : now + 1].sum())
    return left, cost[now + 1 :].sum()


@pytest.mark.parametrize("course", COURSES)
@pytest.mark.parametrize("share", [0.02, 0.5, 0.9])
def test_time_left_is_that_of_the_expected_population(course, share):
    left, true = predicted(COURSES[course], share)
    assert left == pytest.approx(true, rel=0.03)


def test_a_run_of_fewer_cells_than_expected_is_found_by_what_it_costs():
    cells = COURSES["exponential"]
    left, true = predicted(cells, 0.5, expected=cells * 2.0)
    assert left == pytest.approx(true, rel=0.05)


def test_noise_and_early_ends_do_not_mislead():
    left, true = predicted(COURSES["exponential"], 0.5, noise=0.5)
    assert left == pytest.approx(true, rel=0.3)
    left, true = predicted(COURSES["exponential"], 0.5, stop=20_000)
    assert left == pytest.approx(true, rel=0.1)


@pytest.mark.parametrize("amiss", [0.93, 1.0, 1.07])
def test_growth_that_slows_down_is_not_continued(amiss):
    """Cells double in 15 h until only a rim grows, as in a spheroid of 12 days."""
    times = np.arange(0.0, 12.0 * DAY + 1.0, STEP)
    free, rim = 2.0 ** (times / 54000.0 / 3.0), 2.0 + 3.0 * times / DAY
    cells = (1.5 * free * rim / (free + rim)) ** 3
    spent = np.cumsum(
        (0.002 + 2e-6 * cells) * np.random.default_rng(2).gamma(4.0, 0.25, len(cells))
    )
    forecast = Forecast.of_steps(times[::10], cells[::10] ** amiss, 7e-4, 7e-7)
    found = [
        (forecast.left(times[10], times[k], spent[k] - spent[10]) + spent[k]) / spent[-1]
        for k in range(30, int(0.98 * len(times)))
    ]
    assert min(found) > 0.3
    assert max(found) < 3.0


def test_nothing_is_predicted_from_nothing_and_zero_at_the_end():
    forecast = Forecast.of_steps(TIMES, np.zeros_like(TIMES), 1.0, 1.0)
    assert forecast.left(600.0, 600.0, 1.0) is None
    assert forecast.left(600.0, TIMES[-1], 1.0) == 0.0


def test_a_forecast_is_that_of_explain():
    scene = mc.load_scene("spheroid").with_changes({"duration": "2 d"})
    forecast = Forecast.of(scene)
    assert forecast.times[-1] == pytest.approx(scene.duration)
    assert (np.diff(forecast.cost) > 0.0).all()
    early = Forecast.of(scene.with_changes({"stop_cells": 3}))
    assert early.times[-1] < scene.duration


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(3.2, "3.2 s"), (59.0, "59 s"), (91.0, "1.5 min"), (7200.0, "2 h"), (2e5, "2.3 d")],
)
def test_times_are_put_into_words(seconds, words):
    assert time_text(seconds, 2) == words
