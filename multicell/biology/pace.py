"""How long the next coupling step is where the scene lets the run choose.

A step of length h gets a part of growth wrong that is proportional to h to leading order, as
:mod:`multicell.biology.splitting` estimates it. The next step is the longest one of the ladder (an
hour halved some times) whose part is below the tolerance, and at most twice as long as the last
one. No step is taken back: what a sudden change costs is the error of the one step in which it
comes, and steps end where a medium changes. The estimates of single steps are averaged over the
last few, since states change cell by cell, and pressures flicker after every division.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple, final

if TYPE_CHECKING:
    from multicell.biology.splitting import StepError
    from multicell.scene.steps import StepPlan

_AVERAGED = 8.0
"""Number of steps over which estimates are averaged, though not over more than the longest one."""

_NEAR = 1e-6
"""Part of a step that is too short to be a step of its own."""


@final
class Pace(NamedTuple):
    """How fast a run goes ahead.

    - ``step``, float, s: length of the next step, unless something ends it early
    - ``drift``, ``states``, ``uptake``, float, 1/s: averages over time of what
      :class:`multicell.biology.splitting.StepError` calls so, and of the part of the uptake from
      transient fields that a step gets wrong, over its length
    """

    step: float
    drift: float = 0.0
    states: float = 0.0
    uptake: float = 0.0

    @classmethod
    def of(cls, noted: Mapping[str, float] | None) -> Pace | None:
        """Return the pace that a frame's progress noted."""
        return None if noted is None else cls(**noted)


def first_pace(plan: StepPlan) -> Pace:
    """Return the pace at the start of a run: nothing is known yet."""
    return Pace(plan.shortest)


def next_pace(plan: StepPlan, pace: Pace, error: StepError, uptake: float, dt: float) -> Pace:
    """Return the pace after a step.

    - ``pace``: that of the step
    - ``error``: of the step
    - ``uptake``: part of the uptake from a transient field that the step got wrong, over its
      length, 1/s
    - ``dt``: its length, s; shorter than ``pace.step`` if something ended it early
    """
    longest = plan.longest
    weight = -math.expm1(-dt / min(_AVERAGED * pace.step, longest))
    drift = pace.drift + weight * (error.drift - pace.drift)
    states = pace.states + weight * (error.states - pace.states)
    uptake = pace.uptake + weight * (uptake - pace.uptake)
    wrong = max(abs(drift) + states, uptake)
    most = min(2.0 * pace.step, longest)
    shortest = plan.shortest
    step = longest
    while step > most or (step > shortest and step * wrong > plan.tolerance):
        step *= 0.5
    return Pace(step, drift, states, uptake)


def end_of_step(plan: StepPlan, pace: Pace, time: float) -> float:
    """Return when the step that begins at ``time`` ends, s.

    At the next multiple of its length, where a medium or what drives cells changes, at a fraction
    of radiation, or with the run.
    """
    whole = math.floor(time / pace.step + _NEAR) + 1
    end = whole * pace.step
    after = time + _NEAR * pace.step
    changes = [moment for moment in plan.changes if after < moment < end]
    return min([end, *changes, plan.duration])
