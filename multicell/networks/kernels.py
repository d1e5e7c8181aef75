"""One step of one cell: what the loop over cells is made of.

The inputs of a cell go linearly from their values at the beginning of the coupling step to those at
its end. All that a step writes stands in the :class:`Scratch` of the thread that takes it.
"""

from __future__ import annotations

import math
from typing import NamedTuple, final

import numpy as np

from multicell.cells import FloatArray, IntArray
from multicell.compiling import INNER, UNCOUNTED, called_with_rows, typed
from multicell.networks.code import CALLED_ROWS
from multicell.networks.methods import Explicit, LinearlyImplicit

_inner = typed(**UNCOUNTED)
_once = typed(**UNCOUNTED, forceinline=True)  # called in one place, with more than is quick to pass
call_rates = called_with_rows(5, CALLED_ROWS)
call_trigger = called_with_rows(4, CALLED_ROWS)
call_assign = called_with_rows(6, CALLED_ROWS)
call_initial = called_with_rows(3, CALLED_ROWS)

_ROUNDING = 1.5e-8  # square root of the rounding of doubles: part of a state for a difference


@final
class Common(NamedTuple):
    """Data that all cells of a network share in a coupling step.

    - ``rates``: address of the rates
    - ``relative``, ``absolute``, (s,): tolerances of the error of a step
    - ``diluted``, (s,): 1 for states that fall as the cell grows, else 0
    - ``observe``, ``observed``: address and number of the observed values
    """

    rates: int
    relative: float
    absolute: FloatArray
    diluted: FloatArray
    observe: int
    observed: int


@final
class Surrounding(NamedTuple):
    """Inputs of one cell in a step.

    - ``before``, ``after``, (m,): inputs at both ends; ``p``, (q,): its parameters
    - ``growth``: d ln(volume)/dt
    - ``start``, ``span``: of the step, in the network's own unit of time; ``rate``: 1 / span
    """

    before: FloatArray
    after: FloatArray
    p: FloatArray
    growth: float
    start: float
    span: float
    rate: float


@final
class Scratch(NamedTuple):
    """Memory of one thread for s states, m inputs and k stages; ``calls`` counts evaluations."""

    u: FloatArray
    f: FloatArray
    point: FloatArray
    trial: FloatArray
    slope: FloatArray
    stages: FloatArray
    jacobian: FloatArray
    matrix: FloatArray
    pivot: IntArray
    calls: IntArray


@typed(**INNER)
def scratch_of(states, inputs, stages):
    """Return memory for a thread."""
    return Scratch(
        np.empty(inputs),
        np.empty(states),
        np.empty(states),
        np.empty(states),
        np.empty(states),
        np.empty((stages, states)),
        np.empty((states, states)),
        np.empty((states, states)),
        np.empty(states, np.int64),
        np.zeros(1, np.int64),
    )


@_once
def set_inputs(here, t, u):
    """Write the inputs at a time to ``u``."""
    part = (t - here.start) * here.rate
    for k in range(u.size):
        u[k] = here.before[k] + part * (here.after[k] - here.before[k])


@_once
def evaluate_network(common, here, t, y, u, out):
    """Write dy/dt to ``out``: the network's rates, less what growth dilutes."""
    set_inputs(here, t, u)
    call_rates(common.rates, t, y, u, here.p, out)
    if here.growth != 0.0:
        for k in range(y.size):
            out[k] -= here.growth * common.diluted[k] * y[k]


@_once
def set_jacobian(common, here, t, y, s, careful):
    """Write df/dy by differences to ``s.jacobian``; ``s.f`` has the rates at ``y``.

    Row j has the derivatives by state j: they are written one after another, and a processor waits
    where it reads several numbers at once that were written apart a moment before.

    - ``careful``: differences to both sides are compared, and the smaller one taken where a jump of
      the rates lies within the other
    """
    n, size = y.size, 0.0
    for j in range(n):
        s.point[j] = y[j]
    for j in range(n):
        width = _ROUNDING * max(abs(y[j]), common.absolute[j] / common.relative)
        for side in range(2 if careful else 1):
            s.point[j] = y[j] - width if side else y[j] + width
            inverse, found = 1.0 / (s.point[j] - y[j]), 0.0
            evaluate_network(common, here, t, s.point, s.u, s.slope)
            s.calls[0] += 1
            for i in range(n):
                s.slope[i] = (s.slope[i] - s.f[i]) * inverse
                found += abs(s.slope[i])
            if not side or found < 0.1 * size or (found < math.inf and not size < math.inf):
                size = found
                for i in range(n):
                    s.jacobian[j, i] = s.slope[i]
        s.point[j] = y[j]


