"""Which method reaches an accuracy at least cost on one coupling step.

Every method climbs from loose to tight tolerances, all of them rung by rung in turns, the order
rotated from step to step. No solve may take more than BUDGET times what the fastest method found so
far has needed for the accuracy that is still missing: the same budget for all. Cost is CPU time
of the whole solve in one thread, neighbour lists and start-up included.
"""

from __future__ import annotations

import math
import os
import pickle
import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Final, final

import numpy as np
from phase_problems import ACCURACIES, Solved, errors

from multicell.cells import FloatArray
from multicell.comparison.files import Row
from multicell.comparison.ladders import Method
from multicell.comparison.replay import Problem, replay

BUDGET: Final = 5.0
"""Cost of a solve in units of the fastest found at which a method is given up."""
TOLERANCES: Final = tuple(10.0 ** (-0.5 * k) for k in range(1, 11))
"""Absolute tolerances that are tried, µm."""
STEPS: Final = 14
"""Number of step lengths that methods with a fixed step try: the coupling step, halved again."""
REACHED, SLOW, MISSED = "reached", "too slow", "missed"
"""An accuracy was reached; or all that is left costs too much; or no tolerance leads there."""
_LEAST = 0.1  # s of CPU time that any solve may take
_GIVEN_UP = 2  # solves that are stopped before an implicit method is given up: loose tolerances
# may be what takes long; with an explicit one it is stability, and finer ones cost more
_WATCHED = 0.3  # s of CPU time from which on a solve goes to a process that can be stopped
_PER_CELL = 1.2e-7  # s: two evaluations for a cell, which an explicit method needs for λΔt = 1
_SHORT, _TIMED_TO = 0.02, 1.0  # s: solves repeated more often, and no more at all


@final
@dataclass
class Rung:
    """A solve that came to its end: setting, CPU time in s, errors by norm."""

    setting: float
    cost: float
    errors: dict[str, float]


@final
@dataclass
class Climber:
    """A method on its ladder; ``bound`` is the longest CPU time after which a solve was stopped."""

    method: Method
    ladder: list[float]
    rungs: list[Rung] = field(default_factory=list)
    at: int = 0
    stopped: int = 0
    bound: float = 0.0

    def best(self, accuracy: float, norm: str) -> Rung | None:
        """Return the cheapest solve that has an accuracy."""
        found = [rung for rung in self.rungs if rung.errors[norm] <= accuracy]
        return min(found, key=lambda rung: rung.cost, default=None)

    def missing(self, step: Solved) -> list[float]:
        """Return the accuracies that are not reached yet."""
        return [a for a in ACCURACIES if self.best(a, step.judged_by(a)) is None]

    def over(self, step: Solved) -> bool:
        """Tell whether there is nothing more to try."""
        patience = _GIVEN_UP if self.method.info.implicit else 1
        done = self.at == len(self.ladder) or self.stopped >= patience
        return done or not self.missing(step)


def ladder(method: Method, step: Solved) -> list[float]:
    """Return the settings of a method from coarse to fine: µm, or s."""
    if method.control == "tolerance":
        return list(TOLERANCES)
    motion = step.problem.steps[0].motion
    return [(motion.end - motion.begin) / 2.0**k for k in range(STEPS)]


