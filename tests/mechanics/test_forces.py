"""Forces of populations against second formulas; receptors, matrices and external forces."""

import numpy as np
import pytest
from formulas import Pairs, product_of, slope, velocity_of
from hypothesis import given
from hypothesis import strategies as st
from law_samples import SAMPLES
from scipy.spatial import cKDTree
from strategies import cluster, seeds

from multicell.contact.exact_jkr import ExactJKR
from multicell.contact.hertz import Hertz
from multicell.contact.jkr import JKR
from multicell.contact.law import effective_modulus
from multicell.mechanics.motion import Motion
from multicell.mechanics.neighbours import CHUNK
from multicell.mechanics.system import Mechanics

pytestmark = pytest.mark.kernels


def system(law, radius, young, *, duration=10.0, rate=None, options=None, **motion):
    n = len(radius)
    rate = np.zeros(n) if rate is None else rate
    made = Mechanics(law, 5.0, **(options or {}))
    made.begin(Motion(radius, rate, young, np.full(n, 0.5), 0.0, duration, **motion))
    return made


@pytest.mark.sample(
    "hertz-400",
    "jkr-400",
    "jkr that does not stick-400",
    "sticky physicell-400",
    "jkr-2",
    "hertz-4106",
)
@pytest.mark.parametrize(
    ("name", "n"), [*((name, 400) for name in SAMPLES), ("jkr", 2), ("hertz", 2 * CHUNK + 10)]
)
def test_kernels_agree_with_sums_over_all_pairs(name, n):
    law = SAMPLES[name]
    position, radius, young = cluster(n, 11, spacing=0.97, variation=0.3)
    touching = np.array([[0, 1]] if n == 2 else [[3, 4], [0, 7]])
    if name == "exact-jkr" and n > 2:
        tree = cKDTree(position).query_pairs(11.0, output_type="ndarray")
        touching = np.sort(tree, axis=1)[::2]
    made = system(law, radius, young, touching=touching)
    pairs = Pairs(position, radius, young, law, touching)
    expected = pairs.forces()
    scale = np.abs(expected).max()
    assert scale > 0
    np.testing.assert_allclose(made.force(0.0, position), expected, atol=1e-10 * scale)
    assert made.energy(0.0, position) == pytest.approx(pairs.energy.sum(), rel=1e-10)
    expected = pairs.pressures()
    np.testing.assert_allclose(
        made.pressure(0.0, position), expected, atol=1e-10 * np.abs(expected).max()
    )


@pytest.mark.sample("hertz", "jkr", "jkr that does not stick")
@pytest.mark.parametrize("name", SAMPLES)
def test_jacobian_of_every_law(name):
    law = SAMPLES[name]
    position, radius, young = cluster(40, 5, spacing=0.9, variation=0.2)
    bonds = np.tile([0.9, 0.8, 0.0, 0.0], (40, 1))
    pairs = np.sort(cKDTree(position).query_pairs(12.0, output_type="ndarray"), axis=1)
    made = system(law, radius, young, bonds=bonds, touching=pairs, options={"bond_strength": 0.1})
    direction = np.random.default_rng(0).normal(size=position.shape)
    made.linearise(0.0, position)
    expected = slope(velocity_of(made), position, direction, 1e-6)
    np.testing.assert_allclose(
        product_of(made, direction), expected, atol=2e-6 * np.abs(expected).max()
    )


@given(seeds, st.integers(2, 25))
def test_differential_adhesion_is_equation_3_7(seed, n):
    position, radius, young = cluster(n, seed, spacing=0.9, variation=0.3)
    rng = np.random.default_rng(seed)
    receptor, ligand = rng.random(n), rng.random(n)
    bonds = np.stack([receptor, ligand, np.zeros(n), np.zeros(n)], axis=1)
    law = Hertz()
    made = system(law, radius, young, bonds=bonds, options={"bond_strength": 0.3})
    pairs = Pairs(position, radius, young, law)
    i, j = pairs.i, pairs.j
    area = np.pi * pairs.reduced * np.maximum(pairs.overlap, 0.0)
    adhesion = area * 0.3 * 0.5 * (receptor[i] * ligand[j] + ligand[i] * receptor[j])
    expected = pairs.forces(pairs.force - adhesion)
    np.testing.assert_allclose(
        made.force(0.0, position), expected, atol=1e-12 * np.abs(expected).max() + 1e-15
    )


def pull(receptor, ligand, strength=0.1):
    """Return the bond force between two touching cells that would not stick otherwise."""
    position = np.array([[0.0, 0, 0], [9.0, 0, 0]])
    radius, young = np.array([5.0, 5.5]), np.ones(2)
    bonds = np.stack([receptor, ligand, np.zeros(2), np.zeros(2)], axis=1)
    options = {"bond_strength": strength}
    bare = system(Hertz(), radius, young).force(0.0, position)
    return (system(Hertz(), radius, young, bonds=bonds, options=options).force(0.0, position)
            - bare)[0, 0]  # fmt: skip


def test_bonds_are_symmetric_need_both_partners_and_scale_with_receptors():
    one = pull(np.array([0.9, 0.2]), np.array([0.1, 0.8]))
    assert one > 0  # cell 0 is pulled towards cell 1
    assert pull(np.array([0.2, 0.9]), np.array([0.8, 0.1])) == pytest.approx(one, rel=1e-12)
    assert pull(np.array([0.0, 0.9]), np.array([0.0, 0.9])) == 0.0
    assert pull(np.array([0.9, 0.0]), np.array([0.9, 0.0])) == 0.0
    assert pull(np.array([1.8, 0.4]), np.array([0.1, 0.8])) == pytest.approx(2 * one, rel=1e-12)
    expected = np.pi * (5 * 5.5 / 10.5) * 1.5 * 0.1 * 0.5 * (0.9 * 0.8 + 0.1 * 0.2)
    assert one == pytest.approx(expected, rel=1e-12)