@_once
def factorise(a, pivot):
    """Replace a matrix by its factors L and U with row pivots; return whether it is regular.

    The diagonal of U is there by its reciprocals, which each solution would divide by anew.
    """
    n = pivot.size
    for k in range(n):
        best, place = abs(a[k, k]), k
        for i in range(k + 1, n):
            if abs(a[i, k]) > best:
                best, place = abs(a[i, k]), i
        pivot[k] = place
        if not best > 0.0:
            return False
        if place != k:
            for j in range(n):
                a[k, j], a[place, j] = a[place, j], a[k, j]
        inverse = 1.0 / a[k, k]
        a[k, k] = inverse
        for i in range(k + 1, n):
            share = a[i, k] * inverse
            a[i, k] = share
            if share != 0.0:
                for j in range(k + 1, n):
                    a[i, j] -= share * a[k, j]
    return True


@_inner
def solve(a, pivot, b):
    """Overwrite ``b`` with the solution of A x = b, A as :func:`factorise` leaves it."""
    n = pivot.size
    for k in range(n):
        if pivot[k] != k:
            b[k], b[pivot[k]] = b[pivot[k]], b[k]
    for i in range(1, n):
        value = b[i]
        for j in range(i):
            value -= a[i, j] * b[j]
        b[i] = value
    for i in range(n - 1, -1, -1):
        value = b[i]
        for j in range(i + 1, n):
            value -= a[i, j] * b[j]
        b[i] = value * a[i, i]


@_once
def size_of_error(common, y, trial, error):
    """Return the largest error over its tolerance; infinite where something is not finite."""
    worst = 0.0
    for k in range(y.size):
        allowed = common.absolute[k] + common.relative * max(abs(y[k]), abs(trial[k]))
        size = abs(error[k]) / allowed
        if not (size <= math.inf and abs(trial[k]) < math.inf):
            return math.inf
        worst = max(worst, size)
    return worst


REUSED, AFRESH, CAREFUL = range(3)
"""How a step finds the Jacobian: as it was, by differences, or by differences to both sides."""


@_once
def take_implicit(common, here, table: LinearlyImplicit, t, h, y, s, jacobian):
    """Write the state after a Rosenbrock step to ``s.trial``; return the size of its error.

    ``s.f`` has the rates at ``y``. A jump of the rates within the differences that a Jacobian is
    made of gives it huge numbers, and these hold a state where it is, with no error to be seen.
    """
    while True:  # with one place for each call, which is then none
        if jacobian != REUSED:
            set_jacobian(common, here, t, y, s, jacobian == CAREFUL)
        size = _rosenbrock(common, here, table, t, h, y, s)
        if size > 1.0 or jacobian == CAREFUL or not _is_held(common, h, y, s):
            return size
        jacobian = CAREFUL


@_once
def _is_held(common, h, y, s):
    """Return whether a state does not follow its rates, and the Jacobian knows no reason.

    ``s.slope`` has the rates at the last stage, ``s.point`` its state.
    """
    n = y.size
    for i in range(n):
        moved = abs(s.trial[i] - y[i])
        least = min(abs(s.f[i]), abs(s.slope[i])) if s.f[i] * s.slope[i] > 0.0 else 0.0
        allowed = common.absolute[i] + common.relative * abs(y[i])
        if h * least > max(allowed, 10.0 * moved):
            foreseen = s.f[i]
            for j in range(n):
                foreseen += s.jacobian[j, i] * (s.point[j] - y[j])
            if abs(foreseen - s.slope[i]) > 0.5 * least:
                return True
    return False


