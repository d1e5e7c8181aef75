"""The true end of a recorded coupling step, and how far anybody can know it.

The end is solved by two methods at tight tolerances. Its *conditioning* is the largest displacement
of a cell at the end that normal random shifts of all coordinates at the start cause, the most of
twelve: one alone may by chance do a thirtieth of another. A step may forget a shift of its start
and yet hang by a hair later, where a contact breaks: shifts within the step show that.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from typing import Final, final

import numpy as np

from multicell.cells import FloatArray, IntArray
from multicell.comparison.ladders import find_method
from multicell.comparison.norms import worst_distance
from multicell.comparison.null_methods import NULL_METHODS
from multicell.comparison.stability_limits.recorded import RecordedState
from multicell.comparison.stability_limits.state import largest_decay, largest_growth
from multicell.errors import SceneError, StepFailed
from multicell.integrators.base import Integrator, build_method
from multicell.integrators.shift import SHIFT, shifted_positions
from multicell.mechanics.motion import Motion
from multicell.mechanics.system import Mechanics

SHIFTS: Final = 12
"""Number of random shifts of a start, of which the one with the largest effect counts."""
_DRAWS: Final = range(1, SHIFTS + 1)  # seeds of the shifts

_EXACT, _CHECK, _SHIFTED = 1e-11, 1e-10, 1e-8  # tolerances in radii: truth, its check, shifts
_PARTS: Final = 32  # of a coupling step, at whose ends the true contacts are looked at
_HINT: Final = "Choose another time, or a run with a shorter coupling_step."
_METHODS: Final = ("dopri5", "cvode")  # of the truth and of its check; or the other way round


@final
@dataclass
class TrueStep:
    """The truth of a recorded state.

    - ``state``, RecordedState
    - ``end``, (n, 3) float64, µm: where the cells end
    - ``uncertainty``, float, µm: how far the second method puts the worst cell from there
    - ``moved``, shift in µm -> float, µm: its conditioning
    - ``method``, str: the one that solved it
    """

    state: RecordedState
    end: FloatArray
    uncertainty: float
    method: str
    moved: dict[float, float] = field(default_factory=dict)

    @classmethod
    def of(cls, state: RecordedState) -> TrueStep:
        """Solve a state; raises StepFailed where neither method can."""
        words = ""
        for first, second in (_METHODS, _METHODS[::-1]):
            words, end, _ = state.solve(reference_method(state, first, _EXACT), state.start)
            if not words:
                checking = reference_method(state, second, _CHECK)
                other, check, _ = state.solve(checking, state.start)
                off = float("nan") if other else worst_distance(end, check)
                return cls(state, end, off, first)
        raise StepFailed(state.motion.begin, f"the reference of {state.name}: {words}", _HINT)

    def conditioning(self, shift: float = SHIFT) -> float:
        """Return the effect of shifts of the start on the worst cell, µm: the largest of twelve.

        At least the uncertainty of the end itself.
        """
        if shift not in self.moved:
            motion, method = self.state.motion, self._tight()
            ends = [self._solved(method, self._shifted(shift, draw), motion)[0] for draw in _DRAWS]
            self.moved[shift] = max(worst_distance(end, self.end) for end in ends)
        return max(self.moved[shift], float(np.nan_to_num(self.uncertainty)))

    def conditioning_within(self, shift: float = SHIFT) -> float:
        """Return the effect of shifts at each of 32 times of the step, µm: the largest of twelve.

        Less than what a method may do whose steps are each off by ``shift``.
        """
        most, method, touching = 0.0, self._tight(), self.state.motion.touching
        for draw in _DRAWS:
            position, memory = self.state.start, touching
            for k, (begin, end) in enumerate(itertools.pairwise(self._times())):
                position = self._shifted(shift, draw, k, position)
                motion = self.state.motion.between(begin, end, memory)
                position, system = self._solved(method, position, motion)
                memory = None if touching is None else system.contacts(end, position)
            most = max(most, worst_distance(position, self.end))
        return most

    def _shifted(
        self, shift: float, draw: int, place: int = 0, position: FloatArray | None = None
    ) -> FloatArray:
        """Return positions, by default the start, with all cells shifted that are not held."""
        state = self.state
        position = state.start if position is None else position
        ids, held = np.arange(len(position)), state.motion.held
        moved = shifted_positions(position, shift, draw, place, ids, state.scene.dimensions)
        return moved if held is None else np.where(held[:, None], position, moved)

    def _solved(
        self, method: Integrator, position: FloatArray, motion: Motion
    ) -> tuple[FloatArray, Mechanics]:
        """Return where shifted cells end, and the mechanics there."""
        words, end, system = self.state.solve(method, position, motion)
        if words:
            raise StepFailed(motion.begin, f"{self.state.name}, shifted: {words}", _HINT)
        return end, system

    def null_error(self) -> float:
        """Return how far the better one of the methods without mechanics is off, µm."""
        state, found = self.state, []
        for info in NULL_METHODS.values():
            _, end, _ = state.solve(build_method(info), state.start)
            found.append(worst_distance(end, self.end))
        return min(found)

    def contacts(self, end: FloatArray) -> IntArray:
        """Return the pairs in contact where cells end, (m, 2)."""
        system = self.state.system()
        return system.contacts(system.motion.end, end)

    def growth(self, end: FloatArray) -> float:
        """Return the largest growth rate of a displacement where cells end, 1/s."""
        system = self.state.system()
        return largest_growth(system, system.motion.end, end, self.state.scene.dimensions == 2)

    def decay(self) -> float:
        """Return the largest decay rate at the true end, 1/s; zero where no cells touch."""
        time, flat = self.state.motion.end, self.state.scene.dimensions == 2
        motion = self.state.motion.between(time, time + self.state.length, self.contacts(self.end))
        try:
            return largest_decay(self.state.system(motion), self.end, flat)[0]
        except SceneError:
            return 0.0

    def contact_time(self, pair: IntArray) -> float | None:
        """Return the first of 32 times of the step at which a pair is in contact to stay, s.

        None if it is not in contact at the end.
        """
        state, touching = self.state, self.state.motion.touching
        position, since, memory = state.start, None, touching
        for begin, end in itertools.pairwise(self._times()):
            motion = state.motion.between(begin, end, memory)
            words, position, system = state.solve(self._tight(), position, motion)
            if words:
                return None
            pairs = system.contacts(end, position)
            memory = None if touching is None else pairs
            joined = bool((pairs == pair).all(axis=1).any())
            since = (end if since is None else since) if joined else None
        return since

    def later(self, end: FloatArray, part: float) -> FloatArray | None:
        """Return where cells that end there are a part of the step later, by the reference."""
        begin = self.state.motion.end
        memory = None if self.state.motion.touching is None else self.contacts(end)
        motion = self.state.motion.between(begin, begin + part * self.state.length, memory)
        words, position, _ = self.state.solve(self._tight(), end, motion)
        return None if words else position

    def stopping(self, method: Integrator, time: float) -> FloatArray | None:
        """Return the end of a method that stops at a time of the step, s, and beside it.

        The stops beside it are a 32nd of the step before and after. None where the method fails.
        """
        state, position, part = self.state, self.state.start, self.state.length / _PARTS
        memory, last = state.motion.touching, state.motion.end
        stops = [t for t in (time - part, time, time + part) if state.motion.begin < t < last]
        for begin, end in itertools.pairwise([state.motion.begin, *stops, last]):
            words, position, system = state.solve(
                method, position, state.motion.between(begin, end, memory)
            )
            if words:
                return None
            memory = None if memory is None else system.contacts(end, position)
        return position

    def _times(self) -> list[float]:
        """Return the ends of the parts of the step, s."""
        motion = self.state.motion
        return [float(t) for t in np.linspace(motion.begin, motion.end, _PARTS + 1)]

    def _tight(self) -> Integrator:
        return reference_method(self.state, self.method, _SHIFTED)


def reference_method(state: RecordedState, name: str, tolerance: float) -> Integrator:
    """Return a method with a tolerance in mean radii."""
    return find_method(name, state.scene, state.radius).make(tolerance)
