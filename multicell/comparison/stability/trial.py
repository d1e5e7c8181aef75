"""One trial of a method: it is watched step by step, and how it fails is named."""

from __future__ import annotations

import re
import time as clock
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from multicell.cells import FloatArray, IntArray
from multicell.comparison.ladders import Method
from multicell.comparison.replay import _one_step
from multicell.comparison.stability.state import State
from multicell.mechanics.system import Mechanics, StateRejected

STABLE: Final = "stable"
BLOW_UP: Final = "blow-up"
PASSING: Final = "cells passing through each other"
OSCILLATION: Final = "oscillation"
SEPARATION: Final = "false separation of a bond"
STALL: Final = "stall"
WRONG: Final = "wrong equilibrium"

KINDS: Final = {
    STABLE: "the energy only falls, and the end is that of the reference",
    BLOW_UP: "positions or energy grow beyond all bounds or are no numbers, or a step is refused "
    "because it would throw a cell away",
    PASSING: "the line between two cells that touch turns by more than 90° within one step",
    OSCILLATION: "displacements alternate from step to step and do not decay, or the energy "
    "rises and falls again",
    SEPARATION: "a pair in contact at the start, and at the end of the reference, ends apart",
    STALL: "the end is not reached within the allowed steps, or nothing moves where it should",
    WRONG: "the energy ends above that of the reference, or pair distances differ, though nothing "
    "failed",
}
"""How a trial ends -> what that means.

Where several apply, blow-up or stall counts first, then cells that pass through each other,
displacements that alternate, a lost bond, and the others. After a division cells may take
another pocket than in the reference: only a higher energy at the end is wrong there, and only
then a lost bond counts.
"""

STEPS: Final = 200
"""Steps that a method with a fixed step takes in a trial."""

_WINDOWS, _LENGTH = 8, 2000.0  # of methods under error control; time in 1/λ_max
_THROWN = re.compile("would move|not a number|on top of each other|not finite")
_DISTANCE = 0.05  # pair distances off by more are wrong, in radii
_FIRM = 0.02  # overlap of a contact that cannot be lost by chance, in radii
_SAFETY = 3.0  # on what differs among the true courses of twins
_STILL = 0.01  # part of the true way that counts as no progress


@final
@dataclass(frozen=True, eq=False)
class Trace:
    """What was seen of a trial.

    Attributes
    ----------
    times : (m + 1,) float64, s
    positions : list of (n, 3) float64, µm
        At every time, the start included.
    energy : (m + 1,) float64, fJ
    contacts : (p, 2) int64
        Pairs in contact at the start.
    turned : list of (k, i, j)
        The line between cells i and j, which touched, turned by more than 90° in step k.
    problem : str
        Why it ended early, in words.
    out_of_bounds : bool
        Whether it ended because positions or energy left all bounds.
    end : float, s
        When it should have ended.
    steps : int
        Steps that the method took.
    wall : float, s
    """

    times: FloatArray
    positions: list[FloatArray]
    energy: FloatArray
    contacts: IntArray
    turned: list[tuple[int, int, int]]
    problem: str
    out_of_bounds: bool
    end: float
    steps: int
    wall: float


@final
@dataclass(frozen=True)
class Verdict:
    """How a trial went.

    Attributes
    ----------
    kind : str
        A key of :data:`KINDS`.
    also : tuple of str
        Other kinds that apply as well.
    words : str
        What was seen.
    climb : float
        Largest rise of the energy over what is noticed.
    deviation : float
        Largest error of a pair distance at the end, in mean radii; NaN without an end.
    """

    kind: str
    also: tuple[str, ...]
    words: str
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
    return _Watch(state, method, setting, length, count, patience).run()


