"""Elastic walls against closed forms, differences, and integrators that are not ours."""

import numpy as np
import pytest
from formulas import end_of
from strategies import ONE_OF_A_KIND, cluster

from multicell.contact.hertz import Hertz
from multicell.contact.jkr import JKR
from multicell.contact.law import compliance
from multicell.integrators import registry as integrators
from multicell.integrators.auto import measured_rate
from multicell.mechanics import forces as kernels
from multicell.mechanics.jacobian import limited, sparse_jacobian
from multicell.mechanics.motion import Motion
from multicell.mechanics.preconditioners import Sweeps
from multicell.mechanics.system import Mechanics
from multicell.mechanics.walls import Walls
from multicell.scene.parts import IntegratorOptions

HALF = 18.0
WALL = {"young": 2.0, "poisson": 0.3}
PUSH = np.random.default_rng(9).normal(0.0, 0.3, (40, 6)) * [1, 1, 1, 0, 0, 0]
"""Constant forces on each of 40 cells, nN."""


def walls(half=HALF, axes=3):
    high = np.where(np.arange(3) < axes, half, np.inf)
    return Walls(-high, high, float(compliance(**WALL)))


def pressed(n=40, seed=3, *, law=None, rate=0.0, push=None, half=HALF, duration=50.0, **options):
    """Return a cluster that does not fit into its box without pressing against the sides."""
    position, radius, young = cluster(n, seed)
    position = np.clip(position, -half + 2.5, half - 2.5)
    system = Mechanics(law or Hertz(), 5.0, walls=walls(half), **options)
    motion = Motion(radius, np.full(n, rate), young, np.full(n, 0.5), 0.0, duration, push=push)
    system.begin(motion)
    return system, position


def wall_force(position, radius, young, half=HALF):
    """Return the closed form, written down once more: Hertz's sphere on a flat half space."""
    modulus = 1.0 / (0.75 * (1 - 0.5**2) / young + 0.75 * (1 - 0.3**2) / 2.0)
    low = np.maximum(radius[:, None] - (position + half), 0.0)
    high = np.maximum(radius[:, None] - (half - position), 0.0)
    return (modulus * np.sqrt(radius))[:, None] * (low**1.5 - high**1.5)


def test_one_cell_at_a_wall_feels_hertz_on_a_half_space():
    """With E* = ¾ E_iw the textbook has F = 4/3 E* √R h^{3/2}."""
    radius, young = np.array([4.0]), np.array([1.3])
    system = Mechanics(Hertz(), 5.0, walls=walls())
    system.begin(Motion(radius, np.zeros(1), young, np.array([0.4]), 0.0, 1.0))
    plane = 1.0 / ((1 - 0.4**2) / 1.3 + (1 - 0.3**2) / 2.0)
    for h in (-1.0, 0.0, 1e-6, 0.5, 3.9, 7.0):
        for axis in range(3):
            for sign in (-1.0, 1.0):
                position = np.zeros((1, 3))
                position[0, axis] = sign * (HALF - 4.0 + h)
                exact = np.zeros((1, 3))
                exact[0, axis] = -sign * 4 / 3 * plane * 2.0 * max(h, 0.0) ** 1.5
                found = system.force(0.0, position)
                np.testing.assert_allclose(found, exact, rtol=1e-9, atol=1e-12)
    # in a corner the sides add up, and a side at infinity is none
    corner = np.full((1, 3), HALF - 3.0)
    assert (system.force(0.0, corner) < 0.0).all()
    system.walls = walls(axes=2)
    assert (system.force(0.0, corner) < 0.0).tolist() == [[True, True, False]]


@pytest.mark.parametrize("law", [Hertz(), JKR(surface_energy=0.1)])
def test_force_is_minus_the_gradient_of_the_energy(law):
    system, position = pressed(law=law)
    force, rng = system.force(0.0, position), np.random.default_rng(0)
    assert np.abs(wall_force(position, system.motion.radius, system.motion.young)).max() > 1.0
    for _ in range(5):
        v = rng.normal(size=position.shape)
        ends = [system.energy(0.0, position + s * 1e-5 * v) for s in (1, -1)]
        slope = (ends[0] - ends[1]) / 2e-5
        assert -(force * v).sum() == pytest.approx(slope, rel=1e-6)


