"""States of cells: proliferation, rest and death by their signals, and removal of the dead.

**Why cells do not all react at once.** A resting cell takes up less nutrient. If all cells compared
the field with the threshold at every coupling step, those near it would rest together, the field
would recover, all would wake together, and the field would fall again: half of a spheroid was seen
to switch in every step, and cells died in the troughs. The oscillation is made by the coupling
step, not by the model: the steady state has a layer at the threshold in which a part of the cells
rests. So each cell decides at birth and then once in a reaction time, at times of its own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from multicell import random
from multicell.biology.division import ROUNDING, due_to_divide
from multicell.biology.exposure import finite_rate, part_until
from multicell.biology.growth import shrunk
from multicell.biology.responding import rate_of, rate_of_harm, wants_rest
from multicell.cells import SPHERE, Cells, FloatArray, IntArray, Mask, Phase, Signals, State
from multicell.random import GOLDEN, Purpose

if TYPE_CHECKING:
    from multicell.biology.exposure import Exposure, Rate
    from multicell.biology.plan import BiologyPlan
    from multicell.biology.responding import Known
    from multicell.scene.radiation import Radiation


# arrays compare with numbers of their own type faster than with names
_GROWING, _RESTING, _NECROTIC, _APOPTOTIC = (np.int8(state) for state in State)


@final
class Deaths(NamedTuple):
    """When in the last step cells die, and their exposure until its end.

    - ``necrosis``, ``apoptosis``, (n,): parts of the step after which they die of it; infinite:
      not; None where nobody does
    - ``columns``, name -> (n,): damage and integrals of rates, where they have changed
    """

    necrosis: FloatArray | None
    apoptosis: FloatArray | None
    columns: Mapping[str, FloatArray] = MappingProxyType({})


def update_states(
    plan: BiologyPlan,
    cells: Cells,
    signals: Signals,
    dying: Deaths | None = None,
    *,
    dt: float | None = None,
    ahead: float | None = None,
) -> NDArray[np.int8]:
    """Return the new state of each cell.

    One that is dying (:func:`deaths`) turns necrotic or apoptotic, and stays so for ever.
    Another cell that is due to decide
    (:func:`deciding`) rests (quiescent) if a response lets it
    (:func:`multicell.biology.responding.wants_rest`), and proliferates if none does. Where nothing
    makes cells quiescent, their states stay as they are.

    - ``dying``: from :func:`deaths`; absent: those who find what kills at once
    - ``dt``, ``ahead``: lengths of the step that has ended and of the next one, s; absent: the
      usual one

    Returns (n,) int8: values of :class:`multicell.cells.State`; if none changes ``cells.state``.
    """
    state = cells.state
    if plan.may_rest and not plan.restricted:
        wanted = np.where(wants_rest(plan, cells, signals), _RESTING, _GROWING)
        if np.count_nonzero(wanted != state):  # else it does not matter who is due
            due = deciding(cells, dt or plan.coupling_step, plan.cells.reaction_time, ahead)
            state = np.where(due & ~cells.dead, wanted, state)
    necrosis, apoptosis, _ = deaths(plan, cells, signals) if dying is None else dying
    for new, part in ((_NECROTIC, necrosis), (_APOPTOTIC, apoptosis)):
        if part is not None:
            state = np.where(np.isfinite(part) & ~cells.dead, new, state)
    return state


def deaths(
    plan: BiologyPlan,
    cells: Cells,
    signals: Signals,
    exposure: Exposure | None = None,
    time: float = 0.0,
) -> Deaths:
    """Return when in the last step cells die, with their damage and integrals of rates.

    By necrosis where they find what kills at once, by the rate that their responses give, or with
    as much damage as they bear. By apoptosis at the end of their lives, and at the end of the cycle
    where irradiation has doomed them to die in place of this division.

    - ``exposure``: to the signals of the step; absent at the start of a run
    - ``time``: the end of that step, s; 0 at the start of a run
    """
    necrosis = apoptosis = None
    columns: dict[str, FloatArray] = {}
    if "necrosis rate" in plan.responses:
        necrosis = necrotic(plan, cells, signals, exposure, columns)
    if exposure is not None and "damage rate" in plan.responses:
        necrosis = _earlier(necrosis, take_damage(plan, cells, exposure, columns))
    if plan.growth is not None and np.count_nonzero(last := cells.doomed == 1):
        due = (last & due_to_divide(plan, cells)).nonzero()[0]
        apoptosis = _earlier(apoptosis, _only(due, _since_due(plan, cells, exposure, due), cells))
    if "apoptosis rate" in plan.base_rates:
        apoptosis = _earlier(apoptosis, apoptotic(plan, cells, exposure, time, columns))
    part = _earlier(necrosis, apoptosis)
    if exposure is not None and columns and part is not None:
        _end_with_death(plan, cells, exposure, part, columns)
    return Deaths(necrosis, apoptosis, columns)


def _end_with_death(
    plan: BiologyPlan,
    cells: Cells,
    exposure: Exposure,
    part: FloatArray,
    columns: dict[str, FloatArray],
) -> None:
    """Let damage and integrals of cells that die be those until their death, at parts of a step."""
    rows = ((part < 1.0) & ~cells.dead).nonzero()[0]
    if not rows.size:
        return
    some, ended = cells.take(rows), exposure[rows]
    ended.until = part[rows]
    found: dict[str, FloatArray] = {}
    if "damage" in columns:
        take_damage(plan, some, ended, found)
    for name, column, rate in (
        ("necrosis rate", "necrosis_hazard", finite_rate),
        ("apoptosis rate", "apoptosis_hazard", rate_of),
    ):
        if column in columns:
            gained = ended.integral(plan.responses[name], partial(rate, plan, name))
            before = getattr(some, column)
            found[column] = gained if before is None else before + gained
    for column, values in columns.items():
        there = found.get(column, getattr(some, column))
        # a threshold kills, which rounding may just miss
        full = column == "damage" and there >= 1.0 - 2.0 * ROUNDING
        values[rows] = np.where(full, 1.0, there)


def _earlier(first: FloatArray | None, second: FloatArray | None) -> FloatArray | None:
    if first is None or second is None:
        return second if first is None else first
    return np.minimum(first, second)


def _only(rows: IntArray, part: FloatArray, cells: Cells) -> FloatArray:
    """Return the parts of some cells, infinite for the others, (n,)."""
    every = np.full(len(cells), np.inf)
    every[rows] = part
    return every


def _since_due(
    plan: BiologyPlan, cells: Cells, exposure: Exposure | None, rows: IntArray
) -> FloatArray:
    """Return at which part of a step cells came to the end of their cycle, (k,)."""
    if exposure is None:
        return np.ones(len(rows))
    if plan.phased:
        over = (cells.progress[rows] - cells.phase_length[rows]) / exposure.length
        return np.clip(1.0 - over, 0.0, 1.0)
    first, last = (exposure[rows].volume_at(np.full(len(rows), end)) for end in (0.0, 1.0))
    grown = np.where(last > first, last - first, 1.0)
    due = plan.division_volumes(cells.kind[rows])
    return np.clip((due - first) / grown, 0.0, 1.0)


def die(
    plan: BiologyPlan, cells: Cells, died: Mask, dying: Deaths, exposure: Exposure | None
) -> tuple[Cells, float]:
    """Return cells of which some are dead since their time in the step, and the volume lost, µm³.

    They have grown until then, and shrunk since.
    """
    part = _earlier(dying.necrosis, dying.apoptosis)
    age = np.where(died, 0.0, cells.age)
    if exposure is None or part is None or plan.death is None:
        return cells.changed(age=age), 0.0
    rows = died.nonzero()[0]
    volume = exposure[rows].volume_at(part[rows])
    age[rows] = np.minimum((1.0 - part[rows]) * exposure.length, cells.age[rows])
    birth = plan.birth_volumes(cells.kind[rows])
    left = shrunk(plan.death, birth, volume, cells.state[rows], 0.0, age[rows])
    radius = cells.radius.copy()
    radius[rows] = np.cbrt(left / SPHERE)
    return cells.changed(age=age, radius=radius), float((volume - left).sum())


def rest_from_birth(cells: Cells, before: NDArray[np.int8], exposure: Exposure) -> Cells:
    """Return cells of which daughters that come to rest have rested since they were born.

    Others decide at the end that is nearest to their time, and neither early nor late on average;
    daughters would always be late.

    - ``before``, (n,): states until now
    """
    if cells.id is exposure.began.id:  # no cell was born
        return cells
    rows = ((cells.state == _RESTING) & (before == _GROWING)).nonzero()[0]
    if rows.size:
        rows = rows[exposure.began.id[exposure.row[rows]] != cells.id[rows]]
    if not rows.size:
        return cells
    birth = np.maximum(1.0 - cells.age[rows] / exposure.length, 0.0)
    radius = cells.radius.copy()
    radius[rows] = np.cbrt(exposure[rows].volume_at(birth) / SPHERE)
    return cells.changed(radius=radius)


def deciding(cells: Cells, dt: float, reaction_time: float, ahead: float | None = None) -> Mask:
    """Return which cells decide in a step of length ``dt`` (s) that ends now, (n,).

    A cell decides at birth and whenever its age passes a multiple of the reaction time, shifted by
    a part of it that the identity sets: multiples of the golden ratio spread these parts evenly,
    and far apart for sisters. It does so at the end of the step that is nearest to that moment, so
    that decisions are neither late nor early on average. With a reaction time up to ``dt`` every
    cell decides in every step.

    ``ahead`` is the length of the next step, s; absent: as that of this one.
    """
    turns = (cells.id + 1) * GOLDEN
    shift = turns - np.floor(turns)  # what % gives, in a tenth of its time
    now = np.floor((cells.age + 0.5 * (dt if ahead is None else ahead)) / reaction_time + shift)
    before = np.floor((cells.age - 0.5 * dt) / reaction_time + shift)
    return np.asarray((now > before) | (cells.age < dt))


def apoptotic(
    plan: BiologyPlan,
    cells: Cells,
    exposure: Exposure | None,
    time: float,
    columns: dict[str, FloatArray],
) -> FloatArray | None:
    """Return at which part of a step living cells come to the end of their life, (n,).

    With a constant rate k lives are distributed exponentially. Each cell draws its own once, keyed
    by its identity, and dies when the time that it has lived in the run passes it: since its birth,
    or since the start for a cell that was there then. An exponential life has no memory, so the age
    of a cell at the start says nothing about what remains. Survivors are N exp(-kt) from t = 0 on,
    and the outcome knows nothing of the coupling step but for the moment at which the death is
    noticed. A rate that responds to signals counts by its integral, against the same draw.

    - ``time``: the end of the step, s
    - ``columns``: where the integral of such a rate is noted
    """
    rate = plan.base_rates["apoptosis rate"]
    known = plan.responses.get("apoptosis rate")
    if exposure is not None and known is not None:
        rate_now = partial(rate_of, plan, "apoptosis rate")
        whole = Purpose.APOPTOSIS, "apoptosis_hazard", known, rate_now
        return _part_until_death(plan, cells, exposure, columns, *whole)
    if known is not None:
        return None
    # who was there at the start is older than the run, who was born in it is younger
    lived = np.minimum(cells.age, time) * rate
    life = random.thresholds(plan.seed, Purpose.APOPTOSIS, 0, cells.id)
    over = ((lived > life) & ~cells.dead).nonzero()[0]
    if not over.size:
        return None
    late = (lived[over] - life[over]) / rate
    part = 1.0 - late / exposure.length if exposure is not None else np.ones(len(over))
    return _only(over, np.maximum(part, 0.0), cells)


def necrotic(
    plan: BiologyPlan,
    cells: Cells,
    signals: Signals,
    exposure: Exposure | None,
    columns: dict[str, FloatArray],
) -> FloatArray | None:
    """Return at which part of a step living cells die by necrosis, (n,).

    Where they first find what kills at once; and where the integral of their rate reaches a
    threshold, so that times until death are distributed exponentially whatever the coupling step.
    That integral is noted in ``columns``.
    """
    known, part = plan.responses["necrosis rate"], None
    if any(math.isinf(response.effect.high) for response in known):
        hazard = rate_of_harm(plan, "necrosis rate", signals, cells)
        now = np.zeros(len(cells), dtype=np.bool_) if hazard is None else np.isinf(hazard)
        rows = now.nonzero()[0]
        if exposure is not None and exposure.inner:
            rows = np.arange(len(cells))
        if rows.size and (rows := rows[~cells.dead[rows]]).size:
            first = np.full(len(rows), np.inf)
            if exposure is not None:
                first = exposure[rows].first_infinite(
                    known, partial(rate_of, plan, "necrosis rate")
                )
            part = _only(rows, np.where(now[rows], np.minimum(first, 1.0), first), cells)
    if exposure is not None and "necrosis rate" in plan.acting:
        rate = partial(finite_rate, plan, "necrosis rate")
        whole = Purpose.NECROSIS, "necrosis_hazard", known, rate
        part = _earlier(part, _part_until_death(plan, cells, exposure, columns, *whole))
    return part


def _part_until_death(
    plan: BiologyPlan,
    cells: Cells,
    exposure: Exposure,
    columns: dict[str, FloatArray],
    purpose: Purpose,
    column: str,
    responses: Known,
    rate: Rate,
) -> FloatArray:
    """Return at which part of a step the integral of a rate kills living cells, (n,); it is noted.

    Infinite where they do not; ``column`` is the integral's name, one of
    :data:`multicell.cells.HAZARDS`, and ``columns`` where it is noted.
    """
    gained = np.where(cells.dead, 0.0, exposure.integral(responses, rate))
    known = getattr(cells, column)
    before = np.zeros(len(cells)) if known is None else known
    if known is not None or gained.any():
        columns[column] = before + gained
    share = part_until(plan, purpose, cells.id, before, gained)
    return _when(exposure, responses, rate, share)


def _when(exposure: Exposure, known: Known, rate: Rate, share: FloatArray) -> FloatArray:
    """Return at which parts of a step integrals come to shares of their gain, (n,)."""
    rows = np.isfinite(share).nonzero()[0]
    part = share.copy()
    if rows.size:
        part[rows] = exposure[rows].reached(known, rate, share[rows])
    return part


def take_damage(
    plan: BiologyPlan, cells: Cells, exposure: Exposure, columns: dict[str, FloatArray]
) -> FloatArray:
    """Return after which part of a step cells bear no more damage, (n,).

    Damage counts in parts of what kills a cell: dD/dt = k/θ, with the damage rate k and the
    tolerance θ of the cell (gamma, mean 1, drawn once by its identity). The dead keep theirs.
    Where any is taken, all of it is noted in ``columns``.
    """
    before = damage = cells.damage
    known, rate = plan.responses["damage rate"], partial(rate_of, plan, "damage rate")
    if plan.death is not None and plan.death.repair_rate > 0.0:
        return _take_and_heal(plan, cells, exposure, columns)
    gained, two_rates = np.where(cells.dead, 0.0, exposure.integral(known, rate)), None
    hit = gained.nonzero()[0]
    if plan.death is not None and plan.death.damage_variation > 0.0 and hit.size:
        born = hit[exposure.began.id[exposure.row[hit]] != cells.id[hit]]
        # before its birth a daughter bore the damage of its mother
        since = 1.0 - cells.age[born] / exposure.length
        later = exposure[born].integral(known, rate, since)
        earlier = (gained[born] - later) / _tolerance(plan, cells.parent[born])
        gained[born] = later
        gained[hit] /= _tolerance(plan, cells.id[hit])
        gained[born] += earlier
        two_rates = born
    if gained.any():
        columns["damage"] = damage = before + gained
    most = 1.0 - ROUNDING
    dies = (damage >= most) & ~cells.dead
    left = np.divide(most - before, gained, out=np.zeros(len(cells)), where=dies & (gained > 0.0))
    share = np.where(dies, np.clip(left, 0.0, 1.0), np.inf)
    part = _when(exposure, known, rate, share)
    if two_rates is not None:  # their mothers bore another amount
        part[two_rates] = share[two_rates]
    return part


def _take_and_heal(
    plan: BiologyPlan, cells: Cells, exposure: Exposure, columns: dict[str, FloatArray]
) -> FloatArray:
    """Do the same where damage heals: dD/dt = k/θ - ρ D with the repair rate ρ.

    In each piece of the step k is one number, and the equation is solved in closed form.
    """
    assert plan.death is not None
    repair, damage, most = plan.death.repair_rate, cells.damage.copy(), 1.0 - ROUNDING
    born, tolerance = np.zeros(len(cells)), np.ones(len(cells))
    mothers = tolerance
    if plan.death.damage_variation > 0.0:
        newborn = exposure.began.id[exposure.row] != cells.id
        born[newborn] = 1.0 - cells.age[newborn] / exposure.length
        tolerance = _tolerance(plan, cells.id)
        mothers = np.where(newborn, _tolerance(plan, np.maximum(cells.parent, 0)), tolerance)
    first = np.full(len(cells), np.inf)
    known, rate = plan.responses["damage rate"], partial(rate_of, plan, "damage rate")
    for begin, end, taken in exposure.pieces(known, rate):
        turn = np.clip(born, begin, end)
        for low, high, bears in ((begin, turn, mothers), (turn, end, tolerance)):
            limit = taken / (bears * repair)  # where taking and healing are in balance
            left = limit + (damage - limit) * np.exp(-repair * (high - low) * exposure.length)
            passes = np.isinf(first) & (left >= most) & (high > low)
            # limit > most >= damage, but for cells that were beyond it before
            away = np.where(passes & (damage < most), (limit - damage) / (limit - most), 1.0)
            since = np.log(away) / (repair * exposure.length)
            first = np.where(passes, np.minimum(low + since, high), first)
            damage = left
    first[cells.dead] = np.inf
    damage = np.where(np.isfinite(first), 1.0, np.where(cells.dead, cells.damage, damage))
    if not np.array_equal(damage, cells.damage):
        columns["damage"] = damage
    return first


def _tolerance(plan: BiologyPlan, ids: IntArray) -> FloatArray:
    """Return the damage that cells bear over that of a mean one, (n,)."""
    from scipy.special import gammainccinv  # loaded where it is used

    assert plan.death is not None
    shape = plan.death.damage_variation**-2
    u = random.uniform(plan.seed, Purpose.TOLERANCE, 0, ids)[:, 0]
    return np.asarray(gammainccinv(shape, u) / shape)


def lysed(plan: BiologyPlan, cells: Cells) -> Mask | None:
    """Return which dead cells are below ``removal_fraction`` of the birth volume; None for none."""
    if plan.death is None or not np.count_nonzero(dead := cells.dead):
        return None
    smallest = plan.death.removal_fraction * plan.birth_volumes(cells.kind)
    gone = dead & (cells.volume < smallest)
    return gone if np.count_nonzero(gone) else None


def irradiate(
    plan: BiologyPlan, cells: Cells, signals: Signals, begin: float, end: float
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
                _kill(part, after, (u[:, 0] >= _survival(plan, part, after, signals)) & ~after.dead)
    dead = after.dead & ~cells.dead
    if dead.any():
        after.age = np.where(dead, 0.0, after.age)
    return after, dead


def _survival(plan: BiologyPlan, part: Radiation, cells: Cells, signals: Signals) -> FloatArray:
    """Return the probability of each cell to survive a fraction, (n,)."""
    known = part.phase_factor or {}
    factor = np.array([known.get(phase.name, 1.0) for phase in Phase])[cells.phase]
    if part.types:
        factor *= np.isin(cells.kind, [list(plan.types).index(kind) for kind in part.types])
    pressure = signals[part.oxygen] / plan.solubility[part.oxygen] if part.oxygen else np.inf
    return np.asarray(part.survival(pressure, factor))


def _kill(part: Radiation, cells: Cells, lost: Mask) -> None:
    """Let cells die at once, or at one of their next divisions."""
    left = np.int8(part.mitotic_divisions)
    if left:
        sooner = lost & ((cells.doomed == 0) | (cells.doomed > left))
        cells.doomed = np.where(sooner, left, cells.doomed)
    else:
        cells.state = np.where(lost, np.int8(State.APOPTOTIC), cells.state)
