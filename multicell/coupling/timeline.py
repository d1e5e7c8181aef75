"""Where a run is in time, and which coupling step comes next."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple, final

from multicell.biology.pace import Pace, end_of_step, first_pace

if TYPE_CHECKING:
    from multicell.results.frame import Frame
    from multicell.scene.steps import StepPlan


@final
class Timeline(NamedTuple):
    """The time of a run.

    - ``plan``: which steps the scene allows
    - ``step``: number of coupling steps done
    - ``origin``, (step, s): from which steps of fixed length count; where the run chooses them, the
      last one's end
    - ``pace``, Pace or None: what chooses the next step; None where the scene fixes it
    """

    plan: StepPlan
    step: int
    origin: tuple[int, float]
    pace: Pace | None

    @classmethod
    def at_start(cls, plan: StepPlan) -> Timeline:
        """Return the beginning of a run."""
        return cls(plan, 0, (0, 0.0), None if plan.fixed is not None else first_pace(plan))

    @classmethod
    def at_frame(cls, plan: StepPlan, frame: Frame) -> Timeline:
        """Return the time of a frame that a run is resumed from."""
        start, known = cls.at_start(plan), frame.progress
        pace = start.pace
        if pace is not None and known is not None:
            pace = Pace.of(known.pace) or pace
        # a run whose last step was a shorter one has been prolonged: count from here
        shorter = plan.fixed is None or frame.time != frame.step * plan.fixed
        return cls(plan, frame.step, (frame.step, frame.time) if shorter else start.origin, pace)

    def after_step(self) -> Timeline:
        """Return the time after the next step."""
        origin = self.origin if self.pace is None else (self.step + 1, self.next_time)
        return self._replace(step=self.step + 1, origin=origin)

    @property
    def time(self) -> float:
        """Simulated time, s: whole steps from the start or a prolonged end, or the run's end."""
        step, time = self.origin
        if self.pace is None:
            time += (self.step - step) * self.plan.longest
        return min(time, self.plan.duration)

    @property
    def next_time(self) -> float:
        """The end of the next coupling step, s."""
        if self.pace is not None:
            return end_of_step(self.plan, self.pace, self.time)
        return min(self.time + self.plan.longest, self.plan.duration)

    @property
    def steps(self) -> int:
        """Number of coupling steps to the run's end, chosen ones all as long as the next."""
        step, time = self.origin
        length = self.plan.longest if self.pace is None else self.pace.step
        ahead = (self.plan.duration - time) / length
        return max(1, step + math.ceil(ahead * (1.0 - 1e-12)))

    @property
    def is_over(self) -> bool:
        """Whether the duration is reached."""
        if self.pace is not None:
            return self.time >= self.plan.duration
        return self.step >= self.steps
