"""The loop over cells: each cell takes its own steps through a coupling step.

Every cell remembers its step, whether it goes explicitly, and estimates of its stiffness. So the
course of a cell depends on itself alone: any number of threads gives the same bits.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import FloatArray
from multicell.compiling import KERNEL, UNCOUNTED, typed
from multicell.networks.events import (
    EventRules,
    any_rises,
    event_memory,
    fire,
    note_conditions,
)
from multicell.networks.kernels import (
    Common,
    Surrounding,
    evaluate_network,
    fastest,
    scratch_of,
    take_explicit,
    take_implicit,
)
from multicell.networks.methods import AUTO, EXPLICIT, Explicit, LinearlyImplicit
from multicell.networks.watching import (
    LOOKS,
    Watch,
    between,
    excess_of,
    no_watch,
    passage_within,
    stays_below,
)

_inner = typed(**UNCOUNTED)

CELL_DONE, CELL_STALLED, CELL_OUT_OF_STEPS, CELL_NOT_FINITE, CASCADE = range(5)
"""How a cell came through a coupling step."""

CELL_STEP, IMPLICITLY, EVIDENCE, REMEMBERED = range(4)
"""Places in the memory of a cell: length of its next step (0: none yet), whether it takes
Rosenbrock steps, steps that spoke for the other kind; after these the conditions of its events."""

CELL_STEPS, CELL_REJECTIONS, STIFF, FIRED, CELL_EVALUATIONS, WORK = range(6)
"""Places in what is counted of a cell: accepted and rejected steps, Rosenbrock steps, events,
evaluations of the rates; how many there are."""

_STIFF = 3.0  # h |λ| at which the explicit pair is at the limit of its stability
_SURE = 4.0  # steps in a row that speak for the other kind
_SHORTEST = 1e-14  # steps below this part of time and span are lost in rounding
_LONGEST = 100.0  # coupling steps that a remembered step is long at most
_EXACT = 1e-13  # part of time and span to which the time of an event is known


@final
class Batch(NamedTuple):
    """Cells of one network, n of them; ``y``, ``p``, ``memory`` and ``work`` are overwritten.

    - ``y`` (n, s), ``p`` (n, q), ``before`` and ``after`` (n, m): states, parameters and inputs at
      both ends
    - ``growth`` (n,): d ln(volume)/dt over the step
    - ``start``, ``span`` (n,): when the step of each cell begins, and its length
    - ``memory`` (n, 3 + k), ``work`` (n, 5), ``status`` (n,), ``reached`` (n,): where it ended
    - ``waiting`` (n, 4) or (0, 4): what cells wait for (:class:`.watching.Watch`), ``met`` (n,):
      when that came true; infinite: not
    """

    y: FloatArray
    p: FloatArray
    before: FloatArray
    after: FloatArray
    growth: FloatArray
    start: FloatArray
    span: FloatArray
    memory: FloatArray
    work: NDArray[np.int64]
    status: NDArray[np.int64]
    reached: FloatArray
    waiting: FloatArray
    met: FloatArray


@final
class LoopControl(NamedTuple):
    """How steps are taken.

    - ``mode``: of :mod:`.methods`
    - ``most``: steps that a cell may take
    - ``length``: of steps that are all as long, without error control; 0 for steps under it
    """

    mode: int
    most: int
    length: float


@_inner
def _finite(y):
    largest = 0.0
    for k in range(y.size):
        largest += abs(y[k])
    return largest < math.inf


@_inner
def _first_step(common, here, y, f):
    """Return a careful first step: a hundredth of the time in which the fastest state changes."""
    least = here.span
    for k in range(y.size):
        scale = abs(y[k]) + common.absolute[k] / common.relative
        if abs(f[k]) * least > scale:
            least = scale / abs(f[k])
    return 0.01 * least


@_inner
def _factor(size, order):
    """Return by what the error of a step allows the next one to be longer."""
    if size <= 1e-8:
        return 5.0
    return min(5.0, max(0.1, 0.9 * size ** (-1.0 / order)))


@_inner
def _weigh(mode, memory, implicit, speaks):
    """Count steps that speak for the other kind of steps, and change to it when sure."""
    if mode != AUTO:
        return
    memory[EVIDENCE] = memory[EVIDENCE] + 1.0 if speaks else max(0.0, memory[EVIDENCE] - 1.0)
    if memory[EVIDENCE] >= _SURE:
        memory[IMPLICITLY] = 0.0 if implicit else 1.0
        memory[EVIDENCE] = 0.0


@_inner
def _attempt(common, here, rosenbrock, explicit, implicit, t, h, y, s, fresh):
    """Take a step; return the size of its error and h |λ| as far as it is known."""
    if implicit:
        size = take_implicit(common, here, rosenbrock, t, h, y, s, fresh)
        return size, h * fastest(s, y.size)
    return take_explicit(common, here, explicit, t, h, y, s)


@_inner
def _rises_at(common, here, rules, t, h, y, s, conditions, state):
    """Return the first part of a step by which a condition has risen, or 2 where none has.

    ``s.slope`` has the rates at the end; between the ends the state is Hermite's cubic.
    """
    for part in range(1, LOOKS):
        x = part / LOOKS
        between(h, x, y, s, state)
        if any_rises(rules, here, t + x * h, state, s.u, conditions):
            return x
    if any_rises(rules, here, t + h, s.trial, s.u, conditions):
        return 1.0
    return 2.0


@_inner
def _locate(common, here, rosenbrock, explicit, implicit, rules, t, h, y, s, conditions):
    """Shorten a step so that it ends just behind the first rise of a condition.

    Each try is a step of its own from the beginning, and so as exact as any. Returns its length.
    """
    low, high = 0.0, h
    exact = _EXACT * (abs(t) + here.span)
    while high - low > exact:
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        _attempt(common, here, rosenbrock, explicit, implicit, t, middle, y, s, False)
        if any_rises(rules, here, t + middle, s.trial, s.u, conditions):
            high = middle
        else:
            low = middle
    _attempt(common, here, rosenbrock, explicit, implicit, t, high, y, s, False)
    return high


@_inner
def _cut_at_event(common, here, rosenbrock, explicit, implicit, rules, t, h, y, s, memory):
    """Return the length of a step up to the first event in it, and whether there is one."""
    conditions = memory[REMEMBERED:]
    # the rates at the end are not needed where nothing but the cubic would ask for them
    evaluate_network(common, here, t + h, s.trial, s.u, s.slope)
    s.calls[0] += 1
    x = _rises_at(common, here, rules, t, h, y, s, conditions, s.point)
    if x > 1.0:
        return h, False
    if x < 1.0:
        _attempt(common, here, rosenbrock, explicit, implicit, t, x * h, y, s, False)
        if not any_rises(rules, here, t + x * h, s.trial, s.u, conditions):
            return x * h, False  # the cubic was wrong: the step is taken up to there
        h = x * h
    return _locate(
        common, here, rosenbrock, explicit, implicit, rules, t, h, y, s, conditions
    ), True


@_inner
def _met_at(common, here, rosenbrock, explicit, implicit, watch, t, h, y, s, seen):
    """Return when within an accepted step a value first comes beyond its level; infinite: never.

    ``s.slope`` has the rates at the end. ``s.trial`` is in the end what it was.
    """
    low, high = passage_within(watch, here, t, h, y, s, seen)
    if high > 1.0:
        return math.inf
    if low == high:
        return t + low * h
    exact = _EXACT * (abs(t) + here.span)
    if low > 0.0:
        _attempt(common, here, rosenbrock, explicit, implicit, t, low * h, y, s, False)
        begin = excess_of(watch, here, t + low * h, s.trial, s.u, seen)
    else:
        begin = excess_of(watch, here, t, y, s.u, seen)
    _attempt(common, here, rosenbrock, explicit, implicit, t, high * h, y, s, False)
    end = excess_of(watch, here, t + high * h, s.trial, s.u, seen)
    if begin > 0.0:  # the cubic was late
        high = low
    elif end > 0.0:
        last = 0
        while (high - low) * h > exact:
            # false position, with half of the end that stays (Illinois)
            x = low + (high - low) * begin / (begin - end)
            if not low < x < high:
                x = 0.5 * (low + high)
                if not low < x < high:
                    break
            _attempt(common, here, rosenbrock, explicit, implicit, t, x * h, y, s, False)
            value = excess_of(watch, here, t + x * h, s.trial, s.u, seen)
            if value > 0.0:
                high, end = x, value
                begin *= 0.5 if last == 1 else 1.0
                last = 1
            else:
                low, begin = x, value
                end *= 0.5 if last == -1 else 1.0
                last = -1
            if value == 0.0:
                high = x
                break
    # else the cubic was early by no more than its error
    _attempt(common, here, rosenbrock, explicit, implicit, t, h, y, s, False)
    return t + high * h


@_inner
def _fire_now(common, here, rules, t, y, memory, work, s, events):
    """Fire what has become true; return whether that came to an end."""
    conditions = memory[REMEMBERED:]
    for k in range(conditions.size):
        events.was[k] = conditions[k]
    settled = fire(rules, here, t, y, s.u, events)
    for k in range(conditions.size):
        conditions[k] = events.was[k]
    work[FIRED] += 1
    memory[CELL_STEP] = 0.0
    return settled


@_inner
def _begin_events(common, here, rules, t, y, memory, work, s, events):
    """Fire what has become true between two coupling steps, and at the start."""
    conditions = memory[REMEMBERED:]
    note_conditions(rules, here, t, y, s.u, events.was)
    for k in range(conditions.size):
        if conditions[k] < 0.0:  # it counts as what it is
            conditions[k] = events.was[k]
    if any_rises(rules, here, t, y, s.u, conditions):
        return _fire_now(common, here, rules, t, y, memory, work, s, events)
    for k in range(conditions.size):
        conditions[k] = events.was[k]
    return True


@_inner
def _through(
    common, here, rosenbrock, explicit, rules, control, y, memory, work, s, events, watch, seen
):
    """Bring a cell through a coupling step.

    Returns how that ended, when, and when what the cell waits for came true.
    """
    t, end, eventful = here.start, here.start + here.span, rules.triggers.size > 0
    met, waits = math.inf, watch.since < end
    fixed = control.length > 0.0
    count = math.ceil(here.span / control.length * (1.0 - 1e-12)) if fixed else 0.0
    known = fresh = refused = False
    tried = 0
    if control.mode != AUTO:
        memory[IMPLICITLY] = 0.0 if control.mode == EXPLICIT else 1.0
    if eventful and not _begin_events(common, here, rules, t, y, memory, work, s, events):
        return CASCADE, t, met
    while t < end:
        tried += 1
        if tried > control.most:
            return CELL_OUT_OF_STEPS, t, met
        implicit = memory[IMPLICITLY] == 1.0
        if not known:
            evaluate_network(common, here, t, y, s.u, s.f)
            s.calls[0] += 1
            known = fresh = True
            if not _finite(s.f):
                return CELL_NOT_FINITE, t, met
        if memory[CELL_STEP] <= 0.0:
            memory[CELL_STEP] = _first_step(common, here, y, s.f)
        left = end - t
        h = here.span / count if fixed else memory[CELL_STEP]
        last = h >= left * (1.0 - 1e-10)
        if last:
            h = left
        elif not fixed and 2.0 * h > left:
            h = 0.5 * left  # no tiny step is left over
        size, stiffness = _attempt(common, here, rosenbrock, explicit, implicit, t, h, y, s, fresh)
        fresh = fresh and not implicit
        if fixed and not _finite(s.trial):
            return CELL_NOT_FINITE, t, met
        order = rosenbrock.order if implicit else explicit.order
        if not fixed and not size <= 1.0:
            work[CELL_REJECTIONS] += 1
            refused = True
            memory[CELL_STEP] = h * (min(0.9, _factor(size, order)) if size < math.inf else 0.1)
            _weigh(control.mode, memory, implicit, not implicit and stiffness > _STIFF)
            fresh = fresh or (memory[IMPLICITLY] == 1.0 and not implicit)
            if memory[CELL_STEP] < _SHORTEST * (abs(t) + here.span):
                return CELL_STALLED, t, met
            continue
        longer = _factor(size, order)
        longer = min(1.0, longer) if refused else longer
        event = False
        if eventful and not fixed:
            whole = h
            h, event = _cut_at_event(
                common, here, rosenbrock, explicit, implicit, rules, t, h, y, s, memory
            )
            last = last and h == whole
        elif eventful:
            event = any_rises(rules, here, t + h, s.trial, s.u, memory[REMEMBERED:])
        known, refused = False, False
        if waits:
            evaluate_network(common, here, t + h, s.trial, s.u, s.slope)
            s.calls[0] += 1
            # the test comes before the call: so many arrays take longer to pass than a step takes
            if t + h > watch.since and not stays_below(watch, h, y, s):
                met = _met_at(common, here, rosenbrock, explicit, implicit, watch, t, h, y, s, seen)
            waits = met == math.inf
            if waits and not eventful and not last:  # these are the rates of the next step
                for k in range(y.size):
                    s.f[k] = s.slope[k]
                known = fresh = _finite(s.f)
        for k in range(y.size):
            y[k] = s.trial[k]
        t = end if last else t + h
        work[CELL_STEPS] += 1
        work[STIFF] += implicit
        if not fixed:
            # a step that only the end has cut keeps its length
            new = h * longer
            memory[CELL_STEP] = min(
                max(new, memory[CELL_STEP]) if longer >= 1.0 else new, _LONGEST * here.span
            )
            speaks = stiffness < 0.5 * _STIFF if implicit else stiffness > _STIFF
            _weigh(control.mode, memory, implicit, speaks)
        if eventful:
            if event:
                if not _fire_now(common, here, rules, t, y, memory, work, s, events):
                    return CASCADE, t, met
            else:
                note_conditions(rules, here, t, y, s.u, memory[REMEMBERED:])
    return CELL_DONE, t, met


@typed(**KERNEL, nogil=True)
def advance_cells(
    begin: int,
    end: int,
    common: Common,
    rosenbrock: LinearlyImplicit,
    explicit: Explicit,
    rules: EventRules,
    control: LoopControl,
    batch: Batch,
) -> Any:
    """Bring the cells from ``begin`` to ``end`` (rows) through a coupling step."""
    states, inputs = batch.y.shape[1], batch.before.shape[1]
    s = scratch_of(states, inputs, max(rosenbrock.alpha.size, explicit.b.size))
    events = event_memory(rules.triggers.size, states, batch.p.shape[1])
    seen = np.empty(common.observed)
    _each_cell(begin, end, common, rosenbrock, explicit, rules, control, batch, s, events, seen)
    # numba frees what is not used again
    s.calls[0] = events.was.size + seen.size


@_inner
def _each_cell(begin, end, common, rosenbrock, explicit, rules, control, batch, s, events, seen):
    watch = no_watch()
    for i in range(begin, end):
        span = batch.span[i]
        here = Surrounding(
            batch.before[i],
            batch.after[i],
            batch.p[i],
            batch.growth[i],
            batch.start[i],
            span,
            1.0 / span if span > 0.0 else 0.0,
        )
        if batch.waiting.shape[0] > 0:
            place, sign, level, since = batch.waiting[i]
            watch = Watch(common.observe, int(place), sign, level, since)
        batch.status[i], batch.reached[i], batch.met[i] = _through(
            common,
            here,
            rosenbrock,
            explicit,
            rules,
            control,
            batch.y[i],
            batch.memory[i],
            batch.work[i],
            s,
            events,
            watch,
            seen,
        )
        batch.work[i, CELL_EVALUATIONS], s.calls[0] = s.calls[0], 0
