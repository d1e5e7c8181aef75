"""Pair laws: exact JKR, the smoothing of approximate JKR, springs and PhysiCell's, at their limits.

Forces and energies are compared with second formulas in ``test_second_formulas.py``, slopes and
reach by ``check_pair_law`` in ``test_own_law.py``.
"""

from decimal import Decimal, getcontext

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from law_samples import SAMPLES
from scipy.optimize import brentq, minimize_scalar
from strategies import energies, moduli, poissons, radii

from multicell.contact.exact_jkr import ExactJKR, beyond_turning
from multicell.contact.jkr import JKR
from multicell.contact.law import effective_modulus, effective_radius
from multicell.contact.pair import rest_overlap
from multicell.contact.physicell import PhysiCell
from multicell.contact.springs import CubicSpring, GeneralisedLinearSpring, LinearSpring
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


SPRINGS = [
    LinearSpring(stiffness_at_rest=1.7, cutoff=1.4),
    CubicSpring(stiffness_at_rest=1.7, cutoff=1.4),
    GeneralisedLinearSpring(stiffness_at_rest=1.7, cutoff=1.4, decay=4.0),
]


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


# springs and PhysiCell's law


@pytest.mark.parametrize("law", SPRINGS, ids=lambda law: type(law).__name__)
def test_springs_end_at_their_cutoff_and_need_the_distance_at_rest(law):
    rest, pair = np.array([2.0, 10.5]), (1.0, 2.5)
    np.testing.assert_allclose(law.reach(*pair, rest=rest), 0.4 * rest)
    np.testing.assert_allclose(law.stiffness(0.0, *pair, rest=rest), 1.7)
    assert (law.energy(0.0, *pair, rest=rest) < 0.0).all()
    with pytest.raises(TypeError, match="rest"):
        law.force(1.0, *pair)


def test_centres_that_meet_are_pushed_without_bound_by_the_logarithm_only():
    law = GeneralisedLinearSpring()
    near = law.force(10.0 - 10.0 ** np.arange(-1.0, -7.0, -1.0), 1.0, 2.5, rest=10.0)
    np.testing.assert_allclose(np.diff(near), 10.0 * np.log(10.0), rtol=1e-8)
    assert near[-1] < law.force(10.0, 1.0, 2.5, rest=10.0) < np.inf
    assert np.isfinite(law.energy(10.0, 1.0, 2.5, rest=10.0))
    for spring in SPRINGS[:2]:
        assert np.isfinite(spring.force(10.0, 1.0, 2.5, rest=10.0))


@pytest.mark.parametrize(("repulsion", "adhesion", "cutoff"), [(10.0, 0.4, 1.25), (20.0, 5.0, 2.5)])
def test_cells_of_one_size_move_as_in_physicell(repulsion, adhesion, cutoff):
    """Velocities in µm/min, with 3πη = 15π of them in a force of 1 nN/µm."""
    drag = 15.0 * np.pi / 60.0
    law = PhysiCell(surface_energy=drag * adhesion, cutoff=cutoff)
    for radius in (4.0, 8.4):
        d = np.linspace(0.1, 3.0 * radius * cutoff, 40)
        force = law.force(2.0 * radius - d, drag * repulsion, 0.5 * radius, rest=2.0 * radius)
        near, far = (np.maximum(1.0 - d / (2.0 * radius * f), 0.0) for f in (1.0, cutoff))
        expected = repulsion * near**2 - adhesion * far**2
        np.testing.assert_allclose(force / (2.0 * drag * radius), expected, rtol=1e-12, atol=1e-14)


def test_cells_that_attract_more_than_they_repel_do_not_rest():
    law = PhysiCell(surface_energy=20.0)
    assert float(law.equilibrium_overlap(10.0, 4.0)) == 16.0
    assert float(law.force(15.0, 10.0, 4.0, rest=16.0)) < 0.0


# all laws


@pytest.mark.parametrize(
    ("law", "given"),
    [
        *((JKR, {"smoothing": value}) for value in (-0.1, float("nan"), "1 s")),
        *(
            (law, {"cutoff": 0.9})
            for law in (LinearSpring, CubicSpring, GeneralisedLinearSpring, PhysiCell)
        ),
        (LinearSpring, {"stiffness_at_rest": 0.0}),
    ],
)
def test_parameters_out_of_their_range_are_refused(law, given):
    with pytest.raises(SceneError, match=next(iter(given))):
        law(**given)


@pytest.mark.parametrize(
    "law", [*SAMPLES.values(), PhysiCell(surface_energy=4.0, cutoff=2.5)], ids=repr
)
def test_bonded_pairs_rest_where_the_forces_cancel(law):
    modulus, radius, rest = 5.0, 2.5, 10.0
    bonds = np.array([0.0, 1e-6, 1e-3, 0.03, 0.1])
    found = rest_overlap(law, modulus, radius, rest, bonds)

    def net(overlap, bonds):
        force = law.evaluate(overlap, modulus, radius, rest=rest, touching=True)[0]
        return float(force) - np.pi * radius * bonds * overlap

    without = float(law.equilibrium_overlap(modulus, radius))
    assert abs(net(without, 0.0)) < 1e-10
    assert found[0] == pytest.approx(without, abs=1e-12)
    for strength, overlap in zip(bonds[1:], found[1:], strict=True):
        low, high = max(without, 1e-12), 0.999 * rest
        exact = without  # a spring stiffer than its bonds rests without overlap
        if net(high, strength) < 0.0:  # a repulsion that stays finite: the centres meet
            exact = (1.0 - 1e-9) * rest
        elif net(low, strength) < 0.0:
            exact = brentq(net, low, high, (strength,), 1e-14, 1e-14)
        assert overlap == pytest.approx(exact, rel=1e-9, abs=1e-9)
    assert (np.diff(found) >= -1e-12).all()
