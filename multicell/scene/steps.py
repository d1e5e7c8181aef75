"""The coupling steps of a scene, which end where anything that it schedules changes."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final, NamedTuple, final

from multicell.behaviours.catalogue import needs_contacts
from multicell.scene.responses import effects
from multicell.scene.scales import regime

if TYPE_CHECKING:
    from multicell.scene.scene import Scene

_ROUNDING = 1e-12
"""Part of a time by which two that are meant to be the same may differ."""

_SHORTEST = 1e-9
"""Part of a coupling step that no step is shorter than: what is, is rounding of times."""

SHORTEST_HALVINGS: Final = 5
"""Halvings of the longest step that a run chooses, of the shortest one."""
_UNSEEN: Final = 600.0
"""Longest step in s that a run chooses where a scene has what no estimate sees."""


@final
class Lengths(NamedTuple):
    """Numbers that a run with chosen lengths of steps holds of them.

    - ``length``, ``following``, s: chosen for the next step and for the one after
    - ``error``: volume that depends on lengths so far, relative
    - ``rate``, 1/s²: of that in a step over the square of its length, averaged
    - ``last``, ``shortest``, ``longest``, s: of steps so far
    - ``exceeded``: number of steps that were more than twice as long as they should have been
    """

    length: float
    following: float
    error: float = 0.0
    rate: float = 0.0
    last: float = 0.0
    shortest: float = 0.0
    longest: float = 0.0
    exceeded: float = 0.0


@final
@dataclass(frozen=True)
class StepPlan:
    """The coupling steps of a run: ends at multiples of one, changes, the end.

    - ``coupling_step``, float, s: their length where nothing ends them before
    - ``duration``, float, s: of the run
    - ``jumps``, times, s: at which the medium of a steady field changes at once, or irradiated
      cells die at once
    - ``changes``, times, s, rising: at which anything scheduled changes
    - ``tolerance``: part of the volume for which the run chooses the lengths of its steps, up to
      ``coupling_step``; None: all are alike
    - ``every``, s: chosen steps also end at its multiples; infinite: frames are closer than steps
    """

    coupling_step: float
    duration: float
    jumps: tuple[float, ...] = ()
    changes: tuple[float, ...] = ()
    tolerance: float | None = None
    every: float = math.inf

    def next_end(self, time: float, length: float | None = None) -> float:
        """Return where the step that begins at a time ends, s, also beyond the run's end.

        Multiples of its ``length`` (by default ``coupling_step``) and changes that are the same but
        for rounding are one end, the latest of them: all of them have happened by then.
        """
        length, now = length or self.coupling_step, time + self._near(time)
        regular = length * (math.floor(now / length) + 1)
        if self.every < math.inf:
            regular = min(regular, self.every * (math.floor(now / self.every) + 1))
        if not self.changes:
            return regular
        ahead = self.changes[bisect_right(self.changes, time + self._near(time)) :]
        first = min((regular, *ahead[:1]))
        same = [x for x in (regular, *ahead) if x <= first + self._near(first)]
        return max(same)

    def end_after(self, time: float, length: float | None = None) -> float:
        """Return where the step that begins at a time ends, s: at the run's end at the latest."""
        end = self.next_end(time, length)
        return end if end < self.duration - self._near(self.duration) else self.duration

    def steps_after(self, time: float, length: float | None = None) -> int:
        """Return how many steps of a length there are from a time in s to the run's end."""
        length = length or self.coupling_step
        last = self.duration - self._near(self.duration)
        if time >= last:
            return 0
        regular = math.ceil(last / length) - math.floor((time + self._near(time)) / length)
        return regular + sum(time < x < last for x in self.added)

    @cached_property
    def added(self) -> tuple[float, ...]:
        """The changes that make ends of steps of their own, s."""
        ends: list[float] = []
        for change in self.changes:
            apart = abs(change - self.coupling_step * round(change / self.coupling_step))
            if apart > self._near(change):
                if ends and change - ends[-1] <= self._near(change):
                    ends.pop()
                ends.append(change)
        return tuple(ends)

    def jumps_at(self, end: float) -> bool:
        """Return whether something jumps at the end of a step, s."""
        return any(abs(jump - end) <= self._near(end) for jump in self.jumps)

    def changes_at(self, end: float) -> bool:
        """Return whether anything scheduled changes at the end of a step, s."""
        return any(abs(change - end) <= self._near(end) for change in self.changes)

    def _near(self, time: float) -> float:
        """Return how far apart times about this one are that are meant to be the same, s."""
        return max(_SHORTEST * self.coupling_step, _ROUNDING * time)


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
    changes = {time for time in _scheduled(scene) if 0.0 < time < math.inf}
    longest, tolerance = longest_coupling_step(scene), scene.coupling_tolerance
    every = scene.output.every
    if tolerance is None or every < math.ldexp(longest, -SHORTEST_HALVINGS):
        every = math.inf
    return StepPlan(longest, scene.duration, tuple(times), tuple(sorted(changes)), tolerance, every)


