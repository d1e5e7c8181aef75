"""Sticky spheres: Johnson, Kendall & Roberts (1971), exact and as the law of runs approximates."""

import numpy as np
import pytest
from example_programs import load
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import minimize_scalar
from strategies import moduli, poissons, radii

import multicell as mc
from multicell.contact.exact_jkr import ExactJKR, exact_units
from multicell.contact.hertz import Hertz
from multicell.contact.jkr import JKR
from multicell.contact.law import effective_modulus, effective_radius

SUBJECT, SOURCE = "contact", "jkr1971"

sticky = st.floats(1e-3, 0.5)
CLOSE = pytest.approx


def unlike(ri, rj, ei, ej, nu):
    return effective_modulus(ei, nu, ej, -nu), effective_radius(ri, rj)


pairs = st.builds(unlike, radii, radii, moduli, moduli, poissons)


def close(value, rel=1e-10):
    return pytest.approx(value, rel=rel)


E, R, SIGMA = effective_modulus(1.0, 0.5, 1.0, 0.5), effective_radius(10.0, 10.0), 0.1
H = np.linspace(0.05, 9.0, 400)
H0 = (6 * np.pi * SIGMA * np.sqrt(R) / E) ** (2 / 3)
"""Two cells of radius 10 µm with E = 1 kPa, ν = 0.5, σ = 0.1 nN/µm, their overlaps, and h₀."""


def test_the_approximate_law_has_the_rest_and_pull_off_of_the_theory(compare):
    law = JKR(surface_energy=SIGMA)
    rest = 20.0 - float(law.equilibrium_overlap(E, R))
    compare.value("JKR, approximate: distance at rest (figure 3.4)", 17.178, rest, 5e-4, "µm")
    deepest = float(law.force(H0 / 2 ** (4 / 3), E, R))
    off = abs(deepest / (-1.5 * np.pi * SIGMA * R) - 1)
    compare.deviation("JKR, approximate: pull-off, relative", "−(3/2) π σ r", off, 1e-12)
    step = 1e-5
    slope = (law.energy(H + step, E, R) - law.energy(H - step, E, R)) / (2 * step)
    off = abs(slope - law.force(H, E, R)).max()
    compare.deviation("JKR, approximate: slope of the energy", "the force", off, 1e-8, "nN")


def test_the_exact_law_has_the_roots_of_the_quartic(compare):
    """Roots of √a by NumPy; the quartic is at the end of the derivation in the documentation."""
    law, star = ExactJKR(surface_energy=SIGMA), 0.75 * E
    roots = [np.roots([1 / R, 0, 0, -np.sqrt(2 * np.pi * SIGMA / star), -x]) for x in H]
    a = np.array([max(z.real[abs(z.imag) < 1e-9]) ** 2 for z in roots])
    force = 4 * star * a**3 / (3 * R) - np.sqrt(8 * np.pi * SIGMA * star * a**3)
    off = abs(law.force(H, E, R) - force).max()
    compare.deviation("JKR, exact: force", "roots of the quartic", off, 1e-10, "nN")
    off = abs(law.equilibrium_overlap(E, R) / (H0 / 3) - 1)
    compare.deviation("JKR, exact: overlap at rest, relative", "h₀/3", off, 1e-12)


def test_the_curves_of_the_example_are_those_of_the_published_figure(tmp_path, compare):
    results = load("jkr_curves").main(tmp_path)
    expected = [(17.178, -2.3562), (18.030, -2.3562), (18.222, -2.3562), (15.520, -4.7124)]
    off = np.abs(np.array(list(results.values())) - expected).max()
    what = "JKR, four curves of figure 3.4: rest (µm) and deepest force (nN)"
    compare.deviation(what, "17.178, 18.030, 18.222, 15.520; −2.3562, −4.7124", off, 5e-4)


def test_two_cells_that_are_pulled_apart_hold_the_pull_off_force(compare):
    pulled = mc.run(mc.load_scene("doublet")).summary()["separation"]["force"]
    # the load rises by 0.005 nN a step
    what = "two cells pulled apart (`doublet`): load at separation"
    compare.value(what, 1.5 * np.pi * 0.1 * 5.0, pulled, 5e-3 * 2.3562, "nN")


@given(pairs, sticky, st.floats(1.0, 30.0))
def test_overlap_and_force_satisfy_the_equations_of_johnson(pair, sigma, u):
    law, (unit, scale) = ExactJKR(surface_energy=sigma), exact_units(*pair, sigma)
    contact = float(np.sqrt(unit * pair[1])) * u * u
    overlap, force = law.curve(contact, *pair)
    assert overlap == CLOSE(unit * (u**4 - 4 * u), rel=1e-12, abs=1e-11 * unit)
    assert force == CLOSE(scale * (u**6 - 6 * u**3), rel=1e-12, abs=1e-11 * scale)
    assume(u > 1.001)
    assert law.contact_radius(overlap, *pair, touching=True) == close(contact)
    got = law.force(overlap, *pair, touching=True)
    assert got == CLOSE(force, rel=1e-10, abs=1e-10 * scale)


