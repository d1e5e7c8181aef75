"""Cells whose motion is prescribed: exact for every method, and right for all others."""

import numpy as np
import pytest
from formulas import pair, reduced
from scipy.integrate import solve_ivp
from strategies import ONE_OF_A_KIND, cluster

from multicell.contact.hertz import Hertz
from multicell.contact.jkr import JKR
from multicell.integrators import registry as integrators
from multicell.integrators.registry import METHODS
from multicell.mechanics.decay_rate import largest_decay_rate
from multicell.mechanics.jacobian import limited, sparse_jacobian, sparsity
from multicell.mechanics.motion import Motion
from multicell.mechanics.preconditioners import Sweeps
from multicell.mechanics.prescribed import outside_force
from multicell.mechanics.system import Mechanics
from multicell.scene.parts import IntegratorOptions

DRAG = 6 * np.pi * 5.0
DURATION = 40.0


def driven(n=14, seed=5, *, law=None, rate=0.0, speed=0.03, duration=DURATION, **options):
    """Return a cluster with two cells that stand still, and two that move."""
    position, radius, young = cluster(n, seed)
    held, velocity = np.zeros(n, dtype=bool), np.zeros((n, 3))
    held[[0, 3, 7, 9]] = True
    velocity[7], velocity[9] = (0.0, 0.0, speed), (speed, -speed, 0.0)
    system = Mechanics(law or Hertz(), 5.0, **options)
    motion = Motion(
        radius, np.full(n, rate), young, np.full(n, 0.5), 0.0, duration, held=held,
        velocity=velocity,
    )  # fmt: skip
    system.begin(motion)
    return system, position


def end_of(system, position):
    """Return where free cells are in the end, by SciPy's DOP853 over all pairs without a list."""
    motion = system.motion
    free = ~motion.held
    i, j = np.triu_indices(len(free), 1)

    def places(t, y):
        x = position + t * motion.velocity
        x[free] = y.reshape(-1, 3)
        return x

    def velocity(t, y):
        x, size = places(t, y), motion.radius + motion.radius_rate * t
        away = x[j] - x[i]
        distance = np.linalg.norm(away, axis=1)
        modulus, small = reduced(motion.young[i], motion.young[j], size[i], size[j])
        total = size[i] + size[j]
        force, _ = pair(system.law, total - distance, modulus, small, total)
        sums = np.zeros_like(x)
        np.add.at(sums, i, -(force / distance)[:, None] * away)
        np.add.at(sums, j, (force / distance)[:, None] * away)
        return (sums / (DRAG * size[:, None]))[free].ravel()

    start = position[free].ravel()
    found = solve_ivp(velocity, (0.0, motion.end), start, "DOP853", rtol=1e-11, atol=1e-11)
    return places(motion.end, found.y[:, -1])


@pytest.fixture(scope="module")
def ends():
    """Return where cells are in the end, for those that grow and for those that are quick."""
    return [end_of(*driven(rate=0.002)), end_of(*driven(speed=0.05))]


@pytest.mark.parametrize("method", [*ONE_OF_A_KIND, "auto"])
def test_methods_move_driven_cells_exactly_and_the_others_rightly(method, ends):
    system, position = driven(rate=0.002)
    info, held = METHODS[method], system.motion.held
    step = {"euler": 0.01, "backward-euler": 0.02}.get(method, 0.25)
    atol = 1e-3 if info.order == 1 else 1e-5
    made = integrators.from_options(
        IntegratorOptions(method=method, rtol=1e-9, atol=atol, step=step, max_steps=200000)
    )
    out = made.integrate(system, position)
    assert out.done, out.problem
    end = system.at_end(out.position)
    exact = position + DURATION * system.motion.velocity
    np.testing.assert_array_equal(out.position[held], position[held])
    np.testing.assert_array_equal(end[held], exact[held])
    assert np.abs(end[~held] - position[~held]).max() > 0.3
    np.testing.assert_allclose(end, ends[0], atol=5e-3)


