"""The ball at rest that hypoxic radii of WM983b are compared with: against closed forms."""

import numpy as np
import pytest
from docs_programs import program


@pytest.fixture(scope="module")
def ball():
    return program("wm983b_ball")


@pytest.mark.parametrize("layer", [0.1, 60.0, 1e6])
def test_a_linear_sink_leaves_a_hyperbolic_sine(ball, layer):
    rate, radius, medium = 1.2, 200.0, 0.2  # 1/s, um, mM
    r, c = ball.solve(lambda c: rate * c, 0.0, radius, layer, medium)
    k = np.sqrt(rate / ball.TISSUE)
    # c = a sinh(k r) / r, whose flow at the surface crosses the layer
    shape = np.sinh(k * radius) / radius
    slope = (k * np.cosh(k * radius) - shape) / radius
    apart = ball.TISSUE / ball.MEDIUM * radius**2 * (1 / radius - 1 / (radius + layer))
    a = medium / (shape + apart * slope)
    expected = np.append(a * k, a * np.sinh(k * r[1:]) / r[1:])
    np.testing.assert_allclose(c, expected, rtol=2e-3)


@pytest.mark.parametrize("core", [0.0, 60.0, 150.0])
def test_a_constant_sink_leaves_a_parabola_round_its_core(ball, core):
    uptake, radius, medium = 0.02, 190.0, 0.21
    r, c = ball.solve(lambda c: uptake * c / (c + 1e-9), core, radius, 0.0, medium)
    of = uptake / (6 * ball.TISSUE)
    r = np.maximum(r, 1e-9)
    expected = medium - of * (radius**2 - r**2) + 2 * of * core**3 * (1 / r - 1 / radius)
    np.testing.assert_allclose(c, expected, rtol=2e-4)


def test_the_hypoxic_radius_is_where_there_are_10_mmhg(ball):
    r = np.linspace(0.0, 200.0, 201)
    assert ball.hypoxic_radius(r, ball.HYPOXIC + 1e-4 * (r - 80.0)) == pytest.approx(80.0)
    assert ball.hypoxic_radius(r, np.full(201, ball.HYPOXIC * 1.01)) == 0.0
    assert ball.hypoxic_radius(r, np.full(201, ball.HYPOXIC * 0.99)) == 200.0


def test_uptake_that_falls_in_low_oxygen_is_what_hypoxic_radii_ask_for(ball):
    """As found by the fit to air and 2 %, which has not seen those after the switch."""
    constant, _, whole, cells = ball.LAWS
    for law, values in ((whole, [0.042, 64.0, 0.088]), (cells, [0.1, 0.1, 0.001, 0.023])):
        missed = {regime: ball.rms(ball.off(law, values, regime)) for regime in ball.REGIMES}
        assert max(missed.values()) < 2.0, missed
    assert ball.rms(ball.off(constant, [0.058, 0.1], "hypoxia")) > 3.0
