"""The Rosenbrock method: order, stiff modes, growth that may not be damped, what it refuses."""

import math

import numpy as np
import pytest
from formulas import growth_rate_of
from oracles import exact_end, four_cells, reference
from strategies import cluster, mechanics

import multicell as mc
from multicell import JKR, Hertz
from multicell.errors import SceneError
from multicell.integrators import rosenbrock_solver
from multicell.integrators.cvode import Cvode
from multicell.integrators.rosenbrock import Rosenbrock
from multicell.integrators.rosenbrock_solver import Resolvent, Walk, worst_cell
from multicell.mechanics.jacobian import sparse_jacobian
from multicell.mechanics.motion import Motion
from multicell.mechanics.system import Mechanics


def equal_steps(system, position, steps, **options):
    """Return where steps of one length lead, whatever their error."""
    walk = Walk(Rosenbrock(1e-12, 1e-9, worst=math.inf, **options), system, np.array(position))
    walk._tolerances = math.inf
    length = walk.length / steps
    # linear systems are solved to rounding
    walk._resolvent.solve = lambda right, *_: solved(walk._resolvent, right)
    system.velocity(system.motion.begin, walk.position, walk.velocity)
    for _ in range(steps):
        walk._step(min(length, walk.length - walk.elapsed))
    return walk.position


def solved(resolvent, right):
    """Solve with the matrix that a step takes, dense, from SciPy's sparse one."""
    system = resolvent.system
    matrix = np.eye(right.size) - (1 - math.sqrt(0.5)) * resolvent.dt * matrix_of(resolvent)
    return np.linalg.solve(matrix, right.ravel()).reshape(len(system), 3)


def matrix_of(resolvent):
    system, product = resolvent.system, np.empty((len(resolvent.system), 3))
    columns = []
    for unit in np.eye(3 * len(system)):
        system.jacobian_product(unit.reshape(-1, 3), product, resolvent.linear)
        columns.append(product.ravel().copy())
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("law", [Hertz(), JKR(surface_energy=0.1)])
@pytest.mark.parametrize("softening", [1.0, -0.5])
def test_order_is_two_for_every_matrix(law, softening):
    """Against a right-hand side of its own; a negative softening spoils the slopes at will."""
    position, radius, young = four_cells()
    exact = exact_end(four_cells, law, 60.0)
    errors = []
    for steps in (10, 20, 40):
        system = mechanics(radius, young, law, duration=60.0)
        end = equal_steps(system, position, steps, softening=softening)
        errors.append(np.abs(end - exact).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, 2.0, atol=0.15)


def test_order_is_two_while_cells_grow_and_are_pushed():
    """∂v/∂t counts: the scene has radii and forces that change."""
    position, radius, young = four_cells()
    push = np.zeros((4, 6))
    push[:, :3], push[:, 3:] = [[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]], 0.02

    def system():
        made = Mechanics(Hertz(), 1.0)
        rate = np.array([2e-3, 0.0, 1e-3, 0.0])
        made.begin(Motion(radius, rate, young, np.full(4, 0.5), 5.0, 65.0, push=push))
        return made

    exact = reference(system(), position)
    errors = [np.abs(equal_steps(system(), position, n) - exact).max() for n in (20, 40, 80)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, 2.0, atol=0.15)


def test_a_very_stiff_pair_relaxes_without_oscillation():
    """With Δt λ of a thousand and more the overlap never changes sign or grows."""
    position = np.array([[0.0, 0, 0], [9.0, 0, 0]])
    system = mechanics(np.full(2, 5.0), np.full(2, 1e4), Hertz(), duration=3600.0)
    overlaps = []
    step = Walk._step

    walk = Walk(Rosenbrock(), system, position.copy())
    walk._step = lambda length: noted(step(walk, length))

    def noted(size):
        overlaps.append(10.0 - np.linalg.norm(walk.position[1] - walk.position[0]))
        return size

    assert walk.integrate().done
    assert len(overlaps) < 100
    assert (np.diff(overlaps) <= 1e-12).all()
    assert min(overlaps) > -1e-9
    # the last step is longer than a thousand relaxation times of the first
    assert overlaps[-1] < 1e-3


def chain(count, disturbance, duration, viscosity=5.0):
    """Return a straight chain that its ends press together, nearly at rest, and its system.

    Every contact overlaps by 1 µm; E_ij = 2/3 kPa and r_ij = 2.5 µm there.
    """
    position = np.zeros((count, 3))
    position[:, 0] = 9.0 * np.arange(count)
    position[:, 1] = disturbance * np.random.default_rng(0).normal(size=count)
    push = np.zeros((count, 6))
    push[0, 0] = 4.0 / 3.0 * (2.0 / 3.0) * math.sqrt(2.5)
    push[-1, 0] = -push[0, 0]

    def system():
        made = Mechanics(Hertz(), viscosity)
        ones = np.ones(count)
        made.begin(Motion(5.0 * ones, 0.0 * ones, ones, 0.5 * ones, 0.0, duration, push=push))
        return made

    return position, system


