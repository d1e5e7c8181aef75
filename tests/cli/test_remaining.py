"""The time that is left follows the growth that is expected and the steps that were measured."""

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid

import multicell as mc
from multicell.cli.progress import Forecast
from multicell.report.explain.cost import predict

DAY = 86400.0
STEP = 600.0
TIMES = np.arange(0.0, 8.0 * DAY + 1.0, STEP)
COURSES = {
    "exponential": 100.0 * 2.0 ** (TIMES / 54000.0),
    "a rim that grows": 50.0 * (1.0 + TIMES / DAY) ** 3,
    "constant": np.full_like(TIMES, 2000.0),
    "shrinking": 5000.0 * np.exp(-TIMES / (6.0 * DAY)),
}


def forecast_of(times, cells, constant, slope):
    """Return a forecast of steps of ten minutes that cost constant + slope n, s."""
    rate = (constant + slope * cells) / STEP
    return Forecast(times, cumulative_trapezoid(rate, times, initial=0.0))


def predicted(cells, share, *, expected=None, noise=0.0, slower=1.0):
    """Return the prediction after a share of the steps, and the truth.

    A step costs 1 ms and 20 µs a cell; the machine of the run may be slower.
    """
    known = (cells if expected is None else expected)[::10]
    forecast = forecast_of(TIMES[::10], known, 0.001, 2e-5)
    cost = (
        slower
        * (0.001 + 2e-5 * cells)
        * np.random.default_rng(1).gamma(
            1.0 / max(noise, 1e-9) ** 2, max(noise, 1e-9) ** 2, len(cells)
        )
    )
    first, now = int(0.01 * len(cells)), int(share * len(cells))
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
    assert left == pytest.approx(true, rel=0.2)


def test_noise_does_not_mislead():
    left, true = predicted(COURSES["exponential"], 0.5, noise=0.5)
    assert left == pytest.approx(true, rel=0.3)


def test_a_slower_machine_is_found_in_its_steps_and_not_in_the_first_few():
    left, true = predicted(COURSES["constant"], 0.9, slower=3.0)
    assert left == pytest.approx(true, rel=0.15)
    # 3 s of loading in what should take 0.05 s, as in the first minute of a first run
    forecast = forecast_of(TIMES, COURSES["exponential"], 0.001, 2e-5)
    begin = float(np.interp(0.05, forecast.cost, forecast.times))
    assert forecast.left(0.0, begin, 3.0) < 2.0 * forecast.cost[-1]


def test_steps_that_take_turns_do_not_make_what_is_left_jump():
    forecast = forecast_of(TIMES, COURSES["constant"], 0.1, 0.0)
    wall = np.cumsum(np.diff(forecast.cost) * np.tile([0.5, 2.0], len(TIMES) // 2))
    left = [forecast.left(0.0, t, w) for t, w in zip(TIMES[1:], wall, strict=True)]
    assert np.abs(np.diff(left)).max() < 0.03 * left[0]
    assert min(left[:-1]) > 0.0


def test_nothing_is_left_at_the_end():
    assert forecast_of(TIMES, np.zeros_like(TIMES), 1.0, 1.0).left(600.0, TIMES[-1], 1.0) == 0.0


def test_a_forecast_is_that_of_explain():
    scene = mc.load_scene("spheroid").with_changes({"duration": "2 d"})
    forecast = Forecast.of(scene)
    assert forecast.cost[-1] == pytest.approx(predict(scene).seconds)
    assert forecast.times[-1] == pytest.approx(scene.duration)
    assert (np.diff(forecast.cost) > 0.0).all()
    early = Forecast.of(scene.with_changes({"stop_cells": 3}))
    assert early.times[-1] < scene.duration
