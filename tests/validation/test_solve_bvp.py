"""Steady fields with Michaelis–Menten uptake, with the equation handed to SciPy."""

import exact_balls
import numpy as np
import pytest
from layers import LEVEL, SIZE, along, ends_of, layers_of
from scipy.integrate import solve_bvp

from multicell.nutrient.equations.equation import FieldEquation
from multicell.nutrient.equations.substance import Substance

SUBJECT, SOURCE = "fields", "SciPy"
KINDS = ["cubes", "squares", "shells"]
D, HALF, DEMAND = 2000.0, 0.005, 0.03


def test_a_ball_with_michaelis_menten_uptake(compare):
    half = 0.1 * exact_balls.SURFACE
    ours = exact_balls.shells(exact_balls.UPTAKE, half, exact_balls.SURFACE)
    theirs = exact_balls.michaelis_menten(half)(exact_balls.RADII)
    off = abs(ours - theirs).max() / exact_balls.SURFACE
    compare.deviation(
        "Michaelis–Menten in a ball of 160 shells, over the surface",
        "`solve_bvp` at 10⁻⁸",
        off,
        1e-4,
    )


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
def test_steady_states_are_those_of_solve_bvp(kind, compare):
    errors = []
    for times in (1, 2):
        grid = layers_of(kind, times)
        position, capacity = feeding_everywhere(kind, grid)
        oxygen = Substance(D, ends_of(kind), HALF, capacity=capacity)
        equation = FieldEquation(grid, {"oxygen": oxygen}, position)
        state = equation.state({"oxygen": LEVEL})
        exact = by_solve_bvp(kind, grid.axes_coords[0])
        assert exact.min() < 0.9 * LEVEL
        ours = equation.solve(state, 1.0, solver="multicell-steady", tracker=None)
        errors.append(np.abs(along(kind, ours.data) - exact).max())
    assert errors[0] > 1e-6 * LEVEL
    what = f"Michaelis–Menten everywhere, {kind}, over the level outside"
    compare.deviation(what, "`solve_bvp` at 10⁻⁹", errors[0] / LEVEL, 5e-3)
    what = f"Michaelis–Menten everywhere, {kind}: gain of half the spacing"
    compare.value(what, 4.0, errors[0] / errors[1], 0.6)
