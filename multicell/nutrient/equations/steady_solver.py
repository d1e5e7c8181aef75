"""``multicell-steady``: the state in which an equation of fields rests."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, final

from pde.solvers.base import SolverBase

from multicell.nutrient.equations.solving import suitable

if TYPE_CHECKING:
    from collections.abc import Callable


@final
class SteadyFieldSolver(SolverBase):  # type: ignore[no-untyped-call]
    """Steady states by Newton's method, as runs have them (:mod:`multicell.nutrient.steady`).

    ``info["reports"]`` says what the solves took, and ``info["rates"]`` what happens to each
    substance, with the columns of :data:`multicell.nutrient.balance.COLUMNS`.

    ``equation.solve(state, t_range, solver="multicell-steady")`` returns the state that rests with
    what holds at the end of ``t_range``; trackers see it at all times after the start.

    Parameters
    ----------
    pde
        A field equation.
    backend
        Not used: the steps are compiled kernels.
    """

    name = "multicell-steady"

    def make_stepper(
        self, state: Any, dt: float | None = None
    ) -> Callable[[Any, float, float], float]:
        """Return a function that brings a state to rest; ``dt`` is not used.

        Raises
        ------
        SceneError
            For an equation that has no steady solver, and a state of another one.
        """
        equation = suitable(self.pde, state, "steady_state")
        self.info.update(dt=None, steps=0, stochastic=False)

        def stepper(state: Any, t_start: float, t_end: float) -> float:
            found, reports = equation.steady_state(state.data, float(t_end))
            state.data[...] = found
            self.info["reports"] = reports
            self.info["rates"] = equation.exchanges(found, float(t_end), reports)
            self.info["steps"] += sum(report.newton for report in reports.values())
            return t_end

        return stepper
