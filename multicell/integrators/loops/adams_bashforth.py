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

from multicell.integrators.stepping import (
    DONE,
    EVALUATIONS,
    MOVED,
    OUT_OF_STEPS,
    REJECTIONS,
    STALLED,
    STEPS,
    TOO_LONG,
    Report,
    combine,
    compiled,
    copy,
    displace,
    evaluate,
    furthest_moved,
    largest_length,
    next_step,
    shorter,
    weighted_rms,
)

_SHORTEST = 1e-13
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
        cell, moved = furthest_moved(position, trial, radius)
        if moved > allowed:
            return Report(MOVED, elapsed, step, cell, moved, math.nan), pairs
        copy(trial, position)
        counts[STEPS] += 1
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
    elapsed, previous, last, moved, cell = 0.0, 1.0, 0.0, 0.0, -1
    accepted, tried, before, worst = 0, 0, counts[EVALUATIONS], 0.0
    status, pairs = evaluate(source, pairs, 0.0, position, slopes[now])
    if status != DONE:
        return Report(status, 0.0, 0.0, -1, math.inf, math.nan), pairs
    # not further than the neighbour list reaches: a refused trial would cost two lists
    displace(position, 1.0, slopes[now], trial)
    cell, moved = furthest_moved(position, trial, radius)
    step, held = 0.5 * length, False
    if moved * step > 0.14 * control.max_displacement:
        step = 0.14 * control.max_displacement / moved
    while elapsed < length:
        left = length - elapsed
        # equal steps to the end, so that no tiny one is left over
        if step > _SHORTEST * length:
            step = left / np.ceil(left / step * (1.0 - 1e-12))
        if accepted == control.most_steps or step < _SHORTEST * length:
            status = OUT_OF_STEPS if accepted == control.most_steps else STALLED
            return Report(status, elapsed, step, cell, moved, math.nan), pairs
        if patience and tried >= _TRIED:
            expected = counts[EVALUATIONS] - before + left / step
            if expected > patience:
                return Report(TOO_LONG, elapsed, step, -1, expected, math.nan), pairs
        tried += 1
        status = DONE
        if accepted == 0:
            displace(position, step, slopes[now], trial)
            cell, moved = furthest_moved(position, trial, radius)
            if moved <= 4.0 * control.max_displacement:
                status, pairs = evaluate(source, pairs, step, trial, slopes[old])
                _weigh(0.5 * step, slopes[now], 0.5 * step, slopes[old], position, trial)
                cell, moved = furthest_moved(position, trial, radius)
        else:
            r = step / last
            _weigh(
                step * (1.0 + 0.5 * r), slopes[now], -0.5 * r * step, slopes[old], position, trial
            )
            cell, moved = furthest_moved(position, trial, radius)
        if status == DONE and moved <= control.max_displacement:
            status, pairs = evaluate(source, pairs, elapsed + step, trial, slopes[new])
        if status != DONE or moved > control.max_displacement:
            counts[REJECTIONS] += 1
            step, held = shorter(step, moved, control.max_displacement), True
            continue
        if accepted == 0:
            _difference(0.5 * step, slopes[new], -0.5 * step, slopes[old], error)
        else:
            share = step * (3.0 + 2.0 * r) / (3.0 + 3.0 * r)
            _milne(share, r, slopes[new], slopes[now], slopes[old], error)
        size = weighted_rms(error, position, trial, control.rtol, control.atol)
        size /= control.strictness
        if not size <= 1.0:
            counts[REJECTIONS] += 1
            least = 0.2 if accepted else 0.02
            step, held = step * max(least, 0.9 * size ** (-1.0 / control.order)), True
            if not math.isfinite(size):
                step *= 0.2
            continue
        whole = step == left
        elapsed = length if whole else elapsed + step
        copy(trial, position)
        old, now, new = now, new, old
        worst = max(worst, largest_length(error))
        counts[STEPS] += 1
        accepted += 1
        last = step
        wanted = min(next_step(step, size, previous, control.order, False), 2.0 * step)
        # a step that hardly changes is kept: the formula is at its best with equal steps
        if 0.9 * step < wanted < 1.2 * step:
            wanted = step
        step, held = (min(step, wanted) if held else wanted), False
        previous = max(size, 1e-4)
    return Report(DONE, length, step, -1, 0.0, worst), pairs


@compiled
def _weigh(a, u, b, v, position, out):
    """Write position + a u + b v."""
    x, p, q, y = position.reshape(-1), u.reshape(-1), v.reshape(-1), out.reshape(-1)
    for k in range(y.size):
        y[k] = x[k] + a * p[k] + b * q[k]


@compiled
def _difference(a, u, b, v, out):
    """Write a u + b v."""
    p, q, y = u.reshape(-1), v.reshape(-1), out.reshape(-1)
    for k in range(y.size):
        y[k] = a * p[k] + b * q[k]


@compiled
def _milne(share, r, new, now, old, out):
    """Write share times what the trapezoidal rule and the Adams-Bashforth formula differ by."""
    p, q, s, y = new.reshape(-1), now.reshape(-1), old.reshape(-1), out.reshape(-1)
    for k in range(y.size):
        y[k] = share * (0.5 * p[k] - (0.5 + 0.5 * r) * q[k] + 0.5 * r * s[k])
