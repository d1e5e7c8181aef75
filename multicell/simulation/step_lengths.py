"""Lengths of coupling steps that a run chooses from what it estimates of their errors."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from multicell.scene.steps import SHORTEST_HALVINGS, Lengths

if TYPE_CHECKING:
    from collections.abc import Sequence

    from multicell.biology.step_errors import StepErrors
    from multicell.scene.steps import StepPlan
    from multicell.simulation.timeline import Timeline

_FIRST: Final = 4  # halvings of the longest step, of that with which a run begins (anew)
_PACE: Final = 1e-5  # 1/s, of scenes in which cells hardly grow
_LEAST: Final = 0.25  # of the pace counts where cells do not grow, or steps become ever shorter
_MEMORY: Final = 4.0  # longest steps over which errors are averaged: few cells decide in one
_SAFETY: Final = 0.5  # part of the tolerance that is for growth yet to be made good
_SLACK: Final = 1.15  # by which a step may be too long, or another one must be too short


def first_lengths(plan: StepPlan) -> Sequence[float]:
    """Return the lengths that a run begins with, short ones; nothing where all are alike."""
    if plan.tolerance is None:
        return ()
    first = math.ldexp(plan.coupling_step, -_FIRST)
    return Lengths(first, first, shortest=plan.coupling_step)


def lengths_after(
    known: Sequence[float], timeline: Timeline, begin: float, found: StepErrors
) -> Sequence[float]:
    """Return the lengths of the next two steps after one; nothing where all are alike.

    Cells decide at the end of the step that is nearest to their time, so that the length of the
    next one is known before this one ends. Steps end at multiples of their length. Errors that last
    may add up to the tolerance, where they stay if each step adds that part of what has grown in
    it. What is unspent may be added at the pace of free growth.

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
    pace = max(found.pace, _PACE)
    grows = max(found.growth / dt, _LEAST * pace)
    unspent = max(1.0 - error / plan.tolerance, 0.0)
    allowed = plan.tolerance * (grows + unspent * max(pace - grows, 0.0))
    ideal = allowed / rate if rate > 0.0 else 2.0 * plan.coupling_step
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
        return min(length, math.ldexp(longest, -_FIRST))
    up = _rung(longest, min(ideal / _SLACK, 2.0 * length))
    if up > length:
        return up
    return _rung(longest, ideal) if ideal < length / _SLACK else length


def _rung(longest: float, ideal: float) -> float:
    """Return the largest of the lengths that a run chooses from up to an ideal one, s."""
    power = min(max(math.floor(math.log2(ideal / longest) + 1e-9), -SHORTEST_HALVINGS), 0)
    low = math.ldexp(longest, power)
    return 1.5 * low if power < 0 and ideal >= 1.5 * low * (1.0 - 1e-9) else low
