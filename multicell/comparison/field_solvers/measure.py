"""One point of a comparison of field solvers: a solve, its error and its time."""

from __future__ import annotations

import math
import time as clock
import warnings
from collections.abc import Callable
from statistics import median
from typing import Any, Final

import numpy as np
from pde.solvers.base import ConvergenceError

from multicell.cells import FloatArray
from multicell.comparison.field_solvers.problems import Case
from multicell.comparison.field_solvers.reference import Exact
from multicell.comparison.field_solvers.solvers import Attempt, FieldSolver
from multicell.comparison.field_solvers.watched import TooSlow
from multicell.comparison.files import DONE, FAILED, SKIPPED, Row
from multicell.comparison.measure import Effort
from multicell.errors import NutrientFailed

RIGHT, OFF, NEGATIVE, RUNS_AWAY = "right", "off", "negative", "runs away"
NOT_FINITE, NO_CONVERGENCE, RAISES, TOO_SLOW = (
    "not finite", "does not converge", "raises", "too slow",
)  # fmt: skip
KINDS: Final = {
    RIGHT: "within 10 % of the scale of the reference",
    OFF: "off by more than 10 % of the scale",
    NEGATIVE: "a concentration below zero by more than 0.1 % of the scale",
    RUNS_AWAY: "off by more than ten times the scale",
    NOT_FINITE: "a concentration that is no finite number",
    NO_CONVERGENCE: "the solver says that its iteration or its step control failed",
    RAISES: "another exception",
    TOO_SLOW: "took longer than it may",
}
"""How a solve ends -> what that means; the last that applies counts."""

WRONG, AWAY, BELOW = 0.1, 10.0, 1e-3
"""Errors over the scale from which on a solve is off and has run away, and how far below zero it
may come."""

_WARMED: set[tuple[str, str, str]] = set()
"""Solver, geometry and problem that this process has loaded and compiled for."""

_SAID = ("not converge", "Time step below", "NaN", "Required step size", "Not-A-Number")


def attempted(
    solver: FieldSolver, problem: Case, setting: float, backend: str, patience: float
) -> tuple[FloatArray | None, Attempt | None, dict[str, Any]]:
    """Solve once; return the data, or None with the kind of failure and its words.

    The third value holds ``kind``, ``words``, ``wall`` and ``cpu`` (s).
    """
    begun, work = clock.perf_counter(), clock.process_time()
    attempt = None
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # of a solve that runs away; what became of it is told
        try:
            attempt = Attempt(solver, problem, setting, backend, patience)
            data, kind, words = attempt.solve(), RIGHT, ""
        # whatever a solver raises is its result
        except Exception as trouble:
            data, kind, words = None, _kind(trouble), _words(trouble)
    found = {"kind": kind, "words": words, "wall": clock.perf_counter() - begun}
    return data, attempt, found | {"cpu": clock.process_time() - work}


def _kind(trouble: Exception) -> str:
    if isinstance(trouble, TooSlow):
        return TOO_SLOW
    told = isinstance(trouble, ConvergenceError | NutrientFailed)
    said = any(words in str(trouble) for words in _SAID)
    return NO_CONVERGENCE if told or said else RAISES


def _words(trouble: Exception) -> str:
    name = "" if isinstance(trouble, TooSlow | NutrientFailed) else f"{type(trouble).__name__}: "
    return f"{name}{trouble}".strip()


def judged(data: FloatArray, exact: Exact, scale: float) -> tuple[str, str, float]:
    """Return how a solve ended, in words, and its largest error over the scale."""
    if not np.isfinite(data).all():
        return NOT_FINITE, f"{int((~np.isfinite(data)).sum())} of {data.size} nodes", math.nan
    error = float(np.abs(data - exact.data).max()) / scale
    lowest = float(data.min()) / scale
    if error > AWAY:
        return RUNS_AWAY, f"off by {error:.3g} of the scale", error
    if lowest < -BELOW:
        return NEGATIVE, f"lowest concentration {lowest:.3g} of the scale", error
    if error > WRONG:
        return OFF, f"off by {error:.3g} of the scale", error
    return RIGHT, "", error


