"""Division: one mother becomes two daughters of half her volume."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multicell import random
from multicell.biology.cycle import enter_cycle
from multicell.biology.durations import draw_cycle_times
from multicell.biology.traits import draw_moduli
from multicell.cells import HALF, Cells, State
from multicell.random import Purpose

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan


# A cell that reaches the division volume up to rounding has reached it: else cells in step with
# the coupling times would divide in this step or the next at the whim of the last bit.
_ROUNDING = 1e-12


def divide(plan: BiologyPlan, cells: Cells, step: int, next_id: int) -> tuple[Cells, int]:
    """Divide all proliferating cells at the end of M, or at the division volume without phases.

    Each mother is replaced by two daughters of half her volume (what she grew beyond the division
    volume included), at +- r (1 - 2^(-1/3)) from her centre along a random axis, r her radius:
    volume and centre of mass are conserved and the daughters stay within the mother.

    Parameters
    ----------
    plan
        A scene without ``growth`` has no divisions.
    cells
        The population; it is not changed.
    step
        Index of the coupling step, part of the key of the random numbers.
    next_id
        First identity that is free.

    Returns
    -------
    cells
        The cells that did not divide, in their old order, followed by the daughters in the order
        of their mothers' identities. The daughters have age 0, the mother's pressure and Poisson
        ratio, and draw cycle time and modulus anew unless these are heritable.
    next_id
        First identity that is free now; it has grown by two a division.
    """
    if plan.growth is None:
        return cells, next_id
    if plan.order:
        ripe = (cells.phase == plan.order[-1]) & (cells.progress >= cells.phase_length)
    else:
        ripe = cells.volume >= plan.division_volume * (1.0 - _ROUNDING)
    ripe &= cells.state == State.PROLIFERATING
    if not ripe.any():
        return cells, next_id
    mothers = cells.take(ripe)
    # identities follow those of the mothers, so that the order of the arrays does not matter
    mothers = mothers.take(np.argsort(mothers.id))
    ids = np.arange(next_id, next_id + 2 * len(mothers), dtype=np.int64)
    return cells.replaced(~ripe, _daughters(plan, mothers, step, ids)), int(ids[-1]) + 1


def _daughters(plan: BiologyPlan, mothers: Cells, step: int, ids: NDArray[np.int64]) -> Cells:
    """Return two daughters for each of the ``mothers``, side by side, named ``ids``."""
    axis = random.directions(plan.seed, Purpose.AXIS, step, mothers.id, plan.dimensions)
    offset = (mothers.radius * (1.0 - HALF))[:, None] * axis
    daughters = mothers.take(np.repeat(np.arange(len(mothers)), 2))
    daughters.position[0::2] += offset
    daughters.position[1::2] -= offset
    daughters.parent = daughters.id
    daughters.id = ids
    daughters.radius = daughters.radius * HALF
    daughters.age = np.zeros(len(ids))
    if "young" not in plan.heritable:
        daughters.young = draw_moduli(plan, step, ids, daughters.kind)
    if plan.order:
        enter_cycle(plan, daughters, daughters.progress - daughters.phase_length)
    elif "cycle_time" not in plan.heritable:
        daughters.cycle_time = draw_cycle_times(plan, step, ids, daughters.kind)
    return daughters