@final
class _Watch:
    """A trial under way."""

    def __init__(
        self,
        state: State,
        method: Method,
        setting: float,
        length: float,
        count: int,
        patience: float,
    ) -> None:
        self.state, self.method, self.length, self.count = state, method, length, count
        self.integrator = method.make(setting)
        self.patience = patience
        self.turned: list[tuple[int, int, int]] = []
        self.middle = state.start.mean(axis=0)
        self.reach = float(np.ptp(state.start, axis=0).max()) + 10.0 * state.radius
        self.most = max(state.energy_unit, state.system(0.0, 1.0).energy(0.0, state.start))

    def run(self) -> Trace:
        """Take all steps, unless something goes wrong for good."""
        begin = clock.perf_counter()
        state = self.state
        system = state.system(0.0, self.length)
        touching = first = system.contacts(0.0, state.start)
        positions, energy = [state.start], [system.energy(0.0, state.start)]
        steps, problem, lost = 0, "", False
        for k in range(self.count):
            before = system.work.steps
            problem, position = self._step(system, k, positions, touching)
            steps += system.work.steps - before
            if problem:
                break
            self._note_turns(k, positions[-1], position, touching)
            positions.append(position)
            energy.append(self._energy(system, (k + 1) * self.length, position))
            lost = not energy[-1] <= self.most
            late = clock.perf_counter() - begin > self.patience and k + 1 < self.count
            if lost or late:
                problem = f"not done after {self.patience:g} s of wall time" if late else ""
                break
            touching = system.contacts((k + 1) * self.length, position)
        times = np.asarray(self.length * np.arange(len(positions)), dtype=np.float64)
        return Trace(
            times, positions, np.array(energy), first, self.turned, problem, lost,
            self.count * self.length, steps, clock.perf_counter() - begin,
        )  # fmt: skip

    def _step(
        self, system: Mechanics, k: int, positions: list[FloatArray], touching: IntArray
    ) -> tuple[str, FloatArray]:
        remembers = self.method.control == "step" and self.method.info.remembers
        start = 0 if remembers else k
        self.state.ready(system, start * self.length, (k + 1) * self.length, touching)
        return _one_step(system, self.integrator, positions[start])

    def _note_turns(
        self, k: int, before: FloatArray, after: FloatArray, touching: IntArray
    ) -> None:
        pairs = turned_pairs(before, after, touching)
        if len(pairs) and self.method.control == "tolerance":
            # a coupling step may be long enough for the true motion to turn a pair
            true = [self.state.at((k + m) * self.length) for m in (0, 1)]
            really = {tuple(pair) for pair in turned_pairs(true[0], true[1], pairs)}
            pairs = np.array([pair for pair in pairs if tuple(pair) not in really])
        self.turned += [(k, int(i), int(j)) for i, j in pairs]

    def _energy(self, system: Mechanics, time: float, position: FloatArray) -> float:
        """Return the energy in fJ, infinite where cells are out of bounds or on top of others."""
        if not np.abs(position - self.middle).max() <= self.reach:
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


def judge(state: State, trace: Trace) -> Verdict:
    """Say how a trial went, by comparing it with the reference."""
    problem = trace.problem
    slack, true_end, rest = _expected(state, trace)
    climb = _climb(trace.energy) / slack
    if trace.out_of_bounds or _THROWN.search(problem):
        kinds = [(BLOW_UP, problem or "positions or energy left all bounds")]
    elif problem:
        kinds = [(STALL, problem)]
    else:
        kinds = _stillness(state, trace, true_end)
    if trace.turned:
        k, i, j = trace.turned[0]
        kinds.append((PASSING, f"cells {i} and {j} changed sides in step {k + 1}"))
    deviation = np.nan
    if not problem and not trace.out_of_bounds:
        deviation = pair_deviation(state, trace.positions[-1], true_end)
        kinds += _at_end(state, trace, slack, rest, deviation)
    if not kinds:
        return Verdict(STABLE, (), "", climb, deviation)
    also = tuple(dict.fromkeys(kind for kind, _ in kinds[1:] if kind != kinds[0][0]))
    return Verdict(kinds[0][0], also, kinds[0][1], climb, deviation)


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
    rest = state.system(0.0, 1.0).energy(0.0, true_end)
    released = max(float(trace.energy[0]) - rest, 0.0)
    others = [state.system(0.0, 1.0).energy(0.0, twin.at(trace.end)) for twin in state.twins]
    spread = max((abs(energy - rest) for energy in others), default=0.0)
    slack = max(state.share * released, 1e-12 * state.energy_unit)
    return slack + _SAFETY * spread, true_end, rest


