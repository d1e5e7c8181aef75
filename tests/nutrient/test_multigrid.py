"""Multigrid for fields on many nodes, against direct solves, transforms and plain interpolation."""

import itertools

import numpy as np
import pytest
from grids import diffusion
from pde import CartesianGrid
from scipy.sparse import coo_array
from scipy.sparse.linalg import spsolve

import multicell as mc
from multicell.compiling.threads import Team
from multicell.nutrient import cartesian, steady, stencil
from multicell.nutrient.balls import gather
from multicell.nutrient.cartesian import Box, mesh, moved
from multicell.nutrient.diffusion import Diffusion
from multicell.nutrient.multigrid import Hierarchy, MultigridSolver
from multicell.nutrient.steady import solve_steady

D = 2000.0
VALUE, WALL = {"value": 0.07}, {"derivative": 0.0}
SUPPLY = {"derivative": 2e-5}
FACES = ("x-", "x+", "y-", "y+", "z-", "z+")


def operator(shape, sides=VALUE, varied=None, h=10.0):
    """Return diffusion on a grid with one condition on all faces, or named ones."""
    grid = CartesianGrid([(0.0, h * n) for n in shape], shape)
    names = FACES[: 2 * len(shape)]
    named = {face: sides.get(face, VALUE) if "x-" in sides else sides for face in names}
    height = 20.0 if len(shape) == 2 else None
    return diffusion(grid, D, named, height=height, varied=varied)


def ball(op, most=0.02):
    """Return an uptake of cells in the middle, unequal from node to node."""
    rng = np.random.default_rng(4)
    place = np.meshgrid(*(np.arange(n) - 0.5 * (n - 1) for n in op.shape), indexing="ij")
    away = np.sqrt(sum(x**2 for x in place))
    within = 0.4 * min(n for n in op.shape if n > 1)
    return np.where(away < within, most * (0.5 + rng.random(op.shape)), 0.0)


