"""Explicit methods against SciPy, the spectrum of the Jacobian, and each other's code paths."""

import re
from functools import partial

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from oracles import four_cells
from strategies import cluster, mechanics

from multicell import JKR, Hertz
from multicell.contact.exact_jkr import ExactJKR
from multicell.integrators import driver as explicit
from multicell.integrators import stepping as loops
from multicell.integrators.adams_bashforth import AdamsBashforth2, AdaptiveAdams
from multicell.integrators.auto import Auto
from multicell.integrators.cvode import Cvode, CvodeAdams
from multicell.integrators.loops.chebyshev import coefficients, stable_length
from multicell.integrators.loops.runge_kutta import fixed_runge_kutta
from multicell.integrators.rkc import Rkc2
from multicell.integrators.rosenbrock import Rosenbrock
from multicell.integrators.runge_kutta import AdaptiveEuler, Dopri5, Euler, Heun, RungeKutta4
from multicell.integrators.scipy import Scipy
from multicell.mechanics.motion import Motion
from multicell.mechanics.system import Mechanics

pytestmark = pytest.mark.kernels

ALL = [
    Euler(2.0), AdamsBashforth2(2.0), Rkc2(step=4.0), AdaptiveEuler(1e-4, 1e-3), Dopri5(1e-8, 1e-8),
    Rkc2(1e-5, 1e-4), AdaptiveAdams(1e-6, 1e-5),
]  # fmt: skip
"""One of each loop, and two tableaus under error control."""
ADAPTIVE = [AdaptiveEuler, AdaptiveAdams, Dopri5, Rkc2]


def name_of(method):
    return getattr(method, "__name__", type(method).__name__)


@pytest.fixture(scope="module")
def settled():
    """A cluster at rest with its stiffest mode and the decay rate of that."""
    position, radius, young = cluster(40, 3, spacing=0.8)
    for _ in range(20):
        system = mechanics(radius, young, duration=1e4)
        position = Dopri5(1e-10, 1e-10).integrate(system, position).position
    velocity = np.empty_like(position)
    system.velocity(1e4, position, velocity)
    assert np.abs(velocity).max() < 1e-11
    system.linearise(1e4, position)
    jacobian = np.empty((position.size, position.size))
    for k, unit in enumerate(np.eye(position.size)):
        system.jacobian_product(unit.reshape(-1, 3), velocity)
        jacobian[:, k] = velocity.ravel()
    values, vectors = np.linalg.eig(jacobian)
    worst = values.real.argmin()
    mode = vectors[:, worst].real.reshape(-1, 3)
    return position, radius, young, -values[worst].real, mode / np.abs(mode).max()


def test_rkc2_chooses_enough_stages_for_any_step(settled):
    position, radius, young, rate, mode = settled
    for step in np.array([1.0, 30.0, 1000.0]) * 2.0 / rate:
        system = mechanics(radius, young, duration=20 * step)
        outcome = Rkc2(step=step).integrate(system, position + 1e-3 * mode)
        assert outcome.done
        assert np.abs(outcome.position - position).max() < 1e-3
        # s² > step rate / 0.65, one product in ten steps and ten at the start come on top
        fewest = 20 * np.sqrt(step * rate / 0.66)
        assert fewest <= system.work.evaluations < 1.3 * fewest + 60


def test_chebyshev_coefficients_satisfy_the_conditions_of_order_two():
    """Applied to y' = a y the step is a polynomial with 1, 1, 1/2 as first coefficients."""
    for stages in (2, 3, 7, 30):
        table = coefficients(stages)
        law = 2.0 / 3.0 * (stages**2 - 1) * (1.0 - 2.0 / 15.0 * 2.0 / 13.0)
        assert stable_length(stages) == pytest.approx(law, rel=0.01)
        z = Polynomial([0.0, 1.0])
        far, near = Polynomial([1.0]), 1.0 + table[1, 2] * z
        for mu, nu, mt, gt, _ in table[2:]:
            far, near = near, 1.0 - mu - nu + mu * near + nu * far + mt * z * near + gt * z
        np.testing.assert_allclose(near.coef[:3], [1.0, 1.0, 0.5], rtol=1e-10)
        # the damping: inside the interval the polynomial stays below one
        inside = np.linspace(-0.999 * stable_length(stages), -0.5, 500)
        if stages < 10:
            assert (np.abs(near(inside)) < 1.0).all()
        assert table[stages, 4] == pytest.approx(1.0)