def climb(
    solver: FieldSolver,
    problem: Case,
    exact: Exact,
    backend: str,
    effort: Effort,
    tell: Callable[[str], None],
) -> tuple[list[Row], float]:
    """Return the rows of one solver on one problem from coarse to fine, and the s that took.

    Compilation is no part of the times: a solver is run once before, and if numba compiles for
    every step anew, before each point.
    """
    begun = clock.perf_counter()
    rows: list[Row] = []
    if why := solver.refusal(problem):
        return [], 0.0
    ladder = solver.ladder(problem)
    _warm(solver, problem, backend, effort.patience)  # compilation is no part of any time
    lost = clock.perf_counter() - begun
    foreseen = 0.0
    for k, setting in enumerate(ladder):
        spent = clock.perf_counter() - begun - lost
        dear = foreseen > effort.patience or spent + foreseen > effort.budget
        if rows and dear:
            why = f"not tried: it would take about {foreseen:.2g} s, after {spent:.2g} s"
            rows.append(_row(solver, problem, setting, exact, backend, SKIPPED, words=why))
            continue
        tell(f"{problem.name}: {solver.name} at {setting:.3g}")
        row = _measured(solver, problem, setting, exact, backend, effort)
        rows.append(row)
        following = ladder[min(k + 1, len(ladder) - 1)]
        foreseen = row["spent"] * _dearer(solver.control(problem), setting, following)
    return rows, clock.perf_counter() - begun - lost


def _dearer(control: str, now: float, then: float) -> float:
    """Return how many times as long the next setting takes, about."""
    if control == "tolerance":
        return 1.0
    return then / now if control == "time" else now / then if then else 1.0


def _warm(solver: FieldSolver, problem: Case, backend: str, patience: float) -> None:
    """Load and compile what the first solve would load and compile, once for each geometry."""
    warmed = (solver.name, problem.geometry, problem.kind)
    if warmed not in _WARMED and (backend != "numba" or solver.ours):
        attempted(solver, problem, solver.ladder(problem)[0], backend, 0.2 * patience)
        _WARMED.add(warmed)


def _measured(
    solver: FieldSolver, problem: Case, setting: float, exact: Exact, backend: str, effort: Effort
) -> Row:
    """Return the row of a setting."""
    data, attempt, found = attempted(solver, problem, setting, backend, effort.patience)
    if data is None:
        return _row(
            solver, problem, setting, exact, backend, FAILED, kind=found["kind"],
            words=found["words"], spent=found["wall"],
        )  # fmt: skip
    assert attempt is not None
    kind, words, error = judged(data, exact, problem.scale)
    counts = {"evaluations": attempt.evaluations or math.nan, "steps": attempt.steps or math.nan}
    compiled = backend == "numba" and not solver.ours
    times = [] if compiled else [(found["wall"], found["cpu"])]
    spent = found["wall"]
    while len(times) < effort.repeats and (spent < effort.share or not times):
        wall, cpu = _again(solver, problem, setting, backend, attempt if compiled else None)
        times.append((wall, cpu))
        spent += wall
    columns = {}
    for k, name in enumerate(("wall", "cpu")):
        series = [time[k] + problem.assembly for time in times]
        columns[name], columns[f"{name}_longest"] = median(series), max(series)
        columns[f"{name}_shortest"] = min(series)
    return _row(
        solver, problem, setting, exact, backend, DONE if kind == RIGHT else FAILED, kind=kind,
        words=words, error=error, lowest=float(np.min(data)) / problem.scale,
        spent=median([wall for wall, _ in times]), **counts, **columns,
    )  # fmt: skip


def _again(
    solver: FieldSolver, problem: Case, setting: float, backend: str, compiled: Attempt | None
) -> tuple[float, float]:
    """Return wall and processor time in s of another solve."""
    if compiled is None:
        _, _, found = attempted(solver, problem, setting, backend, math.inf)
        return found["wall"], found["cpu"]
    begun, work = clock.perf_counter(), clock.process_time()
    with np.errstate(all="ignore"):
        compiled.solve()
    return clock.perf_counter() - begun, clock.process_time() - work


def _row(
    solver: FieldSolver, problem: Case, setting: float, exact: Exact, backend: str, status: str,
    **known: Any,
) -> Row:  # fmt: skip
    """Return one row of the table; what is not known is NaN."""
    own = "kernels" if solver.ours else backend
    first = {
        "field": problem.field, "geometry": problem.geometry,
        "spacing": problem.layout.spacing, "nodes": problem.nodes, "problem": problem.kind,
        "solver": solver.name, "backend": own, "control": solver.control(problem),
        "setting": setting, "status": status, "kind": "", "words": "",
    }  # fmt: skip
    unknown = (
        "error", "lowest", "cpu", "cpu_shortest", "cpu_longest", "wall", "wall_shortest",
        "wall_longest", "spent", "evaluations", "steps",
    )  # fmt: skip
    about = {
        "assembly": problem.assembly, "uncertainty": exact.uncertainty, "scale": problem.scale,
        "slowest_time": problem.slowest, "explicit_limit": problem.limit,
    }  # fmt: skip
    return {**first, **dict.fromkeys(unknown, math.nan), **about, **known}
