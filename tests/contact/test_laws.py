"""Exact JKR, the smoothing of approximate JKR, and springs, against closed forms and sources."""

from decimal import Decimal, getcontext

import formulas
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import brentq, minimize_scalar
from strategies import energies, moduli, poissons, radii

from multicell.contact.exact_jkr import ExactJKR, beyond_turning, exact_units
from multicell.contact.hertz import Hertz
from multicell.contact.jkr import JKR
from multicell.contact.law import effective_modulus, effective_radius
from multicell.contact.springs import Cubic, GeneralisedLinear, Linear
from multicell.errors import SceneError

sticky = st.floats(1e-3, 0.5)
CLOSE = pytest.approx


def unlike(ri, rj, ei, ej, nu):
    return effective_modulus(ei, nu, ej, -nu), effective_radius(ri, rj)


pairs = st.builds(unlike, radii, radii, moduli, moduli, poissons)


def close(value, rel=1e-10):
    return pytest.approx(value, rel=rel)


# the universal curve


def decimal_root(excess):
    """Return v >= 0 with v² (v² + 4 v + 6) = excess from 60-digit bisection and Newton."""
    getcontext().prec = 60
    c = Decimal(excess)
    v = Decimal(float(np.sqrt(excess / 6.0)))
    for _ in range(200):
        step = (v * v * (v * v + 4 * v + 6) - c) / (4 * v**3 + 12 * v * v + 12 * v)
        v -= step
        if abs(step) < v * Decimal("1e-40"):
            return v
    raise AssertionError("no root")


def test_the_universal_curve_is_solved_to_rounding_over_its_whole_range():
    # h_0 is 6^{4/3} units, so 100 h_0 is an excess of 1093; both ends are passed by far
    excess = np.concatenate([np.logspace(-30, 12, 300), np.linspace(1e-3, 1100.0, 300)])
    exact = np.array([float(decimal_root(e)) for e in excess])
    np.testing.assert_allclose([beyond_turning(e) for e in excess], exact, rtol=1e-15)
    assert beyond_turning(0.0) == 0.0


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


# closed forms


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


def test_force_at_fixed_grips_is_exact_on_the_curve():
    # the turning point itself: a_c = √(k r) and no rounding of the overlap in between
    modulus, radius, sigma = 1.3, 2.1, 0.07
    unit, _ = exact_units(modulus, radius, sigma)
    overlap, force = ExactJKR(surface_energy=sigma).curve(np.sqrt(unit * radius), modulus, radius)
    assert force == close(-(5.0 / 6.0) * np.pi * sigma * radius, rel=1e-13)
    assert overlap == close(-3.0 * unit, rel=1e-13)


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


# force, energy, stiffness: finite differences and quadrature


def slopes(function, h, step):
    """Return a fourth-order central difference."""
    return (
        8.0 * (function(h + step) - function(h - step))
        - (function(h + 2 * step) - function(h - 2 * step))
    ) / (12.0 * step)


SPRINGS = [
    Linear(stiffness_at_rest=1.7, cutoff=1.4),
    Cubic(stiffness_at_rest=1.7, cutoff=1.4),
    GeneralisedLinear(stiffness_at_rest=1.7, cutoff=1.4, decay=4.0),
]
RI, RJ = 4.0, 6.5


@pytest.mark.parametrize(
    "law",
    [Hertz(), JKR(), JKR(smoothing=0.5), ExactJKR(), *SPRINGS],
    ids=lambda law: f"{type(law).__name__}{getattr(law, 'smoothing', '') or ''}",
)
def test_force_is_the_slope_of_the_energy_and_stiffness_that_of_the_force(law):
    modulus, radius = unlike(RI, RJ, 0.8, 2.5, 0.4)
    options = {"rest": RI + RJ, "touching": True}
    low = -float(law.reach(modulus, radius, rest=RI + RJ))
    h = low + np.array([0.02, 0.1, 0.3, 0.45, 0.55, 0.9, 1.5, 2.5, 4.0])

    def force(x):
        return law.force(x, modulus, radius, **options)

    def energy(x):
        return law.energy(x, modulus, radius, **options)

    got, scale = slopes(energy, h, 1e-4), np.abs(force(h)).max()
    np.testing.assert_allclose(got, force(h), rtol=1e-7, atol=1e-9 * scale)
    stiffness = law.stiffness(h, modulus, radius, **options)
    np.testing.assert_allclose(slopes(force, h, 1e-4), stiffness, rtol=2e-6, atol=1e-8)


