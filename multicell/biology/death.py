"""Death by the clock, and removal of dead cells whose volume is all but gone."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multicell import random
from multicell.cells import Cells
from multicell.random import Purpose

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan


def apoptotic(plan: BiologyPlan, cells: Cells, time: float) -> NDArray[np.bool_]:
    """Return which cells have reached the end of their life by apoptosis, (n,).

    With a constant rate k lives are distributed exponentially. Each cell draws its own once, keyed
    by its identity, and dies when the time that it has lived in the run passes it: since its birth,
    or since the start for a cell that was there then. An exponential life has no memory, so the age
    of a cell at the start says nothing about what remains. Survivors are N exp(-kt) from t = 0 on,
    and the outcome knows nothing of the coupling step but for the moment at which the death is
    noticed.

    Parameters
    ----------
    plan
        Gives the rate.
    cells
        The population; identities and ages are read.
    time
        Since the start of the run, s.
    """
    rate = 0.0 if plan.death is None else plan.death.apoptosis_rate
    if rate == 0.0:
        return np.zeros(len(cells), dtype=bool)
    u = random.uniform(plan.seed, Purpose.APOPTOSIS, 0, cells.id)[:, 0]
    # who was there at the start is older than the run, who was born in it is younger
    lived = np.minimum(cells.age, time)
    return np.asarray(lived * rate > -np.log1p(-u))


def necrotic(
    plan: BiologyPlan, cells: Cells, beyond: NDArray[np.bool_], step: int, dt: float
) -> NDArray[np.bool_]:
    """Return which of the cells beyond a threshold of necrosis die of it, (n,).

    All, unless the scene gives a rate k: then each cell dies in a time dt with the probability
    1 - exp(-k dt). Times until death are distributed exponentially whatever the coupling step.

    Parameters
    ----------
    plan
        Gives the rate.
    cells
        The population; the identities are read.
    beyond : (n,) bool
        Cells that find too little or too much of a nutrient.
    step
        Number of the coupling step, which the random numbers depend on.
    dt
        Time since the last decision, s.
    """
    rate = None if plan.death is None else plan.death.necrosis_rate
    if rate is None:
        return beyond
    dies = beyond.copy()
    u = random.uniform(plan.seed, Purpose.NECROSIS, step, cells.id[beyond])[:, 0]
    dies[beyond] = u < -np.expm1(-rate * dt)
    return dies


def remove_lysed(plan: BiologyPlan, cells: Cells) -> tuple[Cells, int]:
    """Remove dead cells smaller than ``removal_fraction`` of the birth volume.

    Parameters
    ----------
    plan
        Without ``death`` no cell is removed.
    cells
        The population; it is not changed.

    Returns
    -------
    cells
        The cells that remain, in their old order.
    removed
        Number of cells removed.
    """
    if plan.death is None:
        return cells, 0
    dead = cells.dead
    if not dead.any():
        return cells, 0
    smallest = plan.death.removal_fraction * plan.birth_volume
    gone = dead & (cells.volume < smallest)
    removed = int(gone.sum())
    return (cells.take(~gone), removed) if removed else (cells, 0)
