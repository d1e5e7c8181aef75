"""Helpers to use scenes in tests: run them to the end, expect a refusal, count survivors."""

import shutil
from contextlib import contextmanager
from pathlib import Path

import numba
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


def copy_lists(cache):
    """Copy what is compiled of neighbour lists to another folder for compiled code, if it is there.

    They take most of what two cells in an empty folder have to compile, and know no law.
    """
    for room in Path(numba.config.CACHE_DIR or cache).glob("neighbours_*"):
        being_written = shutil.ignore_patterns("*.tmp.*")
        shutil.copytree(room, cache / room.name, ignore=being_written, dirs_exist_ok=True)
