"""One trial of a method: its steps are recorded, and the kind of failure is named.

There are four kinds of failure. A *blow-up* and a *stall* end a trial; a *wrong state* is one that
the true motion does not come to, whether it was seen on the way or at the end. Where that came
about because cells did not follow truly unstable modes, the method *damps a real instability*
(:func:`describe_damping`).
"""

from __future__ import annotations

import math
import re
import time as clock
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final, final

import numpy as np

from multicell.cells import FloatArray, IntArray
from multicell.comparison.ladders import Method
from multicell.comparison.replay import advance, timeout_words
from multicell.comparison.stability_limits.state import State
from multicell.mechanics.motion import StateRejected
from multicell.mechanics.system import Mechanics

STABLE: Final = "stable"
BLOW_UP: Final = "blow-up"
WRONG: Final = "wrong state"
STALL: Final = "stall"
DAMPED: Final = "damps a real instability"

KINDS: Final = {
    STABLE: "the energy only falls, and the end is that of the reference",
    BLOW_UP: "positions or energy grow beyond all bounds or are no numbers, or a step is refused "
    "because it would throw a cell away",
    STALL: "the end is not reached within the allowed steps, or nothing moves where it should",
    WRONG: "cells pass through each other, displacements alternate from step to step, the energy "
    "rises, or the end is not that of the reference",
    DAMPED: "the end is not that of the reference, and earlier a cell did not follow an unstable "
    "mode: when the true cell left the neighbourhood of the start, this one had moved less than "
    "half as far, in steps longer than 1/μ of the growth",
}
"""How a trial ends -> what that means.

Where several apply, blow-up or stall counts first, then damping. In moving states cells may take
another pocket than in the reference where a small shift of the start has them do so too.
"""

DEPARTURE_RADII: Final = 0.05
"""Growing part of a cell's displacement, in mean radii, from which it has left the neighbourhood of
the start, in which the motion is linear."""

MIN_FOLLOWED: Final = 0.5  # part of the true growth of a cell below which a method has damped it

TRIAL_STEPS: Final = 200  # steps that a method with a fixed step takes in a trial

_WINDOWS, _CONTROLLED_LENGTH = 8, 2000.0  # of methods under error control; time in 1/λ_max
_THROWN = re.compile("would move|not a number|on top of each other|not finite")
_MAX_PAIR_ERROR = 0.05  # pair distances off by more are wrong, in radii
_SAFETY = 3.0  # on what differs among the true courses of twins
_SHORT = 1e-3  # of a step, for what must not be timed
_MIN_PROGRESS = 0.01  # part of the true way that counts as no progress
_MAX_WINDOWS = 200  # windows of a fixed step in a trial whose length is given
_FINAL_STEPS = 3  # single steps at its end, in which displacements may alternate
_EARLIER_FACTOR = 4.0  # after cells have left the neighbourhood, over the time until then


@final
@dataclass
class Trace:
    """What was seen of a trial.

    - ``times``, list of float, s
    - ``positions``, list of (n, 3) float64, µm: at every time, the start included
    - ``energy``, list of float, fJ: at every time; infinite where cells are out of bounds or on top
      of others
    - ``end``, float, s: when it should end
    - ``turned``, list of (k, i, j): the line between cells i and j, which touched, turned by more
      than 90° from the state k that was looked at to the next
    - ``problem``, str: why it ended early, in words
    - ``out_of_bounds``, bool: whether it ended because positions or energy left all bounds
    - ``steps``, int: steps that the method took
    - ``wall``, float, s
    - ``counts``, list of int: steps that it took from the start until each time
    - ``late``, int: number of displacements at the end that are looked at for alternation; zero
      where every state is the end of a solve of its own
    - ``implicit``, bool: whether it solved equations in its steps
    - ``step``, float, s: the step, where it is fixed; else NaN
    """

    times: list[float]
    positions: list[FloatArray]
    energy: list[float]
    end: float
    turned: list[tuple[int, int, int]]
    problem: str = ""
    out_of_bounds: bool = False
    steps: int = 0
    wall: float = 0.0
    counts: list[int] = field(default_factory=lambda: [0])
    late: int = 3
    implicit: bool = False
    step: float = math.nan


@final
@dataclass(frozen=True)
class Verdict:
    """How a trial went.

    - ``kind``, str: a key of :data:`KINDS`
    - ``words``, str: what was seen
    - ``also``, tuple of str: what else was seen, in words
    - ``climb``, float: largest rise of the energy over what is noticed
    - ``deviation``, float: largest error of a pair distance at the end, in mean radii; NaN without
      an end
    """

    kind: str
    words: str
    also: tuple[str, ...]
    climb: float
    deviation: float


