"""One coupling step: from the state of a run to the next one.

The data goes one way: growth rates from the signals of cells, motion while the radii
grow, then all events (division, removal), then the nutrient field of the new configuration, and
from it the cells' new states. So a frame taken between two steps is consistent: its concentrations
are those of its own cells.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, cast, final

import numpy as np

from multicell.biology import driven
from multicell.biology.division import change_types, changing, mutate_as_found
from multicell.biology.encounters import with_encounters
from multicell.biology.exposure import Exposure, course_with_deaths, remainders
from multicell.biology.growth import growth_factor, lag_after
from multicell.biology.responding import with_newborn
from multicell.biology.states import irradiate
from multicell.biology.step import age_cells, bind_changed, decide, divide_and_remove, grow
from multicell.biology.step_errors import step_errors
from multicell.biology.surface import check_surface_held
from multicell.biology.waiting import watched
from multicell.cells import contact_rows, rows_before
from multicell.compiling.threads import share_rows
from multicell.mechanics import neighbours
from multicell.simulation.passages import Passed, after_conditions
from multicell.simulation.run_state import RunState
from multicell.simulation.step_lengths import lengths_after
from multicell.simulation.timeline import Laps
from multicell.vectors import wrapped

if TYPE_CHECKING:
    from multicell.biology.exposure import Jumps
    from multicell.biology.step import Decided, Grown
    from multicell.cells import Cells, FloatArray, IntArray, Signals
    from multicell.results.lineage import Lineage
    from multicell.simulation.machinery import Machinery
    from multicell.simulation.mover import Moved
    from multicell.simulation.timeline import Timeline

_GRAIN = 1e-3  # of a coupling step, to which the time of a separation is known
_MOST_PASSES = 16  # of a step's fields, until the deaths in it settle
_SETTLED = 1e-3  # of a coupling step, to which the times of these are known then
_SENSITIVE = 0.25
"""Part of the deaths that follow from others in the same step which hangs on its length.

