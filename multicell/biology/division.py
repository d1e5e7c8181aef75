"""Division of a mother into two daughters, and cells that become another type then or at a rate."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from typing import TYPE_CHECKING, NamedTuple, TypeAlias, final

import numpy as np
from numpy.typing import NDArray

from multicell import random
from multicell.biology.cycle import enter_cycle
from multicell.biology.draws import draw_cycle_times, draw_moduli, drift
from multicell.biology.exposure import part_until
from multicell.biology.growth import growing
from multicell.biology.responding import value_of
from multicell.cells import (
    HALF,
    HAZARDS,
    SPHERE,
    Cells,
    FloatArray,
    IntArray,
    Mask,
    Phase,
    Share,
    Signals,
    State,
)
from multicell.random import Purpose
from multicell.vectors import cubes

if TYPE_CHECKING:
    from multicell.behaviours.growth_laws.laws import GrowthLaw
    from multicell.biology.exposure import Exposure
    from multicell.biology.plan import BiologyPlan


# A cell that reaches the division volume up to rounding has reached it: else cells in step with
# the coupling times would divide in this step or the next at the whim of the last bit.
ROUNDING = 1e-12

_NONE: Signals = {}

_AT_BIRTH = ("mutation to", "asymmetric division to")
"""Behaviours that are chances of each daughter, and of exactly one, to be of another type."""
_CHANCES = tuple(f"{behaviour} " for behaviour in _AT_BIRTH)
NOBODY = np.empty(0, dtype=np.int64)


@final
class Turns(NamedTuple):
    """Living cells that die or become another type within a step.

    - ``row``, (k,), and ``part``, (k,): of the step
    - ``kind``, ``becomes``, (k,): types before and after
    - ``dies``, (k,) bool
    """

    row: IntArray
    part: FloatArray
    kind: NDArray[np.integer]
    becomes: NDArray[np.integer]
    dies: Mask


BirthChances: TypeAlias = "Sequence[FloatArray | None]"
"""For each behaviour at a division the chances of each type, (n, types), or None."""

_GROWING = int(State.PROLIFERATING)  # numbers compare with arrays faster than names do


def due_to_divide(plan: BiologyPlan, cells: Cells) -> Mask:
    """Return which cells are at the end of their cycle, (n,); ``plan`` is one with growth."""
    if plan.phased and plan.waits[Phase.M]:  # it divides when what it waits for comes true
        return np.zeros(len(cells), bool)
    if plan.phased:
        ripe = (cells.phase == Phase.M) & (cells.progress >= cells.phase_length)
    else:
        ripe = cells.volume >= plan.division_volumes(cells.kind) * (1.0 - ROUNDING)
    return np.asarray(ripe & (cells.state == _GROWING))


def divide(
    plan: BiologyPlan,
    cells: Cells,
    next_id: int,
    dt: float = 0.0,
    signals: Signals = _NONE,
    factor: float | FloatArray = 1.0,
    since: FloatArray | None = None,
    share: Share | None = None,
) -> tuple[Cells, int]:
    """Divide all proliferating cells at the end of M, or at the division volume without phases.

    Each mother is replaced by two daughters of half her volume, at +- r (1 - 2^(-1/3)) from her
    centre along a random axis, r her radius: volume and centre of mass are conserved and the
    daughters stay within the mother. A mother that passed the division volume within the step was
    two daughters since: each has half of the division volume, and its growth in the rest of the
    step by its own cycle time. A cell that is doomed to die at this division does not divide.

    Random numbers depend on seed and identity only, and identities are given in the order in which
    mothers came to divide, so that other coupling steps leave draws as they are.

    - ``next_id``: first identity that is free
    - ``dt``: length of the coupling step that has ended, s: no mother can have waited for longer
    - ``factor``, (n,) or one for all: part of unlimited growth at which they have grown in the step
    - ``since``, (n,) s: how long before its end those divided that a condition lets divide; NaN of
      others, absent: there are none
    - ``share``: by which threads share the copying

    Returns cells: the cells that did not divide, in their old order, followed by the daughters in
    the order of their identities. The daughters have the age of that rest, the mother's pressure
    and Poisson ratio and damage, and draw cycle time and modulus anew unless these are heritable;
    next_id: first identity that is free now; it has grown by two a division.
    """
    born = births(plan, cells, next_id, dt, signals, factor, since)
    if born is None:
        return cells, next_id
    ripe, _, daughters = born
    return cells.replaced(~ripe, daughters, share), int(daughters.id[-1]) + 1


def births(
    plan: BiologyPlan,
    cells: Cells,
    next_id: int,
    dt: float = 0.0,
    signals: Signals = _NONE,
    factor: float | FloatArray = 1.0,
    since: FloatArray | None = None,
) -> tuple[Mask, IntArray, Cells] | None:
    """Return which cells :func:`divide`, (n,), the row of each daughter's mother, and daughters.

    None where no cell does.
    """
    if plan.growth is None:
        return None
    ripe = due_to_divide(plan, cells)
    if since is not None:
        ripe |= ~np.isnan(since)
    if not np.count_nonzero(ripe) or not np.count_nonzero(ripe := ripe & (cells.doomed != 1)):
        return None
    (rows,) = ripe.nonzero()
    rate = factor[rows] if isinstance(factor, np.ndarray) else np.full(len(rows), factor)
    waited, volume = _waited(plan, cells, rows, dt * rate)
    age = np.maximum(waited, 0.0)
    if not plan.phased or plan.grows[Phase.G1]:
        age = np.divide(age, rate, out=np.zeros(len(age)), where=rate > 0.0)
    if since is not None:
        age = np.where(np.isnan(since[rows]), age, since[rows])
    order = np.repeat(np.lexsort((cells.id[rows], -age)), 2)
    mother = rows[order]
    ids = np.arange(next_id, next_id + len(mother), dtype=np.int64)
    chances = [
        None if of_all is None else of_all[mother]
        for of_all in _chances_at_birth(plan, signals, cells)
    ]
    daughters = _daughters(plan, cells.take(mother), ids, chances)
    daughters.age = age[order]
    if plan.waits[Phase.G1]:
        daughters.progress = daughters.age.copy()
    if not plan.phased:
        _grow_since(plan, daughters, volume[order], waited[order])
    return ripe, mother, daughters


def _waited(
    plan: BiologyPlan, cells: Cells, rows: IntArray, longest: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return how long mothers have grown beyond their division, and their volumes then.

    - ``rows``, (n,): of the mothers among the cells
    - ``longest``, (n,) s: no mother has waited for longer

    Returns (n,) s of unlimited growth; (n,) µm³.
    """
    volume = SPHERE * cubes(cells.radius[rows])
    if plan.phased:
        return cells.progress[rows] - cells.phase_length[rows], volume
    assert plan.law is not None
    kind, cycle = cells.kind[rows], cells.cycle_time[rows]
    birth, due = plan.birth_volumes(kind), np.full(len(rows), plan.division_volumes(kind))
    # what exceeds that was there before the step: a table said so
    most = np.minimum(volume, plan.law.volume_after(due, longest / cycle, birth))
    shares = plan.law.share_at(most / birth) - plan.law.share_at(due / birth)
    return np.asarray(np.maximum(shares, 0.0) * cycle), np.asarray(volume - (most - due))


