"""Death by the clock, and removal of dead cells whose volume is all but gone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multicell import random
from multicell.biology.responding import rate_of_harm, value_of
from multicell.cells import Cells, FloatArray
from multicell.random import Purpose

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan


def apoptotic(
    plan: BiologyPlan,
    cells: Cells,
    found: Mapping[str, FloatArray],
    step: int,
    dt: float,
    time: float,
) -> NDArray[np.bool_]:
    """Return which cells have reached the end of their life by apoptosis, (n,).

    With a constant rate k lives are distributed exponentially. Each cell draws its own once, keyed
    by its identity, and dies when the time that it has lived in the run passes it: since its birth,
    or since the start for a cell that was there then. An exponential life has no memory, so the age
    of a cell at the start says nothing about what remains. Survivors are N exp(-kt) from t = 0 on,
    and the outcome knows nothing of the coupling step but for the moment at which the death is
    noticed. With a rate that responds to signals each cell dies in a step with the probability
    1 - exp(-k dt).

    - ``step``, ``dt``: number of the coupling step that ends, and its length, s
    """
    rate = plan.base_rates["apoptosis rate"]
    hazard = value_of(plan, "apoptosis rate", rate, found, cells)
    if hazard is not None:
        u = random.uniform(plan.seed, Purpose.APOPTOSIS, step + 1, cells.id)[:, 0]
        return np.asarray(u < -np.expm1(-hazard * dt))
    u = random.uniform(plan.seed, Purpose.APOPTOSIS, 0, cells.id)[:, 0]
    # who was there at the start is older than the run, who was born in it is younger
    lived = np.minimum(cells.age, time)
    return np.asarray(lived * rate > -np.log1p(-u))


def necrotic(
    plan: BiologyPlan, cells: Cells, hazard: FloatArray, step: int, dt: float
) -> NDArray[np.bool_]:
    """Return which of the cells die by necrosis, (n,).

    All with an infinite rate; with another rate k each cell dies in a time dt with the probability
    1 - exp(-k dt). Times until death are distributed exponentially whatever the coupling step.

    - ``hazard``, (n,), 1/s: from :func:`multicell.biology.responding.rate_of_harm`
    - ``dt``: time since the last decision, s
    """
    dies = np.isinf(hazard)
    at_rate = (hazard > 0.0) & ~dies
    if at_rate.any():
        u = random.uniform(plan.seed, Purpose.NECROSIS, step, cells.id[at_rate])[:, 0]
        dies[at_rate] = u < -np.expm1(-hazard[at_rate] * dt)
    return dies


def damage_after(
    plan: BiologyPlan, cells: Cells, found: Mapping[str, FloatArray], dt: float
) -> FloatArray:
    """Return the damage of the cells after a time ``dt`` (s), (n,), in parts of what kills them.

    dD/dt = k/θ - D/τ in closed form, with the damage rate k held for the step, the tolerance θ of
    the cell (gamma, mean 1, drawn once by its identity) and the time τ of repair. D changes
    monotonically, so that who is below one at the end was so throughout. The dead keep theirs.
    """
    rate = rate_of_harm(plan, "damage rate", found, cells)
    death, dead = plan.death, cells.dead
    if rate is None or not (rate.any() or cells.damage.any()):
        return cells.damage
    if death is not None and death.damage_variation > 0.0:
        from scipy.special import gammainccinv  # loaded where it is used

        hit, shape = np.flatnonzero(rate), death.damage_variation**-2
        u = random.uniform(plan.seed, Purpose.TOLERANCE, 0, cells.id[hit])[:, 0]
        rate[hit] *= shape / gammainccinv(shape, u)
    if death is None or death.damage_repair_time is None:
        after = cells.damage + rate * dt
    else:
        repair = death.damage_repair_time
        after = cells.damage + (rate * repair - cells.damage) * -np.expm1(-dt / repair)
    return np.where(dead, cells.damage, after)


def remove_lysed(plan: BiologyPlan, cells: Cells) -> tuple[Cells, int]:
    """Remove dead cells smaller than ``removal_fraction`` of the birth volume; return how many."""
    if plan.death is None:
        return cells, 0
    dead = cells.dead
    if not dead.any():
        return cells, 0
    smallest = plan.death.removal_fraction * plan.birth_volume
    gone = dead & (cells.volume < smallest)
    removed = int(gone.sum())
    return (cells.take(~gone), removed) if removed else (cells, 0)
