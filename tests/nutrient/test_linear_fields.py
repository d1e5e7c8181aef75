"""Fields that nothing takes up, against SciPy's exponential of the matrix of all nodes."""

from itertools import pairwise

import numpy as np
import pde
import pytest
from scipy.linalg import expm

import multicell as mc
from multicell.nutrient.balance import BALANCE_COLUMNS, SIGNS
from multicell.nutrient.equations import linear
from multicell.nutrient.equations.solvers import MarchFieldSolver

VALUES = {"x-": {"value": 0.1}, "x+": {"value": 0.3}, "*": {"value": 0.2}}
SLOPES = {"*": {"derivative": 0.0}}
MIXED = {"x-": {"value": 0.2}, "x+": {"derivative": 1e-3}, "*": {"derivative": 0.0}}
BOX = pde.CartesianGrid([(0, 50), (0, 40), (0, 60)], [5, 4, 6])
PLANE = pde.CartesianGrid([(0, 70), (0, 50)], [7, 5])
POSITION = np.array([[12.0, 22.0, 31.0], [38.0, 17.0, 24.0]])
RADIUS = np.array([6.0, 5.0])
SECRETED = np.array([30.0, 10.0])  # amol/s
NONE = np.zeros(2)
CASES = {
    "values on the sides": (BOX, VALUES, {}),
    "closed, nothing decays": (BOX, SLOPES, {}),
    "mixed sides, decay": (BOX, MIXED, {"decay": 0.02}),
    "perfused": (BOX, SLOPES, {"perfusion": 0.01, "medium": 0.4}),
    "plane": (PLANE, {"*": {"value": 0.05}}, {"decay": 1e-3}),
    "fast decay": (BOX, SLOPES, {"decay": 40.0}),
}


def placed(name, diffusion=60.0, **more):
    """Return an equation with two secreting cells, and nodes to begin with."""
    grid, sides, terms = CASES[name]
    position = POSITION.copy()
    if grid is PLANE:
        position[:, 2] = 0.0
    substance = mc.Substance(diffusion, sides, production=SECRETED, **terms | more)
    equation = mc.FieldEquation(grid, {"signal": substance}, position, radius=RADIUS)
    rng = np.random.default_rng(4)
    return equation, equation.state({"signal": rng.uniform(0.0, 0.2, grid.shape)})


def exact(equation, data, length, change=0.0):
    """Return the nodes after a time by the exponential of a matrix, and their integral over it.

    - ``change``: of the gain of nodes over the whole time
    """
    n = data.size

    def rates(c):
        return equation.rates(c.reshape(data.shape), 0.0)[0].ravel()

    gain = rates(np.zeros(n))
    block = np.zeros((2 * n + 2, 2 * n + 2))
    block[:n, :n] = np.transpose([rates(unit) - gain for unit in np.eye(n)])
    block[:n, n], block[:n, n + 1] = gain, change / length  # one, and the time
    block[n + 1, n] = 1.0
    block[n + 2 :, :n] = np.eye(n)
    first = np.concatenate([data.ravel(), [1.0, 0.0], np.zeros(n)])
    found = expm(length * block) @ first
    return found[:n].reshape(data.shape), found[n + 2 :].reshape(data.shape)


def marched(equation, state, length, watch=None, **options):
    solver = MarchFieldSolver(equation, **options)
    solver.watch = watch
    found = state.copy()
    solver.make_stepper(found)(found, 0.0, length)
    return np.asarray(found.data), solver.info


@pytest.mark.parametrize("length", [0.3, 50.0, 4000.0])
@pytest.mark.parametrize("name", CASES)
def test_nodes_and_account_are_those_of_the_exponential(name, length):
    equation, state = placed(name)
    found, info = marched(equation, state, length)
    end, integral = exact(equation, np.asarray(state.data), length)
    np.testing.assert_allclose(found, end, rtol=1e-9)
    assert info["steps"] == 1
    (row,) = info["amounts"]
    account = dict(zip(BALANCE_COLUMNS, row, strict=True))
    volumes = equation.layout.volumes
    decay = equation.substances["signal"].substance.decay
    assert account["decayed"] == pytest.approx(decay * volumes * integral.sum(), rel=1e-9)
    assert account["secreted"] == pytest.approx(40.0 * length)
    gained = sum(sign * account[entry] for entry, sign in SIGNS.items())
    stored = volumes * (end - np.asarray(state.data)).sum()
    scale = volumes * np.asarray(state.data).sum() + 40.0 * length
    assert gained == pytest.approx(stored, abs=1e-10 * scale)
    assert info["lifted"].tolist() == [0.0]


def test_secretion_and_a_medium_that_rise_are_followed():
    """Linearly in time, at once."""
    length, times = 80.0, np.array([0.0])
    rising = mc.Schedule(times, np.array([0.1]), np.array([0.4 / length]))
    equation, state = placed("perfused", medium=rising)
    each = equation.substances["signal"]
    before = each.gain(0.0)
    each.change_demand(POSITION, RADIUS, NONE, 0.2 * SECRETED, 0.0, length)
    first = each.gain(0.0)
    assert not np.array_equal(first, before)
    last = each.gain(np.nextafter(length, 0.0))
    each.set_time(0.0)
    end, _ = exact(equation, np.asarray(state.data), length, (last - first).ravel())
    found, info = marched(equation, state, length)
    np.testing.assert_allclose(found, end, rtol=1e-9)
    secreted = info["amounts"][0][BALANCE_COLUMNS.index("secreted")]
    assert secreted == pytest.approx(0.6 * 40.0 * length)