def _daughters(
    plan: BiologyPlan,
    daughters: Cells,
    ids: IntArray,
    chances: BirthChances,
) -> Cells:
    """Return two daughters for each mother, side by side, named ``ids``.

    - ``daughters``: copies of the mothers, two of each side by side, which become the daughters
    - ``chances``: of the daughters to be of each type
    """
    mothers, width = daughters.id[0::2], daughters.radius[0::2]
    axis = random.directions(plan.seed, Purpose.AXIS, 0, mothers, plan.dimensions)
    offset = (width * (1.0 - HALF))[:, None] * axis
    daughters.position[0::2] += offset
    daughters.position[1::2] -= offset
    daughters.parent = daughters.id
    daughters.id = ids
    daughters.radius = daughters.radius * HALF
    daughters.doomed = np.maximum(daughters.doomed, 1) - np.int8(1)
    for name in HAZARDS:  # with thresholds of their own
        if (column := getattr(daughters, name)) is not None:
            setattr(daughters, name, np.zeros_like(column))
    since = daughters.progress - daughters.phase_length  # by the clock that brought the mother here
    mutate(plan, daughters, chances, int(ids[0]))
    drift(plan, daughters)
    if "young" not in plan.cells.heritable:
        daughters.young = draw_moduli(plan, ids, daughters.kind)
    if plan.phased:
        enter_cycle(plan, daughters, since)
    elif "cycle_time" not in plan.cells.heritable:
        daughters.cycle_time = draw_cycle_times(plan, ids, daughters.kind)
    return daughters


