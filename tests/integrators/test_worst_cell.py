"""Methods that are called safe lose no cell by more than what a shift of its start does."""

import functools
import importlib.util
from pathlib import Path

import pytest

from multicell.integrators.registry import METHODS

FILE = Path(__file__).parents[1] / "benchmarks" / "worst_cell.py"
spec = importlib.util.spec_from_file_location("worst_cell", FILE)
worst_cell = importlib.util.module_from_spec(spec)
spec.loader.exec_module(worst_cell)

VISCOSITY = 0.05
STEPS = (12, 15, 19)
"""A contact forms late in the last one: CVODE missed it with its whole share of the tolerance."""


@functools.cache
def truth():
    return worst_cell.Truth(worst_cell.recorded("growing", VISCOSITY, max(STEPS)))


@pytest.mark.slow
def test_the_right_hand_side_is_that_of_the_package():
    for case in worst_cell.CASES:
        problem = worst_cell.recorded(case, 5.0, 2)
        system = problem.system()
        system.begin(problem.steps[2].motion)
        velocity = worst_cell.Velocity(problem.steps[2].motion, problem.template)
        start, out = problem.starts[2], problem.starts[2].copy()
        time = problem.steps[2].motion.end
        system.velocity(time, start, out)
        # with friction the velocities solve equations, to a millionth of the fastest
        expected = velocity(time, start.ravel())
        assert out.ravel() == pytest.approx(
            expected, rel=1e-9, abs=(1e-6 if case == "friction" else 1e-9) * abs(expected).max()
        )


@pytest.mark.slow
@pytest.mark.parametrize("method", worst_cell.SAFE)
def test_the_worst_cell_is_no_further_off_than_thrice_the_conditioning(method):
    rows = worst_cell.measured("growing", VISCOSITY, truth(), STEPS, method)
    assert len(rows) == len(STEPS)
    for row in rows:
        assert row["atol_um"] == METHODS[method].atol
        assert row["error_um"] <= worst_cell.LIMIT * row["shift_um"], row
