"""Solvers of fields keep their promises: ours, and one of py-pde's; each broken one is named."""

import numpy as np
import pytest
from pde.solvers.base import SolverBase

import multicell.nutrient.equations.solvers as solvers
from multicell.testing import FieldSolverTests, check_field_solver

OURS = {kind.name for kind in vars(solvers).values()
        if isinstance(kind, type) and kind.__module__ == solvers.__name__
        and issubclass(kind, SolverBase)}  # fmt: skip


class TestSteady(FieldSolverTests):
    steady = True
    accuracy = 1e-6

    @pytest.fixture
    def solver(self):
        return "multicell-steady"


class TestMarch(FieldSolverTests):
    @pytest.fixture
    def solver(self):
        return "multicell-march"


class TestImplicit(FieldSolverTests):
    options = {"rtol": 1e-6}  # noqa: RUF012 - as users write it
    accuracy = 1e-4

    @pytest.fixture
    def solver(self):
        return "multicell-implicit"


def test_all_solvers_of_ours_are_tested():
    assert {"multicell-steady", "multicell-march", "multicell-implicit"} == OURS


class Broken(SolverBase):
    """Relaxes to the steady state at once or in time, with a fault by its option."""

    name = "of-a-test"

    def __init__(self, pde, *, backend="auto", fault=""):
        super().__init__(pde, backend=backend)
        self.fault = fault

    def make_stepper(self, state, dt=None):
        self.info.update(dt=None, steps=0, stochastic=False)

        def stepper(state, t_start, t_end):
            found, _ = self.pde.steady_state(state.data, float(t_end))
            if self.fault == "negative":
                found = found - 1e-3 * (found < 1e-3)
            if self.fault == "noise":
                found = found * (1.0 + 1e-12 * np.random.default_rng().random())
            if self.fault == "mixed" and found.ndim == 2:
                found = found[::-1]
            if self.fault == "nan":
                found = np.nan * found
            if self.fault == "raises":
                raise RuntimeError("no way")
            state.data[...] = found
            return t_end

        return stepper


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("negative", "has a concentration of -"),
        ("noise", "does not give the same bits again"),
        ("mixed", "beside another substance it is off"),
        ("nan", "returns something that is no number"),
        ("raises", "raises RuntimeError: no way"),
    ],
)
def test_a_broken_promise_is_named(fault, words):
    check_field_solver("of-a-test", steady=True)
    with pytest.raises(AssertionError, match=words):
        check_field_solver("of-a-test", steady=True, fault=fault)


def test_a_solver_that_is_at_rest_at_once_does_not_follow_the_time():
    with pytest.raises(AssertionError, match=r"after 0.5 s in a ball that fills it is off"):
        check_field_solver("of-a-test")