@given(pairs, sticky)
def test_energy_of_exact_jkr_is_elastic_less_surface_energy(pair, sigma):
    law, (modulus, radius) = ExactJKR(surface_energy=sigma), pair
    h0 = float(law.equilibrium_overlap(*pair)) * 3.0
    star = 0.75 * float(modulus)
    for h in (-0.2 * h0, 0.0, h0 / 3, 2.0 * h0):
        a = float(law.contact_radius(h, *pair, touching=True))
        force = float(law.force(h, *pair, touching=True))
        # loaded to the radius a without adhesion, then unloaded with the punch of radius a
        hertz_force, hertz_overlap = 4 * star * a**3 / (3 * float(radius)), a * a / float(radius)
        loading = 0.4 * hertz_force * hertz_overlap
        unloading = (hertz_force**2 - force**2) / (4 * star * a)
        expected = loading - unloading - sigma * np.pi * a * a
        got = law.energy(h, *pair, touching=True)
        size = sigma * np.pi * a * a
        assert got == CLOSE(expected, rel=1e-9, abs=1e-9 * size)


def test_the_hysteresis_loop_loses_what_forming_and_breaking_lose():
    law, pair = ExactJKR(), (0.9, 2.5)
    broken = float(law.breaking_overlap(*pair))
    # retreat below first contact does work that approach does not give back; the substitution
    # h = broken + x² takes the root out of the integrand
    loop, _ = quad(
        lambda x: 2 * x * float(law.force(broken + x * x, *pair, touching=True)),
        0.0,
        np.sqrt(-broken),
        epsabs=1e-13,
    )
    losses = law.forming_loss(*pair) + law.breaking_loss(*pair)
    assert -loop == close(losses, rel=1e-7)
    assert law.energy(0.0, *pair) == close(-law.forming_loss(*pair))
    at_end = law.energy(broken * (1 - 1e-14), *pair, touching=True)
    assert at_end == close(law.breaking_loss(*pair), rel=1e-6)


def test_contact_forms_at_zero_and_breaks_at_the_turning_point():
    law, pair = ExactJKR(), (0.9, 2.5)
    broken = float(law.breaking_overlap(*pair))
    h = np.array([2 * broken, broken * (1 + 1e-9), broken, 0.5 * broken, -1e-12, 0.0, 1.0])
    assert law.in_contact(h, *pair, False).tolist() == [False] * 5 + [True] * 2
    assert law.in_contact(h, *pair, True).tolist() == [False] * 2 + [True] * 5
    for before in (False, True):
        contact = law.in_contact(h, *pair, before)
        for function in (law.force, law.stiffness, law.energy, law.contact_radius):
            values = function(h, *pair, touching=before)
            assert np.isfinite(values).all()
            assert ((values != 0.0) == contact).all()
    assert law.reach(*pair) == -broken
    mixed = law.force(np.full(2, 0.5 * broken), *pair, touching=np.array([False, True]))
    assert mixed[0] == 0.0
    assert mixed[1] < 0.0


# smoothing of approximate JKR


@given(pairs, energies, st.floats(0.0, 5.0))
def test_above_its_length_the_smoothed_force_is_the_plain_one_bit_for_bit(pair, sigma, h):
    law = JKR(surface_energy=sigma, smoothing=0.0)
    smoothed = JKR(surface_energy=sigma, smoothing=0.3)
    assert smoothed.force(0.3 + h, *pair) == law.force(0.3 + h, *pair)
    # and without smoothing it is eq. 3.6
    exact = formulas.pair(law, h, *pair)
    for found, expected in zip((law.force(h, *pair), law.energy(h, *pair)), exact, strict=True):
        stiff = pair[0] * np.sqrt(pair[1]) * h**1.5
        assert found == CLOSE(float(expected), rel=1e-12, abs=1e-13 * stiff)


@given(pairs, sticky, st.floats(0.01, 1.0))
def test_smoothing_is_once_differentiable_with_bounded_stiffness(pair, sigma, length):
    law = JKR(surface_energy=sigma, smoothing=length)
    b = law.adhesion * np.sqrt(pair[0] * pair[1] ** 1.5)
    below, above = length * (1 - 1e-13), length * (1 + 1e-13)
    size = b * length**0.75
    for function, unit in ((law.force, size), (law.stiffness, size / length)):
        assert function(below, *pair) == CLOSE(function(above, *pair), abs=1e-10 * unit, rel=1e-10)
    energy = law.energy(below, *pair)
    assert energy == CLOSE(law.energy(above, *pair), abs=1e-10 * size * length, rel=1e-10)
    h = np.concatenate([np.logspace(-300, -1, 60) * length, np.linspace(0.1, 3.0, 60) * length])
    bound = 1.25 * b * length**-0.25
    assert (law.stiffness(h, *pair) >= -bound * (1 + 1e-12)).all()
    elastic = 1.5 * pair[0] * np.sqrt(pair[1] * 1e-300 * length)
    assert law.stiffness(1e-300 * length, *pair) == close(elastic - bound)
    assert law.force(0.0, *pair) == 0.0


