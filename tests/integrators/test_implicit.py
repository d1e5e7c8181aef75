"""Implicit methods: against SciPy, the sparse Jacobian, what they refuse, what they say."""

import numpy as np
import pytest
from oracles import reference
from scipy.sparse.linalg import LinearOperator, gmres
from strategies import cluster, mechanics

from multicell import JKR, Hertz
from multicell.errors import SceneError
from multicell.integrators import auto, costs, cvode_solver
from multicell.integrators.auto import Auto, measured_rate
from multicell.integrators.backward_euler import BackwardEuler
from multicell.integrators.cvode import Cvode
from multicell.integrators.limits import stiffness_scale
from multicell.integrators.restarts import IntegrationProgress, StepImpossible, Taken
from multicell.integrators.rkc import Rkc2
from multicell.integrators.rosenbrock import Rosenbrock
from multicell.integrators.scipy import Scipy
from multicell.mechanics.decay_rate import spectrum_ends
from multicell.mechanics.jacobian import limited, sparse_jacobian
from multicell.mechanics.neighbours import spatial_order
from multicell.mechanics.preconditioners import Sweeps
from multicell.mechanics.system import Linearisation


def test_no_step_limit_from_stability():
    """A settled cluster in a thin medium: steps far beyond Euler's limit, and it stays."""
    position, radius, young = cluster(100, 3, spacing=0.85)
    settled = Cvode(atol=1e-6).integrate(
        mechanics(radius, young, duration=20_000.0), position
    ).position  # fmt: skip
    for method in (Cvode(), BackwardEuler(100.0), BackwardEuler(1000.0)):
        system = mechanics(radius, young, duration=1000.0, viscosity=0.01)
        limit_of_euler = 2.0 / measured_rate(system, settled)
        outcome = method.integrate(system, settled)
        assert outcome.done
        assert system.work.steps < 0.02 * 1000.0 / limit_of_euler
        assert np.abs(outcome.position - settled).max() < 0.05


@pytest.mark.parametrize("chunk", [2048, 40])
@pytest.mark.parametrize("law", [Hertz(), JKR(surface_energy=0.1)])
def test_sparse_jacobian_is_that_of_products(law, chunk):
    """Products are compared with differences in tests/mechanics."""
    position, radius, young = cluster(60, 5, spacing=0.8)
    system = mechanics(radius, young, law, chunk=chunk)
    system.linearise(0.0, position)
    matrix = sparse_jacobian(system)
    assert matrix.has_sorted_indices
    vector = np.random.default_rng(0).normal(size=position.shape)
    product = np.empty_like(vector)
    system.jacobian_product(vector, product)
    np.testing.assert_allclose(matrix @ vector.ravel(), product.ravel(), rtol=0, atol=1e-14)


def stable_system(system, gamma):
    """Return I - γJ with the stable part of each pair, dense, from the stored stiffness."""
    linear = system.linearisation
    along, across = linear.along.copy(), linear.across.copy()
    with np.errstate(all="ignore"):  # the spare room of a list holds anything
        linear.across[:] = np.minimum(across, 0.0)
        linear.along[:] = np.maximum(along - across, 0.0) + linear.across
    matrix = np.eye(3 * len(system)) - gamma * sparse_jacobian(system).toarray()
    linear.along[:], linear.across[:] = along, across
    return matrix


