"""Estimates of the error that the length of a coupling step leaves in the volume of cells."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, final

import numpy as np

from multicell.biology.growth import growing
from multicell.cells import rows_before

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan
    from multicell.cells import Cells, FloatArray, IntArray

_SHARE = np.array([1.0, 0.5, 0.0, 0.0])
"""What a cell of each state counts of the growth that its uptake allows: resting ones a half."""

_MISSED = 1.5
"""Growth that lasts over that by which lags change their sign: 0.7 to 1.6 at 5 to 40 min, measured.
"""


@final
class StepErrors(NamedTuple):
    """Parts of the volume of all cells that depend on the length of a step.

    - ``lasting``: of first order, which nothing makes good
    - ``lag``: what the next steps are to make good if all are like this one
    - ``growth``: of all cells in the step
    - ``pace``, 1/s: of living cells that nothing limits
    """

    lasting: float
    lag: float
    growth: float
    pace: float


def step_errors(
    plan: BiologyPlan,
    began: Cells,
    cells: Cells,
    before: FloatArray,
    now: FloatArray | None,
    dt: float,
    events: float,
    row: IntArray | None = None,
) -> StepErrors:
    """Return estimates of the errors of a step.

    Growth that cells have yet to make good is made good where it changes slowly. Where it changes
    its sign, rates go up and down from step to step, as pressures do after divisions, and as much
    is missed between its ends. Cells that come to rest, wake or die change what others are fed half
    a step early or late.

    - ``began``, ``cells``: of its beginning and end
    - ``before``, (n,) s: lags of the latter without this step
    - ``now``, (n,): part of unlimited growth at the end; None: as at the beginning
    - ``dt``: its length, s
    - ``events``: deaths and changes of type that it has made too many or too few
    - ``row``, (n,): rows of the cells or their mothers at the beginning, where they are known
    """
    volume, total = cells.volume, float(cells.volume.sum())
    if not total > 0.0:
        return StepErrors(0.0, 0.0, 0.0, 0.0)
    lasting = events / len(cells)
    if plan.law is None:
        return StepErrors(lasting, 0.0, 0.0, 0.0)
    scale = 1.0 if plan.target_scale is None else plan.target_scale[cells.phase]
    rate = scale * plan.law.rate(volume / scale, plan.birth_volumes(cells.kind)) / cells.cycle_time
    rate /= total
    net = 0.0
    if cells.lag is not before:
        change = rate * np.where(cells.dead, 0.0, cells.lag - before)
        net = abs(float(change.sum()))
        lasting += _MISSED * float(np.abs(change[change * before < 0.0]).sum())
    row = rows_before(began, cells) if row is None else row
    came, went = _SHARE[cells.state], _SHARE[began.state[row]]
    if not np.array_equal(came, went):
        lasting += 0.5 * dt * abs(float((rate * (came - went)).sum()))
    grew = rate if now is None else rate * now
    growth = dt * float(grew[growing(plan, cells)].sum())
    return StepErrors(lasting, 2.0 * net, max(growth, 0.0), float(rate[~cells.dead].sum()))
