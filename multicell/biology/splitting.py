"""Growth of second order in the coupling step, from rates that are known anyway.

Within a coupling step the factors of growth are those of its beginning, f₀. When it has ended those
of its end are known, f₁: the trapezoidal rule gives Δt (f₀ + f₁)/2 in place of Δt f₀. So each cell
notes Δt (f₁ - f₀)/2, the time for which it has yet to grow (:attr:`multicell.cells.Cells.lag`), and
makes half of what it has noted good in each of the next steps. All of it at once would be the
method of Adams and Bashforth, which is stable for half of the steps that Euler's is; half of it is
stable for three quarters of them (z-transform: for |λ| Δt < 3/2), and only the lag is larger.

Growth stays between none and twice that of the rates at the beginning of its step: what a cell
that hardly grows has grown too much stays noted. Decisions to rest fall on the end of the step
that is nearest to their time (:func:`multicell.biology.states.deciding`), and are not counted.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from multicell.cells import Cells, FloatArray, State, rows_before

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from multicell.biology.plan import BiologyPlan


_SHARE = 0.5  # of the lag that is made good in a step
_GROWING = int(State.PROLIFERATING)  # numbers compare with arrays faster than names do


def corrected_factor(plan: BiologyPlan, cells: Cells, factor: FloatArray, dt: float) -> FloatArray:
    """Return the factor at which cells grow in a step of ``dt`` s, with what they make good, (n,).

    ``factor``, (n,): that of the step's beginning; see
    :func:`multicell.biology.growth.growth_factor`.
    """
    if dt <= 0.0 or not cells.lag.any():
        return factor
    most = np.abs(factor)
    extra = np.clip(_SHARE / dt * cells.lag, -most, most)
    return np.where(_grows(plan, cells), factor + extra, factor)


def lag_after(
    plan: BiologyPlan, began: Cells, before: FloatArray, cells: Cells, now: FloatArray, dt: float
) -> FloatArray:
    """Return for how long each cell has yet to grow after a step, (n,) s of unlimited growth.

    - ``began``, ``before``: the cells of the step's beginning, and their factors
    - ``cells``, ``now``: those of its end, whose lag lacks this step, and their factors
    - ``dt``: its length, s
    """
    grew = np.where(_grows(plan, began), before, np.nan)[rows_before(began, cells)]
    change = np.where(_grows(plan, cells), now - grew, 0.0)
    lag = cells.lag + 0.5 * dt * np.where(np.isnan(change), 0.0, change)
    return np.where(cells.dead, 0.0, lag)


def _grows(plan: BiologyPlan, cells: Cells) -> NDArray[np.bool_]:
    """Return which cells grow as their surroundings allow, (n,)."""
    living = cells.state == _GROWING
    return np.asarray(living & plan.grows[cells.phase] if plan.order else living)
