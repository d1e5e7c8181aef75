"""Loops of stabilised Runge-Kutta: RKC2 of Sommeijer, Shampine & Verwer (1998).

With s stages RKC2 is of order two and stable for steps up to β(s)/λ,
β(s) ≈ 2/3 (s² - 1)(1 - 2ε/15) with the damping ε = 2/13, where λ is the largest decay rate:
s² times further than Euler for s evaluations. The spectrum must be close to the negative real
axis; here J is self-adjoint in the scalar product of the drag coefficients, so it is real.

λ is estimated by a few steps of Lanczos' method in that scalar product, with difference
quotients of the velocity as products: no Jacobian is needed. The estimate plus its residual
is used, and the vector that was found starts the next estimate, together with the estimated
error of the last step, in which a mode that has become unstable stands out.
"""

from __future__ import annotations

import math

import numpy as np
from numba.extending import register_jitable

from multicell.compiling import arithmetic
from multicell.integrators.stepping import (
    DONE,
    DT,
    ELAPSED,
    MOVED,
    Report,
    accept_step,
    compiled,
    control_state,
    copy,
    displace,
    evaluate,
    fit_step,
    furthest_move,
    part_of_step,
    refuse_step,
    shorten_step,
    starting_step,
    stop_reason,
    take_fixed_step,
)

DAMPING = 2.0 / 13.0  # ε of Sommeijer, Shampine and Verwer (1998)
_SAFETY = 1.1  # on the estimated λ, which may be low
_COLD, _WARM = 10, 3
"""Products for an estimate from nothing, or after a refusal, and for a refreshed one."""
_AGE = 10  # steps after which the estimate is refreshed
_MU, _NU, _MU_SLOPE, _GAMMA_SLOPE, _TIME = range(5)  # columns of the coefficients
_PROBE = 1e-5  # root mean square displacement of a difference quotient, in mean radii


@arithmetic
def stable_length(stages):
    """Return β(s): the largest stable product of step and decay rate."""
    w0 = 1.0 + DAMPING / stages**2
    t, d, b = 1.0, 0.0, 0.0
    t1, d1, b1 = w0, 1.0, 0.0
    for _ in range(2, stages + 1):
        t, t1 = t1, 2.0 * w0 * t1 - t
        # t is now the former last polynomial, whose double enters the derivative
        d, d1 = d1, 2.0 * t + 2.0 * w0 * d1 - d
        b, b1 = b1, 4.0 * d + 2.0 * w0 * b1 - b
    return (w0 + 1.0) * b1 / d1


@arithmetic
def coefficients(stages):
    """Return (s + 1, 5) with μ, ν, μ~, γ~ and the time c of each stage."""
    w0 = 1.0 + DAMPING / stages**2
    t, d, b = np.zeros(stages + 1), np.zeros(stages + 1), np.zeros(stages + 1)
    t[0], t[1], d[1] = 1.0, w0, 1.0
    for j in range(2, stages + 1):
        t[j] = 2.0 * w0 * t[j - 1] - t[j - 2]
        d[j] = 2.0 * t[j - 1] + 2.0 * w0 * d[j - 1] - d[j - 2]
        b[j] = 4.0 * d[j - 1] + 2.0 * w0 * b[j - 1] - b[j - 2]
    w1 = d[stages] / b[stages]
    weight = np.empty(stages + 1)
    for j in range(2, stages + 1):
        weight[j] = b[j] / d[j] ** 2
    weight[0] = weight[1] = weight[2]
    table = np.zeros((stages + 1, 5))
    table[1, _MU_SLOPE] = weight[1] * w1
    for j in range(2, stages + 1):
        table[j, _MU] = 2.0 * weight[j] * w0 / weight[j - 1]
        table[j, _NU] = -weight[j] / weight[j - 2]
        table[j, _MU_SLOPE] = 2.0 * weight[j] * w1 / weight[j - 1]
        table[j, _GAMMA_SLOPE] = -(1.0 - weight[j - 1] * t[j - 1]) * table[j, _MU_SLOPE]
        table[j, _TIME] = w1 * b[j] / d[j]
    # the time of the first stage is that at which it stands
    table[1, _TIME] = table[1, _MU_SLOPE]
    return table


@arithmetic
def _recur(row, dt, base, near, far, slope, slope0, out):
    """Write the next stage of the recurrence; as a displacement, to keep rounding small."""
    x0, x1, x2 = base.reshape(-1), near.reshape(-1), far.reshape(-1)
    f, f0, y = slope.reshape(-1), slope0.reshape(-1), out.reshape(-1)
    mu, nu = row[_MU], row[_NU]
    mt, gt = dt * row[_MU_SLOPE], dt * row[_GAMMA_SLOPE]
    for k in range(y.size):
        x = x0[k]
        y[k] = x + (mu * (x1[k] - x) + nu * (x2[k] - x) + mt * f[k] + gt * f0[k])


