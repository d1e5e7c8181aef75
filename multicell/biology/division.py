"""Division: one mother becomes two daughters of half her volume."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from multicell import random
from multicell.biology.changes import mutant_chances, mutate
from multicell.biology.cycle import enter_cycle
from multicell.biology.durations import draw_cycle_times
from multicell.biology.responding import value_of
from multicell.biology.traits import draw_moduli, drift
from multicell.cells import HALF, Cells, FloatArray, State
from multicell.random import Purpose

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan


# A cell that reaches the division volume up to rounding has reached it: else cells in step with
# the coupling times would divide in this step or the next at the whim of the last bit.
ROUNDING = 1e-12

_NONE: Mapping[str, FloatArray] = {}


def due_to_divide(
    plan: BiologyPlan, cells: Cells, found: Mapping[str, FloatArray]
) -> NDArray[np.bool_]:
    """Return which cells are at the end of their cycle, (n,); ``plan`` is one with growth."""
    if plan.order:
        ripe = (cells.phase == plan.order[-1]) & (cells.progress >= cells.phase_length)
    else:
        least: Any = plan.division_volume
        scale = value_of(plan, "division radius", 1.0, found, cells)
        if scale is not None:
            least = least * scale**3
        ripe = cells.volume >= least * (1.0 - ROUNDING)
    return np.asarray(ripe & (cells.state == State.PROLIFERATING))


def divide(
    plan: BiologyPlan,
    cells: Cells,
    step: int,
    next_id: int,
    found: Mapping[str, FloatArray] = _NONE,
) -> tuple[Cells, int]:
    """Divide all proliferating cells at the end of M, or at the division volume without phases.

    Each mother is replaced by two daughters of half her volume (what she grew beyond the division
    volume included), at +- r (1 - 2^(-1/3)) from her centre along a random axis, r her radius:
    volume and centre of mass are conserved and the daughters stay within the mother. A cell that is
    doomed to die at this division does not divide.

    - ``plan``: a scene without ``growth`` has no divisions
    - ``cells``: the population; it is not changed
    - ``step``: index of the coupling step, part of the key of the random numbers
    - ``next_id``: first identity that is free
    - ``found``, name -> (n,): signals at the cells, for what responds to them

    Returns cells: the cells that did not divide, in their old order, followed by the daughters in
    the order of their mothers' identities. The daughters have age 0, the mother's pressure and
    Poisson ratio and damage, and draw cycle time and modulus anew unless these are heritable;
    next_id: first identity that is free now; it has grown by two a division.
    """
    if plan.growth is None:
        return cells, next_id
    ripe = due_to_divide(plan, cells, found) & (cells.doomed != 1)
    if not ripe.any():
        return cells, next_id
    mothers = cells.take(ripe)
    # identities follow those of the mothers, so that the order of the arrays does not matter
    order = np.argsort(mothers.id)
    mothers = mothers.take(order)
    ids = np.arange(next_id, next_id + 2 * len(mothers), dtype=np.int64)
    chances = mutant_chances(plan, cells, found)
    if chances is not None:
        chances = np.repeat(chances[ripe][order], 2, axis=0)
    daughters = _daughters(plan, mothers, step, ids, chances)
    return cells.replaced(~ripe, daughters), int(ids[-1]) + 1


def _daughters(
    plan: BiologyPlan,
    mothers: Cells,
    step: int,
    ids: NDArray[np.int64],
    mutant: FloatArray | None,
) -> Cells:
    """Return two daughters for each of the ``mothers``, side by side, named ``ids``.

    ``mutant`` are the chances of each daughter to be of each type, or None.
    """
    axis = random.directions(plan.seed, Purpose.AXIS, step, mothers.id, plan.dimensions)
    offset = (mothers.radius * (1.0 - HALF))[:, None] * axis
    daughters = mothers.take(np.repeat(np.arange(len(mothers)), 2))
    daughters.position[0::2] += offset
    daughters.position[1::2] -= offset
    daughters.parent = daughters.id
    daughters.id = ids
    daughters.radius = daughters.radius * HALF
    daughters.age = np.zeros(len(ids))
    daughters.doomed = np.maximum(daughters.doomed, 1) - np.int8(1)
    if mutant is not None:
        mutate(plan, daughters, mutant, step)
    drift(plan, daughters, step)
    if "young" not in plan.heritable:
        daughters.young = draw_moduli(plan, step, ids, daughters.kind)
    if plan.order:
        enter_cycle(plan, daughters, daughters.progress - daughters.phase_length)
    elif "cycle_time" not in plan.heritable:
        daughters.cycle_time = draw_cycle_times(plan, step, ids, daughters.kind)
    return daughters
