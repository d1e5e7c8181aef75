"""Work–precision of the methods of a network inside cells, on steps that a run takes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Final, final

import numpy as np

from multicell.cells import FloatArray
from multicell.comparison.base import CLOCKS, FAILED, SKIPPED, SOLVED, Row
from multicell.comparison.ladders import SMALLEST_TOLERANCE
from multicell.comparison.measure import default_budget, solve_row, solve_times
from multicell.comparison.measured import Measurements, open_measurements
from multicell.comparison.network_reference import (
    NetworkReference,
    largest_rates,
    network_reference,
)
from multicell.comparison.network_steps import (
    NetworkProblem,
    NetworkRun,
    methods_of_networks,
    record_network,
    solve_steps,
    which_network,
)
from multicell.comparison.norms import Norm
from multicell.comparison.null_methods import root_mean_square
from multicell.comparison.numbers import COMPARISON_FILES, NUMBERS_FILE
from multicell.comparison.precision import Precision
from multicell.comparison.record import SAMPLES, sample_size
from multicell.errors import SceneError
from multicell.integrators.base import MethodInfo
from multicell.networks.loop import CELL_EVALUATIONS, CELL_REJECTIONS, CELL_STEPS, STIFF
from multicell.networks.methods import IMPLICIT, METHODS, NetworkMethod
from multicell.results.folder import versions
from multicell.scene.scene import Scene, load_scene
from multicell.schema import near_miss

TOLERANCES: Final = tuple(10.0**-k for k in range(1, 10))
"""Default ladder of relative tolerances."""

_QUARTERS, _QUARTER = 9, 4.0  # fixed steps, from the coupling step down; by what they fall
_LOST: Final = 1.0  # error over the size of states beyond which a solve has failed
_SOLVES: Final = 3.0  # of a point in which its repeats are foreseen
_FAILURES: Final = 3  # tolerances at which a method may fail before finer ones are left out
_LOOKS: Final = {
    "dormand-prince": ("", "s", "-"),
    "rodas3": ("", "o", "-"),
    "rodas4": ("", "D", "-"),
}
_COUNTS: Final = {
    "evaluations": CELL_EVALUATIONS,
    "steps": CELL_STEPS,
    "rejections": CELL_REJECTIONS,
    "implicit_steps": STIFF,
}


def _over(of: Callable[[FloatArray], Any], steps: Callable[[list[Any]], Any]) -> Any:
    """Return a measure of errors, (n, s) for each step: ``of`` a step, then over the steps."""
    return lambda errors: float(steps([of(error) for error in errors]))


_SIZE: Final = "their size"
NETWORK_NORMS: Final = {
    norm.name: norm
    for norm in (
        Norm("state", "states", "worst", _SIZE, _over(root_mean_square, max)),
        Norm("state_median", "states", "median", _SIZE, _over(root_mean_square, np.median)),
        Norm("worst_cell", "worst state of a cell", "worst", _SIZE, _over(np.max, max)),
        Norm(
            "worst_cell_median", "worst state of a cell", "median", _SIZE, _over(np.max, np.median)
        ),
    )
}
"""Name of each norm -> the norm. Of all states: root mean square over states and cells."""


@final
class NetworkPrecision(Precision):
    """Error and cost of each method of a network.

    ``table`` has one row for each method and setting as that of
    :class:`multicell.comparison.result.WorkPrecision`; a setting is a relative tolerance or a step
    in s, errors are over the size of each state, and ``cost`` and ``evaluations`` are calls of the
    network's rates by all cells, ``steps``, ``rejections`` and ``implicit_steps`` those of all
    cells.
    """

    main: ClassVar[str] = "state"
    last: ClassVar[str] = "state"

    def measures(self) -> dict[str, Norm]:
        """Return all norms of the table by their names."""
        return NETWORK_NORMS

    def info(self, method: str) -> MethodInfo | None:
        """Return the properties of a method; none of one that is now explicit, now implicit."""
        known = METHODS[method]
        if method == "auto":
            return None
        return MethodInfo(method, known.words, implicit=known.mode == IMPLICIT)

    def shown(self) -> tuple[str, dict[str, tuple[str, str]]]:
        """Return a note and the columns of the page's table of all solves."""
        note = (
            "Times in s; errors over the size of each state, root mean square over states and "
            "cells, and of the worst one; counts of all cells. Jacobians are differences, whose "
            "evaluations are counted."
        )
        return note, {
            "wall": ("wall", "{:.3g}"),
            "cpu": ("processor", "{:.3g}"),
            "error_state": ("error", "{:.2e}"),
            "error_worst_cell": ("worst cell", "{:.2e}"),
            **{name: (name.replace("_", " "), "{:,.0f}") for name in _COUNTS},
        }


