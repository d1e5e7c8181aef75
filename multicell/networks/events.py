"""Events of networks: when they fire, and what they do, in the middle of a step of one cell."""

from __future__ import annotations

from typing import NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import FloatArray, IntArray
from multicell.compiling import INNER, typed
from multicell.networks.kernels import call_event, set_inputs
from multicell.networks.network import Network

_inner = typed(**INNER)

MAX_CASCADE = (
    1000  # rounds of events at one time; events that set off each other for ever have more
)


@final
class EventRules(NamedTuple):
    """The events of a network, in the order in which those of the same time are executed.

    - ``triggers``, ``assigns``, (k,): addresses
    - ``persistent``, (k,): whether one stays due although its condition turns false
    """

    triggers: IntArray
    assigns: IntArray
    persistent: NDArray[np.bool_]


@final
class EventMemory(NamedTuple):
    """Memory of one thread.

    - ``was``, ``due``, (k,): conditions as they were last, and which events are to be executed
    - ``y``, ``p``: the state in which they have fired; ``new_y``, ``new_p``: after one of them;
      ``probe_y``, ``probe_p``: one that is tried
    """

    was: FloatArray
    due: NDArray[np.bool_]
    y: FloatArray
    p: FloatArray
    new_y: FloatArray
    new_p: FloatArray
    probe_y: FloatArray
    probe_p: FloatArray


def event_rules(network: Network, triggers: IntArray, assigns: IntArray) -> EventRules:
    """Return the events of a network; the order is by priority, and then that of the network."""
    order = _order(network)
    persistent = np.array([network.events[k].persistent for k in order], dtype=np.bool_)
    return EventRules(triggers[order], assigns[order], persistent)


def first_conditions(network: Network) -> FloatArray:
    """Return what counts as the conditions before the start, (k,), in the order of the rules.

    0: false; -1: what it is at the start, which fires nothing.
    """
    return np.array([-1.0 if network.events[k].initial else 0.0 for k in _order(network)])


def _order(network: Network) -> NDArray[np.int64]:
    urgency = [np.inf if e.priority is None else -e.priority for e in network.events]
    return np.argsort(np.array(urgency), kind="stable").astype(np.int64)


@_inner
def event_memory(events, states, parameters):
    """Return memory for a thread."""
    return EventMemory(
        np.empty(events),
        np.zeros(events, np.bool_),
        np.empty(states),
        np.empty(parameters),
        np.empty(states),
        np.empty(parameters),
        np.empty(states),
        np.empty(parameters),
    )


@_inner
def any_rises(rules, common, here, t, y, u, was):
    """Return whether a condition that was false is true in a state."""
    set_inputs(common, here, t, u)
    for k in range(rules.triggers.size):
        if was[k] == 0.0 and call_event(rules.triggers[k], t, y, u, here.p) > 0.0:
            return True
    return False


@_inner
def note_conditions(rules, common, here, t, y, u, was):
    """Write which conditions are true now."""
    set_inputs(common, here, t, u)
    for k in range(rules.triggers.size):
        was[k] = 1.0 if call_event(rules.triggers[k], t, y, u, here.p) > 0.0 else 0.0


@_inner
def _notice(rules, here, t, y, u, memory):
    """Mark what has become due, with the state of that moment; return whether anything has."""
    found = False
    for k in range(rules.triggers.size):
        now = 1.0 if call_event(rules.triggers[k], t, y, u, here.p) > 0.0 else 0.0
        if now == 1.0 and memory.was[k] == 0.0:
            memory.due[k] = found = True
        if now == 0.0 and not rules.persistent[k]:
            memory.due[k] = False
        memory.was[k] = now
    return found


@_inner
def _copy(a, b):
    for k in range(a.size):
        b[k] = a[k]


@_inner
def _is_assigned(rules, event, t, u, memory, place, of_parameter):
    """Return whether an event writes a state (or parameter), tried from another value of it."""
    _copy(memory.y, memory.probe_y)
    _copy(memory.p, memory.probe_p)
    probe = memory.probe_p if of_parameter else memory.probe_y
    other = probe[place] + max(1.0, abs(probe[place]))
    probe[place] = other
    call_event(rules.assigns[event], t, memory.probe_y, u, memory.probe_p)
    return probe[place] != other


@_inner
def _execute(rules, event, here, t, y, u, memory):
    """Execute one event: all values are computed from the state in which it fired.

    An entry that it leaves at its value may have been assigned that very value; this matters where
    another event of the same time has changed the entry since.
    """
    _copy(memory.y, memory.new_y)
    _copy(memory.p, memory.new_p)
    call_event(rules.assigns[event], t, memory.new_y, u, memory.new_p)
    for k in range(y.size):
        new, old = memory.new_y[k], memory.y[k]
        if new != old or (y[k] != old and _is_assigned(rules, event, t, u, memory, k, False)):
            y[k] = new
    for k in range(here.p.size):
        new, old, now = memory.new_p[k], memory.p[k], here.p[k]
        if new != old or (now != old and _is_assigned(rules, event, t, u, memory, k, True)):
            here.p[k] = new


@_inner
def fire(rules, common, here, t, y, u, memory):
    """Execute what is due at a time, and what that sets off; return whether it came to an end."""
    set_inputs(common, here, t, u)
    memory.due[:] = False
    _copy(y, memory.y)
    _copy(here.p, memory.p)
    _notice(rules, here, t, y, u, memory)
    for _ in range(MAX_CASCADE):
        event = -1
        for k in range(memory.due.size):
            if memory.due[k]:
                event = k
                break
        if event < 0:
            return True
        memory.due[event] = False
        _execute(rules, event, here, t, y, u, memory)
        waiting = False
        for k in range(memory.due.size):
            waiting = waiting or memory.due[k]
        if not waiting:  # what is set off now fires in this state
            _copy(y, memory.y)
            _copy(here.p, memory.p)
        _notice(rules, here, t, y, u, memory)
    return False
