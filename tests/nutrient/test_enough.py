"""Fields on many nodes that are solved no more exactly than their grid allows."""

import numpy as np
import pytest
from grids import diffusion
from pde import CartesianGrid

import multicell as mc
from multicell.nutrient import steady
from multicell.nutrient.steady import BALANCE_TOLERANCE, ENOUGH, solve_steady

SHAPE, D = (22, 20, 24), 2000.0
VALUE, WALL = {"value": 0.07}, {"derivative": 0.0}
FACES = ("x-", "x+", "y-", "y+", "z-", "z+")


def operator(sides, h=10.0, shape=SHAPE):
    grid = CartesianGrid([(0.0, h * n) for n in shape], shape)
    return diffusion(grid, D, dict(zip(FACES, sides, strict=True)))


def ball(most):
    place = np.meshgrid(*(np.arange(n) - 0.5 * (n - 1) for n in SHAPE), indexing="ij")
    inside = np.sqrt(sum(x**2 for x in place)) < 8.0
    return np.where(inside, most * (0.5 + np.random.default_rng(4).random(SHAPE)), 0.0)


CASES = {
    "a starved core": ([VALUE] * 6, 0.3, 0.005, 0.0, 0.0),
    "enough for all": ([VALUE] * 6, 0.002, 0.005, 0.0, 0.0),
    "a medium on one side": ([VALUE] + [WALL] * 5, 0.002, 0.01, 0.0, 1e-6),
    "supply that decays": ([WALL] * 6, 0.0, 0.005, 1e-3, 1e-5),
    "supply that saturated uptake hardly takes": ([WALL] * 6, 0.02, 1e-3, 0.0, None),
}


def solved(case, monkeypatch, tolerance):
    """Return the field after a small change of uptake, and its report."""
    sides, most, half, linear, supply = CASES[case]
    op, sink = operator(sides), ball(most)
    given = np.flip(0.98 * sink) if supply is None else supply * (1.0 + ball(1.0))
    monkeypatch.setattr(steady, "MULTIGRID_NODES", 1)
    before, guess = 0.98 * given, np.full(SHAPE, 0.07)
    start, _ = solve_steady(op, 0.99 * sink, half, guess, linear=linear, supply=before)
    c, report = solve_steady(
        op, sink, half, start, linear=linear, supply=given, tolerance=tolerance
    )
    spent = report.uptake + linear * op.volumes * float(c.sum())
    left = report.inflow + op.volumes * float(given.sum()) - spent
    return c, report, abs(left) / spent


@pytest.mark.parametrize("case", CASES)
def test_less_work_leaves_a_small_error_and_a_balance_that_is_closed(case, monkeypatch):
    exact, long, _ = solved(case, monkeypatch, BALANCE_TOLERANCE)
    c, short, left = solved(case, monkeypatch, ENOUGH)
    assert short.cg < long.cg
    assert c.min() >= 0.0
    assert np.abs(c - exact).max() <= 1e-6 * exact.max()
    assert left <= 1e-9


def test_on_few_nodes_it_changes_nothing():
    op, sink, start = operator([VALUE] * 6), ball(0.02), np.full(SHAPE, 0.07)
    assert start.size < steady.MULTIGRID_NODES
    c, report = solve_steady(op, sink, 0.005, start, tolerance=ENOUGH)
    same, other = solve_steady(op, sink, 0.005, start)
    np.testing.assert_array_equal(c, same)
    assert report == other


OXYGEN = {"boundary": "0.07 mM", "uptake": "20 amol/s", "half_saturation": "5 uM"}


def grown(oxygen, **more):
    """Return a simulation of some steps with a field on a box."""
    box = {"geometry": "box", "margin": "60 um"}
    scene = mc.load_scene("growth").with_changes(
        {"nutrients": {"oxygen": {**OXYGEN, **box, **oxygen}}, "initial.count": 60, **more}
    )
    simulation = mc.Simulation(scene, threads=1)
    for _ in range(3):
        simulation.step()
    return simulation


def test_a_run_keeps_its_account_and_errs_by_a_hundredth_of_its_grid(monkeypatch):
    monkeypatch.setattr(steady, "MULTIGRID_NODES", 1)
    run = grown({})
    assert run.ledger["oxygen"].relative_remainder <= 1e-8
    field, cells = run.field_system.fields["oxygen"], run.cells
    found = field.sample(cells.position, cells.radius)
    capacity, production = run.field_system.demand("oxygen", cells)
    again = mc.nutrient.field.NutrientField("oxygen", field.parameters)
    again.restore(field.field())
    again.solve(cells.position, capacity, production=production, radius=cells.radius)
    error = np.abs(again.sample(cells.position, cells.radius) - found).max()
    assert 0.0 < error <= 0.01 * run.summary()["fields"]["oxygen"]["discretisation_error"]


def test_fields_that_are_solved_within_a_solve_stay_exact():
    def tolerances(**tables):
        scene = mc.load_scene("growth").with_changes({"initial.count": 5, **tables})
        groups = mc.Simulation(scene, threads=1).field_system.groups
        return {group.tolerance for group in groups}

    finite = {"finite_medium": {"volume": "1 mm^3"}}
    on = {"half": "0.02 mM", "effect": 0.5}
    circle = {
        "oxygen": {**OXYGEN, "uptake_on": {"glucose": on}},
        "glucose": {**OXYGEN, "uptake_on": {"oxygen": on}},
    }
    assert tolerances(nutrients={"oxygen": OXYGEN, "glucose": OXYGEN}) == {ENOUGH}
    assert tolerances(nutrients={"oxygen": {**OXYGEN, **finite}}) == {BALANCE_TOLERANCE}
    assert tolerances(nutrients=circle) == {BALANCE_TOLERANCE}


def test_what_the_last_solve_left_in_memory_changes_no_bit(monkeypatch):
    monkeypatch.setattr(steady, "MULTIGRID_NODES", 1)
    op, start = operator([VALUE] * 6), np.full(SHAPE, 0.07)
    sinks = ball(0.02), ball(0.3)
    found = [solve_steady(op, sink, 0.005, start) for sink in (*sinks, sinks[0])]
    fresh = solve_steady(operator([VALUE] * 6), sinks[0], 0.005, start)
    for c, report in (found[0], found[2]):
        np.testing.assert_array_equal(c, fresh[0])
        assert report == fresh[1]


@pytest.mark.parametrize(("more", "stays"), [(-1, True), (0, True), (1, True), (9, False)])
def test_a_grid_of_another_shape_works_in_the_same_memory(more, stays, monkeypatch):
    monkeypatch.setattr(steady, "MULTIGRID_NODES", 1)
    first = operator([VALUE] * 6)
    solve_steady(first, ball(0.3), 0.005, np.full(SHAPE, 0.07))
    shape = tuple(n + more for n in SHAPE)
    sink, start = np.full(shape, 1e-3), np.full(shape, 0.07)
    one, other = (operator([VALUE] * 6, 11.0, shape) for _ in range(2))
    one.room = first.room
    found, apart = (solve_steady(op, sink, 0.005, start) for op in (one, other))
    assert (one.room is first.room) == stays
    np.testing.assert_array_equal(found[0], apart[0])
    assert found[1] == apart[1]
