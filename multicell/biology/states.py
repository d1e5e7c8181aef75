"""Which cells proliferate, rest or die, from what they find around them, and removal of the dead.

**Why cells do not all react at once.** A resting cell takes up less nutrient. If all cells compared
the field with the threshold at every coupling step, those near it would rest together, the field
would recover, all would wake together, and the field would fall again: half of a spheroid was seen
to switch in every step, and cells died in the troughs. The oscillation is made by the coupling
step, not by the model: the steady state has a layer at the threshold in which a part of the cells
rests. So each cell decides at birth and then once in a reaction time, at times of its own.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multicell import random
from multicell.biology.division import ROUNDING, due_to_divide
from multicell.biology.exposure import comes_to_pass
from multicell.biology.responding import rate_of_harm, value_of, wants_rest
from multicell.cells import Cells, FloatArray, Found, Mask, Phase, State
from multicell.random import Purpose

if TYPE_CHECKING:
    from multicell.biology.exposure import Exposure
    from multicell.biology.plan import BiologyPlan
    from multicell.scene.radiation import Radiation


_GOLDEN = float(0.5 * (np.sqrt(5.0) - 1.0))
# arrays compare with numbers of their own type faster than with names
_GROWING, _RESTING, _NECROTIC, _APOPTOTIC = (np.int8(state) for state in State)


def update_states(
    plan: BiologyPlan,
    cells: Cells,
    found: Found,
    exposure: Exposure | None = None,
    *,
    dt: float | None = None,
    ahead: float | None = None,
    time: float = 0.0,
) -> NDArray[np.int8]:
    """Return the new state of each cell; integrals of rates are noted in ``cells``.

    A cell turns necrotic where it finds what kills at once, by the rate that its responses give,
    or with as much damage as it bears, and stays so for ever; one whose life by
    apoptosis has run out turns apoptotic, and so does one at the end of its cycle that irradiation
    has doomed to die in place of this division. Another cell that is due to decide
    (:func:`deciding`) rests (quiescent) if a response lets it
    (:func:`multicell.biology.responding.wants_rest`), and proliferates if none does. Where nothing
    lets cells rest, their states stay as they are.

    - ``exposure``: to the signals of the step that has ended; absent at the start of a run, and
      where no rate acts
    - ``dt``, ``ahead``: lengths of that step and of the next one, s; absent: the usual one
    - ``time``: the end of that step, s; 0 at the start of a run

    Returns (n,) int8: values of :class:`multicell.cells.State`.
    """
    state = cells.state.copy()
    if plan.may_rest and not plan.restricted:
        wanted = np.where(wants_rest(plan, cells, found), _RESTING, _GROWING)
        if np.count_nonzero(wanted != state):  # else it does not matter who is due
            due = deciding(cells, dt or plan.step, plan.cells.reaction_time, ahead)
            state = np.where(due, wanted, state)
    necrosis, apoptosis = cells.state == _NECROTIC, cells.state == _APOPTOTIC
    if plan.growth is not None and np.count_nonzero(last := cells.doomed == 1):
        apoptosis |= last & due_to_divide(plan, cells)
    if "apoptosis rate" in plan.base_rates:
        apoptosis |= apoptotic(plan, cells, exposure, time) & ~cells.dead
    if "damage rate" in plan.responses:
        necrosis |= cells.damage >= 1.0 - ROUNDING
    if "necrosis rate" in plan.responses:
        necrosis |= necrotic(plan, cells, found, exposure)
    state[necrosis] = _NECROTIC
    state[apoptosis] = _APOPTOTIC
    return state


def deciding(
    cells: Cells, dt: float, reaction_time: float, ahead: float | None = None
) -> Mask:
    """Return which cells decide in a step of length ``dt`` (s) that ends now, (n,).

    A cell decides at birth and whenever its age passes a multiple of the reaction time, shifted by
    a part of it that the identity sets: multiples of the golden ratio spread these parts evenly,
    and far apart for sisters. It does so at the end of the step that is nearest to that moment, so
    that decisions are neither late nor early on average. With a reaction time up to ``dt`` every
    cell decides in every step.

    ``ahead`` is the length of the next step, s; absent: as that of this one.
    """
    shift = (cells.id + 1) * _GOLDEN % 1.0
    now = np.floor((cells.age + 0.5 * (dt if ahead is None else ahead)) / reaction_time + shift)
    before = np.floor((cells.age - 0.5 * dt) / reaction_time + shift)
    return np.asarray((now > before) | (cells.age < dt))


def apoptotic(
    plan: BiologyPlan, cells: Cells, exposure: Exposure | None, time: float
) -> Mask:
    """Return which cells have reached the end of their life by apoptosis, (n,).

    With a constant rate k lives are distributed exponentially. Each cell draws its own once, keyed
    by its identity, and dies when the time that it has lived in the run passes it: since its birth,
    or since the start for a cell that was there then. An exponential life has no memory, so the age
    of a cell at the start says nothing about what remains. Survivors are N exp(-kt) from t = 0 on,
    and the outcome knows nothing of the coupling step but for the moment at which the death is
    noticed. A rate that responds to signals counts by its integral, against the same draw.

    ``time`` is the end of the step, s.
    """
    rate = plan.base_rates["apoptosis rate"]
    known = plan.responses.get("apoptosis rate")
    if known is None:
        life = random.thresholds(plan.seed, Purpose.APOPTOSIS, 0, cells.id)
        # who was there at the start is older than the run, who was born in it is younger
        return np.asarray(np.minimum(cells.age, time) * rate > life)
    if exposure is None:
        return np.zeros(len(cells), dtype=np.bool_)
    gained = exposure.integral(
        known, lambda found, cells: value_of(plan, "apoptosis rate", rate, found, cells)
    )
    return comes_to_pass(plan, Purpose.APOPTOSIS, cells, "apoptosis_hazard", gained)


def necrotic(
    plan: BiologyPlan, cells: Cells, found: Found, exposure: Exposure | None
) -> Mask:
    """Return which of the cells die by necrosis, (n,).

    All that find what kills at once, now or at a time in the step; and those for which the integral
    of their rate reaches a threshold, so that times until death are distributed exponentially
    whatever the coupling step.
    """
    known, dies = plan.responses["necrosis rate"], np.zeros(len(cells), dtype=np.bool_)

    def rate(found: Found, cells: Cells) -> FloatArray | None:
        return rate_of_harm(plan, "necrosis rate", found, cells)

    if any(math.isinf(part.effect.high) for part in known):
        hazard = rate(found, cells)
        if hazard is not None and np.count_nonzero(hazard):
            dies |= np.isinf(hazard)
    if exposure is not None:
        gained = exposure.integral(known, rate)
        dies |= comes_to_pass(plan, Purpose.NECROSIS, cells, "necrosis_hazard", gained)
    return dies


def damage_after(plan: BiologyPlan, cells: Cells, exposure: Exposure) -> FloatArray:
    """Return the damage of the cells after a step, (n,), in parts of what kills them.

    dD/dt = k/θ, with the damage rate k and the tolerance θ of the cell (gamma, mean 1, drawn once
    by its identity). The dead keep theirs.
    """
    gained = exposure.integral(
        plan.responses["damage rate"],
        lambda found, cells: rate_of_harm(plan, "damage rate", found, cells),
    )
    death, dead = plan.death, cells.dead
    if not gained.any():
        return cells.damage
    if death is not None and death.damage_variation > 0.0:
        from scipy.special import gammainccinv  # loaded where it is used

        hit, shape = np.flatnonzero(gained), death.damage_variation**-2
        u = random.uniform(plan.seed, Purpose.TOLERANCE, 0, cells.id[hit])[:, 0]
        gained[hit] *= shape / gammainccinv(shape, u)
    return np.where(dead, cells.damage, cells.damage + gained)


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
