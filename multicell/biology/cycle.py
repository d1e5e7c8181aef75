"""The cell cycle in phases: G1, S, G2, M, and G0 for cells that rest at the restriction point.

A cell spends in each phase a time that it draws when it enters. In phases in which it grows its
clock runs as fast as growth does (:func:`multicell.biology.growth.growth_factor`), in the others at
its full rate, so that clock and volume agree and the volume doubles between birth and division.
A coupling step may hold any part of a phase or several phases: what is left of the step is spent
in the next one, also after division, so that cycles do not become longer with the step.

At the end of G1 (the restriction point; A. B. Pardee, PNAS 71 (1974) 1286) a cell that finds too
little nutrient or too much pressure goes to G0, and on to S when it decides anew in better
conditions. Where the scene has no restriction, cells become quiescent in any phase.

A phase that a condition ends (``plan.waits``) lasts whatever its duration is: its clock counts all
time since the cell entered it, and when the condition has come true (:mod:`.waiting`) the cell
leaves it at that moment (:func:`leave_phases`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np
from numpy.typing import NDArray

from multicell.biology.draws import draw_lengths
from multicell.biology.growth import growing
from multicell.biology.responding import value_of
from multicell.cells import Cells, FloatArray, IntArray, Mask, Phase, Signals, State
from multicell.scene.parts import CYCLE_PHASES

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan


@final
@dataclass(frozen=True)
class Cycling:
    """Where cells are in their cycle after a step: columns of :class:`Cells`, and volumes."""

    volume: FloatArray
    state: NDArray[np.int8]
    phase: NDArray[np.int8]
    progress: FloatArray
    phase_length: FloatArray


def growing_time(plan: BiologyPlan, lengths: FloatArray, kind: NDArray[np.int16]) -> FloatArray:
    """Return the time in which each cell doubles its volume, (n,) s.

    It spends it in the phases in which it grows, unless the scene states it.
    """
    if plan.doubling is not None:
        return plan.doubling[kind]
    return np.asarray(lengths[:, plan.grows[1:]].sum(axis=1))


def volume_in(
    plan: BiologyPlan,
    phase: NDArray[np.integer],
    volume: FloatArray,
    share: FloatArray,
    birth: float | FloatArray = 1.0,
) -> FloatArray:
    """Return volumes after a share of a cycle without limits in a phase, (n,)."""
    assert plan.law is not None
    if plan.target_scale is None:
        return plan.law.volume_after(volume, share, birth)
    scale = plan.target_scale[phase]
    return np.asarray(scale * plan.law.volume_after(volume / scale, share, birth))


def advance_cycle(
    plan: BiologyPlan,
    cells: Cells,
    factor: FloatArray,
    unfavourable: Mask,
    dt: float,
    pace: FloatArray | None = None,
) -> Cycling:
    """Return where the cells are after a time ``dt`` (s).

    - ``factor``, (n,): how fast cells grow here; see :func:`multicell.biology.growth.growth_factor`
    - ``unfavourable``, (n,) bool: whether a cell would rest here
    - ``pace``, (n, 5) or None: factor of each phase's clock, from :func:`phase_pace`
    """
    now = _now(cells)
    left = np.where((cells.state == State.PROLIFERATING) & (cells.phase != Phase.G0), dt, 0.0)
    grows = plan.grows
    if not grows[Phase.G1] and not plan.waits[Phase.G1]:
        # newborn cells may have spent more of the step than their first phase lasts
        newborn_ones = (left > 0.0) & (now.phase == Phase.G1)
        surplus = np.where(newborn_ones, np.maximum(now.progress - now.phase_length, 0.0), 0.0)
        left += surplus
        now.progress[:] -= surplus
    _spend(plan, cells, now, factor, unfavourable, left, pace)
    return now


def leave_phases(
    plan: BiologyPlan,
    cells: Cells,
    rows: IntArray,
    left: FloatArray,
    volume: FloatArray,
    factor: FloatArray,
    unfavourable: Mask,
    pace: FloatArray | None = None,
) -> Cycling:
    """Return where cells are at the end of a step of which some have left their phase within it.

    - ``rows``, (k,): of these
    - ``left``, (n,): what was left of the step then, s; zero of others. It is overwritten.
    - ``volume``, (k,) µm³: of these then

    ``factor``, ``unfavourable`` and ``pace`` are as in :func:`advance_cycle`.
    """
    now = _now(cells)
    now.volume[rows] = volume
    _change(plan, cells, now, rows, factor, unfavourable, left)
    _spend(plan, cells, now, factor, unfavourable, left, pace)
    return now


def _now(cells: Cells) -> Cycling:
    state, phase = cells.state.copy(), cells.phase.copy()
    return Cycling(cells.volume, state, phase, cells.progress.copy(), cells.phase_length.copy())


def _spend(
    plan: BiologyPlan,
    cells: Cells,
    now: Cycling,
    factor: FloatArray,
    unfavourable: Mask,
    left: FloatArray,
    pace: FloatArray | None,
) -> None:
    """Let cells spend what is left of a step, (n,) s, in their phases."""
    grows, waits = plan.grows, plan.waits
    # a clock that stands still never comes to the end of its phase
    active = np.flatnonzero(left > 0.0)
    while active.size:
        grow = growing(plan, cells, now.phase)[active]
        rate = np.where(grow, factor[active], np.where(grows[now.phase[active]], 0.0, 1.0))
        if pace is not None:
            rate *= pace[active, now.phase[active]]
        needed = np.full(active.size, np.inf)
        to_go = now.phase_length[active] - now.progress[active]
        if waits.any():
            waiting = waits[now.phase[active]]
            rate[waiting], to_go[waiting] = 1.0, np.inf
        np.divide(to_go, rate, out=needed, where=rate > 0.0)
        spent = np.minimum(np.maximum(needed, 0.0), left[active])
        now.progress[active] += rate * spent
        larger = active[grow]
        _grow(plan, cells, now, larger, factor[larger], spent[grow])
        left[active] -= spent
        _change(plan, cells, now, active[needed <= spent], factor, unfavourable, left)
        active = active[(left[active] > 0.0) & (needed <= spent)]


def phase_pace(plan: BiologyPlan, signals: Signals, cells: Cells) -> FloatArray | None:
    """Return the factor of the clock in each phase, (n, 5), or None where nothing responds.

    The response of the entry into a phase sets the pace of the phase before it. Cells grow at
    their own rate all the while: where a phase takes longer, they come out of it larger, beyond
    the volume of division only where the scene has hypertrophy.
    """
    pace = None
    for phase in (Phase.G1, Phase.S, Phase.G2, Phase.M):
        value = value_of(plan, f"entry into {phase.name}", 1.0, signals, cells)
        if value is not None:
            pace = np.ones((len(cells), len(Phase))) if pace is None else pace
            pace[:, Phase.M if phase == Phase.G1 else phase - 1] = value
    return pace


def _grow(
    plan: BiologyPlan,
    cells: Cells,
    now: Cycling,
    index: IntArray,
    factor: FloatArray,
    time: FloatArray,
) -> None:
    """Let cells grow for some time, s, at a part of their unlimited growth."""
    assert plan.law is not None
    kind, cycle = cells.kind[index], cells.cycle_time[index]
    law, birth = plan.law, plan.birth_volumes(kind)
    before = now.volume[index]
    if law.constant:
        after = before + birth / cycle * factor * time
    else:
        share = factor * time / cycle
        after = volume_in(plan, now.phase[index], before, share, birth)
    if not plan.hypertrophy:
        after = np.minimum(after, np.maximum(before, plan.division_volumes(kind)))
    now.volume[index] = after


def _grow_as_two(
    plan: BiologyPlan, cells: Cells, now: Cycling, index: IntArray, ahead: FloatArray
) -> None:
    """Let mothers grow as their two daughters do for some time without limits, s."""
    assert plan.law is not None
    kind, cycle = cells.kind[index], cells.cycle_time[index]
    law, birth = plan.law, plan.birth_volumes(kind)
    if law.constant:
        now.volume[index] += 2.0 * ahead * birth / cycle
        return
    half, first = 0.5 * now.volume[index], np.full(len(index), Phase.G1)
    now.volume[index] = 2.0 * volume_in(plan, first, half, ahead / cycle, birth)


def _change(
    plan: BiologyPlan,
    cells: Cells,
    now: Cycling,
    at_end: IntArray,
    factor: FloatArray,
    unfavourable: Mask,
    left: FloatArray,
) -> None:
    """Lead cells at the end of their phase into the next one."""
    phase = now.phase[at_end]
    ripe = at_end[phase == Phase.M]
    if ripe.size:
        # what is left of the step is the daughters' time in their first phase
        ahead = left[ripe]
        if plan.grows[Phase.G1]:
            newborn = cells.take(ripe)
            newborn.age[:], newborn.phase[:] = 0.0, Phase.G1
            ahead = np.where(growing(plan, newborn), ahead * factor[ripe], 0.0)
            _grow_as_two(plan, cells, now, ripe, ahead)
        now.progress[ripe] = now.phase_length[ripe] + ahead
        left[ripe] = 0.0
    resting = np.zeros(len(at_end), dtype=bool)
    if plan.restricted:
        resting = (phase == Phase.G1) & unfavourable[at_end]
        rest = at_end[resting]
        now.phase[rest], now.state[rest] = Phase.G0, State.QUIESCENT
        now.progress[rest] = now.phase_length[rest] = left[rest] = 0.0
    onward = at_end[(phase != Phase.M) & ~resting]
    now.phase[onward] += 1
    now.progress[onward] = 0.0
    now.phase_length[onward] = _length_of(plan, cells, onward, now.phase[onward])


def leave_rest(plan: BiologyPlan, cells: Cells, wakes: Mask) -> Cells:
    """Return the cells, of which those in G0 that are to continue are in S."""
    awake = np.flatnonzero(wakes & (cells.phase == Phase.G0) & (cells.state == State.QUIESCENT))
    if not awake.size:
        return cells
    state, phase = cells.state.copy(), cells.phase.copy()
    progress, length = cells.progress.copy(), cells.phase_length.copy()
    state[awake], phase[awake], progress[awake] = State.PROLIFERATING, Phase.S, 0.0
    length[awake] = _length_of(plan, cells, awake, phase[awake])
    return cells.changed(state=state, phase=phase, progress=progress, phase_length=length)


def enter_cycle(plan: BiologyPlan, cells: Cells, progress: FloatArray) -> None:
    """Put cells into G1, with the time already spent there."""
    lengths = draw_lengths(plan, cells.id, cells.kind)
    cells.phase = np.full(len(cells), Phase.G1, dtype=np.int8)
    cells.progress = progress
    cells.phase_length = lengths[:, 0].copy()
    cells.cycle_time = growing_time(plan, lengths, cells.kind)


def place_in_cycle(
    plan: BiologyPlan, cells: Cells, lengths: FloatArray, share: FloatArray
) -> FloatArray:
    """Put cells at a share of their cycle, in [0, 1); return their volumes over that at birth.

    ``lengths`` are those of their phases, (n, 4) s.
    """
    cells.cycle_time = growing_time(plan, lengths, cells.kind)
    grows, ends = plan.grows[1:], np.cumsum(lengths, axis=1)
    elapsed = share * ends[:, -1]
    phase = np.minimum((elapsed[:, None] >= ends).sum(axis=1), len(CYCLE_PHASES) - 1)
    rows = np.arange(len(cells))
    cells.phase = (phase + 1).astype(np.int8)
    cells.phase_length = lengths[rows, phase]
    cells.progress = elapsed - (ends[rows, phase] - lengths[rows, phase])
    before = np.arange(len(CYCLE_PHASES)) < phase[:, None]
    growing = (lengths * grows * before).sum(axis=1) + cells.progress * grows[phase]
    cells.age = elapsed
    if plan.target_scale is not None:
        return _volume_through(plan, cells, lengths)
    return volume_ratio(plan, growing / cells.cycle_time)


def volume_ratio(plan: BiologyPlan, share: FloatArray) -> FloatArray:
    """Return the volumes of cells over that at birth after a share of their growing time, (n,)."""
    if plan.law is None:
        return np.asarray(1.0 + share)
    return plan.law.volume_after(np.ones(len(share)), share)


def share_of_growth(plan: BiologyPlan, volume: FloatArray) -> FloatArray:
    """Return the share of their growing time that cells of a volume have behind them, (n,).

    Volumes are over that at birth; those outside growth have none or all of it behind them.
    """
    ratio = np.clip(volume, 1.0, 2.0)
    if plan.law is None:
        return np.asarray(ratio - 1.0)
    return plan.law.share_at(ratio)


def place_by_volume(plan: BiologyPlan, cells: Cells, volume: FloatArray) -> None:
    """Put cells of known cycle times where they have a volume, given over that at birth."""
    lengths = draw_lengths(plan, cells.id, cells.kind)
    grown_for = share_of_growth(plan, volume) * cells.cycle_time
    ends = np.cumsum(lengths * plan.grows[1:], axis=1)
    place = np.minimum((grown_for[:, None] >= ends).sum(axis=1), len(CYCLE_PHASES) - 1)
    rows = np.arange(len(cells))
    before = np.where(place > 0, ends[rows, place - 1], 0.0)
    cells.phase = (place + 1).astype(np.int8)
    cells.phase_length = lengths[rows, place]
    cells.progress = np.minimum(grown_for - before, cells.phase_length)


def time_before_phase(plan: BiologyPlan, cells: Cells) -> FloatArray:
    """Return the time of cells before their phase, (n, 2) s: all time, time of growth.

    Those in G0 have G1 behind them.
    """
    lengths = draw_lengths(plan, cells.id, cells.kind)
    place = np.where(cells.phase == Phase.G0, Phase.S, cells.phase) - 1
    earlier = lengths * (np.arange(len(CYCLE_PHASES)) < place[:, None])
    return np.stack([earlier.sum(axis=1), earlier @ plan.grows[1:]], axis=1)


def volume_in_phase(plan: BiologyPlan, cells: Cells) -> FloatArray:
    """Return the volumes of cells in their phases over those at birth, (n,)."""
    if plan.target_scale is not None:
        return _volume_through(plan, cells, draw_lengths(plan, cells.id, cells.kind))
    elapsed = time_before_phase(plan, cells)[:, 1] + cells.progress * plan.grows[cells.phase]
    return volume_ratio(plan, elapsed / cells.cycle_time)


def _volume_through(plan: BiologyPlan, cells: Cells, lengths: FloatArray) -> FloatArray:
    """Return the volumes over those at birth after phases that have targets of their own, (n,)."""
    volume = np.ones(len(cells))
    place = np.where(cells.phase == Phase.G0, Phase.S, cells.phase)
    for phase in (Phase.G1, Phase.S, Phase.G2, Phase.M):
        spent = np.where(cells.phase == phase, cells.progress, 0.0)
        spent = np.where(place > phase, lengths[:, phase - 1], spent) * plan.grows[phase]
        volume = volume_in(plan, np.full(len(cells), phase), volume, spent / cells.cycle_time)
    return volume


def _length_of(
    plan: BiologyPlan, cells: Cells, index: IntArray, phase: NDArray[np.int8]
) -> FloatArray:
    """Return how long the cells at ``index`` stay in a phase, s."""
    lengths = draw_lengths(plan, cells.id[index], cells.kind[index])
    return np.asarray(lengths[np.arange(len(index)), phase - Phase.G1])
