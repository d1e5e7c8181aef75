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
    event_memory,
    fire,
    highest_rise,
    note_conditions,
)
from multicell.networks.kernels import (
    AFRESH,
    CAREFUL,
    REUSED,
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
_once = typed(**UNCOUNTED, forceinline=True)  # called in one place, with more than is quick to pass

CELL_DONE, CELL_STALLED, CELL_OUT_OF_STEPS, CELL_NOT_FINITE, CASCADE, CELL_SLIDES = range(6)
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
_LOOKS_AHEAD = 32  # at rates on the way to a jump
_LONGEST = 100.0  # coupling steps that a remembered step is long at most
_EXACT = 1e-13  # part of time and span to which the time of an event is known
_REFUSALS = 3  # of steps from one point, after which its Jacobian is made with care
_SUSPICIOUS = 2000  # tries of a cell after which, and again, it is asked whether it slides


NOTHING, EVENT, PASSAGE, WHOLE = range(4)
"""What is sought within a step; after a passage the whole step, which is taken once more."""


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


@final
class Tools(NamedTuple):
    """All that cells of a network share: data, methods, events, and how steps are taken."""

    common: Common
    rosenbrock: LinearlyImplicit
    explicit: Explicit
    rules: EventRules
    control: LoopControl


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


@_once
def _attempt(tools, here, implicit, t, h, y, s, jacobian):
    """Take a step; return the size of its error and h |λ| as far as it is known."""
    if implicit:
        size = take_implicit(tools.common, here, tools.rosenbrock, t, h, y, s, jacobian)
        return size, h * fastest(s, y.size)
    return take_explicit(tools.common, here, tools.explicit, t, h, y, s)


@_once
def _rates_at_end(tools, here, implicit, t, h, s):
    """Write the rates at the end of a step to ``s.slope``."""
    last = tools.explicit.b.size - 1
    if implicit or not tools.explicit.ends:
        evaluate_network(tools.common, here, t + h, s.trial, s.u, s.slope)
        s.calls[0] += 1
    else:
        for i in range(s.slope.size):
            s.slope[i] = s.stages[last, i]


@_inner
def _excess(tools, here, sought, watch, t, y, s, conditions, seen):
    """Return by how much what is sought is true: a condition of an event, or of the cell."""
    if sought == EVENT:
        return highest_rise(tools.rules, here, t, y, s.u, conditions)
    return excess_of(watch, here, t, y, s.u, seen)


@_inner
def _event_in(tools, here, t, h, y, s, conditions):
    """Return by which part of a step an event comes; 2 where none does.

    ``s.slope`` has the rates at the end; between the ends the state is Hermite's cubic.
    """
    for part in range(1, LOOKS + 1):
        x = part / LOOKS
        between(h, x, y, s, s.point)
        state = s.point if part < LOOKS else s.trial
        if highest_rise(tools.rules, here, t + x * h, state, s.u, conditions) > 0.0:
            return x
    return 2.0


@final
class _Bracket(NamedTuple):
    """Lengths of steps between which something comes true, and by how much it is at their ends.

    ``side``: which end moved last; ``wide``: their distance some tries ago
    """

    low: float
    high: float
    begin: float
    end: float
    side: int
    tries: int
    wide: float


@_inner
def _narrowed(known, x, value):
    """Return a bracket after a try: false position halves the end that stays (Illinois)."""
    low, high, begin, end, side, tries, wide = known
    if value > 0.0:
        begin = 0.5 * begin if side == 1 else begin
        high, end, side = x, value, 1
    else:
        end = 0.5 * end if side == -1 else end
        low, begin, side = x, value, -1
    return _Bracket(low, high, begin, end, side, tries + 1, wide if tries % 3 else high - low)


@_inner
def _next_try(known, exact):
    """Return the next length to try: by false position, or the middle where that is slow.

    The upper end, where there is nothing between.
    """
    low, high, begin, end, _, tries, wide = known
    if not high - low > exact:
        return high
    x = low + exact if begin == 0.0 else low + (high - low) * begin / (begin - end)
    if not low < x < high or (tries % 3 == 2 and high - low > 0.5 * wide):
        x = 0.5 * (low + high)
    return x if low < x < high else high


@_inner
def _slides(tools, here, t, h, y, s):
    """Return whether the rates of a state jump just ahead, and lead back from there.

    Then the solution slides along the place of the jump, and steps cross it without end. The jump
    is what is left of the largest change of a rate where the way to it gets short.
    """
    common, n, place, most = tools.common, y.size, 0, 0.0
    low, high, whole, before, beyond = 0.0, 10.0 * h, 0.0, 0.0, 0.0
    for look in range(_LOOKS_AHEAD + 2):
        x = high if look in (0, _LOOKS_AHEAD) else 0.5 * (low + high)
        for i in range(n):
            back = 0.1 * h * s.slope[i] if look > _LOOKS_AHEAD else 0.0
            s.point[i] = s.point[i] + back if look > _LOOKS_AHEAD else y[i] + x * s.f[i]
        evaluate_network(common, here, t, s.point, s.u, s.slope)
        s.calls[0] += 1
        if look == 0:
            before = s.f[0]
            for i in range(n):
                allowed = common.absolute[i] + common.relative * abs(y[i])
                if abs(s.slope[i] - s.f[i]) > most * allowed:
                    place, most = i, abs(s.slope[i] - s.f[i]) / allowed
            before, whole = s.f[place], s.slope[place] - s.f[place]
        elif look == _LOOKS_AHEAD:
            beyond = s.slope[place]
            if not abs(beyond - before) > 0.25 * abs(whole) > 0.0:
                return False
        elif look > _LOOKS_AHEAD:
            break
        elif abs(s.slope[place] - s.f[place]) > 0.5 * abs(whole):
            high = x
        else:
            low, before = x, s.slope[place]
    return abs(s.slope[place] - before) < 0.5 * abs(beyond - before)


@_inner
def _fire_now(tools, here, t, y, memory, work, s, events):
    """Fire what has become true; return whether that came to an end.

    Where the rates stay what they were, so does the length of the next step.
    """
    conditions = memory[REMEMBERED:]
    for k in range(conditions.size):
        events.was[k] = conditions[k]
    evaluate_network(tools.common, here, t, y, s.u, s.slope)
    settled = fire(tools.rules, here, t, y, s.u, events)
    for k in range(conditions.size):
        conditions[k] = events.was[k]
    evaluate_network(tools.common, here, t, y, s.u, s.f)
    s.calls[0] += 2
    for k in range(y.size):
        if s.f[k] != s.slope[k]:
            memory[CELL_STEP] = 0.0
    work[FIRED] += 1
    return settled


@_inner
def _begin_events(tools, here, t, y, memory, work, s, events):
    """Fire what has become true between two coupling steps, and at the start."""
    conditions = memory[REMEMBERED:]
    note_conditions(tools.rules, here, t, y, s.u, events.was)
    for k in range(conditions.size):
        if conditions[k] < 0.0:  # it counts as what it is
            conditions[k] = events.was[k]
    if highest_rise(tools.rules, here, t, y, s.u, conditions) > 0.0:
        return _fire_now(tools, here, t, y, memory, work, s, events)
    for k in range(conditions.size):
        conditions[k] = events.was[k]
    return True


@_once
def _through(tools, here, y, memory, work, s, events, watch, seen):
    """Bring a cell through a coupling step.

    Returns how that ended, when, and when what the cell waits for came true. Steps are tried in
    one place, which alone is then compiled: also those that look for the time of an event or a
    passage, each of its own from the beginning of the step, and so as exact as any.
    """
    common, rules, control = tools.common, tools.rules, tools.control
    conditions = memory[REMEMBERED:]
    t, end, eventful = here.start, here.start + here.span, rules.triggers.size > 0
    met, waits = math.inf, watch.since < end
    fixed = control.length > 0.0
    count = math.ceil(here.span / control.length * (1.0 - 1e-12)) if fixed else 0.0
    known, last, jacobian, tried, refusals = False, False, AFRESH, 0, 0
    sought, bracket = NOTHING, _Bracket(0.0, 0.0, 0.0, 0.0, 0, 0, 0.0)
    h, whole, event = 0.0, 0.0, False
    if control.mode != AUTO:
        memory[IMPLICITLY] = 0.0 if control.mode == EXPLICIT else 1.0
    if eventful and not _begin_events(tools, here, t, y, memory, work, s, events):
        return CASCADE, t, met
    while t < end:
        implicit = memory[IMPLICITLY] == 1.0
        if sought == NOTHING:
            tried += 1
            if tried > control.most:
                return CELL_OUT_OF_STEPS, t, met
            if not known:
                evaluate_network(common, here, t, y, s.u, s.f)
                s.calls[0] += 1
                known, jacobian = True, AFRESH
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
            if tried % _SUSPICIOUS == 0 and not fixed and _slides(tools, here, t, h, y, s):
                return CELL_SLIDES, t, met
        size, stiffness = _attempt(tools, here, implicit, t, h, y, s, jacobian)
        jacobian = REUSED if implicit else jacobian
        ends = False
        if sought == NOTHING:
            if fixed and not _finite(s.trial):
                return CELL_NOT_FINITE, t, met
            order = tools.rosenbrock.order if implicit else tools.explicit.order
            longer = _factor(size, order)
            if not fixed and not size <= 1.0:
                work[CELL_REJECTIONS] += 1
                refusals += 1
                memory[CELL_STEP] = h * (min(0.9, longer) if size < math.inf else 0.1)
                _weigh(control.mode, memory, implicit, not implicit and stiffness > _STIFF)
                if memory[IMPLICITLY] == 1.0 and not implicit:
                    jacobian = AFRESH
                elif refusals == _REFUSALS:
                    jacobian = CAREFUL
                if memory[CELL_STEP] < _SHORTEST * (abs(t) + here.span):
                    return CELL_STALLED, t, met
                continue
            if not fixed:
                # a step that only the end has cut keeps its length
                new = h * (min(1.0, longer) if refusals > 0 else longer)
                new = max(new, memory[CELL_STEP]) if new >= h else new
                memory[CELL_STEP] = min(new, _LONGEST * here.span)
            # rates at the end: those of the next step, and for the cubic
            whole, event, ends = h, False, eventful or (tools.explicit.ends and not implicit)
            if ends:
                _rates_at_end(tools, here, implicit, t, h, s)
            if eventful and fixed:
                event = highest_rise(rules, here, t + h, s.trial, s.u, conditions) > 0.0
            elif eventful:
                x = _event_in(tools, here, t, h, y, s, conditions)
                if x <= 1.0:
                    begin = highest_rise(rules, here, t, y, s.u, conditions)
                    bracket = _Bracket(0.0, x * h, begin, 0.0, 0, 0, x * h)
                    sought, h = EVENT, x * h
                    continue
        elif sought != WHOLE:
            value = _excess(tools, here, sought, watch, t + h, s.trial, s, conditions, seen)
            if bracket.tries > 0 or value > 0.0:
                bracket = _narrowed(bracket, h, value)
                x = _next_try(bracket, _EXACT * (abs(t) + here.span))
                if x != h:
                    h = x
                    continue
            # else the cubic was early: an event does not come yet, a passage by its error
            if sought == PASSAGE:
                met, waits, sought, h = t + h, False, WHOLE, whole
                continue
            event, last = value > 0.0, last and h == whole
        if waits and sought != WHOLE:
            if not ends:
                _rates_at_end(tools, here, implicit, t, h, s)
                ends = True
            if t + h > watch.since and not stays_below(watch, h, y, s):
                low, high = passage_within(watch, here, t, h, y, s, seen)
                if low == high:
                    met, waits = t + low * h, False
                elif high <= 1.0:
                    between(h, low, y, s, s.point)
                    begin = excess_of(watch, here, t + low * h, s.point, s.u, seen)
                    bracket = _Bracket(low * h, high * h, begin, 0.0, 0, 0, (high - low) * h)
                    sought, whole, h = PASSAGE, h, high * h
                    continue
        sought = NOTHING
        for k in range(y.size):
            y[k] = s.trial[k]
        if ends:
            for k in range(y.size):
                s.f[k] = s.slope[k]
        known, jacobian, refusals = ends and _finite(s.f), AFRESH, 0
        t = end if last else t + h
        work[CELL_STEPS] += 1
        work[STIFF] += implicit
        if not fixed:
            speaks = stiffness < 0.5 * _STIFF if implicit else stiffness > _STIFF
            _weigh(control.mode, memory, implicit, speaks)
        if eventful:
            if event:
                known = False
                if not _fire_now(tools, here, t, y, memory, work, s, events):
                    return CASCADE, t, met
            else:
                note_conditions(rules, here, t, y, s.u, conditions)
    return CELL_DONE, t, met


@typed(**KERNEL, nogil=True)
def advance_cells(begin: int, end: int, tools: Tools, batch: Batch) -> Any:
    """Bring the cells from ``begin`` to ``end`` (rows) through a coupling step.

    The first one that cannot be solved ends that.
    """
    states, inputs = batch.y.shape[1], batch.before.shape[1]
    s = scratch_of(states, inputs, max(tools.rosenbrock.alpha.size, tools.explicit.b.size))
    events = event_memory(tools.rules.triggers.size, states, batch.p.shape[1])
    seen = np.empty(tools.common.observed)
    _each_cell(begin, end, tools, batch, s, events, seen)
    # numba frees what is not used again
    s.calls[0] = events.was.size + seen.size


@_inner
def _each_cell(begin, end, tools, batch, s, events, seen):
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
            watch = Watch(tools.common.observe, int(place), sign, level, since)
        batch.status[i], batch.reached[i], batch.met[i] = _through(
            tools, here, batch.y[i], batch.memory[i], batch.work[i], s, events, watch, seen
        )
        batch.work[i, CELL_EVALUATIONS], s.calls[0] = s.calls[0], 0
        if batch.status[i] != CELL_DONE:
            break
