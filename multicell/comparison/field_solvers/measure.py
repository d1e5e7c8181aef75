"""One point of a comparison of field solvers: a solve, its error and its time."""

from __future__ import annotations

import math
import time as clock
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from statistics import median
from typing import Any, Final, final

import numpy as np
from pde.solvers.base import ConvergenceError

from multicell.cells import FloatArray
from multicell.comparison.field_solvers.equations import (
    TooSlow,
    thiele_modulus,
    with_uptake,
)
from multicell.comparison.field_solvers.problems import Case, Piece, fastest_rate
from multicell.comparison.field_solvers.reference import Exact, on_one_grid
from multicell.comparison.field_solvers.solvers import (
    CONTROLLED,
    DIRECT,
    Attempt,
    FieldSolver,
)
from multicell.comparison.files import DONE, FAILED, SKIPPED, Row
from multicell.comparison.measure import Effort, Rung, climb_ladder
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
    NO_CONVERGENCE: "the solver reports that its iteration or its step control failed",
    RAISES: "another exception",
    TOO_SLOW: "took longer than it may",
}
"""How a solve ends -> what that means; the last that applies counts."""

MAX_ERROR, RUNAWAY_ERROR, MAX_NEGATIVE = 0.1, 10.0, 1e-3
"""Errors over the scale from which on a solve is off and has run away, and how far below zero it
may come."""

UPTAKES: Final = tuple(10.0**k for k in np.arange(-1.0, 3.51, 0.9))
"""Uptake over that of the scene in the stability map."""
STEPS: Final = tuple(2.0**k for k in range(-4, 6))
"""Steps in the stability map over the largest stable one of explicit Euler without uptake."""
TOLERANCES: Final = tuple(10.0**-k for k in range(6, 0, -1))
"""Tolerances in the stability map over the scale."""
TRIAL_PATIENCE: Final = 0.2
"""Longest trial of the stability map over the longest solve of the comparison."""

_WARMED: set[tuple[str, str, str]] = set()
"""Solver, geometry and problem that this process has loaded and compiled for."""

_FAILURES = ("not converge", "Time step below", "NaN", "Required step size", "Not-A-Number")
"""Words by which solvers report that they failed."""


@final
@dataclass
class Solve:
    """What became of one solve.

    Attributes
    ----------
    data : FloatArray or None, mM
        At the end; None where the solver failed.
    attempt : Attempt or None
        Its counts.
    kind, words : str
        A key of :data:`KINDS`, and what was seen.
    error : float
        Largest error over the scale of the problem.
    wall, cpu : float, s
    """

    data: FloatArray | None = None
    attempt: Attempt | None = None
    kind: str = RIGHT
    words: str = ""
    error: float = math.nan
    wall: float = 0.0
    cpu: float = 0.0

    @contextmanager
    def timed(self) -> Iterator[None]:
        """Time a solve, of which warnings do not matter: its end is judged."""
        begun, work = clock.perf_counter(), clock.process_time()
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            yield
        self.wall, self.cpu = clock.perf_counter() - begun, clock.process_time() - work

    def judge(self, exact: Exact, scale: float) -> None:
        """Compare the data, if there are any, with the exact ones."""
        data = self.data
        if data is None:
            return
        if not np.isfinite(data).all():
            bad = f"{int((~np.isfinite(data)).sum())} of {data.size} nodes"
            self.kind, self.words = NOT_FINITE, bad
            return
        self.error = float(np.abs(data - exact.data).max()) / scale
        lowest = float(data.min()) / scale
        off = f"off by {self.error:.3g} of the scale"
        if self.error > RUNAWAY_ERROR:
            self.kind, self.words = RUNS_AWAY, off
        elif lowest < -MAX_NEGATIVE:
            self.kind, self.words = NEGATIVE, f"lowest concentration {lowest:.3g} of the scale"
        elif self.error > MAX_ERROR:
            self.kind, self.words = OFF, off


