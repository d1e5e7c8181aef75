"""The steady solver against exact solutions, py-pde's operator and SciPy's sparse solver."""

from contextlib import suppress

import numpy as np
import pytest
from grids import diffusion, divergence
from pde.grids.cartesian import CartesianGrid

from multicell.errors import NutrientFailed
from multicell.nutrient.balls import scatter
from multicell.nutrient.cartesian import Box
from multicell.nutrient.steady import solve_steady

D = 2000.0
RADIUS = 100.0
HALF_WIDTH = 150.0
CENTRE = np.array([3.1, -5.3, 1.7])  # off every symmetry of the grid
SIZES = (20, 40)


def cube(n, half_width=HALF_WIDTH):
    return CartesianGrid([(-half_width, half_width)] * 3, n)


def ball_quadrature():
    """Return points and volumes that integrate over the ball by Gauss's rules."""
    s, ws = np.polynomial.legendre.leggauss(48)
    r, wr = 0.5 * RADIUS * (s + 1.0), 0.5 * RADIUS * ws
    m, wm = np.polynomial.legendre.leggauss(60)
    phi = 2.0 * np.pi * (np.arange(120) + 0.25) / 120
    r, m, phi = np.meshgrid(r, m, phi, indexing="ij")
    ring = np.sqrt(1.0 - m**2)
    points = np.stack([r * ring * np.cos(phi), r * ring * np.sin(phi), r * m], axis=-1)
    volumes = r**2 * wr[:, None, None] * wm[:, None] * (2.0 * np.pi / 120)
    return points.reshape(-1, 3) + CENTRE, volumes.ravel()


POINTS, VOLUMES = ball_quadrature()


def ball_sink(grid, density):
    """Return a uniform sink in the ball, spread over the nodes like the cells are."""
    low = tuple(bounds[0] for bounds in grid.axes_bounds)
    return scatter(Box(low, grid.shape, float(grid.discretization[0])), POINTS, density * VOLUMES)


def from_faces(grid, law):
    """Return the inflow to the nodes by an exact solution's values on all faces, mM/s."""
    middle, h = grid.axes_coords[0], float(grid.discretization[0])
    a, b = np.meshgrid(middle, middle, indexing="ij")
    supply = np.zeros(grid.shape)
    for axis in range(3):
        for end, at in ((0, -HALF_WIDTH), (-1, HALF_WIDTH)):
            x = np.insert(np.stack([a, b], axis=-1), axis, at, axis=-1)
            layer = np.moveaxis(supply, axis, 0)[end]
            layer += 2.0 * D / h**2 * law(np.linalg.norm(x - CENTRE, axis=-1))
    return supply


def starved_core(uptake, surface, necrotic):
    """Return c(r) for a constant uptake in the shell from ``necrotic`` to the ball's surface."""

    def law(r):
        inner = np.clip(r, necrotic, RADIUS)
        shape = inner**2 - 3.0 * necrotic**2 + 2.0 * necrotic**3 / inner
        at_rim = RADIUS**2 - 3.0 * necrotic**2 + 2.0 * necrotic**3 / RADIUS
        flow = uptake * (RADIUS**3 - necrotic**3) / (3.0 * D)
        outer = flow * (1.0 / RADIUS - 1.0 / np.maximum(r, RADIUS))
        return surface + uptake / (6.0 * D) * (shape - at_rim) + outer

    return law


def rms_error(n, law, density, half):
    grid = cube(n)
    start = np.full(grid.shape, float(law(np.array(2 * RADIUS))))
    operator, supply = diffusion(grid, D, 0.0), from_faces(grid, law)
    c, report = solve_steady(operator, ball_sink(grid, density), half, start, supply=supply)
    r = np.linalg.norm(grid.cell_coords - CENTRE, axis=-1)
    return np.sqrt(np.mean((c - law(r)) ** 2)), c, report


def order(errors, sizes=SIZES):
    return -np.polyfit(np.log(sizes), np.log(errors), 1)[0]


@pytest.mark.slow
def test_second_order_for_zero_order_uptake_with_a_necrotic_core():
    necrotic, uptake = 55.0, 0.05
    rim = RADIUS**2 - 3.0 * necrotic**2 + 2.0 * necrotic**3 / RADIUS
    law = starved_core(uptake, uptake / (6.0 * D) * rim, necrotic)
    errors, radii = [], []
    for n in SIZES:
        error, c, report = rms_error(n, law, density=uptake, half=1e-8)
        errors.append(error)
        radii.append((RADIUS**3 - report.uptake / (4 / 3 * np.pi * uptake)) ** (1 / 3))
        assert c.min() >= 0.0
    assert order(errors) == pytest.approx(2.0, abs=0.2)
    assert radii[-1] == pytest.approx(necrotic, rel=2e-3)
    assert order(np.abs(np.array(radii) - necrotic)) > 1.6


def starved(n=24, factor=1.0, half=0.005):
    """Return operator, sink and half saturation of a ball that starves in its middle."""
    grid = cube(n)
    return diffusion(grid, D, 0.07), ball_sink(grid, 0.15 * factor), half


@pytest.mark.parametrize("factor", [1.0, 1e3, 1e6])
@pytest.mark.parametrize("half", [0.005, 1e-6])
def test_converges_to_one_field_without_negative_values_from_any_guess(factor, half):
    operator, sink, half = starved(16, factor, half)
    found = []
    for guess in (0.07, 0.0, 50.0, -3.0):
        c, report = solve_steady(operator, sink, half, np.full(operator.shape, guess))
        assert c.min() >= 0.0
        assert c.max() <= 0.07 * (1 + 1e-12)
        assert c[8, 8, 8] < 1e-3
        assert report.inflow == pytest.approx(report.uptake, rel=1e-9)
        imbalance = divergence(operator, c) - sink * c / (half + c)
        assert np.abs(imbalance).sum() * operator.spacing**3 <= 2e-9 * report.uptake
        found.append(c)
    np.testing.assert_allclose(found[1:], [found[0]] * 3, rtol=0, atol=1e-9 * 0.07)


@pytest.mark.parametrize("nodes", [2, 4, 8])
@pytest.mark.parametrize("medium", [1e-12, 1e-3])
@pytest.mark.parametrize("uptake", [1e6, 1e14, 1e18, 1e22])
def test_fields_too_small_for_single_precision_are_solved_or_refused_by_name(nodes, medium, uptake):
    """Diffusion of 1e-6 µm²/s against uptake (mM/s) that leaves next to nothing."""
    operator = diffusion(cube(nodes), 1e-6, medium)
    sink = np.full(operator.shape, uptake)
    with suppress(NutrientFailed):
        c, _ = solve_steady(operator, sink, 0.004, np.full(operator.shape, medium))
        assert c.min() >= 0.0
        assert c.max() <= medium


def test_a_warm_start_takes_fewer_iterations():
    operator, sink, half = starved()
    c, cold = solve_steady(operator, sink, half, np.full(operator.shape, 0.07))
    _, warm = solve_steady(operator, 1.01 * sink, half, c)
    assert warm.newton < cold.newton
    assert warm.cg < 0.7 * cold.cg
    _, again = solve_steady(operator, sink, half, c)
    assert (again.newton, again.cg) == (0, 0)


def test_values_that_are_not_finite_end_with_words():
    operator, sink, half = starved(8)
    sink[3, 3, 3] = np.nan
    with pytest.raises(NutrientFailed, match=r"did not converge.*Check uptake"):
        solve_steady(operator, sink, half, np.full(operator.shape, 0.07))
