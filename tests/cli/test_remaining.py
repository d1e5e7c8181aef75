"""The time that is left follows the growth of the population, whatever has been simulated."""

import math

import numpy as np
import pytest

from multicell.cli.remaining import Forecast, Remaining, in_words

DAY = 86400.0
STEP = 600.0
COURSES = {
    "exponential": lambda t: 100.0 * 2.0 ** (t / 54000.0),
    "a rim that grows": lambda t: 50.0 * (1.0 + t / DAY) ** 3,
    "constant": lambda t: np.full_like(t, 2000.0),
    "shrinking": lambda t: 5000.0 * np.exp(-t / (6.0 * DAY)),
}


def told(course, share, *, constant=0.001, slope=2e-5, noise=0.0, stop=None, seed=1):
    """Return what is told after a share of the steps, and what is true."""
    times = np.arange(0.0, 8.0 * DAY + 1.0, STEP)
    cells = course(times)
    if stop is not None:
        last = int(np.searchsorted(cells, stop))
        times, cells = times[: last + 1], cells[: last + 1]
    cost = (constant + slope * cells) * np.random.default_rng(seed).gamma(
        1.0 / max(noise, 1e-9) ** 2, max(noise, 1e-9) ** 2, len(cells)
    )
    remaining = Remaining(8.0 * DAY, stop)
    now = int(share * len(times))
    for k in range(1, now + 1):
        remaining.note(times[k], int(cells[k]), cost[k])
    return remaining.left(), cost[now + 1 :].sum()


@pytest.mark.parametrize("course", COURSES)
@pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
def test_time_left_is_that_of_the_growing_population(course, share):
    left, true = told(COURSES[course], share)
    # a power of time is known the better, the more of it has been
    within = 2.0 if course == "a rim that grows" and share < 0.5 else 1.35
    assert true / within < left < true * within


def test_exponential_growth_is_continued_exactly():
    """Not from the part of the time that is done: that would tell a hundredth."""
    left, true = told(COURSES["exponential"], 0.5)
    assert left == pytest.approx(true, rel=0.02)


def test_noise_stalls_and_early_ends_do_not_mislead():
    left, true = told(COURSES["exponential"], 0.5, noise=0.5)
    assert left == pytest.approx(true, rel=0.3)
    left, true = told(COURSES["exponential"], 0.5, stop=20_000)
    assert left == pytest.approx(true, rel=0.1)
    remaining = Remaining(1000.0 * STEP)
    for k in range(1, 201):
        remaining.note(k * STEP, 100, 20.0 if k in (1, 120) else 0.01)  # compiled twice
    assert remaining.left() == pytest.approx(8.0, rel=0.3)


@pytest.mark.parametrize("amiss", [0.93, 1.0, 1.07])
def test_a_forecast_keeps_growth_that_will_slow_down_from_being_continued(amiss):
    """Cells double in 15 h until only a rim grows, as in a spheroid of 12 days."""
    times = np.arange(0.0, 12.0 * DAY + 1.0, STEP)
    free, rim = 2.0 ** (times / 54000.0 / 3.0), 2.0 + 3.0 * times / DAY
    cells = (1.5 * free * rim / (free + rim)) ** 3
    noise = np.random.default_rng(2).gamma(4.0, 0.25, len(times))
    cost = (0.002 + 2e-6 * cells) * noise
    told = {}
    for forecast in (None, Forecast(times[::10], cells[::10] ** amiss, 7e-4, 1e-6)):
        remaining, found = Remaining(12.0 * DAY, cycle=54000.0), []
        remaining.forecast = forecast
        for k in range(1, len(times)):
            remaining.note(times[k], int(cells[k]), cost[k])
            if 20 <= k < 0.98 * len(times):
                found.append((remaining.left() + cost[1 : k + 1].sum()) / cost[1:].sum())
        told[forecast is None] = np.array(found)
    without, given = told[True], told[False]
    assert without.max() > 10.0
    assert given.max() < 3.0
    assert given.min() > 0.3
    assert np.abs(np.diff(np.log(given))).max() < math.log(1.5)


def test_a_first_division_is_no_rate():
    remaining = Remaining(20.0 * DAY, cycle=15 * 3600.0)
    for k in range(1, 100):
        remaining.note(k * STEP, 1 if k < 95 else 2, 0.001)
    most = 0.001 * sum(2.0 * 2.0 ** (k * STEP / 54000.0) for k in range(20 * 144 - 99))
    assert remaining.left() <= most


def test_nothing_is_told_of_nothing_and_zero_at_the_end():
    remaining = Remaining(3000.0)
    assert remaining.left() is None
    for k in range(1, 6):
        remaining.note(k * 600.0, 0, 0.001)
    assert remaining.left() == 0.0


def test_long_runs_keep_little():
    remaining = Remaining(1e9)
    for k in range(1, 20_000):
        remaining.note(k * 600.0, 10 + k // 50, 1e-3)
    assert len(remaining._times) <= 4096
    assert math.isfinite(remaining.left())


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(3.2, "3 s"), (89.0, "89 s"), (91.0, "2 min"), (7200.0, "2 h"), (2e5, "2 d")],
)
def test_times_are_told_in_words(seconds, words):
    assert in_words(seconds) == words
