"""An equation whose evaluations are counted and whose solves end when their time is over."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final, final

from pde.pdes.base import PDEBase

from multicell.cells import FloatArray
from multicell.nutrient.equations.equation import FieldEquation

if TYPE_CHECKING:
    from multicell.nutrient.equations.solving import Inverse

BACKENDS: Final = {
    "kernels": "py-pde's solvers in Python, the rates by our compiled kernels",
    "numpy": "py-pde's solvers in Python, the rates by its own Laplacian",
    "numba": "py-pde's solvers and the rates compiled by numba, without the time for that",
}
"""How the rates are evaluated for py-pde's solvers -> what that means."""


@final
class TooSlow(Exception):  # noqa: N818 - it names what happened
    """A solve that took longer than it may."""


@final
class Watched(PDEBase):  # type: ignore[no-untyped-call]
    """A field equation as solvers see it, which counts what they evaluate.

    Parameters
    ----------
    equation
    backend
        One of :data:`BACKENDS`.
    patience : float, s
        Wall time from :meth:`begin` on after which an evaluation raises :class:`TooSlow`; compiled
        solvers do not look at it.
    """

    def __init__(self, equation: FieldEquation, backend: str, patience: float) -> None:
        super().__init__()
        self.equation, self.kernels, self.patience = equation, backend == "kernels", patience
        self.explicit_time_dependence = equation.explicit_time_dependence
        self.evaluations = 0
        self.begin()

    def begin(self) -> None:
        """Let the clock run from now on."""
        self.deadline = clock.perf_counter() + self.patience

    def look(self) -> None:
        """Count an evaluation.

        Raises
        ------
        TooSlow
        """
        self.evaluations += 1
        if clock.perf_counter() > self.deadline:
            raise TooSlow(f"took longer than {self.patience:g} s")

    def evolution_rate(self, state: Any, t: float = 0.0) -> Any:
        """Return the rates for py-pde's solvers in Python."""
        self.look()
        if not self.kernels:
            return self.equation.evolution_rate(state, t)
        return state.__class__(state.grid, self.equation.rates(state.data, t)[0])

    def make_evolution_rate(  # type: ignore[override]
        self, state: Any, backend: Any
    ) -> Callable[[FloatArray, float], FloatArray]:
        """Return the rates for py-pde's compiled solvers."""
        return self.equation.make_evolution_rate(state, backend)

    def rates(self, data: FloatArray, t: float) -> tuple[FloatArray, FloatArray]:
        """Return the rates and the slopes of the sinks, for our solvers."""
        self.look()
        return self.equation.rates(data, t)

    def shifted_inverse(self, data: FloatArray, t: float) -> Inverse:
        """Return the equation's own inverse."""
        return self.equation.shifted_inverse(data, t)

    def switches(self, begin: float, end: float) -> list[float]:
        """Return when the medium jumps."""
        return self.equation.switches(begin, end)

    def steady_state(self, data: FloatArray, t: float) -> tuple[FloatArray, dict[str, Any]]:
        """Return the state at rest."""
        return self.equation.steady_state(data, t)

    def check(self, state: Any) -> None:
        """Refuse a state that is not one of the equation."""
        self.equation.check(state)
