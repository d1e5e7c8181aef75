"""Time of a run, its next coupling step, and the wall time of its phases."""

from __future__ import annotations

import time as clock
from typing import TYPE_CHECKING, Final, NamedTuple, final

from multicell.compiling import COMPILATION

if TYPE_CHECKING:
    from collections.abc import Sequence

    from multicell.results.frame import Frame
    from multicell.scene.steps import StepPlan


@final
class Timeline(NamedTuple):
    """The time of a run.

    - ``plan``: its coupling steps
    - ``step_index``: number of coupling steps done
    - ``time``, s: simulated
    - ``length``, ``following``, s: chosen for the next step and the one after; None: of the plan
    """

    plan: StepPlan
    step_index: int = 0
    time: float = 0.0
    length: float | None = None
    following: float | None = None

    @classmethod
    def at_frame(cls, plan: StepPlan, frame: Frame) -> Timeline:
        """Return the time of a frame that a run is resumed from."""
        lengths = () if frame.progress is None else frame.progress.lengths[:2]
        return cls(plan, frame.step, frame.time, *lengths)

    def choosing(self, lengths: Sequence[float]) -> Timeline:
        """Return it with lengths of the next two steps, where a run chooses them."""
        return Timeline(self.plan, self.step_index, self.time, *lengths[:2])

    def after_step(self) -> Timeline:
        """Return the time after the next step."""
        return Timeline(self.plan, self.step_index + 1, self.next_time, self.following)

    @property
    def next_time(self) -> float:
        """The end of the next coupling step, s."""
        return self.plan.end_after(self.time, self.length)

    @property
    def ahead(self) -> float:
        """Length of the next coupling step, s, also where the run ends before it."""
        return self.plan.next_end(self.time, self.length) - self.time

    @property
    def steps(self) -> int:
        """Number of coupling steps to the run's end, chosen ones as long as the next."""
        return self.step_index + self.plan.steps_after(self.time, self.length)

    @property
    def is_over(self) -> bool:
        """Whether the duration is reached."""
        return self.time >= self.plan.duration


TIMED_PHASES: Final = ("compile", "nutrient", "biology", "mechanics", "events", "record")
"""Phases of the loop whose wall time is measured; no moment belongs to two of them."""


@final
class PhaseTimer:
    """Adds the wall time of a block to that of a phase, and what numba took of it to another."""

    def __init__(self, wall: dict[str, float], name: str) -> None:
        self.wall, self.name = wall, name

    def __enter__(self) -> None:
        self.lap = Laps(self.wall)

    def __exit__(self, *_: object) -> None:
        self.lap(self.name)


@final
class Laps:
    """A clock that adds the time since its last call to a phase; of numba's it is as in Phase."""

    def __init__(self, wall: dict[str, float]) -> None:
        self.wall, self.begin, self.compiled = wall, clock.perf_counter(), COMPILATION.seconds

    def __call__(self, name: str) -> None:
        """Enter in a phase what has passed since the last call."""
        now, compiled = clock.perf_counter(), COMPILATION.seconds
        self.wall["compile"] += compiled - self.compiled
        self.wall[name] += now - self.begin - (compiled - self.compiled)
        self.begin, self.compiled = now, compiled