def _grow_since(
    plan: BiologyPlan, daughters: Cells, mother: FloatArray, waited: FloatArray
) -> None:
    """Let daughters grow since the division, by their own cycle times.

    - ``mother``, (n,) µm³: volume at which the mother of each divided
    - ``waited``, (n,): time since then, s of unlimited growth
    """
    assert plan.law is not None
    share = np.where(growing(plan, daughters), waited / daughters.cycle_time, 0.0)
    volume = plan.law.volume_after(0.5 * mother, share, plan.birth_volumes(daughters.kind))
    daughters.radius = np.cbrt(volume / SPHERE)


def change_types(
    plan: BiologyPlan, cells: Cells, exposure: Exposure, found: list[Turns] | None = None
) -> Cells:
    """Return the cells after those have changed their type whose time came in a step.

    A living cell changes when the integral of all its rates k_j of becoming type j reaches its
    threshold, and then becomes j by the share of k_j: a Markov chain. From then on it is exposed as
    a cell of that type, with a new threshold, and may change again in the same step.

    - ``found``: list that the changes are added to
    """
    known = tuple(part for name in changing(plan.responses) for part in plan.responses[name])
    after, rows = cells.shared(), (~cells.dead).nonzero()[0]
    integral, count = np.zeros(len(cells)), np.zeros(len(cells), dtype=np.int64)
    if cells.change_hazard is not None:
        integral += cells.change_hazard
    if cells.type_changes is not None:
        count += cells.type_changes
    exposure, since = exposure[rows], np.zeros(len(rows))
    by_type = partial(_by_type, plan, "change to")
    while rows.size:
        rates = exposure.integral(known, by_type, since)
        gained = rates.sum(axis=1)
        part = part_until(plan, Purpose.CHANGE, cells.id[rows], integral[rows], gained, count[rows])
        integral[rows] += gained
        turns = np.isfinite(part).nonzero()[0]
        rows, exposure = rows[turns], exposure[turns]
        since = exposure.reached(known, by_type, part[turns], since[turns])
        ends = np.cumsum(rates[turns], axis=1)
        u = random.uniform(plan.seed, Purpose.CHANGE, count[rows], cells.id[rows], attempt=1)
        kinds = np.minimum((u * ends[:, -1:] >= ends).sum(axis=1), len(plan.types) - 1)
        if found is not None:
            found.append(Turns(rows, since, after.kind[rows], kinds, np.zeros(len(rows), bool)))
        _become(plan, after, rows, kinds)
        exposure.cells.kind = after.kind[rows]
        integral[rows] = 0.0
        count[rows] += 1
    after.change_hazard, after.type_changes = integral, count
    return after


def changing(behaviours: Iterable[str]) -> list[str]:
    """Return which of the behaviours are rates of becoming another type."""
    return [name for name in behaviours if name.startswith("change to ")]


def mutate(plan: BiologyPlan, daughters: Cells, chances: BirthChances, first: int) -> None:
    """Let daughters be of other types by ``chances``; ``first``: identity of any first daughter."""
    if all(one is None for one in chances):
        return
    kinds = _kinds_at_birth(plan, daughters, chances, first)
    turns = (kinds != daughters.kind).nonzero()[0]
    _become(plan, daughters, turns, kinds[turns])


def _chances_at_birth(plan: BiologyPlan, signals: Signals, cells: Cells) -> BirthChances:
    """Return the chances of cells for each behaviour at a division."""
    return [_by_type(plan, behaviour, signals, cells) for behaviour in _AT_BIRTH]


def _kinds_at_birth(
    plan: BiologyPlan, daughters: Cells, chances: BirthChances, first: int
) -> IntArray:
    """Return the types of daughters that are of their mothers'.

    Chances that add up to more than one leave none of the mother's type.
    """
    kinds = daughters.kind.astype(np.int64)
    of_each, of_one = chances
    if of_each is not None:
        u = random.uniform(plan.seed, Purpose.MUTATION, 0, daughters.id)
        kinds = _drawn(u, of_each, kinds)
    if of_one is not None:  # one draw of the mother: it is the second daughter or none
        u = random.uniform(plan.seed, Purpose.ASYMMETRY, 0, daughters.parent)
        second = are_second(daughters.id, first)[:, None]
        kinds = _drawn(u, np.where(second, of_one, 0.0), kinds)
    return kinds


