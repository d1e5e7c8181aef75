"""Batched solvers of networks: closed forms, SciPy, orders, threads, and failures in words."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from network_models import BRUSSELATOR, DECAY, FORCED, ROBERTSON, network, rows
from scipy.integrate import solve_ivp

from multicell.networks.loop import EVIDENCE, IMPLICITLY
from multicell.networks.methods import METHODS, method_of
from multicell.networks.solver import NetworkFailed, NetworkSolver

ADAPTIVE = [name for name, method in METHODS.items() if not method.fixed]
ORDERS = {"rodas3": 3, "rodas4": 4, "dormand-prince": 5, "rk4": 4, "euler": 1}


def _reference(model, end, u0=(), u1=(), start=0.0):
    def f(t, y):
        part = (t - start) / (end - start)
        out = np.empty(len(y))
        u = np.array(u0) + part * (np.array(u1) - np.array(u0))
        model.rates(t, y, u, np.array(model.values), out)
        return out

    found = solve_ivp(f, (start, end), model.start, method="Radau", rtol=1e-11, atol=1e-13)
    return found.y[:, -1]


@pytest.mark.parametrize("method", ADAPTIVE)
def test_brusselator_agrees_with_scipy(method):
    solver = NetworkSolver(BRUSSELATOR, method=method, relative=1e-9)
    inside = solver.advance(solver.begin(2), rows(2, 0.2), rows(2, 0.8), 0.0, 6.0)
    want = _reference(BRUSSELATOR, 6.0, (0.2,), (0.8,))
    np.testing.assert_allclose(inside.y, [want, want], rtol=2e-7)


@pytest.mark.parametrize("method", ["auto", "rodas3", "rodas4"])
def test_robertson_agrees_with_scipy_and_keeps_its_mass(method):
    solver = NetworkSolver(ROBERTSON, method=method, relative=1e-7, absolute=1e-12)
    inside = solver.advance(solver.begin(1), rows(1), rows(1), 0.0, 400.0)
    np.testing.assert_allclose(inside.y[0], _reference(ROBERTSON, 400.0), rtol=1e-5)
    assert inside.y[0].sum() == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("method", ORDERS)
def test_order_by_regression(method):
    # the pair of order 5 is near its order only over a longer way
    end = 5.0 if method == "dormand-prince" else 1.0
    want = np.exp([math.sin(end), -math.sin(end)])
    lengths = np.array([1 / 10, 1 / 14, 1 / 20, 1 / 28, 1 / 40])
    errors = []
    for length in lengths:
        solver = NetworkSolver(FORCED, method=method, length=length)
        inside = solver.advance(solver.begin(1), rows(1), rows(1), 0.0, end)
        assert solver.work[0] == round(end / length)
        errors.append(np.abs(inside.y[0] - want).max())
    slope = np.polyfit(np.log(lengths), np.log(errors), 1)[0]
    assert slope == pytest.approx(ORDERS[method], abs=0.16)


@pytest.mark.slow
@pytest.mark.parametrize("method", ADAPTIVE)
def test_error_follows_the_tolerance(method):
    want = _reference(BRUSSELATOR, 20.0, (0.0,), (0.0,))
    errors = []
    for relative in (1e-3, 1e-5, 1e-7):
        solver = NetworkSolver(BRUSSELATOR, method=method, relative=relative)
        inside = solver.advance(solver.begin(1), rows(1, 0.0), rows(1, 0.0), 0.0, 20.0)
        errors.append(np.abs(inside.y[0] / want - 1.0).max())
    assert errors[0] < 0.1
    assert errors[2] < 1e-5
    assert errors[0] > errors[1] > errors[2]


def test_many_steps_of_coupling_follow_the_closed_form_of_a_switched_source():
    solver = NetworkSolver(DECAY, relative=1e-8)
    inside, at = solver.begin(1), 1.0
    for step in range(40):
        source = 1.0 if step % 2 else 0.0
        inside = solver.advance(inside, rows(1, source), rows(1, source), 0.25 * step, 0.25)
        at = source + (at - source) * math.exp(-2.0 * 0.25)
        assert inside.y[0, 0] == pytest.approx(at, rel=1e-6)


def test_a_linear_input_is_followed_within_the_step():
    # y' = k (a + b t - y): y = a + b t - b/k + c exp(-k t)
    k, a, b, end = 2.0, 0.3, 0.7, 1.5
    solver = NetworkSolver(DECAY, relative=1e-9)
    inside = solver.advance(solver.begin(1), rows(1, a), rows(1, a + b * end), 0.0, end)
    want = a + b * end - b / k + (1.0 - a + b / k) * math.exp(-k * end)
    assert inside.y[0, 0] == pytest.approx(want, rel=1e-7)


def test_growth_dilutes_what_is_marked_alone():
    def idle(t, y, u, p, out):
        out[0] = 0.0
        out[1] = 0.0

    solver = NetworkSolver(network(idle, {"kept": 1.0, "diluted": 1.0}), relative=1e-9)
    growth, inside = np.array([0.0, 0.4]), solver.begin(2)
    inside = solver.advance(
        inside, rows(2), rows(2), 0.0, 2.0, growth=growth, diluted=np.array([0.0, 1.0])
    )
    assert inside.y[:, 0].tolist() == [1.0, 1.0]
    np.testing.assert_allclose(inside.y[:, 1], np.exp(-2.0 * growth), rtol=1e-7)


def test_each_cell_chooses_by_its_own_stiffness():
    solver = NetworkSolver(DECAY, relative=1e-4)
    inside = solver.begin(2)
    inside.p[:, 0] = [0.5, 5e4]
    for step in range(20):
        inside = solver.advance(inside, rows(2, 0.0), rows(2, 1.0), float(step), 1.0)
    assert inside.memory[:, IMPLICITLY].tolist() == [0.0, 1.0]
    inside.p[1, 0] = 0.5  # not stiff any more
    for step in range(20, 60):
        inside = solver.advance(inside, rows(2, 0.0), rows(2, 1.0), float(step), 1.0)
    assert inside.memory[:, IMPLICITLY].tolist() == [0.0, 0.0]
    assert (inside.memory[:, EVIDENCE] < 4).all()


def test_cells_are_solved_alone_and_by_threads_with_the_same_bits():
    count, rng = 3000, np.random.default_rng(1)
    found = []
    first = NetworkSolver(BRUSSELATOR).begin(count)
    first.p[:, 1] = rng.uniform(1.5, 60.0, count)
    drive = rng.uniform(0.0, 0.5, (count, 1))
    for threads in (1, 2, 16):
        solver = NetworkSolver(BRUSSELATOR, threads=threads)
        inside = first
        for step in range(3):
            inside = solver.advance(inside, drive, 2.0 * drive, float(step), 1.0)
        found.append((inside.y, inside.memory, solver.work))
    for other in found[1:]:
        for one, two in zip(found[0], other, strict=True):
            assert one.tobytes() == two.tobytes()
    rows_ = np.array([7, 2999])
    solver = NetworkSolver(BRUSSELATOR)
    alone = type(first)(first.y[rows_], first.p[rows_], first.memory[rows_])
    for step in range(3):
        alone = solver.advance(alone, drive[rows_], 2.0 * drive[rows_], float(step), 1.0)
    assert alone.y.tobytes() == found[0][0][rows_].tobytes()


def test_what_was_given_is_not_written():
    solver = NetworkSolver(BRUSSELATOR)
    inside = solver.begin(1)
    solver.advance(inside, rows(1, 0.0), rows(1, 0.0), 0.0, 1.0)
    assert inside.y.tolist() == [[1.5, 3.0]]
    assert not inside.memory.any()


def test_tight_tolerances_take_the_method_of_order_four():
    assert method_of("auto", 1e-4).rosenbrock.order == 3
    assert method_of("auto", 1e-6).rosenbrock.order == 4


def test_a_steady_state_is_found():
    solver = NetworkSolver(DECAY, relative=1e-6)
    inside = solver.settle(solver.begin(2), np.array([[3.0], [5.0]]), 0.0)
    np.testing.assert_allclose(inside.y[:, 0], [3.0, 5.0], rtol=1e-5)


def test_an_oscillator_has_no_steady_state():
    solver = NetworkSolver(BRUSSELATOR)
    with pytest.raises(NetworkFailed, match=r"does not come to rest|more than"):
        solver.settle(solver.begin(1), rows(1, 0.0), 0.0)


def test_a_state_that_leaves_the_numbers_fails_with_row_and_time():
    def burst(t, y, u, p, out):
        out[0] = y[0] * y[0]  # infinite at t = 1 / start

    solver = NetworkSolver(network(burst, {"A": 0.1}))
    inside = solver.begin(3)
    inside.y[1] = 2.0
    with pytest.raises(NetworkFailed) as failed:
        solver.advance(inside, rows(3), rows(3), 0.0, 1.0)
    assert failed.value.row == 1
    assert failed.value.time == pytest.approx(0.5, rel=1e-3)


def test_a_fixed_method_needs_a_length():
    with pytest.raises(ValueError, match="length"):
        NetworkSolver(DECAY, method="rk4")


def test_observed_values_follow_states_and_inputs():
    def observe(t, y, u, p, out):
        out[0] = p[0] * y[0] + u[0] + t

    model = replace(DECAY, observed=("flux",), observe=observe)
    solver = NetworkSolver(model)
    assert solver.observe(solver.begin(2), rows(2, 0.5), 1.0).tolist() == [[3.5], [3.5]]


def test_a_computed_start_follows_the_parameters_of_each_cell():
    def initial(u, p, y):
        y[0] = 10.0 * p[0] + u[0]

    model = replace(DECAY, initial=initial)
    solver = NetworkSolver(model)
    inside = solver.begin(2, rows(2, 0.5), np.array([[1.0], [2.0]]))
    assert inside.y[:, 0].tolist() == [10.5, 20.5]