@pytest.mark.slow
def test_times_on_the_way_are_exact_and_close_where_the_field_bends():
    equation, state = placed("mixed sides, decay")
    seen = []
    _, _ = marched(equation, state, 600.0, lambda t, c: seen.append((t, c.copy())), tolerance=1e-3)
    times = np.array([time for time, _ in seen])
    assert times[0] == 0.0
    assert times[-1] == 600.0
    assert (np.diff(times) > 0.0).all()
    for time, values in seen[1:]:
        end, _ = exact(equation, np.asarray(state.data), time)
        np.testing.assert_allclose(values, end, rtol=1e-8)
    straight = [
        np.abs(0.5 * (a + b) - exact(equation, np.asarray(state.data), 0.5 * (s + t))[0]).max()
        for (s, a), (t, b) in pairwise(seen)
    ]
    assert max(straight) < 1e-3 * max(values.max() for _, values in seen)
    assert np.diff(times).min() < 5.0 < 50.0 < np.diff(times).max()


def test_nothing_is_below_zero_far_from_a_source():
    grid = pde.CartesianGrid([(0, 600)] * 3, 40)
    substance = mc.Substance(20.0, SLOPES, production=np.array([5.0]))
    centre = np.array([[300.0, 300.0, 300.0]])
    equation = mc.FieldEquation(grid, {"signal": substance}, centre, radius=RADIUS[:1])
    found, info = marched(equation, equation.state({"signal": 0.0}), 60.0)
    assert found.min() >= 0.0
    assert 0.0 <= info["lifted"][0] <= 1e-9 * 300.0  # amol, of those secreted
    assert equation.layout.volumes * found.sum() == pytest.approx(300.0, rel=1e-12)


@pytest.mark.parametrize(
    "more",
    [
        {"capacity": np.array([1.0, 0.0])},
        {"varied": np.linspace(0.5, 1.0, 120).reshape(5, 4, 6)},
    ],
    ids=["uptake", "unequal diffusion"],
)
def test_other_fields_are_left_to_steps(more):
    equation, state = placed("mixed sides, decay", **more)
    assert equation.linear_courses(np.asarray(state.data), 0.0, 1.0, 1.0) is None
    _, info = marched(equation, state, 50.0)
    assert info["steps"] > 1


def test_uptake_that_ends_within_the_step_counts():
    equation, state = placed("mixed sides, decay")
    each = equation.substances["signal"]
    assert linear.is_linear(each)
    each.change_demand(POSITION, RADIUS, np.array([1.0, 0.0]), SECRETED, 0.0, 10.0)
    assert not linear.is_linear(each)
    assert marched(equation, state, 10.0)[1]["steps"] > 1


@pytest.mark.parametrize(
    ("capacity", "production", "holds"), [(0.0, 0.0, True), (0.0, 2.0, False), (1.0, 0.0, False)]
)
def test_cells_that_leave_within_the_step_count_where_they_exchange(capacity, production, holds):
    """Their secretion ends at once, at a time of their own: that is no line."""
    equation, state = placed("mixed sides, decay")
    each, one = equation.substances["signal"], np.ones(1)
    cell = POSITION[:1], RADIUS[:1], capacity * one, production * one
    each.let_leave(*cell, np.array([4.0]))
    assert linear.is_linear(each) is holds
    _, info = marched(equation, state, 10.0)
    assert (info["steps"] == 1) is holds
    secreted = info["amounts"][0][BALANCE_COLUMNS.index("secreted")]
    assert secreted == pytest.approx(40.0 * 10.0 + 4.0 * production, rel=1e-6)


def test_phi_functions_at_all_arguments():
    """Against series with 60 terms in exact fractions."""
    from fractions import Fraction
    from math import factorial

    z = np.array([0.0, 1e-12, 1e-3, 0.4999, 0.5, 0.5001, 1.0, 7.0])
    for k, found in enumerate(linear._phi(z)):
        for argument, value in zip(z, found, strict=True):
            x = Fraction(float(argument))
            terms = ((-x) ** j / factorial(j + k) for j in range(60))
            assert value == pytest.approx(float(sum(terms)), rel=4e-15)


def test_sides_that_take_more_than_there_is_are_left_to_steps():
    sides = {"x-": {"derivative": -0.05}, "*": {"derivative": 0.0}}
    equation = mc.FieldEquation(BOX, {"signal": mc.Substance(60.0, sides)})
    state = equation.state({"signal": 0.01})
    solver = MarchFieldSolver(equation)
    solver.make_stepper(state)
    assert solver._follow(equation, np.asarray(state.data), 0.0, 400.0) is None
    assert solver.info["steps"] == 0
