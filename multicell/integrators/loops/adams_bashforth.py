"""Loops of Adams-Bashforth of order 2: one evaluation a step.

Under error control, with r the ratio of a step h to the one before,

    x(n+1) = x(n) + h ((1 + r/2) f(n) - r/2 f(n-1)).

The velocity at the new state is needed for the next step anyway. It also gives the trapezoidal
rule's result, and the distance of the two is the estimate of the error (Milne's device; Hairer,
Nørsett & Wanner I, III.1), of order h³: its share of the difference is (3 + 2r) / (3 + 3r).

The first step of an interval is Heun's. The distance between its result and the one of its
corrector applied once more has the same order, and costs nothing either.
"""

from __future__ import annotations

import math

import numpy as np

from multicell.integrators.fused import assess, chunks, foresee
from multicell.integrators.stepping import (
    _SHORTEST,
    DONE,
    DT,
    ELAPSED,
    EVALUATIONS,
    MOVED,
    TOO_LONG,
    Report,
    combine_slopes,
    compiled,
    control_state,
    control_step,
    copy,
    displace,
    evaluate,
    refuse_step,
    stop_reason,
    take_fixed_step,
)

_TRIED = 6  # steps, refused ones too, after which the rest of the way is estimated


@compiled
def fixed_adams(source, pairs, position, length, radius, counts, steps, allowed):
    """Take equal steps of the two-step Adams-Bashforth method, the first one by Heun's."""
    slopes = np.empty((2, position.shape[0], 3))
    trial = np.empty_like(position)
    dt = length / steps
    weights = np.full(2, 0.5)
    for k in range(steps):
        elapsed = k * dt
        # the newest slope goes where the oldest was
        new = k % 2
        status, pairs = evaluate(source, pairs, elapsed, position, slopes[new])
        if k == 0 and status == DONE:
            displace(position, dt, slopes[0], trial)
            status, pairs = evaluate(source, pairs, dt, trial, slopes[1])
        elif k > 0:
            weights[new], weights[1 - new] = 1.5, -0.5
        if status != DONE:
            return Report(status, elapsed, dt, -1, math.inf), pairs
        combine_slopes(position, dt, weights, slopes, 2, trial)
        cell, moved = take_fixed_step(position, trial, radius, allowed, counts)
        if not moved <= allowed:
            return Report(MOVED, elapsed, dt, cell, moved), pairs
    return Report(DONE, length, dt, -1, 0.0), pairs


@compiled
def adaptive_adams(source, pairs, position, length, radius, counts, control, patience):
    """Take steps of the two-step Adams-Bashforth method under error control.

    It gives up where the interval would take more evaluations than ``patience``, judged by the
    present step; zero for any number.
    """
    slopes = np.empty((3, position.shape[0], 3))
    # a step that is taken changes the places of the two
    here, trial = position, np.empty_like(position)
    found = chunks(position)
    old, now, new = 0, 1, 2
    last, tried, first = 0.0, 0, counts[EVALUATIONS]
    status, pairs = evaluate(source, pairs, 0.0, here, slopes[now])
    if status != DONE:
        return Report(status, 0.0, 0.0, -1, math.inf), pairs
    # not further than the neighbour list reaches: a refused trial would cost two lists
    cell, moved = foresee(source, 1.0, slopes[now], 0.0, slopes[now], here, radius, trial, found)
    walk = control_state(0.5 * length)
    if moved * walk[DT] > 0.14 * control.max_displacement:
        walk[DT] = 0.14 * control.max_displacement / moved
    while walk[ELAPSED] < length:
        elapsed, dt = walk[ELAPSED], walk[DT]
        left = length - elapsed
        # equal steps to the end, so that no tiny one is left over
        if dt > _SHORTEST * length:
            dt = walk[DT] = left / np.ceil(left / dt * (1.0 - 1e-12))
        status = stop_reason(walk, counts, control, length)
        if status == DONE and patience and tried >= _TRIED:
            expected = counts[EVALUATIONS] - first + left / dt
            if expected > patience:
                status, cell, moved = TOO_LONG, -1, expected
        if status != DONE:
            copy(here, position)
            return Report(status, elapsed, dt, cell, moved), pairs
        tried += 1
        r = dt / last if last > 0.0 else 0.0
        ahead, behind, other = dt * (1.0 + 0.5 * r), -0.5 * r * dt, old
        if last == 0.0:
            _, moved = foresee(
                source, dt, slopes[now], 0.0, slopes[now], here, radius, trial, found
            )
            ahead, behind, other = 0.5 * dt, 0.5 * dt, now
            if moved <= 4.0 * control.max_displacement:
                status, pairs = evaluate(source, pairs, dt, trial, slopes[old])
                other = old
        cell, moved = foresee(
            source, ahead, slopes[now], behind, slopes[other], here, radius, trial, found
        )
        if status == DONE and moved <= control.max_displacement:
            status, pairs = evaluate(source, pairs, elapsed + dt, trial, slopes[new])
        if refuse_step(walk, counts, control, status, moved):
            continue
        if last > 0.0:
            share = dt * (3.0 + 2.0 * r) / (3.0 + 3.0 * r)
            least = 0.2
        else:
            # of Heun's and its corrector once more; now counts for nothing
            share, least = dt, 0.02
        b, c = (-0.5 * (1.0 + r), 0.5 * r) if last > 0.0 else (0.0, -0.5)
        size = assess(
            source,
            0.5 * share,
            slopes[new],
            b * share,
            slopes[now],
            c * share,
            slopes[old],
            here,
            trial,
            control,
            found,
        )
        # the formula is at its best with equal steps
        if control_step(walk, counts, control, length, size, least, 2.0, True):
            here, trial = trial, here
            old, now, new = now, new, old
            last = dt
    copy(here, position)
    return Report(DONE, length, walk[DT], -1, 0.0), pairs