@register_jitable
def _chebyshev(source, pairs, table, position, slope0, elapsed, dt, work):
    """Take one step; the result is left in ``work[0]``."""
    far, near, new, slope = work[1], work[2], work[0], work[3]
    copy(position, far)
    displace(position, dt * table[1, _MU_SLOPE], slope0, near)
    for j in range(2, table.shape[0]):
        status, pairs = evaluate(source, pairs, elapsed + table[j - 1, _TIME] * dt, near, slope)
        if status != DONE:
            copy(near, new)
            return status, pairs
        _recur(table[j], dt, position, near, far, slope, slope0, new)
        copy(near, far)
        copy(new, near)
    return DONE, pairs


@arithmetic
def _estimate(dt, before, after, slope0, slope, out):
    """Write the estimated error of a step."""
    x, y, f0, f, e = (
        before.reshape(-1),
        after.reshape(-1),
        slope0.reshape(-1),
        slope.reshape(-1),
        out.reshape(-1),
    )
    for k in range(e.size):
        e[k] = 0.8 * (x[k] - y[k]) + 0.4 * dt * (f0[k] + f[k])


@arithmetic
def scaled(factor, values, out):
    """Write a multiple."""
    x, y = values.reshape(-1), out.reshape(-1)
    for k in range(y.size):
        y[k] = factor * x[k]


@arithmetic
def _dot(radius, a, b):
    total = 0.0
    for i in range(radius.size):
        total += radius[i] * (a[i, 0] * b[i, 0] + a[i, 1] * b[i, 1] + a[i, 2] * b[i, 2])
    return total


@arithmetic
def _scramble(out):
    """Fill with numbers that have no pattern, the same every time (integer hash)."""
    flat = out.reshape(-1)
    for k in range(flat.size):
        h = np.uint64(k + 1) * np.uint64(0x9E3779B97F4A7C15)
        h = (h ^ (h >> np.uint64(32))) * np.uint64(0xD6E8FEB86659FD93)
        h = h ^ (h >> np.uint64(32))
        flat[k] = np.float64(h >> np.uint64(11)) / 2.0**52 - 1.0


@arithmetic
def _mix(radius, vector, other):
    """Replace a vector by the sum of two directions of unit length."""
    one = math.sqrt(_dot(radius, vector, vector))
    two = math.sqrt(_dot(radius, other, other))
    one = 1.0 / one if one > 0.0 else 0.0
    two = 1.0 / two if two > 0.0 and math.isfinite(two) else 0.0
    for i in range(radius.size):
        for a in range(3):
            vector[i, a] = one * vector[i, a] + (two * other[i, a] if two > 0.0 else 0.0)


@arithmetic
def _dominant(alpha, beta, count):
    """Return the dominant eigenvalue of a small tridiagonal matrix, and its vector."""
    v, w = np.empty(count), np.empty(count)
    for k in range(count):
        v[k] = (-1.0) ** k / (1.0 + k)
    value = 0.0
    for _ in range(40 * count):
        for k in range(count):
            w[k] = alpha[k] * v[k]
            if k > 0:
                w[k] += beta[k] * v[k - 1]
            if k + 1 < count:
                w[k] += beta[k + 1] * v[k + 1]
        total = 0.0
        for k in range(count):
            total += w[k] * w[k]
        value = math.sqrt(total)
        if value == 0.0:
            break
        for k in range(count):
            v[k] = w[k] / value
    return value, v


@register_jitable
def spectral_radius(source, pairs, elapsed, position, slope, radius, vector, count):
    """Estimate the largest decay rate at a state by Lanczos' method, from above.

    ``vector`` is where to start; on return it is the direction that was found.
    """
    scale = _PROBE * radius.mean() * math.sqrt(3.0 * radius.sum())
    basis = np.empty((count, position.shape[0], 3))
    trial, product = np.empty_like(position), np.empty_like(position)
    alpha, beta = np.zeros(count), np.zeros(count + 1)
    length = math.sqrt(_dot(radius, vector, vector))
    if not length > 0.0:
        return 0.0, pairs
    scaled(1.0 / length, vector, basis[0])
    used, ceiling = 0, 0.0
    for k in range(count):
        displace(position, scale, basis[k], trial)
        status, pairs = evaluate(source, pairs, elapsed, trial, product)
        if status != DONE:
            break
        displace(product, -1.0, slope, product)
        scaled(1.0 / scale, product, product)
        ceiling = max(ceiling, math.sqrt(_dot(radius, product, product)))
        alpha[k] = _dot(radius, basis[k], product)
        displace(product, -alpha[k], basis[k], product)
        if k > 0:
            displace(product, -beta[k], basis[k - 1], product)
        beta[k + 1] = math.sqrt(_dot(radius, product, product))
        used += 1
        if not beta[k + 1] > 1e-6 * ceiling:
            break
        if used < count:
            scaled(1.0 / beta[used], product, basis[used])
    if used == 0:
        return 0.0, pairs
    value, small = _dominant(alpha, beta, used)
    scaled(small[0], basis[0], vector)
    for k in range(1, used):
        displace(vector, small[k], basis[k], vector)
    return value + beta[used] * abs(small[used - 1]), pairs


