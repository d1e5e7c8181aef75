"""Cells whose phase a condition ends within a step: they start the next phase, or divide.

The conditions are known once the fields and networks of the step are. The phase ends, or the cell
divides, at the moment at which its condition has come true; all that it has done since then in the
step is done again, by its daughters too: growth, the clock of the cycle and networks.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, final

import numpy as np

from multicell.biology import driven
from multicell.biology.cycle import leave_phases, phase_pace
from multicell.biology.division import divide
from multicell.biology.responding import wants_rest, with_newborn
from multicell.biology.states import Deaths, die
from multicell.biology.step import bind_changed
from multicell.biology.waiting import passages
from multicell.cells import SPHERE, Phase, State, contact_rows
from multicell.scene.domain import check_inside

if TYPE_CHECKING:
    from collections.abc import Mapping

    from multicell.biology.exposure import Exposure
    from multicell.cells import Cells, FloatArray, IntArray
    from multicell.results.lineage import Lineage
    from multicell.simulation.machinery import Machinery
    from multicell.simulation.run_state import RunState


@final
class Passed(NamedTuple):
    """Parts of a state that conditions change; the names are those of :class:`RunState`."""

    cells: Cells
    contacts: IntArray
    lineage: Lineage
    named: Mapping[str, IntArray]
    next_id: int
    released: float


def after_conditions(
    run: Machinery,
    state: RunState,
    passed: Passed,
    exposure: Exposure,
    met: FloatArray | None,
    factor: FloatArray,
    end: float,
) -> Passed:
    """Return the end of a step after cells have acted whose condition came true within it.

    - ``state``: at its beginning; ``passed``: at its end so far
    - ``exposure``: to the signals of the step; ``met``: when conditions on networks came true, (n,)
    - ``factor``, (m,): part of unlimited growth at which the cells of the beginning have grown
    """
    plan, cells, dt = run.plan, passed.cells, exposure.length
    exposure.cells = cells
    part, row = passages(plan, exposure, met), exposure.row
    # one that was born in the step has no network yet that could be divided
    early = (state.cells.id[row] != cells.id) & (cells.phase == Phase.M)
    rows = np.flatnonzero(np.isfinite(part) & ~early)
    if not rows.size:
        return passed
    since = np.full(len(cells), np.nan)
    late = dt * (1.0 - part[rows])
    divides = cells.phase[rows] == Phase.M
    since[rows[divides]] = late[divides]
    left = np.zeros(len(cells))
    left[rows] = late
    pace = phase_pace(plan, exposure.before, state.cells)
    volume = exposure[rows].volume_at(part[rows])
    resting = wants_rest(plan, cells, exposure.signals)
    now = leave_phases(
        plan, cells, rows, left, volume, factor[row], resting, None if pace is None else pace[row]
    )
    radius = cells.radius.copy()
    radius[rows] = np.cbrt(now.volume[rows] / SPHERE)
    cells = cells.changed(
        radius=radius,
        state=now.state,
        phase=now.phase,
        progress=now.progress,
        phase_length=now.phase_length,
    )
    passed = _doomed(run, passed._replace(cells=cells), since, exposure, part, end)
    return _divided(run, state, passed, since, exposure, factor[row], end)


def _doomed(
    run: Machinery,
    passed: Passed,
    since: FloatArray,
    exposure: Exposure,
    part: FloatArray,
    end: float,
) -> Passed:
    """Let cells die that irradiation has doomed to die in place of this division."""
    cells = passed.cells
    dies = ~np.isnan(since) & (cells.doomed == 1)
    if not dies.any():
        return passed
    state = np.where(dies, np.int8(State.APOPTOTIC), cells.state)
    dying = Deaths(None, np.where(dies, part, np.inf))
    cells, lost = die(run.plan, cells.changed(state=state), dies, dying, exposure)
    since[dies] = np.nan
    lineage = passed.lineage.died(cells, dies, end)
    return passed._replace(cells=cells, lineage=lineage, released=passed.released + lost)


def _divided(
    run: Machinery,
    state: RunState,
    passed: Passed,
    since: FloatArray,
    exposure: Exposure,
    factor: FloatArray,
    end: float,
) -> Passed:
    """Divide cells whose time has come within the step, and their networks at that time."""
    plan, cells, first, found = run.plan, passed.cells, passed.next_id, exposure.signals
    divided, free = divide(plan, cells, first, exposure.length, found, factor, since)
    if free == first:
        return passed
    check_inside(plan.domain, divided.id, divided.position, end)
    born = np.flatnonzero(divided.id >= first)
    if plan.networks is not None:
        daughters = divided.take(born)
        plan.networks.divided(
            daughters,
            cells,
            cells.rows_of(daughters.parent),
            state.cells,
            found,
            end - exposure.length,
            end,
            exposure.held,
            next_id=free,
            courses=exposure.inner,
        )
        assert divided.inside is not None
        divided.inside[born] = daughters.inside
    divided = bind_changed(plan, cells, divided, found, end)
    run.field_system.find_again(divided)
    contacts = passed.contacts
    if len(contacts):
        contacts = divided.id[contact_rows(divided, contacts)]
    contacts = with_newborn(plan, divided, contacts, first)
    return passed._replace(
        cells=divided,
        contacts=contacts,
        lineage=passed.lineage.events(cells, divided, end),
        named=driven.pass_on(passed.named, divided, first),
        next_id=free,
    )
