"""One point of a comparison: a solve, its errors and its wall time."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, final

from multicell.comparison.methods import Method, weighted_cost
from multicell.comparison.norms import errors, no_errors, observe
from multicell.comparison.problem import Problem, Trajectory, replay
from multicell.comparison.reference import Reference
from multicell.integrators.base import Integrator
from multicell.mechanics import Work

Row = dict[str, Any]
DONE, FAILED, SKIPPED = "done", "failed", "skipped"
_TRIALS = 3
"""Tolerances at which a method may fail before it is held to be too slow for finer ones."""
_COMPILATION = 20.0
"""Wall time in s that a first coupling step may take in any case."""


@final
@dataclass(frozen=True)
class Effort:
    """How much time a comparison may take.

    Attributes
    ----------
    repeats : int
        Number of timed solves of a point.
    patience : float, s
        Wall time of one solve.
    budget : float, s
        Wall time of all solves of one method.
    points : int
        Number of points of that method: repeats end when they have taken a fair share.
    """

    repeats: int
    patience: float
    budget: float
    points: int

    @property
    def share(self) -> float:
        """Wall time in s that the repeats of a point may take."""
        return min(self.patience / 5.0, max(self.budget, 0.0) / (2.0 * self.points))


def climb(
    method: Method,
    ladder: Sequence[float],
    exact: Reference,
    effort: Effort,
    tell: Callable[[str], None],
) -> list[Row]:
    """Return the rows of one method, from coarse to fine, until patience or budget end."""
    rows: list[Row] = []
    foreseen, failures = 0.0, 0
    # compiled and loaded before the clock of the first point runs, however short the patience
    first = replace(exact.problem, steps=exact.problem.steps[:1])
    replay(first, method.make(ladder[0]), max(effort.patience, _COMPILATION))
    begin = clock.perf_counter()
    for k, setting in enumerate(ladder):
        spent = clock.perf_counter() - begin
        # a point takes two solves at least; the first one is tried in any case
        dear = foreseen > effort.patience or spent + 2.0 * foreseen > effort.budget
        if rows and dear:
            text = f"not tried: it would take about {foreseen:.2g} s, after {spent:.2g} s"
            rows.append(_row(method, setting, SKIPPED, text))
            continue
        tell(f"{method.name} at {setting:.3g}")
        found = replay(exact.problem, method.make(setting), effort.patience)
        rows.append(_measured(method, setting, found, exact, effort))
        finer = ladder[k] / ladder[k + 1] if k + 1 < len(ladder) else 1.0
        # half the step takes twice as long; a tolerance costs less the higher the order
        growth = finer if method.control == "step" else 1.0
        foreseen = growth * (rows[-1]["wall"] if found.done else found.wall)
        failures += not found.done
        if not found.done and method.control == "tolerance" and failures < _TRIALS:
            # a loose tolerance may be what it fails at, or what takes so long
            foreseen = 0.0
    return [{**row, "mode": exact.problem.mode} for row in rows]


def _measured(
    method: Method,
    setting: float,
    found: Trajectory,
    exact: Reference,
    effort: Effort,
) -> Row:
    """Return the row of a solve; one that succeeded is timed."""
    if not found.done:
        return _row(method, setting, FAILED, found.problem, spent=found.wall)
    times = _timed(exact.problem, method.make(setting), found.wall, effort)
    error = errors(exact.problem, observe(exact.problem, found), exact.observed)
    return _row(method, setting, DONE, "", times, found, error, spent=found.wall)


def _timed(
    problem: Problem, integrator: Integrator, first: float, effort: Effort
) -> tuple[float, float]:
    """Return the minimum wall time and the minimum processor time of several solves, s.

    The solve that gave the error has compiled the kernels and filled the caches; if it was
    short another one warms up. Of a long solve one repetition is enough.
    """
    if first < effort.share:
        replay(problem, integrator)
    wall: list[float] = []
    cpu: list[float] = []
    while not wall or (len(wall) < effort.repeats and sum(wall) < effort.share):
        again = replay(problem, integrator)
        wall.append(again.wall)
        cpu.append(again.cpu)
    return min(wall), min(cpu)


def _row(
    method: Method,
    setting: float,
    status: str,
    text: str,
    times: tuple[float, float] = (math.nan, math.nan),
    found: Trajectory | None = None,
    error: Mapping[str, float] | None = None,
    *,
    spent: float = math.nan,
) -> Row:
    """Return one row of the table; what is not known is NaN."""
    counts = dict.fromkeys(vars(Work()), math.nan) if found is None else vars(found.work)
    return {
        "method": method.name,
        "control": method.control,
        "setting": setting,
        "status": status,
        "words": text,
        "wall": times[0],
        "cpu": times[1],
        "spent": spent,
        **{f"error_{norm}": value for norm, value in (error or no_errors()).items()},
        "cost": math.nan if found is None else weighted_cost(found.work),
        **counts,
    }
