"""Solvers of py-pde's kind for equations of fields.

py-pde's own implicit solvers are fixed-point iterations, which fail beyond about the largest step
of an explicit one. Ours know more of an equation than its rates, which it offers by methods as
those of :class:`multicell.FieldEquation`.
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np
from pde.solvers.base import SolverBase

from multicell.cells import FloatArray
from multicell.errors import NutrientFailed, SceneError
from multicell.host.interrupts import UNCUT
from multicell.nutrient.balance import BALANCE_COLUMNS
from multicell.nutrient.steady import StepRefused

if TYPE_CHECKING:
    from collections.abc import Callable

    from pde.pdes.base import PDEBase

_SMALL = 1e-3
"""Part of a field's largest value below which errors are held absolutely."""

_MOST_STEPS: Final = 20_000  # in one coupling step; then the solver is not getting on
_SHORTEST: Final = 1e-9  # of the interval
_FINEST: Final = 2.0**-16  # part of an interval that is looked at
_ROUNDING: Final = 1e-9  # below zero, of the largest value: more is no rounding of a transform
_REFUSED: Final = 0.25  # of a step that was not solved, the next one tried


def suitable(pde: PDEBase, state: Any, method: str) -> Any:
    """Return an equation that has the method by which a solver solves it."""
    if not hasattr(pde, method):
        problem = f"is {type(pde).__name__}, but multicell's solvers solve equations of fields only"
        raise SceneError("equation", problem, "Take one of py-pde's own solvers.")
    check = getattr(pde, "check", None)
    if check is not None:
        check(state)
    return pde


