"""Methods that reach the goals of a tile, and their cost.

Every method climbs from loose to tight tolerances, all of them rung by rung in turns, the order
rotated from tile to tile. No solve may take more than BUDGET times what the fastest method found
so far has needed for the goal that is still missing: the same budget for all. Cost is CPU time of
the whole solve in one thread, neighbour lists and start-up included. Null methods take part.
"""

from __future__ import annotations

import math
import os
import pickle
import signal
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple, final

from tile_problems import Solved

from multicell.cells import FloatArray
from multicell.comparison.ladders import Method
from multicell.comparison.replay import replay

Row = dict[str, Any]
BUDGET: Final = 5.0
"""Cost of a solve in units of the fastest found at which a method is given up."""
TOLERANCES: Final = tuple(10.0 ** (-0.5 * k) for k in range(1, 11))
"""Absolute tolerances that are tried, µm, and a method's default one."""
STEPS: Final = 14
"""Number of step lengths that methods with a fixed step try: the coupling step, halved again."""
REACHED, SLOW, MISSED = "reached", "too slow", "missed"
"""A goal was reached; or all that is left costs too much; or no setting leads there."""
DEFAULT: Final = 0.0
"""In place of a goal: the row of a solve at a method's default tolerance."""
_LEAST = 0.1  # s of CPU time that any solve may take
_GIVEN_UP = 2  # solves that are stopped before an implicit method is given up: loose tolerances
# may be what takes long; with an explicit one it is stability, and finer ones cost more
_WATCHED = 0.3  # s of CPU time from which on a solve goes to a process that can be stopped
_PER_CELL = 1.2e-7  # s: two evaluations for a cell, which an explicit method needs for λΔt = 1
_SHORT = 0.05  # s of CPU time below which a solve is timed at least three times
_ALIKE, _LEAST_TIMES, _MOST_TIMES = 1.1, 9, 25
"""Ratio of the two shortest times of a solve above which it is timed again; how often at least and
at most."""


class Rung(NamedTuple):
    """A solve that came to its end: setting, CPU time in s, effort in evaluations, errors."""

    setting: float
    cost: float
    effort: int
    error: float
    worst: float


@final
@dataclass
class Climber:
    """A method on its ladder; ``bound`` is the longest CPU time after which a solve was stopped."""

    method: Method
    ladder: list[float]
    goals: tuple[float, ...]
    rungs: list[Rung] = field(default_factory=list)
    at: int = 0
    stopped: int = 0
    bound: float = 0.0

    def best(self, goal: float) -> Rung | None:
        """Return the cheapest solve that reaches a goal."""
        found = [rung for rung in self.rungs if rung.error <= goal]
        return min(found, key=lambda rung: rung.cost, default=None)

    @property
    def missing(self) -> list[float]:
        """The goals that are not reached yet."""
        return [goal for goal in self.goals if self.best(goal) is None]

    @property
    def over(self) -> bool:
        """Whether there is nothing more to try."""
        patience = _GIVEN_UP if self.method.info.implicit else 1
        return self.at == len(self.ladder) or self.stopped >= patience or not self.missing


def ladder(method: Method, step: Solved, loosest: float = math.inf) -> list[float]:
    """Return the settings of a method from coarse to fine: µm, or s; NaN where it has none."""
    if method.control == "none":
        return [math.nan]
    if method.control == "tolerance":
        every = sorted({*TOLERANCES, method.info.atol}, reverse=True)
        return [atol for atol in every if atol <= loosest]
    motion = step.problem.steps[0].motion
    return [(motion.end - motion.begin) / 2.0**k for k in range(STEPS)]


def race(
    step: Solved,
    methods: Sequence[Method],
    turn: int = 0,
    loosest: dict[str, float] | None = None,
) -> list[Row]:
    """Return one row for each method and goal, and one at its default tolerance.

    - ``step``: the coupling step with its reference
    - ``methods``: what takes part
    - ``turn``: which of them begins
    - ``loosest``: method -> setting at which its ladder begins
    """
    turn %= max(len(methods), 1)
    climbers = [
        Climber(
            method, ladder(method, step, (loosest or {}).get(method.name, math.inf)), step.goals
        )
        for method in [*methods[turn:], *methods[:turn]]
    ]
    least: dict[float, float] = {}
    while any(not one.over for one in climbers):
        for one in climbers:
            if not one.over:
                limit = max(_LEAST, *(_limit(goal, step, least) for goal in one.missing))
                one.at += 1
                _climb(one, one.ladder[one.at - 1], limit, step)
                for goal in step.goals:
                    best = one.best(goal)
                    # a null method is no measure of what a solve may cost
                    if best is not None and one.method.control != "none":
                        least[goal] = min(best.cost, least.get(goal, math.inf))
    for one in climbers:
        if one.method.control == "tolerance" and _at_default(one) is None:
            limit = max(_LEAST, *(_limit(goal, step, least) for goal in step.goals))
            _climb(one, one.method.info.atol, limit, step)
    _time_again(climbers, step)
    return [row for one in climbers for row in _rows(one, least)]