@final
@dataclass(frozen=True)
class Bench:
    """One problem with its solution, on which solvers are tried.

    Attributes
    ----------
    problem : Case
    exact : Exact
    backend : str
        Of py-pde's solvers, one of :data:`BACKENDS`.
    """

    problem: Case
    exact: Exact
    backend: str

    def attempt(self, solver: FieldSolver, setting: float, patience: float) -> Solve:
        """Solve once and judge the end; whatever a solver raises is its result."""
        found = Solve()
        with found.timed():
            try:
                found.attempt = Attempt(solver, self.problem, setting, self.backend, patience)
                found.data = found.attempt.solve()
            except Exception as trouble:
                found.kind, found.words = _kind(trouble), _words(trouble)
        found.judge(self.exact, self.problem.scale)
        return found

    def climb(
        self, solver: FieldSolver, effort: Effort, tell: Callable[[str], None]
    ) -> tuple[list[Row], float]:
        """Return the rows of one solver from coarse to fine, and the s that took.

        Compilation is no part of the times: a solver is run once before, and if numba compiles
        for every step anew, before each point.
        """
        problem = self.problem
        if solver.refusal(problem):
            return [], 0.0
        ladder = solver.ladder(problem)
        self._warm(solver, ladder[0], effort.patience)

        def measure(setting: float) -> Rung:
            tell(f"{problem.name}: {solver.name} at {setting:.3g}")
            row = self._measured(solver, setting, effort)
            finer = ladder[min(ladder.index(setting) + 1, len(ladder) - 1)]
            return Rung(row, row["spent"] * _dearer(solver.control(problem), setting, finer))

        def skip(setting: float, words: str) -> Row:
            return self._row(solver, setting, SKIPPED, words=words)

        return climb_ladder(ladder, effort, measure, skip)

    def _compiles(self, solver: FieldSolver) -> bool:
        """Return whether every attempt of a solver compiles its steps anew."""
        return self.backend == "numba" and not solver.ours

    def _warm(self, solver: FieldSolver, setting: float, patience: float) -> None:
        """Load and compile what the first solve would load and compile, once for each geometry."""
        warmed = (solver.name, self.problem.geometry, self.problem.kind)
        if warmed not in _WARMED and not self._compiles(solver):
            self.attempt(solver, setting, 0.2 * patience)
            _WARMED.add(warmed)

    def _measured(self, solver: FieldSolver, setting: float, effort: Effort) -> Row:
        """Return the row of a setting; one that reached the end is timed."""
        found = self.attempt(solver, setting, effort.patience)
        if found.data is None or found.attempt is None:
            return self._row(
                solver, setting, FAILED, kind=found.kind, words=found.words, spent=found.wall
            )
        times = [] if self._compiles(solver) else [(found.wall, found.cpu)]
        spent = found.wall
        while len(times) < effort.repeats and (spent < effort.share or not times):
            again = self._again(solver, setting, found.attempt)
            times.append((again.wall, again.cpu))
            spent += again.wall
        columns = {}
        for k, name in enumerate(("wall", "cpu")):
            series = [time[k] + self.problem.assembly for time in times]
            columns[name], columns[f"{name}_longest"] = median(series), max(series)
            columns[f"{name}_shortest"] = min(series)
        return self._row(
            solver, setting, DONE if found.kind == RIGHT else FAILED, kind=found.kind,
            words=found.words, error=found.error,
            lowest=float(np.min(found.data)) / self.problem.scale,
            spent=median([wall for wall, _ in times]),
            evaluations=found.attempt.evaluations or math.nan,
            steps=found.attempt.steps or math.nan, **columns,
        )  # fmt: skip

    def _again(self, solver: FieldSolver, setting: float, before: Attempt) -> Solve:
        """Solve again for the time it takes."""
        if not self._compiles(solver):
            return self.attempt(solver, setting, math.inf)
        found = Solve()
        with found.timed():
            before.solve()
        return found

    def place(self, solver: FieldSolver, setting: float) -> Row:
        """Return the columns that tell a solve from others."""
        problem = self.problem
        return {
            "field": problem.field, "geometry": problem.geometry,
            "spacing": problem.layout.spacing, "nodes": problem.nodes, "problem": problem.kind,
            "solver": solver.name, "backend": "kernels" if solver.ours else self.backend,
            "control": solver.control(problem), "setting": setting,
        }  # fmt: skip

    def _row(self, solver: FieldSolver, setting: float, status: str, **known: Any) -> Row:
        """Return one row of the table; what is not known is NaN."""
        unknown = (
            "error", "lowest", "cpu", "cpu_shortest", "cpu_longest", "wall", "wall_shortest",
            "wall_longest", "spent", "evaluations", "steps",
        )  # fmt: skip
        problem = self.problem
        about = {
            "assembly": problem.assembly, "uncertainty": self.exact.uncertainty,
            "scale": problem.scale, "slowest_time": problem.slowest,
            "explicit_limit": problem.limit,
        }  # fmt: skip
        first = {**self.place(solver, setting), "status": status, "kind": "", "words": ""}
        return {**first, **dict.fromkeys(unknown, math.nan), **about, **known}


