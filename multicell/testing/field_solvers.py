"""Promises of solvers of fields, which are solvers of py-pde's kind."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from multicell.cells import FloatArray
from multicell.errors import MulticellError
from multicell.testing.promises import BrokenPromise, carry_out_tests, require

if TYPE_CHECKING:
    from collections.abc import Mapping

    from multicell.nutrient.equations.equation import FieldEquation

_LEVEL, _RADIUS, _SHELLS = 0.1, 100.0, 24  # mM outside, µm, nodes of the ball
_DIFFUSION, _DECAY = 500.0, 0.05  # µm²/s, 1/s
_TIMES = (0.5, 4.0)
"""Times at which a filling ball is compared, s; its slowest mode decays in 2 s."""
_BELOW = 1e-12  # of the level, by which rounding may leave a concentration below zero
_RESTED = 200.0  # s, when all modes are gone


class FieldSolverTests:
    """Tests of a solver of fields; a subclass gives its name by a fixture of pytest.

    Each promise of :func:`check_field_solver` is a test of its own::

        class TestCrankNicolson(FieldSolverTests):
            options = {"dt": 0.01}

            @pytest.fixture
            def solver(self):
                return "crank-nicolson"
    """

    options: ClassVar[Mapping[str, Any]] = {}
    """Arguments of the solver."""
    steady: ClassVar[bool] = False
    """Whether it finds the state at rest alone, whatever the time."""
    accuracy: ClassVar[float] = 5e-3
    """How far concentrations may be off, over the level outside."""

    def _solve(self, solver: str, equation: FieldEquation, start: float, time: float) -> FloatArray:
        """Return the concentrations after a time; an exception is a promise that is not kept."""
        state: Any = equation.state(dict.fromkeys(equation.names, start))
        before = np.array(state.data)
        try:
            end: Any = equation.solve(state, time, solver=solver, tracker=None, **self.options)
        except (MulticellError, ArithmeticError, ValueError, RuntimeError) as error:
            raise BrokenPromise(f"it raises {type(error).__name__}: {error}") from error
        require(np.array_equal(state.data, before), "it changes the state that it was given")
        found = np.array(end.data)
        require(np.isfinite(found).all(), "it returns something that is no number")
        return found

    def _compare(self, found: FloatArray, wanted: FloatArray, where: str) -> None:
        """See that concentrations are near enough to others."""
        off = float(np.abs(found - wanted).max()) / _LEVEL
        problem = f"{where} it is off by {off:.2g} of the level, more than {self.accuracy:g}"
        require(off <= self.accuracy, problem)

    def test_a_filling_ball_is_that_of_a_matrix_exponential(self, solver: str) -> None:
        """Diffusion with decay into an empty ball, in time and at rest."""
        from scipy.linalg import expm, solve

        equation, nothing = _ball(), np.zeros(_SHELLS)
        brought = _rates(equation, nothing)
        matrix = np.stack([_rates(equation, unit) - brought for unit in np.eye(_SHELLS)], axis=1)
        rest = -solve(matrix, brought)
        for time in () if self.steady else _TIMES:
            exact = rest - expm(matrix * time) @ rest
            found = self._solve(solver, equation, 0.0, time)
            self._compare(found, exact, f"after {time:g} s in a ball that fills")
        self._compare(
            self._solve(solver, equation, 0.0, _RESTED), rest, "at rest in a ball with decay"
        )

    def test_saturating_uptake_is_that_of_scipy(self, solver: str) -> None:
        """Cells whose uptake saturates, by SciPy's LSODA on the rates of the equation."""
        from scipy.integrate import solve_ivp

        equation, start = _ball(uptake=0.01), np.full(_SHELLS, _LEVEL)
        time = _RESTED if self.steady else _TIMES[1]

        def slopes(_: float, c: FloatArray) -> FloatArray:
            return _rates(equation, c)

        exact = solve_ivp(slopes, (0.0, time), start, "LSODA", rtol=1e-9, atol=1e-12)
        self._compare(
            self._solve(solver, equation, _LEVEL, time),
            exact.y[:, -1],
            "with uptake that saturates",
        )

    def test_nothing_is_negative(self, solver: str) -> None:
        """However hard cells take up, no concentration is below zero."""
        hard = _ball(uptake=50.0, half=1e-3)
        least = float(self._solve(solver, hard, _LEVEL, _TIMES[0]).min())
        problem = f"where cells take up hard it has a concentration of {least:.2g} mM"
        require(least >= -_BELOW * _LEVEL, problem)

    def test_substances_do_not_mix(self, solver: str) -> None:
        """A substance has the concentrations that it has without another."""
        time = _RESTED if self.steady else _TIMES[1]
        alone = self._solve(solver, _ball(uptake=0.01), 0.0, time)
        both = self._solve(solver, _ball(uptake=0.01, others=1), 0.0, time)
        self._compare(both[0], alone, "beside another substance")

    def test_it_gives_the_same_bits_again(self, solver: str) -> None:
        """The same bits come out again, and the state that was given is left as it was."""
        first, again = (self._solve(solver, _ball(uptake=0.01), 0.0, _TIMES[0]) for _ in range(2))
        require(np.array_equal(first, again), "it does not give the same bits again")


def check_field_solver(
    solver: str, *, steady: bool = False, accuracy: float = 5e-3, **options: Any
) -> None:
    """Check a solver; raise ``AssertionError`` with every requirement that it violates.

    In a ball of shells, of which the rates of :class:`multicell.FieldEquation` are known:

    - a substance that diffuses and decays fills the empty ball as a matrix exponential of its rates
      says, and comes to rest where they vanish;
    - with cells whose uptake saturates concentrations are those of SciPy's LSODA;
    - however hard cells take up, no concentration is below zero;
    - a substance has the concentrations that it has without another;
    - the same bits come out again, and the state that was given is left as it was.

    Parameters
    ----------
    solver
        Name by which py-pde knows it, as scenes and ``FieldEquation.solve`` take it.
    steady
        Whether it finds the state at rest alone, whatever the time.
    accuracy
        How far concentrations may be off, over the level outside.
    **options
        Arguments of the solver.
    """
    given = {"options": options, "steady": steady, "accuracy": accuracy}
    carry_out_tests(type("Given", (FieldSolverTests,), given)(), solver, solver)


def _ball(uptake: float = 0.0, half: float = 0.02, others: int = 0) -> FieldEquation:
    """Return the equation of a ball in which cells take up everywhere, uptake in mM/s."""
    from pde.grids.spherical import SphericalSymGrid

    from multicell.nutrient.equations.equation import FieldEquation
    from multicell.nutrient.equations.substance import Substance

    grid = SphericalSymGrid(_RADIUS, _SHELLS)
    place = np.zeros((_SHELLS, 3))
    place[:, 0] = grid.axes_coords[0]
    capacity = uptake * np.asarray(grid.cell_volumes)
    first = Substance(_DIFFUSION, _LEVEL, half, decay=_DECAY, capacity=capacity)
    slow = Substance(0.5 * _DIFFUSION, _LEVEL, half, decay=0.0)
    more = {f"other_{k}": slow for k in range(others)}
    return FieldEquation(grid, {"a": first, **more}, place)


def _rates(equation: FieldEquation, c: FloatArray) -> FloatArray:
    state = equation.state({"a": c})
    return np.array(equation.evolution_rate(state).data)
