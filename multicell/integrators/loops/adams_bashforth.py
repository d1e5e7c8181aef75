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

from multicell.compiling import arithmetic
from multicell.integrators.stepping import (
    _SHORTEST,
    DONE,
    ELAPSED,
    EVALUATIONS,
    MOVED,
    STEP,
    TOO_LONG,
    WORST,
    Report,
    accepted,
    begun,
    combine,
    compiled,
    displace,
    ended,
    evaluate,
    furthest_moved,
    moved_on,
    refused,
)

_TRIED = 6  # steps, refused ones too, after which the rest of the way is estimated


@compiled
def fixed_adams(source, pairs, position, length, radius, counts, steps, allowed):
    """Take equal steps of the two-step Adams-Bashforth method, the first one by Heun's."""
    slopes = np.empty((2, position.shape[0], 3))
    trial = np.empty_like(position)
    step = length / steps
    weights = np.full(2, 0.5)
    for k in range(steps):
        elapsed = k * step
        # the newest slope goes where the oldest was
        new = k % 2
        status, pairs = evaluate(source, pairs, elapsed, position, slopes[new])
        if k == 0 and status == DONE:
            displace(position, step, slopes[0], trial)
            status, pairs = evaluate(source, pairs, step, trial, slopes[1])
        elif k > 0:
            weights[new], weights[1 - new] = 1.5, -0.5
        if status != DONE:
            return Report(status, elapsed, step, -1, math.inf, math.nan), pairs
        combine(position, step, weights, slopes, 2, trial)
        cell, moved = moved_on(position, trial, radius, allowed, counts)
        if not moved <= allowed:
            return Report(MOVED, elapsed, step, cell, moved, math.nan), pairs
    return Report(DONE, length, step, -1, 0.0, math.nan), pairs


@compiled
def adaptive_adams(source, pairs, position, length, radius, counts, control, patience):
    """Take steps of the two-step Adams-Bashforth method under error control.

    It gives up where the interval would take more evaluations than ``patience``, judged by the
    present step; zero for any number.
    """
    slopes = np.empty((3, position.shape[0], 3))
    trial, error = np.empty_like(position), np.empty_like(position)
    old, now, new = 0, 1, 2
    last, tried, first = 0.0, 0, counts[EVALUATIONS]
    status, pairs = evaluate(source, pairs, 0.0, position, slopes[now])
    if status != DONE:
        return Report(status, 0.0, 0.0, -1, math.inf, math.nan), pairs
    # not further than the neighbour list reaches: a refused trial would cost two lists
    displace(position, 1.0, slopes[now], trial)
    cell, moved = furthest_moved(position, trial, radius)
    walk = begun(0.5 * length)
    if moved * walk[STEP] > 0.14 * control.max_displacement:
        walk[STEP] = 0.14 * control.max_displacement / moved
    while walk[ELAPSED] < length:
        elapsed, step = walk[ELAPSED], walk[STEP]
        left = length - elapsed
        # equal steps to the end, so that no tiny one is left over
        if step > _SHORTEST * length:
            step = walk[STEP] = left / np.ceil(left / step * (1.0 - 1e-12))
        status = ended(walk, counts, control, length)
        if status != DONE:
            return Report(status, elapsed, step, cell, moved, math.nan), pairs
        if patience and tried >= _TRIED:
            expected = counts[EVALUATIONS] - first + left / step
            if expected > patience:
                return Report(TOO_LONG, elapsed, step, -1, expected, math.nan), pairs
        tried += 1
        r = step / last if last > 0.0 else 0.0
        if last > 0.0:
            _weigh(
                step * (1.0 + 0.5 * r), slopes[now], -0.5 * r * step, slopes[old], position, trial
            )
        else:
            displace(position, step, slopes[now], trial)
            _, moved = furthest_moved(position, trial, radius)
            if moved <= 4.0 * control.max_displacement:
                status, pairs = evaluate(source, pairs, step, trial, slopes[old])
                _weigh(0.5 * step, slopes[now], 0.5 * step, slopes[old], position, trial)
        cell, moved = furthest_moved(position, trial, radius)
        if status == DONE and moved <= control.max_displacement:
            status, pairs = evaluate(source, pairs, elapsed + step, trial, slopes[new])
        if refused(walk, counts, control, status, moved):
            continue
        if last > 0.0:
            share = step * (3.0 + 2.0 * r) / (3.0 + 3.0 * r)
            _milne(share, r, slopes[new], slopes[now], slopes[old], error)
            least = 0.2
        else:
            _difference(0.5 * step, slopes[new], -0.5 * step, slopes[old], error)
            least = 0.02
        # the formula is at its best with equal steps
        if accepted(walk, counts, control, length, position, trial, error, least, 2.0, True):
            old, now, new = now, new, old
            last = step
    return Report(DONE, length, walk[STEP], -1, 0.0, walk[WORST]), pairs


@arithmetic
def _weigh(a, u, b, v, position, out):
    """Write position + a u + b v."""
    x, p, q, y = position.reshape(-1), u.reshape(-1), v.reshape(-1), out.reshape(-1)
    for k in range(y.size):
        y[k] = x[k] + a * p[k] + b * q[k]


@arithmetic
def _difference(a, u, b, v, out):
    """Write a u + b v."""
    p, q, y = u.reshape(-1), v.reshape(-1), out.reshape(-1)
    for k in range(y.size):
        y[k] = a * p[k] + b * q[k]


@arithmetic
def _milne(share, r, new, now, old, out):
    """Write share times what the trapezoidal rule and the Adams-Bashforth formula differ by."""
    p, q, s, y = new.reshape(-1), now.reshape(-1), old.reshape(-1), out.reshape(-1)
    for k in range(y.size):
        y[k] = share * (0.5 * p[k] - (0.5 + 0.5 * r) * q[k] + 0.5 * r * s[k])
