"""One trial of a method: it is watched step by step, and how it fails is named.

There are three kinds of failure. A *blow-up* and a *stall* end a trial; a *wrong state* is one that
the true motion does not come to, whether it was seen on the way or at the end.
"""

from __future__ import annotations

import re
import time as clock
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from multicell.cells import FloatArray, IntArray
from multicell.comparison.ladders import Method
from multicell.comparison.replay import advance, too_late
from multicell.comparison.stability_limits.state import State
from multicell.mechanics.motion import StateRejected
from multicell.mechanics.system import Mechanics

STABLE: Final = "stable"
BLOW_UP: Final = "blow-up"
WRONG: Final = "wrong state"
STALL: Final = "stall"

KINDS: Final = {
    STABLE: "the energy only falls, and the end is that of the reference",
    BLOW_UP: "positions or energy grow beyond all bounds or are no numbers, or a step is refused "
    "because it would throw a cell away",
    STALL: "the end is not reached within the allowed steps, or nothing moves where it should",
    WRONG: "cells pass through each other, displacements alternate from step to step, the energy "
    "rises, or the end is not that of the reference",
}
"""How a trial ends -> what that means.

Where several apply, blow-up or stall counts first. After a division cells may take another pocket
than in the reference: only a higher energy at the end is wrong there.
"""

STEPS: Final = 200
"""Steps that a method with a fixed step takes in a trial."""

_WINDOWS, _LENGTH = 8, 2000.0  # of methods under error control; time in 1/λ_max
_THROWN = re.compile("would move|not a number|on top of each other|not finite")
_DISTANCE = 0.05  # pair distances off by more are wrong, in radii
_SAFETY = 3.0  # on what differs among the true courses of twins
_SHORT = 1e-3  # of a step, for what must not be timed
_STILL = 0.01  # part of the true way that counts as no progress


