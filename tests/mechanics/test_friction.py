"""Friction between cells: the matrix Γ, its solution, and the motion that follows."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp
from scipy.sparse import block_array, coo_array, csc_array
from scipy.sparse.linalg import spsolve
from scipy.spatial import cKDTree
from strategies import cluster, mechanics, seeds

from multicell import JKR
from multicell.contact.law import effective_modulus, effective_radius
from multicell.mechanics import friction
from multicell.mechanics.friction import FrictionMatrix, PairFriction
from multicell.mechanics.motion import StateRejected

coefficients = st.tuples(st.sampled_from([0.0, 0.1, 3.0]), st.sampled_from([0.0, 0.1, 1.0]))
PAIRS = [(0.1, 0.1), (0.4, 0.05), (0.0, 0.2), (0.3, 0.0), (0.0, 0.0)]


def system_at(position, radius, young, normal, tangential, *, shared=False, **options):
    """Return mechanics, Γ and forces at a state; friction may be as strong as Stokes drag."""
    options = {"viscosity": 0.05, **options}
    system = mechanics(radius, young, **options)
    force = system.force(0.0, position)
    gamma = FrictionMatrix(
        (normal, tangential), len(radius), system.drag, system.chunk, tolerance=1e-12
    )
    gamma.measure(system._rows, system.neighbours.pairs, shared)
    return system, gamma, force


def reference_matrix(position, radius, normal, tangential, drag):
    """Assemble Γ from the pairs of a k-d tree, (3n, 3n) sparse."""
    n = len(radius)
    i, j = cKDTree(position).query_pairs(2 * radius.max(), output_type="ndarray").T
    vector = position[j] - position[i]
    distance = np.linalg.norm(vector, axis=1)
    touching = distance < radius[i] + radius[j]
    i, j, vector, distance = i[touching], j[touching], vector[touching], distance[touching]
    unit = vector / distance[:, None]
    area = np.pi * effective_radius(radius[i], radius[j]) * (radius[i] + radius[j] - distance)
    along = unit[:, :, None] * unit[:, None, :]
    pair = area[:, None, None] * (normal * along + tangential * (np.eye(3) - along))
    incidence = coo_array(
        (np.r_[np.ones(len(i)), -np.ones(len(i))], (np.r_[: len(i), : len(i)], np.r_[i, j])),
        shape=(len(i), n),
    ).tocsr()
    blocks = [
        [incidence.T @ incidence.multiply(pair[:, a, b][:, None]) for b in range(3)]
        for a in range(3)
    ]
    stokes = csc_array((np.tile(drag * radius, 3), (np.arange(3 * n), np.arange(3 * n))))
    return csc_array(block_array(blocks) + stokes)


def flat(vector):
    """Return all x, then all y, then all z, as the reference matrix has them."""
    return np.ascontiguousarray(vector.T).ravel()


def applied(gamma, vector):
    out = np.empty_like(vector)
    gamma.apply(vector, out)
    return out


def solved(gamma, force, guess=None):
    velocity = np.zeros_like(force) if guess is None else guess.copy()
    steps = gamma.solve(force, velocity)
    return velocity, steps


@pytest.mark.parametrize(
    ("normal", "tangential", "n", "chunk"),
    [*((*pair, 200, 64) for pair in PAIRS), (0.4, 0.05, 2, 2048), (0.4, 0.05, 300, 2048)],
)
def test_matrix_is_that_of_the_pairs(normal, tangential, n, chunk):
    position, radius, young = cluster(n, 1, variation=0.3)
    system, gamma, _ = system_at(position, radius, young, normal, tangential, chunk=chunk)
    vector = np.random.default_rng(0).normal(size=position.shape)
    expected = reference_matrix(position, radius, normal, tangential, system.drag) @ flat(vector)
    np.testing.assert_allclose(
        flat(applied(gamma, vector)), expected, atol=1e-12 * np.abs(expected).max()
    )


@pytest.mark.parametrize(
    ("normal", "tangential", "chunk"), [*((*pair, 100) for pair in PAIRS), (0.4, 0.05, 2048)]
)
def test_solution_is_that_of_a_direct_solver(normal, tangential, chunk):
    position, radius, young = cluster(250, 2, variation=0.2)
    system, gamma, force = system_at(position, radius, young, normal, tangential, chunk=chunk)
    velocity, _ = solved(gamma, force)
    matrix = reference_matrix(position, radius, normal, tangential, system.drag)
    expected = spsolve(matrix, flat(force))
    np.testing.assert_allclose(flat(velocity), expected, atol=1e-10 * np.abs(expected).max())
    assert np.linalg.norm(matrix @ flat(velocity) - flat(force)) <= 2e-12 * np.linalg.norm(force)


@given(seeds, coefficients, st.sampled_from([1e-3, 1e-6, 1e-10]), st.integers(2, 40))
def test_momentum_balances_to_the_tolerance(seed, coefficient, tolerance, n):
    position, radius, young = cluster(n, seed, variation=0.2)
    system, gamma, force = system_at(position, radius, young, *coefficient)
    velocity = np.zeros_like(force)
    gamma.solve(force, velocity, tolerance)
    rest = applied(gamma, velocity) - force
    allowed = tolerance * np.linalg.norm(force) * (1 + 1e-3)
    assert np.linalg.norm(rest) <= allowed
    # friction between cells cancels in the sum: what is left is Stokes drag against F
    total = (system.drag * radius[:, None] * velocity - force).sum(axis=0)
    assert np.linalg.norm(total) <= np.sqrt(n) * allowed + 1e-13 * np.abs(force).sum()


def test_no_force_means_no_motion_whatever_the_guess():
    position, radius, young = cluster(50, 4)
    _, gamma, force = system_at(position, radius, young, 0.1, 0.1)
    velocity, steps = solved(gamma, 0.0 * force, np.ones_like(force))
    assert steps == 0
    assert not velocity.any()


def test_a_cold_start_takes_no_notice_of_the_guess():
    position, radius, young = cluster(300, 5)
    _, gamma, force = system_at(position, radius, young, 0.4, 0.1)
    velocity, steps = solved(gamma, force)
    other = np.full_like(force, np.nan)
    assert gamma.solve(force, other, warm=False) == steps
    assert np.array_equal(other, velocity)


def test_a_good_guess_saves_iterations():
    position, radius, young = cluster(500, 5)
    _, gamma, force = system_at(position, radius, young, 0.1, 0.1)
    velocity, cold = solved(gamma, force)
    assert cold > 15
    assert solved(gamma, force, velocity)[1] <= 1
    near, warm = solved(gamma, force * (1 + 1e-9), velocity)
    assert 0 < warm < cold / 2
    np.testing.assert_allclose(near, velocity * (1 + 1e-9), rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize("coefficient", [0.0, 0.1, 2.0])
@pytest.mark.parametrize("start", [0.75, 0.95])
def test_two_cells_relax_as_the_quadrature_says(coefficient, start):
    """(Γ₁Γ₂/(Γ₁ + Γ₂) + A γ_n) dd/dt = F on the line between them; γ_t has no part in it."""
    radius, young, law = np.array([4.0, 6.0]), np.array([1.0, 2.0]), JKR(surface_energy=0.1)
    modulus, reduced = effective_modulus(1, 0.5, 2, 0.5), effective_radius(4.0, 6.0)
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    system = mechanics(radius, young, law, viscosity=0.05)
    gamma = FrictionMatrix((coefficient, 0.7 * coefficient), 2, system.drag, 2048, tolerance=1e-13)

    def rate(t, y):
        force = system.force(0.0, y.reshape(2, 3))
        gamma.measure(system._rows, system.neighbours.pairs)
        return solved(gamma, force)[0].ravel()

    position = np.array([[1.0, 2.0, 3.0], [1.0, 2.0, 3.0] + start * 10.0 * axis])
    end = solve_ivp(
        rate, (0.0, 2.0), position.ravel(), method="DOP853", rtol=1e-10, atol=1e-10
    ).y[:, -1]  # fmt: skip
    reached = np.linalg.norm(end[3:] - end[:3])
    drag = system.drag * radius.prod() / radius.sum()

    def slowness(d):
        area = np.pi * reduced * (10.0 - d)
        return (drag + coefficient * area) / law.force(10.0 - d, modulus, reduced)

    rest = 10.0 - law.equilibrium_overlap(modulus, reduced)
    assert abs(reached - rest) < abs(start * 10.0 - rest)
    assert quad(slowness, start * 10.0, reached, epsabs=0, epsrel=1e-10)[0] == pytest.approx(
        2.0, rel=1e-6
    )
    # the centre of drag stays where it was
    np.testing.assert_allclose(
        (radius[:, None] * end.reshape(2, 3)).sum(axis=0), radius @ position, rtol=1e-9
    )


@given(seeds, st.sampled_from(PAIRS), st.integers(2, 25))
def test_product_with_friction_held_is_the_derivative_at_fixed_gamma(seed, coefficient, n):
    position, radius, young = cluster(n, seed, spacing=0.75, variation=0.0)
    system, gamma, _ = system_at(position, radius, young, *coefficient, law=JKR(surface_energy=0.0))
    direction = np.random.default_rng(seed).normal(size=position.shape)
    system.linearise(0.0, position)
    product = np.empty_like(position)
    system.jacobian_product(direction, product)
    found = solved(gamma, product * system.drag * radius[:, None])[0]
    step = 1e-5
    change = system.force(0.0, position + step * direction)
    change -= system.force(0.0, position - step * direction)
    expected = solved(gamma, change / (2 * step))[0]
    np.testing.assert_allclose(found, expected, atol=2e-4 * np.abs(expected).max() + 1e-12)


def test_what_does_not_converge_is_said(monkeypatch):
    position, radius, young = cluster(100, 8)
    _, gamma, force = system_at(position, radius, young, 0.1, 0.1)
    monkeypatch.setattr(friction, "_MOST", 3)
    with pytest.raises(StateRejected, match="after 3 iterations"):
        gamma.solve(force, np.zeros_like(force))
    force[4, 1] = np.nan
    with pytest.raises(StateRejected, match="nan"):
        gamma.solve(force, np.zeros_like(force))


def test_coincident_and_far_cells_give_finite_velocities():
    position, radius, young = cluster(50, 0)
    position[1] = position[0]
    position[2] = [1e15, -1e15, 1e15]
    position[3] = [1e300, 0, 0]
    _, gamma, force = system_at(position, radius, young, 0.4, 0.1)
    assert np.isfinite(solved(gamma, force)[0]).all()


@pytest.mark.parametrize(("normal", "tangential"), PAIRS)
def test_diagonal_at_the_linearisation_is_that_of_the_matrix(normal, tangential):
    position, radius, young = cluster(60, 7)
    system, _, _ = system_at(position, radius, young, normal, tangential, chunk=16)
    used = PairFriction((normal, tangential), 60, system.drag, system.chunk)
    used.linearise(system._rows, system.neighbours.pairs, False)
    full = reference_matrix(position, radius, normal, tangential, system.drag)
    expected = full.diagonal().reshape(3, 60).mean(axis=0)
    np.testing.assert_allclose(used.diagonal(), expected, rtol=1e-12)
