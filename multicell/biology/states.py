"""Which cells proliferate, rest or die, from what they find around them, and removal of the dead.

**Why cells do not all react at once.** A resting cell takes up less nutrient. If all cells compared
the field with the threshold at every coupling step, those near it would rest together, the field
would recover, all would wake together, and the field would fall again: half of a spheroid was seen
to switch in every step, and cells died in the troughs. The oscillation is made by the coupling
step, not by the model: the steady state has a layer at the threshold in which a part of the cells
rests. So each cell decides at birth and then once in a reaction time, at times of its own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multicell import random
from multicell.biology.division import ROUNDING, due_to_divide
from multicell.biology.responding import rate_of_harm, value_of, wants_rest
from multicell.cells import Cells, FloatArray, Found, Mask, Phase, State
from multicell.random import Purpose

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan
    from multicell.scene.radiation import Radiation


_GOLDEN = float(0.5 * (np.sqrt(5.0) - 1.0))
# arrays compare with numbers of their own type faster than with names
_GROWING, _RESTING, _NECROTIC, _APOPTOTIC = (np.int8(state) for state in State)


def update_states(
    plan: BiologyPlan, cells: Cells, found: Found, step: int = 0, dt: float = 0.0, time: float = 0.0
) -> NDArray[np.int8]:
    """Return the new state of each cell.

    A cell turns necrotic at the rate that its responses give (a threshold: at once;
    :func:`necrotic`) or with as much damage as it bears, and stays so for ever; one whose life by
    apoptosis has run out turns apoptotic, and so does one at the end of its cycle that irradiation
    has doomed to die in place of this division. Another cell that is due to decide
    (:func:`deciding`) rests (quiescent) if a response lets it
    (:func:`multicell.biology.responding.wants_rest`), and proliferates if none does. Where nothing
    lets cells rest, their states stay as they are.

    - ``step``, ``dt``, ``time``: number of the coupling step that has ended, its length and its
      end, s; 0 at the start of a run

    Returns (n,) int8: values of :class:`multicell.cells.State`; ``cells`` is not changed.
    """
    state = cells.state.copy()
    if plan.may_rest and not plan.restricted:
        wanted = np.where(wants_rest(plan, cells, found), _RESTING, _GROWING)
        if np.count_nonzero(wanted != state):  # else it does not matter who is due
            due = deciding(cells, plan.step, plan.cells.reaction_time)
            state = np.where(due, wanted, state)
    hazard = rate_of_harm(plan, "necrosis rate", found, cells)
    necrosis, apoptosis = cells.state == _NECROTIC, cells.state == _APOPTOTIC
    if plan.growth is not None and np.count_nonzero(last := cells.doomed == 1):
        apoptosis |= last & due_to_divide(plan, cells)
    if "apoptosis rate" in plan.base_rates:
        apoptosis |= apoptotic(plan, cells, found, step, dt, time) & ~cells.dead
    if "damage rate" in plan.responses:
        necrosis |= cells.damage >= 1.0 - ROUNDING
    if hazard is not None and np.count_nonzero(hazard):
        necrosis |= necrotic(plan, cells, hazard, step, dt)
    state[necrosis] = _NECROTIC
    state[apoptosis] = _APOPTOTIC
    return state


def deciding(cells: Cells, dt: float, reaction_time: float) -> Mask:
    """Return which cells decide in a step of length ``dt`` (s) that ends now, (n,).

    A cell decides at birth and whenever its age passes a multiple of the reaction time, shifted by
    a part of it that the identity sets: multiples of the golden ratio spread these parts evenly,
    and far apart for sisters. It does so at the end of the step that is nearest to that moment, so
    that decisions are neither late nor early on average. With a reaction time up to ``dt`` every
    cell decides in every step.
    """
    shift = (cells.id + 1) * _GOLDEN % 1.0
    now = np.floor((cells.age + 0.5 * dt) / reaction_time + shift)
    before = np.floor((cells.age - 0.5 * dt) / reaction_time + shift)
    return np.asarray((now > before) | (cells.age < dt))


def apoptotic(
    plan: BiologyPlan, cells: Cells, found: Found, step: int, dt: float, time: float
) -> Mask:
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


def necrotic(plan: BiologyPlan, cells: Cells, hazard: FloatArray, step: int, dt: float) -> Mask:
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


def damage_after(plan: BiologyPlan, cells: Cells, found: Found, dt: float) -> FloatArray:
    """Return the damage of the cells after a time ``dt`` (s), (n,), in parts of what kills them.

    dD/dt = k/θ, with the damage rate k held for the step and the tolerance θ of the cell (gamma,
    mean 1, drawn once by its identity). The dead keep theirs.
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
    return np.where(dead, cells.damage, cells.damage + rate * dt)


def remove_lysed(plan: BiologyPlan, cells: Cells) -> tuple[Cells, int]:
    """Remove dead cells smaller than ``removal_fraction`` of the birth volume; return how many."""
    if plan.death is None:
        return cells, 0
    dead = cells.dead
    if not np.count_nonzero(dead):
        return cells, 0
    smallest = plan.death.removal_fraction * plan.birth_volume
    gone = dead & (cells.volume < smallest)
    removed = int(gone.sum())
    return (cells.take(~gone), removed) if removed else (cells, 0)


def irradiate(
    plan: BiologyPlan, cells: Cells, found: Found, begin: float, end: float
) -> tuple[Cells, Mask]:
    """Return the cells after all fractions between two times, and which have died, (n,).

    Each living cell is hit by each fraction with a random number of its own, which knows nothing of
    the coupling step. One that does not survive dies at once, or has so many divisions left.

    - ``begin``, ``end``, s: fractions fall due after the first and up to the second
    """
    after = cells.shared()
    for course, part in enumerate(plan.radiation.values()):
        for number, time in enumerate(part.schedule):
            if begin < time * (1.0 - ROUNDING) <= end:
                u = random.uniform(plan.seed, Purpose.RADIATION, number, cells.id, attempt=course)
                _kill(part, after, (u[:, 0] >= _survival(plan, part, after, found)) & ~after.dead)
    dead = after.dead & ~cells.dead
    if dead.any():
        after.age = np.where(dead, 0.0, after.age)
    return after, dead


def _survival(plan: BiologyPlan, part: Radiation, cells: Cells, found: Found) -> FloatArray:
    """Return the probability of each cell to survive a fraction, (n,)."""
    known = part.phase_factor or {}
    factor = np.array([known.get(phase.name, 1.0) for phase in Phase])[cells.phase]
    if part.types:
        factor *= np.isin(cells.kind, [list(plan.types).index(kind) for kind in part.types])
    pressure = found[part.oxygen] / plan.solubility[part.oxygen] if part.oxygen else np.inf
    return np.asarray(part.survival(pressure, factor))


def _kill(part: Radiation, cells: Cells, lost: Mask) -> None:
    """Let cells die at once, or at one of their next divisions."""
    left = np.int8(part.mitotic_divisions)
    if left:
        sooner = lost & ((cells.doomed == 0) | (cells.doomed > left))
        cells.doomed = np.where(sooner, left, cells.doomed)
    else:
        cells.state = np.where(lost, np.int8(State.APOPTOTIC), cells.state)