@final
@dataclass
class Trace:
    """What was seen of a trial.

    Attributes
    ----------
    times : list of float, s
    positions : list of (n, 3) float64, µm
        At every time, the start included.
    energy : list of float, fJ
        At every time; infinite where cells are out of bounds or on top of others.
    end : float, s
        When it should end.
    turned : list of (k, i, j)
        The line between cells i and j, which touched, turned by more than 90° in step k.
    problem : str
        Why it ended early, in words.
    out_of_bounds : bool
        Whether it ended because positions or energy left all bounds.
    steps : int
        Steps that the method took.
    wall : float, s
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


@final
@dataclass(frozen=True)
class Verdict:
    """How a trial went.

    Attributes
    ----------
    kind : str
        A key of :data:`KINDS`.
    words : str
        What was seen.
    also : tuple of str
        What else was seen, in words.
    climb : float
        Largest rise of the energy over what is noticed.
    deviation : float
        Largest error of a pair distance at the end, in mean radii; NaN without an end.
    """

    kind: str
    words: str
    also: tuple[str, ...]
    climb: float
    deviation: float


def watch(state: State, method: Method, setting: float, patience: float = 20.0) -> Trace:
    """Let a method go from a state, and look at every step.

    A method with a fixed step takes :data:`STEPS` steps, one at a time. A method that looks back
    at earlier steps goes from the start again for every state that is looked at. Methods under
    error control are looked at eight times in 2000 / λ_max, at the ends of coupling steps.

    Parameters
    ----------
    state, method, setting
        What, by what, and with which tolerance or step.
    patience
        Wall time in s after which a trial counts as a stall.
    """
    fixed = method.control == "step"
    count = STEPS if fixed else _WINDOWS
    length = setting if fixed else _LENGTH / (_WINDOWS * state.rate)
    integrator = method.make(setting)
    # loaded before the clock runs, however short the patience
    advance(state.system(0.0, _SHORT * length), integrator, state.start)
    begin = clock.perf_counter()
    system = state.system(0.0, length)
    touching = at_start = system.contacts(0.0, state.start)
    energy = system.energy(0.0, state.start)
    trace = Trace([0.0], [state.start], [energy], count * length, [])
    for k in range(count):
        first = 0 if fixed and method.info.remembers else k
        before, end = system.work.steps, (k + 1) * length
        state.ready(system, first * length, end, touching if first else at_start)
        trace.problem, position = advance(system, integrator, trace.positions[first])
        trace.steps += system.work.steps - before
        if trace.problem:
            break
        trace.turned += _turns(state, k, length, trace.positions[-1], position, touching, fixed)
        trace.times.append(end)
        trace.positions.append(position)
        trace.energy.append(_energy(state, system, end, position))
        trace.out_of_bounds = not trace.energy[-1] <= max(state.energy_unit, energy)
        if clock.perf_counter() - begin > patience and k + 1 < count:
            trace.problem = too_late(patience)
        if trace.problem or trace.out_of_bounds:
            break
        touching = system.contacts(end, position)
    trace.wall = clock.perf_counter() - begin
    return trace


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
    state: State,
    k: int,
    length: float,
    before: FloatArray,
    after: FloatArray,
    touching: IntArray,
    fixed: bool,
) -> list[tuple[int, int, int]]:
    """Return the pairs whose line turned in step ``k``, other than by the true motion."""
    pairs = {(int(i), int(j)) for i, j in turned_pairs(before, after, touching)}
    if pairs and not fixed:
        # a coupling step may be long enough for the true motion to turn a pair
        true = [state.at((k + m) * length) for m in (0, 1)]
        really = turned_pairs(true[0], true[1], np.array(sorted(pairs)))
        pairs -= {(int(i), int(j)) for i, j in really}
    return [(k, i, j) for i, j in sorted(pairs)]


def judge(state: State, trace: Trace) -> Verdict:
    """Say how a trial went, by comparing it with the reference."""
    problem = trace.problem
    noticed, true_end, rest = _expected(state, trace)
    climb = _climb(trace.energy) / noticed
    if trace.out_of_bounds or _THROWN.search(problem):
        found = [(BLOW_UP, problem or "positions or energy left all bounds")]
    else:
        stalled = problem or _stillness(state, trace, true_end)
        found = [(STALL, stalled)] if stalled else []
    if trace.turned:
        k, i, j = trace.turned[0]
        found.append((WRONG, f"cells {i} and {j} changed sides in step {k + 1}"))
    deviation = np.nan
    if not problem and not trace.out_of_bounds:
        deviation = pair_deviation(state, trace.positions[-1], true_end)
        excess = (trace.energy[-1] - rest) / noticed
        found += [(WRONG, words) for words in _wrong(state, trace, climb, excess, deviation)]
    kind, words = found[0] if found else (STABLE, "")
    return Verdict(kind, words, tuple(words for _, words in found[1:]), climb, deviation)


def pair_deviation(state: State, position: FloatArray, true: FloatArray) -> float:
    """Return the largest error of the distance of a pair that truly touches, in mean radii."""
    pairs = state.system(0.0, 1.0).contacts(0.0, true)
    if len(pairs) == 0:
        return 0.0
    error = np.abs(_distances(position, pairs) - _distances(true, pairs))
    return float(error.max()) / state.radius


def _expected(state: State, trace: Trace) -> tuple[float, FloatArray, float]:
    """Return the rise of energy that is noticed, fJ, and true positions and energy at the end."""
    true_end = state.at(trace.end)
    rest = state.energy(0.0, true_end)
    released = max(trace.energy[0] - rest, 0.0)
    others = [state.energy(0.0, twin.at(trace.end)) for twin in state.twins]
    spread = max((abs(energy - rest) for energy in others), default=0.0)
    noticed = max(state.share * released, 1e-12 * state.energy_unit)
    return noticed + _SAFETY * spread, true_end, rest


def _stillness(state: State, trace: Trace, true_end: FloatArray) -> str:
    """Return the words for cells that have not moved though they should have, or none."""
    way = np.abs(true_end - trace.positions[0]).max()
    gone = np.abs(trace.positions[-1] - trace.positions[0]).max()
    if way > state.noticed and gone < _STILL * way:
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
    # where cells have been pressed apart, a pocket of no higher energy is as good
    if excess > 1.0 or (deviation > _DISTANCE and not state.twins):
        side = "above" if excess > 0.0 else "below"
        yield (
            f"the energy ends {abs(excess):.3g} times what is noticed {side} the reference; "
            f"pair distances differ by up to {deviation:.2g} radii"
        )
    if climb > 1.0:
        yield "the energy rose"


def _alternation(state: State, trace: Trace) -> tuple[bool, float]:
    """Return whether the last quarter of the displacements alternate, and their size in radii."""
    moves = np.diff(np.array(trace.positions), axis=0)
    late = moves[-max(3, len(moves) // 4) :]
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
