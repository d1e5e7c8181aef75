"""Springs between given pairs against closed forms, differences, and SciPy's integrators."""

import numpy as np
import pytest
from formulas import end_of
from strategies import cluster

from multicell.contact.hertz import Hertz
from multicell.contact.jkr import JKR
from multicell.integrators import registry as integrators
from multicell.integrators.auto import decay_rate
from multicell.integrators.registry import METHODS
from multicell.mechanics.jacobian import Pattern, limited, sparse_jacobian
from multicell.mechanics.motion import Motion
from multicell.mechanics.preconditioners import preconditioner
from multicell.mechanics.system import Mechanics
from multicell.scene.parts import IntegratorOptions

DRAG = 6 * np.pi * 5.0


def joined(position, pairs, stiffness, rest, *, radius=4.0, duration=50.0, law=None, **options):
    """Return the mechanics of cells with springs, ready for a coupling step."""
    n = len(position)
    radius = np.full(n, radius) if np.isscalar(radius) else radius
    spring = np.stack([np.full(len(pairs), stiffness), np.full(len(pairs), rest)], axis=1)
    system = Mechanics(law or Hertz(), 5.0, **options)
    motion = Motion(
        radius, np.zeros(n), np.ones(n), np.full(n, 0.5), 0.0, duration,
        spring_pairs=np.array(pairs), spring=spring,
    )  # fmt: skip
    system.begin(motion)
    return system


def tissue(n=40, seed=3, **options):
    """Return a cluster in which each cell has springs to others, near and far, some twice."""
    position, radius, _ = cluster(n, seed)
    rng = np.random.default_rng(seed)
    pairs = np.stack([rng.permutation(n), rng.permutation(n)], axis=1)
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    pairs = np.concatenate([pairs, pairs[:3, ::-1]])
    return joined(position, pairs, 0.7, 9.0, radius=radius, **options), position


def test_two_cells_relax_exponentially_to_the_length_at_rest():
    """d/dt (d - L) = -k (1/Γ_1 + 1/Γ_2) (d - L), without contact; the centre of drag stays."""
    radius = np.array([3.0, 5.0])
    start = np.array([[0.0, 0.0, 0.0], [14.0, 0.0, 0.0]])
    system = joined(start, [[0, 1]], 2.0, 20.0, radius=radius, duration=120.0)
    rate = 2.0 * (1.0 / (DRAG * radius)).sum()
    options = IntegratorOptions(method="cvode", rtol=1e-9, atol=1e-8)
    out = integrators.from_options(options).integrate(system, start)
    assert out.done
    distance = np.linalg.norm(out.position[1] - out.position[0])
    assert distance == pytest.approx(20.0 - 6.0 * np.exp(-120.0 * rate), abs=1e-5)
    np.testing.assert_allclose(radius @ out.position, radius @ start, atol=1e-7)


def test_modes_of_a_chain_decay_at_their_known_rates():
    """A free chain at rest has λ_m = 4 k/Γ sin²(π m / 2N) along itself, and none across."""
    n, k = 12, 1.5
    position = np.zeros((n, 3))
    position[:, 1] = 20.0 * np.arange(n)
    system = joined(position, [[i, i + 1] for i in range(n - 1)], k, 20.0)
    system.linearise(0.0, position)
    matrix = sparse_jacobian(system).toarray()
    found = np.sort(np.linalg.eigvalsh(-matrix[1::3, 1::3]))
    exact = 4.0 * k / (DRAG * 4.0) * np.sin(np.pi * np.arange(n) / (2 * n)) ** 2
    np.testing.assert_allclose(found, exact, atol=1e-14)
    np.testing.assert_allclose(matrix[::3, ::3], 0.0, atol=1e-15)
    assert decay_rate(system, position) <= exact[-1] * (1 + 1e-12)
    assert exact[-1] <= system.stiffness_bound(0.0, position) * (1 + 1e-12)


def test_force_is_minus_the_gradient_of_the_energy_and_adds_up_to_nothing():
    system, position = tissue(law=JKR(surface_energy=0.1))
    force, rng = system.force(0.0, position), np.random.default_rng(0)
    np.testing.assert_allclose(force.sum(axis=0), 0.0, atol=1e-11)
    np.testing.assert_allclose(np.cross(position, force).sum(axis=0), 0.0, atol=1e-9)
    for _ in range(5):
        v = rng.normal(size=position.shape)
        ends = [system.energy(0.0, position + s * 1e-5 * v) for s in (1, -1)]
        assert -(force * v).sum() == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-6)
    plain = Mechanics(JKR(surface_energy=0.1), 5.0)
    plain.begin(system.motion)
    plain.springs = None
    i, j = system.motion.spring_pairs.T
    away = position[j] - position[i]
    length = np.linalg.norm(away, axis=1)
    exact = plain.force(0.0, position)
    pull = 0.7 * (length - 9.0)[:, None] * away / length[:, None]
    np.add.at(exact, i, pull)
    np.add.at(exact, j, -pull)
    np.testing.assert_allclose(force, exact, atol=1e-12)
    virial = -0.25 * np.bincount(np.r_[i, j], np.tile(0.7 * (length - 9.0) * length, 2), len(force))
    difference = system.pressure(0.0, position) - plain.pressure(0.0, position)
    volume = 4.0 / 3.0 * np.pi * system.motion.radius**3
    np.testing.assert_allclose(3.0 * volume * difference, 2.0 * virial, atol=1e-10)


