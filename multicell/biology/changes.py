"""Cells that become another type: at a rate while they live, or by a mutation at division."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from multicell import random
from multicell.biology.responding import value_of
from multicell.random import Purpose

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan
    from multicell.cells import Cells, FloatArray, Found, IntArray


def change_types(plan: BiologyPlan, cells: Cells, found: Found, step: int, dt: float) -> Cells:
    """Return the cells after those of a step of ``dt`` s have changed that do.

    With the rates k_j of the types j a living cell changes with the probability 1 - exp(-Σ k dt),
    and then becomes j with k_j / Σ k: a Markov chain whose rates are held for a step.
    """
    rates = _by_type(plan, "change to", found, cells)
    if rates is None:
        return cells
    rates[cells.dead] = 0.0
    u = random.uniform(plan.seed, Purpose.CHANGE, step, cells.id, 2)
    total = rates.sum(axis=1)
    turns = np.flatnonzero(u[:, 0] < -np.expm1(-total * dt))
    if not turns.size:
        return cells
    chosen = (u[turns, 1, None] * total[turns, None] >= np.cumsum(rates[turns], axis=1)).sum(axis=1)
    after = cells.shared()
    _become(plan, after, turns, np.minimum(chosen, len(plan.types) - 1))
    return after


def mutant_chances(plan: BiologyPlan, cells: Cells, found: Found) -> FloatArray | None:
    """Return the chance of a daughter of each cell to be of each type, (n, types), or None."""
    return _by_type(plan, "mutation to", found, cells)


def mutate(plan: BiologyPlan, daughters: Cells, chances: FloatArray) -> None:
    """Let daughters be of another type, whose mothers' chances are (n, types).

    Chances that add up to more than one leave none of the mother's type.
    """
    u = random.uniform(plan.seed, Purpose.MUTATION, 0, daughters.id)[:, 0]
    ends = np.cumsum(chances, axis=1)
    turns = np.flatnonzero(u < ends[:, -1])
    _become(plan, daughters, turns, (u[turns, None] >= ends[turns]).sum(axis=1))


def _by_type(plan: BiologyPlan, behaviour: str, found: Found, cells: Cells) -> FloatArray | None:
    """Return the values of a behaviour for each type, (n, types), zero for the cell's own."""
    out = None
    for number, name in enumerate(plan.types):
        value = value_of(plan, f"{behaviour} {name}", 0.0, found, cells)
        if value is not None:
            out = np.zeros((len(cells), len(plan.types))) if out is None else out
            out[:, number] = np.where(cells.kind == number, 0.0, value)
    return out


def _become(plan: BiologyPlan, cells: Cells, index: IntArray, kinds: IntArray) -> None:
    """Make cells of other types: their moduli and cycles go with those of the types."""
    before, kind = cells.kind[index], cells.kind.copy()
    kind[index] = kinds
    for name, ratio in (("young", plan.young_ratio), ("cycle_time", plan.cycle_scale)):
        if ratio is not None:
            column = getattr(cells, name).copy()
            column[index] *= ratio[kinds] / ratio[before]
            setattr(cells, name, column)
    cells.kind = kind