def test_gauss_seidel_sweeps_are_those_of_linear_algebra():
    position, radius, young = cluster(50, 6, spacing=0.8)
    system = mechanics(radius, young)
    system.linearise(0.0, position)
    gamma = 200.0
    weight = np.repeat(system.drag * system.rows[:, 3], 3)
    matrix = weight[:, None] * stable_system(system, gamma)
    cell = np.arange(150) // 3
    upper = np.where(cell[:, None] < cell, matrix, 0.0)
    diagonal = np.where(cell[:, None] == cell, matrix, 0.0)
    vector = np.random.default_rng(1).normal(size=(50, 3))
    whole = (diagonal + upper.T) @ np.linalg.solve(diagonal, diagonal + upper)
    expected = np.linalg.solve(whole, weight * vector.ravel())
    sweeps, out = Sweeps(system), np.empty((50, 3))
    sweeps.setup_preconditioner(gamma, system.linearisation)
    sweeps.precondition(vector, out)
    np.testing.assert_allclose(out.ravel(), expected, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("sweeps", [True, False])
def test_preconditioners_approximate_and_give_the_same_bits(sweeps):
    position, radius, young = cluster(120, 6, spacing=0.8)
    position = position[spatial_order(position, 10.0)]
    young[::7] *= 30.0
    results = []
    for count in (1, 2):
        system = mechanics(radius, young, threads=count, chunk=60, shared_chunks=2)
        system.linearise(0.0, position)
        matrix = stable_system(system, 3000.0)
        system.linearise(0.0, position)
        vector = np.random.default_rng(1).normal(size=(120, 3))
        inverse, out = Sweeps(system) if sweeps else system, np.empty((120, 3))
        inverse.setup_preconditioner(3000.0, system.linearisation)
        inverse.precondition(vector, out)
        results.append(out)
        # the preconditioned matrix is much closer to the identity than the matrix
        columns = np.empty((360, 360))
        for k in range(360):
            inverse.precondition(np.ascontiguousarray(matrix[:, k].reshape(-1, 3)), out)
            columns[:, k] = out.ravel()
        before, after = (np.linalg.cond(m) for m in (matrix, columns))
        assert after < 0.7 * before
    np.testing.assert_array_equal(results[0], results[1])


def test_bounded_softening_changes_nothing_else():
    """It is a linearisation of its own: what the system has by itself stays the derivative."""
    position = np.array([[0.0, 0, 0], [9.999999, 0, 0], [0.0, 8.0, 0]])
    system = mechanics(np.full(3, 5.0), np.ones(3))
    system.linearise(0.0, position)
    before = sparse_jacobian(system).toarray()
    linear, _ = limited(system, 0.5)
    after = sparse_jacobian(system, linear).toarray()
    # E_ij r_ij = 2/3 · 1 / ¾ ... of two alike cells: E = 1 / (2 · 9/16), r = 2.5
    least = 0.5 * 2.5 / (2 * 0.75 * 0.75)
    assert before[0, 3] * system.drag * 5.0 < -2 * least
    assert after[0, 3] * system.drag * 5.0 == pytest.approx(-least, rel=1e-3)
    np.testing.assert_array_equal(before[:3, 6:], after[:3, 6:])
    vector, product = np.random.default_rng(0).normal(size=(3, 3)), np.empty((3, 3))
    for used, matrix in ((None, before), (linear, after)):
        system.jacobian_product(vector, product, used)
        np.testing.assert_allclose(product.ravel(), matrix @ vector.ravel(), rtol=1e-12)
    np.testing.assert_array_equal(sparse_jacobian(system).toarray(), before)


@pytest.mark.parametrize("friction", [(2.0, 1.0), (20.0, 20.0), (20.0, 0.0)])
def test_blocks_know_the_friction_between_cells(friction):
    """Solved by SciPy's GMRES, I - γJ takes fewer products than with Stokes drag alone."""
    position, radius, young = cluster(120, 6, spacing=0.8)
    system = mechanics(radius, young, viscosity=0.05, friction=friction)
    system.linearise(0.0, position)
    vector = np.random.default_rng(2).normal(size=360)
    counts = []
    for known in (True, False):
        used = system if known else mechanics(radius, young, viscosity=0.05)
        used.linearise(0.0, position)
        used.setup_preconditioner(20.0, used.linearisation)

        def approximate(x, used=used):
            out = np.empty((120, 3))
            used.precondition(np.ascontiguousarray(x).reshape(-1, 3), out)
            return out.ravel()

        def whole(x):
            out = np.empty((120, 3))
            system.jacobian_product(np.ascontiguousarray(x).reshape(-1, 3), out)
            return x - 20.0 * out.ravel()

        before = system.work.jacobian_products
        operator, inverse = (LinearOperator((360, 360), matvec=f) for f in (whole, approximate))
        _, trouble = gmres(operator, vector, M=inverse, rtol=1e-2, restart=60, maxiter=5)
        assert trouble == 0
        counts.append(system.work.jacobian_products - before)
    assert counts[0] < 0.8 * counts[1]


@pytest.fixture(scope="module")
def pressed():
    """A cluster, and where its cells are in truth at the end."""
    position, radius, young = cluster(80, 6, spacing=0.8)
    exact = reference(mechanics(radius, young, Hertz()), position, 1e-10)
    return position, radius, young, exact


@pytest.mark.parametrize("softening", [0.5, np.inf])
def test_bounded_softening_changes_the_way_and_not_the_end(softening, pressed, monkeypatch):
    position, radius, young, exact = pressed
    monkeypatch.setattr(cvode_solver, "SOFTENING", softening)
    outcome = Cvode(1e-12, 1e-6, light=False).integrate(mechanics(radius, young, Hertz()), position)
    assert outcome.done
    assert np.abs(outcome.position - exact).max() < 3e-5


@pytest.mark.parametrize(
    ("method", "n"), [(Scipy(name="LSODA"), 1001), (Scipy(name="Radau"), 3001)]
)
def test_a_method_that_cannot_hold_a_scene_says_why(method, n):
    position = 20.0 * np.arange(3 * n, dtype=float).reshape(n, 3)
    system = mechanics(np.full(n, 5.0), np.ones(n))
    with pytest.raises(SceneError, match=rf"holds at most {n - 1} cells, not {n}.*'cvode'"):
        method.integrate(system, position)


@pytest.mark.parametrize("method", [Rosenbrock(), Scipy(name="BDF")])
def test_friction_makes_the_jacobian_full(method):
    position, radius, young = cluster(5, 1)
    system = mechanics(radius, young, friction=(0.1, 0.1))
    with pytest.raises(SceneError, match="friction between cells"):
        method.integrate(system, position)


def test_scipy_refuses_a_tolerance_that_doubles_cannot_carry():
    with pytest.raises(SceneError, match="double precision"):
        Scipy(name="RK45", rtol=1e-14)


def test_backward_euler_ends_with_words():
    position, radius, young = cluster(60, 8, spacing=0.6)
    system = mechanics(radius, young, duration=4000.0)
    outcome = BackwardEuler(2000.0).integrate(system, position)
    # whether Newton or its line search gives up first hangs on the last bits of the processor
    assert "step of 2e+03 s" in outcome.problem
    assert outcome.time == 0.0
    assert outcome.cell in range(60)
    # no step lowers a residual that is rounding, and none is small enough for no tolerance
    outcome = BackwardEuler(10.0, tolerance=0.0, newton=1000).integrate(system, position)
    assert "step of 10 s has no solution that a line search finds" in outcome.problem
    outcome = BackwardEuler(10.0, max_displacement=0.01).integrate(system, position)
    assert "step of 10 s would move the cell" in outcome.problem
    assert "shorter integrator.step" in outcome.hint
    assert outcome.cell in range(60)
    system = mechanics(radius, young, duration=100.0)
    stopped = BackwardEuler(100.0, newton=1, tolerance=1e-12).integrate(system, position)
    assert "did not converge in 1 iterations in a step of 100 s" in stopped.problem
    assert stopped.time == 0.0
    np.testing.assert_array_equal(stopped.position, position)


class Breaking:
    """A solver that takes two steps of a second and then gives up, always."""

    open = 0

    def __init__(self, run, ceiling):
        self.run, self.taken = run, 0
        Breaking.open += 1

    def close(self):
        Breaking.open -= 1

    def take_step(self):
        if self.run.elapsed >= 2.0:
            raise StepImpossible("it broke")
        self.taken += 1
        return Taken(float(self.taken), self.run.position.copy())


def test_a_solver_that_keeps_breaking_ends_with_its_words():
    position, radius, young = cluster(4, 1)
    system = mechanics(radius, young)
    outcome = IntegrationProgress(Cvode(max_steps=100), system, position).integrate(Breaking)
    assert outcome.problem == "it broke"
    assert outcome.time == 2.0
    assert system.work.steps == 2
    assert system.work.rejections > 1
    assert Breaking.open == 0


def test_cvode_begins_light_where_it_is_mild():
    """The work is that of difference quotients; the end is within the tolerance the same."""
    position, radius, young = cluster(200, 1, spacing=0.8)
    ends, works = [], []
    for light in (True, False):
        system = mechanics(radius, young, JKR(surface_energy=0.1), duration=600.0)
        outcome = Cvode(1e-5, 1e-2, light=light).integrate(system, position)
        assert outcome.done
        ends.append(outcome.position)
        works.append(system.work)
    assert np.abs(ends[0] - ends[1]).max() < 0.05
    light, full = works
    assert light.linearisations == light.jacobian_products == 0 < full.linearisations
    assert light.evaluations > full.evaluations
    assert light.steps <= light.newton_iterations <= light.evaluations
    assert light.linear_iterations > 0
    # every evaluation is one of Newton's or a product, but for those that find the first step
    extra = light.evaluations - light.newton_iterations - light.linear_iterations
    assert 0 <= extra <= 5


def test_a_stiff_interval_is_that_of_the_full_method():
    """Two steps tell, and are thrown away: the same bits, for a few evaluations more."""
    position, radius, young = cluster(200, 1, spacing=0.8)
    ends, works = [], []
    for light in (True, False):
        system = mechanics(radius, young, Hertz(), duration=6000.0, viscosity=0.005)
        outcome = Cvode(1e-5, 1e-2, light=light).integrate(system, position)
        assert outcome.done
        ends.append(outcome.position.tobytes())
        works.append(system.work)
    assert ends[0] == ends[1]
    assert works[0].steps == works[1].steps
    assert 0 < works[0].evaluations - works[1].evaluations <= 16


def test_an_interval_that_becomes_stiff_goes_over_to_the_full_method(monkeypatch):
    monkeypatch.setattr("multicell.integrators.cvode_solver._SLOW_START", 0.0)
    position, radius, young = cluster(200, 1, spacing=0.8)
    system = mechanics(radius, young, JKR(surface_energy=0.1), duration=600.0, viscosity=0.05)
    outcome = Cvode(1e-6, 1e-2).integrate(system, position)
    assert outcome.done
    assert outcome.time == 600.0
    assert system.work.linearisations > 0
    alone = mechanics(radius, young, JKR(surface_energy=0.1), duration=600.0, viscosity=0.05)
    assert Cvode(1e-6, 1e-2, light=False).integrate(alone, position).done
    # what was begun light took evaluations in place of products
    assert system.work.evaluations > alone.work.evaluations


def test_auto_chooses_by_stiffness_and_tolerance():
    position, radius, young = cluster(400, 2, spacing=0.9)
    soft = mechanics(radius, young, duration=60.0)
    stiff = mechanics(radius, young, duration=6e5, viscosity=0.05)
    some = mechanics(radius, young, duration=1e5)
    chosen = [Auto(1e-6, 0.1).by_motion(system, position) for system in (soft, some, stiff)]
    assert [choice.method for choice in chosen] == ["ab2-adaptive", "rkc2", "rosenbrock"]
    assert Auto(1e-6, 1e-4).by_motion(soft, position).method == "rk4-adaptive"
    # λ of mild tissue is not measured
    assert soft.work.linearisations == 0
    found = measured_rate(soft, position)
    exact = -np.linalg.eigvals(sparse_jacobian(soft).toarray()).real.min()
    assert 0.95 * exact < found < 1.15 * exact
    assert 0.3 < chosen[0].stiffness / (60.0 * exact) < 3.0
    assert Auto(1e-6, 0.1).by_motion(soft, position) == chosen[0]
    lone = mechanics(np.array([5.0]), np.array([1.0]))
    assert measured_rate(lone, np.zeros((1, 3))) == 0.0


def test_auto_counts_the_steps_of_each_method():
    position, radius, young = cluster(60, 2, spacing=0.9)
    system = mechanics(radius, young, duration=60.0)
    Auto(atol=0.1).integrate(system, position)
    assert system.work.steps_ab2_adaptive == system.work.steps > 0
    assert system.work.jacobian_products == 0
    Auto(atol=0.0001).integrate(system, position)
    assert system.work.steps_rk4_adaptive > 0


def test_auto_does_not_take_the_growth_of_forming_contacts_for_stiffness():
    """The largest |eigenvalue| is one of growth there: no explicit step is limited by it."""
    radius, young = np.full(40, 5.0), np.ones(40)
    position = np.zeros((40, 3))
    position[:, 0] = 9.998 * np.arange(40)  # each just inside first contact with the next
    system = mechanics(radius, young, JKR(surface_energy=0.1), duration=2500.0)
    decay, residual, growth = spectrum_ends(system, 0.0, position)
    spectrum = np.linalg.eigvals(sparse_jacobian(system).toarray()).real
    assert growth > 20.0 * decay
    assert 0.9 * spectrum.max() < growth <= spectrum.max() * (1 + 1e-12)
    assert decay <= -spectrum.min() * (1 + 1e-12) + 1e-12
    # what contacts relax at once they have formed counts
    rate = measured_rate(system, position)
    assert rate == max(decay + residual, stiffness_scale(system))
    assert 2500.0 * growth > 5.0 * 2500.0 * rate
    settled = 9.0 * position / 9.998
    decay, residual, growth = spectrum_ends(system, 0.0, settled)
    assert growth < decay
    assert measured_rate(system, settled) == decay + residual


def test_auto_takes_an_implicit_method_where_rkc2_would_take_long():
    position, radius, young = cluster(300, 2, spacing=0.9)
    system = mechanics(radius, young, duration=6e5, viscosity=0.05)
    choice = Auto().choose(system, position)
    outcome = Auto().integrate(system, position)
    assert outcome.done
    assert outcome.time == 6e5
    assert system.work.steps == system.work.steps_rosenbrock > 0
    fresh = mechanics(radius, young, duration=6e5, viscosity=0.05)
    # implicit methods are further off at the same tolerances
    assert choice.finer == pytest.approx(0.1)
    finer = choice.finer * Auto().rtol, choice.finer * Auto().atol
    alone = Rosenbrock(*finer).integrate(fresh, position)
    assert outcome.position.tobytes() == alone.position.tobytes()


def test_a_step_that_is_not_as_mild_as_it_seems_is_begun_again(monkeypatch, request):
    """By another method, from the beginning; what was tried in vain is counted."""
    auto._sure.cache_clear()
    request.addfinalizer(auto._sure.cache_clear)
    work = costs.CouplingStep.work
    mild = {"ab2-adaptive": 1.0}
    monkeypatch.setattr(
        costs.CouplingStep, "work", lambda step, name, *finer: mild.get(name) or work(step, name)
    )
    position, radius, young = cluster(300, 2, spacing=0.9)
    system = mechanics(radius, young, duration=6e4)
    outcome = Auto(atol=0.1).integrate(system, position)
    assert outcome.done
    assert 0 < system.work.steps_ab2_adaptive < system.work.steps
    fresh = mechanics(radius, young, duration=6e4)
    alone = Rkc2(atol=0.1).integrate(fresh, position)
    # neighbours are listed in another order
    np.testing.assert_allclose(outcome.position, alone.position, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("method", "viscosity"),
    [
        (Cvode(atol=1e-3, light=False), 5.0),
        (Cvode(atol=1e-3, light=False), 0.05),
        (BackwardEuler(100.0, 1e3), 0.5),
    ],
)
def test_memory_that_nothing_was_written_to_decides_nothing(monkeypatch, method, viscosity):
    """Spare room of the pairs and blocks not yet inverted, filled with what would be found out."""
    position, radius, young = cluster(80, 6, spacing=0.8)
    room = Linearisation.room
    results = []
    for filling in (np.nan, 1e30, 0.0):

        def filled(pairs, filling=filling):
            linear = room(pairs)
            for array in (linear.normal, linear.along, linear.across):
                array[:] = filling
            return linear

        monkeypatch.setattr(Linearisation, "room", filled)
        system = mechanics(radius, young, duration=600.0, viscosity=viscosity)
        system._inverse = np.full((len(system), 6), filling)
        outcome = method.integrate(system, position)
        assert outcome.done
        results.append((system.work, outcome.position))
    for work, end in results[1:]:
        assert work == results[0][0]
        np.testing.assert_array_equal(end, results[0][1])
