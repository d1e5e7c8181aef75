"""One point of a comparison: a solve, its errors and its wall time."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from statistics import median
from typing import Any, final

from multicell.comparison.base import FAILED, SKIPPED, SOLVED, Row
from multicell.comparison.ladders import Method, weighted_cost
from multicell.comparison.norms import WORST_CELL, errors, observe
from multicell.comparison.reference import Reference
from multicell.comparison.replay import ReplayProblem, Trajectory, replay, solve_compiled
from multicell.integrators.auto import ChosenWork

_MAX_FAILURES = 3
"""Tolerances at which a method may fail before it counts as too slow for finer ones."""
_SHORT = 0.02  # wall time in s of a solve up to which an untimed one goes before it
_LEAST_BUDGET, _REFERENCES = 60.0, 10.0  # s, and solves of the reference, whichever is longer
_COMPILATION = 20.0  # wall time in s that a first coupling step may take in any case


@final
@dataclass(frozen=True)
class Effort:
    """How much time a comparison may take.

    - ``repeats``, int: number of timed solves of a point
    - ``patience``, float, s: wall time of one solve
    - ``budget``, float, s: wall time of all solves of one method
    - ``points``, int: number of points of that method: repeats end when they have taken a fair
      share
    """

    repeats: int
    patience: float
    budget: float
    points: int

    @property
    def share(self) -> float:
        """Wall time in s that the repeats of a point may take."""
        return min(self.patience / 5.0, max(self.budget, 0.0) / (2.0 * self.points))


def default_budget(wall: float) -> float:
    """Return the wall time in s of all solves, where the user names none.

    - ``wall``: of the reference, s
    """
    return max(_LEAST_BUDGET, _REFERENCES * wall)


@final
@dataclass
class TimedPoint:
    """A point that was solved and is to be timed again; ``spent`` is the wall time that took.

    ``repeats`` holds wall and processor time in s of every timed solve so far.
    """

    row: Row
    method: Method
    share: float
    spent: float
    repeats: list[tuple[float, float]]


def climb(
    method: Method,
    ladder: Sequence[float],
    exact: Reference,
    effort: Effort,
    note: Callable[[str], None],
) -> tuple[list[Row], list[TimedPoint], float]:
    """Return the rows of one method, from coarse to fine, until patience or budget end.

    Each point that was solved is timed once; the others of its repeats are left for
    :func:`time_again`, and their time is set aside in the budget. The third value is the part of
    the budget that is gone, in s; compilation and loading are not part of it.
    """
    rows: list[Row] = []
    again: list[TimedPoint] = []
    failures, foreseen, reserved = 0, 0.0, 0.0
    # compiled and loaded before the clock of the first point runs, however short the patience
    first = replace(exact.problem, steps=exact.problem.steps[:1])
    replay(first, method.make(ladder[0]), max(effort.patience, _COMPILATION))
    begin = clock.perf_counter()
    for setting in ladder:
        spent = clock.perf_counter() - begin + reserved
        # a point takes two solves at least; the first one is tried in any case
        if rows and (foreseen > effort.patience or spent + 2.0 * foreseen > effort.budget):
            words = f"not tried: it would take about {foreseen:.2g} s, after {spent:.2g} s"
            rows.append(_row(method, setting, exact, SKIPPED, words=words))
            continue
        note(f"{method.name} at {setting:.3g}")
        solve = partial(replay, exact.problem, method.make(setting), effort.patience)
        found, lost = solve_compiled(solve)
        row = _solve_row(method, setting, found, exact, effort)
        rows.append(row)
        reserved -= lost
        wall = foreseen = row["wall"] if found.done else found.wall
        if method.control == "step":
            # half the step takes twice as long; a tolerance costs less the higher the order
            foreseen *= next((setting / other for other in ladder if other < setting), 1.0)
        if found.done:
            again.append(TimedPoint(row, method, effort.share, wall, [(wall, row["cpu"])]))
            reserved += min((effort.repeats - 1) * wall, effort.share)
            continue
        failures += 1
        if method.control == "tolerance" and failures < _MAX_FAILURES:
            # a loose tolerance may be what it fails at, or what takes so long
            foreseen = 0.0
    return rows, again, clock.perf_counter() - begin + reserved


def time_again(points: Sequence[TimedPoint], problem: ReplayProblem, repeats: int) -> None:
    """Time points of all methods in turns, and keep minimum, median and maximum of each.

    A machine is slower for minutes at a time. In turns all methods meet the same minutes, and
    the ratios of their times are those of the methods.
    """
    for _ in range(repeats - 1):
        for point in points:
            if point.spent >= point.share:
                continue
            solver = point.method.make(point.row["setting"])
            if point.row["wall"] < _SHORT:
                # the caches of the processor hold what the point before has left there
                replay(problem, solver)
            found = replay(problem, solver)
            point.spent += found.wall
            point.repeats.append((found.wall, found.cpu))
            point.row.update(solve_times(point.repeats))


def _solve_row(
    method: Method, setting: float, found: Trajectory, exact: Reference, effort: Effort
) -> Row:
    """Return the row of a solve; one that succeeded is timed."""
    if not found.done:
        return _row(method, setting, exact, FAILED, words=found.problem, spent=found.wall)
    problem, solver = exact.problem, method.make(setting)
    # that solve has compiled the kernels and filled the caches; if it was short another warms up
    if found.wall < effort.share:
        replay(problem, solver)
    timed = replay(problem, solver)
    return _row(
        method,
        setting,
        exact,
        SOLVED,
        **solve_times([(timed.wall, timed.cpu)]),
        spent=found.wall,
        cost=weighted_cost(found.work),
        **vars(found.work),
        **_columns(errors(problem, observe(problem, found), exact.observed, exact.norms), exact),
    )


def _row(method: Method, setting: float, exact: Reference, status: str, **known: Any) -> Row:
    columns = (*_columns(dict.fromkeys(exact.norms, math.nan), exact), "cost", *vars(ChosenWork()))
    return solve_row(
        method.name, method.control, setting, status, columns, exact.problem.mode, **known
    )


def solve_row(
    method: str,
    control: str,
    setting: float,
    status: str,
    columns: Iterable[str],
    mode: str,
    **known: Any,
) -> Row:
    """Return one row of a table of solves; what is not known of it is NaN.

    - ``columns``: of errors and of what is counted; all tables have those of times
    """
    first = {"method": method, "control": control, "setting": setting, "status": status}
    unknown = dict.fromkeys((*solve_times([(0.0, 0.0)]), "spent", *columns), math.nan)
    return {**first, "words": "", **unknown, **known, "mode": mode}


def solve_times(repeats: Sequence[tuple[float, float]]) -> dict[str, float]:
    """Return the columns of the times of some solves: wall and processor time in s of each."""
    found = dict(zip(("wall", "cpu"), zip(*repeats, strict=True), strict=True))
    middle = {f"{clock}_median": median(times) for clock, times in found.items()}
    longest = {f"{clock}_longest": max(times) for clock, times in found.items()}
    return {clock: min(times) for clock, times in found.items()} | middle | longest


def _columns(errors: Mapping[str, float], exact: Reference) -> dict[str, float]:
    """Return the errors as columns; that of the worst cell in mean radii, in µm and in shifts."""
    radius, known = exact.problem.mean_radius, exact.conditioning
    floor = math.nan if known is None else known.floor["worst_cell_median"]
    return {
        **{f"error_{norm}": value for norm, value in errors.items()},
        **{column: radius * errors[norm] for norm, column in WORST_CELL.items()},
        "worst_cell_over_shift": errors["worst_cell_median"] / (floor or math.nan),
    }
