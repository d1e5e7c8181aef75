"""Every law against a formula of its own that shares no line with the package."""

import formulas
import numpy as np
import pytest
from law_samples import SAMPLES
from scipy.integrate import quad

from multicell.contact.law import effective_modulus, effective_radius

RI, RJ, EI, EJ = np.array([4.0, 3.1, 8.0]), np.array([6.5, 3.1, 2.0]), 0.8, 2.5


def test_effective_constants_are_those_of_two_solids():
    modulus, radius = formulas.reduced(EI, EJ, RI, RJ, 0.3)
    np.testing.assert_allclose(effective_modulus(EI, 0.3, EJ, -0.3), modulus, rtol=1e-14)
    np.testing.assert_allclose(effective_radius(RI, RJ), radius, rtol=1e-14)


@pytest.mark.parametrize("touching", [False, True])
@pytest.mark.parametrize("name", SAMPLES)
def test_force_and_energy(name, touching):
    law = SAMPLES[name]
    modulus, radius = formulas.reduced(EI, EJ, RI, RJ)
    overlap = np.linspace(-3.6, 2.9, 161)[:, None]
    force, energy = formulas.pair(law, overlap, modulus, radius, RI + RJ, touching=touching)
    options = {"rest": RI + RJ, "touching": touching}
    got = law.force(overlap, modulus, radius, **options)
    # the slope of exact JKR has no bound where it breaks: digits of the overlap are lost there
    np.testing.assert_allclose(got, force, rtol=1e-9, atol=1e-12 * np.abs(force).max())
    got = law.energy(overlap, modulus, radius, **options)
    np.testing.assert_allclose(got, energy, rtol=1e-9, atol=1e-12 * np.abs(energy).max())
    assert ((force != 0.0) & (overlap < 0.0)).any() == (
        float(law.reach(EI, 4.0, rest=10.0)) > 1e-3 and (touching or not law.remembers)
    )


@pytest.mark.parametrize("name", SAMPLES)
def test_the_second_energy_is_the_integral_of_the_second_force(name):
    law, (modulus, radius) = SAMPLES[name], formulas.reduced(EI, EJ, 4.0, 6.5)

    def force(h):
        return float(formulas.pair(law, h, modulus, radius, 10.5, touching=True)[0])

    ends = np.array([0.3, 2.4])
    energy = formulas.pair(law, ends, modulus, radius, 10.5, touching=True)[1]
    assert energy[1] - energy[0] == pytest.approx(
        quad(force, *ends, epsabs=1e-12, points=[0.6])[0], rel=1e-9
    )