@final
class SteadyFieldSolver(SolverBase):  # type: ignore[no-untyped-call]
    """Steady states by Newton's method, as runs have them (:mod:`multicell.nutrient.steady`).

    ``info["reports"]`` says what the solves took, and ``info["rates"]`` what happens to each
    substance, with the columns of :data:`multicell.nutrient.balance.BALANCE_COLUMNS`.

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


@final
class MarchFieldSolver(SolverBase):  # type: ignore[no-untyped-call]
    """Linear fields exactly, others by steps of backward Euler under error control: as in runs.

    A field of a box that nothing takes up or reacts with, and that diffuses alike everywhere, is
    followed without an error in time (:mod:`multicell.nutrient.equations.linear`); what rounding
    leaves below zero is set to zero, and ``info["lifted"]`` is what that added to each substance.

    The steps are never below zero. Their equations are those of the steady state with 1/dt added to
    the rates and c/dt to the supply: M-matrices again, so that no concentration is negative, and
    the steady state is exactly where the march comes to rest. Each step is done once in full and
    once in halves; their distance is the estimate of the error, and 2 (halves) - (full) is of
    second order. That is taken where it is nowhere negative, else the halves are.

    ``info["amounts"]`` holds what happened to each substance, with the columns of
    :data:`multicell.nutrient.balance.BALANCE_COLUMNS`.

    - ``pde``: a field equation
    - ``backend``: not used: the steps are compiled kernels
    - ``tolerance``: largest error of a step over the concentration of each field
    - ``scales``, (m,) mM: concentrations that errors are compared with at least; absent: those of
      the media

    - ``watch``: called with the time and the data at the beginning and after each step; None: not
    """

    name = "multicell-march"

    def __init__(
        self,
        pde: PDEBase,
        *,
        backend: Any = "auto",
        tolerance: float = 1e-3,
        scales: FloatArray | None = None,
    ) -> None:
        super().__init__(pde, backend=backend)
        if not (np.isfinite(tolerance) and tolerance > 0.0):
            raise SceneError("tolerance", f"is {tolerance!r}, must be above zero")
        self.tolerance, self.scales = tolerance, scales
        self.watch: Callable[[float, FloatArray], None] | None = None

    def make_stepper(
        self, state: Any, dt: float | None = None
    ) -> Callable[[Any, float, float], float]:
        """Return a function that brings a state from one time to another.

        ``dt`` is the first step; absent: a tenth of the time between two jumps of the medium.
        """
        pde = suitable(self.pde, state, "implicit_step")
        self.info.update(
            dt=dt,
            stochastic=False,
            steps=0,
            rejections=0,
            amounts=np.zeros((len(pde.names), len(BALANCE_COLUMNS))),
            lifted=np.zeros(len(pde.names)),
        )

        def stepper(state: Any, t_start: float, t_end: float) -> float:
            c, ends = np.array(state.data, dtype=float), (float(t_start), float(t_end))
            if self.watch is not None:
                self.watch(ends[0], c)
            for begin, end in itertools.pairwise([ends[0], *pde.switches(*ends), ends[1]]):
                found = self._follow(pde, c, begin, end)
                c = self._march(pde, c, begin, end) if found is None else found
            state.data[...] = c
            return t_end

        return stepper

    def _scale(self, pde: Any, c: FloatArray, begin: float, end: float) -> FloatArray:
        """Return the concentrations that errors are compared with at least, (m,) mM."""
        scale = np.asarray(pde.scales(c, begin, end))
        return scale if self.scales is None else np.maximum(scale, self.scales)

    def _follow(self, pde: Any, c: FloatArray, begin: float, end: float) -> FloatArray | None:
        """Bring the data from one time to another exactly; None where that is not possible.

        Sides that take more than there is (a negative slope) empty nodes: that is left to steps,
        which say so.
        """
        last = float(np.nextafter(end, -np.inf))
        courses = getattr(pde, "linear_courses", lambda *_: None)(c, begin, last, end)
        if courses is None:
            return None
        found, rows = zip(*(course.end() for course in courses), strict=True)
        raw = np.reshape(found, c.shape)
        largest = max(raw.max(initial=0.0), c.max(initial=0.0))
        if not raw.min(initial=0.0) >= -_ROUNDING * largest:  # nor where something is no number
            return None
        if self.watch is not None:
            self._show(courses, (c, raw), begin, self._scale(pde, c, begin, end))
            self.watch(end, np.maximum(raw, 0.0))
        gained = np.maximum(raw, 0.0)
        self.info["amounts"] = self.info["amounts"] + np.array(rows)
        added = (gained - raw).reshape(len(rows), -1).sum(axis=1)
        self.info["lifted"] = self.info["lifted"] + added * pde.layout.volumes
        self.info["steps"] += 1
        return gained

    def _show(
        self, courses: list[Any], ends: tuple[FloatArray, FloatArray], begin: float, scale: Any
    ) -> None:
        """Let the watch see times between which the data change by straight lines, nearly."""

        def between(low: float, first: FloatArray, high: float, second: FloatArray) -> None:
            share = 0.5 * (low + high)
            middle = np.reshape([course.at(share) for course in courses], first.shape)
            bent = _distance(middle, 0.5 * (first + second), scale) > self.tolerance
            deeper = bent and high - low > _FINEST
            if deeper:
                between(low, first, share, middle)
            assert self.watch is not None
            self.watch(begin + share * courses[0].length, np.maximum(middle, 0.0))
            if deeper:
                between(share, middle, high, second)

        between(0.0, ends[0], 1.0, ends[1])

    def _march(self, pde: Any, c: FloatArray, begin: float, end: float) -> FloatArray:
        """Bring the data from one time to another, between which no medium jumps."""
        last = float(np.nextafter(end, -np.inf))  # at the moment of a jump the old medium holds
        scale = self._scale(pde, c, begin, end)

        def implicit(c: FloatArray, dt: float, time: float) -> Any:
            return pde.implicit_step(c, dt, min(time, last))

        length, info = end - begin, self.info
        elapsed, dt = 0.0, 0.1 * length if info["dt"] is None else info["dt"]
        while elapsed < length:
            dt = min(dt, length - elapsed)
            if length - elapsed - dt < 1e-9 * length:
                dt = length - elapsed
            if info["steps"] > _MOST_STEPS or dt < _SHORTEST * length:
                raise NutrientFailed(
                    f"{' and '.join(pde.names)} would need steps of {dt:.3g} s at t = "
                    f"{begin + elapsed:.6g} s, too many to go on",
                    "Raise time_tolerance, let the field be steady, or look for a reaction that "
                    "makes it grow without bound",
                )
            t = begin + elapsed
            try:
                full, once = implicit(c, dt, t + dt)
                middle, first = implicit(c, 0.5 * dt, t + 0.5 * dt)
                halves, second = implicit(middle, 0.5 * dt, t + dt)
            except StepRefused:
                info["rejections"] += 1
                dt *= _REFUSED
                continue
            error = _distance(halves, full, scale)
            factor = min(4.0, 0.9 * (self.tolerance / max(error, 1e-300)) ** 0.5)
            if error > self.tolerance:
                info["rejections"] += 1
                dt *= max(0.1, factor)
                continue
            amounts = first + second
            better = 2.0 * halves - full
            if better.min(initial=0.0) >= 0.0:
                c, amounts = better, amounts + amounts - once
            else:
                c = halves
            info["amounts"] = info["amounts"] + amounts
            info["steps"] += 1
            elapsed = length if dt == length - elapsed else elapsed + dt
            dt *= max(0.3, factor)
            if self.watch is not None:
                self.watch(begin + elapsed if elapsed < length else end, c)
        return c


def _distance(halves: FloatArray, full: FloatArray, scale: FloatArray) -> float:
    """Return the largest distance of two states over what it is compared with in each field."""
    apart, most = (
        np.abs(x).reshape(len(scale), -1).max(axis=1, initial=0.0) for x in (halves - full, halves)
    )
    largest = np.maximum(scale, most)
    return float((apart / np.where(largest > 0.0, largest, 1.0)).max())


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
            if value is not None and not (np.isfinite(value) and value > 0.0):
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
        """Return the data at ``end``; signals come between two evaluations only."""
        with UNCUT:
            return self._advance(data, begin, end)

    def _advance(self, data: FloatArray, begin: float, end: float) -> FloatArray:
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
        return self.y.reshape(self.shape)

    def _start(self, y: FloatArray, begin: float) -> None:
        from sksundae.cvode import CVODE, CVODEPrecond

        self.begin = self.reached = begin
        self.y = y
        self.near: Any = None
        absolute: Any = self.owner.atol
        if absolute is None:
            parts = np.abs(y).reshape(len(self.equation.names), -1)
            largest = parts.max(axis=1)
            largest[largest == 0.0] = largest.max() or 1.0
            absolute = np.repeat(self.owner.rtol * _SMALL * largest, parts.shape[1])
        self.cvode = CVODE(
            self.velocity,
            method="BDF",
            linsolver="gmres",
            rtol=self.owner.rtol,
            krylov_dim=10,
            atol=absolute,
            first_step=self.first or 0.0,
            precond=CVODEPrecond(self.setup, self.precondition, side="right"),
        )
        self.cvode.init_step(0.0, y)

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
        UNCUT.pause()
        self.info["evaluations"] += 1
        now = min(self.begin + t, self.last)
        data = np.array(y).reshape(self.shape)
        found, _ = self.equation.rates(data, now)
        if not np.isfinite(found).all():
            names = self.equation.names
            lost = ~np.isfinite(found.reshape(len(names), -1)).all(axis=1)
            raise NutrientFailed(
                f"the rate of {names[int(np.argmax(lost))]} is not finite at t = {now:.6g}",
                "Look for a reaction that makes it grow without bound",
            )
        yp[:] = found.ravel()

    def setup(
        self, t: float, y: FloatArray, yp: FloatArray, jok: int, jnew: list[int], gamma: float
    ) -> None:
        """Make the preconditioner anew where SUNDIALS asks for it."""
        jnew[0] = int(not jok or self.near is None)
        if jnew[0]:
            now = min(self.begin + t, self.last)
            self.near = self.equation.shifted_inverse(np.array(y).reshape(self.shape), now)

    def precondition(
        self,
        t: float,
        y: FloatArray,
        yp: FloatArray,
        r: FloatArray,
        z: FloatArray,
        gamma: float,
        delta: float,
        lr: int,
    ) -> None:
        """Solve about (I - γJ) z = r."""
        z[:] = self.near(np.array(r).reshape(self.shape) / gamma, 1.0 / gamma).ravel()
