"""``multicell-march``: steps of backward Euler under error control, of which none is below zero.

A step is backward Euler, whose equations are those of the steady state with 1/dt added to the
rates and c/dt to the supply: M-matrices again, so that no concentration is negative, and the steady
state is exactly where the march comes to rest. Each step is done once in full and once in halves;
their distance is the estimate of the error, and 2 (halves) - (full) is of second order. That is
taken where it is nowhere negative, else the halves are.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np
from pde.solvers.base import SolverBase

from multicell.cells import FloatArray
from multicell.errors import NutrientFailed, SceneError
from multicell.nutrient.balance import COLUMNS
from multicell.nutrient.equations.solving import suitable
from multicell.nutrient.steady import StepRefused

if TYPE_CHECKING:
    from collections.abc import Callable

    from pde.pdes.base import PDEBase

_MOST_STEPS: Final = 20_000
_SHORTEST: Final = 1e-9  # of the interval
_REFUSED: Final = 0.25  # of a step that was not solved, the next one tried


@final
class MarchFieldSolver(SolverBase):  # type: ignore[no-untyped-call]
    """What transient fields of runs are solved by.

    ``info["amounts"]`` holds what happened to each substance, with the columns of
    :data:`multicell.nutrient.balance.COLUMNS`.

    - ``pde``: a field equation
    - ``backend``: not used: the steps are compiled kernels
    - ``tolerance``: largest error of a step over the concentration of each field
    - ``scales``, (m,) mM: concentrations that errors are compared with at least; absent: those of
      the media
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

    def make_stepper(
        self, state: Any, dt: float | None = None
    ) -> Callable[[Any, float, float], float]:
        """Return a function that brings a state from one time to another.

        ``dt`` is the first step; absent: a tenth of the time between two jumps of the medium.
        """
        pde = suitable(self.pde, state, "implicit_step")
        self.info.update(
            dt=dt, stochastic=False, steps=0, rejections=0, first_order=0, error=0.0,
            amounts=np.zeros((len(pde.names), len(COLUMNS))),
        )  # fmt: skip

        def stepper(state: Any, t_start: float, t_end: float) -> float:
            c, ends = np.array(state.data, dtype=float), (float(t_start), float(t_end))
            for begin, end in itertools.pairwise([ends[0], *pde.switches(*ends), ends[1]]):
                self._reached = begin, c
                try:
                    c = self._march(pde, c, begin, end)
                except NutrientFailed as failure:
                    words = pde.growing(self._reached[1])
                    if not words:
                        raise
                    hint = "Look at the rates of the reactions that make it, or let them saturate."
                    problem = f"at t = {self._reached[0]:.6g} s {words}"
                    raise NutrientFailed(problem, hint) from failure
            state.data[...] = c
            return t_end

        return stepper

    def _march(self, pde: Any, c: FloatArray, begin: float, end: float) -> FloatArray:
        """Bring the data from one time to another, between which no medium jumps."""
        last = float(np.nextafter(end, -np.inf))  # at the moment of a jump the old medium holds
        scale = pde.scales(c, begin, end)
        if self.scales is not None:
            scale = np.maximum(scale, self.scales)

        def step(c: FloatArray, dt: float, time: float) -> tuple[FloatArray, FloatArray]:
            self._reached = time - dt, c
            after, amounts = pde.implicit_step(c, dt, min(time, last))
            return after, amounts

        length, info = end - begin, self.info
        elapsed, dt = 0.0, 0.1 * length if info["dt"] is None else info["dt"]
        while elapsed < length:
            dt = min(dt, length - elapsed)
            if length - elapsed - dt < 1e-9 * length:
                dt = length - elapsed
            if info["steps"] > _MOST_STEPS or dt < _SHORTEST * length:
                raise NutrientFailed(
                    f"a transient field needs steps of {dt:.3g} s, too many to go on",
                    "Raise time_tolerance, or let the field be steady",
                )
            t = begin + elapsed
            try:
                full, once = step(c, dt, t + dt)
                middle, first = step(c, 0.5 * dt, t + 0.5 * dt)
                halves, second = step(middle, 0.5 * dt, t + dt)
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
                info["first_order"] += 1
            info["amounts"] = info["amounts"] + amounts
            info["steps"] += 1
            info["error"] = max(info["error"], error)
            elapsed = length if dt == length - elapsed else elapsed + dt
            dt *= max(0.3, factor)
        return c


def _distance(halves: FloatArray, full: FloatArray, scale: FloatArray) -> float:
    """Return the largest distance of two states over what it is compared with in each field."""
    apart, most = (
        np.abs(x).reshape(len(scale), -1).max(axis=1, initial=0.0) for x in (halves - full, halves)
    )
    largest = np.maximum(scale, most)
    return float((apart / np.where(largest > 0.0, largest, 1.0)).max())