Divisions at its end put cells elsewhere: over five seeds of a pulse on growing cells 0.23 at 10,
less at 5 and 15 min.
"""

_NOTHING: Mapping[str, Any] = MappingProxyType({})
_STALE_ORDER = 0.05  # part of the cells that may be new before all are sorted in space again


def next_state(run: Machinery, state: RunState) -> RunState:
    """Return the state after the next coupling step.

    Raises StepFailed or NutrientFailed if positions or a field cannot be solved for; the parts of
    ``run`` are then to be loaded again.
    """
    run.load(state)
    plan, lap = run.plan, Laps(run.wall)
    begin, timeline = state.timeline.time, state.timeline.after_step()
    end, found = timeline.time, run.signals_of(state)
    factor = run.growth(state, found)
    grown = grow(plan, state.cells, found, factor, end - begin)
    lap("biology")
    moved, separation = _moved(run, state, found, end, grown.radius)
    contacts = state.contacts
    if moved.contacts is not None:
        contacts = state.cells.id[moved.contacts]
    lap("mechanics")
    people = _after_events(run, state, grown, moved, contacts, timeline)
    lap("events")
    jumps = timeline.plan.jumps_at(end)
    lived = _exposed(run, state, people, found, timeline, jumps, lap)
    passed = Passed(
        lived.cells,
        people.contacts,
        lived.lineage,
        people.named,
        people.next_id,
        lived.released,
    )
    if plan.awaited:
        passed = after_conditions(run, state, passed, lived.exposure, lived.met, grown.factor, end)
        lap("events")
    cells, lineage, next_id = passed.cells, passed.lineage, passed.next_id
    if plan.radiation:
        cells, dead = irradiate(plan, cells, run.field_system.concentrations, begin, end)
        lineage = lineage.died(cells, dead, end)
    growth, lengths, before, exposure = None, state.lengths, cells.lag, lived.exposure
    row = vars(exposure).get("row") if exposure.cells.id is cells.id else None
    if plan.growth is not None and not jumps:
        # a jump changes nothing of the step that it ends
        here = run.signals(cells, passed.contacts, end)
        growth = growth_factor(plan, here, cells.pressure, cells)
        lag = lag_after(plan, state.cells, factor, cells, growth, end - begin, row)
        cells = cells.changed(lag=lag)
    if lengths:
        wrong = abs(lived.exposures.get("error", 0.0) - state.exposures.get("error", 0.0))
        errors = step_errors(plan, state.cells, cells, before, growth, end - begin, wrong, row)
        lengths = lengths_after(lengths, timeline, begin, errors)
        timeline = timeline.choosing(lengths)
    lap("biology")
    return RunState(
        cells=cells,
        timeline=timeline,
        fields=run.field_system.state,
        contacts=passed.contacts,
        lineage=lineage,
        next_id=next_id,
        unsorted=people.unsorted + next_id - people.next_id,
        divisions=state.divisions + (next_id - state.next_id) // 2,
        removals=state.removals + people.removals,
        released=passed.released,
        separation=separation,
        first_states=state.first_states,
        exposures=lived.exposures,
        named=passed.named,
        replays=moved.replays,
        stability=moved.stability,
        work=run.work(),
        lengths=lengths,
        learnt=run.mover.system.learnt,
        cavity=run.mover.cavity,
        inside=state.inside,
        growth=growth,
    )


def _moved(
    run: Machinery, state: RunState, signals: Signals, end: float, radius: FloatArray
) -> tuple[Moved, Mapping[str, float] | None]:
    """Return the moved cells, and when a pull has parted them."""
    begin, step_index = state.timeline.time, state.timeline.step_index
    motion = run.motion(state, signals, begin, end, radius)
    moved = run.mover.move(state.cells, motion, step_index, state.replays, state.stability)
    if run.plan.surface_tension > 0.0:
        check_surface_held(state.cells, moved.position, begin)
    pull, none_left = run.scene.pull, moved.contacts is not None and not len(moved.contacts)
    if pull is None or not none_left or not len(state.contacts):
        return moved, state.separation
    time = _parting(run, replace(state, stability=moved.stability), signals, end, radius)
    return moved, {"time": time, "force": pull.load(time)}


def _parting(
    run: Machinery, state: RunState, signals: Signals, end: float, radius: FloatArray
) -> float:
    """Return when in a step the last contact breaks, s: halving it until the time is known."""
    cells, begin = state.cells, state.timeline.time
    low, high = begin, end
    while high - low > _GRAIN * (end - begin):
        middle = 0.5 * (low + high)
        grown = cells.radius + (middle - begin) / (end - begin) * (radius - cells.radius)
        motion = run.motion(state, signals, begin, middle, grown)
        moved = run.mover.move(cells, motion, state.timeline.step_index, None, state.stability)
        joined = moved.contacts is not None and len(moved.contacts) > 0
        low, high = (middle, high) if joined else (low, middle)
    return high


@final
class _People(NamedTuple):
    """The population after events; the names are those of :class:`RunState`.

    ``removals`` counts those of the step, and ``released`` is what all dead cells have lost so far.
    ``row``, (n,), is where the cells or their mothers were, if that is known.
    """

    cells: Cells
    contacts: IntArray
    lineage: Lineage
    named: Mapping[str, IntArray]
    next_id: int
    unsorted: int
    removals: int
    released: float
    row: IntArray | None


def _after_events(
    run: Machinery,
    state: RunState,
    grown: Grown,
    moved: Moved,
    contacts: IntArray,
    timeline: Timeline,
) -> _People:
    """Return the cells at the end of a step after division and removal, sorted where it is due."""
    plan, begin, end, first = run.plan, state.timeline.time, timeline.time, state.next_id
    here: Signals = {}
    if plan.receptors is not None:
        here = run.signals(state.cells, contacts, begin)
    aged, lost = age_cells(plan, state.cells, grown, here, begin, end)
    aged = aged.changed(position=moved.position, pressure=moved.pressure)
    here = run.signals(aged, contacts, end)
    threads = run.mover.system.threads
    share = partial(share_rows, threads) if threads > 1 else None
    after = divide_and_remove(plan, aged, first, end, end - begin, here, grown.factor, share)
    cells, lineage, named = after.cells, state.lineage, state.named
    unsorted = state.unsorted + after.next_id - first + after.removals
    if after.next_id > first or after.removals:
        lineage = lineage.events(aged, cells, end, after.row)
        named = driven.pass_on(named, cells, first)
        if len(contacts):
            contacts = cells.id[contact_rows(cells, contacts)]
        contacts = with_newborn(plan, cells, contacts, first)
    cells, unsorted = sorted_in_space(cells, unsorted, run.mover.system.period, threads)
    row = after.row if cells is after.cells else None
    released = state.released + lost + after.released
    return _People(
        cells, contacts, lineage, named, after.next_id, unsorted, after.removals, released, row
    )


def sorted_in_space(
    cells: Cells, unsorted: int, period: FloatArray | None = None, threads: int = 1
) -> tuple[Cells, int]:
    """Return cells sorted in space where many are new, and how many are since the last sorting.

    Neighbours then share memory.
    """
    if unsorted <= _STALE_ORDER * len(cells):
        return cells, unsorted
    width = 2.0 * float(cells.radius.max(initial=1.0))
    place = cells.position if period is None else wrapped(cells.position, period)
    order = neighbours.spatial_order(place, width, threads)
    return cells.take(order, partial(share_rows, threads) if threads > 1 else None), 0


@final
class _Lived(NamedTuple):
    """The cells after all responses to their signals, as in :class:`_People`.

    - ``exposure``: to their signals; ``met``: when what they wait for in networks came true
    """

    cells: Cells
    lineage: Lineage
    released: float
    exposures: Mapping[str, float]
    exposure: Exposure
    met: FloatArray | None


def _exposed(
    run: Machinery,
    state: RunState,
    people: _People,
    signals: Signals,
    timeline: Timeline,
    jumps: bool,
    lap: Laps,
) -> _Lived:
    """Bring the fields through a step, and let cells respond to their signals.

    Where rates have killed cells, fields are brought through it once more, now with these cells
    until they died; and again, as long as that lets others die, or at other times.

    - ``jumps``: whether a steady field jumps at the end of the step
    """
    plan, fields, before = run.plan, run.field_system, people.cells
    begin, end = state.timeline.time, timeline.time
    jumped = timeline.plan.changes_at(begin)
    # whether more than the ends of the step matters: rates, or fields that jumped
    followed = plan.exposed if plan.acting or jumped else frozenset()
    followed = followed.union(*(part.needs for part in plan.awaited))
    if plan.networks is not None:
        followed = followed | plan.networks.inputs
    marches = fields.marches
    attempt = run, state, people, signals, timeline, fields.steady if jumps else (), followed, lap
    again = bool(fields.fields) and (bool(plan.acting) or (jumped and marches))
    tried, until, missed, moved = _settled(attempt, again)
    exposure, decided, correction, met, _ = tried
    cells, dead, released = decided
    lineage, exposures = people.lineage, state.exposures
    if np.count_nonzero(dead):
        lineage = lineage.died(cells, dead, end)
    if marches and cells.radius is not before.radius:  # some died, or rest early
        rests = (cells.state != before.state) & (cells.age < end - begin) & ~dead
        late = np.where((dead & (until == 1.0)) | rests, cells.age, 0.0)
        fields.give_back(before, cells, late)
    if plan.acting:
        exposures = remainders(plan, exposure, exposures, jumped=jumped)
        exposures["error"] -= moved + _SENSITIVE * missed
    unsettled = state.exposures.get("unsettled", 0.0) + (moved > 0)
    if unsettled:
        exposures = {**exposures, "unsettled": unsettled}
    if correction is not None:
        exposures = {**exposures, "networks": correction}
    cells, rows = mutate_as_found(plan, cells, exposure, people.next_id)
    if rows.size:
        lineage = lineage.retyped(cells.id[rows], cells.kind[rows])
    if changing(plan.acting):
        exposure.cells = cells
        cells = change_types(plan, cells, exposure)
    cells = bind_changed(plan, decided.cells, cells, exposure.signals, end)
    return _Lived(cells, lineage, people.released + released, exposures, exposure, met)


@final
class _Tried(NamedTuple):
    """A step of fields, networks and deaths.

    - ``exposure``, ``decided``: of and by the cells
    - ``correction``: by what part the fields at the end have changed the networks that change them;
      None where no network does
    - ``met``, (n,): when what cells wait for in their networks came true
    - ``unsettled``: deaths and changes of type that still let others die or change
    """

    exposure: Exposure
    decided: Decided
    correction: float | None
    met: FloatArray | None
    unsettled: int


def _attempt(
    run: Machinery,
    state: RunState,
    people: _People,
    before: Signals,
    timeline: Timeline,
    held: Collection[str],
    followed: Collection[str],
    lap: Laps,
    until: Any = 1.0,
    alone: Mapping[str, FloatArray] = _NOTHING,
) -> _Tried:
    """Bring fields and networks through a step, and let some cells die.

    - ``until``: part of the step until which cells exchange with fields, (n,) or one for all
    - ``alone``, name -> (n,) mM: steady fields at the end if all did so until then
    """
    plan, fields, cells = run.plan, run.field_system, people.cells
    begin, end, networks = state.timeline.time, timeline.time, run.plan.networks
    predicted, ahead, correction, met = cells, None, None, None
    threads = run.mover.system.threads
    if networks is not None and networks.change_fields:
        # the fields need the rates of networks at the end of the step
        predicted = cells.shared()
        ahead = networks.shares_ahead(predicted, end - begin)
        networks.advance(
            predicted, state.cells, None, begin, end, held, threads, next_id=people.next_id
        )
        lap("biology")
    fields.advance(
        predicted, begin, end, before=state.cells, follow=followed, until=until, ahead=ahead
    )
    lap("nutrient")
    if networks is not None:
        cells = cells.shared()
        find = partial(run.signals, contacts=people.contacts, time=end)
        waiting = watched(plan, cells, end - begin) if plan.awaited else None
        met = networks.advance(
            cells,
            state.cells,
            find,
            begin,
            end,
            held,
            threads,
            next_id=people.next_id,
            courses=fields.courses,
            waiting=waiting,
        )
        if networks.change_fields:
            networks.note_shares(cells, fields.shares(cells), end - begin)
            correction = networks.correction(predicted, cells)
    inner = fields.courses
    if alone:
        row = rows_before(state.cells, cells)
        inner = inner | {
            name: course_with_deaths(before[name][row], last, fields.concentrations[name], until)
            for name, last in alone.items()
            if name in followed and name not in held and name not in inner
        }
    found = run.signals(cells, people.contacts, end)

    def respond(jumps: Jumps | None = None) -> tuple[Exposure, Decided]:
        exposure = Exposure(
            cells,
            found,
            end - begin,
            began=state.cells,
            before=before,
            inner=inner,
            held=held,
            jumps=jumps,
        )
        if people.row is not None:
            exposure.row = people.row
        decided = decide(plan, cells, found, exposure, ahead=timeline.ahead, time=end)
        exposure.cells = decided.cells
        return exposure, decided

    unsettled = 0
    if plan.counted:
        contacts = state.contacts, people.contacts
        exposure, decided, unsettled = with_encounters(
            plan, respond, contacts, people.next_id, _MOST_PASSES
        )
    else:
        exposure, decided = respond()
    lap("biology")
    return _Tried(exposure, decided, correction, met, unsettled)


def _settled(attempt: tuple[Any, ...], again: bool) -> tuple[_Tried, Any, int, int]:
    """Return a step in which cells exchange with fields until they die, and until which part of it.

    A death exposes others, which may die of it in the same step, or later: each pass is right up to
    one more death in a row than the one before. Also returns how many deaths the first pass has
    missed, and how many have not settled.

    - ``attempt``: arguments of :func:`_attempt`
    - ``again``: whether there is more than one pass where cells die
    """
    run, state, _, _, timeline, *_ = attempt
    fields, dt = run.field_system, timeline.time - state.timeline.time
    trial = cast("Callable[..., _Tried]", partial(_attempt, *attempt))
    tried, until, moved = trial(), cast(Any, 1.0), 0
    if not again:
        return tried, until, 0, tried.unsettled
    died = np.count_nonzero(tried.decided.died)
    alone: Mapping[str, FloatArray] = {}
    for number in range(_MOST_PASSES + 1):
        lived = until
        if np.ndim(until) or np.count_nonzero(tried.decided.died):
            lived = np.where(tried.decided.died, 1.0 - tried.decided.cells.age / dt, 1.0)
            lived[lived > 1.0 - _SETTLED] = 1.0
        moved = int(np.count_nonzero(np.abs(lived - until) > _SETTLED))
        if not moved or number == _MOST_PASSES:
            break
        alone, until = alone or {x: fields.concentrations[x] for x in fields.steady}, lived
        fields.state = state.fields
        tried = trial(until=until, alone=alone)
    missed = abs(int(np.count_nonzero(tried.decided.died)) - int(died))
    return tried, until, missed, moved + tried.unsettled