def test_momentum_only_walls_push_the_whole():
    """Contacts bring no force in total: the sum is that of the walls, by the closed form."""
    system, position = pressed(law=JKR(surface_energy=0.1))
    radius, young = system.motion.radius, system.motion.young
    exact = wall_force(position, radius, young)
    np.testing.assert_allclose(system.force(0.0, position).sum(axis=0), exact.sum(axis=0),
                               rtol=1e-9, atol=1e-9)  # fmt: skip
    out = np.empty_like(position)
    system.velocity(0.0, position, out)
    drag = 6 * np.pi * 5.0 * radius[:, None]
    np.testing.assert_allclose((drag * out).sum(axis=0), exact.sum(axis=0), rtol=1e-9, atol=1e-9)
    free = Mechanics(JKR(surface_energy=0.1), 5.0)
    free.begin(system.motion)
    np.testing.assert_allclose(
        system.force(0.0, position) - free.force(0.0, position), exact, rtol=1e-9, atol=1e-9
    )


def test_jacobian_is_the_derivative_of_the_velocity():
    system, position = pressed()
    system.linearise(0.0, position)
    v = np.random.default_rng(1).normal(size=position.shape)
    product, ends = np.empty_like(v), [np.empty_like(v), np.empty_like(v)]
    system.jacobian_product(v, product)
    matrix = sparse_jacobian(system)
    np.testing.assert_allclose((matrix @ v.ravel()).reshape(-1, 3), product, atol=1e-12)
    for s, out in zip((1, -1), ends, strict=True):
        system.velocity(0.0, position + s * 1e-6 * v, out)
    exact = (ends[0] - ends[1]) / 2e-6
    np.testing.assert_allclose(product, exact, rtol=1e-5, atol=1e-7 * np.abs(exact).max())


def test_with_friction_between_cells_walls_are_a_part_of_the_force(monkeypatch):
    """Γ v = F with the walls in F; J leaves the derivative of Γ out, so that Γ J is dF/dx."""
    monkeypatch.setattr("multicell.mechanics.friction._INNER", 1e-12)
    system, position = pressed(friction=(0.1, 0.05))
    radius, young = system.motion.radius, system.motion.young
    out = np.empty_like(position)
    system.velocity(0.0, position, out)
    total = (6 * np.pi * 5.0 * radius[:, None] * out).sum(axis=0)
    exact = wall_force(position, radius, young).sum(axis=0)
    np.testing.assert_allclose(total, exact, atol=1e-5 * np.abs(exact).max())
    system.linearise(0.0, position)
    v = np.random.default_rng(1).normal(size=position.shape)
    product, image = np.empty_like(v), np.empty_like(v)
    system.jacobian_product(v, product)
    system._pair_friction._linearised.apply(product, image)
    ends = [system.force(0.0, position + s * 1e-6 * v) for s in (1, -1)]
    slope = (ends[0] - ends[1]) / 2e-6
    np.testing.assert_allclose(image, slope, rtol=1e-5, atol=1e-6 * np.abs(slope).max())


def test_one_cell_alone_has_the_walls_in_every_part_of_the_linear_algebra():
    """J = -k/Γ along the axis that is pressed, k = (3/2) E √(r h)."""
    radius, young = np.array([4.0]), np.array([1.0])
    system = Mechanics(Hertz(), 5.0, walls=walls())
    system.begin(Motion(radius, np.zeros(1), young, np.array([0.5]), 0.0, 10.0))
    position = np.array([[HALF - 3.0, 0.0, 0.0]])
    modulus = 1.0 / (0.75 * 0.75 + 0.75 * 0.91 / 2.0)
    rate = 1.5 * modulus * np.sqrt(4.0 * 1.0) / (6 * np.pi * 5.0 * 4.0)
    system.linearise(0.0, position)
    np.testing.assert_allclose(
        sparse_jacobian(system).toarray(), np.diag([-rate, 0.0, 0.0]), atol=1e-15
    )
    assert measured_rate(system, position) == pytest.approx(rate, rel=1e-9)
    assert rate <= system.stiffness_bound(0.0, position) <= 2 * rate * (1 + 1e-12)
    assert limited(system, 0.5)[1] == pytest.approx(rate * 6 * np.pi * 5.0 * 4.0, rel=1e-9)
    b = np.array([[1.0, 2.0, 3.0]])
    for approximate in (system, Sweeps(system)):
        out = np.empty_like(b)
        approximate.setup_preconditioner(7.0, system.linearisation)
        approximate.precondition(b, out)
        np.testing.assert_allclose(out, b / np.array([[1 + 7.0 * rate, 1.0, 1.0]]), rtol=1e-12)