def test_bonds_change_during_a_step():
    position, radius, young = cluster(30, 2)
    rates = np.tile([0.9, 0.8, -0.09, -0.02], (30, 1))
    there = np.tile([0.45, 0.7, 0.0, 0.0], (30, 1))
    options = {"bond_strength": 0.1}
    moving = system(JKR(), radius, young, bonds=rates, options=options)
    frozen = system(JKR(), radius, young, bonds=there, options=options)
    np.testing.assert_allclose(
        moving.force(5.0, position), frozen.force(0.0, position), rtol=1e-10, atol=1e-12
    )


@pytest.mark.parametrize("law", [JKR(), ExactJKR()])
def test_surface_energy_by_type(law):
    n = 150
    position, radius, young = cluster(n, 8, spacing=0.95)
    kind = np.random.default_rng(3).integers(0, 2, n)
    matrix = np.array([[0.1, 0.02], [0.02, 0.05]])
    touching = np.sort(cKDTree(position).query_pairs(12.0, output_type="ndarray"), axis=1)
    made = system(law, radius, young, kind=kind, touching=touching, options={"pair_table": matrix})
    pairs = Pairs(position, radius, young, law, touching, sigma=matrix[np.ix_(kind, kind)])
    expected = pairs.forces()
    found = made.force(0.0, position)
    np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())
    assert made.energy(0.0, position) == pytest.approx(pairs.energy.sum(), rel=1e-10)


def test_one_type_is_the_plain_law():
    position, radius, young = cluster(80, 4)
    alike = system(
        JKR(surface_energy=0.7), radius, young, kind=np.zeros(80, int),
        options={"pair_table": np.array([[0.1]])},
    )  # fmt: skip
    plain = system(JKR(surface_energy=0.1), radius, young)
    assert np.array_equal(alike.force(0.0, position), plain.force(0.0, position))


def test_external_force_and_its_rate():
    position, radius, young = np.array([[0.0, 0, 0]]), np.array([5.0]), np.array([1.0])
    push = np.array([[1.0, 0.0, -2.0, 0.5, 0.25, 0.0]])
    made = system(JKR(), radius, young, push=push)
    np.testing.assert_allclose(made.force(4.0, position), [[3.0, 1.0, -2.0]], rtol=1e-14)
    out = np.empty((1, 3))
    made.velocity(4.0, position, out)
    np.testing.assert_allclose(out, np.array([[3.0, 1.0, -2.0]]) / (30 * np.pi * 5.0), rtol=1e-14)


def test_contacts_and_hysteresis():
    """Two cells between breaking and first contact touch only if they touched before."""
    law = ExactJKR(surface_energy=0.1)
    radius, young = np.full(2, 10.0), np.ones(2)
    gap = 0.5 * float(law.reach(effective_modulus(1, 0.5, 1, 0.5), 5.0))
    position = np.array([[0.0, 0, 0], [20.0 + gap, 0, 0]])
    apart = system(law, radius, young)
    assert len(apart.contacts(0.0, position)) == 0
    assert (apart.force(0.0, position) == 0).all()
    bound = system(law, radius, young, touching=np.array([[0, 1]]))
    assert bound.contacts(0.0, position).tolist() == [[0, 1]]
    assert bound.force(0.0, position)[0, 0] > 0
    beyond = position * (1 + gap / 10)
    assert len(bound.contacts(0.0, beyond)) == 0
    assert (bound.force(0.0, beyond) == 0).all()


def test_contacts_of_several_chunks_stand_once():
    position, radius, young = cluster(300, 6)
    made = system(JKR(), radius, young, options={"chunk": 64})
    pairs = cKDTree(position).query_pairs(2 * radius.max(), output_type="ndarray")
    distance = np.linalg.norm(position[pairs[:, 0]] - position[pairs[:, 1]], axis=1)
    expected = np.sort(pairs[distance <= radius[pairs].sum(axis=1)], axis=1)
    expected = expected[np.lexsort((expected[:, 1], expected[:, 0]))]
    np.testing.assert_array_equal(made.contacts(0.0, position), expected)


def test_growing_exact_contacts_end_at_the_right_unit():
    law = ExactJKR(surface_energy=0.1)
    position, radius, young = cluster(40, 9, spacing=0.9)
    rate = np.full(40, 0.01)
    growing = system(law, radius, young, rate=rate, duration=10.0)
    grown = system(law, radius + 0.1, young)
    np.testing.assert_allclose(
        growing.force(10.0, position), grown.force(0.0, position), rtol=1e-9, atol=1e-12
    )


@pytest.mark.parametrize("law", SAMPLES.values(), ids=SAMPLES)
def test_cells_that_only_meet_are_in_contact_where_contacts_form_at_an_overlap_of_zero(law):
    """Other laws need an overlap above zero; 5 + 5 - 10 has no rounding."""
    young, radius = np.ones(3), np.full(3, 5.0)
    position = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, np.nextafter(10.0, 0.0), 0.0]])
    found = system(law, radius, young).contacts(0.0, position).tolist()
    assert found == ([[0, 1], [0, 2]] if law.remembers else [[0, 2]])
