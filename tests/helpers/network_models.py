"""Networks for tests, with what is known of them from elsewhere."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from multicell.networks.network import Event, Network


def network(rates: Any, start: dict[str, float], **parts: Any) -> Network:
    """Return a network of a function; parts are by name -> value, as the fields of Network."""
    inputs, parameters = parts.pop("inputs", {}), parts.pop("parameters", {})
    return Network(
        name=rates.__name__,
        states=tuple(start),
        start=tuple(start.values()),
        inputs=tuple(inputs),
        defaults=tuple(inputs.values()),
        parameters=tuple(parameters),
        values=tuple(parameters.values()),
        rates=rates,
        source="",
        **{"observed": (), "observe": None, **parts},
    )


def decay(t, y, u, p, out):
    """Exponential decay towards an input."""
    out[0] = p[0] * (u[0] - y[0])


def brusselator(t, y, u, p, out):
    """The Brusselator; it is driven in time by the input."""
    out[0] = p[0] + u[0] * math.sin(t) + y[0] * y[0] * y[1] - (p[1] + 1.0) * y[0]
    out[1] = p[1] * y[0] - y[0] * y[0] * y[1]


def robertson(t, y, u, p, out):
    """Robertson's reactions: stiff, mass is kept."""
    slow, fast = 0.04 * y[0], 1e4 * y[1] * y[2]
    faster = 3e7 * y[1] * y[1]
    out[0] = fast - slow
    out[1] = slow - fast - faster
    out[2] = faster


def forced(t, y, u, p, out):
    """Two states driven in time: exp(sin t) and exp(-sin t)."""
    out[0] = y[0] * math.cos(t)
    out[1] = -y[0] * math.cos(t) * y[1] * y[1]


FORCED = network(forced, {"a": 1.0, "b": 1.0})
DECAY = network(decay, {"A": 1.0}, inputs={"source": 0.0}, parameters={"k": 2.0})
BRUSSELATOR = network(
    brusselator, {"X": 1.5, "Y": 3.0}, inputs={"drive": 0.0}, parameters={"a": 1.0, "b": 3.0}
)
ROBERTSON = network(robertson, {"A": 1.0, "B": 0.0, "C": 0.0})


def clock(t, y, u, p, out):
    """A value that rises at a constant rate, and a count of what events do."""
    out[0] = p[0]
    out[1] = 0.0


def high(t, y, u, p):
    return y[0] - p[1]


def reset(t, y, u, p, y_then, p_then):
    y[0] = 0.0
    y[1] = y_then[1] + 1.0


CLOCK = network(
    clock,
    {"phase": 0.0, "rounds": 0.0},
    parameters={"rate": 1.0, "limit": 0.7},
    events=(Event("reset", high, reset),),
)


def rows(count: int, *values: float) -> Any:
    """Return the same inputs for many cells, (count, m)."""
    return np.tile(np.array(values, dtype=float), (count, 1))


WRITTEN = """model hif
  compartment cell = 1
  species HIF in cell = 0.1
  made: -> HIF; cell * k_made
  lost: HIF -> ; cell * k_lost * O2 * HIF
  k_made = 0.01; k_lost = 0.3; O2 = 0.1
  unit time_unit = 60 second
end
"""
"""A network in the language of Antimony, and a scene beside whose file it lies."""
WITH_NETWORK = """duration = "4 h"
initial = { count = 4 }
nutrients.oxygen.boundary = "0.1 mM"
output.every = "2 h"
growth = { cycle_time = "6 h" }
[networks.hif]
file = "own.ant"
inputs = { O2 = "oxygen" }
units = { O2 = "mM" }
"""