@pytest.mark.parametrize(
    ("disturbance", "duration", "viscosity"),
    [(1e-8, 12_000.0, 5.0), (1e-4, 60.0, 0.05), (0.01, 3500.0, 5.0)],
)
def test_buckling_grows_as_it_does_in_truth(disturbance, duration, viscosity):
    """Also while it is far below the tolerance, where error control sees nothing."""
    position, system = chain(12, disturbance, duration, viscosity)
    exact = reference(system(), position, 1e-13)
    used = system()
    outcome = Rosenbrock(1e-6, 1e-2).integrate(used, position)
    assert outcome.done
    assert np.abs(exact[:, 1]).max() > 5.0 * np.abs(position[:, 1]).max()
    ratio = np.abs(outcome.position[:, 1]).max() / np.abs(exact[:, 1]).max()
    assert ratio == pytest.approx(1.0, abs=0.1)


def test_bdf_damps_the_buckling_that_is_below_its_tolerance():
    """This is what the bound is for."""
    position, system = chain(12, 1e-4, 6000.0)
    exact = reference(system(), position, 1e-13)
    damped = Cvode(1e-6, 1e-2, part=1.0).integrate(system(), position).position
    assert np.abs(damped[:, 1]).max() < 0.1 * np.abs(exact[:, 1]).max()


@pytest.mark.parametrize("growth", [0.25, 1.0])
def test_no_step_beyond_the_bound_is_taken(growth, monkeypatch):
    position, system = chain(12, 1e-6, 9000.0)
    taken = []
    step = Walk._step

    def noted(walk, length):
        start = walk.position.copy()
        size = step(walk, length)
        taken.append((length, start))
        return size

    monkeypatch.setattr(Walk, "_step", noted)
    used = system()
    outcome = Rosenbrock(1e-6, 1e-2, growth=growth).integrate(used, position)
    assert outcome.done
    assert used.work.rejections > 0
    products = [length * growth_rate_of(system(), start) for length, start in taken]
    # the largest eigenvalue is a tenth above the Rayleigh quotient of a direction close to it
    assert max(products) < 1.3 * growth
    assert max(products) > 0.5 * growth


def test_conjugate_gradients_tell_how_fast_a_disturbance_grows():
    position, system = chain(8, 1e-3, 1000.0)
    used = system()
    rate = growth_rate_of(used, position)
    resolvent = Resolvent(Rosenbrock(), used)
    resolvent.linearise(0.0, position)
    resolvent.setup(0.3 / rate)
    with pytest.raises(rosenbrock_solver.Refused, match="disturbances grow at a rate of") as seen:
        resolvent.setup(1.0 / rate)
    assert 0.1 <= seen.value.factor <= 0.5
    told = float(str(seen.value).split()[-2])
    assert 0.5 * rate < told <= 1.001 * rate


def test_the_linear_systems_are_solved():
    position, radius, young = cluster(40, 5, spacing=0.8)
    system = mechanics(radius, young, Hertz())
    resolvent = Resolvent(Rosenbrock(), system)
    resolvent.linearise(0.0, position)
    resolvent.setup(3.0)
    right = np.random.default_rng(0).normal(size=position.shape)
    matrix = np.eye(120) - 3.0 * (1 - math.sqrt(0.5)) * sparse_jacobian(system).toarray()
    found = resolvent.solve(right, None, 1e-10)
    np.testing.assert_allclose(matrix @ found.ravel(), right.ravel(), rtol=0, atol=1e-10)
    guessed = resolvent.solve(right, found, 1e-10)
    np.testing.assert_array_equal(guessed, found)


def test_the_worst_cell_decides():
    error = np.zeros((3, 3))
    error[1] = 3e-3, 0.0, 4e-3
    position = np.array([[0.0, 0, 0], [0, -10.0, 0], [1e6, 0, 0]])
    assert worst_cell(error, position, 0.0 * position, 1e-4, 1e-3) == pytest.approx(2.5)
    error[2, 2] = np.nan
    assert worst_cell(error, position, position, 1e-4, 1e-3) == np.inf


def test_what_it_refuses():
    position, radius, young = cluster(10, 5, spacing=0.85)
    with pytest.raises(SceneError, match="friction between cells"):
        Rosenbrock().integrate(mechanics(radius, young, friction=(1.0, 1.0)), position)
    for wrong in (0.0, -1.0, 3.5, math.nan):
        with pytest.raises(ValueError, match="growth is"):
            Rosenbrock(growth=wrong)


SCENES = {
    "plane": ("settle", {"dimensions": 2, "initial.count": 60, "duration": "2 min"}),
    "one cell": ("settle", {"initial.count": 1, "duration": "2 min"}),
    "exact JKR": ("settle", {"contact.law": "exact-jkr", "initial.count": 40, "duration": "2 min"}),
    # a little jitter: on the lattice any two methods part at a saddle
    "division": ("growth", {"initial.count": 30, "initial.jitter": 0.05, "duration": "1 h"}),
}


@pytest.mark.parametrize("name", SCENES)
def test_scenes_end_as_with_the_default(name):
    scene, changes = SCENES[name]
    ends = []
    for method in ("rosenbrock", "rkc2"):
        changed = {**changes, "integrator": {"method": method, "atol": "0.001 um"}}
        result = mc.run(mc.load_scene(scene).with_changes(changed))
        ends.append(result.frames[-1].cells.position)
    assert np.abs(ends[0] - ends[1]).max() < 0.1
    if name == "plane":
        assert (ends[0][:, 2] == 0.0).all()