@given(pairs, sticky, st.floats(0.05, 4.0))
def test_smoothing_shifts_equilibrium_and_depth_only_when_it_is_long(pair, sigma, ratio):
    plain = JKR(surface_energy=sigma)
    h0 = float(plain.equilibrium_overlap(*pair))
    law = JKR(surface_energy=sigma, smoothing=ratio * h0)
    found = brentq(lambda x: float(law.force(x * h0, *pair)), 0.05, 5.0, xtol=1e-14) * h0
    rest = law.equilibrium_overlap(*pair)
    assert rest == close(found, rel=1e-9)
    pull_off = 1.5 * np.pi * sigma * float(pair[1])
    deepest = minimize_scalar(
        lambda x: float(law.force(x * h0, *pair)) / pull_off, bounds=(0.0, 1.5)
    ).fun
    if ratio <= 1.0:
        assert rest == h0
    else:
        assert rest < h0
    if ratio <= 2.0 ** (-4.0 / 3.0):
        assert deepest == close(-1.0, rel=1e-8)
    # the linear onset lies below h^{3/4}: a long smoothing holds less
    assert deepest >= -1.0 - 1e-12
    if ratio > 0.5:
        assert deepest > -1.0


def test_model_error_of_the_smoothing():
    """A tenth of h0 as smoothing weakens the binding energy by 0.3 %."""
    pair = (0.9, 2.5)
    plain = JKR()
    h0 = float(plain.equilibrium_overlap(*pair))
    bound = float(plain.energy(h0, *pair))
    # U(h0) = (2/5 - 4/7) b h0^{7/4}, raised by (5/168) b h_s^{7/4}
    for ratio in (0.01, 0.1, 1.0):
        law = JKR(smoothing=ratio * h0)
        change = float(law.energy(h0, *pair)) / bound - 1.0
        assert change == close(-(25.0 / 144.0) * ratio**1.75, rel=1e-8)


@pytest.mark.parametrize("value", [-0.1, float("nan"), "1 s"])
def test_a_smoothing_that_is_no_length_is_refused(value):
    with pytest.raises(SceneError, match="smoothing"):
        JKR(smoothing=value)


# springs


@pytest.mark.parametrize("law", SPRINGS, ids=lambda law: type(law).__name__)
def test_springs_rest_at_the_sum_of_the_radii_and_end_at_their_cutoff(law):
    rest = np.array([2.0, 10.5])
    pair = (1.0, 2.5)
    reach = law.reach(*pair, rest=rest)
    np.testing.assert_allclose(reach, 0.4 * rest)
    for function in (law.force, law.stiffness, law.energy):
        assert (function(-reach * (1 + 1e-12), *pair, rest=rest) == 0.0).all()
    assert (law.force(0.0, *pair, rest=rest) == 0.0).all()
    np.testing.assert_allclose(law.stiffness(0.0, *pair, rest=rest), 1.7)
    assert (law.equilibrium_overlap(*pair) == 0.0).all()
    assert (law.energy(0.0, *pair, rest=rest) < 0.0).all()
    with pytest.raises(TypeError, match="rest"):
        law.force(1.0, *pair)


def test_centres_that_meet_are_pushed_without_bound_by_the_logarithm_only():
    law = GeneralisedLinear()
    near = law.force(10.0 - 10.0 ** np.arange(-1.0, -7.0, -1.0), 1.0, 2.5, rest=10.0)
    np.testing.assert_allclose(np.diff(near), 10.0 * np.log(10.0), rtol=1e-8)
    assert near[-1] < law.force(10.0, 1.0, 2.5, rest=10.0) < np.inf
    assert np.isfinite(law.energy(10.0, 1.0, 2.5, rest=10.0))
    for spring in SPRINGS[:2]:
        assert np.isfinite(spring.force(10.0, 1.0, 2.5, rest=10.0))


@pytest.mark.parametrize("law", [Linear, Cubic, GeneralisedLinear])
def test_spring_parameters_are_checked(law):
    with pytest.raises(SceneError, match="cutoff"):
        law(cutoff=0.9)
    with pytest.raises(SceneError, match="stiffness_at_rest"):
        law(stiffness_at_rest=0.0)


@pytest.mark.parametrize("law", [Hertz(), JKR(), ExactJKR(), *SPRINGS])
def test_reach_is_bounded_by_the_extremes_of_a_population(law):
    rng = np.random.default_rng(5)
    ri, rj = rng.uniform(2.0, 9.0, (2, 200))
    modulus, radius = rng.uniform(0.3, 3.0, 200), effective_radius(ri, rj)
    reach = law.reach(modulus, radius, rest=ri + rj)
    most = law.reach(modulus.min(), radius.max(), rest=(ri + rj).max())
    assert (reach >= 0.0).all()
    assert (reach <= most).all()
    apart = -most * (1 + 1e-9) - 1e-9
    assert (law.force(apart, modulus, radius, rest=ri + rj, touching=True) == 0.0).all()
