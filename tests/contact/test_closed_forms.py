"""Pair laws against closed forms, the thesis's figure 3.4, and finite differences."""

import numpy as np
import pytest
from hypothesis import given
from scipy.optimize import brentq, minimize_scalar
from strategies import energies, moduli, poissons, radii

from multicell import JKR, Hertz
from multicell.contact.law import compliance, effective_modulus, effective_radius

# (ν, E / kPa, σ / (nN/µm)) -> equilibrium distance / µm, deepest attraction / nN, for r = 10 µm.
# The values belong to figure 3.4 of the thesis; ν = 0.75 is there although no isotropic
# solid has it, so the modulus is computed here and not by a scene.
FIGURE_3_4 = {
    "black": (0.5, 1.0, 0.1, 17.178, -2.3562),
    "blue": (0.75, 1.0, 0.1, 18.030, -2.3562),
    "red": (0.5, 2.0, 0.1, 18.222, -2.3562),
    "green": (0.5, 1.0, 0.2, 15.520, -4.7124),
}


@pytest.mark.parametrize("curve", FIGURE_3_4)
def test_jkr_values_of_figure_3_4(curve):
    poisson, young, sigma, distance, deepest = FIGURE_3_4[curve]
    modulus = effective_modulus(young, poisson, young, poisson)
    radius = effective_radius(10.0, 10.0)
    law = JKR(surface_energy=sigma)
    rest = brentq(lambda h: float(law.force(h, modulus, radius)), 0.5, 9.0, xtol=1e-13)
    assert 20.0 - rest == pytest.approx(distance, abs=5e-4)
    assert law.equilibrium_overlap(modulus, radius) == pytest.approx(rest, rel=1e-12)
    least = minimize_scalar(lambda h: float(law.force(h, modulus, radius)), bounds=(0, rest))
    assert least.fun == pytest.approx(deepest, abs=5e-5)


@given(radii, radii, moduli, moduli, poissons, energies)
def test_deepest_attraction_is_the_pull_off_of_jkr_theory(ri, rj, ei, ej, nu, sigma):
    modulus, radius = effective_modulus(ei, nu, ej, nu), effective_radius(ri, rj)
    law = JKR(surface_energy=sigma)
    deepest = law.equilibrium_overlap(modulus, radius) / 2.0 ** (4.0 / 3.0)
    expected = -1.5 * np.pi * sigma * radius
    assert law.force(deepest, modulus, radius) == pytest.approx(expected, rel=1e-10, abs=1e-14)


@given(radii, radii, moduli, moduli, poissons)
def test_effective_constants(ri, rj, ei, ej, nu):
    modulus = effective_modulus(ei, nu, ej, -nu)
    assert 1 / modulus == pytest.approx(0.75 * ((1 - nu**2) / ei + (1 - nu**2) / ej), rel=1e-13)
    assert 1 / modulus == pytest.approx(compliance(ei, nu) + compliance(ej, nu), rel=1e-13)
    assert effective_radius(ri, rj) == pytest.approx(1 / (1 / ri + 1 / rj), rel=1e-13)


@given(radii, moduli, energies)
def test_force_is_minus_the_slope_of_the_energy_and_stiffness_its_slope(r, e, sigma):
    law, h = JKR(surface_energy=sigma), np.linspace(0.05, 0.9, 18) * r
    step = 1e-5 * r
    slope = (law.energy(h + step, e, r) - law.energy(h - step, e, r)) / (2 * step)
    scale = np.abs(law.force(h, e, r)).max()
    np.testing.assert_allclose(slope, law.force(h, e, r), rtol=1e-6, atol=1e-6 * scale)
    slope = (law.force(h + step, e, r) - law.force(h - step, e, r)) / (2 * step)
    scale = np.abs(law.stiffness(h, e, r)).max()
    np.testing.assert_allclose(slope, law.stiffness(h, e, r), rtol=1e-6, atol=1e-6 * scale)


def test_no_contact_no_force():
    for law in (Hertz(), JKR()):
        for function in (law.force, law.stiffness, law.energy):
            assert (function(np.array([-3.0, -1e-12, 0.0]), 1.0, 2.5) == 0.0).all()


def test_hertz_is_jkr_without_surface_energy():
    h = np.linspace(0.0, 4.0, 9)
    np.testing.assert_allclose(
        Hertz().force(h, 0.9, 2.5), JKR(surface_energy=0.0).force(h, 0.9, 2.5), rtol=1e-15
    )
    assert Hertz().force(1.0, 2.0, 4.0) == pytest.approx(2.0 * 2.0)
    assert Hertz().equilibrium_overlap(1.0, 2.5) == 0.0


def test_contact_radius_of_spheres_that_touch():
    found = JKR().contact_radius([-1.0, 0.0, 1.6], 1.0, 2.5)
    np.testing.assert_allclose(found, [0.0, 0.0, 2.0])