def test_a_wall_presses_like_a_neighbour_in_the_mirror():
    """p = F d/(3 V); a wall of the cell's own kind is a twin pressed to half the indentation."""
    radius, young, nu = np.array([4.0]), np.array([1.0]), np.array([0.5])
    system = Mechanics(Hertz(), 5.0, walls=walls())
    system.begin(Motion(radius, np.zeros(1), young, nu, 0.0, 1.0))
    position = np.array([[0.0, 3.1 - HALF, 0.0]])
    force = np.linalg.norm(system.force(0.0, position))
    volume = 4 / 3 * np.pi * 4.0**3
    assert system.pressure(0.0, position)[0] == pytest.approx(force * 3.1 / (3 * volume))
    # a rigid plane between two mirrored cells: F = (4/3) E* √r h^{3/2}, h = half of their overlap
    rigid = Mechanics(Hertz(), 5.0, walls=Walls(np.full(3, -HALF), np.full(3, HALF), 0.0))
    rigid.begin(Motion(radius, np.zeros(1), young, nu, 0.0, 1.0))
    pair = Mechanics(Hertz(), 5.0)
    two = np.ones(2)
    pair.begin(Motion(4.0 * two, 0.0 * two, two, 0.5 * two, 0.0, 1.0))
    mirror = np.array([[0.0, 3.1 - HALF, 0.0], [0.0, -3.1 - HALF, 0.0]])
    np.testing.assert_allclose(
        rigid.force(0.0, position), pair.force(0.0, mirror)[:1], rtol=1e-12, atol=1e-12
    )
    np.testing.assert_allclose(
        rigid.pressure(0.0, position), pair.pressure(0.0, mirror)[:1], rtol=1e-12
    )
    assert rigid.energy(0.0, position) == pytest.approx(0.5 * pair.energy(0.0, mirror))


@pytest.fixture(scope="module")
def settled():
    """SciPy's end of a right-hand side of the test's own, without any neighbour list."""
    system, position = pressed(rate=0.002, push=PUSH)
    motion = system.motion
    return end_of(
        position, motion.radius, motion.young, Hertz(), 50.0, rate=motion.radius_rate,
        outer=lambda x, radius: wall_force(x, radius, motion.young) + PUSH[:, :3],
    )  # fmt: skip


@pytest.mark.parametrize("method", ONE_OF_A_KIND)
def test_methods_agree_with_scipy_on_a_right_hand_side_of_our_own(method, settled):
    """Compressed growing cells in a box; first order to its order, the others to tolerance."""
    first = ("euler", "backward-euler", "euler-adaptive", "multirate-euler")
    bounds = dict.fromkeys(first, 0.01)
    system, position = pressed(rate=0.002, push=PUSH)
    atol = 1e-3 if method in ("euler-adaptive", "multirate-euler") else 1e-6
    step = 0.25 if method == "backward-euler" else 0.05
    options = IntegratorOptions(method=method, rtol=1e-9, atol=atol, step=step)
    outcome = integrators.from_options(options).integrate(system, position)
    assert outcome.done, outcome.problem
    np.testing.assert_allclose(outcome.position, settled, atol=bounds.get(method, 2e-4))


def test_scenes_without_walls_use_the_same_kernels():
    """Absent walls cost nothing: the arguments of the kernels know nothing of them."""
    fields = kernels.CellData._fields + kernels.PairData._fields + Hertz().constants()._fields
    assert not any("wall" in name for name in fields)
    free = Mechanics(Hertz(), 5.0)
    position, radius, young = cluster(20, 1)
    free.begin(Motion(radius, 0 * radius, young, 0 * radius + 0.5, 0.0, 1.0))
    free.linearise(0.0, position)
    assert free.linearisation.walls.size == 0