@pytest.mark.parametrize("method", ["heun", "rk4", "ab2"])
def test_methods_keep_their_order_while_cells_are_driven(method, ends):
    system, position = driven(speed=0.05)
    errors = []
    for step in (4.0, 2.0):
        made = integrators.from_options(IntegratorOptions(method=method, step=step))
        system.begin(system.motion)
        end = system.at_end(made.integrate(system, position).position)
        errors.append(np.abs(end - ends[1]).max())
    assert errors[1] < 1e-2
    # contacts form and break: an order of 7/4 at least where the formal one is 2 or more
    assert errors[0] / errors[1] > 2.0**1.6


def test_held_cells_are_no_unknowns_of_the_jacobian():
    system, position = driven()
    held = system.motion.held
    time = 13.0
    system.linearise(time, position)
    v = np.random.default_rng(1).normal(size=position.shape)
    product, ends = np.empty_like(v), [np.empty_like(v), np.empty_like(v)]
    system.jacobian_product(v, product)
    assert not product[held].any()
    v[held] = 0.0
    again = np.empty_like(v)
    system.jacobian_product(v, again)
    np.testing.assert_array_equal(product, again)
    matrix = sparse_jacobian(system)
    np.testing.assert_allclose((matrix @ v.ravel()).reshape(-1, 3), product, atol=1e-12)
    weight = np.repeat(system.motion.radius, 3)[:, None]
    np.testing.assert_allclose((weight * matrix.toarray()).T, weight * matrix.toarray(), atol=1e-12)
    pattern = sparsity(position, system, 0.2)
    assert not matrix.toarray()[pattern.toarray() == 0.0].any()
    for s, out in zip((1, -1), ends, strict=True):
        system.velocity(time, position + s * 1e-6 * v, out)
    exact = (ends[0] - ends[1]) / 2e-6
    assert not exact[held].any()
    np.testing.assert_allclose(product, exact, rtol=1e-5, atol=1e-7 * np.abs(exact).max())


def test_the_decay_rate_is_the_largest_eigenvalue_of_what_is_free():
    system, position = driven(law=JKR(surface_energy=0.1))
    system.linearise(0.0, position)
    eigenvalues = np.linalg.eigvals(-sparse_jacobian(system).toarray()).real
    found = largest_decay_rate(system, 0.0, position)
    assert found == pytest.approx(eigenvalues.max(), rel=0.01)


@pytest.mark.parametrize("sweeps", [True, False])
def test_preconditioners_leave_held_cells_alone(sweeps):
    system, position = driven(40)
    held = system.motion.held
    system.linearise(0.0, position)
    linear, _ = limited(system, 0.5)
    approximate = Sweeps(system) if sweeps else system
    approximate.setup_preconditioner(300.0, linear)
    b = np.random.default_rng(2).normal(size=position.shape)
    out, free = np.empty_like(b), np.empty_like(b)
    approximate.precondition(b, out)
    np.testing.assert_array_equal(out[held], b[held])
    b[held] = 0.0
    approximate.precondition(b, free)
    assert not free[held].any()
    np.testing.assert_array_equal(free[~held], out[~held])
    # nearer to the solution than no preconditioner
    jacobian = sparse_jacobian(system).toarray()
    exact = np.linalg.solve(np.eye(b.size) - 300.0 * jacobian, b.ravel()).reshape(b.shape)
    assert np.linalg.norm(free - exact) < 0.8 * np.linalg.norm(b - exact)


def friction_matrix(system, position):
    """Return Γ over all pairs, (3 n, 3 n), written down once more."""
    radius, n = system.motion.radius, len(position)
    gamma = np.kron(np.diag(DRAG * radius), np.eye(3))
    normal, tangential = system.friction
    for i in range(n):
        for j in range(i):
            away = position[j] - position[i]
            d = np.linalg.norm(away)
            h = radius[i] + radius[j] - d
            if h <= 0.0:
                continue
            area = np.pi * radius[i] * radius[j] / (radius[i] + radius[j]) * h
            along = np.outer(away, away) / d**2
            block = area * (normal * along + tangential * (np.eye(3) - along))
            for a, b, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
                gamma[3 * a : 3 * a + 3, 3 * b : 3 * b + 3] += sign * block
    return gamma


