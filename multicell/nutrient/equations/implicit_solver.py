"""``multicell-implicit``: a transient solver for equations of fields, by SUNDIALS CVODE."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Any, final

import numpy as np
from pde.solvers.base import SolverBase

from multicell.cells import FloatArray
from multicell.errors import NutrientFailed, SceneError
from multicell.nutrient.equations.solving import suitable
from multicell.scene.nutrient import MOST

if TYPE_CHECKING:
    from collections.abc import Callable

    from pde.pdes.base import PDEBase

_SMALL = 1e-3
"""Part of a field's largest value below which errors are held absolutely."""


@final
class ImplicitFieldSolver(SolverBase):  # type: ignore[no-untyped-call]
    """BDF of orders 1 to 5 with error control, Newton's method and preconditioned GMRES.

    ``equation.solve(state, t_range, solver="multicell-implicit")``. The preconditioner is a fast
    inverse of diffusion. BDF keeps no bounds: a field may fall below zero by about its tolerance.

    Parameters
    ----------
    pde
        A field equation.
    backend
        Not used: the rates are compiled kernels.
    rtol
        Relative tolerance of a step's error, by the root of its mean square over all nodes.
    atol
        Absolute tolerance; absent: ``rtol`` times a thousandth of each field's largest value.
    max_steps
        Most steps between two calls of trackers.
    """

    name = "multicell-implicit"

    def __init__(
        self,
        pde: PDEBase,
        *,
        backend: Any = "auto",
        rtol: float = 1e-5,
        atol: float | None = None,
        max_steps: int = 100_000,
    ) -> None:
        super().__init__(pde, backend=backend)
        for name, value in (("rtol", rtol), ("atol", atol)):
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise SceneError(name, f"is {value!r}, must be above zero")
        self.rtol, self.atol, self.max_steps = rtol, atol, max_steps

    def make_stepper(
        self, state: Any, dt: float | None = None
    ) -> Callable[[Any, float, float], float]:
        """Return a function that brings a state from one time to another.

        ``dt`` is the first step; absent: chosen by SUNDIALS.

        Raises
        ------
        SceneError
            For an equation or a state that it cannot solve.
        """
        equation = suitable(self.pde, state, "shifted_inverse")
        self.info.update(dt=dt, steps=0, evaluations=0, stochastic=False)
        march = _March(self, equation, dt)

        def stepper(state: Any, t_start: float, t_end: float) -> float:
            state.data[...] = march.advance(state.data, float(t_start), float(t_end))
            return t_end

        return stepper