def race(
    step: Solved,
    methods: Sequence[Method],
    turn: int,
    known: dict[float, float] | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> list[Row]:
    """Return one row for each method and accuracy.

    Parameters
    ----------
    step
        The coupling step with its reference.
    methods
        What takes part.
    turn
        Which of them begins.
    known
        Least cost in s for an accuracy that others have needed before.
    tell
        Called with what is being solved.
    """
    turn %= max(len(methods), 1)
    climbers = [Climber(m, ladder(m, step)) for m in [*methods[turn:], *methods[:turn]]]
    least = dict(known or {})
    while any(not one.over(step) for one in climbers):
        for one in climbers:
            if not one.over(step):
                _climb(one, step, least, tell)
    _time_again(climbers, step)
    return [_row(one, step, a, least) for one in climbers for a in ACCURACIES]


def _climb(
    one: Climber, step: Solved, least: dict[float, float], tell: Callable[[str], None]
) -> None:
    """Take one rung; note what it costs to reach an accuracy if it is the least so far."""
    setting = one.ladder[one.at]
    limit = max(_LEAST, *(_limit(a, step, least) for a in one.missing(step)))
    tell(f"{one.method.name} at {setting:.2g}, up to {limit:.2g} s")
    one.at += 1
    end, cost = solve(step.problem, one.method, setting, limit, _foreseen(one, step))
    if cost > limit:
        one.stopped += 1
        one.bound = max(one.bound, limit)
    if end is None:
        return
    one.rungs.append(Rung(setting, cost, errors(step, end)))
    for a in ACCURACIES:
        if one.rungs[-1].errors[step.judged_by(a)] <= a:
            least[a] = min(cost, least.get(a, math.inf))


def _limit(accuracy: float, step: Solved, least: dict[float, float]) -> float:
    # before anyone is there: the reference is much more exact than what is asked for
    return BUDGET * least[accuracy] if accuracy in least else step.cost


def _foreseen(one: Climber, step: Solved) -> float:
    """Return about what the next solve takes at most, s."""
    if one.rungs and not one.stopped:
        return 3.0 * one.rungs[-1].cost
    return _PER_CELL * len(step.problem.start) * step.stiffness


def solve(
    problem: Problem, method: Method, setting: float, limit: float, foreseen: float
) -> tuple[FloatArray | None, float]:
    """Return the end of a step, None if it was not reached, and the CPU time in s.

    A solve that may take long is made in a process of its own, which is stopped at the limit:
    compiled loops cannot be interrupted otherwise. The time is then just above the limit.
    """
    made = method.make(setting / problem.mean_radius if method.control == "tolerance" else setting)

    def run() -> tuple[FloatArray | None, float]:
        found = replay(problem, made)
        return (found.positions[0] if found.done else None), found.cpu

    if foreseen < _WATCHED:
        return run()
    return _in_child(run, limit)


def _in_child(
    run: Callable[[], tuple[FloatArray | None, float]], limit: float
) -> tuple[FloatArray | None, float]:
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
        return None, math.nextafter(limit, math.inf)
    if status != 0:
        raise SystemExit(f"a solve ended with status {status}")
    found: tuple[FloatArray | None, float] = pickle.loads(answer)  # written by ourselves
    return found


def _time_again(climbers: Sequence[Climber], step: Solved) -> None:
    """Time short solves that reached something again, in turns, and keep the medians."""
    chosen: dict[tuple[str, float], tuple[Method, Rung, list[float]]] = {}
    for one in climbers:
        for a in ACCURACIES:
            rung = one.best(a, step.judged_by(a))
            if rung is not None and rung.cost < _TIMED_TO:
                chosen[one.method.name, rung.setting] = (one.method, rung, [])
    for k in range(5):
        for method, rung, times in chosen.values():
            if k < 3 or rung.cost < _SHORT:
                times.append(solve(step.problem, method, rung.setting, math.inf, 0.0)[1])
    for _, rung, times in chosen.values():
        rung.cost = median(times)


def _row(one: Climber, step: Solved, accuracy: float, least: dict[float, float]) -> Row:
    norm = step.judged_by(accuracy)
    rung = one.best(accuracy, norm)
    if rung is None:
        # an accuracy that the method does not have costs more than it was ready to spend
        spent = max((r.cost for r in one.rungs), default=0.0)
        bound = max(one.bound, spent, BUDGET * least.get(accuracy, 0.0))
        words = SLOW if one.stopped else MISSED
        rung = Rung(math.nan, bound, {"worst": math.nan, "observable": math.nan})
    else:
        words = REACHED
    return {
        "method": one.method.name, "implicit": int(one.method.info.implicit),
        "accuracy": accuracy, "judged_by": norm, "status": words,
        "control": one.method.control, "setting": rung.setting,
        "worst": rung.errors["worst"], "observable": rung.errors["observable"],
        "cost_s": rung.cost, "conditioning": step.conditioning[accuracy],
        "uncertainty": step.uncertainty, "viscosity_kPa_s": step.problem.scene.drag.viscosity,
        "reference_s": step.cost,
    }  # fmt: skip


def warm_up(step: Solved, methods: Sequence[Method]) -> float:
    """Compile and load all that the methods need; return the seconds it took."""
    begin = time.perf_counter()
    for method in methods:
        replay(step.problem, method.make(0.01 if method.control == "tolerance" else 60.0))
    errors(step, np.array(step.end))
    return time.perf_counter() - begin


def not_tried(name: str, implicit: bool, step: Solved, why: Row, known: Row) -> Row:
    """Return the row of a method that was too slow already where the step is less stiff."""
    return {
        **known, "method": name, "implicit": int(implicit), "status": SLOW, "setting": math.nan,
        "worst": math.nan, "observable": math.nan, "control": why["control"],
        "cost_s": BUDGET * known["cost_s"],
    }  # fmt: skip
