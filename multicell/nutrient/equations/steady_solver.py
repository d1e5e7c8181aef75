"""``multicell-steady``: the state in which an equation of py-pde's rests."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, final

import numpy as np
from pde.solvers.base import SolverBase

from multicell.cells import FloatArray
from multicell.errors import NutrientFailed, SceneError
from multicell.nutrient.equations.solving import (
    Diffusivity,
    Inverse,
    Rate,
    inverse_of,
    rate_of,
    refuse_unsuitable,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from pde.pdes.base import PDEBase

_FIRST = 0.1  # relative change that the first step in pseudo-time may make
_FASTER, _SLOWER = 10.0, 0.1
_FORCING = 0.01
_RESTART, _CYCLES = 40, 5
_DIFFERENCE = 1e-7  # relative, of difference quotients


@final
class SteadyFieldSolver(SolverBase):  # type: ignore[no-untyped-call]
    """Steady states: of field equations by Newton's method, of others by pseudo-time.

    ``equation.solve(state, t_range, solver="multicell-steady")`` returns the state that rests with
    what holds at the end of ``t_range``; trackers see it at all times after the start.

    A field equation is solved as runs do (:mod:`multicell.nutrient.steady`). For any other
    equation that says its diffusivities Newton's method with GMRES is continued in pseudo-time
    (Kelley & Keyes 1998): implicit Euler steps that lengthen as the rates fall. From where they
    start these follow the true course, and do not end in states that are unstable.

    Parameters
    ----------
    pde
        The equation.
    backend
        py-pde's, for the rates.
    tolerance
        Largest last correction over the state's largest value (of other equations than ours).
    diffusivity, bc
        As for :class:`~multicell.nutrient.equations.implicit_solver.ImplicitFieldSolver`.
    max_steps
        Most steps in pseudo-time.
    """

    name = "multicell-steady"

    def __init__(
        self,
        pde: PDEBase,
        *,
        backend: Any = "auto",
        tolerance: float = 1e-9,
        diffusivity: Diffusivity = None,
        bc: Any = None,
        max_steps: int = 300,
    ) -> None:
        super().__init__(pde, backend=backend)
        if not (np.isfinite(tolerance) and tolerance > 0.0):
            raise SceneError("tolerance", f"is {tolerance!r}, must be above zero")
        self.tolerance, self.max_steps = tolerance, max_steps
        self.diffusivity, self.bc = diffusivity, bc

    def make_stepper(
        self, state: Any, dt: float | None = None
    ) -> Callable[[Any, float, float], float]:
        """Return a function that brings a state to rest; ``dt`` is not used.

        Raises
        ------
        SceneError
            For an equation that neither has a steady solver nor says its diffusivities.
        """
        refuse_unsuitable(self.pde, state)
        self.info.update(dt=None, steps=0, stochastic=False)
        solve = self._own() if hasattr(self.pde, "steady_state") else self._continued(state)

        def stepper(state: Any, t_start: float, t_end: float) -> float:
            state.data[...] = solve(np.array(state.data), float(t_end))
            return t_end

        return stepper

    def _own(self) -> Callable[[FloatArray, float], FloatArray]:
        """Return the equation's own solver."""
        pde: Any = self.pde

        def solve(data: FloatArray, t: float) -> FloatArray:
            found, reports = pde.steady_state(data, t)
            self.info["reports"] = reports
            self.info["steps"] += sum(report.newton for report in reports.values())
            return np.asarray(found)

        return solve

    def _continued(self, state: Any) -> Callable[[FloatArray, float], FloatArray]:
        """Return Newton's method in pseudo-time."""
        inverse = inverse_of(self.pde, state, self.diffusivity, self.bc)
        if inverse is None:
            raise SceneError(
                "diffusivity",
                f"is not known for {type(self.pde).__name__}, and without it Newton's linear "
                "systems cannot be solved",
                "Pass diffusivity=... (zero for a field that does not diffuse), on a Cartesian "
                "grid or a ball; or let 'multicell-implicit' run long enough.",
            )
        rate = rate_of(self, state)
        lengths = [high - low for low, high in state.grid.axes_bounds]
        slowest = 1.0 / max(lengths) ** 2

        def solve(data: FloatArray, t: float) -> FloatArray:
            return self._newton(rate, inverse(data, t), data, t, slowest)

        return solve

    def _newton(
        self, rate: Rate, inverse: Inverse, u: FloatArray, t: float, least: float
    ) -> FloatArray:
        """Return the steady state from a start ``u``; ``least`` keeps shifts above zero."""
        found = rate(u, t)
        size = float(np.abs(found).max())
        step = _FIRST * (float(np.abs(u).max()) or 1.0) / size if size else np.inf
        for _ in range(self.max_steps):
            if size == 0.0:
                return u
            correction = _solve(rate, inverse, u, t, found, step, least)
            trial = u + correction
            there, now = self._tried(rate, trial, t)
            # while time is followed rates may rise, as fronts form
            if not now <= 2.0 * size:
                step *= _SLOWER
                continue
            largest, most = float(np.abs(correction).max()), float(np.abs(trial).max())
            settled = largest <= 0.1 * size * step
            if settled and largest <= self.tolerance * most:
                return trial
            step *= float(np.clip(size / now, 1.5, _FASTER)) if now > 0.0 else _FASTER
            u, found, size = trial, there, now
            self.info["steps"] += 1
        raise NutrientFailed(
            f"no steady state was found in {self.max_steps} steps: the largest rate still is "
            f"{size:.3g}",
            "Perhaps there is none, or it is not fixed (a closed box without a reaction)",
        )

    def _tried(self, rate: Rate, u: FloatArray, t: float) -> tuple[FloatArray, float]:
        """Return the rates at a trial state and the largest; infinite where they are not finite."""
        try:
            found = rate(u, t)
        except NutrientFailed:
            return u, np.inf
        return found, float(np.abs(found).max())


def _solve(
    rate: Rate, inverse: Inverse, u: FloatArray, t: float, found: FloatArray, step: float,
    least: float,
) -> FloatArray:  # fmt: skip
    """Return x of (1/step - J) x = rates, by GMRES with difference quotients."""
    from scipy.sparse.linalg import LinearOperator, gmres

    shift, n, scale = 1.0 / step, u.size, float(np.abs(u).max()) or 1.0

    def product(v: FloatArray) -> FloatArray:
        most = float(np.abs(v).max())
        if most == 0.0:
            return np.zeros(n)
        share = _DIFFERENCE * scale / most
        v = v.reshape(u.shape)
        return (shift * v - (rate(u + share * v, t) - found) / share).ravel()

    def about(r: FloatArray) -> FloatArray:
        return inverse(r.reshape(u.shape), max(shift, least)).ravel()

    matrix, preconditioner = (
        LinearOperator((n, n), matvec=f, dtype=float) for f in (product, about)
    )
    x, _ = gmres(
        matrix, found.ravel(), rtol=_FORCING, restart=_RESTART, maxiter=_CYCLES, M=preconditioner
    )
    return np.asarray(x).reshape(u.shape)
