"""Loops of the explicit methods, compiled, with the neighbour list updated inside.

Every loop is an ordinary function of a *source* of velocities. Compiled, the source is a
:class:`Source`, a set of arrays, and :func:`evaluate` calls the kernels without returning to
Python, at an address: they are compiled once for all loops, and a loop once for any number of
threads. Uncompiled (``loop.py_func``), the source is :class:`Called`, for systems that
need Python (see :func:`multicell.integrators.driver.needs_python`): the same loop, one
call of ``Mechanics.velocity`` per stage. Functions that evaluate are
:func:`numba.extending.register_jitable`; the arithmetic on arrays is compiled in both cases.

A loop works on its own copy of the positions, which is always the last accepted state, and
returns a :class:`Report`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple, final

import numpy as np
from numba import TypingError, njit, types
from numba.extending import overload, register_jitable
from numpy.typing import NDArray

from multicell.cells import FloatArray
from multicell.compiling import (
    ADDRESSED,
    KERNEL,
    address_of,
    arithmetic,
    called_at,
)
from multicell.compiling.numba_068 import compute_fingerprint
from multicell.integrators import fused
from multicell.mechanics import any_law, forces
from multicell.mechanics.motion import StateRejected
from multicell.mechanics.neighbours import updating
from multicell.mechanics.system import Mechanics

DONE, REJECTED, NOT_FINITE, MOVED, STALLED, OUT_OF_STEPS, TOO_LONG = range(7)
"""How a loop, or one evaluation, ended."""
EVALUATIONS, LIST_BUILDS, LIST_REPAIRS, STEPS, REJECTIONS = range(5)  # in the array of counts
ELAPSED, DT, PREVIOUS, HELD = range(4)
"""Places in the state of error control: time since the beginning and next step, s; size of the last
error; steps refused since the last accepted one."""

_SHORTEST = 1e-13  # steps below this fraction of the interval are lost in rounding
_MOST_REFUSALS = 200
"""Refused steps in a row; a method that makes each shorter by a tenth has stalled long before."""

LEAST_PART = 0.05  # of a step that is refused because a contact forms within it
_BLOCK = 1024  # numbers of an array that are worked on at a time


class Source(NamedTuple):
    """Arguments of the kernels besides the pairs; ``cells.reference``, ``.margin`` are written.

    ``law`` are the values of its constants. ``kernel_at`` (the forces), ``rebuild_at`` and
    ``repair_at`` (0: lists are not repaired) are the addresses of the kernels, for one thread or
    for all, ``serial_at`` that of the forces for one. ``velocities_at`` and ``missed_at`` (0: no
    contact can be missed) are those of :mod:`multicell.mechanics.any_law`, ``evaluation_at`` that
    of the function that calls kernels. ``foresee_at`` and ``assess_at`` are those of :mod:`.fused`,
    for loops that use it.
    """

    cells: forces.CellData
    law: FloatArray
    reach: FloatArray
    least_margin: float
    rows: FloatArray
    counts: NDArray[np.int64]
    velocities_at: int = 0
    kernel_at: int = 0
    serial_at: int = 0
    rebuild_at: int = 0
    repair_at: int = 0
    evaluation_at: int = 0
    missed_at: int = 0
    foresee_at: int = 0
    assess_at: int = 0


class Control(NamedTuple):
    """Settings of error control.

    ``strictness`` is the weighted error that a step may have, ``order`` the exponent of the
    step in the estimated error, ``most_steps`` the largest number of accepted steps.
    """

    rtol: float
    atol: float
    strictness: float
    order: float
    most_steps: int
    max_displacement: float


class Report(NamedTuple):
    """How a loop ended: time since the beginning and last step tried, s; the worst cell."""

    status: int
    elapsed: float
    dt: float
    cell: int
    moved: float


def compiled(function: Callable[..., Any], **options: Any) -> Any:
    """Compile a loop when it is called."""
    return njit(**{**KERNEL, **options})(function)


@final
class Called:
    """A source of velocities in Python: one call of :meth:`Mechanics.velocity` per stage."""

    def __init__(self, system: Mechanics) -> None:
        self.system = system
        self.problem = ""

    def velocity(self, elapsed: float, position: FloatArray, out: FloatArray) -> int:
        """Write the velocities at a state; return how it went."""
        try:
            self.system.velocity(self.system.motion.begin + elapsed, position, out)
        except StateRejected as error:
            self.problem = str(error)
            return REJECTED if np.isfinite(position).all() else NOT_FINITE
        return DONE


def evaluate(source, pairs, elapsed, position, out):
    """Write the velocities at a state; return how it went, and the list of pairs.

    The list is handed from call to call, since compiled code cannot change what it was given.
    """
    return source.velocity(elapsed, position, out), pairs


@overload(evaluate)
def _compiled_evaluate(source, pairs, elapsed, position, out):
    if getattr(source, "instance_class", None) is not Source:
        return None
    if not position == out == types.float64[:, ::1]:
        raise TypingError(f"positions and velocities are {position} and {out}")

    def run(source, pairs, elapsed, position, out):
        return _evaluate_at(source.evaluation_at, source, pairs, float(elapsed), position, out)

    return run


def part_of_step(source, pairs, before, after, slope, end_slope, elapsed, dt, moved, tolerance):
    """Return the part of a step to be taken where it misses a contact that forms in it, else 1.

    See :func:`multicell.mechanics.forces.missed_contact`. The steps of an explicit method follow
    contacts that form, except between cells that are driven past each other.
    """
    system = source.system
    if not meets_driven(system):
        return 1.0
    begin = system.motion.begin + elapsed
    return system.missed_contact(
        begin, begin + dt, before, after, slope, end_slope, moved, tolerance
    )


@overload(part_of_step)
def _compiled_part(source, pairs, before, after, slope, end_slope, elapsed, dt, moved, tolerance):
    if getattr(source, "instance_class", None) is not Source:
        return None

    def run(source, pairs, before, after, slope, end_slope, elapsed, dt, moved, tolerance):
        if source.missed_at == 0:
            return 1.0
        return any_law.missed_among_all_at(
            source.missed_at,
            None,
            source.law,
            source.cells,
            pairs,
            source.rows,
            (before, after, slope, end_slope),
            float(elapsed),
            float(dt),
            float(moved),
            float(tolerance),
        )

    return run


def meets_driven(system: Mechanics) -> bool:
    """Return whether contacts snap that form between cells which forces from outside drive."""
    return system.motion.push is not None and system.law.snaps


def _evaluation(source, pairs, elapsed, position, out):
    """Do the work of :func:`evaluate` in compiled code."""
    source.counts[EVALUATIONS] += 1
    cells = source.cells
    while any_law.velocities_at(
        source.velocities_at,
        None,
        source.kernel_at,
        cells,
        pairs,
        source.law,
        position,
        elapsed,
        source.rows,
        out,
    ):
        if not _is_finite(position):
            return NOT_FINITE, pairs
        found, listed = updating.update_list(
            source.rebuild_at,
            source.repair_at,
            position,
            cells.reference,
            source.reach,
            cells.margin,
            source.least_margin,
            cells.chunk,
            (pairs.first, pairs.second, pairs.start, pairs.inner_end, pairs.outer_end),
            pairs.first,
            pairs.second,
        )
        source.counts[LIST_REPAIRS if found == updating.REPAIRED else LIST_BUILDS] += 1
        if found == updating.TOO_CROWDED:
            return REJECTED, pairs
        pairs = forces.PairData(*listed, pairs.adhesion, pairs.unit, pairs.onset, pairs.period)
    return DONE, pairs


# the evaluation would be compiled into a loop at every call
_evaluate_at = called_at(5, lambda _, source, pairs, *__: types.Tuple((types.intp, pairs)))


def with_addresses(
    source: Source,
    pairs: forces.PairData,
    law: Any,
    *,
    shared: bool,
    passes: bool = False,
    parts: bool = False,
    watched: bool = False,
) -> Source:
    """Return a source with the addresses of its kernels, which are compiled if need be.

    - ``law``: the constants whose values it has
    - ``shared``: whether threads share them
    - ``passes``: whether the loop uses :mod:`.fused`
    - ``parts``: whether it evaluates a part of the cells
    - ``watched``: whether it looks for contacts that its steps miss
    """
    repairs = len(source.reach) >= updating.REPAIR_FROM
    # the rest of a source is of one kind, and so are the law's values; a law is of floats and None
    kinds = compute_fingerprint((source.cells, source[2:5], pairs)), type(law), *map(type, law)
    key = kinds, shared, passes, parts, watched, repairs
    if key not in _PLACES:
        used = stepping_kernels(source, pairs, law, shared=shared, passes=passes)
        if parts:
            used["serial_at"] = (forces.forces, *used["kernel_at"][1:])
        if watched:
            path = (np.empty((0, 3)),) * 4
            known = any_law.law_type(law), source.law, source.cells, pairs, source.rows, path
            used["missed_at"] = (any_law.missed_among_all, 0.0, *known, 0.0, 0.0, 0.0, 0.0)
        places: dict[str, Any] = {name: address_of(*kernel) for name, kernel in used.items()}
        _PLACES[key] = source._replace(**places)[6:]
    return Source(*source[:6], *_PLACES[key])


_PLACES: dict[Any, tuple[int, ...]] = {}


def stepping_kernels(
    source: Source, pairs: forces.PairData, law: Any, *, shared: bool, passes: bool
) -> dict[str, tuple[Any, ...]]:
    """Return the kernels as :func:`address_of` takes them, by their names in :class:`Source`."""
    place, seen = np.empty((2, 0, 3))
    seen.flags.writeable = False
    run = forces.forces_parallel if shared else forces.forces
    cells, rows = source.cells, source.rows
    given = any_law.law_type(law), 0, cells, pairs, source.law, place, 0.0, rows, place
    known: dict[str, tuple[Any, ...]] = {
        "kernel_at": (run, True, cells, pairs, law, seen, 0.0, True, rows, place),
        "velocities_at": (any_law.velocities, True, *given),
        "evaluation_at": (_EVALUATION, (0, pairs), source, pairs, 0.0, place, place),
    }
    known |= updating.kernel_calls(place, source.reach, cells.chunk, pairs[:5], shared=shared)
    if passes:
        known |= fused.fused_kernels(cells.radius, shared=shared)
    return known


@arithmetic
def _is_finite(position):
    x, lost = position.reshape(-1), False
    for k in range(x.size):  # without an early end, for the vector units
        lost |= not abs(x[k]) < math.inf
    return not lost


@arithmetic
def copy(source, out):
    """Copy an array: loops like this one compile four times faster than ``out[:] = source``."""
    x, y = source.reshape(-1), out.reshape(-1)
    for k in range(y.size):
        y[k] = x[k]


@arithmetic
def displace(position, dt, direction, out):
    """Write position + dt x direction; ``out`` may be either of them."""
    x, v, y = position.reshape(-1), direction.reshape(-1), out.reshape(-1)
    for k in range(y.size):
        y[k] = x[k] + dt * v[k]


@arithmetic
def combine_slopes(position, dt, weights, slopes, count, out):
    """Write position + dt Σ_j weights_j slopes_j over the first ``count`` slopes.

    In blocks that stay in the nearest cache, while each slope streams through once.
    """
    x, y = position.reshape(-1), out.reshape(-1)
    for begin in range(0, y.size, _BLOCK):
        end = min(begin + _BLOCK, y.size)
        for k in range(begin, end):
            y[k] = x[k]
        for j in range(count):
            w = dt * weights[j]
            if w != 0.0:
                slope = slopes[j].reshape(-1)
                for k in range(begin, end):
                    y[k] += w * slope[k]


@arithmetic
def error_of(dt, weights, slopes, out):
    """Write dt Σ_j weights_j slopes_j."""
    y = out.reshape(-1)
    for k in range(y.size):
        y[k] = 0.0
    combine_slopes(out, dt, weights, slopes, weights.size, out)


@arithmetic
def furthest_move(before, after, radius):
    """Return the cell that moved furthest, in its radius, and how far; not a number is ∞."""
    cell, most = 0, -1.0
    for i in range(before.shape[0]):
        x, y, z = after[i, 0] - before[i, 0], after[i, 1] - before[i, 1], after[i, 2] - before[i, 2]
        moved = math.sqrt(x * x + y * y + z * z) / radius[i]
        if not math.isfinite(moved):
            return i, math.inf
        if moved > most:
            cell, most = i, moved
    return cell, most


@arithmetic
def largest_length(values):
    """Return the length of the longest row."""
    square = 0.0
    for i in range(values.shape[0]):
        x, y, z = values[i, 0], values[i, 1], values[i, 2]
        square = max(square, x * x + y * y + z * z)
    return math.sqrt(square)


@arithmetic
def weighted_rms(values, before, after, rtol, atol):
    """Return the root mean square of values_k / (atol + rtol |x_k|), larger |x| of the two."""
    e, x, y = values.reshape(-1), before.reshape(-1), after.reshape(-1)
    total = 0.0
    for k in range(e.size):
        part = e[k] / (atol + rtol * max(abs(x[k]), abs(y[k])))
        total += part * part
    return math.sqrt(total / e.size)


@register_jitable
def starting_step(source, pairs, control, position, slope, trial, other, length, radius):
    """Return a first step (Hairer, Nørsett & Wanner I, II.4) and leave nothing behind.

    The trial step of that recipe moves no cell further than a tenth of what is allowed.
    """
    size = weighted_rms(position, position, position, control.rtol, control.atol)
    speed = weighted_rms(slope, position, position, control.rtol, control.atol)
    dt = length
    if speed > 0.0:
        dt = min(dt, 0.01 * size / speed)
    displace(position, 1.0, slope, trial)
    _, moved = furthest_move(position, trial, radius)
    if moved * dt > 0.1 * control.max_displacement:
        dt = 0.1 * control.max_displacement / moved
    dt = max(dt, 1e-6 * length)
    displace(position, dt, slope, trial)
    status, pairs = evaluate(source, pairs, dt, trial, other)
    if status != DONE:
        return 1e-6 * length, pairs
    displace(other, -1.0, slope, other)
    bend = weighted_rms(other, position, position, control.rtol, control.atol) / dt
    largest = max(speed, bend) / control.strictness
    if largest > 0.0:
        return min(100.0 * dt, (0.01 / largest) ** (1.0 / control.order), length), pairs
    return length, pairs


@arithmetic
def control_state(dt):
    """Return the state of error control at the beginning: see ``ELAPSED`` and the others."""
    walk = np.zeros(4)
    walk[DT], walk[PREVIOUS] = dt, 1.0
    return walk


@arithmetic
def stop_reason(walk, counts, control, length):
    """Return why no step can be tried, or ``DONE``."""
    if counts[STEPS] == control.most_steps:
        return OUT_OF_STEPS
    stuck = walk[DT] < _SHORTEST * length or walk[HELD] > _MOST_REFUSALS
    return STALLED if stuck else DONE


@arithmetic
def refuse_step(walk, counts, control, status, moved):
    """Return whether a step moved a cell too far or had no velocity; the next one is shorter."""
    if status == DONE and not moved > control.max_displacement:
        return False
    counts[REJECTIONS] += 1
    walk[DT] = step_after_move(walk[DT], moved, control.max_displacement)
    walk[HELD] += 1.0
    return True


@arithmetic
def shorten_step(walk, counts, part):
    """Refuse a step; a part of it is tried next."""
    counts[REJECTIONS] += 1
    walk[DT] *= max(part, LEAST_PART)
    walk[HELD] += 1.0


@arithmetic
def accept_step(walk, counts, control, length, position, trial, error, least, most, steady):
    """Take a step if its estimated error is small enough; choose the next step.

    ``least`` and ``most`` bound its length over that of a refused and of an accepted step; a
    ``steady`` one stays as it is where it would hardly change.
    """
    size = weighted_rms(error, position, trial, control.rtol, control.atol)
    if not control_step(walk, counts, control, length, size, least, most, steady):
        return False
    copy(trial, position)
    return True


@arithmetic
def control_step(walk, counts, control, length, size, least, most, steady):
    """Return whether a step is taken, as :func:`accept_step` does, by the size of its error.

    ``size`` is its weighted root mean square.
    """
    dt = walk[DT]
    size /= control.strictness
    if not size <= 1.0:
        counts[REJECTIONS] += 1
        walk[DT] = step_after_error(dt, size, control.order, least)
        walk[HELD] += 1.0
        return False
    walk[ELAPSED] = length if dt == length - walk[ELAPSED] else walk[ELAPSED] + dt
    counts[STEPS] += 1
    wanted = min(next_step(dt, size, walk[PREVIOUS], control.order), most * dt)
    if steady and 0.9 * dt < wanted < 1.2 * dt:
        wanted = dt
    # no growth right after a refusal
    walk[DT] = min(dt, wanted) if walk[HELD] > 0.0 else wanted
    walk[HELD], walk[PREVIOUS] = 0.0, max(size, 1e-4)
    return True


@arithmetic
def step_after_error(dt, error, order, least):
    """Return the step to try after one with too large an error, in units of the allowed one."""
    if not math.isfinite(error):
        return 0.2 * dt
    return dt * max(least, 0.9 * error ** (-1.0 / order))


@arithmetic
def next_step(dt, error, previous, order):
    """Return the next step by PI control (Gustafsson)."""
    error = max(error, 1e-10)
    factor = 0.9 * error ** (-0.7 / order) * previous ** (0.4 / order)
    return dt * min(5.0, max(0.2, factor))


@arithmetic
def step_after_move(dt, moved, allowed):
    """Return the step to try after one that moved a cell too far, or had no velocity."""
    if not moved > allowed:
        return 0.25 * dt
    return dt * max(0.1, min(0.7, 0.8 * allowed / moved))


@arithmetic
def fit_step(dt, left):
    """Return a step that does not leave a tiny rest of the interval."""
    if dt >= left * (1.0 - 1e-12):
        return left
    return min(dt, 0.5 * left)


@arithmetic
def take_fixed_step(position, trial, radius, allowed, counts):
    """Take a fixed step unless it moves a cell too far; return that cell and how far it moves."""
    cell, moved = furthest_move(position, trial, radius)
    if moved <= allowed:
        copy(trial, position)
        counts[STEPS] += 1
    return cell, moved


_EVALUATION = compiled(_evaluation, **ADDRESSED)
