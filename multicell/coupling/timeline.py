"""Where a run is in time, which coupling step comes next, and the wall time of its phases."""

from __future__ import annotations

import math
import time as clock
from typing import TYPE_CHECKING, Final, NamedTuple, final

from multicell.compiling import COMPILATION

if TYPE_CHECKING:
    from multicell.results.frame import Frame
    from multicell.scene.scales import StepPlan


@final
class Timeline(NamedTuple):
    """The time of a run.

    - ``plan``: its coupling steps
    - ``step``: number of coupling steps done
    - ``origin``, (step, s): from which steps count
    """

    plan: StepPlan
    step: int
    origin: tuple[int, float]

    @classmethod
    def at_start(cls, plan: StepPlan) -> Timeline:
        """Return the beginning of a run."""
        return cls(plan, 0, (0, 0.0))

    @classmethod
    def at_frame(cls, plan: StepPlan, frame: Frame) -> Timeline:
        """Return the time of a frame that a run is resumed from."""
        # a run whose last step was a shorter one has been prolonged: count from here
        shorter = frame.time != frame.step * plan.step
        return cls(plan, frame.step, (frame.step, frame.time) if shorter else (0, 0.0))

    def after_step(self) -> Timeline:
        """Return the time after the next step."""
        return Timeline(self.plan, self.step + 1, self.origin)

    @property
    def time(self) -> float:
        """Simulated time, s: whole steps from the start or a prolonged end, or the run's end."""
        step, time = self.origin
        return min(time + (self.step - step) * self.plan.step, self.plan.duration)

    @property
    def next_time(self) -> float:
        """The end of the next coupling step, s."""
        return min(self.time + self.plan.step, self.plan.duration)

    @property
    def steps(self) -> int:
        """Number of coupling steps to the run's end."""
        step, time = self.origin
        ahead = (self.plan.duration - time) / self.plan.step
        return max(1, step + math.ceil(ahead * (1.0 - 1e-12)))

    @property
    def is_over(self) -> bool:
        """Whether the duration is reached."""
        return self.step >= self.steps


PHASES: Final = ("compile", "nutrient", "biology", "mechanics", "events", "record")
"""Phases of the loop whose wall time is measured; no moment belongs to two of them."""


@final
class Phase:
    """Adds the wall time of a block to that of a phase, and what numba took of it to another."""

    def __init__(self, wall: dict[str, float], name: str) -> None:
        self.wall, self.name = wall, name

    def __enter__(self) -> None:
        self.begin, self.compiled = clock.perf_counter(), COMPILATION.seconds

    def __exit__(self, *_: object) -> None:
        compiled = COMPILATION.seconds - self.compiled
        self.wall["compile"] += compiled
        self.wall[self.name] += clock.perf_counter() - self.begin - compiled
