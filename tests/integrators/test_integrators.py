"""Integrators against SciPy, the energy law, and states that they must not return."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from strategies import cluster, mechanics

from multicell import JKR, Hertz
from multicell.integrators.base import furthest
from multicell.integrators.cvode import Cvode
from multicell.integrators.runge_kutta import Euler

TIGHT = Cvode(rtol=1e-10, atol=1e-12)


def two_cells():
    return np.array([[0.0, 0, 0], [6, 1, 2]]), np.array([5.0, 4.5]), np.array([1.0, 1.1])


def tight_solution(law, position, radius, young, duration):
    """Solve with SciPy's DOP853; the right-hand side is written out here from eq. 3.6."""

    def rhs(_, y):
        x = y.reshape(2, 3)
        d = x[1] - x[0]
        distance = np.linalg.norm(d)
        h = radius.sum() - distance
        r = radius.prod() / radius.sum()
        e = 1.0 / (0.75 * 0.75 * (1 / young).sum())
        sigma = getattr(law, "surface_energy", 0.0)
        force = e * r**0.5 * h**1.5 - np.sqrt(6 * np.pi * sigma * e * r**1.5 * h**1.5)
        pull = force * d / distance
        return (np.array([-pull, pull]) / (6 * np.pi * 5.0 * radius[:, None])).ravel()

    solution = solve_ivp(
        rhs, (0, duration), position.ravel(), method="DOP853", rtol=1e-12, atol=1e-13
    )
    return solution.y[:, -1].reshape(2, 3)


@pytest.mark.parametrize("law", [Hertz(), JKR(surface_energy=0.1)])
def test_two_cells_released_at_overlap_follow_dop853(law):
    position, radius, young = two_cells()
    # Hertz cells are still in contact then: at first contact they would rest only at infinity
    outcome = TIGHT.integrate(mechanics(radius, young, law, duration=200.0), position)
    assert outcome.done
    assert outcome.time == 200.0
    expected = tight_solution(law, position, radius, young, 200.0)
    np.testing.assert_allclose(outcome.position, expected, atol=1e-8 * np.abs(expected).max())


def test_euler_converges_with_first_order():
    position, radius, young = two_cells()
    law = JKR(surface_energy=0.1)
    exact = tight_solution(law, position, radius, young, 200.0)
    steps = np.array([4.0, 2.0, 1.0, 0.5])
    errors = [
        np.abs(
            Euler(step).integrate(mechanics(radius, young, law, duration=200.0), position).position
            - exact
        ).max()
        for step in steps
    ]
    order = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert order == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("method", [Cvode(), Cvode(rtol=1e-8, atol=1e-5), Euler(5.0)])
@pytest.mark.parametrize("law", [Hertz(), JKR(surface_energy=0.1)])
def test_energy_never_rises_without_growth(method, law):
    position, radius, young = cluster(150, 4, spacing=0.75)
    energies = []
    for _ in range(25):
        system = mechanics(radius, young, law, duration=30.0)
        outcome = method.integrate(system, position)
        assert outcome.done
        position = outcome.position
        energies.append(system.energy(30.0, position))
    scale = max(map(abs, energies))
    # a step may wobble by its tolerance; the law itself only ever goes down
    slack = 1e-12 if isinstance(method, Euler) else method.atol * 1e-2
    assert (np.diff(energies) <= slack * scale).all()
    assert energies[-1] < energies[0]


def test_methods_agree_on_growing_cells():
    position, radius, young = cluster(120, 5, spacing=0.9)
    rate = np.full(120, 2e-4)
    ends = []
    for method in (TIGHT, Euler(0.05)):
        system = mechanics(radius, young, Hertz(), rate=rate, duration=60.0)
        ends.append(method.integrate(system, position).position)
    np.testing.assert_allclose(ends[0], ends[1], atol=2e-3)


def test_tolerance_is_met():
    position, radius, young = cluster(80, 6, spacing=0.8)
    exact = TIGHT.integrate(mechanics(radius, young, Hertz()), position).position
    for atol in (1e-2, 1e-4, 1e-6):
        method = Cvode(rtol=1e-12, atol=atol)
        found = method.integrate(mechanics(radius, young, Hertz()), position).position
        assert np.abs(found - exact).max() < 30 * atol


def test_work_is_counted():
    position, radius, young = cluster(50, 7)
    system = mechanics(radius, young, duration=50.0)
    Euler(1.0).integrate(system, position)
    assert (system.work.steps, system.work.evaluations, system.work.jacobian_products) == (
        50,
        50,
        0,
    )
    system = mechanics(radius, young, duration=50.0, viscosity=0.05)
    Cvode().integrate(system, position)
    work = system.work
    assert work.evaluations >= work.steps > 1
    assert work.jacobian_products > 0
    assert work.preconditioner_solves > 0
    assert work.rejections == 0


def test_euler_beyond_its_limit_fails_with_words_and_the_cell():
    position, radius, young = cluster(50, 8, spacing=0.6)
    outcome = Euler(2000.0).integrate(mechanics(radius, young, duration=4000.0), position)
    assert not outcome.done
    assert "step of 2e+03 s" in outcome.problem
    assert "shorter integrator.step" in outcome.hint
    assert outcome.cell in range(50)
    assert outcome.time < 4000.0


def test_cvode_out_of_steps_says_so():
    position, radius, young = cluster(50, 8, spacing=0.6)
    outcome = Cvode(max_steps=3).integrate(mechanics(radius, young, duration=600.0), position)
    assert not outcome.done
    assert "3 internal steps" in outcome.problem
    assert "max_steps" in outcome.hint
    assert 0.0 < outcome.time < 600.0


def test_cvode_refuses_to_throw_cells_away():
    """With a tolerance of a cell's size BDF's predictor alone would accept almost anything."""
    position, radius, young = cluster(200, 9, spacing=0.55)
    method = Cvode(rtol=0.1, atol=5.0, max_displacement=0.3)
    system = mechanics(radius, young, duration=600.0)
    outcome = method.integrate(system, position)
    assert outcome.done
    assert system.work.rejections > 0
    spread = np.linalg.norm(outcome.position - outcome.position.mean(axis=0), axis=1).max()
    assert spread < 150.0
    assert np.isfinite(outcome.position).all()


@pytest.mark.parametrize("method", [Cvode(), Euler(1.0)])
def test_coincident_and_far_cells(method):
    position, radius, young = cluster(30, 1)
    position[1] = position[0]
    position[2] = [1e7, 1e7, -1e7]
    outcome = method.integrate(mechanics(radius, young, duration=20.0), position)
    assert outcome.done
    assert np.isfinite(outcome.position).all()


def test_furthest_counts_what_is_no_number_as_infinite():
    before = np.zeros((3, 3))
    after = np.array([[1.0, 0, 0], [np.nan, 0, 0], [2.0, 0, 0]])
    assert furthest(before, after, np.ones(3)) == (1, np.inf)
    assert furthest(before, after[[0, 2, 2]], np.full(3, 2.0)) == (1, 1.0)
