"""The largest eigenvalue of the Jacobian against closed forms and dense matrices."""

import numpy as np
import pytest
from formulas import dense_jacobian
from scipy.integrate import solve_ivp
from strategies import cluster, mechanics

from multicell import Hertz
from multicell.mechanics.growth_rate import PRODUCTS, largest_growth_rate
from multicell.mechanics.walls import Walls


def divided(n, seed, law=None, **options):
    """Return a loose cluster in which three cells have just become two, close together."""
    position, radius, young = cluster(n, seed, spacing=0.95)
    for k in range(3):
        middle, axis = position[k], np.array([0.6, 0.8, 0.0])
        position = np.vstack([position, middle + 1.5 * axis])
        position[k] = middle - 1.5 * axis
        radius, young = np.append(radius, 4.0), np.append(young, 1.0)
        radius[k] = 4.0
    return mechanics(radius, young, law, **options), position


def largest_of(system, position, dimensions=3):
    """Return the largest and the smallest eigenvalue of the dense Jacobian."""
    matrix = dense_jacobian(system, position)
    kept = np.arange(position.size) % 3 < dimensions
    values = np.linalg.eigvals(matrix[np.ix_(kept, kept)])
    return values.real.max(), values.real.min()


@pytest.mark.parametrize("distance", [6.0, 9.0])
def test_two_compressed_cells_buckle_at_the_rate_of_their_prestress(distance):
    """Across the line of centres J is F/d (1/Γ₁ + 1/Γ₂)."""
    radius, position = np.array([4.0, 6.0]), np.array([[0.0, 0.0, 0.0], [0.0, distance, 0.0]])
    system = mechanics(radius, np.ones(2), Hertz(), viscosity=2.0)
    force = system.force(0.0, position)[1, 1]
    expected = force / distance * (1.0 / (12.0 * np.pi * radius)).sum()
    found = largest_growth_rate(system, 0.0, position)
    assert expected > 0.0
    assert found.rate == pytest.approx(expected, rel=1e-10)
    assert (found.products, found.problem) == (6, "")


@pytest.mark.parametrize("viscosity", [5.0, 0.05])
@pytest.mark.parametrize("seed", [1, 2])
def test_freshly_divided_clusters_have_the_eigenvalue_of_the_dense_matrix(seed, viscosity):
    system, position = divided(40, seed, viscosity=viscosity)
    largest, smallest = largest_of(system, position)
    found = largest_growth_rate(system, 0.0, position)
    assert largest > 0.3 * abs(smallest)
    assert found.rate == pytest.approx(largest, rel=1e-5)
    assert found.error <= 1e-3 * largest
    assert 5 < found.products <= PRODUCTS


@pytest.mark.parametrize("products", [5, 8, 12, 20])
def test_no_more_products_are_spent_than_allowed_and_the_error_is_estimated(products):
    system, position = divided(60, 3)
    values = np.linalg.eigvals(dense_jacobian(system, position)).real
    largest = values.max()
    before = system.work.jacobian_products
    found = largest_growth_rate(system, 0.0, position, products=products)
    assert system.work.jacobian_products - before == found.products <= products
    assert found.rate <= largest * (1.0 + 1e-6)
    assert np.abs(values - found.rate).min() <= found.error + 1e-6 * largest
    if products >= 12:
        assert largest - found.rate <= found.error + 1e-6 * largest


def test_a_settled_cluster_has_none():
    position, radius, young = cluster(60, 5, spacing=0.9)
    # the time scale of contacts is some 50 s
    system = mechanics(radius, young, viscosity=0.05, duration=1e4)
    out = np.empty_like(position)

    def velocity(time, y):
        system.velocity(time, y.reshape(-1, 3), out)
        return out.ravel()

    settled = solve_ivp(velocity, (0.0, 1e4), position.ravel(), "LSODA", rtol=1e-9, atol=1e-9)
    position = settled.y[:, -1].reshape(-1, 3)
    _, smallest = largest_of(system, position)
    found = largest_growth_rate(system, 1e4, position)
    assert 0.0 <= found.rate <= 1e-3 * abs(smallest)
    assert found.error <= 0.1 * abs(smallest)
    # with as many products as there are coordinates nothing is left open
    whole = largest_growth_rate(system, 1e4, position, products=position.size)
    assert abs(whole.rate) <= 1e-5 * abs(smallest)


def test_in_a_plane_motions_out_of_it_do_not_count():
    radius, position = np.full(3, 5.0), np.array([[0.0, 0, 0], [6.0, 0, 0], [3.0, 5.0, 0]])
    system = mechanics(radius, np.ones(3), Hertz())
    expected, _ = largest_of(system, position, 2)
    found = largest_growth_rate(system, 0.0, position, dimensions=2)
    assert found.rate == pytest.approx(expected, abs=1e-9)
    assert largest_growth_rate(system, 0.0, position).rate > found.rate + 1e-4


def test_cells_that_touch_nothing_and_no_cells_have_zero():
    position = np.arange(90.0).reshape(30, 3) * 50.0
    system = mechanics(np.full(30, 5.0), np.ones(30))
    found = largest_growth_rate(system, 0.0, position)
    assert (found.rate, found.error, found.products) == (0.0, 0.0, 1)
    none = largest_growth_rate(mechanics(np.empty(0), np.empty(0)), 0.0, np.empty((0, 3)))
    assert none.rate == 0.0


def test_between_walls_it_may_be_negative():
    system = mechanics(np.array([5.0]), np.ones(1), walls=Walls(np.zeros(3), np.full(3, 50.0), 0.5))
    position = np.array([[4.0, 4.5, 4.8]])
    largest, _ = largest_of(system, position)
    assert largest < 0.0
    assert largest_growth_rate(system, 0.0, position).rate == pytest.approx(largest, rel=1e-5)


def test_the_same_state_gives_the_same_bits():
    system, position = divided(40, 7)
    first, second = (largest_growth_rate(system, 0.0, position) for _ in range(2))
    assert first == second


def test_with_friction_it_is_not_given():
    system, position = divided(20, 1, friction=(0.1, 0.1))
    found = largest_growth_rate(system, 0.0, position)
    assert np.isnan(found.rate)
    assert "friction" in found.problem


@pytest.mark.parametrize("wrong", [{"products": 4}, {"dimensions": 1}])
def test_what_has_no_meaning_is_refused(wrong):
    system, position = divided(10, 1)
    with pytest.raises(ValueError, match=next(iter(wrong))):
        largest_growth_rate(system, 0.0, position, **wrong)
