"""One trial of a method: its steps are recorded, and the kind of failure is named.

There are three kinds of failure. A *blow-up* and a *stall* end a trial; a *wrong state* is one that
the true motion does not come to, whether that was seen on the way or at the end.
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
from multicell.comparison.replay import advance_system, timeout_words
from multicell.comparison.stability_limits.state import MIN_NOTICED, PUSH, TrialState
from multicell.mechanics.motion import StateRejected
from multicell.mechanics.system import Mechanics

STABLE: Final = "stable"
BLOW_UP: Final = "blow-up"
WRONG: Final = "wrong state"
STALL: Final = "stall"

TRIAL_ENDS: Final = {
    STABLE: "the energy only falls, and the end is that of the reference",
    BLOW_UP: "positions or energy grow beyond all bounds or are no numbers, or a step is refused "
    "because it would throw a cell away",
    STALL: "the end is not reached within the allowed steps",
    WRONG: "displacements alternate from step to step, the energy rises, or the end is not that of "
    "the reference",
}
"""End of a trial -> its meaning. Where several apply, blow-up or stall counts first."""

TRIAL_STEPS: Final = 200  # steps that a method with a fixed step takes in a trial

_WINDOWS, _CONTROLLED_LENGTH = 8, 2000.0  # of methods under error control; time in 1/λ_max
THROWN: Final = re.compile("would move|not a number|on top of each other|not finite")
_MAX_PAIR_ERROR = 0.05  # pair distances off by more are wrong, in radii
_SHORT = 1e-3  # of a step, for what must not be timed
_RISE_NOTICED = (MIN_NOTICED / PUSH) ** 2
"""Rise of the energy that is noticed, over the energy that the reference releases."""


@final
@dataclass
class Trace:
    """Trace of a trial.

    - ``times``, list of float, s
    - ``positions``, list of (n, 3) float64, µm: at every time, the start included
    - ``energy``, list of float, fJ: at every time; infinite where cells are out of bounds or on top
      of others
    - ``end``, float, s: when it should end
    - ``problem``, str: why it ended early, in words
    - ``out_of_bounds``, bool: whether it ended because positions or energy left all bounds
    - ``steps``, int: steps that the method took
    - ``wall``, float, s
    """

    times: list[float]
    positions: list[FloatArray]
    energy: list[float]
    end: float
    problem: str = ""
    out_of_bounds: bool = False
    steps: int = 0
    wall: float = 0.0


def run_trial(state: TrialState, method: Method, setting: float, patience: float = 20.0) -> Trace:
    """Run a method from a state and record the outcome.

    A method with a fixed step takes :data:`TRIAL_STEPS` steps, one at a time; a multistep method
    starts anew for every recorded state. Methods under error control are recorded eight times in
    2000 / λ_max, at the ends of coupling steps.

    - ``patience``: wall time in s after which a trial counts as a stall
    """
    fixed = method.control == "step"
    count = TRIAL_STEPS if fixed else _WINDOWS
    length = setting if fixed else _CONTROLLED_LENGTH / (_WINDOWS * state.rate)
    times = [(k + 1) * length for k in range(count)]
    again = method.info.remembers and fixed
    integrator = method.make(setting)
    # loaded before the clock runs, however short the patience
    advance_system(state.system(0.0, _SHORT * times[0]), integrator, state.start)
    begin = clock.perf_counter()
    system = state.system(0.0, times[0])
    touching = at_start = system.contacts(0.0, state.start)
    energy = system.energy(0.0, state.start)
    trace = Trace([0.0], [state.start], [energy], times[-1])
    for k, end in enumerate(times):
        first = 0 if again else k
        state.ready(system, trace.times[first], end, touching if first else at_start)
        trace.problem, position = advance_system(system, integrator, trace.positions[first])
        trace.steps = system.work.steps
        if trace.problem:
            break
        trace.times.append(end)
        trace.positions.append(position)
        trace.energy.append(_energy(state, system, end, position))
        trace.out_of_bounds = not trace.energy[-1] <= max(state.energy_unit, energy)
        if clock.perf_counter() - begin > patience and k + 1 < len(times):
            trace.problem = timeout_words(patience)
        if trace.problem or trace.out_of_bounds:
            break
        touching = system.contacts(end, position)
    trace.wall = clock.perf_counter() - begin
    return trace


def _energy(state: TrialState, system: Mechanics, time: float, position: FloatArray) -> float:
    """Return the energy in fJ, infinite where cells are out of bounds or on top of others."""
    reach = float(np.ptp(state.start, axis=0).max()) + 10.0 * state.radius
    if not np.abs(position - state.start.mean(axis=0)).max() <= reach:
        return np.inf
    try:
        return system.energy(time, position)
    except StateRejected:
        return np.inf


def judge(state: TrialState, trace: Trace) -> tuple[str, str]:
    """Return how a trial went, a key of :data:`TRIAL_ENDS`, and what was seen, in words.

    It is compared with the reference.
    """
    problem = trace.problem
    true_end = state.at(trace.end)
    rest = state.energy(trace.end, true_end)
    released = max(trace.energy[0] - rest, 0.0)
    noticed = max(_RISE_NOTICED * released, 1e-12 * state.energy_unit)
    if trace.out_of_bounds or THROWN.search(problem):
        return BLOW_UP, problem or "positions or energy left all bounds"
    if problem:
        return STALL, problem
    deviation = pair_deviation(state, trace.positions[-1], true_end, trace.end)
    excess, climb = (trace.energy[-1] - rest) / noticed, _climb(trace.energy) / noticed
    words = "; ".join(_wrong(state, trace, climb, excess, deviation))
    return WRONG if words else STABLE, words


def pair_deviation(state: TrialState, position: FloatArray, true: FloatArray, time: float) -> float:
    """Return the largest error of the distance of a pair that truly touches, in mean radii."""
    pairs = state.system(time, time + 1.0).contacts(time, true)
    if len(pairs) == 0:
        return 0.0
    error = np.abs(_distances(position, pairs) - _distances(true, pairs))
    return float(error.max()) / state.radius


def _wrong(
    state: TrialState, trace: Trace, climb: float, excess: float, deviation: float
) -> Iterator[str]:
    """Yield the faults of a trial that reached its end, the foremost first.

    ``climb`` and ``excess``, of the energy at the end over that of the reference, are in units of
    what is noticed.
    """
    alternates, size = _alternation(state, trace)
    if alternates:
        yield f"displacements of {size:.2g} radii alternate"
    if excess > 1.0 or deviation > _MAX_PAIR_ERROR:
        side = "above" if excess > 0.0 else "below"
        yield (
            f"the energy ends {abs(excess):.3g} times what is noticed {side} the reference; "
            f"pair distances differ by up to {deviation:.2g} radii"
        )
    if climb > 1.0:
        yield "the energy rose"


def _alternation(state: TrialState, trace: Trace) -> tuple[bool, float]:
    """Return whether the last displacements alternate, and their size in radii."""
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
