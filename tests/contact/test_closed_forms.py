"""Pair laws against closed forms, the thesis's figure 3.4, and finite differences."""

import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar

from multicell import JKR, Hertz
from multicell.contact.law import effective_modulus, effective_radius

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


def test_no_contact_no_force():
    for law in (Hertz(), JKR()):
        for function in (law.force, law.stiffness, law.energy):
            assert (function(np.array([-3.0, -1e-12, 0.0]), 1.0, 2.5) == 0.0).all()


def test_contact_radius_of_spheres_that_touch():
    found = JKR().contact_radius([-1.0, 0.0, 1.6], 1.0, 2.5)
    np.testing.assert_allclose(found, [0.0, 0.0, 2.0])
