"""Lengths of coupling steps that a run chooses from what it estimates of their errors."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple, final

from multicell.scene.steps import FIRST, SHORTEST

if TYPE_CHECKING:
    from collections.abc import Sequence

    from multicell.biology.step_errors import StepErrors
    from multicell.scene.steps import StepPlan
    from multicell.simulation.timeline import Timeline

_SPEND: Final = 4.0
"""How fast the tolerance is spent, over the pace of growth: most of it where all cells grow."""
_PACE: Final = 1e-5  # 1/s, of scenes in which cells hardly grow
_LEAST: Final = 0.25  # of the tolerance is left to spend, or steps would become ever shorter
_MEMORY: Final = 4.0  # longest steps over which errors are averaged: few cells decide in one
_SAFETY: Final = 0.5  # part of the tolerance that is for growth yet to be made good
_SLACK: Final = 0.7  # of a step is short enough to go on with it


@final
class Lengths(NamedTuple):
    """What a run with chosen lengths of steps holds of them; all are numbers.

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
    shortest: float = math.inf
    longest: float = 0.0
    exceeded: float = 0.0


def first_lengths(plan: StepPlan) -> Sequence[float]:
    """Return what a run begins with: short steps; nothing where all are alike."""
    if plan.tolerance is None:
        return ()
    first = math.ldexp(plan.coupling_step, -FIRST)
    return Lengths(first, first)


def lengths_after(
    known: Sequence[float], timeline: Timeline, begin: float, found: StepErrors
) -> Sequence[float]:
    """Return the lengths of the next two steps after one; nothing where all are alike.

    Cells decide at the end of the step that is nearest to their time, so that the length of the
    next one is known before this one ends. Lengths are halves of each other, and steps end at their
    multiples: they double at most.

    - ``known``: before the step, which began at ``begin``, s, and ended at that of the ``timeline``
    - ``found``: its errors
    """
    plan, end = timeline.plan, timeline.time
    if plan.tolerance is None:
        return ()
    was, dt = Lengths(*known), end - begin
    error = (was.error + found.lasting) / (1.0 + found.growth)
    share = dt / (dt + min(begin, _MEMORY * plan.coupling_step))
    rate = was.rate + share * (found.lasting / dt**2 - was.rate)
    left = max(plan.tolerance - error, _LEAST * plan.tolerance)
    ideal = left * _SPEND * max(found.pace, _PACE) / rate if rate > 0.0 else math.inf
    if found.lag > 0.0:
        ideal = min(ideal, dt * math.sqrt(_SAFETY * plan.tolerance / found.lag))
    return Lengths(
        length=was.following,
        following=_following(plan, was.following, ideal, plan.next_end(end, was.following)),
        error=error,
        rate=rate,
        last=dt,
        shortest=min(was.shortest, dt),
        longest=max(was.longest, dt),
        exceeded=was.exceeded + (2.0 * ideal < dt),
    )


def _following(plan: StepPlan, length: float, ideal: float, begin: float) -> float:
    """Return the length of the step that begins after one of another length, s."""
    longest = plan.coupling_step
    if plan.changes_at(begin):
        return min(length, math.ldexp(longest, -FIRST))
    if ideal >= 2.0 * length:
        return min(2.0 * length, longest)
    if ideal < _SLACK * length:
        halvings = math.ceil(math.log2(length / max(ideal, math.ldexp(longest, -SHORTEST))))
        return math.ldexp(length, -halvings)
    return length
