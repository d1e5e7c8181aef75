"""Boxes with all kinds of sides, shells, and marches in time against exact solutions."""

import numpy as np
import pytest
from grids import diffusion, divergence
from hypothesis import given, settings
from hypothesis import strategies as st
from pde import CartesianGrid, ScalarField, SphericalSymGrid
from plain_pde import uncompiled

from multicell.nutrient.balance import BALANCE_COLUMNS
from multicell.nutrient.diffusion import eigenvalues
from multicell.nutrient.equations.equation import FieldEquation
from multicell.nutrient.equations.solvers import MarchFieldSolver
from multicell.nutrient.equations.substance import Substance
from multicell.nutrient.spherical import Shells
from multicell.nutrient.steady import solve_steady

D = 1000.0
WALL = {"derivative": 0.0}
SIDES = {
    "value": {"value": 0.3},
    "wall": WALL,
    "supply": {"derivative": 0.01},
}


def order(steps, errors):
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


# --- the operator ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("first", "second", "dimensions"),
    [*((one, other, 3) for one in SIDES for other in SIDES), *((one, one, 2) for one in SIDES)],
)
def test_stencil_and_flows_agree_with_pde_for_all_kinds_of_sides(dimensions, first, second):
    shape = (4, 5, 6)[:dimensions]
    grid = CartesianGrid([(0, 7.0 * n) for n in shape], shape)
    axes = "xyz"[:dimensions]
    sides = {axis + "-": SIDES[first] for axis in axes}
    sides |= {axis + "+": SIDES[second] for axis in axes}
    operator = diffusion(grid, D, sides, height=9.0 if dimensions == 2 else None)
    c = np.random.default_rng(1).random(operator.shape)
    # its other backend compiles for every shape and kind of side
    laplace = ScalarField(grid, c.reshape(shape)).laplace(sides, backend="scipy")
    expected = D * laplace.data.reshape(c.shape)
    np.testing.assert_allclose(divergence(operator, c), expected, rtol=0, atol=1e-11)
    inward, outward = operator.flows(c)
    total = float(expected.sum()) * operator.volumes
    assert inward - outward == pytest.approx(total, rel=1e-11, abs=1e-9)


@pytest.mark.parametrize("ends", [(True, True), (False, False), (True, False), (False, True)])
def test_transforms_diagonalise_each_pair_of_ends(ends):
    n = 12
    low, high = ({"value": 0.0} if end else WALL for end in ends)
    sides = {"x-": low, "x+": high, "y": WALL, "z": WALL}
    operator = diffusion(CartesianGrid([(0, n), (0, 6), (0, 7)], (n, 6, 7)), 1.0, sides)
    y = np.random.default_rng(2).normal(size=operator.shape)
    u, product = operator.invert(y.copy(), 0.3)
    np.testing.assert_allclose(0.3 * u - divergence(operator, u), y, atol=1e-12)
    assert product == pytest.approx(np.sum(u * y), rel=1e-12)
    assert eigenvalues(n, ends).min() >= 0.0


@pytest.mark.parametrize("sides", [{"*": SIDES["value"]}, {"x": SIDES["value"], "*": WALL}])
def test_iterations_do_not_grow_with_the_grid(sides):
    found = []
    for n in (16, 32, 64):
        grid = CartesianGrid([(-150, 150)] * 3, n)
        operator = diffusion(grid, D, sides)
        r = np.linalg.norm(grid.cell_coords, axis=-1)
        sink = np.where(r < 100.0, 0.01, 0.0)
        _, report = solve_steady(operator, sink, 0.01, np.full(operator.shape, 0.3))
        found.append(report.cg)
        balance = report.inflow - report.uptake
        assert abs(balance) <= 1e-8 * report.uptake
    assert found[1] <= 1.3 * found[0] + 2
    assert found[2] <= 1.3 * max(found[0], 10) + 2  # by multigrid, which is nowhere exact


