"""The one home of Michaelis-Menten: against its derivative by complex step, and its balance."""

import numpy as np
import pytest
from numba import njit

from multicell.nutrient.uptake import balanced, rate, uptake, uptake_and_slope


@njit
def compiled(most, c, half):
    """Return what a kernel gets."""
    return uptake_and_slope(most, c, half)


def test_slope_is_the_derivative():
    c = np.logspace(-6, 2, 50)
    taken, slope = uptake_and_slope(3.0, c, 0.02)
    np.testing.assert_allclose(taken, 3.0 * c / (0.02 + c), rtol=1e-14)
    step = 1e-30
    exact = (3.0 * (c + 1j * step) / (0.02 + c + 1j * step)).imag / step
    np.testing.assert_allclose(slope, exact, rtol=1e-12)
    np.testing.assert_array_equal(uptake(3.0, c, 0.02), taken)
    np.testing.assert_allclose(rate(3.0, c, 0.02) * c, taken, rtol=1e-15)


def test_below_zero_it_goes_on_along_its_tangent():
    c = np.array([-2.0, -1e-9, -0.0, 0.0])
    taken, slope = uptake_and_slope(3.0, c, 0.02)
    np.testing.assert_allclose(slope, 150.0)
    np.testing.assert_allclose(taken, 150.0 * c)


@pytest.mark.parametrize("c", [-0.3, 0.0, 1e-9, 0.02, 7.0])
def test_kernels_and_arrays_get_the_same_bits(c):
    here, slope = uptake_and_slope(np.array([3.0]), np.array([c]), 0.02)
    assert compiled(3.0, c, 0.02) == (here[0], slope[0])


@pytest.mark.parametrize("c", [-0.5, -1e-12, 0.0, 1e-15, 1e-3, 0.02, 5.0, 1e6])
@pytest.mark.parametrize("loss", [1e-8, 1.0, 1e8])
def test_balance_is_met(c, loss):
    most, half = 3.0, 0.02
    taken, _ = uptake_and_slope(most, c, half)
    assert balanced(loss * c + taken, loss, most, half) == pytest.approx(c, rel=1e-9, abs=1e-18)