@pytest.mark.parametrize("friction", [(0.0, 0.0), (0.1, 0.05)])
def test_jacobian_is_the_derivative_of_the_velocity(friction, monkeypatch):
    monkeypatch.setattr("multicell.mechanics.friction._INNER", 1e-12)
    system, position = tissue(friction=friction)
    system.linearise(0.0, position)
    v = np.random.default_rng(1).normal(size=position.shape)
    product, ends = np.empty_like(v), []
    system.jacobian_product(v, product)
    if max(friction):  # the derivative of Γ is left out: Γ J is dF/dx
        image = np.empty_like(v)
        system._pair_friction._linearised.apply(product, image)
        product = image
        ends = [system.force(0.0, position + s * 1e-6 * v) for s in (1, -1)]
    else:
        matrix = sparse_jacobian(system)
        np.testing.assert_allclose((matrix @ v.ravel()).reshape(-1, 3), product, atol=1e-12)
        pattern = Pattern.near(position, system.motion, 0.2)
        values = np.empty(len(pattern.index))
        assert pattern.fill(system, values, system.linearisation) == 0
        np.testing.assert_array_equal(pattern.matrix(values).toarray(), matrix.toarray())
        for s in (1, -1):
            ends.append(np.empty_like(v))
            system.velocity(0.0, position + s * 1e-6 * v, ends[-1])
    exact = (ends[0] - ends[1]) / 2e-6
    np.testing.assert_allclose(product, exact, rtol=1e-5, atol=1e-6 * np.abs(exact).max())


@pytest.mark.parametrize("name", ["blocks", "gauss-seidel", "incomplete"])
def test_preconditioners_know_of_springs(name):
    """The preconditioned operator is nearer to one than the plain one, and exact for one spring."""
    system, position = tissue()
    system.linearise(0.0, position)
    linear, _ = limited(system, 0.5)
    gamma, size = 2000.0, position.size
    approximate = preconditioner(name, system)
    approximate.setup(system, gamma, linear)
    jacobian = sparse_jacobian(system).toarray()
    inverse = np.empty((size, size))
    for k, unit in enumerate(np.eye(size)):
        out = np.empty_like(position)
        approximate.solve(system, unit.reshape(-1, 3), out)
        inverse[:, k] = out.ravel()
    whole = np.eye(size) - gamma * jacobian
    spread = [np.ptp(np.abs(np.linalg.eigvals(m))) for m in (whole, inverse @ whole)]
    assert spread[1] < 0.3 * spread[0]


@pytest.mark.parametrize("method", sorted(set(METHODS) - {"auto"}))
def test_all_methods_come_to_the_same_end(method):
    """The reference is SciPy's DOP853 on the same right-hand side."""
    system, position = tissue(12, law=Hertz())
    motion = system.motion
    i, j = motion.spring_pairs.T

    def springs(x, _):
        total, away = np.zeros_like(x), x[j] - x[i]
        length = np.linalg.norm(away, axis=1)[:, None]
        np.add.at(total, i, 0.7 * (length - 9.0) * away / length)
        np.add.at(total, j, -0.7 * (length - 9.0) * away / length)
        return total

    exact = end_of(
        position, motion.radius, motion.young, Hertz(), motion.end, outer=springs
    )  # fmt: skip
    info = METHODS[method]
    step = {"euler": 0.01, "backward-euler": 0.05}.get(method, 0.25)
    atol = 1e-3 if info.order == 1 else 1e-5
    made = integrators.from_options(
        IntegratorOptions(method=method, rtol=1e-9, atol=atol, step=step, max_steps=200000)
    )
    out = made.integrate(system, position)
    assert out.done, out.problem
    np.testing.assert_allclose(out.position, exact, atol=5e-3)


def test_energy_falls():
    system, position = tissue(30, law=Hertz())
    made = integrators.from_options(IntegratorOptions(method="rkc2", atol=1e-4))
    energy = [system.energy(0.0, position)]
    for _ in range(8):
        system.begin(system.motion)
        position = made.integrate(system, position).position
        energy.append(system.energy(system.motion.end, position))
    assert (np.diff(energy) < 0.0).all()


def test_threads_give_the_same_bits():
    found = []
    for threads in (1, 2):
        system, position = tissue(2000, threads=threads, chunk=64)
        out = np.empty_like(position)
        system.velocity(0.0, position, out)
        system.linearise(0.0, position)
        product = np.empty_like(position)
        system.jacobian_product(position, product)
        found.append((out, product))
    for one, two in zip(*found, strict=True):
        np.testing.assert_array_equal(one, two)
