"""The time that is left follows the growth of the population, whatever has been simulated."""

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


def estimate(course, share, *, amiss=1.0, constant=0.001, slope=2e-5, noise=0.0, stop=None):
    """Return what is estimated after a share of the steps, and what is true.

    The forecast has the numbers of cells to the power ``amiss``, and other costs.
    """
    times = np.arange(0.0, 8.0 * DAY + 1.0, STEP)
    cells = course(times)
    forecast = Forecast(times[::10], cells[::10] ** amiss, 7e-4, 1e-5)
    if stop is not None:
        last = int(np.searchsorted(cells, stop))
        times, cells = times[: last + 1], cells[: last + 1]
    cost = (constant + slope * cells) * np.random.default_rng(1).gamma(
        1.0 / max(noise, 1e-9) ** 2, max(noise, 1e-9) ** 2, len(cells)
    )
    remaining = Remaining(8.0 * DAY, stop)
    now = int(share * len(times))
    for k in range(1, now + 1):
        remaining.note(times[k], int(cells[k]), cost[k])
    return remaining.left(forecast), cost[now + 1 :].sum()


@pytest.mark.parametrize("course", COURSES)
@pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
@pytest.mark.parametrize("amiss", [0.93, 1.0, 1.07])
def test_time_left_is_that_of_the_growing_population(course, share, amiss):
    """What went amiss with the forecast so far does not count: only how it continues."""
    left, true = estimate(COURSES[course], share, amiss=amiss)
    within = 1.15 if amiss == 1.0 else 1.8
    assert true / within < left < true * within


def test_exponential_growth_is_continued_exactly():
    """Not from the part of the time that is done: that would say a hundredth."""
    left, true = estimate(COURSES["exponential"], 0.5)
    assert left == pytest.approx(true, rel=0.02)


def test_noise_stalls_and_early_ends_do_not_mislead():
    left, true = estimate(COURSES["exponential"], 0.5, noise=0.5)
    assert left == pytest.approx(true, rel=0.3)
    left, true = estimate(COURSES["exponential"], 0.5, stop=20_000)
    assert left == pytest.approx(true, rel=0.1)
    remaining = Remaining(1000.0 * STEP)
    for k in range(1, 201):
        remaining.note(k * STEP, 100, 20.0 if k in (1, 120) else 0.01)  # compiled twice
    constant = Forecast(np.array([0.0, 1000.0 * STEP]), np.array([100.0, 100.0]), 1.0, 0.01)
    assert remaining.left(constant) == pytest.approx(8.0, rel=0.3)


def test_nothing_is_estimated_of_nothing_and_zero_at_the_end():
    remaining = Remaining(3000.0)
    nobody = Forecast(np.array([0.0, 3000.0]), np.array([0.0, 0.0]), 1.0, 0.01)
    assert remaining.left(nobody) is None
    for k in range(1, 6):
        remaining.note(k * 600.0, 0, 0.001)
    assert remaining.left(nobody) == 0.0


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(3.2, "3 s"), (89.0, "89 s"), (91.0, "2 min"), (7200.0, "2 h"), (2e5, "2 d")],
)
def test_times_are_told_in_words(seconds, words):
    assert in_words(seconds) == words
