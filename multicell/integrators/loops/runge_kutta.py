"""Loops of explicit Runge-Kutta methods."""

from __future__ import annotations

import math

import numpy as np
from numba.extending import register_jitable

from multicell.integrators.stepping import (
    _SHORTEST,
    DONE,
    MOVED,
    OUT_OF_STEPS,
    REJECTIONS,
    STALLED,
    STEPS,
    Report,
    combine,
    compiled,
    copy,
    error_of,
    evaluate,
    fitted,
    furthest_moved,
    largest_length,
    next_step,
    shorter,
    starting_step,
    weighted_rms,
)


@register_jitable
def _stages(source, pairs, tableau, slopes, position, elapsed, step, trial):
    """Evaluate all stages but the first; ``trial`` is left at the last one."""
    for i in range(1, tableau.c.size):
        combine(position, step, tableau.a[i], slopes, i, trial)
        status, pairs = evaluate(source, pairs, elapsed + tableau.c[i] * step, trial, slopes[i])
        if status != DONE:
            return status, pairs
    return DONE, pairs


@compiled
def fixed_runge_kutta(source, pairs, position, length, radius, counts, steps, allowed, tableau):
    """Take equal steps of a Runge-Kutta method."""
    slopes = np.empty((tableau.c.size, position.shape[0], 3))
    trial = np.empty_like(position)
    step = length / steps
    for k in range(steps):
        elapsed = k * step
        status, pairs = evaluate(source, pairs, elapsed, position, slopes[0])
        if status == DONE:
            status, pairs = _stages(source, pairs, tableau, slopes, position, elapsed, step, trial)
        if status != DONE:
            return Report(status, elapsed, step, -1, math.inf, math.nan), pairs
        combine(position, step, tableau.b, slopes, tableau.c.size, trial)
        cell, moved = furthest_moved(position, trial, radius)
        if moved > allowed:
            return Report(MOVED, elapsed, step, cell, moved, math.nan), pairs
        copy(trial, position)
        counts[STEPS] += 1
    return Report(DONE, length, step, -1, 0.0, math.nan), pairs


@compiled
def adaptive_runge_kutta(source, pairs, position, length, radius, counts, control, tableau):
    """Take steps of an embedded pair under error control."""
    last = tableau.c.size - 1
    slopes = np.empty((tableau.c.size, position.shape[0], 3))
    trial, error = np.empty_like(position), np.empty_like(position)
    elapsed, previous, accepted, cell, moved, worst = 0.0, 1.0, 0, -1, 0.0, 0.0
    status, pairs = evaluate(source, pairs, 0.0, position, slopes[0])
    if status != DONE:
        return Report(status, 0.0, 0.0, -1, math.inf, math.nan), pairs
    step, pairs = starting_step(
        source, pairs, control, position, slopes[0], trial, error, length, radius
    )
    held = False
    while elapsed < length:
        step = fitted(step, length - elapsed)
        if accepted == control.most_steps or step < _SHORTEST * length:
            status = OUT_OF_STEPS if accepted == control.most_steps else STALLED
            return Report(status, elapsed, step, cell, moved, math.nan), pairs
        status, pairs = _stages(source, pairs, tableau, slopes, position, elapsed, step, trial)
        # the result, where the last stage was
        cell, moved = furthest_moved(position, trial, radius)
        if status != DONE or moved > control.max_displacement:
            counts[REJECTIONS] += 1
            step, held = shorter(step, moved, control.max_displacement), True
            continue
        error_of(step, tableau.error, slopes, error)
        size = weighted_rms(error, position, trial, control.rtol, control.atol)
        size /= control.strictness
        if not size <= 1.0:
            counts[REJECTIONS] += 1
            step, held = next_step(step, size, previous, control.order, True), True
            continue
        whole = step == length - elapsed
        elapsed = length if whole else elapsed + step
        copy(trial, position)
        copy(slopes[last], slopes[0])
        worst = max(worst, largest_length(error))
        counts[STEPS] += 1
        accepted += 1
        wanted = next_step(step, size, previous, control.order, False)
        # no growth right after a refusal
        step, held = (min(step, wanted) if held else wanted), False
        previous = max(size, 1e-4)
    return Report(DONE, length, step, -1, 0.0, worst), pairs
