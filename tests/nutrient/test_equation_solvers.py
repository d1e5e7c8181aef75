"""Our solvers of py-pde's kind: their names, clocks, trackers and what they refuse."""

import numpy as np
import pytest
from pde import CallbackTracker, CartesianGrid, DiffusionPDE, FieldCollection, ScalarField

import multicell as mc
from multicell.errors import NutrientFailed

GRID = CartesianGrid([(0.0, 40.0)] * 2, 4)
CLOSED = {"*": {"derivative": 0.0}}


def closed(**terms):
    """Return a closed box in which nothing differs from place to place, empty at first."""
    equation = mc.FieldEquation(GRID, {"drug": mc.Substance(1000.0, CLOSED, **terms)})
    return equation, equation.state({"drug": 0.0})


def test_trackers_may_change_the_state():
    """c' = 1 mM/s is set back to zero each second."""
    equation, state = closed(supply=np.ones(GRID.shape))

    def clear(state, t):
        state.data[...] = 0.0

    tracker = CallbackTracker(clear, np.array([1.0, 2.0]))
    end = equation.solve(state, 2.7, solver="multicell-implicit", tracker=tracker)
    np.testing.assert_allclose(end.data, 0.7, rtol=1e-9)


@pytest.mark.parametrize("solver", ["multicell-implicit", "multicell-march"])
def test_time_runs_from_any_start(solver):
    """A medium that rises from the tenth day on is followed within microseconds."""
    start, rate = 864000.0, 1e6
    rising = mc.Schedule(np.array([start]), np.zeros(1), np.ones(1))
    equation, state = closed(perfusion=rate, medium=rising)
    exact = {"multicell-implicit": {"rtol": 1e-8}, "multicell-march": {"tolerance": 1e-6}}[solver]
    end = equation.solve(state, (start, start + 2.0), solver=solver, tracker=None, **exact)
    np.testing.assert_allclose(end.data, 2.0 - 1.0 / rate, rtol=1e-7)


def test_rates_that_are_not_finite_are_refused_by_name():
    fields = {name: mc.Substance(1000.0, CLOSED) for name in ("calm", "wild")}
    equation = mc.FieldEquation(GRID, fields)
    values = {"calm": 1.0, "wild": np.where(np.arange(16) == 5, np.inf, 1.0)}
    with (
        np.errstate(invalid="ignore"),
        pytest.raises(NutrientFailed, match="rate of wild is not finite at t = 0"),
    ):
        equation.solve(equation.state(values), 1.0, solver="multicell-implicit", tracker=None)


def test_what_cannot_be_solved_is_said():
    equation, state = closed(supply=np.ones(GRID.shape))
    implicit, march = "multicell-implicit", "multicell-march"
    for solver, options, words in (
        (implicit, {"rtol": 0.0}, r"rtol: is 0\.0, must be above zero"),
        (march, {"tolerance": np.nan}, "tolerance: is nan"),
    ):
        with pytest.raises(mc.SceneError, match=words):
            equation.solve(state, 1.0, solver=solver, tracker=None, **options)
    with pytest.raises(NutrientFailed, match="too many steps"):
        equation.solve(state, 1.0, solver=implicit, tracker=None, max_steps=1)
    both = FieldCollection([state, state])
    for solver in (implicit, march, "multicell-steady"):
        with pytest.raises(mc.SceneError, match="equation: is DiffusionPDE, but multicell's"):
            DiffusionPDE().solve(ScalarField(GRID, 1.0), 1.0, solver=solver, tracker=None)
        with pytest.raises(mc.SceneError, match="state: has 2 fields"):
            equation.solve(both, 1.0, solver=solver, tracker=None)