@pytest.mark.parametrize("method", ALL, ids=name_of)
def test_compiled_and_python_paths_agree(method, monkeypatch):
    position, radius, young = cluster(60, 6, spacing=0.75)
    rate = np.full(60, 1e-3)
    compiled = mechanics(radius, young, rate=rate)
    there = method.integrate(compiled, position)
    monkeypatch.setattr(explicit, "needs_python", lambda system: True)
    python = mechanics(radius, young, rate=rate)
    here = method.integrate(python, position)
    assert here.done
    assert there.done
    np.testing.assert_allclose(there.position, here.position, rtol=0, atol=1e-11)
    assert compiled.work == python.work
    assert compiled.work.list_builds > 1


@pytest.mark.slow
def test_a_loop_is_compiled_once_for_all_laws_bonds_and_forces(monkeypatch):
    position, radius, young = cluster(30, 6, spacing=0.75)
    rng, rate, half = np.random.default_rng(3), np.full(30, 1e-3), np.full(30, 0.5)
    bonds, push = rng.uniform(0.0, 1.0, (30, 4)), rng.normal(0.0, 0.1, (30, 6))
    all_ends = []
    for law, *parts in ((JKR(surface_energy=0.1), None, push), (Hertz(), bonds, push)):
        ends = []
        for in_python in (False, True):
            monkeypatch.setattr(explicit, "needs_python", lambda system, answer=in_python: answer)
            system = Mechanics(law, 5.0, bond_strength=0.01)
            system.begin(Motion(radius, rate, young, half, 0.0, 20.0, *parts))
            outcome = Euler(0.5).integrate(system, position)
            assert outcome.done, outcome
            ends.append(outcome.position)
        np.testing.assert_allclose(*ends, rtol=0, atol=1e-11)
        all_ends.append(ends[0])
    assert np.abs(all_ends[1] - all_ends[0]).max() > 0.01
    assert len(fixed_runge_kutta.signatures) == len(loops._EVALUATION.signatures) == 1


def systems_that_need_python():
    position, radius, young = cluster(40, 8, spacing=0.85)
    n = len(radius)
    kind = np.arange(n) % 2
    energies = np.array([[0.1, 0.02], [0.02, 0.2]])
    still, half = np.zeros(n), np.full(n, 0.5)
    for law, options, extra in (
        (ExactJKR(surface_energy=0.1), {}, {}),
        (JKR(surface_energy=0.1), {"pair_table": energies}, {"kind": kind}),
        (Hertz(), {"friction": (2.0, 1.0)}, {}),
    ):
        system = Mechanics(law, 5.0, **options)
        system.begin(Motion(radius, still, young, half, 30.0, 50.0, **extra))
        yield system, position


@pytest.mark.parametrize("which", range(3), ids=["exact JKR", "types", "friction"])
def test_systems_that_need_python(which):
    ends = []
    methods = (RungeKutta4(0.5), Dopri5(1e-9, 1e-9), Rkc2(1e-6, 1e-6), AdaptiveAdams(1e-6, 1e-6))
    for method in methods:
        system, position = list(systems_that_need_python())[which]
        assert explicit.needs_python(system)
        outcome = method.integrate(system, position)
        assert outcome.done
        assert outcome.time == 50.0
        assert system.work.evaluations > system.work.steps > 0
        ends.append(outcome.position)
    assert np.abs(ends[0] - position).max() > 0.01
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-5)
    np.testing.assert_allclose(ends[2], ends[0], atol=1e-4)
    np.testing.assert_allclose(ends[3], ends[0], atol=1e-4)


@pytest.mark.parametrize("make", [Euler, AdamsBashforth2, RungeKutta4], ids=name_of)
def test_a_fixed_step_that_moves_a_cell_too_far_ends_with_words(make):
    position, radius, young = cluster(50, 8, spacing=0.6)
    system = mechanics(radius, young, duration=4000.0)
    outcome = make(2000.0).integrate(system, position)
    assert not outcome.done
    assert "step of 2e+03 s" in outcome.problem
    assert "shorter integrator.step" in outcome.hint
    assert outcome.cell in range(50)
    assert outcome.time < 4000.0
    assert np.isfinite(outcome.position).all()