def run_trial(state: State, method: Method, setting: float, patience: float = 20.0) -> Trace:
    """Run a method from a state and record what it does.

    From a settled state a method with a fixed step takes :data:`TRIAL_STEPS` steps, one at a time;
    a multistep method starts anew for every recorded state. Methods under error control are
    recorded eight times in 2000 / λ_max, at the ends of coupling steps. From other states both
    solve the length of the state's trial: a fixed step is recorded 200 times at most; methods
    under error control and multistep methods start anew for each of a few observation times, as
    one coupling step to its end.

    - ``patience``: wall time in s after which a trial counts as a stall
    """
    fixed = method.control == "step"
    times = _times(state, method, setting)
    again = method.info.remembers if fixed else not state.settled
    integrator = method.make(setting)
    # loaded before the clock runs, however short the patience
    advance(state.system(0.0, _SHORT * times[0]), integrator, state.start)
    begin = clock.perf_counter()
    system = state.system(0.0, times[0])
    touching = at_start = system.contacts(0.0, state.start)
    energy = system.energy(0.0, state.start)
    late = max(3, len(times) // 4) if state.settled else _FINAL_STEPS * fixed
    trace = Trace([0.0], [state.start], [energy], times[-1], [], late=late)
    trace.step = setting if fixed else math.nan
    for k, end in enumerate(times):
        first = 0 if again else k
        before = system.work.steps
        state.ready(system, trace.times[first], end, touching if first else at_start)
        trace.problem, position = advance(system, integrator, trace.positions[first])
        trace.steps = trace.counts[first] + system.work.steps - before
        if trace.problem:
            break
        trace.turned += _turns(state, trace, end, position, touching, fixed)
        trace.times.append(end)
        trace.positions.append(position)
        trace.counts.append(trace.steps)
        trace.energy.append(_energy(state, system, end, position))
        trace.out_of_bounds = not trace.energy[-1] <= max(state.energy_unit, energy)
        if clock.perf_counter() - begin > patience and k + 1 < len(times):
            trace.problem = timeout_words(patience)
        if trace.problem or trace.out_of_bounds:
            break
        if trace.late:
            touching = system.contacts(end, position)
    trace.wall = clock.perf_counter() - begin
    trace.implicit = method.info.implicit or system.work.newton_iterations > 0
    return trace


def _times(state: State, method: Method, setting: float) -> list[float]:
    """Return the moments at which a trial is looked at, s; the last one is its end."""
    fixed = method.control == "step"
    if state.settled:
        count = TRIAL_STEPS if fixed else _WINDOWS
        length = setting if fixed else _CONTROLLED_LENGTH / (_WINDOWS * state.rate)
        return [(k + 1) * length for k in range(count)]
    if not fixed:
        return state.observation_times
    count = max(1, round(state.length / setting))
    if method.info.remembers:
        seen = [math.ceil(time / setting * (1.0 - 1e-9)) for time in state.observation_times]
    else:
        windows = -(-count // -(-count // _MAX_WINDOWS))
        seen = [-(-count * (k + 1) // windows) for k in range(windows)]
    last = range(max(1, count - _FINAL_STEPS), count + 1)
    return [state.length * k / count for k in sorted({*(min(k, count) for k in seen), *last})]


def _energy(state: State, system: Mechanics, time: float, position: FloatArray) -> float:
    """Return the energy in fJ, infinite where cells are out of bounds or on top of others."""
    reach = float(np.ptp(state.start, axis=0).max()) + 10.0 * state.radius
    if not np.abs(position - state.start.mean(axis=0)).max() <= reach:
        return np.inf
    try:
        return system.energy(time, position)
    except StateRejected:
        return np.inf


def turned_pairs(before: FloatArray, after: FloatArray, pairs: IntArray) -> IntArray:
    """Return those of some pairs whose line turns by more than 90° between two states."""
    first, second = pairs[:, 0], pairs[:, 1]
    old, new = before[second] - before[first], after[second] - after[first]
    return np.asarray(pairs[np.einsum("ij,ij->i", old, new) < 0.0])


def _turns(
    state: State, trace: Trace, end: float, after: FloatArray, touching: IntArray, fixed: bool
) -> list[tuple[int, int, int]]:
    """Return the pairs whose line turned until ``end``, other than by the true motion.

    It turned since the state that was looked at before; where each state is the end of a solve of
    its own, since the start.
    """
    k = len(trace.times) - 1 if trace.late else 0
    pairs = {(int(i), int(j)) for i, j in turned_pairs(trace.positions[k], after, touching)}
    if pairs and not (fixed and state.settled):
        # a coupling step may be long enough for the true motion to turn a pair
        true = [state.at(time) for time in (trace.times[k], end)]
        really = turned_pairs(true[0], true[1], np.array(sorted(pairs)))
        pairs -= {(int(i), int(j)) for i, j in really}
    return [(len(trace.times) - 1, i, j) for i, j in sorted(pairs)]


def judge(state: State, trace: Trace) -> Verdict:
    """Say how a trial went, by comparing it with the reference."""
    problem = trace.problem
    noticed, true_end, rest = _true_end(state, trace)
    climb = max(_climb(trace.energy) - state.rise, 0.0) / noticed if trace.late else 0.0
    if trace.out_of_bounds or _THROWN.search(problem):
        found = [(BLOW_UP, problem or "positions or energy left all bounds")]
    else:
        stalled = problem or _stillness(state, trace, true_end)
        found = [(STALL, stalled)] if stalled else []
    if trace.turned:
        k, i, j = trace.turned[0]
        when = f"in step {k + 1}" if state.settled else f"before {trace.times[k + 1]:.3g} s"
        found.append((WRONG, f"cells {i} and {j} changed sides {when}"))
    deviation = np.nan
    if not problem and not trace.out_of_bounds:
        deviation = pair_deviation(state, trace.positions[-1], true_end, trace.end)
        excess = (trace.energy[-1] - rest) / noticed
        wrong = list(_wrong(state, trace, climb, excess, deviation))
        words = describe_damping(state, trace) if wrong else ""
        found = [(DAMPED, words)] * bool(words) + found + [(WRONG, said) for said in wrong]
    kind, words = found[0] if found else (STABLE, "")
    return Verdict(kind, words, tuple(words for _, words in found[1:]), climb, deviation)


def pair_deviation(state: State, position: FloatArray, true: FloatArray, time: float) -> float:
    """Return the largest error of the distance of a pair that truly touches, in mean radii."""
    pairs = state.system(time, time + 1.0).contacts(time, true)
    if len(pairs) == 0:
        return 0.0
    error = np.abs(_distances(position, pairs) - _distances(true, pairs))
    return float(error.max()) / state.radius


def _true_end(state: State, trace: Trace) -> tuple[float, FloatArray, float]:
    """Return the rise of energy that is noticed, fJ, and true positions and energy at the end."""
    true_end = state.at(trace.end)
    rest = state.energy(trace.end, true_end)
    # growth may feed in more energy than motion releases
    released = trace.energy[0] - rest if state.rise == 0.0 else abs(trace.energy[0] - rest)
    released = max(released, state.rise, 0.0)
    others = [state.energy(trace.end, twin.at(trace.end)) for twin in state.twins]
    spread = max((abs(energy - rest) for energy in others), default=0.0)
    noticed = max(state.share * released, 1e-12 * state.energy_unit)
    return noticed + _SAFETY * spread, true_end, rest


def _stillness(state: State, trace: Trace, true_end: FloatArray) -> str:
    """Return the words for cells that have not moved though they should have, or none."""
    way = np.abs(true_end - trace.positions[0]).max()
    gone = np.abs(trace.positions[-1] - trace.positions[0]).max()
    if way > state.noticed and gone < _MIN_PROGRESS * way:
        return f"no progress: the cells should move by {way / state.radius:.2g} radii"
    return ""


def _wrong(
    state: State, trace: Trace, climb: float, excess: float, deviation: float
) -> Iterator[str]:
    """Yield what is wrong with a trial that reached its end, the foremost first.

    ``climb`` and ``excess``, of the energy at the end over that of the reference, are in units of
    what is noticed.
    """
    alternates, size = _alternation(state, trace)
    if alternates:
        yield f"displacements of {size:.2g} radii alternate"
    if excess > 1.0 or deviation > _max_deviation(state, trace.end):
        side = "above" if excess > 0.0 else "below"
        yield (
            f"the energy ends {abs(excess):.3g} times what is noticed {side} the reference; "
            f"pair distances differ by up to {deviation:.2g} radii"
        )
    if climb > 1.0:
        yield "the energy rose"


def _max_deviation(state: State, end: float) -> float:
    """Return the error of pair distances at the end that is not wrong, in mean radii.

    The true courses of twins tell what a small shift of the start changes.
    """
    true = state.at(end)
    apart = (pair_deviation(state, twin.at(end), true, end) for twin in state.twins)
    return max(_MAX_PAIR_ERROR, _SAFETY * max(apart, default=0.0))


def describe_damping(state: State, trace: Trace) -> str:
    """Return the words for real growth that a method has damped, or none.

    At a moment that is looked at let h be the method's mean step since half that time, and P the
    projection on the modes of the start with hμ > 1. The true course has *left* if the part P Δx
    of some cell's displacement is 0.05 mean radii or more, and had not left a quarter of that time
    before. The method has *damped* its growth if the size of that cell's P Δx is less than half
    the true one, while it is half of it or more in the true courses of all twins: then the growth
    hangs on no detail of the start. It is the size that counts, since which way cells buckle does
    hang on such details. Explicit methods lag behind growth but do not damp it: only methods that
    solve equations are asked.
    """
    unstable = state.unstable
    if unstable is None or not trace.implicit:
        return ""
    for k in _indices(trace.times, state.observation_times):
        time, step = trace.times[k], _mean_step(trace, k)
        if not (unstable.rates * step > 1.0).any():
            continue

        def part(course: FloatArray, start: FloatArray, least: float = 1.0 / step) -> FloatArray:
            return unstable.unstable_part(course - start, least) / state.radius

        true = part(state.at(time), state.start)
        left = np.flatnonzero(true >= DEPARTURE_RADII)
        if len(left) == 0:
            continue
        sooner = max(
            (t for t in state.observation_times if t * _EARLIER_FACTOR <= time), default=0.0
        )
        if (part(state.at(sooner), state.start) >= DEPARTURE_RADII).any():
            break
        own = part(trace.positions[k], state.start)
        least = np.min([true, *(part(twin.at(time), twin.start) for twin in state.twins)], axis=0)
        held = left[
            (own[left] < MIN_FOLLOWED * true[left]) & (least[left] >= MIN_FOLLOWED * true[left])
        ]
        if len(held):
            cell = int(held[true[held].argmax()])
            return (
                f"cell {cell} has grown by {own[cell]:.2g} radii along unstable modes after "
                f"{time:.3g} s, truly by {true[cell]:.2g}, in steps of {step:.3g} s with hμ up to "
                f"{step * unstable.rates.max():.3g}"
            )
    return ""


def _indices(times: list[float], moments: list[float]) -> list[int]:
    """Return the indices of the first times that are not before given ones, none twice."""
    places = np.searchsorted(times, np.array(moments) * (1.0 - 1e-9))
    return [int(k) for k in np.unique(places) if 0 < k < len(times)]


def _mean_step(trace: Trace, k: int) -> float:
    """Return the mean step in s since half the time of the state ``k`` that was looked at."""
    if not math.isnan(trace.step):
        return trace.step
    before = max(j for j in range(k) if trace.times[j] <= 0.5 * trace.times[k] or j == 0)
    steps = max(trace.counts[k] - trace.counts[before], 1)
    return (trace.times[k] - trace.times[before]) / steps


def _alternation(state: State, trace: Trace) -> tuple[bool, float]:
    """Return whether the last displacements alternate, and their size in radii."""
    if not trace.late:
        return False, 0.0
    moves = np.diff(np.array(trace.positions), axis=0)
    late = moves[-trace.late :]
    size = float(np.sqrt(np.square(late).sum(axis=2)).max()) / state.radius
    flat = late.reshape(len(late), -1)
    product = np.einsum("ij,ij->i", flat[1:], flat[:-1])
    length = np.linalg.norm(flat, axis=1)
    both = length[1:] * length[:-1]
    angle = np.divide(product, both, out=np.zeros_like(product), where=both > 0.0)
    return bool(np.median(angle) < -0.3 and size * state.radius > state.noticed), size


def _climb(energy: list[float]) -> float:
    """Return the largest rise of the energy above the least of what it was before, fJ."""
    rises = energy - np.minimum.accumulate(energy)
    return float(rises.max()) if np.isfinite(rises).all() else np.inf


def _distances(position: FloatArray, pairs: IntArray) -> FloatArray:
    return np.asarray(np.linalg.norm(position[pairs[:, 1]] - position[pairs[:, 0]], axis=1))