@final
class _March:
    """CVODE under way; a new one is started where the state is not the one it left behind.

    Its clock counts from its start: short steps would be lost on a clock that shows days.
    """

    def __init__(self, solver: ImplicitFieldSolver, equation: Any, first: float | None) -> None:
        self.owner, self.info = solver, solver.info
        self.equation, self.first = equation, first
        self.begin = self.reached = math.nan
        self.y = np.empty(0)

    def advance(self, data: FloatArray, begin: float, end: float) -> FloatArray:
        """Return the data at ``end``."""
        self.shape = data.shape
        # when the rates jump, the beginning included
        jumps = self.equation.switches(float(np.nextafter(begin, -np.inf)), end)
        if begin != self.reached or begin in jumps or not np.array_equal(self.y, data.ravel()):
            self._start(np.array(data, dtype=float).ravel(), begin)
        limit = self.info["steps"] + self.owner.max_steps
        inner = [t for t in jumps if t > begin]
        for start, stop in itertools.pairwise([begin, *inner, end]):
            # what holds from a switch on holds for the next piece only
            self.last = float(np.nextafter(stop, -np.inf))
            if start > begin:
                self._start(self.y, start)
            while self.reached < stop:
                self._step(stop, limit)
                self._refuse_growth()
        return self.y.reshape(self.shape)

    def _refuse_growth(self) -> None:
        """Refuse values beyond anything where reactions make them grow on: steps would only end."""
        if not float(self.y.max(initial=0.0)) > MOST:
            return
        words = self.equation.growing(self.y.reshape(self.shape))
        if words:
            hint = "Look at the rates of the reactions that make it, or let them saturate."
            raise NutrientFailed(f"at t = {self.reached:.6g} {words}", hint)

    def _start(self, y: FloatArray, begin: float) -> None:
        from sksundae.cvode import CVODE, CVODEPrecond

        self.begin = self.reached = begin
        self.y = y
        self.near: Any = None
        self.cvode = CVODE(
            self.velocity, method="BDF", linsolver="gmres", krylov_dim=10, rtol=self.owner.rtol,
            atol=self._absolute(y), first_step=self.first or 0.0,
            precond=CVODEPrecond(self.setup, self.precondition, side="right"),
        )  # fmt: skip
        self.cvode.init_step(0.0, y)

    def _absolute(self, y: FloatArray) -> FloatArray:
        """Return the absolute tolerance of each value."""
        if self.owner.atol is not None:
            return np.full(y.size, self.owner.atol)
        parts = np.abs(y).reshape(len(self.equation.names), -1)
        largest = parts.max(axis=1)
        largest[largest == 0.0] = largest.max() or 1.0
        return np.repeat(self.owner.rtol * _SMALL * largest, parts.shape[1])

    def _step(self, stop: float, limit: int) -> None:
        """Take one step of CVODE's, up to ``stop`` at most."""
        left = stop - self.begin
        result = self.cvode.step(left, method="onestep", tstop=left)
        if not result.success or self.info["steps"] >= limit:
            why = "too many steps" if result.success else f"SUNDIALS: {result.message}"
            raise NutrientFailed(
                f"multicell-implicit stopped at t = {self.reached:.6g}: {why}",
                "Raise rtol or max_steps, or look for rates that jump",
            )
        self.info["steps"] += 1
        self.reached = stop if result.t >= left else self.begin + float(result.t)
        self.y = np.array(result.y)

    def velocity(self, t: float, y: FloatArray, yp: FloatArray) -> None:
        """Write the rates at a time of the solver's clock."""
        self.info["evaluations"] += 1
        now = min(self.begin + t, self.last)
        data = np.array(y).reshape(self.shape)
        found, _ = self.equation.rates(data, now)
        if not np.isfinite(found).all():
            raise self._runaway(data, found, now)
        yp[:] = found.ravel()

    def _runaway(self, data: FloatArray, found: FloatArray, t: float) -> NutrientFailed:
        """Return the error of rates that are not finite, which names the field."""
        names = self.equation.names
        fields, rates = (x.reshape(len(names), -1) for x in (data, found))
        bad = int(np.argmax(~np.isfinite(rates).all(axis=1)))
        problem = f"the rate of {names[bad]} is not finite at t = {t:.6g}"
        largest = f"where its largest value is {np.abs(fields[bad]).max():.3g}"
        hint = "Look for a reaction that makes it grow without bound"
        return NutrientFailed(f"{problem}, {largest}", hint)

    def setup(
        self, t: float, y: FloatArray, yp: FloatArray, jok: int, jnew: list[int], gamma: float
    ) -> None:
        """Make the preconditioner anew where SUNDIALS asks for it."""
        jnew[0] = int(not jok or self.near is None)
        if jnew[0]:
            now = min(self.begin + t, self.last)
            self.near = self.equation.shifted_inverse(np.array(y).reshape(self.shape), now)

    def precondition(
        self, t: float, y: FloatArray, yp: FloatArray, r: FloatArray, z: FloatArray,
        gamma: float, delta: float, lr: int,
    ) -> None:  # fmt: skip
        """Solve about (I - γJ) z = r."""
        z[:] = self.near(np.array(r).reshape(self.shape) / gamma, 1.0 / gamma).ravel()