def _stillness(state: State, trace: Trace, true_end: FloatArray) -> list[tuple[str, str]]:
    """Return a stall if the cells have not moved though they should have."""
    way = np.abs(true_end - trace.positions[0]).max()
    gone = np.abs(trace.positions[-1] - trace.positions[0]).max()
    if way > state.noticed and gone < _STILL * way:
        return [(STALL, f"no progress: the cells should move by {way / state.radius:.2g} radii")]
    return []


def _at_end(
    state: State, trace: Trace, slack: float, rest: float, deviation: float
) -> list[tuple[str, str]]:
    """Return the failures that a trial shows which reached its end, the first one foremost."""
    found = []
    alternates, size = _alternation(state, trace)
    excess = (float(trace.energy[-1]) - rest) / slack
    # where cells have been pressed apart, a pocket of no higher energy is as good
    wrong = excess > 1.0 or (deviation > _DISTANCE and not state.twins)
    still = size * state.radius < 0.1 * state.noticed
    if alternates:
        found.append((OSCILLATION, f"displacements of {size:.2g} radii alternate"))
    bond = _lost_bond(state, trace)
    if bond and (wrong or not state.twins):
        found.append((SEPARATION, bond))
    side = "above" if excess > 0.0 else "below"
    wrong_words = (
        f"the energy ends {abs(excess):.3g} times what is noticed {side} the reference; "
        f"pair distances differ by up to {deviation:.2g} radii"
    )
    if wrong and still:
        found.append((WRONG, wrong_words))
    if _cycles(trace.energy, slack):
        found.append((OSCILLATION, "the energy rose and fell again"))
    elif _climb(trace.energy) > slack and not wrong:
        found.append((OSCILLATION, "the energy rose"))
    if wrong and not still:
        found.append((WRONG, wrong_words))
    return found


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


def _climb(energy: FloatArray) -> float:
    """Return the largest rise of the energy above what it was before, fJ."""
    rises = energy - np.minimum.accumulate(energy)
    return float(rises.max()) if np.isfinite(rises).all() else np.inf


def _cycles(energy: FloatArray, slack: float) -> bool:
    """Return whether the energy rises by more than ``slack`` and falls by as much again."""
    rises = energy - np.minimum.accumulate(energy)
    peak = int(rises.argmax())
    return bool(rises[peak] > slack and energy[peak] - energy[peak:].min() > slack)


def _lost_bond(state: State, trace: Trace) -> str:
    """Return the words for a bond that the method has broken, or none."""
    time = float(trace.times[-1])
    pairs = trace.contacts
    rest = state.motion.radius[pairs[:, 0]] + state.motion.radius[pairs[:, 1]]
    true_ends = [true.at(trace.end) for true in (state, *state.twins)]
    # bonds of every true course, whichever pocket it ends in
    firm = np.all([rest - _distances(x, pairs) > _FIRM * state.radius for x in true_ends], axis=0)
    system = state.system(time, time + 1.0, pairs)
    touching = {tuple(pair) for pair in system.contacts(time, trace.positions[-1]).tolist()}
    lost = [tuple(pair) for pair in pairs[firm].tolist() if tuple(pair) not in touching]
    if not lost:
        return ""
    i, j = lost[0]
    return f"{len(lost)} bond{'s' if len(lost) > 1 else ''} lost, first that of cells {i} and {j}"


def _distances(position: FloatArray, pairs: IntArray) -> FloatArray:
    return np.asarray(np.linalg.norm(position[pairs[:, 1]] - position[pairs[:, 0]], axis=1))
