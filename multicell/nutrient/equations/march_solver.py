"""``multicell-march``: steps of backward Euler under error control, of which none is below zero."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any, final

import numpy as np
from pde.solvers.base import SolverBase

from multicell.cells import FloatArray
from multicell.errors import NutrientFailed, SceneError
from multicell.nutrient.balance import COLUMNS
from multicell.nutrient.equations.solving import suitable
from multicell.nutrient.march import March, march

if TYPE_CHECKING:
    from collections.abc import Callable

    from pde.pdes.base import PDEBase


@final
class MarchFieldSolver(SolverBase):  # type: ignore[no-untyped-call]
    """What transient fields of runs are solved by: see :mod:`multicell.nutrient.march`.

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
        done = March(np.zeros((len(pde.names), len(COLUMNS))))
        self.info.update(dt=dt, stochastic=False)
        self._note(done)

        def stepper(state: Any, t_start: float, t_end: float) -> float:
            c, ends = np.array(state.data, dtype=float), (float(t_start), float(t_end))
            for begin, end in itertools.pairwise([ends[0], *pde.switches(*ends), ends[1]]):
                c = self._march(pde, c, begin, end, done)
            state.data[...] = c
            self._note(done)
            return t_end

        return stepper

    def _march(self, pde: Any, c: FloatArray, begin: float, end: float, done: March) -> FloatArray:
        """Bring the data from one time to another, between which no medium jumps."""
        last = float(np.nextafter(end, -np.inf))  # at the moment of a jump the old medium holds
        scale = pde.scales(c, begin, end)
        if self.scales is not None:
            scale = np.maximum(scale, self.scales)
        m = len(scale)
        reached = begin, c

        def step(c: FloatArray, dt: float, time: float) -> tuple[FloatArray, FloatArray]:
            nonlocal reached
            reached = time - dt, c
            after, amounts = pde.implicit_step(c, dt, min(time, last))
            return after, amounts

        def error(halves: FloatArray, full: FloatArray) -> float:
            apart, most = (
                np.abs(x).reshape(m, -1).max(axis=1, initial=0.0) for x in (halves - full, halves)
            )
            largest = np.maximum(scale, most)
            return float((apart / np.where(largest > 0.0, largest, 1.0)).max())

        opening = 0.1 * (end - begin) if self.info["dt"] is None else self.info["dt"]
        try:
            return march(
                step, error, c, begin, end, tolerance=self.tolerance, done=done, opening=opening
            )
        except NutrientFailed as failure:
            words = pde.growing(reached[1])
            if not words:
                raise
            hint = "Look at the rates of the reactions that make it, or let them saturate."
            raise NutrientFailed(f"at t = {reached[0]:.6g} s {words}", hint) from failure

    def _note(self, done: March) -> None:
        self.info.update(
            steps=done.steps, rejections=done.rejections, first_order=done.first_order,
            error=done.error, amounts=done.amounts,
        )  # fmt: skip