def stability_rows(
    problem: Case,
    solvers: Sequence[FieldSolver],
    backend: str,
    patience: float,
    tell: Callable[[str], None],
    *,
    uptakes: Sequence[float] | None = None,
    steps: Sequence[float] | None = None,
    tolerances: Sequence[float] | None = None,
) -> list[Row]:
    """Return how each solver ends for each step or tolerance and strength of uptake.

    Steps are relative to explicit Euler's limit without uptake, which is the same in all rows.
    Uptake is stated as a Thiele modulus. By default :data:`UPTAKES`, :data:`STEPS` and
    :data:`TOLERANCES` are tried.
    """
    uptakes, steps, tolerances = uptakes or UPTAKES, steps or STEPS, tolerances or TOLERANCES
    rows: list[Row] = []
    diffusive = 2.0 / fastest_rate(with_uptake(problem.whole, 0.0), problem.scale, problem.start)
    for factor in uptakes:
        equation = with_uptake(problem.whole, factor)
        limit = 2.0 / fastest_rate(equation, problem.scale, problem.start)
        piece = Piece(equation, 0.0, problem.end)
        stiff = replace(problem, whole=equation, pieces=(piece,), limit=diffusive)
        bench = Bench(stiff, on_one_grid(stiff), backend)
        modulus = thiele_modulus(equation)
        about = {"factor": factor, "thiele": modulus, "limit": limit / diffusive}
        for solver in solvers:
            if solver.kind == DIRECT or solver.refusal(stiff):
                continue
            tell(f"stability: {solver.name} at a Thiele modulus of {modulus:.2g}")
            for setting in tolerances if solver.kind == CONTROLLED else steps:
                found = bench.attempt(solver, setting, TRIAL_PATIENCE * patience)
                seen = {"kind": found.kind, "words": found.words, "error": found.error}
                row = bench.place(solver, setting) | seen | about
                rows.append({**row, "cpu": found.cpu, "explicit_limit": diffusive})
    return rows


def _kind(trouble: Exception) -> str:
    if isinstance(trouble, TooSlow):
        return TOO_SLOW
    reported = isinstance(trouble, ConvergenceError | NutrientFailed)
    described = any(words in str(trouble) for words in _FAILURES)
    return NO_CONVERGENCE if reported or described else RAISES


def _words(trouble: Exception) -> str:
    name = "" if isinstance(trouble, TooSlow | NutrientFailed) else f"{type(trouble).__name__}: "
    return f"{name}{trouble}".strip()


def _dearer(control: str, now: float, then: float) -> float:
    """Return how many times as long the next setting takes, about."""
    if control == "tolerance":
        return 1.0
    return then / now if control == "time" else now / then if then else 1.0
