"""The biology of a coupling step: growth, events, and decisions.

Each function returns a new population, or what is needed to make one, and changes none.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple, final

import numpy as np

from multicell.biology.cycle import Cycling, advance_cycle, leave_rest, phase_pace
from multicell.biology.division import NOBODY, births
from multicell.biology.growth import corrected_factor, volumes_after
from multicell.biology.motion import bond_levels
from multicell.biology.responding import wants_rest
from multicell.biology.states import (
    deaths,
    deciding,
    die,
    lysed,
    rest_from_birth,
    update_states,
)
from multicell.cells import (
    SPHERE,
    Cells,
    FloatArray,
    IntArray,
    Mask,
    Share,
    Signals,
    rows_before,
)
from multicell.scene.domain import check_inside
from multicell.vectors import cubes

if TYPE_CHECKING:
    from multicell.biology.exposure import Exposure
    from multicell.biology.plan import BiologyPlan


@final
class Grown(NamedTuple):
    """Grown cells at the end of a step.

    - ``radius``, (n,) µm
    - ``factor``, (n,): part of unlimited growth at which they have grown if they could
    - ``lag``, (n,) s: growth yet to be made good
    - ``cycling``: their place in the cycle; None where the scene has no phases
    """

    radius: FloatArray
    factor: FloatArray
    lag: FloatArray
    cycling: Cycling | None


@final
class Decided(NamedTuple):
    """The cells after decisions, which have died, (n,), and the volume that these lost, µm³."""

    cells: Cells
    died: Mask
    released: float


@final
class Events(NamedTuple):
    """The cells after division and removal, the next free identity, and what was removed.

    ``removals`` is a number of cells, ``released`` their volume in µm³, ``row``, (n,), where the
    cells or their mothers were before; None where nothing happened.
    """

    cells: Cells
    next_id: int
    removals: int
    released: float
    row: IntArray | None


def grow(plan: BiologyPlan, cells: Cells, signals: Signals, factor: FloatArray, dt: float) -> Grown:
    """Let cells grow for a time ``dt`` (s).

    ``factor`` is how fast they grow where they are, (n,); see
    :func:`multicell.biology.growth.growth_factor`. Growth left out by earlier steps is made good.
    """
    own, factor = factor, corrected_factor(plan, cells, factor, dt)
    lag = cells.lag if factor is own else cells.lag - dt * (factor - own)
    volume = volumes_after(plan, cells, factor, dt)
    cycling = None
    if plan.phased:
        resting = wants_rest(plan, cells, signals)
        pace = phase_pace(plan, signals, cells)
        cycling = advance_cycle(plan, cells, factor, resting, dt, pace)
        volume += cycling.volume - cells.volume
    return Grown(np.asarray(np.cbrt(volume / SPHERE)), factor, lag, cycling)


def age_cells(
    plan: BiologyPlan,
    cells: Cells,
    grown: Grown,
    signals: Signals,
    begin: float,
    end: float,
) -> tuple[Cells, float]:
    """Return the cells at the end of a step, and the volume that dead ones have lost in it, µm³."""
    now, age = grown.cycling, cells.age + (end - begin)
    after = cells.changed(radius=grown.radius, lag=grown.lag, age=age)
    if now is not None:
        after = after.changed(
            state=now.state, phase=now.phase, progress=now.progress, phase_length=now.phase_length
        )
    after = bind(plan, after, cells, signals, end)
    dead = cells.dead
    if not np.count_nonzero(dead):
        return after, 0.0
    # what the dead took up when they swelled counts against what they lose
    lost = cubes(cells.radius[dead]) - cubes(grown.radius[dead])
    return after, SPHERE * float(lost.sum())


def bind(plan: BiologyPlan, after: Cells, cells: Cells, signals: Signals, time: float) -> Cells:
    """Return ``after`` with the receptors and ligands that ``cells`` have at a time in s."""
    if plan.receptors is None:
        return after
    receptor, ligand = np.ascontiguousarray(bond_levels(plan, cells, signals, time).T)
    return after.changed(receptor=receptor, ligand=ligand)


def bind_changed(
    plan: BiologyPlan, before: Cells, cells: Cells, signals: Signals, time: float
) -> Cells:
    """Return cells, those of another type than ``before`` with its receptors and ligands.

    Those before are the cells or their mothers, and ``signals`` are of these; ``time`` in s.
    """
    if plan.receptors is None or cells.kind is before.kind:
        return cells
    row = rows_before(before, cells)
    changed = (cells.kind != before.kind[row]).nonzero()[0]
    here = {name: values[row[changed]] for name, values in signals.items()}
    levels = bond_levels(plan, cells.take(changed), here, time)
    receptor, ligand = cells.receptor.copy(), cells.ligand.copy()
    receptor[changed], ligand[changed] = levels.T
    return cells.changed(receptor=receptor, ligand=ligand)


def divide_and_remove(
    plan: BiologyPlan,
    cells: Cells,
    next_id: int,
    time: float,
    dt: float,
    signals: Signals = MappingProxyType({}),
    factor: float | FloatArray = 1.0,
    share: Share | None = None,
) -> Events:
    """Return the cells after all that changes their number at the end of a step.

    ``time`` is that end and ``dt`` the length of the step, s, ``factor`` the part of unlimited
    growth at which cells have grown in it, (n,) or one for all; threads ``share`` the copying.
    """
    born, gone = births(plan, cells, next_id, dt, signals, factor), lysed(plan, cells)
    if born is None and gone is None:
        return Events(cells, next_id, 0, 0.0, None)
    ripe, mother, daughters = born or (np.zeros(len(cells), bool), NOBODY, Cells.empty())
    keep = ~ripe if gone is None else ~(ripe | gone)
    (kept,) = keep.nonzero()
    # one copy of what stays
    after = cells.take(kept, share) if born is None else cells.replaced(kept, daughters, share)
    if born is not None:
        # daughters lie within their mother: only one that is pressed nearly flat, or that no
        # wall holds, can have one outside
        check_inside(plan.domain, after.id, after.position, time)
        after = bind_changed(plan, cells, after, signals, time)
    removals, released = 0, 0.0
    if gone is not None:
        removals, radius = int(np.count_nonzero(gone)), (cells.radius[~ripe], daughters.radius)
        whole = float((SPHERE * cubes(np.concatenate(radius))).sum())
        released = whole - float(after.volume.sum())
    row = np.concatenate([kept, mother])
    return Events(after, next_id + len(daughters), removals, released, row)


def decide(
    plan: BiologyPlan,
    cells: Cells,
    signals: Signals,
    exposure: Exposure | None = None,
    *,
    ahead: float | None = None,
    time: float = 0.0,
) -> Decided:
    """Return the cells with the damage and the states that follow from their signals.

    - ``exposure``: to the signals of the step that has ended; absent at the start of a run
    - ``ahead``: length of the next step, s; absent: the usual one
    - ``time``: the end of the step that has ended, s
    """
    before, dt = cells.state, None if exposure is None else exposure.length
    dying = deaths(plan, cells, signals, exposure, time)
    state = update_states(plan, cells, signals, dying, dt=dt, ahead=ahead)
    if state is not before or dying.columns:
        cells = cells.changed(state=state, **dying.columns)
    if exposure is not None and not plan.restricted:
        cells = rest_from_birth(cells, before, exposure)
    if plan.restricted:
        due = deciding(cells, dt or plan.coupling_step, plan.cells.reaction_time, ahead)
        well = ~wants_rest(plan, cells, signals)
        cells = leave_rest(plan, cells, due & well)
    died, lost, now = np.zeros(len(cells), bool), 0.0, cells.state
    if now is not before and np.count_nonzero(died := (now != before) & cells.dead):
        cells, lost = die(plan, cells, died, dying, exposure)
    return Decided(cells, died, lost)