def patches(shape, ratio):
    """Return a coefficient that jumps by ``ratio`` round a block."""
    varied = np.ones((*shape, 1)[:3])
    varied[tuple(slice(n // 3, 2 * n // 3 + 1) for n in varied.shape)] = ratio
    return varied


def matrix(op, rate):
    """Return -D L0 + rate as a sparse matrix, column by column from the stencil."""
    n, out = rate.size, np.empty(op.shape)
    rows, columns, values = [], [], []
    for column in range(n):
        unit = np.zeros(n)
        unit[column] = 1.0
        stencil.apply_operator(
            unit.reshape(op.shape), rate, op.stiffness, op.ghost, op.weights, out
        )
        found = np.flatnonzero(out)
        rows.extend(found)
        columns.extend([column] * found.size)
        values.extend(out.ravel()[found])
    return coo_array((values, (rows, columns)), (n, n)).tocsr()


CASES = {
    "cube": ((8, 8, 8), VALUE, None),
    "odd": ((9, 5, 7), VALUE, None),
    "one over a power of two": ((17, 4, 6), {"x-": WALL, "y+": SUPPLY}, None),
    "walls": ((6, 7, 8), WALL, None),
    "layers": ((7, 6, 8), SUPPLY, None),
    "plane": ((13, 10), {"x-": SUPPLY, "y-": WALL}, None),
    "medium": ((9, 8, 7), {"x-": SUPPLY, "z-": WALL}, 3.0),
    "plane of a medium": ((12, 11), VALUE, 0.3),
    "rod": ((40, 2, 1), VALUE, None),
}


@pytest.mark.parametrize("case", CASES)
def test_systems_are_solved_as_by_a_direct_solver(case):
    shape, sides, ratio = CASES[case]
    op = operator(shape, sides, None if ratio is None else patches(shape, ratio))
    rng = np.random.default_rng(1)
    rate, residual = rng.random(op.shape) ** 8 * 40.0, rng.normal(size=op.shape)
    size = float(np.linalg.norm(residual))
    exact = spsolve(matrix(op, rate), residual.ravel()).reshape(op.shape)
    solver = MultigridSolver(op, Team())
    found = solver.solve(rate, residual, size, 1e-4)
    assert found.dtype == residual.dtype
    np.testing.assert_allclose(found, exact, atol=3e-4 * np.abs(exact).max())
    assert 1 <= solver.cg <= 12


def test_what_memory_held_before_warns_of_nothing(monkeypatch):
    op = operator((8, 7, 6))

    def dirty(shape, dtype=float):
        out = np.full(shape, np.inf, dtype)
        out[..., ::2] *= -1.0
        return out

    monkeypatch.setattr("multicell.nutrient.multigrid.np.empty", dirty)
    solver = MultigridSolver(op, Team())
    with np.errstate(all="raise"):
        found = solver.solve(np.ones(op.shape), np.ones(op.shape), 1.0, 1e-4)
    assert np.isfinite(found).all()


@pytest.mark.parametrize("ratio", [None, 0.1, 10.0])
@pytest.mark.parametrize("sides", [VALUE, {"x-": VALUE, **dict.fromkeys(FACES[1:], WALL)}, SUPPLY])
def test_a_cycle_gains_a_digit_on_any_number_of_nodes(ratio, sides):
    for shape in ((32, 32, 32), (33, 40, 21), (45, 13, 77)):
        op = operator(shape, sides, None if ratio is None else patches(shape, ratio))
        rate = ball(op) / 0.005
        residual = np.random.default_rng(0).normal(size=op.shape)
        solver = MultigridSolver(op, Team())
        solver.solve(rate, residual, float(np.linalg.norm(residual)), 1e-4)
        assert solver.cg <= (6 if ratio is None else 10)


@pytest.mark.parametrize(("most", "fast"), [(10.0, True), (1e6, False)])
def test_where_cycles_are_slow_conjugate_gradients_take_them(most, fast, monkeypatch):
    conjugate, taken = MultigridSolver._conjugate, []
    monkeypatch.setattr(
        MultigridSolver, "_conjugate", lambda *given: taken.append(1) or conjugate(*given)
    )
    op = operator((20, 19, 18))
    few = np.random.default_rng(2).random(op.shape) < 0.01  # means over nodes say little of these
    rate, residual = np.where(few, most, 0.0), np.ones(op.shape)
    solver, image = MultigridSolver(op, Team()), np.empty(op.shape)
    for solves in (1, 2):
        size = float(np.linalg.norm(residual))
        found = solver.solve(rate, residual, size, 1e-4)
        assert len(taken) == (0 if fast else solves)
        stencil.apply_operator(found, rate, op.stiffness, op.ghost, op.weights, image)
        assert np.linalg.norm(residual - image) <= 2e-4 * size
    assert solver.cg <= (10 if fast else 30)


@pytest.mark.parametrize(
    ("half", "shape", "ratio"),
    [(0.1, (24, 25, 27), 2.5), (0.005, (60, 41), None), (0.005, (24, 25, 27), None),
     (1e-4, (60, 41), 2.5)],
)  # fmt: skip
def test_fields_are_those_by_transforms(half, shape, ratio, monkeypatch):
    op = operator(
        shape, {"x-": WALL, "y-": SUPPLY}, None if ratio is None else patches(shape, ratio)
    )
    sink, start = ball(op, 0.2), np.full(op.shape, 0.07)
    supply = np.full(op.shape, 1e-5)
    by_transforms, _ = solve_steady(op, sink, half, start, supply=supply, linear=1e-3)
    monkeypatch.setattr(steady, "MULTIGRID_NODES", 1)
    c, report = solve_steady(op, sink, half, start, supply=supply, linear=1e-3)
    np.testing.assert_allclose(c, by_transforms, atol=1e-8 * 0.07)
    assert c.min() >= 0.0
    lost = report.uptake + 1e-3 * op.volumes * c.sum()
    assert report.residual <= 1e-9 * lost
    assert report.inflow + op.volumes * supply.sum() == pytest.approx(lost, rel=1e-9)


@pytest.mark.parametrize("shape", [(40, 38, 36), (130, 131)])
def test_the_same_bits_for_any_number_of_threads(shape, monkeypatch):
    monkeypatch.setattr(steady, "MULTIGRID_NODES", 1)
    monkeypatch.setattr(stencil, "PART", 1)
    found = []
    for threads, ratio in itertools.product((1, 2, 3), (None, 2.0)):
        op = operator(shape, VALUE, None if ratio is None else patches(shape, ratio))
        op.threads = threads
        c, report = solve_steady(op, ball(op), 0.005, np.full(op.shape, 0.07))
        found.append((c, report))
    for one, other in zip(found[:2] * 2, found[2:], strict=True):
        np.testing.assert_array_equal(one[0], other[0])
        assert one[1] == other[1]


def test_a_failure_in_a_thread_is_the_caller_s():
    def fail(begin, end):
        if begin > 0:
            raise RuntimeError("in the second part")

    with Team(2) as team, pytest.raises(RuntimeError, match="second part"):
        team.share(fail, 4)


def test_a_moved_grid_is_interpolated_as_points_are(monkeypatch):
    rng = np.random.default_rng(5)
    for n, m in itertools.product(((4, 5, 6), (1, 7, 3)), ((9, 3, 8), (2, 2, 2))):
        old = Box((-20.0, 3.0, 1.0), n, 10.0)
        new = Box((-31.0, 0.5, 4.0), m, 7.3)
        values = rng.random(n)
        points = mesh(new.axes())
        low, high = np.array(old.origin), np.array(old.upper)
        inside = ((points >= low) & (points <= high)).all(axis=1)
        expected = np.full(len(points), 0.4)
        expected[inside] = gather(old, points[inside], values)
        found = moved(values, old, new, 0.4)
        np.testing.assert_allclose(found.ravel(), expected, rtol=1e-14)
        monkeypatch.setattr(cartesian, "_NEAR_NODES", 20)  # a few planes at once
        monkeypatch.setattr(cartesian, "_PART", 1)
        np.testing.assert_array_equal(moved(values, old, new, 0.4, 3), found)
        monkeypatch.undo()
    away = moved(values, old, Box((100.0, 0.0, 0.0), m, 7.3), 0.4)
    np.testing.assert_array_equal(away, np.full(m, 0.4))


def test_a_simulation_hands_its_threads_to_its_fields():
    scene = mc.load_scene("growth").with_changes({"nutrients": {"oxygen": {"boundary": 0.07}}})
    simulation = mc.Simulation(scene, threads=1)
    assert [field.threads for field in simulation.field_system.fields.values()] == [1]


def test_one_node_is_solved_exactly():
    hierarchy = Hierarchy((1, 1, 1), np.array([-1.0, 1.0, 1.0, 1.0, 1.0, 1.0]), Team())
    level = hierarchy.levels[0]
    level.rate[:], level.b[:] = 0.5, 3.0
    assert hierarchy.cycle()[0, 0, 0] == pytest.approx(3.0 / (2.0 + 0.5))
    op = Diffusion(Box((0.0, 0.0, 0.0), (1, 1, 1), 10.0), D, 0.5)
    rate = np.full(op.shape, 7.0)  # and a face with a value brings twice the coefficient
    found = MultigridSolver(op, Team()).solve(rate, np.full(op.shape, 3.0), 3.0, 1e-6)
    assert found[0, 0, 0] == pytest.approx(3.0 / (12.0 * op.stiffness + 7.0), rel=1e-6)


def test_the_imbalance_by_planes_is_that_of_all_nodes():
    op = operator((6, 7, 9), SUPPLY)
    rng = np.random.default_rng(3)
    c, sink, source = (rng.random(op.shape) for _ in range(3))
    found = []
    with Team(2) as team:
        for share in (None, team):
            residual, rate = np.empty(op.shape), np.empty(op.shape)
            sums = stencil.write_imbalance(
                c,
                sink,
                source,
                0.1,
                op.stiffness,
                0.2,
                op.ghost,
                None,
                None,
                0.0,
                residual,
                rate,
                share,
            )
            found.append((sums, residual, rate))
    (whole, *arrays), (planes, *others) = found
    np.testing.assert_allclose(whole, planes, rtol=1e-13)
    for one, other in zip(arrays, others, strict=True):
        np.testing.assert_array_equal(one, other)


def test_small_rates_between_walls_are_solved_where_single_precision_loses_them():
    op = operator((38, 38, 38), WALL)
    assert op.shape == (38, 38, 38)
    assert np.prod(op.shape) > steady.MULTIGRID_NODES
    nothing, supply = np.zeros(op.shape), np.full(op.shape, 1e-6)
    for rate in (1e-6, 3e-7, 1e-7):
        start = np.full(op.shape, 0.1)
        c, report = solve_steady(op, nothing, 1e-4, start, linear=rate, supply=supply)
        assert c == pytest.approx(1e-6 / rate, rel=1e-6)
        assert report.inflow == pytest.approx(0.0, abs=1e-9)


def test_a_plane_with_one_open_side_and_little_uptake_is_solved():
    # a cycle from zero has no positive product with its right-hand side there
    sides = dict.fromkeys(FACES[:4], WALL) | {"x+": VALUE}
    op, rng = operator((366, 201), sides), np.random.default_rng(11)
    sink, start = 1e-9 * rng.random(op.shape), 0.07 * rng.random(op.shape)
    c, report = solve_steady(op, sink, 1e-3, start)
    assert report.inflow == pytest.approx(report.uptake, rel=1e-6)
    assert 0.0 < c.min() <= c.max() < 0.0701


def test_corrections_that_point_uphill_hand_over_to_transforms(monkeypatch):
    op = operator((38, 38, 38))
    sink = ball(op)
    expected, _ = solve_steady(op, sink, 1e-3, np.full(op.shape, 0.05))
    solve = MultigridSolver.solve
    monkeypatch.setattr(MultigridSolver, "solve", lambda self, *given: -solve(self, *given))
    found, report = solve_steady(op, sink, 1e-3, np.full(op.shape, 0.05))
    assert found == pytest.approx(expected, abs=1e-9)
    assert report.inflow == pytest.approx(report.uptake, rel=1e-6)


def test_any_layout_of_arrays_is_taken():
    op = operator((9, 8, 7))
    sink, start = ball(op), np.full(op.shape, 0.05)
    expected, _ = solve_steady(op, sink, 1e-3, start)
    for other in (np.asfortranarray(sink), np.repeat(sink, 2, axis=2)[:, :, ::2]):
        for first in (np.asfortranarray(start), np.broadcast_to(0.05, op.shape)):
            assert np.array_equal(solve_steady(op, other, 1e-3, first)[0], expected)