@pytest.mark.parametrize(
    "make",
    [*ADAPTIVE, partial(Cvode, each_cell=False), partial(Scipy, name="RK45")],
    ids=[*map(name_of, ADAPTIVE), "Cvode", "Scipy"],
)
def test_methods_under_error_control_try_a_shorter_step(make):
    """A tolerance of a cell's size lets anything pass but the limit on displacements."""
    position, radius, young = cluster(200, 9, spacing=0.55)
    system = mechanics(radius, young, duration=600.0, viscosity=0.5)
    outcome = make(rtol=0.1, atol=9.0, max_displacement=0.1).integrate(system, position)
    assert outcome.done
    assert system.work.rejections > 0
    # the swelling alone asks for more steps than the distance allows one to take
    moved = np.linalg.norm(outcome.position - position, axis=1).max()
    assert system.work.steps >= moved / (0.1 * radius.max())
    spread = np.linalg.norm(outcome.position - outcome.position.mean(axis=0), axis=1).max()
    assert spread < 150.0


@pytest.mark.parametrize("method", [*ALL, Cvode(), CvodeAdams(), Auto()], ids=name_of)
def test_coincident_and_far_cells(method):
    position, radius, young = cluster(30, 1)
    position[1] = position[0]
    position[2] = [1e7, 1e7, -1e7]
    system = mechanics(radius, young, duration=20.0)
    outcome = method.integrate(system, position)
    assert outcome.done
    assert np.isfinite(outcome.position).all()
    np.testing.assert_allclose(outcome.position[2], position[2], rtol=1e-15)


@pytest.mark.parametrize("method", [Euler(1.0), Dopri5(), Rkc2()], ids=name_of)
@pytest.mark.parametrize("python", [False, True])
def test_too_many_cells_in_one_place_are_refused(method, python, monkeypatch):
    monkeypatch.setattr(explicit, "needs_python", lambda system: python)
    n = 9000
    outcome = method.integrate(mechanics(np.full(n, 5.0), np.ones(n)), np.zeros((n, 3)))
    assert not outcome.done
    assert "on top of each other" in outcome.problem


@pytest.mark.parametrize(
    "make",
    [*ADAPTIVE, Cvode, Rosenbrock, partial(Scipy, name="RK45")],
    ids=[*map(name_of, ADAPTIVE), "Cvode", "Rosenbrock", "Scipy"],
)
def test_out_of_steps_says_so(make):
    position, radius, young = cluster(50, 8, spacing=0.6)
    system = mechanics(radius, young, duration=600.0)
    outcome = make(rtol=1e-6, atol=1e-6, max_steps=3).integrate(system, position)
    assert "internal steps did not reach the end" in outcome.problem
    assert "max_steps" in outcome.hint
    assert (outcome.position != position).any()
    assert system.work.steps == 3
    assert 0.0 < outcome.time < 600.0


@pytest.mark.parametrize("method", ALL, ids=name_of)
def test_the_mechanics_go_on_with_the_last_list(method):
    position, radius, young = cluster(60, 6, spacing=0.75)
    system = mechanics(radius, young)
    end = method.integrate(system, position).position
    before = system.work.list_builds
    pressure = system.pressure(100.0, end)
    assert system.work.list_builds <= before + 1
    fresh = mechanics(radius, young)
    np.testing.assert_allclose(pressure, fresh.pressure(100.0, end), rtol=1e-12)


def test_evaluations_per_step():
    position, radius, young = cluster(50, 7)

    def work_of(method):
        system = mechanics(radius, young, duration=50.0)
        assert method.integrate(system, position).done
        return system.work

    for method, evaluations in (
        (Euler(1.0), 50),
        (Heun(1.0), 100),
        (AdamsBashforth2(1.0), 51),
        (RungeKutta4(1.0), 200),
        (Rkc2(step=1.0, stages=6), 300),
    ):
        work = work_of(method)
        assert (work.steps, work.evaluations, work.jacobian_products) == (50, evaluations, 0)
    work = work_of(Dopri5(1e-8, 1e-8))
    assert work.evaluations == 2 + 6 * (work.steps + work.rejections)
    work = work_of(AdaptiveAdams(1e-6, 1e-5))
    # one at the start, two in each try of the first step, one a step from then on
    assert work.steps > 10
    assert 1 + work.steps < work.evaluations <= 2 + work.steps + 2 * work.rejections


