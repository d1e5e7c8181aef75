"""The coupling steps of a scene, resolved once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, final

from multicell.scene.scales import regime

if TYPE_CHECKING:
    from multicell.scene.scene import Scene


@final
@dataclass(frozen=True)
class StepPlan:
    """Which coupling steps a run takes.

    - ``step``, float, s: their length
    - ``duration``, float, s: of the run
    - ``jumps``, times, s: at which the medium of a steady field changes at once, or irradiated
      cells die at once
    """

    step: float
    duration: float
    jumps: tuple[float, ...]


def step_plan(scene: Scene) -> StepPlan:
    """Return the plan of a scene's coupling steps."""
    jumping = [
        field.media
        for name, field in scene.nutrients.items()
        if field.media and field.media_change != "linear" and regime(scene, name) == "steady"
    ]
    dying = [part for part in scene.radiation.values() if not part.mitotic_divisions]
    times = [time for media in jumping for time, _ in media]
    times += [time for part in dying for time in part.schedule]
    return StepPlan(scene.coupling_step, scene.duration, tuple(times))
