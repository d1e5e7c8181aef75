"""Forces, Jacobian, energy and pressure of populations."""

import numpy as np
import pytest
from formulas import product_of, reduced, velocity_of
from scipy.spatial import cKDTree
from strategies import cluster, mechanics

from multicell import JKR, Hertz
from multicell.mechanics import neighbours
from multicell.mechanics.motion import StateRejected


def test_velocity_is_force_over_stokes_drag_of_the_growing_radius():
    position, radius, young = cluster(60, 2)
    rate = np.linspace(0.0, 2e-3, 60)
    growing = mechanics(radius, young, rate=rate, duration=100.0)
    later = mechanics(radius + 40.0 * rate, young)
    found = velocity_of(growing, 40.0)(position)
    drag = 6 * np.pi * 5.0 * (radius + 40.0 * rate)
    np.testing.assert_allclose(found, velocity_of(later)(position), rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(found, later.force(0.0, position) / drag[:, None], rtol=1e-9)


def test_constants_of_a_law_that_has_whole_numbers_are_floats(monkeypatch):
    """Kernels would be compiled once more for them, and loops hand over arrays of floats."""
    whole = JKR(smoothing=1.0).constants()._replace(smoothing=1)
    monkeypatch.setattr(JKR, "constants", lambda law: whole)
    system = mechanics(np.full(2, 5.0), np.ones(2), JKR())
    assert {type(value) for value in system._law} == {float, type(None)}
    assert system._law.smoothing == 1.0


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
    system.setup_preconditioner(gamma, system.linearisation)
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


@pytest.mark.parametrize("kind", ["every second column", "column by column", "whole numbers"])
def test_arrays_of_any_kind_are_taken_as_their_numbers(kind):
    position, radius, young = cluster(60, 7)
    system = mechanics(radius, young)
    vector = np.round(np.random.default_rng(7).normal(0.0, 50.0, position.shape))

    def handed(values):
        if kind == "every second column":
            return np.repeat(values, 2, axis=1)[:, ::2]
        return np.asfortranarray(values) if kind == "column by column" else values.astype(int)

    if kind != "whole numbers":
        found = velocity_of(system)(position)
        np.testing.assert_array_equal(velocity_of(system)(handed(position)), found)
    system.linearise(0.0, position)
    found = np.empty_like(position)
    system.jacobian_product(handed(vector), found)
    np.testing.assert_array_equal(found, product_of(system, vector))
