"""Forces, Jacobian, energy and pressure of populations."""

import numpy as np
import pytest
from formulas import pair, product_of, reduced, slope, velocity_of
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from strategies import cluster, laws, mechanics, radii, seeds

from multicell import JKR, Hertz
from multicell.mechanics import neighbours
from multicell.mechanics.motion import StateRejected


@given(seeds, laws, st.integers(2, 40))
def test_forces_sum_to_zero(seed, law, n):
    position, radius, young = cluster(n, seed, variation=0.3)
    force = mechanics(radius, young, law).force(0.0, position)
    assert np.abs(force.sum(axis=0)).max() <= 1e-12 * max(np.abs(force).sum(), 1e-300)


@given(seeds, laws, st.integers(2, 25))
def test_force_is_minus_the_gradient_of_the_energy(seed, law, n):
    """Away from first contact, where the stiffness of JKR is unbounded."""
    position, radius, young = _away_from_first_contact(n, seed)
    system = mechanics(radius, young, law)
    direction = np.random.default_rng(seed).normal(size=position.shape)
    rise = slope(lambda x: system.energy(0.0, x), position, direction, 1e-5)
    force = system.force(0.0, position)
    scale = np.abs(force * direction).sum() + 1e-9
    assert rise == pytest.approx(-(force * direction).sum(), abs=1e-6 * scale)


@given(seeds, laws, st.integers(2, 25))
def test_jacobian_product_is_the_directional_derivative(seed, law, n):
    position, radius, young = _away_from_first_contact(n, seed)
    system = mechanics(radius, young, law)
    direction = np.random.default_rng(seed).normal(size=position.shape)
    system.linearise(0.0, position)
    expected = slope(velocity_of(system), position, direction, 2e-6)
    np.testing.assert_allclose(
        product_of(system, direction), expected, atol=1e-6 * np.abs(expected).max() + 1e-12
    )


def _away_from_first_contact(n, seed):
    """Return a cluster in which no two cells are within 0.01 µm of first contact."""
    for attempt in range(100):
        position, radius, young = cluster(n, [seed, attempt], variation=0.3)
        pairs = cKDTree(position).query_pairs(2 * radius.max() + 1, output_type="ndarray")
        distance = np.linalg.norm(position[pairs[:, 0]] - position[pairs[:, 1]], axis=1)
        if (np.abs(radius[pairs].sum(axis=1) - distance) > 0.01).all():
            return position, radius, young
    raise AssertionError("no cluster away from first contact was found")


def test_velocity_is_force_over_stokes_drag_of_the_growing_radius():
    position, radius, young = cluster(60, 2)
    rate = np.linspace(0.0, 2e-3, 60)
    growing = mechanics(radius, young, rate=rate, duration=100.0)
    later = mechanics(radius + 40.0 * rate, young)
    found = velocity_of(growing, 40.0)(position)
    drag = 6 * np.pi * 5.0 * (radius + 40.0 * rate)
    np.testing.assert_allclose(found, velocity_of(later)(position), rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(found, later.force(0.0, position) / drag[:, None], rtol=1e-9)


def test_threads_do_not_change_a_bit():
    position, radius, young = cluster(3000, 3)
    vector = np.random.default_rng(0).normal(size=position.shape)
    results = []
    for threads in (1, 2):
        system = mechanics(radius, young, threads=threads, chunk=256)
        assert system._shared(neighbours.build(position, radius, 0.5, chunk=256)) == (threads > 1)
        v = velocity_of(system)(position)
        system.linearise(0.0, position)
        results.append((v, product_of(system, vector)))
    assert np.array_equal(results[0][0], results[1][0])
    assert np.array_equal(results[0][1], results[1][1])


def test_list_survives_motion_within_its_skin_and_is_rebuilt_beyond():
    position, radius, young = cluster(400, 6)
    system = mechanics(radius, young)
    rng = np.random.default_rng(0)
    for scale in (0.0, 0.01, 0.1, 1.0, 30.0):
        moved = position + rng.normal(0.0, scale, position.shape)
        fresh = mechanics(radius, young)
        # the order of the pairs, and with it the last bits, may differ
        np.testing.assert_allclose(
            velocity_of(system)(moved), velocity_of(fresh)(moved), rtol=1e-9, atol=1e-12
        )
    assert 2 <= system.work.list_builds <= 4


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_position_that_is_no_number_is_rejected(bad):
    position, radius, young = cluster(10, 0)
    system = mechanics(radius, young)
    velocity_of(system)(position)
    position[3, 1] = bad
    with pytest.raises(StateRejected, match="not a number"):
        velocity_of(system)(position)


def test_coincident_and_far_cells_give_finite_forces():
    position, radius, young = cluster(50, 0)
    position[1] = position[0]
    position[2] = [1e15, -1e15, 1e15]
    position[3] = [1e300, 0, 0]
    system = mechanics(radius, young)
    assert np.isfinite(velocity_of(system)(position)).all()
    assert np.isfinite(system.energy(0.0, position))
    assert np.isfinite(system.pressure(0.0, position)).all()
    assert np.isfinite(system.stiffness_bound(0.0, position))


@given(radii, st.floats(0.05, 0.6))
def test_pressure_of_a_pair_is_its_virial(r, fraction):
    law, distance = JKR(surface_energy=0.1), 2 * r * (1 - fraction / 2)
    system = mechanics(np.array([r, r]), np.array([1.0, 1.0]), law)
    position = np.array([[0.0, 0, 0], [0, distance, 0]])
    force, _ = pair(law, 2 * r - distance, *reduced(1.0, 1.0, r, r))
    expected = force * distance / 2 / (3 * 4 / 3 * np.pi * r**3)
    np.testing.assert_allclose(system.pressure(0.0, position), expected, rtol=1e-10)


@pytest.mark.parametrize("law", [Hertz(), JKR(surface_energy=0.02)])
def test_stiffness_bound_encloses_the_decay_rates(law):
    position, radius, young = cluster(40, 8)
    system = mechanics(radius, young, law)
    bound = system.stiffness_bound(0.0, position)
    units = np.eye(120).reshape(120, 40, 3)
    columns = np.stack([product_of(system, unit).ravel() for unit in units], axis=1)
    largest = -np.linalg.eigvals(columns).real.min()
    assert largest <= bound <= 2.5 * largest


def test_preconditioner_solves_the_block_diagonal_system():
    position, radius, young = cluster(30, 9)
    system = mechanics(radius, young, Hertz())
    system.linearise(0.0, position)
    gamma = 25.0
    system.setup_preconditioner(gamma)
    vector = np.random.default_rng(0).normal(size=position.shape)
    found = np.empty_like(vector)
    system.precondition(vector, found)
    pairs = cKDTree(position).query_pairs(2 * radius.max(), output_type="ndarray")
    for cell in range(30):
        block = np.eye(3)
        for i, j in pairs[(pairs == cell).any(axis=1)]:
            n = position[j] - position[i]
            d = np.linalg.norm(n)
            modulus, size = reduced(young[i], young[j], radius[i], radius[j])
            k = 1.5 * modulus * np.sqrt(size * max(radius[i] + radius[j] - d, 0.0))
            block += gamma * k / (6 * np.pi * 5 * radius[cell]) * np.outer(n, n) / d**2
        np.testing.assert_allclose(block @ found[cell], vector[cell], rtol=1e-9, atol=1e-12)


def test_products_need_a_linearisation():
    position, radius, young = cluster(5, 0)
    with pytest.raises(RuntimeError, match="linearise"):
        mechanics(radius, young).jacobian_product(position, np.empty_like(position))
