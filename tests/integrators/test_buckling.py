"""A chain of cells that buckles: implicit methods may damp what should grow."""

import math

import numpy as np
import pytest
from buckling import LENGTH, RADIUS, TINY, Chain, chain
from formulas import growth_rate_of
from scipy.integrate import solve_ivp

from multicell.integrators.backward_euler import BackwardEuler
from multicell.integrators.cvode import Cvode


@pytest.fixture(scope="module")
def solved():
    """Return the true course, by an outside solver, at 1, 2, 3 and 40 over the rate."""
    start = chain()[1][:, :2]
    assert np.abs(Chain()(0.0, start * [1.0, 0.0])).max() < 1e-12
    times = np.array([1.0, 2.0, 3.0, 40.0]) / Chain.rate
    found = solve_ivp(
        Chain(), (0.0, times[-1]), start.ravel(), "DOP853", times, rtol=1e-12, atol=1e-12
    )
    return times, [y.reshape(3, 2) for y in found.y.T]


def aside(position):
    return np.abs(position[:, 1]).max()


def test_the_growth_rate_is_that_of_the_prestress():
    system, start = chain()
    assert growth_rate_of(system, start, 2) == pytest.approx(Chain.rate, rel=1e-4)


def test_a_tight_tolerance_follows_the_growth_as_an_outside_solver_has_it(solved):
    for time, true in zip(*solved, strict=True):
        system, start = chain(time)
        end = Cvode(1e-11, 1e-9 * RADIUS, 50_000).integrate(system, start).position
        np.testing.assert_allclose(end[:, :2], true, atol=1e-5)
        if time < 4.0 / Chain.rate:
            assert aside(end) / (TINY * RADIUS) == pytest.approx(
                math.exp(Chain.rate * time), rel=2e-3
            )


@pytest.mark.parametrize("product", [7.0, 12.0])
def test_backward_euler_goes_where_the_energy_falls(solved, product):
    system, start = chain()
    step = LENGTH / round(40.0 / product)
    method = BackwardEuler(step, 1.0, tolerance=1e-8 * RADIUS)
    assert aside(method.integrate(system, start).position) == pytest.approx(
        aside(solved[1][-1]), rel=0.01
    )
    first = chain(step)[0]
    assert aside(method.integrate(first, start).position) > 0.8 * RADIUS
    outcome = BackwardEuler(step, 0.5).integrate(system, start)
    assert "would move the cell" in outcome.problem


@pytest.mark.parametrize(("tolerance", "follows"), [(0.03, True), (0.3, False)])
def test_cvode_damps_it_where_its_tolerance_hides_the_disturbance(solved, tolerance, follows):
    system, start = chain()
    outcome = Cvode(0.01 * tolerance, tolerance * RADIUS).integrate(system, start)
    assert outcome.done
    true = aside(solved[1][-1])
    assert aside(outcome.position) == pytest.approx(true if follows else 0.0, abs=0.2 * true)
