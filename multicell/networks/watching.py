"""Values of networks that cells wait for: when in a step one of them passes a level.

Between the ends of an accepted step the state is Hermite's cubic. Where that passes the level, the
step is taken anew, shorter, until its end lies at the passage: so the time is as exact as a step.
"""

from __future__ import annotations

import math
from typing import NamedTuple, final

from multicell.compiling import UNCOUNTED, typed
from multicell.networks.kernels import call_rates, set_inputs

_inner = typed(**UNCOUNTED)

LOOKS = 4
"""Parts of a step in which passages and events are looked for."""

_OVERSHOOT = 4.0 / 27.0  # of its slope at one end, by which a cubic can lie beyond both ends


@final
class Watch(NamedTuple):
    """Condition that one cell waits for: ``sign`` (value - ``level``) > 0, from ``since`` on.

    - ``observe``: address of the observed values; 0 without any
    - ``place``: of the value among states, parameters, inputs and observed values, in this order
    - ``since``: time in the network's own unit; infinite where the cell waits for nothing
    """

    observe: int
    place: int
    sign: float
    level: float
    since: float


@_inner
def excess_of(watch, here, t, y, u, seen):
    """Return by how much a value is beyond the level."""
    states, parameters = y.size, here.p.size
    place = watch.place
    if place < states:
        value = y[place]
    elif place < states + parameters:
        value = here.p[place - states]
    else:
        set_inputs(here, t, u)
        place -= states + parameters
        if place < u.size:
            value = u[place]
        else:
            call_rates(watch.observe, t, y, u, here.p, seen)
            value = seen[place - u.size]
    return watch.sign * (value - watch.level)


@_inner
def between(h, x, y, s, state):
    """Write Hermite's cubic at the part ``x`` of a step to ``state``.

    ``s.f`` and ``s.slope`` have the rates at both ends, ``y`` and ``s.trial`` the states.
    """
    for k in range(y.size):
        a, b = h * s.f[k], h * s.slope[k]
        d = s.trial[k] - y[k]
        state[k] = y[k] + x * (a + x * (3.0 * d - 2.0 * a - b + x * (a + b - 2.0 * d)))


@_inner
def stays_below(watch, h, y, s):
    """Return whether the cubic of a state cannot come to the level between the ends."""
    k = watch.place
    if k >= y.size:
        return False
    highest = max(watch.sign * (y[k] - watch.level), watch.sign * (s.trial[k] - watch.level))
    rise, fall = watch.sign * s.f[k], -watch.sign * s.slope[k]
    return highest + _OVERSHOOT * h * (max(rise, 0.0) + max(fall, 0.0)) < 0.0


@_inner
def passage_within(watch, here, t, h, y, s, seen):
    """Return between which parts of an accepted step a value first comes beyond its level.

    Returns low, high; both the same where it is there already, and high above 1 where it does not.
    """
    low = (watch.since - t) / h if watch.since > t else 0.0
    between(h, low, y, s, s.point)
    if excess_of(watch, here, t + low * h, s.point, s.u, seen) > 0.0:
        return low, low
    first = low
    for look in range(1, LOOKS + 1):
        high = first + (1.0 - first) * look / LOOKS
        between(h, high, y, s, s.point)
        if excess_of(watch, here, t + high * h, s.point, s.u, seen) > 0.0:
            return low, high
        low = high
    return 0.0, 2.0


@_inner
def no_watch():
    """Return the watch of a cell that waits for nothing."""
    return Watch(0, 0, 1.0, 0.0, math.inf)