def _climb(one: Climber, setting: float, limit: float, step: Solved) -> None:
    """Solve at a setting within a limit of CPU time in s."""
    foreseen = _PER_CELL * len(step.problem.start) * step.facts["lambda_dt"]
    if one.rungs and not one.stopped:
        foreseen = 3.0 * one.rungs[-1].cost
    end, cost, effort = solve(step, one.method, setting, limit, foreseen)
    if cost > limit and end is not None:  # the first one may have loaded code
        end, cost, effort = solve(step, one.method, setting, limit, foreseen)
    if cost > limit:
        one.stopped += 1
        one.bound = max(one.bound, limit)
    if end is not None:
        one.rungs.append(Rung(setting, cost, effort, *step.errors(end)))


def _limit(goal: float, step: Solved, least: dict[float, float]) -> float:
    # before anyone is there: the reference is much more exact than what is asked for
    return BUDGET * least[goal] if goal in least else step.facts["reference_s"]


Ended = tuple[FloatArray | None, float, int]


def solve(step: Solved, method: Method, setting: float, limit: float, foreseen: float) -> Ended:
    """Return the end of a step, None if it was not reached, the CPU time in s and the effort.

    A solve that may take long is made in a process of its own, which is stopped at the limit:
    compiled loops cannot be interrupted otherwise. The time is then just above the limit.
    """
    radius = step.problem.mean_radius
    made = method.make(setting / radius if method.control == "tolerance" else setting)

    def run() -> Ended:
        found = replay(step.problem, made)
        return (found.positions[0] if found.done else None), found.cpu, found.work.effort

    return run() if foreseen < _WATCHED else _in_child(run, limit)


def _in_child(run: Callable[[], Ended], limit: float) -> Ended:
    """Run in a copy of this process that the system stops after a CPU time."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        code = 1
        try:
            signal.signal(signal.SIGPROF, signal.SIG_DFL)
            signal.setitimer(signal.ITIMER_PROF, limit)
            answer = pickle.dumps(run())
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            with os.fdopen(writing, "wb") as pipe:
                pipe.write(answer)
            code = 0
        finally:
            os._exit(code)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        answer = pipe.read()
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGPROF:
        return None, math.nextafter(limit, math.inf), 0
    if status != 0:
        raise SystemExit(f"a solve ended with status {status}")
    found: Ended = pickle.loads(answer)  # written by ourselves
    return found


def _at_default(one: Climber) -> Rung | None:
    return next((rung for rung in one.rungs if rung.setting == one.method.info.atol), None)


def _time_again(climbers: Sequence[Climber], step: Solved) -> None:
    """Time the short solves that rows are made of again, in turns, and keep the shortest times."""
    chosen = {}
    for one in climbers:
        for rung in {*map(one.best, one.goals), _at_default(one)} - {None}:
            if rung is not None and rung.cost < _SHORT:
                chosen[one.method.name, rung.setting] = (one, rung, [rung.cost])
    for turn in range(1, _MOST_TIMES):
        for one, rung, times in chosen.values():
            first, second, *_ = [*sorted(times), math.inf]
            if turn < _LEAST_TIMES or second > _ALIKE * first:
                times.append(solve(step, one.method, rung.setting, math.inf, 0.0)[1])
    for one, rung, times in chosen.values():
        one.rungs[one.rungs.index(rung)] = rung._replace(cost=min(times))


def _rows(one: Climber, least: dict[float, float]) -> list[Row]:
    """Return the rows of a method; one that missed a goal has the cost that it was given."""
    common = {"method": one.method.name, "implicit": int(one.method.info.implicit)}
    found: list[Row] = []
    for goal in (*one.goals, *((DEFAULT,) if one.method.control == "tolerance" else ())):
        rung = _at_default(one) if goal == DEFAULT else one.best(goal)
        status = REACHED if rung is not None else SLOW if one.stopped else MISSED
        if rung is None and one.method.control == "none":
            rung = one.rungs[0]
        if rung is None:
            spent = max((r.cost for r in one.rungs), default=0.0)
            bound = max(one.bound, spent, BUDGET * least.get(goal or one.goals[0], 0.0))
            rung = Rung(math.nan, bound, 0, math.nan, math.nan)
        found.append({**common, "goal": goal, "status": status, **rung._asdict()})
    return found
