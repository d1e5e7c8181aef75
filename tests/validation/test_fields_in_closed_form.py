"""Fields whose closed form follows from their equation by hand."""

import exact_balls
import numpy as np
import pytest
from grids import diffusion
from pde import CartesianGrid

import multicell as mc
from multicell.nutrient.cartesian import Box
from multicell.nutrient.diffusion import Diffusion
from multicell.nutrient.steady import solve_steady

SUBJECT, SOURCE = "fields", "closed form"
D = 1000.0
WALL = {"derivative": 0.0}


def test_a_ball_with_uptake_in_proportion(compare):
    r, outer, m = exact_balls.RADII, exact_balls.R, np.sqrt(0.4 / exact_balls.D)
    exact = 0.1 * outer / r * np.sinh(m * r) / np.sinh(m * outer)
    off = abs(exact_balls.shells(0.0, 1.0, 0.1, 0.4) - exact).max() / 0.1
    compare.deviation("uptake in proportion: c over the surface", "sinh(mr)/r", off, 1e-4)


def test_a_slab_with_decay_from_python(compare):
    grid = CartesianGrid([(0, 100), (0, 2.5), (0, 2.5)], (80, 2, 2))
    sides, x = {"x+": {"value": 1.0}, "*": WALL}, (np.arange(80) + 0.5) * 1.25
    slab = mc.FieldEquation(grid, {"a": mc.Substance(D, sides, decay=0.5)})
    decayed = slab.solve(slab.state({"a": 0.0}), 1.0, solver="multicell-steady", tracker=None).data
    m = np.sqrt(0.5 / D)
    off = abs(decayed[:, 0, 0] - np.cosh(m * x) / np.cosh(100 * m)).max()
    compare.deviation("slab with decay, 80 nodes: c over the level", "cosh(mx)/cosh(mL)", off, 2e-4)


def test_absurd_uptake_leaves_nothing_negative(compare):
    hard = np.full((12, 12, 12), 1e6)  # mM/s
    cube = Diffusion(Box((0.0, 0.0, 0.0), (12, 12, 12), 7.5), D, 0.1)
    least = solve_steady(cube, hard, 0.005, np.full(cube.shape, 0.1))[0].min()
    below = max(0.0, -float(least))
    compare.deviation("uptake of 10⁶ mM/s: least c below 0", "nothing negative", below, 0.0, "mM")


def slab(n, sides, length=100.0):
    """Return the operator of a slab between two sides, walls across, and its nodes along x."""
    h = length / n
    grid = CartesianGrid([(0, length), (0, 2 * h), (0, 2 * h)], (n, 2, 2))
    return diffusion(grid, D, {"y": WALL, "z": WALL, **sides}), (np.arange(n) + 0.5) * h


def test_a_slab_with_decay_at_second_order(compare):
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
    found = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    compare.value("slab with decay: order in the spacing", 2.0, found, 0.15)


def test_a_jump_of_the_coefficient_at_a_face_is_exact(compare):
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
    off = np.abs(c[:, 0, 0] / exact - 1.0).max()
    compare.deviation("jump of D at a face, relative", "slopes inverse to D", off, 1e-9)
    assert report.inflow == pytest.approx(0.0, abs=1e-7)
    assert report.outflow == pytest.approx(D * flow * 100.0, rel=1e-9)