def longest_coupling_step(scene: Scene) -> float:
    """Return the longest coupling step of a scene, s.

    Where the run chooses their lengths, it is ``coupling_step`` halved until it is at most a
    twentieth of the shortest cycle, half of the shortest phase and of the time in which cells
    react, and a quarter of those in which dead cells shrink; and ten minutes where cells have
    networks, move of their own, count neighbours or are driven, of which no estimate knows.
    """
    longest = scene.coupling_step
    if scene.coupling_tolerance is None:
        return longest
    limits, growth, death = [0.5 * scene.cells.reaction_time], scene.growth, scene.death
    if growth is not None:
        quickest = min((kind.cycle_scale for kind in scene.types.values()), default=1.0)
        limits += [0.05 * quickest * growth.mean_cycle]
        limits += [0.5 * quickest * phase.duration for phase in growth.phases.values()]
    if death is not None:
        swelling = [death.swelling_time] if death.swelling != 1.0 else []
        limits += [0.25 * x for x in (death.lysis_time, death.apoptosis_time, *swelling)]
    moving = scene.motility, scene.surface, scene.adhesion, scene.chemotaxis, scene.motions
    signals = {name for effect in effects(scene) for name in effect.signals}
    signals |= set() if growth is None else growth.signals
    unseen = any(moving) or scene.networks or scene.pull or scene.contact.remembers
    if unseen or any(map(needs_contacts, signals)):
        limits.append(_UNSEEN)
    return math.ldexp(longest, -max(0, math.ceil(math.log2(longest / min(limits)) - 1e-9)))


_PRESSED: Final = 5.0
"""Tolerance over the product of step and pace of growth, where pressure limits it (measured)."""


def usual_coupling_step(scene: Scene) -> float:
    """Return how long coupling steps are, s: those that a run chooses as it is expected to."""
    longest, growth = longest_coupling_step(scene), scene.growth
    if scene.coupling_tolerance is None or growth is None or growth.critical_pressure is None:
        return longest
    return min(longest, _PRESSED * scene.coupling_tolerance * growth.mean_cycle)


def _scheduled(scene: Scene) -> Iterator[float]:
    """Yield the times in s at which something scheduled begins, ends or changes its slope."""
    for field in scene.nutrients.values():
        yield from (time for time, _ in field.media or ())
        yield from (release.time for release in field.release.values())
    for course in scene.radiation.values():
        yield from course.schedule
    for motion in scene.motions.values():
        yield motion.begin
        yield math.inf if motion.end is None else motion.end
    for kind in scene.types.values():
        for points in (kind.receptor, kind.ligand):
            yield from (time for time, _ in points if len(points) > 1)
    for effect in effects(scene):
        if effect.signals == ("time",):
            yield from effect.law.kinks
