"""The error that coupling steps make with growth, estimated from what they hold fixed.

Within a coupling step concentrations, pressures and states are those of its beginning. So growth is
integrated by Euler's method: a cell that grows at the rate g₀ at the beginning of a step and at g₁
after it has gained Δt g₀, where the trapezoidal rule gives Δt (g₀ + g₁)/2. The difference, Δt (g₀ -
g₁)/2, is the error of the step to leading order. It is also what step doubling gives: one step of
2Δt with the rates of its beginning gains 2Δt g₀, two of Δt gain Δt (g₀ + g₁), and half of their
difference is the error of one of the two. Both rates are known anyway, so that the estimate needs
no second solution of anything.

A division happens at the end of a step. What is left of the step since it was due counts for both
daughters, and nothing is missing.

Where a medium changes at once just when a step ends, and its field is steady, that step has rightly
held the surroundings of before, and the next one holds those of after: the change is no error.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from multicell.biology.cycle import may_grow
from multicell.cells import Cells, FloatArray, State, rows_of

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan


_GROWING = int(State.PROLIFERATING)  # numbers compare with arrays faster than names do


@final
class FrozenRates(NamedTuple):
    """What a coupling step holds fixed of the growth of its cells.

    ``id`` is (n,), ``factor`` the part of unlimited growth at which each cell grows, (n,): that of
    its surroundings, and 0 where its state keeps it from growing.
    """

    id: NDArray[np.int64]
    factor: FloatArray


@final
class StepError(NamedTuple):
    """The error that the splitting has made in a coupling step, simulated minus true.

    - ``volume``, float, µm³: of all cells together
    - ``rms``, ``worst``, float: size of the error of a single living cell over its volume
    - ``drift``, ``states``, float, 1/s: parts of growth that a step gets wrong, over
      its length, for :mod:`multicell.biology.pace`: because the surroundings of cells changed
      (signed), and because cells went over to another state
    """

    volume: float = 0.0
    rms: float = 0.0
    worst: float = 0.0
    drift: float = 0.0
    states: float = 0.0


def freeze(cells: Cells, factor: FloatArray) -> FrozenRates:
    """Return what a coupling step that begins now holds fixed.

    ``factor`` is the part of unlimited growth that the surroundings allow, (n,); see
    :func:`multicell.biology.growth.growth_factor`.
    """
    return FrozenRates(cells.id, np.where(cells.state == _GROWING, factor, 0.0))


def step_error(
    plan: BiologyPlan, before: FrozenRates, now: FrozenRates, cells: Cells, dt: float,
    *, jumped: bool = False,
) -> StepError:  # fmt: skip
    """Return the error of a coupling step that has just ended.

    - ``plan``: with growth
    - ``before``, ``now``: what the step held fixed, and what the next one will
    - ``cells``: the population after the step, n cells, in the order of ``now``
    - ``dt``: length of the step, s
    - ``jumped``: whether the surroundings have changed at once at the step's end, which is no error
    """
    assert plan.law is not None
    if len(cells) == 0 or dt <= 0.0:
        return StepError()
    birth = plan.birth_volume
    # what each cell would gain in a second where nothing limits it, µm³/s
    law = plan.law
    rate = law.rate(cells.volume, birth) / cells.cycle_time
    if plan.order:
        rate[~may_grow(plan, cells)] = 0.0
    began = now.factor if jumped else _inherit(before, now, cells)
    change = 0.5 * rate * (began - now.factor)
    error, volume = dt * change, cells.volume
    living = ~cells.dead
    count = int(np.count_nonzero(living))
    if count == 0:
        return StepError(float(error.sum()))
    relative = error / volume if count == len(cells) else error[living] / volume[living]
    switched = (began == 0.0) != (now.factor == 0.0)
    same, other = change, change[:0]
    if switched.any():
        same, other = change[~switched], change[switched]
    # those that have just died could have grown at the beginning
    free = dt * float((rate if count == len(cells) else rate[living | switched]).sum())
    return StepError(
        float(error.sum()),
        math.sqrt(float(np.square(relative).sum()) / count),
        float(np.abs(relative).max()),
        float(same.sum()) / free if free > 0.0 else 0.0,
        float(np.abs(other).sum()) / free if free > 0.0 else 0.0,
    )


def columns(error: StepError, cells: Cells, contents: Mapping[str, float]) -> dict[str, float]:
    """Return what the history tells of a step's error; ``contents`` are those of fields."""
    volume = float(cells.volume.sum())
    return {
        "splitting_volume_error": error.volume / volume if volume > 0.0 else 0.0,
        "splitting_cell_error": error.rms,
        "splitting_worst_cell_error": error.worst,
        **{f"splitting_content_error_{name}": amiss for name, amiss in contents.items()},
    }


def _inherit(before: FrozenRates, now: FrozenRates, cells: Cells) -> FloatArray:
    """Return the factors of a step's beginning for the cells at its end; daughters have hers."""
    if before.id is now.id or np.array_equal(before.id, now.id):
        return before.factor
    row = rows_of(before.id, now.id)
    born = row < 0
    row[born] = rows_of(before.id, cells.parent[born])
    return np.asarray(before.factor[row])
