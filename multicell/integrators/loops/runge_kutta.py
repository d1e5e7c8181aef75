"""Loops of explicit Runge-Kutta methods."""

from __future__ import annotations

import math

import numpy as np
from numba.extending import register_jitable

from multicell.integrators.stepping import (
    DONE,
    DT,
    ELAPSED,
    MOVED,
    Report,
    accept_step,
    combine_slopes,
    compiled,
    control_state,
    copy,
    error_of,
    evaluate,
    fit_step,
    furthest_move,
    refuse_step,
    starting_step,
    stop_reason,
    take_fixed_step,
)


@register_jitable
def _stages(source, pairs, tableau, slopes, position, elapsed, dt, trial):
    """Evaluate all stages but the first; ``trial`` is left at the last one."""
    for i in range(1, tableau.c.size):
        combine_slopes(position, dt, tableau.a[i], slopes, i, trial)
        status, pairs = evaluate(source, pairs, elapsed + tableau.c[i] * dt, trial, slopes[i])
        if status != DONE:
            return status, pairs
    return DONE, pairs


@compiled
def fixed_runge_kutta(source, pairs, position, length, radius, counts, steps, allowed, tableau):
    """Take equal steps of a Runge-Kutta method."""
    slopes = np.empty((tableau.c.size, position.shape[0], 3))
    trial = np.empty_like(position)
    dt = length / steps
    for k in range(steps):
        elapsed = k * dt
        status, pairs = evaluate(source, pairs, elapsed, position, slopes[0])
        if status == DONE:
            status, pairs = _stages(source, pairs, tableau, slopes, position, elapsed, dt, trial)
        if status != DONE:
            return Report(status, elapsed, dt, -1, math.inf), pairs
        combine_slopes(position, dt, tableau.b, slopes, tableau.c.size, trial)
        cell, moved = take_fixed_step(position, trial, radius, allowed, counts)
        if not moved <= allowed:
            return Report(MOVED, elapsed, dt, cell, moved), pairs
    return Report(DONE, length, dt, -1, 0.0), pairs


@compiled
def adaptive_runge_kutta(source, pairs, position, length, radius, counts, control, tableau):
    """Take steps of an embedded pair under error control."""
    last = tableau.c.size - 1
    slopes = np.empty((tableau.c.size, position.shape[0], 3))
    trial, error = np.empty_like(position), np.empty_like(position)
    cell, moved = -1, 0.0
    status, pairs = evaluate(source, pairs, 0.0, position, slopes[0])
    if status != DONE:
        return Report(status, 0.0, 0.0, -1, math.inf), pairs
    dt, pairs = starting_step(
        source, pairs, control, position, slopes[0], trial, error, length, radius
    )
    walk = control_state(dt)
    while walk[ELAPSED] < length:
        elapsed = walk[ELAPSED]
        dt = walk[DT] = fit_step(walk[DT], length - elapsed)
        status = stop_reason(walk, counts, control, length)
        if status != DONE:
            return Report(status, elapsed, dt, cell, moved), pairs
        status, pairs = _stages(source, pairs, tableau, slopes, position, elapsed, dt, trial)
        # the result, where the last stage was
        cell, moved = furthest_move(position, trial, radius)
        if refuse_step(walk, counts, control, status, moved):
            continue
        error_of(dt, tableau.error, slopes, error)
        if accept_step(walk, counts, control, length, position, trial, error, 0.2, 5.0, False):
            copy(slopes[last], slopes[0])
    return Report(DONE, length, walk[DT], -1, 0.0), pairs