@_once
def _rosenbrock(common, here, table, t, h, y, s):
    """Take a Rosenbrock step with ``s.jacobian``; return the size of its error.

    ``s.slope`` has the rates at the last stage then, ``s.point`` its state.
    """
    n, per_step = y.size, 1.0 / h
    diagonal = per_step / table.gamma[0]
    for i in range(n):
        for j in range(n):
            s.matrix[i, j] = -s.jacobian[j, i]
        s.matrix[i, i] += diagonal
    if not factorise(s.matrix, s.pivot):
        return math.inf
    # by difference: time is in the inputs, and may be in the rates
    late = t + max(1e-6 * h, 1e-12 * abs(t))
    evaluate_network(common, here, late, y, s.u, s.slope)
    s.calls[0] += 1
    part = h / (late - t)
    for i in range(n):
        s.slope[i] = (s.slope[i] - s.f[i]) * part
    stages = table.alpha.size
    for stage in range(stages):
        k = s.stages[stage]
        moved = _stage_point(table, stage, y, s)
        if stage == 0 or (not moved and table.alpha[stage] == 0.0):
            for i in range(n):
                k[i] = s.f[i]
        else:
            evaluate_network(common, here, t + table.alpha[stage] * h, s.point, s.u, k)
            s.calls[0] += 1
        gamma = table.gamma[stage]
        for i in range(n):
            before, rate = 0.0, k[i]
            for other in range(stage):
                before += table.c[stage, other] * s.stages[other, i]
            k[i] += per_step * before + gamma * s.slope[i]
            if stage == stages - 1:  # no later stage needs the slope in time
                s.slope[i] = rate
        solve(s.matrix, s.pivot, k)
    # stiffly accurate: the last increment is what the embedded method, where it began, is off by
    error = s.stages[stages - 1]
    for i in range(n):
        s.trial[i] = s.point[i] + error[i]
    return size_of_error(common, y, s.trial, error)


@_inner
def _stage_point(table, stage, y, s):
    """Write the state of a stage to ``s.point``; return whether it is another than ``y``."""
    moved = False
    for other in range(stage):
        moved = moved or table.a[stage, other] != 0.0
    for i in range(y.size):
        sum_ = 0.0
        for other in range(stage):
            sum_ += table.a[stage, other] * s.stages[other, i]
        s.point[i] = y[i] + sum_
    return moved


@_once
def take_explicit(common, here, table: Explicit, t, h, y, s):
    """Write the state after an explicit step to ``s.trial``.

    ``s.f`` has the rates at ``y``. Returns the size of the error, and h |λ| of the fastest rate λ
    as the last two stages see it.
    """
    n, count = y.size, table.b.size
    s.calls[0] += count - 1
    for i in range(n):
        s.stages[0, i] = s.f[i]
    for stage in range(1, count):
        for i in range(n):
            before, change = s.point[i], 0.0
            for other in range(stage):
                change += table.a[stage, other] * s.stages[other, i]
            s.point[i] = y[i] + h * change
            s.slope[i] = s.point[i] - before
        evaluate_network(common, here, t + table.c[stage] * h, s.point, s.u, s.stages[stage])
    faster, moved = 0.0, 0.0
    if count > 2:
        for i in range(n):
            scale = common.absolute[i] + common.relative * abs(y[i])
            faster = max(faster, abs(s.stages[count - 1, i] - s.stages[count - 2, i]) / scale)
            moved = max(moved, abs(s.slope[i]) / scale)
    for i in range(n):
        change, error = 0.0, 0.0
        for stage in range(count):
            change += table.b[stage] * s.stages[stage, i]
            error += table.e[stage] * s.stages[stage, i]
        s.trial[i], s.point[i] = y[i] + h * change, h * error
    stiffness = h * faster / moved if moved > 0.0 else 0.0
    return size_of_error(common, y, s.trial, s.point), stiffness


@_once
def fastest(s, n):
    """Return a bound on the largest |λ| of the Jacobian: the lesser of two norms."""
    rows, columns = 0.0, 0.0
    for i in range(n):
        row, column = 0.0, 0.0
        for j in range(n):
            row += abs(s.jacobian[i, j])
            column += abs(s.jacobian[j, i])
        rows, columns = max(rows, row), max(columns, column)
    return min(rows, columns)
