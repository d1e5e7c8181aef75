"""The fields' equation against solve_bvp and closed forms on 16³ cubes, 24² squares, 40 shells."""

import numpy as np
import pytest
from pde import CartesianGrid, SphericalSymGrid
from scipy.integrate import solve_bvp

from multicell.nutrient.equations.equation import FieldEquation, Substance

D, LEVEL, HALF, DEMAND = 2000.0, 0.07, 0.005, 0.03
SIZE = {"cubes": 160.0, "squares": 180.0, "shells": 120.0}
NODES = {"cubes": 16, "squares": 24, "shells": 40}
KINDS = list(SIZE)


def grid_of(kind, times=1):
    """Return a slab of cubes or squares across x, or a ball of shells."""
    size, n = SIZE[kind], NODES[kind]
    if kind == "shells":
        return SphericalSymGrid(size, n * times)
    # what lies across x does not matter: few nodes do where it is refined
    rest = n if times == 1 else 2
    h = size / (n * times)
    axes = 2 if kind == "cubes" else 1
    return CartesianGrid([(0.0, size)] + [(0.0, rest * h)] * axes, [n * times] + [rest] * axes)


def sides(kind):
    if kind == "shells":
        return {"value": LEVEL}
    return {"x": {"value": LEVEL}, "*": {"derivative": 0.0}}


def feeding_everywhere(kind, grid):
    """Return positions at the nodes of a grid, and uptake for one density everywhere."""
    if kind == "shells":
        position = np.zeros((grid.shape[0], 3))
        position[:, 0] = grid.axes_coords[0]
        return position, DEMAND * grid.cell_volumes
    nodes = grid.cell_coords.reshape(-1, grid.num_axes)
    position = np.zeros((len(nodes), 3))
    position[:, : grid.num_axes] = nodes
    h = grid.discretization[0]
    return position, np.full(len(nodes), DEMAND * h**3)


def along(kind, data):
    """Return a field along x, or along the radius; it is the same across."""
    if kind == "shells":
        return data
    first = data.reshape(data.shape[0], -1)
    assert np.ptp(first, axis=1).max() < 1e-9 * LEVEL
    return first[:, 0]


def by_solve_bvp(kind, where):
    """D c'' (+ 2 D c'/r) = q c / (K + c) between two values, or in a ball."""
    x = np.linspace(0.0, SIZE[kind], 400)

    def slopes(x, y):
        return np.array([y[1], DEMAND / D * y[0] / (HALF + y[0])])

    def ends(a, b):
        inner = a[1] if kind == "shells" else a[0] - LEVEL
        return np.array([inner, b[0] - LEVEL])

    start = np.vstack([np.full(400, LEVEL), np.zeros(400)])
    curved = np.array([[0.0, 0.0], [0.0, -2.0]]) if kind == "shells" else None
    found = solve_bvp(slopes, ends, x, start, S=curved, tol=1e-9, max_nodes=50_000)
    assert found.success
    return found.sol(where)[0]


@pytest.mark.parametrize("kind", KINDS)
def test_steady_states_are_those_of_solve_bvp(kind):
    errors = []
    for times in (1, 2):
        grid = grid_of(kind, times)
        position, capacity = feeding_everywhere(kind, grid)
        oxygen = Substance(D, sides(kind), HALF, capacity=capacity)
        equation = FieldEquation(grid, {"oxygen": oxygen}, position)
        state = equation.state({"oxygen": LEVEL})
        exact = by_solve_bvp(kind, grid.axes_coords[0])
        assert exact.min() < 0.9 * LEVEL
        ours = equation.solve(state, 1.0, solver="multicell-steady", tracker=None)
        errors.append(np.abs(along(kind, ours.data) - exact).max())
    assert 1e-6 * LEVEL < errors[0] < 5e-3 * LEVEL
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.15)


def exact_filling(kind, x, t, decay):
    """Return the filling of an empty slab or ball whose sides are held at LEVEL (Crank 1975)."""
    size, k = SIZE[kind], np.sqrt(decay / D)
    n = np.arange(1, 400)[:, None]
    if kind == "shells":
        waves = n * np.pi / size
        rest = size * np.sinh(k * x) / (x * np.sinh(k * size))
        size_of = 2.0 * np.where(n % 2 == 1, 1.0, -1.0) * waves / (waves**2 + k**2) / x
    else:
        waves = n * np.pi / size
        rest = np.cosh(k * (x - 0.5 * size)) / np.cosh(0.5 * k * size)
        size_of = np.where(n % 2 == 1, 4.0, 0.0) / (n * np.pi) * waves**2 / (waves**2 + k**2)
    gone = np.exp(-D * (waves**2 + k**2) * t)
    return LEVEL * (rest - np.sum(size_of * np.sin(waves * x) * gone, axis=0))


@pytest.mark.parametrize("kind", KINDS)
def test_transients_follow_the_closed_form(kind):
    decay, errors = 0.3, []
    for times in (1, 2):
        grid = grid_of(kind, times)
        equation = FieldEquation(grid, {"oxygen": Substance(D, sides(kind), decay=decay)})
        empty = equation.state({"oxygen": 0.0})
        end = 0.3 * SIZE[kind] ** 2 / (np.pi**2 * D)
        exact = exact_filling(kind, grid.axes_coords[0], end, decay)
        assert exact.min() < 0.5 * LEVEL
        ours = equation.solve(empty, end, solver="multicell-implicit", rtol=1e-8, tracker=None)
        errors.append(np.abs(along(kind, ours.data) - exact).max())
    assert errors[0] < 5e-3 * LEVEL
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.15)