@pytest.mark.parametrize("friction", [(0.1, 0.1), (0.3, 0.05)])
@pytest.mark.parametrize("contact", ["pressed", "no forces"])
def test_friction_drags_free_cells_along(friction, contact):
    """Γ_ff v_f = F_f - Γ_fh v_h, also where no force acts at all."""
    system, position = driven(friction=friction, speed=0.4)
    if contact == "no forces":
        # without stiffness overlapping cells press each other with nothing
        system.begin(Motion(**{**vars(system.motion), "young": np.full(len(position), 1e-12)}))
    held = np.repeat(system.motion.held, 3)
    given = system.motion.velocity.ravel()
    gamma, force = friction_matrix(system, position), system.force(0.0, position).ravel()
    right = (force - gamma @ given)[~held]
    exact = np.linalg.solve(gamma[np.ix_(~held, ~held)], right)
    out = np.empty_like(position)
    for _ in range(2):  # from zeros, and from the last solution
        system.velocity(0.0, position, out)
        assert not out.ravel()[held].any()
        np.testing.assert_allclose(out.ravel()[~held], exact, atol=1e-5 * np.abs(exact).max())
    outside = outside_force(system, 0.0, position).ravel()
    whole = given.copy()
    whole[~held] = exact
    balance = gamma @ whole - force
    np.testing.assert_allclose(outside[held], balance[held], atol=1e-5 * np.abs(balance).max())
    assert not outside[~held].any()


def test_jacobian_with_friction_leaves_held_cells_alone(monkeypatch):
    monkeypatch.setattr("multicell.mechanics.friction._INNER", 1e-12)
    system, position = driven(friction=(0.1, 0.05))
    held = np.repeat(system.motion.held, 3)
    system.linearise(0.0, position)
    gamma = friction_matrix(system, position)
    v = np.random.default_rng(1).normal(size=position.shape)
    v[system.motion.held] = 0.0
    product = np.empty_like(v)
    system.jacobian_product(v, product)
    ends = [system.force(0.0, position + s * 1e-6 * v) for s in (1, -1)]
    slope = ((ends[0] - ends[1]) / 2e-6).ravel()[~held]
    found = gamma[np.ix_(~held, ~held)] @ product.ravel()[~held]
    np.testing.assert_allclose(found, slope, atol=1e-5 * np.abs(slope).max())
    assert not product.ravel()[held].any()


def test_the_force_of_a_motion_is_what_drag_and_contacts_ask_for():
    """Two spheres pressed together by held cells: Hertz, and a sphere that is towed: Stokes."""
    position = np.array([[0.0, 0.0, 0.0], [9.0, 0.0, 0.0], [200.0, 0.0, 0.0]])
    velocity = np.array([[0.0] * 3, [0.0] * 3, [0.0, 0.25, 0.0]])
    system = Mechanics(Hertz(), 5.0)
    radius = np.full(3, 5.0)
    system.begin(
        Motion(radius, np.zeros(3), np.ones(3), np.full(3, 0.5), 0.0, 4.0,
               held=np.ones(3, bool), velocity=velocity)
    )  # fmt: skip
    modulus = 1.0 / (1.5 * 0.75)
    force = modulus * np.sqrt(2.5) * 1.0**1.5
    exact = np.array([[force, 0.0, 0.0], [-force, 0.0, 0.0], [0.0, DRAG * 5.0 * 0.25, 0.0]])
    np.testing.assert_allclose(outside_force(system, 0.0, position), exact, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(system.at_end(position) - position, 4.0 * velocity, atol=1e-12)