def compare_networks(
    scene: Scene | str | Path,
    network: str = "",
    methods: Sequence[str] | None = None,
    ladder: Mapping[str, Sequence[float]] | None = None,
    output: str | Path | None = None,
    *,
    stepwise: bool | int = SAMPLES,
    clock: str = "cpu",
    repeats: int = 3,
    patience: float = 10.0,
    budget: float | None = None,
    threads: int | None = None,
    overwrite: bool = False,
    progress: Callable[[str], None] | None = None,
) -> NetworkPrecision:
    """Measure error and cost of the methods of a network inside the cells of a scene.

    The scene is run once. From coupling steps spread over the run each method solves the networks
    of the same cells with the same inputs, on one thread. The reference is RODAS at a tolerance of
    1e-10, compared with itself at 1e-9 and with CVODE on one cell of each step.

    Parameters
    ----------
    scene
        The scene, the name of a built-in one, or a TOML file.
    network
        Its name; it may be left out where the scene has one.
    methods
        Names, by default all: ``euler`` and ``rk4`` with fixed steps, ``dormand-prince``,
        ``rodas3``, ``rodas4``, ``auto``.
    ladder
        Settings by name of the method, or by ``"tolerance"`` (relative) and ``"step"`` (s).
    output
        Folder for the files of :meth:`NetworkPrecision.save`.
    stepwise
        Number of coupling steps; True for 24.
    clock, repeats, patience, budget, threads, overwrite, progress
        As for :func:`multicell.compare`; ``threads`` are those of the run.

    Raises
    ------
    SceneError, OutputError
        For input that cannot be used.
    StepFailed
        If the scene cannot be run, or the reference cannot be computed. Methods that fail are rows
        of the table.
    """
    described = scene if isinstance(scene, Scene) else load_scene(scene)
    count = sample_size(stepwise) or SAMPLES
    if clock not in CLOCKS:
        raise SceneError("clock", f"is {clock!r}, must be {' or '.join(map(repr, CLOCKS))}")
    tell = progress or (lambda _: None)
    name = which_network(described, network)
    chosen = methods_of_networks(methods)
    _check_ladder(chosen, ladder)
    what = {
        "network": name,
        "ladder": ladder,
        "stepwise": count,
        "clock": clock,
        "repeats": repeats,
        "patience": patience,
        "budget": budget,
        "threads": threads,
    }
    asked = [method.name for method in chosen]
    own = described.networks[name].network is not None  # it may have changed since
    with open_measurements(
        output, COMPARISON_FILES, described, what, asked, [] if own else asked, overwrite=overwrite
    ) as measured:
        if output is not None and measured.has(asked) and (Path(output) / NUMBERS_FILE).is_file():
            result = NetworkPrecision.read(Path(output) / NUMBERS_FILE)
            result.save(output)  # what is made of it is all that was lacking
            return result
        problem = record_network(described, name, count, threads, tell)
        tell("reference")
        exact = network_reference(problem)
        left = default_budget(exact.wall) if budget is None else budget
        table: list[Row] = []
        points: list[_Point] = []
        for k, method in enumerate(chosen):
            climber = _Climber(method, problem, exact, patience, left / (len(chosen) - k), tell)
            found = climber.points(_settings(method, ladder, problem), measured)
            table += [point.row for point in found]
            points += [point for point in found if point.row["status"] == SOLVED]
            left -= sum(row["spent"] for row in table if row["method"] == method.name)
        tell("timing, all methods in turns")
        for _ in range(repeats):
            for point in points:
                point.time(problem)
        facts = _facts(problem, exact, [] if methods is None else asked)
        result = NetworkPrecision(described, table, facts, _norms(exact.errors), clock)
        if output is not None:
            result.save(output)
    return result


@final
@dataclass
class _Point:
    """A row, a function that solves its steps again, and the times that took, s.

    ``again`` is made where it is needed.
    """

    row: Row
    again: Callable[[], NetworkRun] | None = None
    repeats: list[tuple[float, float]] = field(default_factory=list)

    def time(self, problem: NetworkProblem) -> None:
        """Solve again, and note the times."""
        if self.again is None:
            _, self.again = solve_steps(problem, self.row["method"], self.row["setting"])
        found = self.again()
        self.repeats.append((found.wall, found.cpu))
        self.row.update(solve_times(self.repeats))