@given(pairs, sticky)
def test_closed_forms_of_exact_jkr(pair, sigma):
    law, radius = ExactJKR(surface_energy=sigma), pair[1]
    h0 = JKR(surface_energy=sigma).equilibrium_overlap(*pair)
    size = sigma * radius
    rest = law.equilibrium_overlap(*pair)
    assert rest == close(h0 / 3.0)
    assert law.force(rest, *pair) == CLOSE(0.0, abs=1e-10 * size)
    assert law.contact_radius(rest, *pair) ** 2 / radius == close(h0)
    assert law.force(0.0, *pair) == close(-(8.0 / 9.0) * 1.5 * np.pi * size)
    assert law.first_contact_force(radius) == close(-(4.0 / 3.0) * np.pi * size)
    deepest = law.force(law.pull_off_overlap(*pair), *pair, touching=True)
    assert deepest == close(-1.5 * np.pi * size)
    assert law.pull_off_force(radius) == close(-1.5 * np.pi * size)
    # an overlap rounded to 16 digits gives the force at the vertical tangent to 8
    broken = law.breaking_overlap(*pair)
    at_grips = law.force(broken * (1 - 1e-15), *pair, touching=True)
    assert at_grips == close(-(5.0 / 6.0) * np.pi * size, rel=1e-6)
    assert law.breaking_force(radius) == close(-(5.0 / 6.0) * np.pi * size)


@given(pairs, sticky)
def test_the_turning_point_is_that_of_johnsons_equations(pair, sigma):
    law = ExactJKR(surface_energy=sigma)
    h0 = float(JKR(surface_energy=sigma).equilibrium_overlap(*pair))
    scale = float(np.sqrt(h0 * pair[1]))

    def overlap(a):
        return float(law.curve(a * scale, *pair)[0]) / h0

    def force(a):
        return float(law.curve(a * scale, *pair)[1]) / (sigma * float(pair[1]))

    turning = minimize_scalar(overlap, bounds=(1e-3, 1.0), options={"xatol": 1e-12})
    assert turning.fun * h0 == close(law.breaking_overlap(*pair))
    assert force(turning.x) == close(-(5.0 / 6.0) * np.pi, rel=1e-6)
    deepest = minimize_scalar(force, bounds=(1e-3, 2.0), options={"xatol": 1e-12})
    assert deepest.fun == close(-1.5 * np.pi)
    assert overlap(deepest.x) * h0 == close(law.pull_off_overlap(*pair), rel=1e-6)


@given(pairs, sticky)
def test_closed_forms_of_approximate_jkr(pair, sigma):
    modulus, radius = pair
    law = JKR(surface_energy=sigma)
    h0 = law.equilibrium_overlap(*pair)
    assert h0 == close((6 * np.pi * sigma * np.sqrt(radius) / modulus) ** (2 / 3))
    assert law.force(h0, *pair) == CLOSE(0.0, abs=1e-10 * sigma * radius)
    hm = h0 / 2 ** (4 / 3)
    assert law.force(hm, *pair) == close(-1.5 * np.pi * sigma * radius)
    elastic = 1.5 * modulus * np.sqrt(radius * hm)
    assert law.stiffness(hm, *pair) == CLOSE(0.0, abs=1e-10 * elastic)
    # the deepest attraction does not know E
    assert law.force(law.equilibrium_overlap(7.0, radius) / 2 ** (4 / 3), 7.0, radius) == close(
        -1.5 * np.pi * sigma * radius
    )


def test_the_hysteresis_loop_loses_what_forming_and_breaking_lose():
    law, pair = ExactJKR(), (0.9, 2.5)
    broken = float(law.breaking_overlap(*pair))
    # retreat below first contact does work that approach does not give back; the substitution
    # h = broken + x² takes the root out of the integrand
    force = lambda x: float(law.force(broken + x * x, *pair, touching=True))  # noqa: E731
    loop, _ = quad(lambda x: 2 * x * force(x), 0.0, np.sqrt(-broken), epsabs=1e-13)
    unit, scale = exact_units(*pair, law.surface_energy)
    forming, breaking = 3.6 * 4.0 ** (4 / 3) * unit * scale, 2.4 * unit * scale
    assert -loop == close(forming + breaking, rel=1e-7)
    assert law.energy(0.0, *pair) == close(-forming)
    at_end = law.energy(broken * (1 - 1e-14), *pair, touching=True)
    assert at_end == close(breaking, rel=1e-6)


@pytest.mark.parametrize(("law", "power"), [(JKR, 0.5), (ExactJKR, 1.0)])
def test_without_surface_energy_the_law_is_hertz(law, power):
    h = np.linspace(0.0, 4.0, 41)
    for function in ("force", "stiffness", "energy", "contact_radius"):
        expected = getattr(Hertz(), function)(h[1:], 0.9, 2.5)
        got = getattr(law(surface_energy=0.0), function)(h[1:], 0.9, 2.5)
        np.testing.assert_allclose(got, expected, rtol=1e-10)
    assert float(law(surface_energy=0.0).equilibrium_overlap(0.9, 2.5)) == CLOSE(0.0, abs=1e-30)
    # it tends to it like √σ (eq. 3.6), like σ in truth: at given overlap dU/dσ = -π a_c²
    hertz = Hertz().force(h, 0.9, 2.5)
    far = [np.abs(law(surface_energy=s).force(h, 0.9, 2.5) - hertz).max() for s in (1e-6, 1e-8)]
    assert far[0] / far[1] == pytest.approx(100.0**power, rel=0.05)
