"""Boxes with all kinds of sides, shells, and marches in time against exact solutions."""

import numpy as np
import pytest
from grids import diffusion, divergence
from hypothesis import given, settings
from hypothesis import strategies as st
from pde import CartesianGrid, ScalarField, SphericalSymGrid

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


def slab(n, sides, length=100.0):
    """Return the operator of a slab between two sides, walls across, and its nodes along x."""
    h = length / n
    grid = CartesianGrid([(0, length), (0, 2 * h), (0, 2 * h)], (n, 2, 2))
    return diffusion(grid, D, {"y": WALL, "z": WALL, **sides}), (np.arange(n) + 0.5) * h


def test_a_slab_with_decay_at_second_order():
    """D c'' = k c with c'(0) = 0 and c(L) = 1: in proportion to cosh."""
    k, length, counts = 0.5, 100.0, (10, 20, 40, 80)
    m, errors = np.sqrt(k / D), []
    for n in counts:
        operator, x = slab(n, {"x-": WALL, "x+": {"value": 1.0}})
        zero = np.zeros(operator.shape)
        c, report = solve_steady(operator, zero, 1.0, zero, linear=k)
        exact = np.cosh(m * x) / np.cosh(m * length)
        errors.append(np.abs(c[:, 0, 0] - exact).max())
        assert report.inflow == pytest.approx(k * operator.volumes * c.sum(), rel=1e-9)
    assert order(counts, errors) == pytest.approx(-2.0, abs=0.15)


def test_a_jump_of_the_coefficient_at_a_face_is_exact():
    """Without sinks the flow is the same everywhere: slopes are inverse to the coefficients."""
    operator, x = slab(20, {"x-": {"value": 0.0}, "x+": {"value": 1.0}})
    ratio = np.where(x < 50.0, 1.0, 6.0)
    varied = np.broadcast_to(ratio[:, None, None], operator.shape)
    grid = CartesianGrid([(0, 100.0), (0, 10.0), (0, 10.0)], (20, 2, 2))
    sides = {"y": WALL, "z": WALL, "x-": {"value": 0.0}, "x+": {"value": 1.0}}
    jump = diffusion(grid, D, sides, varied=varied)
    zero = np.zeros(jump.shape)
    c, report = solve_steady(jump, zero, 1.0, zero)
    flow = 1.0 / (50.0 + 50.0 / 6.0)
    exact = np.where(x < 50.0, flow * x, 1.0 - flow * (100.0 - x) / 6.0)
    np.testing.assert_allclose(c[:, 0, 0], exact, rtol=1e-9)
    assert report.inflow == pytest.approx(0.0, abs=1e-7)
    assert report.outflow == pytest.approx(D * flow * 100.0, rel=1e-9)


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
    laplace = ScalarField(grid, c).laplace({"r-": WALL, "r+": SIDES[side]}).data
    np.testing.assert_allclose(shells.gain(c) / shells.volumes, D * laplace, rtol=1e-9, atol=1e-9)


COUNTS = (20, 40, 80, 160)


def radial_errors(exact, sink_of, half, boundary, radius=150.0):
    errors = []
    for n in COUNTS:
        shells = Shells(radius, n, D, boundary)
        r = (np.arange(n) + 0.5) * radius / n
        c, _ = shells.solve(sink_of(r), half, np.full(n, 0.1))
        errors.append(np.sqrt(np.average((c - exact(r)) ** 2, weights=shells.volumes)))
    return errors


def test_a_ball_with_a_starved_core_at_second_order():
    """Uptake of zeroth order ends at the necrotic radius: c = c' = 0 there."""
    q, radius, inner = 0.02, 150.0, 60.0
    surface = q / (6 * D) * (radius**2 - 3 * inner**2 + 2 * inner**3 / radius)

    def exact(r):
        return np.where(r > inner, q / (6 * D) * (r**2 - 3 * inner**2 + 2 * inner**3 / r), 0.0)

    errors = radial_errors(exact, lambda r: np.full_like(r, q), 1e-9, surface)
    assert order(COUNTS, errors) == pytest.approx(-2.0, abs=0.3)
    shells = Shells(radius, 320, D, surface)
    c, _ = shells.solve(np.full(320, q), 1e-9, np.full(320, 0.1))
    edge = np.flatnonzero(c > 1e-5 * surface)[0] * radius / 320
    assert edge == pytest.approx(inner, rel=0.03)


def test_a_layered_ball_with_a_boundary_layer_at_second_order():
    """Tissue to 100 µm with uptake of zeroth order, medium with D times 2.5 to 150 µm."""
    q, tissue, outer, ratio, medium = 0.004, 100.0, 150.0, 2.5, 0.3
    flow = q * tissue**3 / 3.0
    at_edge = medium - flow / (ratio * D) * (1 / tissue - 1 / outer)
    errors = []
    for n in (15, 30, 60, 120):
        r = (np.arange(n) + 0.5) * outer / n
        inside = r < tissue
        shells = Shells(outer, n, D, medium, varied=np.where(inside, 1.0, ratio))
        c, _ = shells.solve(np.where(inside, q, 0.0), 1e-10, np.full(n, medium))
        exact = np.where(
            inside,
            at_edge - q / (6 * D) * (tissue**2 - r**2),
            medium - flow / (ratio * D) * (1 / r - 1 / outer),
        )
        errors.append(np.abs(c - exact).max())
    assert order([15, 30, 60, 120], errors) == pytest.approx(-2.0, abs=0.15)


# --- time -----------------------------------------------------------------------------------------


def marched(equation, start, end, tolerance, scale=1.0):
    """Return the state at ``end`` by the march of runs, and what its solver says."""
    state = equation.state({"a": start})
    solver = MarchFieldSolver(equation, tolerance=tolerance, scales=np.array([scale]))
    solver.make_stepper(state)(state, 0.0, end)
    return state.data, solver.info


def entry(info, name):
    """Return what happened to the one field there is, amol."""
    return info["amounts"][0][BALANCE_COLUMNS.index(name)]


def ball_march(n, tolerance, end):
    """Let a substance diffuse into an empty ball; return equation, field and solver's account."""
    equation = FieldEquation(SphericalSymGrid(100.0, n), {"a": Substance(D, 1.0)})
    return equation, *marched(equation, 0.0, end, tolerance)


def series(r, t, radius=100.0):
    """Crank's series for a ball whose surface is held at 1 (The Mathematics of Diffusion, 6.18)."""
    k = np.arange(1, 400)[:, None]
    terms = (-1.0) ** k / k * np.sin(k * np.pi * r / radius)
    decay = np.exp(-D * (k * np.pi / radius) ** 2 * t)
    return 1.0 + 2.0 * radius / (np.pi * r) * (terms * decay).sum(axis=0)


def test_diffusion_into_a_ball_follows_the_series():
    for t in (0.5, 2.0, 6.0):
        equation, c, info = ball_march(100, 1e-4, t)
        assert np.abs(c - series(np.arange(100) + 0.5, t)).max() < 5e-3
        stored = float(np.sum(equation.layout.volumes * c))
        assert entry(info, "inflow") == pytest.approx(stored, rel=1e-9)
        assert entry(info, "outflow") == 0.0
        assert c.min() >= 0.0


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