@final
@dataclass
class _Climber:
    """Solves the steps by one method from coarse to fine, until patience or budget end."""

    method: NetworkMethod
    problem: NetworkProblem
    exact: NetworkReference
    patience: float
    budget: float
    tell: Callable[[str], None]

    def points(self, settings: Sequence[float], measured: Measurements) -> list[_Point]:
        """Return a point for each setting, from the folder where they were measured before."""
        known = measured.find(self.method.name)
        if known is not None:
            self.tell(f"{self.method.name}: was measured before")
            return [_Point(row) for row in known["rows"]]
        points: list[_Point] = []
        spent, foreseen, failures = 0.0, 0.0, 0
        for setting in settings:
            if foreseen > self.patience or spent + _SOLVES * foreseen > self.budget:
                words = f"not tried: it would take about {foreseen:.2g} s, after {spent:.2g} s"
                points.append(_Point(self._row(setting, SKIPPED, words=words)))
                continue
            self.tell(f"{self.method.name} at {setting:.3g}")
            found, again = solve_steps(self.problem, self.method.name, setting, self.patience)
            failures += bool(found.problem)
            if self.method.fixed:
                foreseen = _QUARTER * found.wall
            else:  # a loose tolerance may be what it fails at
                foreseen = found.wall if not found.problem or failures >= _FAILURES else 0.0
            if not found.problem:
                spent += _SOLVES * found.wall
            points.append(_Point(self._solved(setting, found), again))
        measured.add(self.method.name, rows=[point.row for point in points])
        return points

    def _solved(self, setting: float, found: NetworkRun) -> Row:
        """Return the row of a solve."""
        if found.problem:
            return self._row(setting, FAILED, words=found.problem, spent=found.wall)
        norms = _norms(self.problem.errors(found.states, self.exact.states))
        if not norms["state"] <= _LOST:
            words = f"states end off by {norms['state']:.2g} times their size"
            return self._row(setting, FAILED, words=words, spent=found.wall)
        counts = {name: int(found.work[place]) for name, place in _COUNTS.items()}
        errors = {f"error_{norm}": value for norm, value in norms.items()}
        return self._row(
            setting, SOLVED, spent=found.wall, cost=counts["evaluations"], **counts, **errors
        )

    def _row(self, setting: float, status: str, **known: Any) -> Row:
        control = "step" if self.method.fixed else "tolerance"
        columns = *(f"error_{norm}" for norm in NETWORK_NORMS), "cost", *_COUNTS
        mode = self.problem.mode
        return solve_row(self.method.name, control, setting, status, columns, mode, **known)


def _norms(errors: list[FloatArray]) -> dict[str, float]:
    """Return errors in all norms."""
    measures: Any = NETWORK_NORMS
    return {name: norm.measure(errors) for name, norm in measures.items()}


def _facts(problem: NetworkProblem, exact: NetworkReference, named: list[str]) -> dict[str, Any]:
    """Return facts about the problem for readers of the chart."""
    return {
        "network": problem.part.name,
        "cells": problem.cells,
        "mode": problem.mode,
        "stepwise": len(problem.steps),
        "coupling_steps": len(problem.steps),
        "time": problem.span,
        "largest_decay_rate": max(largest_rates(problem)),
        "threads": 1,
        "reference": exact.words,
        "reference_wall": exact.wall,
        "named": named,
        "looks": _LOOKS,
        "versions": versions(),
    }


def _settings(
    method: NetworkMethod, ladder: Mapping[str, Sequence[float]] | None, problem: NetworkProblem
) -> list[float]:
    """Return the settings of a method from coarse to fine."""
    control = "step" if method.fixed else "tolerance"
    given = (ladder or {}).get(method.name, (ladder or {}).get(control))
    if given is not None:
        return sorted(map(float, given), reverse=True)
    if method.fixed:
        return [problem.span / _QUARTER**k for k in range(_QUARTERS)]
    return list(TOLERANCES)


def _check_ladder(
    methods: Sequence[NetworkMethod], ladder: Mapping[str, Sequence[float]] | None
) -> None:
    """Refuse a ladder for what is not compared, and settings that make no sense."""
    known = {"tolerance", "step", *(method.name for method in methods)}
    for name, values in (ladder or {}).items():
        if name not in known:
            raise SceneError(f"ladder.{name}", "is no method here", near_miss(name, known))
        if not values or not all(math.isfinite(x) and x >= SMALLEST_TOLERANCE for x in values):
            problem = f"is {list(values)}, must be numbers of {SMALLEST_TOLERANCE:g} or more"
            raise SceneError(f"ladder.{name}", problem)
