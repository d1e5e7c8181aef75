"""Events of networks, located and carried out within a step of one cell."""

from __future__ import annotations

import math
from typing import NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import FloatArray, IntArray
from multicell.compiling import INNER, UNCOUNTED, typed
from multicell.networks.kernels import call_assign, call_trigger, set_inputs
from multicell.networks.network import Network

_inner = typed(**UNCOUNTED)

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
    - ``y``, (k, s); ``p``, (k, q): in which state each of them has become due
    """

    was: FloatArray
    due: NDArray[np.bool_]
    y: FloatArray
    p: FloatArray


def event_rules(network: Network, triggers: IntArray, assigns: IntArray) -> EventRules:
    """Return the events of a network; the order is by priority, and then that of the network."""
    order = _order(network)
    persistent = np.array([network.events[k].persistent for k in order], dtype=np.bool_)
    return EventRules(triggers[order], assigns[order], persistent)


def first_conditions(network: Network) -> FloatArray:
    """Return the conditions that count before the start, (k,), in the order of the rules.

    0: false; -1: what it is at the start, which fires nothing.
    """
    return np.array([-1.0 if network.events[k].initial else 0.0 for k in _order(network)])


def _order(network: Network) -> NDArray[np.int64]:
    urgency = [np.inf if e.priority is None else -e.priority for e in network.events]
    return np.argsort(np.array(urgency), kind="stable").astype(np.int64)


@typed(**INNER)
def event_memory(events, states, parameters):
    """Return memory for a thread."""
    return EventMemory(
        np.empty(events),
        np.zeros(events, np.bool_),
        np.empty((events, states)),
        np.empty((events, parameters)),
    )


@_inner
def highest_rise(rules, here, t, y, u, was):
    """Return the largest value of conditions that were false: above 0 where one is true now."""
    set_inputs(here, t, u)
    highest = -math.inf
    for k in range(rules.triggers.size):
        if was[k] == 0.0:
            value = call_trigger(rules.triggers[k], t, y, u, here.p)
            highest = value if value > highest else highest  # not one that is no number
    return highest


@_inner
def note_conditions(rules, here, t, y, u, was):
    """Write which conditions are true now."""
    set_inputs(here, t, u)
    for k in range(rules.triggers.size):
        was[k] = 1.0 if call_trigger(rules.triggers[k], t, y, u, here.p) > 0.0 else 0.0


@_inner
def _notice(rules, here, t, y, u, memory):
    """Mark what has become due, with the state of that moment."""
    for k in range(rules.triggers.size):
        now = 1.0 if call_trigger(rules.triggers[k], t, y, u, here.p) > 0.0 else 0.0
        if now == 1.0 and memory.was[k] == 0.0:
            memory.due[k] = True
            for i in range(y.size):
                memory.y[k, i] = y[i]
            for i in range(here.p.size):
                memory.p[k, i] = here.p[i]
        if now == 0.0 and not rules.persistent[k]:
            memory.due[k] = False
        memory.was[k] = now


@_inner
def fire(rules, here, t, y, u, memory):
    """Execute what is due at a time, and what that sets off; return whether it came to an end."""
    set_inputs(here, t, u)
    memory.due[:] = False
    _notice(rules, here, t, y, u, memory)
    for _ in range(MAX_CASCADE):
        event = -1
        for k in range(memory.due.size - 1, -1, -1):
            if memory.due[k]:
                event = k
        if event < 0:
            return True
        memory.due[event] = False
        call_assign(rules.assigns[event], t, y, u, here.p, memory.y[event], memory.p[event])
        _notice(rules, here, t, y, u, memory)
    return False