@arithmetic
def stages_for(dt, rate, most):
    """Return the number of stages that a step needs."""
    stages = 2
    while stages < most and stable_length(stages) < dt * rate:
        # the law says where to search, its exact value decides
        guess = int(min(math.sqrt(1.5 * dt * rate + 1.0), most + 1.0)) - 1
        stages = max(stages + 1, guess)
    return stages


@compiled
def fixed_chebyshev(
    source, pairs, position, length, radius, counts, steps, allowed, stages, most_stages
):
    """Take equal steps of RKC2, with ``stages`` stages or, if zero, as many as are needed."""
    work = np.empty((4, position.shape[0], 3))
    slope, vector = np.empty_like(position), np.empty_like(position)
    dt = length / steps
    table = coefficients(max(stages, 2))
    _scramble(vector)
    for k in range(steps):
        elapsed = k * dt
        status, pairs = evaluate(source, pairs, elapsed, position, slope)
        if stages == 0 and status == DONE and k % _AGE == 0:
            _mix(radius, vector, slope)
            rate, pairs = spectral_radius(
                source,
                pairs,
                elapsed,
                position,
                slope,
                radius,
                vector,
                _COLD if k == 0 else _WARM,
            )
            table = coefficients(stages_for(dt, _SAFETY * rate, most_stages))
        if status == DONE:
            status, pairs = _chebyshev(source, pairs, table, position, slope, elapsed, dt, work)
        if status != DONE:
            return Report(status, elapsed, dt, -1, math.inf), pairs
        cell, moved = take_fixed_step(position, work[0], radius, allowed, counts)
        if not moved <= allowed:
            return Report(MOVED, elapsed, dt, cell, moved), pairs
    return Report(DONE, length, dt, -1, 0.0), pairs


@compiled
def adaptive_chebyshev(source, pairs, position, length, radius, counts, control, most_stages):
    """Take steps of RKC2 under error control, each with as many stages as it needs."""
    work = np.empty((4, position.shape[0], 3))
    slope, vector = np.empty_like(position), np.empty_like(position)
    error = np.zeros_like(position)
    # a typed number: for a bare one the function would be compiled once more
    table = coefficients(np.int64(2))
    cell, moved = -1, 0.0
    status, pairs = evaluate(source, pairs, 0.0, position, slope)
    if status != DONE:
        return Report(status, 0.0, 0.0, -1, math.inf), pairs
    dt, pairs = starting_step(
        source, pairs, control, position, slope, work[0], work[1], length, radius
    )
    walk = control_state(dt)
    _scramble(vector)
    copy(slope, error)
    rate, products, age = 0.0, _COLD, 0
    while walk[ELAPSED] < length:
        elapsed = walk[ELAPSED]
        if products > 0:
            _mix(radius, vector, error)
            rate, pairs = spectral_radius(
                source, pairs, elapsed, position, slope, radius, vector, products
            )
            products, age = 0, 0
        if rate > 0.0:
            walk[DT] = min(walk[DT], stable_length(most_stages) / (_SAFETY * rate))
        dt = walk[DT] = fit_step(walk[DT], length - elapsed)
        status = stop_reason(walk, counts, control, length)
        if status != DONE:
            return Report(status, elapsed, dt, cell, moved), pairs
        stages = stages_for(dt, _SAFETY * rate, most_stages)
        if stages != table.shape[0] - 1:
            table = coefficients(stages)
        status, pairs = _chebyshev(source, pairs, table, position, slope, elapsed, dt, work)
        trial = work[0]
        cell, moved = furthest_move(position, trial, radius)
        if status == DONE and moved <= control.max_displacement:
            status, pairs = evaluate(source, pairs, elapsed + dt, trial, work[1])
        good, part = not refuse_step(walk, counts, control, status, moved), 1.0
        if good:
            part = part_of_step(
                source, pairs, position, trial, slope, work[1], elapsed, dt, moved, control.atol
            )
        if part < 1.0:
            shorten_step(walk, counts, part)
            products = 0
            continue
        if good:
            _estimate(dt, position, trial, slope, work[1], error)
            good = accept_step(
                walk, counts, control, length, position, trial, error, 0.2, 5.0, False
            )
        else:
            displace(trial, -1.0, position, error)
        if good:
            copy(work[1], slope)
            age += 1
            products = _WARM if age == _AGE else 0
        else:
            # refused twice in a row: the rate is known here already
            products = _COLD if age > 0 else 0
    return Report(DONE, length, walk[DT], -1, 0.0), pairs
