"""Helpers to use scenes in tests: run them to the end, expect a refusal, count survivors."""

from contextlib import contextmanager

import pytest
from scipy import stats

from multicell.errors import SceneError
from multicell.simulation import Simulation


def finished(run, each=None, **options):
    """Return the simulation of a scene, or the one given, at its end."""
    run = run if isinstance(run, Simulation) else Simulation(run, **options)
    while not run.finished:
        run.step()
        if each is not None:
            each(run)
    return run


@contextmanager
def refused(path, words=""):
    """Expect the error of a scene that names a key, and why it cannot be."""
    with pytest.raises(SceneError) as caught:
        yield
    assert caught.value.path == path
    assert words in str(caught.value)


def within(count, trials, chance):
    """Return whether a binomial count lies in the interval of 99.99 %."""
    low, high = stats.binom.interval(0.9999, trials, chance)
    return low <= count <= high
