"""The coupling steps that a scene allows, resolved once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, final

from multicell.scene.coupling import fixed_step, longest_step, shortest_step, tolerance
from multicell.scene.driven import drivers
from multicell.scene.scales import regime

if TYPE_CHECKING:
    from multicell.scene.scene import Scene


@final
@dataclass(frozen=True)
class StepPlan:
    """Which coupling steps a run takes.

    - ``fixed``, float or None, s: length of all steps; None where the run chooses it
    - ``shortest``, ``longest``, float, s: between which it chooses
    - ``tolerance``, float: part of growth that splitting may get wrong
    - ``duration``, float, s: of the run
    - ``changes``, times, s: at which a medium or what drives cells changes, or cells are
      irradiated: chosen steps end there
    - ``jumps``, times, s: at which the medium of a steady field changes at once, or irradiated
      cells die at once
    """

    fixed: float | None
    shortest: float
    longest: float
    tolerance: float
    duration: float
    changes: tuple[float, ...]
    jumps: tuple[float, ...]


def step_plan(scene: Scene) -> StepPlan:
    """Return the plan of a scene's coupling steps."""
    media = {name: field.media or () for name, field in scene.nutrients.items()}
    ends = (time for _, driver in drivers(scene) for time in (driver.begin, driver.end))
    jumping = [
        name
        for name, field in scene.nutrients.items()
        if media[name] and field.media_change != "linear" and regime(scene, name) == "steady"
    ]
    fractions = [(part, time) for part in scene.radiation.values() for time in part.schedule]
    return StepPlan(
        fixed_step(scene),
        shortest_step(scene),
        longest_step(scene),
        tolerance(scene),
        scene.duration,
        changes=(
            *(time for points in media.values() for time, _ in points),
            *(time for time in ends if time is not None),
            *(time for _, time in fractions),
        ),
        jumps=(
            *(time for name in jumping for time, _ in media[name]),
            *(time for part, time in fractions if not part.mitotic_divisions),
        ),
    )