def test_adams_gives_up_where_it_would_take_longer_than_one_has_patience():
    """It says so early, with the number that it then really takes."""
    position, radius, young = cluster(60, 6, spacing=0.85)
    system = mechanics(radius, young, duration=100.0, viscosity=0.02)
    impatient = AdaptiveAdams(1e-6, 1e-2, patience=100)
    outcome = impatient.integrate(system, position)
    assert not outcome.done
    expected = int(re.search(r"would take about (\d+) evaluations", outcome.problem)[1])
    assert "stiff" in outcome.hint
    assert system.work.evaluations <= 100
    assert outcome.time < 50.0
    whole = mechanics(radius, young, duration=100.0, viscosity=0.02)
    assert AdaptiveAdams(1e-6, 1e-2).integrate(whole, position).done
    assert whole.work.evaluations > 100
    assert 0.2 < expected / whole.work.evaluations < 5.0
    mild = mechanics(radius, young, duration=1.0)
    assert impatient.integrate(mild, position).done


def test_adams_changes_its_steps_with_what_happens():
    """Where a stiff pair relaxes early, the steps grow; equal ones would be far more."""
    position, radius, young = four_cells()
    system = mechanics(radius, young, duration=2000.0)
    assert AdaptiveAdams(1e-8, 1e-6).integrate(system, position).done
    equal = system.work.steps
    early = mechanics(radius, young, duration=200.0)
    assert AdaptiveAdams(1e-8, 1e-6).integrate(early, position).done
    assert early.work.steps > 0.2 * equal


@pytest.mark.parametrize("method", [Euler(2.0), Dopri5(), AdaptiveAdams()], ids=name_of)
def test_external_forces_reach_the_loops(method):
    """One cell pulled by a growing force: x = (f t + f' t²/2) / drag, a known answer."""
    system = Mechanics(JKR(), 5.0)
    push = np.array([[3.0, 0.0, 1.0, 0.0, 0.02, 0.0]])
    one = np.ones(1)
    system.begin(Motion(5.0 * one, 0.0 * one, one, 0.5 * one, 0.0, 40.0, push=push))
    end = method.integrate(system, np.zeros((1, 3))).position[0]
    expected = np.array([120.0, 0.01 * 1600.0, 40.0]) / (6.0 * np.pi * 25.0)
    # a straight ramp is exact for methods of order two, one step behind for Euler
    tolerance = 0.06 * expected[1] if "Euler" in type(method).__name__ else 1e-9
    np.testing.assert_allclose(end, expected, atol=tolerance)


@pytest.mark.parametrize("options", [{"stages": 5}, {"stages": 1, "step": 1.0}, {"stages": -2}])
def test_rkc2_refuses_stages_that_there_are_not(options):
    with pytest.raises(ValueError, match="must be 2 or more"):
        Rkc2(**options)


def test_control_of_steps_survives_what_is_no_number():
    for error in (np.nan, np.inf):
        assert loops.step_after_error(1.0, error, 3.0, 0.2) == pytest.approx(0.2)
    assert loops.step_after_move(1.0, 0.0, 0.5) < 1.0
    assert loops.step_after_move(1.0, np.inf, 0.5) < 1.0
    assert loops.step_after_error(1.0, 1.0, 3.0, 0.2) < 1.0


@pytest.mark.parametrize("make", ADAPTIVE)
def test_a_tolerance_that_cannot_be_met_ends_with_words(make):
    position, radius, young = cluster(20, 1)
    outcome = make(0.0, 1e-20).integrate(mechanics(radius, young), position)
    assert not outcome.done
    assert ("did not reach the end" if make is Dopri5 else "too short") in outcome.problem
    assert outcome.time < 100.0
    for rtol, atol in ((0.0, 0.0), (-1.0, 1.0), (np.nan, 1.0)):
        with pytest.raises(ValueError, match="above 0"):
            make(rtol, atol)


@pytest.mark.parametrize("method", [Cvode(), Cvode(rtol=1e-8, atol=1e-5), Euler(5.0)])
@pytest.mark.parametrize("law", [Hertz(), JKR(surface_energy=0.1)])
def test_energy_never_rises_without_growth(method, law):
    position, radius, young = cluster(80, 4, spacing=0.75)
    energies = []
    for _ in range(25):
        system = mechanics(radius, young, law, duration=30.0)
        outcome = method.integrate(system, position)
        assert outcome.done
        position = outcome.position
        energies.append(system.energy(30.0, position))
    # a step may wobble by its tolerance; the law itself only ever goes down
    slack = 1e-12 if isinstance(method, Euler) else method.atol * 1e-2
    assert (np.diff(energies) <= slack * max(map(abs, energies))).all()
    assert energies[-1] < energies[0]
