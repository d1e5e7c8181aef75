"""Loop of the multirate Euler method: fast cells take several short steps in one long step.

A step of length H moves the slow cells once, x + H v. The fast cells take r steps of H/r, during
which the slow ones move along that straight line, and only the pairs of fast cells are evaluated.
The velocity of all cells at the end of the step is that of the beginning of the next one, and
closes the estimate of the error: H/2 (v(0) - v(H)) of a slow cell, the sum of such terms over its
short steps of a fast one.

What an error would be with another grouping follows from these estimates: a cell with the error e
in a long step has e/r in r short ones. After each step the grouping (those cells are fast whose
error exceeds a bound; r is a power of two) is chosen for which cost over length of step is least.
With no fast cell the step is that of Euler under error control, in every bit.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload, register_jitable
from numpy.typing import NDArray

from multicell.cells import FloatArray
from multicell.compiling import arithmetic
from multicell.integrators.stepping import (
    DONE,
    DT,
    ELAPSED,
    EVALUATIONS,
    LIST_BUILDS,
    LIST_REPAIRS,
    Report,
    Source,
    accept_step,
    compiled,
    control_state,
    copy,
    displace,
    evaluate,
    fit_step,
    furthest_move,
    refuse_step,
    starting_step,
    stop_reason,
)
from multicell.mechanics import forces
from multicell.mechanics.any_law import velocities_at

_MOST_SHORT_STEPS = 16  # short steps of the fast cells in a long one
_OCTAVES = 24  # bounds between fast and slow cells that are tried, each half of the one before
_PARTIAL, _GROUPED = 1.6, 0.15
"""Cost of evaluating a fast cell over that of a cell in an evaluation of all, where most pairs
serve two cells; cost of a grouped step beyond its evaluations, in evaluations."""
_GAIN = 0.9  # a grouping is changed where that costs less than this times the present cost


_AGE = 4
"""Accepted steps after which the grouping is chosen anew; after a refused one it is at once."""


class FastPart(NamedTuple):
    """The fast cells, and the slow ones that they may touch, as the kernels take them.

    ``member`` are the cells' indices, the ``fast`` fast ones first; ``share`` is the part of all
    pairs. Pairs count in places of ``member``.
    """

    member: NDArray[np.int64]
    fast: int
    share: float
    cells: forces.CellData
    pairs: forces.PairData
    rows: FloatArray
    position: FloatArray
    velocity: FloatArray


def _most_short_steps(source: Any) -> int:
    """Return how many short steps a long one may be cut into.

    One where evaluations go through Python, which evaluates all cells or none.
    """
    return 1


@overload(_most_short_steps)
def _compiled_most_short_steps(source):
    most = _MOST_SHORT_STEPS if getattr(source, "instance_class", None) is Source else 1
    return lambda source: most


@arithmetic
def _members(is_fast, pairs):
    """Return the fast cells and then all that they may touch; places; numbers of pairs."""
    n = is_fast.size
    place, member = np.full(n, -1), np.empty(n, np.int64)
    count, both, one = 0, 0, 0
    for i in range(n):
        if is_fast[i]:
            member[count], place[i] = i, count
            count += 1
    fast = count
    for c in range(pairs.start.size):
        for p in range(pairs.start[c], pairs.outer_end[c]):
            i, j = pairs.first[p], pairs.second[p]
            inner = p < pairs.inner_end[c]
            if not (is_fast[i] or (inner and is_fast[j])):
                continue
            if inner and is_fast[i] and is_fast[j]:
                both += 1
                continue
            one += 1
            for k in (i, j):
                if place[k] < 0:
                    member[count], place[k] = k, count
                    count += 1
    return member[:count], fast, place, both, one


@arithmetic
def _fast_pairs(is_fast, pairs, place, both, one):
    """Return the pairs of fast cells: those of two, then those whose first cell is fast."""
    first, second = np.empty(both + one, np.int32), np.empty(both + one, np.int32)
    at, beyond, total = 0, both, 0
    for c in range(pairs.start.size):
        total += pairs.outer_end[c] - pairs.start[c]
        for p in range(pairs.start[c], pairs.outer_end[c]):
            i, j = pairs.first[p], pairs.second[p]
            inner = p < pairs.inner_end[c]
            if inner and is_fast[i] and is_fast[j]:
                first[at], second[at] = place[i], place[j]
                at += 1
            elif is_fast[i]:
                first[beyond], second[beyond] = place[i], place[j]
                beyond += 1
            elif inner and is_fast[j]:
                first[beyond], second[beyond] = place[j], place[i]
                beyond += 1
    ends = np.array([0, both, both + one])
    listed = forces.PairData(
        first,
        second,
        ends[:1],
        ends[1:2],
        ends[2:],
        pairs.adhesion,
        pairs.unit,
        pairs.onset,
        pairs.period,
    )
    return listed, (both + one) / max(total, 1)


@arithmetic
def _rows_of(values, member):
    # none of none
    out = np.empty((min(member.size, values.shape[0]), values.shape[1]))
    for k in range(out.shape[0]):
        for a in range(values.shape[1]):
            out[k, a] = values[member[k], a]
    return out


@arithmetic
def _entries_of(values, member):
    out = np.empty(member.size)
    for k in range(member.size):
        out[k] = values[member[k]]
    return out


def _part(source, pairs, is_fast):
    """Return the fast cells with what their velocities depend on; None outside of compiled code."""


@overload(_part)
def _compiled_part(source, pairs, is_fast):
    def run(source, pairs, is_fast):
        member, fast, place, both, one = _members(is_fast, pairs)
        listed, share = _fast_pairs(is_fast, pairs, place, both, one)
        room = np.empty((member.size, 3))
        cells = forces.CellData(
            member.size,
            _entries_of(source.cells.margin, member),
            _rows_of(source.cells.reference, member),
            _entries_of(source.cells.radius, member),
            _entries_of(source.cells.radius_rate, member),
            _rows_of(source.cells.bonds, member),
            _rows_of(source.cells.push, member),
        )
        return FastPart(
            member,
            fast,
            share,
            cells,
            listed,
            _rows_of(source.rows, member),
            room,
            np.empty_like(room),
        )

    return run


@arithmetic
def _carry(part, slope, elapsed, dt, trial):
    """Move the fast cells in ``trial`` by one short step that begins ``elapsed`` into the long one.

    Then put all cells of the part where they are at its end: ``slope`` carries the slow ones.
    """
    for k in range(part.member.size):
        i = part.member[k]
        for a in range(3):
            if k < part.fast:
                trial[i, a] += dt * part.velocity[k, a]
            part.position[k, a] = trial[i, a]
            if k >= part.fast:
                part.position[k, a] += (elapsed + dt) * slope[i, a]


@arithmetic
def _finish(is_fast, dt, slope, trial):
    """Put the slow cells where they are at the end of a step."""
    for i in range(is_fast.size):
        if not is_fast[i]:
            for a in range(3):
                trial[i, a] += dt * slope[i, a]


@arithmetic
def _take(part, velocity):
    """Take over the velocities of the fast cells from those of all."""
    for k in range(part.fast):
        for a in range(3):
            part.velocity[k, a] = velocity[part.member[k], a]


@register_jitable
def _evaluate_part(source, part, elapsed):
    """Write the velocities of the fast cells; return whether a cell has left what the list allows.

    Compiled code alone has a part.
    """
    return velocities_at(
        source.velocities_at,
        None,
        source.serial_at,
        part.cells,
        part.pairs,
        source.law,
        part.position,
        elapsed,
        part.rows,
        part.velocity,
    )


@register_jitable
def _short_steps(source, pairs, part, is_fast, position, slope, elapsed, dt, ratio, trial, new):
    """Carry all cells over a step, the fast ones in ``ratio`` short steps, to ``trial``.

    Returns how it went, the list of pairs, the part, which is made anew with the list, and what
    share of an evaluation of all cells it has taken.
    """
    short, spent = dt / ratio, 0.0
    copy(position, trial)
    _take(part, slope)
    for k in range(ratio):
        _carry(part, slope, k * short, short, trial)
        if k + 1 == ratio:
            break
        spent += part.share
        at = elapsed + (k + 1) * short
        if _evaluate_part(source, part, at):
            # build the list where all cells are now
            whole = trial.copy()
            _finish(is_fast, (k + 1) * short, slope, whole)
            status, pairs = evaluate(source, pairs, at, whole, new)
            if status != DONE:
                return status, pairs, part, spent
            part = _part(source, pairs, is_fast)
            _take(part, new)
    _finish(is_fast, dt, slope, trial)
    return DONE, pairs, part, spent


@arithmetic
def _estimate(is_fast, dt, ratio, slope, new, error):
    """Write the estimated errors of a step; those of the short steps add up to the same form."""
    for i in range(is_fast.size):
        half = 0.5 * dt / ratio if is_fast[i] else 0.5 * dt
        for a in range(3):
            error[i, a] = half * slope[i, a] - half * new[i, a]


@arithmetic
def _grouped(error, is_fast, ratio, most):
    """Choose the fast cells from the errors of a step; return their ratio and the next step.

    ``is_fast`` is overwritten where the grouping changes. The step is that at which the root mean
    square of the errors stays what it was, over the one before.
    """
    n = is_fast.size
    square, top, present, fast = np.empty(n), 0.0, 0.0, 0
    for i in range(n):
        s = error[i, 0] ** 2 + error[i, 1] ** 2 + error[i, 2] ** 2
        present += s
        if is_fast[i]:
            s *= ratio * ratio
            fast += 1
        square[i] = s
        top = max(top, s)
    if most == 1 or not (top > 1e-290 and math.isfinite(present)):
        return ratio, 1.0
    number, part, total = np.zeros(_OCTAVES, np.int64), np.zeros(_OCTAVES), 0.0
    for i in range(n):
        # the squares fall by a factor of four an octave
        octave = min(math.frexp(top / max(square[i], 1e-300))[1] // 2, _OCTAVES - 1)
        number[octave] += 1
        part[octave] += square[i]
        total += square[i]
    cost = _cost(n, fast, ratio, present)
    best, chosen, bound = _cost(n, 0, 1, total), 1, -1
    least, count, taken = total, 0, 0.0
    for octave in range(_OCTAVES - 1):
        count, taken = count + number[octave], taken + part[octave]
        r = 2
        while r <= most:
            left = max(total - taken, 0.0) + taken / r**2
            tried = _cost(n, count, r, left)
            if tried < best:
                best, chosen, bound, least = tried, r, octave, left
            r *= 2
    if best > _GAIN * cost:
        return ratio, 1.0
    for i in range(n):
        octave = min(math.frexp(top / max(square[i], 1e-300))[1] // 2, _OCTAVES - 1)
        is_fast[i] = octave <= bound
    return chosen, (present / least) ** 0.25


@arithmetic
def _cost(n, fast, ratio, squares):
    """Return the cost of a grouping over the length of step that its errors allow."""
    cost = 1.0 if ratio == 1 else 1.0 + _GROUPED + (ratio - 1) * _PARTIAL * fast / n
    return cost * squares**0.25


@compiled
def adaptive_multirate(source, pairs, position, length, radius, counts, control):
    """Take steps of the multirate Euler method under error control."""
    slope, new = np.empty_like(position), np.empty_like(position)
    trial, error = np.empty_like(position), np.empty_like(position)
    most = _most_short_steps(source)
    is_fast, ratio, built = np.zeros(radius.size, np.bool_), 1, -1
    cell, moved, spent, age = -1, 0.0, 0.0, 0
    status, pairs = evaluate(source, pairs, 0.0, position, slope)
    if status != DONE:
        return Report(status, 0.0, 0.0, -1, math.inf), pairs
    dt, pairs = starting_step(source, pairs, control, position, slope, trial, error, length, radius)
    walk = control_state(dt)
    part = _part(source, pairs, is_fast)
    while walk[ELAPSED] < length:
        elapsed = walk[ELAPSED]
        dt = walk[DT] = fit_step(walk[DT], length - elapsed)
        status = stop_reason(walk, counts, control, length)
        if status != DONE:
            return Report(status, elapsed, dt, cell, moved), pairs
        if ratio == 1:
            displace(position, dt, slope, trial)
        else:
            if built != counts[LIST_BUILDS] + counts[LIST_REPAIRS]:
                part = _part(source, pairs, is_fast)
            status, pairs, part, share = _short_steps(
                source, pairs, part, is_fast, position, slope, elapsed, dt, ratio, trial, new
            )
            spent += share
            counts[EVALUATIONS] += int(spent)
            spent -= int(spent)
            built = counts[LIST_BUILDS] + counts[LIST_REPAIRS]
        if status == DONE:
            status, pairs = evaluate(source, pairs, elapsed + dt, trial, new)
        cell, moved = furthest_move(position, trial, radius)
        if refuse_step(walk, counts, control, status, moved):
            continue
        _estimate(is_fast, dt, ratio, slope, new, error)
        if accept_step(walk, counts, control, length, position, trial, error, 0.2, 5.0, False):
            copy(new, slope)
            age += 1
            if age % _AGE:
                continue
            longest = math.inf
        else:
            # errors of unstable steps say little about another grouping: a step that was refused
            # with the old one might otherwise be tried again for ever
            longest = walk[DT]
        ratio, factor = _grouped(error, is_fast, ratio, most)
        if factor != 1.0:
            walk[DT] = min(walk[DT] * min(factor, 5.0), longest)
            built = -1
    return Report(DONE, length, walk[DT], -1, 0.0), pairs
