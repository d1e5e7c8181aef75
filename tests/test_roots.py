"""Brent's method, bit for bit that of SciPy."""

import math

import numpy as np
import pytest
from scipy import optimize

from multicell.roots import brent_root

FUNCTIONS = {
    "cubic": lambda x: x**3 - x - 2.0,
    "exponential": lambda x: math.exp(-3.0 * x) - 0.2,
    "steep": lambda x: math.atan(1e4 * (x - 0.7)),
    "flat": lambda x: (x - 0.7) ** 7,
    "jump": lambda x: -1.0 if x < 1.1 else 2.0,
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_roots_have_the_bits_of_scipy(name):
    f, random = FUNCTIONS[name], np.random.default_rng(1)
    for _ in range(200):
        low, high = float(random.uniform(-5.0, 0.5)), float(random.uniform(1.6, 9.0))
        how = {"rtol": 10.0 ** random.uniform(-14.0, -3.0), "xtol": 1e-300}
        for ends in ((low, high), (high, low)):
            assert brent_root(f, *ends, **how) == optimize.brentq(f, *ends, maxiter=10_000, **how)


def test_a_root_at_an_end_is_found_at_once():
    assert brent_root(lambda x: x, 0.0, 1.0, rtol=1e-14, xtol=1e-300) == 0.0
    assert brent_root(lambda x: x, -1.0, 0.0, rtol=1e-14, xtol=1e-300) == 0.0


def test_equal_signs_are_refused():
    with pytest.raises(ValueError, match="different signs"):
        brent_root(lambda x: x * x + 1.0, 0.0, 1.0, rtol=1e-14, xtol=1e-300)