@settings(max_examples=25, deadline=None)
@given(st.sampled_from(sorted(SIDES)), st.floats(-3, 6), st.integers(0, 100), st.floats(0.0, 2.0))
def test_nothing_is_negative(side, strength, seed, supply):
    sides = {"x-": {"value": 0.1}, "x+": SIDES[side], "y": SIDES[side], "z": WALL}
    operator = diffusion(CartesianGrid([(0, 90)] * 3, 9), D, sides)
    rng = np.random.default_rng(seed)
    sink = 10.0**strength * rng.random(operator.shape) ** 4
    made = supply * rng.random(operator.shape) ** 8
    c, _ = solve_steady(operator, sink, 0.005, np.full(operator.shape, 0.1), supply=made)
    assert c.min() >= 0.0
    shells = Shells(90.0, 12, D, 0.1)
    radial, _ = shells.solve(sink[0, 0, 0] + sink.ravel()[:12], 0.005, np.full(12, 0.1))
    assert radial.min() >= 0.0


# --- shells ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("side", SIDES)
def test_shells_are_those_of_pde(side):
    grid = SphericalSymGrid(120.0, 15)
    c = np.random.default_rng(3).random(15)
    shells = Shells(120.0, 15, D, SIDES[side])
    with uncompiled():
        laplace = ScalarField(grid, c).laplace({"r-": WALL, "r+": SIDES[side]}).data
    np.testing.assert_allclose(shells.gain(c) / shells.volumes, D * laplace, rtol=1e-9, atol=1e-9)


# --- time -----------------------------------------------------------------------------------------


def marched(equation, start, end, tolerance, scale=1.0):
    """Return the state at ``end`` by the march of runs, and what its solver says."""
    state = equation.state({"a": start})
    solver = MarchFieldSolver(equation, tolerance=tolerance, scales=np.array([scale]))
    solver.make_stepper(state)(state, 0.0, end)
    return state.data, solver.info


def entry(info, name):
    """Return the account of the only field, amol."""
    return info["amounts"][0][BALANCE_COLUMNS.index(name)]


def ball_march(n, tolerance, end):
    """Let a substance diffuse into an empty ball; return equation, field and solver's account."""
    equation = FieldEquation(SphericalSymGrid(100.0, n), {"a": Substance(D, 1.0)})
    return equation, *marched(equation, 0.0, end, tolerance)


def test_the_error_of_the_march_follows_its_tolerance():
    equation = FieldEquation(SphericalSymGrid(100.0, 40), {"a": Substance(D, 1.0)})
    options = {"solver": "multicell-implicit", "rtol": 1e-9, "tracker": None}
    exact = equation.solve(equation.state({"a": 0.0}), 4.0, **options).data
    errors = [np.abs(ball_march(40, tol, 4.0)[1] - exact).max() for tol in (1e-2, 1e-3, 1e-4)]
    assert errors[0] > 3 * errors[1] > 9 * errors[2]
    assert errors[1] < 3e-3


def test_the_march_comes_to_rest_at_the_steady_state():
    shells, inside = Shells(100.0, 30, D, 1.0), np.arange(30) < 20
    steady, _ = shells.solve(np.where(inside, 0.3, 0.0), 0.1, np.ones(30), linear=0.02)
    position = np.zeros((20, 3))
    position[:, 1] = (np.arange(20) + 0.5) * shells.spacing  # in the middles of shells
    eaten = Substance(D, 1.0, 0.1, decay=0.02, capacity=0.3 * shells.volumes[inside])
    equation = FieldEquation(SphericalSymGrid(100.0, 30), {"a": eaten}, position)
    c, info = marched(equation, 1.0, 5e5, 1e-3)
    np.testing.assert_allclose(c, steady, rtol=1e-7)
    stored = float(np.sum(shells.volumes * (c - 1.0)))
    gone = entry(info, "uptake") + entry(info, "decayed")
    assert abs(entry(info, "inflow") - gone - stored) < 1e-8 * gone
