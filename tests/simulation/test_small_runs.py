"""Calls in a step of few cells, and work that it does not repeat."""

import math
import sys

import numpy as np
import pytest

import multicell as mc
from multicell.biology.growth import growth_factor
from multicell.cells import rows_by_id
from multicell.simulation import Simulation


def simulation(count, **changes):
    scene = mc.load_scene("spheroid").with_changes(
        {"initial.count": count, "initial.stage": "asynchronous", **changes}
    )
    return Simulation(scene, threads=1)


def calls(run):
    """Return how many functions, of Python and of C, are called in a step in the median."""
    found = []
    for _ in range(15):
        number = 0

        def count(frame, event, argument):
            nonlocal number
            number += event in ("call", "c_call")

        sys.setprofile(count)
        try:
            run.step()
        finally:
            sys.setprofile(None)
        found.append(number)
    return np.median(found)


@pytest.mark.parametrize(("count", "most"), [(1, 650), (40, 950)])
def test_a_step_of_few_cells_takes_few_calls(count, most):
    """It was 2,100 for one cell, most of them to describe the sides of the field anew.

    Grid, state and solver are py-pde's objects, which take 60 calls where the grid stays and 230
    where it follows the tissue.
    """
    run = simulation(count)
    for _ in range(3):
        run.step()
    assert calls(run) < most


def test_a_lone_cell_stays_where_it_is_and_is_not_integrated():
    run = simulation(1)
    where = run.cells.position.copy()
    for _ in range(3):
        run.step()
    assert run.mechanics.work.evaluations == 0
    assert math.isnan(run.history_row()["shift_effect"])
    np.testing.assert_array_equal(run.cells.position, where)
    np.testing.assert_array_equal(run.cells.pressure, [0.0])
    # it is what the integration would have found
    run.mechanics.begin(run._motion(run.time, run.time + 600.0, 1.01 * run.cells.radius))
    outcome = run.mover.integrator.integrate(run.mechanics, run.cells.position)
    assert run.mechanics.work.evaluations > 0
    np.testing.assert_array_equal(outcome.position, where)
    np.testing.assert_array_equal(run.mechanics.pressure(run.time, where), [0.0])


def test_a_lone_cell_that_something_acts_on_moves():
    crawling = simulation(1, motility={"force": "0.1 nN", "persistence": "10 min"})
    where = crawling.cells.position.copy()
    crawling.step()
    assert np.linalg.norm(crawling.cells.position - where) > 0.01
    ends = ["-20 um", "20 um"]
    pressed = simulation(1, domain={"x": ends, "y": ends, "z": ends})
    pressed.cells.position[0] = [18.0, 0.0, 0.0]
    pressed.step()
    assert pressed.cells.position[0, 0] < 18.0


def test_growth_factors_follow_cells_and_fields():
    run = simulation(30)
    for _ in range(6):
        run.step()
        expected = growth_factor(run.plan, run.concentrations, run.cells.pressure)
        np.testing.assert_array_equal(run.state.growth, expected)
    run.cells.pressure = np.full(len(run.cells), 0.05)
    assert run.state.growth is None  # it follows from what is there now


def test_cells_that_share_arrays_keep_their_own_when_some_are_replaced():
    cells = simulation(10).cells
    before = {name: column.copy() for name, column in cells.columns()}
    other = cells.shared()
    assert other.young is cells.young
    other.radius = 2.0 * other.radius
    for name, column in cells.columns():
        np.testing.assert_array_equal(column, before[name])
    mask = cells.radius > np.median(cells.radius)
    taken, rows = cells.take(mask), np.flatnonzero(mask)
    for name, column in taken.columns():
        np.testing.assert_array_equal(column, before[name][rows])
        assert column.flags.c_contiguous
        assert not np.shares_memory(column, getattr(cells, name))


@pytest.mark.parametrize("spread", [1, 3, 1000], ids=["all", "some", "few"])
def test_rows_of_identities_are_those_of_a_dictionary(spread):
    """With a table where identities lie close, and by sorting where they are far apart."""
    rng = np.random.default_rng(spread)
    known = 10**9 + rng.choice(3000 * spread, 3000, replace=False)
    ids = 10**9 + rng.integers(-50, 3000 * spread + 50, (700, 2))
    expected = {int(one): row for row, one in enumerate(known)}
    found = rows_by_id(known, ids)
    assert found.tolist() == [[expected.get(int(one), -1) for one in pair] for pair in ids]
    assert rows_by_id(known, np.array([-1, 2**62, *known[:3]])).tolist() == [-1, -1, 0, 1, 2]
    assert rows_by_id(np.array([], dtype=int), ids).tolist() == [[-1, -1]] * 700