def are_second(ids: IntArray, first: int) -> Mask:
    """Return which daughters are the second of their mothers, (n,), also where a sister is gone.

    Identities are given in pairs: a second daughter's differs from that of any ``first`` one, or
    from the first that is free, by an odd number.
    """
    return np.asarray((ids - first) % 2 == 1)


def _drawn(u: FloatArray, chances: FloatArray, kinds: IntArray) -> IntArray:
    """Return the types that uniform numbers (n, 1) choose by chances (n, types), else ``kinds``."""
    ends = np.cumsum(chances, axis=1)
    return np.where(u[:, 0] < ends[:, -1], (u >= ends).sum(axis=1), kinds)


def mutate_as_found(
    plan: BiologyPlan, cells: Cells, exposure: Exposure, first: int
) -> tuple[Cells, IntArray]:
    """Return cells with the types that daughters of a step have by what they found at their birth.

    When they were born only what their mothers had found at the step's beginning was known. Also
    returns the rows of those whose type that changes.

    - ``first``: identity of any first daughter
    """
    if cells.id is exposure.began.id:  # no cell was born
        return cells, NOBODY
    known = tuple(
        part for name, of in plan.responses.items() if name.startswith(_CHANCES) for part in of
    )
    if not known:
        return cells, NOBODY
    mothers, row = exposure.began, exposure.row
    rows = ((mothers.id[row] != cells.id) & ~cells.dead).nonzero()[0]
    if not rows.size:
        return cells, rows
    born = exposure[rows]
    born.cells.kind = mothers.kind[row[rows]]
    part = 1.0 - born.cells.age / exposure.length
    chances = [
        born.at(part, known, partial(_by_type, plan, behaviour))
        if any(name.startswith(f"{behaviour} ") for name in plan.responses)
        else None
        for behaviour in _AT_BIRTH
    ]
    kinds = _kinds_at_birth(plan, born.cells, chances, first)
    wrong = (kinds != cells.kind[rows]).nonzero()[0]
    after = cells.shared()
    _become(plan, after, rows[wrong], kinds[wrong])
    return after, rows[wrong]


def _by_type(
    plan: BiologyPlan, behaviour: str, signals: Signals, cells: Cells
) -> FloatArray | None:
    """Return the values of a behaviour for each type, (n, types), zero for the cell's own."""
    out = None
    for number, name in enumerate(plan.types):
        value = value_of(plan, f"{behaviour} {name}", 0.0, signals, cells)
        if value is not None:
            out = np.zeros((len(cells), len(plan.types))) if out is None else out
            out[:, number] = np.where(cells.kind == number, 0.0, value)
    return out


def _become(plan: BiologyPlan, cells: Cells, index: IntArray, kinds: IntArray) -> None:
    """Make cells of other types: what the types scale is then as if they had been born so.

    Their place in the cycle stays: the part of the phase that is behind them, their volume, and the
    volume that they have yet to make good. One of a type that divides at another volume grows to
    that from the volume it has.
    """
    before, kind = cells.kind[index], cells.kind.copy()
    kind[index] = kinds
    pace = plan.cycle_scale if plan.doubling is None else plan.doubling
    for name, values in (
        ("young", plan.young_ratio),
        ("cycle_time", pace),
        ("lag", pace),
        ("progress", plan.cycle_scale),
        ("phase_length", plan.cycle_scale),
    ):
        if values is not None:
            column = getattr(cells, name).copy()
            column[index] *= values[kinds] / values[before]
            setattr(cells, name, column)
    if plan.volume_scale is not None and plan.law is not None:
        cells.lag = _owing_as_much(plan, plan.law, cells, index, kinds)
    cells.kind = kind


def _owing_as_much(
    plan: BiologyPlan, law: GrowthLaw, cells: Cells, index: IntArray, kinds: IntArray
) -> FloatArray:
    """Return the lags of cells, (n,) s, at which those of other types owe the same volumes.

    Cells that do not grow at all at their volume as the new type makes good nothing.
    """
    volume, lag = cells.volume[index], cells.lag.copy()
    scale = 1.0 if plan.target_scale is None else plan.target_scale[cells.phase[index]]
    rate, now = (
        law.rate(volume / scale, plan.birth_volumes(kind)) for kind in (cells.kind[index], kinds)
    )
    lag[index] *= np.divide(rate, now, out=np.zeros(len(now)), where=now > 0.0)
    return lag
